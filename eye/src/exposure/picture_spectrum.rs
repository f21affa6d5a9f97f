//! The picture's spectrum at the kept frequencies.
//!
//! Pixels that are far finer than what the eye resolves are first put on a coarser grid, one axis after the other, by the spreading kernel of
//! [`super::spread`], whose transform is divided out (a non-uniform FFT of type 1 whose points are uniform): then the transforms are small
//! and their lengths have small prime factors, whatever the pixels.
//!
//! # Cost
//! A pixel is multiplied and added once for each of the kernel's samples; only columns inside the band are transformed, two rows in one
//! complex transform.

use rustfft::FftPlanner;
use rustfft::num_complex::{Complex, Complex64};
use std::f64::consts::TAU;

use super::grid::{Band, Real};
use super::scene::good_size;
use super::spread::Spread;

/// Coarse samples per two cycles of the highest frequency.
const OVERSAMPLING: f64 = 2.0;
/// Widths of the spreading kernel that leave errors as small as those of the numbers, in single and in double precision.
const WIDTHS: [usize; 2] = [8, 15];
/// Coarse samples for a pixel, along each axis, up to which pixels are put on the coarser grid: by the number of operations, not timed.
const COARSE: f64 = 0.75;

/// Sums that are kept side by side.
const LANES: usize = 4;

/// How the spectra of pictures of a size are made, placed at the corner of a period.
pub struct PictureSpectrum {
    size: [usize; 2],
    period: [usize; 2],
    /// Columns of the spectrum that are kept.
    columns: usize,
    coarse: Option<[Coarse; 2]>,
}

/// A coarser axis.
struct Coarse {
    /// Samples in a period.
    samples: usize,
    /// First pixel of those that a sample takes from, and their weights; samples go on beyond the period's ends.
    taps: Vec<(usize, Vec<f64>)>,
    /// By cycles, 0 and up: over the kernel's transform, and back to the first pixel.
    factors: Vec<Complex64>,
}

impl Coarse {
    /// For so many pixels and cycles in a period of `period` pixels.
    fn new(pixels: usize, period: usize, most: usize, width: usize) -> Self {
        let samples = good_size((2.0 * OVERSAMPLING * (most + 1) as f64).ceil() as usize);
        let spread = Spread::new(width, OVERSAMPLING);
        let half = 0.5 * width as f64;
        let per_px = samples as f64 / period as f64;
        // The first sample that the first pixel reaches stands at -offset.
        let offset = half.floor();
        let last = pixels.saturating_sub(1) as f64 * per_px;
        let count = (offset + (last + half).floor()) as usize + 1;
        let taps_of = |sample: usize| {
            let at = sample as f64 - offset;
            let first = ((at - half) / per_px).ceil().max(0.0) as usize;
            let end = (((at + half) / per_px).floor() as usize + 1).min(pixels);
            let weight = |pixel: usize| spread.value(at - pixel as f64 * per_px);
            (first.min(end), (first..end).map(weight).collect())
        };
        let factor = |cycles: usize| {
            let nu = cycles as f64 / samples as f64;
            Complex64::cis(TAU * nu * offset) / spread.transform(nu)
        };
        Self { samples, taps: (0..count).map(taps_of).collect(), factors: (0..=most).map(factor).collect() }
    }

    /// Taps and their weights in a precision, filled up with weights of 0 to a multiple of `multiple`.
    fn taps<T: Real>(&self, multiple: usize) -> Vec<(usize, Vec<T>)> {
        let narrow = |(first, weights): &(usize, Vec<f64>)| {
            let mut own: Vec<T> = weights.iter().map(|weight| T::narrow(*weight)).collect();
            own.resize(own.len().next_multiple_of(multiple), T::zero());
            (*first, own)
        };
        self.taps.iter().map(narrow).collect()
    }
}

impl PictureSpectrum {
    /// For pictures of `size`, in single or double precision.
    pub fn new(size: [usize; 2], period: [usize; 2], band: &Band, single: bool) -> Self {
        let most = band.most();
        let columns = most[0].min(period[0] / 2) + 1;
        let width = WIDTHS[usize::from(!single)];
        let coarse = [0, 1].map(|axis| Coarse::new(size[axis], period[axis], most[axis], width));
        let pays = [0, 1].iter().all(|&axis| (coarse[axis].samples as f64) < COARSE * period[axis] as f64);
        Self { size, period, columns, coarse: pays.then_some(coarse) }
    }

    /// The spectrum of pixel values `[row][column]` at the kept frequencies, sum convention e^{-2πi}.
    pub fn of<T: Real>(&self, light: &[f64], band: &Band) -> Vec<Complex<T>> {
        let Some([across, down]) = &self.coarse else {
            let light: Vec<T> = light.iter().map(|value| T::narrow(*value)).collect();
            let table = half_spectrum(&light, self.size, self.period, self.columns);
            return kept(&table, self.period, self.columns, band);
        };
        let light = on_coarse_grid::<T>(light, self.size[0], [across, down]);
        let period = [across.samples, down.samples];
        let table = half_spectrum(&light, [across.taps.len(), down.taps.len()], period, self.columns);
        let mut spectrum = kept(&table, period, self.columns, band);
        for run in &band.runs {
            let along = across.factors[run.x.unsigned_abs() as usize];
            let along = if run.x < 0 { along.conj() } else { along };
            for (z, factor) in spectrum[run.range()].iter_mut().zip(&down.factors[run.y as usize..]) {
                let factor = along * factor;
                *z = *z * Complex::new(T::narrow(factor.re), T::narrow(factor.im));
            }
        }
        spectrum
    }
}

/// Pixels put on a coarser grid, `[y][x]`.
fn on_coarse_grid<T: Real>(light: &[f64], width: usize, [across, down]: [&Coarse; 2]) -> Vec<T> {
    let (across, down) = (across.taps::<T>(LANES), down.taps::<T>(1));
    // The last samples' weights of 0 fall on what stands behind the line.
    let mut line = vec![T::zero(); width + LANES];
    let mut grid = Vec::with_capacity(across.len() * down.len());
    for (first, weights) in &down {
        line.fill(T::zero());
        let rows = light[first * width..(first + weights.len()) * width].chunks_exact(width.max(1));
        for (row, weight) in rows.zip(weights) {
            line.iter_mut().zip(row).for_each(|(sum, value)| *sum = *sum + *weight * T::narrow(*value));
        }
        grid.extend(across.iter().map(|(first, weights)| dot(weights, &line[*first..first + weights.len()])));
    }
    grid
}

/// Sum of products, a multiple of [`LANES`] of them, in a fixed order.
fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    let mut lanes = [T::zero(); LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            lanes[lane] = lanes[lane] + a[lane] * b[lane];
        }
    }
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])
}

/// The kept frequencies out of a half spectrum `[x][y]`.
fn kept<T: Real>(table: &[Complex<T>], [px, py]: [usize; 2], columns: usize, band: &Band) -> Vec<Complex<T>> {
    let mut spectrum = Vec::with_capacity(band.len);
    for run in &band.runs {
        let x = run.x.rem_euclid(px as i32) as usize;
        let end = spectrum.len() + run.len;
        // The picture is real: at -ν stands the conjugate.
        let (line, conjugate) = if x < columns { (x, false) } else { (px - x, true) };
        let line = &table[line * py..(line + 1) * py];
        let mut y = run.y as usize % py;
        while spectrum.len() < end {
            let count = (py - y).min(end - spectrum.len());
            if conjugate {
                // From -y downwards; -0 is 0.
                let first = usize::from(y == 0);
                spectrum.extend(line[..first].iter().map(Complex::conj));
                let down = line[py + 1 - y - count..=py - y - first].iter().rev();
                spectrum.extend(down.take(count - first).map(Complex::conj));
            } else {
                spectrum.extend_from_slice(&line[y..y + count]);
            }
            y = 0;
        }
    }
    spectrum
}

/// Rows of which this many are transformed before they are put down column by column.
const ROWS: usize = 8;

/// Spectrum `[x][y]` of one period for x from 0 to `columns` - 1 and all y.
fn half_spectrum<T: Real>(
    light: &[T],
    [width, height]: [usize; 2],
    [px, py]: [usize; 2],
    columns: usize,
) -> Vec<Complex<T>> {
    let zero = Complex::new(T::zero(), T::zero());
    let mut table = vec![zero; columns * py];
    let mut planner = FftPlanner::<T>::new();
    let along_x = planner.plan_fft_forward(px);
    let mut scratch = vec![zero; along_x.get_inplace_scratch_len()];
    let mut lines = vec![zero; ROWS / 2 * px];
    let half = T::narrow(0.5);
    for top in (0..height).step_by(ROWS) {
        lines.fill(zero);
        for row in top..(top + ROWS).min(height) {
            let line = &mut lines[(row - top) / 2 * px..][..px];
            // Light beyond the period's end belongs to its start: it is periodic.
            for part in light[row * width..(row + 1) * width].chunks(px) {
                for (z, value) in line.iter_mut().zip(part) {
                    let value = *value;
                    if (row - top).is_multiple_of(2) { z.re = z.re + value } else { z.im = z.im + value }
                }
            }
        }
        along_x.process_with_scratch(&mut lines, &mut scratch);
        for x in 0..columns {
            for (pair, line) in lines.chunks_exact(px).enumerate() {
                let (a, b) = (line[x], line[(px - x) % px].conj());
                let (even, odd) = ((a + b) * half, (a - b) * half);
                // odd/i.
                for (row, z) in [(top + 2 * pair, even), (top + 2 * pair + 1, Complex::new(odd.im, -odd.re))]
                {
                    if row < height {
                        let slot = &mut table[x * py + row % py];
                        *slot = *slot + z;
                    }
                }
            }
        }
    }
    planner.plan_fft_forward(py).process(&mut table);
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Also where the frequencies go beyond what the pixels can tell apart, with a picture larger than the period, and with pixels so fine
    /// that they are put on a coarser grid.
    #[test]
    fn the_spectrum_of_a_picture_is_the_sum_of_its_pixels() {
        for (size, period, samples, cycles, coarse) in [
            ([3, 2], [8, 6], [40, 40], 1.7, false),
            ([5, 7], [9, 15], [8, 8], 0.3, false),
            ([30, 3], [8, 6], [16, 16], 0.4, false),
            ([3, 2], [2000, 1500], [60, 60], 0.01, true),
            ([70, 41], [94, 62], [20, 16], 0.1, true),
            ([120, 41], [94, 62], [20, 16], 0.1, true),
        ] {
            let light: Vec<f64> = (0..size[0] * size[1]).map(|i| ((i * 7919) % 13) as f64).collect();
            let band = Band::new(period, samples, cycles);
            assert!(band.len > 10);
            let spectrum = |single: bool| PictureSpectrum::new(size, period, &band, single);
            assert_eq!(spectrum(true).coarse.is_some(), coarse, "{size:?}");
            let wide = spectrum(false).of::<f64>(&light, &band);
            let narrow = spectrum(true).of::<f32>(&light, &band);
            for (i, nu) in band.iter().enumerate() {
                let mut exact = Complex64::ZERO;
                for (at, value) in light.iter().enumerate() {
                    let (x, y) = ((at % size[0]) as f64, (at / size[0]) as f64);
                    let turns =
                        f64::from(nu[0]) * x / period[0] as f64 + f64::from(nu[1]) * y / period[1] as f64;
                    exact += Complex64::from_polar(*value, -TAU * turns);
                }
                let scale = light.iter().sum::<f64>();
                assert!((wide[i] - exact).norm() < 1e-12 * scale, "{size:?} {nu:?}");
                let narrow = Complex64::new(narrow[i].re.into(), narrow[i].im.into());
                assert!((narrow - exact).norm() < 1e-6 * scale, "{size:?} {nu:?}");
            }
        }
    }
}
