//! Transforms on the periodic grid: the picture's spectrum, and two real images from one complex inverse transform.

use rayon::prelude::*;
use rustfft::num_complex::{Complex, Complex64};
use rustfft::num_traits::ToPrimitive;
use rustfft::{FftNum, FftPlanner};

/// One kept frequency of the half plane y > 0, or y = 0 and x >= 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frequency {
    /// Cycles in a period along x; may be negative.
    pub x: i32,
    /// Cycles in a period along y, not negative.
    pub y: i32,
}

/// Spectrum of pixel values `[row][column]` placed at the corner of a period (pixels), at the kept frequencies, sum convention
/// e^{-2πi}: by a transform of the whole period, or, where pixels are far smaller than what the eye resolves and the period
/// holds very many of them, by the sums themselves.
pub fn picture_spectrum(
    light: &[f64],
    size: [usize; 2],
    period: [usize; 2],
    frequencies: &[Frequency],
) -> Vec<Complex64> {
    let most_x = frequencies.iter().map(|nu| nu.x.unsigned_abs() as usize).max().unwrap_or(0);
    let most_y = frequencies.iter().map(|nu| nu.y.unsigned_abs() as usize).max().unwrap_or(0);
    let [px, py] = period;
    let transform = px as f64 * py as f64 * 60.0;
    let sums = (2 * most_x + 1) as f64 * size[1] as f64 * (size[0] + most_y + 1) as f64 * 4.0;
    let (table, width) = if transform <= sums {
        (whole_period(light, size, period), px)
    } else {
        (direct_sums(light, size, period, [most_x, most_y]), 2 * most_x + 1)
    };
    let wrap = |at: i32, n: usize| at.rem_euclid(n as i32) as usize;
    let rows = table.len() / width.max(1);
    frequencies.iter().map(|nu| table[wrap(nu.y, rows) * width + wrap(nu.x, width)]).collect()
}

/// Spectrum `[y][x]` of one period.
fn whole_period(light: &[f64], [width, height]: [usize; 2], [px, py]: [usize; 2]) -> Vec<Complex64> {
    let mut values = vec![Complex64::ZERO; px * py];
    for row in 0..height {
        for column in 0..width {
            // Light beyond the period's end belongs to its start: it is periodic.
            values[(row % py) * px + column % px] += light[row * width + column];
        }
    }
    let mut planner = FftPlanner::new();
    planner.plan_fft_forward(px).process(&mut values);
    let mut columns = transpose(&values, px, py);
    planner.plan_fft_forward(py).process(&mut columns);
    transpose(&columns, py, px)
}

/// Spectrum `[y][x]` for y = 0 to `most[1]`, x = 0 to `most[0]` and then -`most[0]` to -1.
fn direct_sums(light: &[f64], size: [usize; 2], period: [usize; 2], most: [usize; 2]) -> Vec<Complex64> {
    let [width, height] = size;
    let columns = 2 * most[0] + 1;
    let signed = |x: usize| if x <= most[0] { x as f64 } else { x as f64 - columns as f64 };
    // e^{-2πi ν n / P} for n = 0, 1, …: exact turns, reduced before the sine.
    let wave = |cycles: f64, n: usize, period: usize| {
        Complex64::cis(-std::f64::consts::TAU * (cycles * n as f64 / period as f64).fract())
    };
    let by_column: Vec<Vec<Complex64>> = (0..columns)
        .into_par_iter()
        .map(|x| {
            let along: Vec<Complex64> = (0..width).map(|n| wave(signed(x), n, period[0])).collect();
            let row_sum = |row: &[f64]| row.iter().zip(&along).map(|(v, w)| *v * w).sum::<Complex64>();
            let sums: Vec<Complex64> = light.chunks_exact(width.max(1)).map(row_sum).collect();
            let down = |y: usize| (0..height).map(|n| sums[n] * wave(y as f64, n, period[1])).sum();
            (0..=most[1]).map(down).collect()
        })
        .collect();
    (0..=most[1]).flat_map(|y| by_column.iter().map(move |column| column[y])).collect()
}

/// Two real images `[y][x]` of `samples` = [columns, rows] from the Fourier coefficients of both at the kept frequencies, computed
/// in the precision `T`.
pub fn two_images<T: FftNum + ToPrimitive>(
    frequencies: &[Frequency],
    first: &[Complex64],
    second: &[Complex64],
    samples: [usize; 2],
) -> [Vec<f32>; 2] {
    let [columns, rows] = samples;
    let narrow = |z: Complex64| {
        let part = |x| T::from_f64(x).unwrap_or_else(T::zero);
        Complex::new(part(z.re), part(z.im))
    };
    // Laid out [x][y], so that after one transposition the result is [y][x].
    let mut values = vec![Complex::new(T::zero(), T::zero()); columns * rows];
    let mut used = vec![false; columns];
    let i = Complex64::I;
    let place = |at: i32, n: usize| at.rem_euclid(n as i32) as usize;
    for ((nu, a), b) in frequencies.iter().zip(first).zip(second) {
        let (x, y) = (place(nu.x, columns), place(nu.y, rows));
        values[x * rows + y] = narrow(a + i * b);
        used[x] = true;
        if nu.x != 0 || nu.y != 0 {
            let (x, y) = (place(-nu.x, columns), place(-nu.y, rows));
            values[x * rows + y] = narrow(a.conj() + i * b.conj());
            used[x] = true;
        }
    }
    let mut planner = FftPlanner::<T>::new();
    let along_y = planner.plan_fft_inverse(rows);
    let mut scratch = vec![Complex::new(T::zero(), T::zero()); along_y.get_inplace_scratch_len()];
    for (line, used) in values.chunks_mut(rows).zip(used) {
        if used {
            along_y.process_with_scratch(line, &mut scratch);
        }
    }
    let mut values = transpose(&values, rows, columns);
    planner.plan_fft_inverse(columns).process(&mut values);
    let single = |x: T| x.to_f32().unwrap_or_default();
    [values.iter().map(|z| single(z.re)).collect(), values.iter().map(|z| single(z.im)).collect()]
}

/// Transposes `[rows][columns]` in blocks that fit the cache.
fn transpose<Z: Copy>(values: &[Z], columns: usize, rows: usize) -> Vec<Z> {
    const BLOCK: usize = 16;
    let mut out = values.to_vec();
    for top in (0..rows).step_by(BLOCK) {
        for left in (0..columns).step_by(BLOCK) {
            for row in top..(top + BLOCK).min(rows) {
                for column in left..(left + BLOCK).min(columns) {
                    out[column * rows + row] = values[row * columns + column];
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_waves_come_back_separately() {
        let frequencies = [Frequency { x: 0, y: 0 }, Frequency { x: 2, y: 0 }, Frequency { x: -3, y: 1 }];
        let first = [Complex64::new(1.0, 0.0), Complex64::new(0.25, 0.0), Complex64::ZERO];
        let second = [Complex64::ZERO, Complex64::ZERO, Complex64::new(0.0, -0.5)];
        for [a, b] in [
            two_images::<f64>(&frequencies, &first, &second, [12, 10]),
            two_images::<f32>(&frequencies, &first, &second, [12, 10]),
        ] {
            for y in 0..10 {
                for x in 0..12 {
                    let turn = std::f64::consts::TAU;
                    let (fx, fy) = (f64::from(x) / 12.0, f64::from(y) / 10.0);
                    let at = (y * 12 + x) as usize;
                    assert!((f64::from(a[at]) - 1.0 - 0.5 * (turn * 2.0 * fx).cos()).abs() < 1e-6);
                    assert!((f64::from(b[at]) - (turn * (fy - 3.0 * fx)).sin()).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn the_spectrum_of_one_pixel_is_a_wave_either_way() {
        let mut light = vec![0.0; 6];
        light[5] = 2.0;
        let frequencies: Vec<Frequency> = (-3..=3)
            .flat_map(|x| (0..=2).map(move |y| Frequency { x, y }))
            .filter(|nu| nu.y > 0 || nu.x >= 0)
            .collect();
        // A short period is transformed whole, a long one summed.
        for period in [[8, 6], [2000, 1500]] {
            let spectrum = picture_spectrum(&light, [3, 2], period, &frequencies);
            for (nu, at) in frequencies.iter().zip(spectrum) {
                let turns = f64::from(nu.x) * 2.0 / period[0] as f64 + f64::from(nu.y) / period[1] as f64;
                assert!(
                    (at - Complex64::from_polar(2.0, -std::f64::consts::TAU * turns)).norm() < 1e-12,
                    "{nu:?}"
                );
            }
        }
    }
}
