//! Transforms on the periodic grid: the picture's spectrum, and two real images from one complex inverse transform.

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

/// Discrete spectrum `[y][x]` of pixel values `[row][column]` placed at the corner of a period, sum convention e^{-2πi}.
pub fn picture_spectrum(light: &[f64], size: [usize; 2], period: [usize; 2]) -> Vec<Complex64> {
    let [width, height] = size;
    let [px, py] = period;
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
    fn the_spectrum_of_one_pixel_is_a_wave() {
        let mut light = vec![0.0; 6];
        light[5] = 2.0;
        let spectrum = picture_spectrum(&light, [3, 2], [8, 4]);
        let at = spectrum[3 * 8 + 5];
        let exact = Complex64::from_polar(2.0, -std::f64::consts::TAU * (5.0 * 2.0 / 8.0 + 3.0 / 4.0));
        assert!((at - exact).norm() < 1e-12);
    }
}
