//! Transforms on the periodic grid: the picture's spectrum, and two real images from one complex inverse transform.
//!
//! # Cost
//! Only rows with a picture and columns inside the band are transformed; two rows (two images) share a complex transform.

use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftNum, FftPlanner};
use std::sync::Arc;

/// The precision of a transform.
pub trait Real: FftNum {
    /// From double precision.
    fn narrow(value: f64) -> Self;
    /// From single precision.
    fn of(value: f32) -> Self;
    /// To single precision.
    fn single(self) -> f32;
    /// To double precision.
    fn wide(self) -> f64;
}

impl Real for f32 {
    fn narrow(value: f64) -> Self {
        value as Self
    }
    fn of(value: f32) -> Self {
        value
    }
    fn single(self) -> f32 {
        self
    }
    fn wide(self) -> f64 {
        self.into()
    }
}

impl Real for f64 {
    fn narrow(value: f64) -> Self {
        value
    }
    fn of(value: f32) -> Self {
        Self::from(value)
    }
    fn single(self) -> f32 {
        self as f32
    }
    fn wide(self) -> f64 {
        self
    }
}

/// Kept frequencies (cycles in a period) with a common x: y from `y` on, `len` of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Cycles along x; may be negative.
    pub x: i32,
    /// First cycles along y, not negative.
    pub y: i32,
    /// Place of the first among all kept frequencies.
    pub at: usize,
    /// Number of frequencies.
    pub len: usize,
}

impl Run {
    /// Places of its frequencies among all kept ones.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.at..self.at + self.len
    }
}

/// The kept frequencies: of the half plane y > 0, or y = 0 and x >= 0, those inside the band.
#[derive(Clone, Debug, Default)]
pub struct Band {
    /// In the order of x.
    pub runs: Vec<Run>,
    /// Number of frequencies.
    pub len: usize,
}

impl Band {
    /// Frequencies below `cycles_per_px` for a period in pixels that is sampled `samples` times.
    pub fn new(period_px: [usize; 2], samples: [usize; 2], cycles_per_px: f64) -> Self {
        let [px, py] = period_px.map(|p| p as f64);
        // The grid cannot tell its highest frequency from its negative.
        let limit = |p: f64, samples: usize| ((cycles_per_px * p) as i32).min(samples as i32 / 2 - 1);
        let (most_x, most_y) = (limit(px, samples[0]), limit(py, samples[1]));
        let mut band = Self::default();
        for x in -most_x..=most_x {
            let inside = |y: &i32| (f64::from(x) / px).hypot(f64::from(*y) / py) <= cycles_per_px;
            let y = i32::from(x < 0);
            let len = (y..=most_y).take_while(inside).count();
            if len > 0 {
                band.runs.push(Run { x, y, at: band.len, len });
                band.len += len;
            }
        }
        band
    }

    /// Largest |x| and y.
    pub fn most(&self) -> [usize; 2] {
        let x = self.runs.iter().map(|r| r.x.unsigned_abs() as usize).max().unwrap_or(0);
        let y = self.runs.iter().map(|r| r.y as usize + r.len - 1).max().unwrap_or(0);
        [x, y]
    }

    /// Each frequency (x, y).
    pub fn iter(&self) -> impl Iterator<Item = [i32; 2]> {
        self.runs.iter().flat_map(|run| (0..run.len as i32).map(move |i| [run.x, run.y + i]))
    }
}

/// Spectrum of pixel values `[row][column]` placed at the corner of a period (pixels), at the kept frequencies, sum convention
/// e^{-2πi}: by transforms, or, where pixels are far smaller than what the eye resolves and the period holds very many of
/// them, by the sums themselves.
pub fn picture_spectrum<T: Real>(
    light: &[f64],
    size: [usize; 2],
    period: [usize; 2],
    band: &Band,
) -> Vec<Complex<T>> {
    let most = band.most();
    let [px, py] = period;
    let columns = most[0].min(px / 2) + 1;
    let transform = |n: usize, lines: usize| 2.5 * (n * lines) as f64 * (n as f64).log2();
    let transforms = transform(px, size[1].div_ceil(2)) + transform(py, columns);
    let sums = (2 * most[0] + 1) as f64 * size[1] as f64 * (size[0] + most[1] + 1) as f64 * 8.0;
    if sums < transforms {
        return direct_sums(light, size, period, band);
    }
    let table = half_spectrum::<T>(light, size, period, columns);
    let mut spectrum = Vec::with_capacity(band.len);
    for run in &band.runs {
        let x = run.x.rem_euclid(px as i32) as usize;
        let y = run.y as usize;
        if x < columns {
            let line = &table[x * py..(x + 1) * py];
            spectrum.extend((y..y + run.len).map(|y| line[y % py]));
        } else {
            // The picture is real: at -ν stands the conjugate.
            let line = &table[(px - x) * py..(px - x + 1) * py];
            spectrum.extend((y..y + run.len).map(|y| line[(py - y % py) % py].conj()));
        }
    }
    spectrum
}

/// Rows of which this many are transformed before they are put down column by column.
const ROWS: usize = 8;

/// Spectrum `[x][y]` of one period for x from 0 to `columns` - 1 and all y.
fn half_spectrum<T: Real>(
    light: &[f64],
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
                    let value = T::narrow(*value);
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

/// The kept part of the spectrum by sums.
fn direct_sums<T: Real>(
    light: &[f64],
    [width, height]: [usize; 2],
    period: [usize; 2],
    band: &Band,
) -> Vec<Complex<T>> {
    // e^{-2πi ν n / P} for n = 0, 1, …: exact turns, reduced before the sine.
    let wave = |cycles: i32, n: usize, period: usize| {
        let turns = (f64::from(cycles) * n as f64 / period as f64).fract();
        Complex::<f64>::cis(-std::f64::consts::TAU * turns)
    };
    let of_run = |run: &Run| -> Vec<Complex<T>> {
        let along: Vec<Complex<f64>> = (0..width).map(|n| wave(run.x, n, period[0])).collect();
        let row_sum = |row: &[f64]| row.iter().zip(&along).map(|(v, w)| *v * w).sum::<Complex<f64>>();
        let sums: Vec<Complex<f64>> = light.chunks_exact(width.max(1)).map(row_sum).collect();
        let down = |y: i32| (0..height).map(|n| sums[n] * wave(y, n, period[1])).sum::<Complex<f64>>();
        (0..run.len as i32)
            .map(|i| down(run.y + i))
            .map(|z| Complex::new(T::narrow(z.re), T::narrow(z.im)))
            .collect()
    };
    band.runs.par_iter().map(of_run).collect::<Vec<_>>().concat()
}

/// Complex numbers, real and imaginary parts apart: sums of products run in vector code then.
#[derive(Clone, Debug, Default)]
pub struct Planar<T> {
    /// Real parts.
    pub re: Vec<T>,
    /// Imaginary parts.
    pub im: Vec<T>,
}

impl<T: Real> Planar<T> {
    /// Zeros.
    pub fn zeros(len: usize) -> Self {
        Self { re: vec![T::zero(); len], im: vec![T::zero(); len] }
    }

    /// From numbers.
    pub fn new(values: impl Iterator<Item = Complex<f64>>) -> Self {
        let (re, im) = values.map(|z| (T::narrow(z.re), T::narrow(z.im))).unzip();
        Self { re, im }
    }

    /// A number in double precision.
    pub fn at(&self, i: usize) -> Complex<f64> {
        Complex::new(self.re[i].wide(), self.im[i].wide())
    }
}

/// The transforms of a grid.
pub struct Transforms<T: Real> {
    /// Columns and rows.
    pub samples: [usize; 2],
    along: [Arc<dyn Fft<T>>; 2],
}

impl<T: Real> Transforms<T> {
    /// For a grid of columns and rows.
    pub fn new(samples: [usize; 2]) -> Self {
        let mut planner = FftPlanner::<T>::new();
        Self { samples, along: samples.map(|n| planner.plan_fft_inverse(n)) }
    }

    fn scratch(&self, axis: usize) -> Vec<Complex<T>> {
        vec![Complex::new(T::zero(), T::zero()); self.along[axis].get_inplace_scratch_len()]
    }
}

/// Two real images as one complex one that is transformed along y only, `[x][y]`.
pub struct Columns<T>(Vec<Complex<T>>);

impl<T: Real> Columns<T> {
    /// Transforms a block of rows from `top` on: `[y][x]` in `block`.
    pub fn rows(
        &self,
        transforms: &Transforms<T>,
        top: usize,
        block: &mut [Complex<T>],
        scratch: &mut Vec<Complex<T>>,
    ) {
        let [columns, rows] = transforms.samples;
        let count = block.len() / columns;
        for (x, column) in self.0.chunks_exact(rows).enumerate() {
            for (row, z) in column[top..top + count].iter().enumerate() {
                block[row * columns + x] = *z;
            }
        }
        if scratch.is_empty() {
            *scratch = transforms.scratch(0);
        }
        transforms.along[0].process_with_scratch(block, scratch);
    }
}

/// The sums over primaries of kernels times what is sent (`drive[primary][frequency]`), for two images, transformed back along y.
pub fn two_images<T: Real>(
    band: &Band,
    [first, second]: [&[Planar<f32>]; 2],
    drive: &[Planar<T>],
    transforms: &Transforms<T>,
) -> Columns<T> {
    let [columns, rows] = transforms.samples;
    let zero = Complex::new(T::zero(), T::zero());
    let mut values = vec![zero; columns * rows];
    let mut used = vec![false; columns];
    let (mut a, mut b) = (Planar::<T>::zeros(rows), Planar::<T>::zeros(rows));
    for run in &band.runs {
        sum_of_products(first, drive, run, &mut a);
        sum_of_products(second, drive, run, &mut b);
        let parts = |from: usize| {
            let (a_re, a_im) = (&a.re[from..run.len], &a.im[from..run.len]);
            let (b_re, b_im) = (&b.re[from..run.len], &b.im[from..run.len]);
            a_re.iter().zip(a_im).zip(b_re.iter().zip(b_im)).map(|((ar, ai), (br, bi))| (*ar, *ai, *br, *bi))
        };
        let plus = run.x.rem_euclid(columns as i32) as usize;
        let minus = (-run.x).rem_euclid(columns as i32) as usize;
        (used[plus], used[minus]) = (true, true);
        // conj(a) + i·conj(b) at -ν, then a + i·b at ν: of the mean only the latter stays.
        let from = run.y as usize;
        let line = &mut values[minus * rows..(minus + 1) * rows];
        let skip = usize::from(from == 0);
        if skip == 1 {
            line[0] = Complex::new(a.re[0] + b.im[0], b.re[0] - a.im[0]);
        }
        let mirrored = line[rows + 1 - from - run.len..=rows - from - skip].iter_mut().rev();
        for (z, (a_re, a_im, b_re, b_im)) in mirrored.zip(parts(skip)) {
            *z = Complex::new(a_re + b_im, b_re - a_im);
        }
        let line = &mut values[plus * rows + from..][..run.len];
        for (z, (a_re, a_im, b_re, b_im)) in line.iter_mut().zip(parts(0)) {
            *z = Complex::new(a_re - b_im, a_im + b_re);
        }
    }
    let mut scratch = transforms.scratch(1);
    for (line, used) in values.chunks_mut(rows).zip(used) {
        if used {
            transforms.along[1].process_with_scratch(line, &mut scratch);
        }
    }
    Columns(values)
}

/// Σ over primaries of kernel times drive on a run of frequencies, in the first places of `sums`.
fn sum_of_products<T: Real>(kernels: &[Planar<f32>], drive: &[Planar<T>], run: &Run, sums: &mut Planar<T>) {
    let (re, im) = (&mut sums.re[..run.len], &mut sums.im[..run.len]);
    re.fill(T::zero());
    im.fill(T::zero());
    for (kernel, sent) in kernels.iter().zip(drive) {
        let (k_re, k_im) = (&kernel.re[run.range()], &kernel.im[run.range()]);
        let (d_re, d_im) = (&sent.re[run.range()], &sent.im[run.range()]);
        for i in 0..run.len {
            let (kr, ki) = (T::of(k_re[i]), T::of(k_im[i]));
            re[i] = re[i] + (kr * d_re[i] - ki * d_im[i]);
            im[i] = im[i] + (kr * d_im[i] + ki * d_re[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustfft::num_complex::Complex64;
    use std::f64::consts::TAU;

    /// A grid of 12 x 10, its rows transformed in two blocks.
    fn image<T: Real>(columns: &Columns<T>) -> Vec<Complex<T>> {
        let mut image = vec![Complex::new(T::zero(), T::zero()); 120];
        let (upper, lower) = image.split_at_mut(84);
        for (top, block) in [(0, upper), (7, lower)] {
            columns.rows(&Transforms::new([12, 10]), top, block, &mut Vec::new());
        }
        image
    }

    #[test]
    fn two_waves_come_back_separately() {
        let band = Band::new([12, 10], [12, 10], 0.4);
        let place = |wanted: [i32; 2]| band.iter().position(|nu| nu == wanted).unwrap();
        let kernel = |waves: &[([i32; 2], Complex64)]| {
            let mut kernel = vec![Complex64::ZERO; band.len];
            for (nu, z) in waves {
                kernel[place(*nu)] = *z;
            }
            [Planar::<f32>::new(kernel.into_iter())]
        };
        let first = kernel(&[([0, 0], Complex64::ONE), ([2, 0], Complex64::new(0.25, 0.0))]);
        let second = kernel(&[([-3, 1], Complex64::new(0.0, -0.5))]);
        let ones = || vec![Complex64::ONE; band.len].into_iter();
        let (drive64, drive32) = ([Planar::new(ones())], [Planar::new(ones())]);
        let wide = image(&two_images::<f64>(&band, [&first, &second], &drive64, &Transforms::new([12, 10])));
        let narrow =
            image(&two_images::<f32>(&band, [&first, &second], &drive32, &Transforms::new([12, 10])));
        for y in 0..10 {
            for x in 0..12 {
                let (fx, fy) = (f64::from(x) / 12.0, f64::from(y) / 10.0);
                let at = (y * 12 + x) as usize;
                let exact = Complex64::new(1.0 + 0.5 * (TAU * 2.0 * fx).cos(), (TAU * (fy - 3.0 * fx)).sin());
                assert!((wide[at] - exact).norm() < 1e-12);
                assert!(
                    (narrow[at].re - exact.re as f32).abs() + (narrow[at].im - exact.im as f32).abs() < 1e-6
                );
            }
        }
    }

    /// Also where the frequencies go beyond what the pixels can tell apart, and with a picture larger than the period.
    #[test]
    fn the_spectrum_of_a_picture_is_the_sum_of_its_pixels() {
        for (size, period, samples, cycles) in [
            ([3, 2], [8, 6], [40, 40], 1.7),
            ([5, 7], [9, 15], [8, 8], 0.3),
            ([30, 3], [8, 6], [16, 16], 0.4),
            ([3, 2], [2000, 1500], [60, 60], 0.01),
        ] {
            let light: Vec<f64> = (0..size[0] * size[1]).map(|i| ((i * 7919) % 13) as f64).collect();
            let band = Band::new(period, samples, cycles);
            assert!(band.len > 10);
            let wide = picture_spectrum::<f64>(&light, size, period, &band);
            let narrow = picture_spectrum::<f32>(&light, size, period, &band);
            let sums = direct_sums::<f64>(&light, size, period, &band);
            for (i, nu) in band.iter().enumerate() {
                let mut exact = Complex64::ZERO;
                for (at, value) in light.iter().enumerate() {
                    let (x, y) = ((at % size[0]) as f64, (at / size[0]) as f64);
                    let turns =
                        f64::from(nu[0]) * x / period[0] as f64 + f64::from(nu[1]) * y / period[1] as f64;
                    exact += Complex64::from_polar(*value, -TAU * turns);
                }
                let scale = light.iter().sum::<f64>();
                assert!((wide[i] - exact).norm() < 1e-12 * scale, "{nu:?}");
                assert!((sums[i] - exact).norm() < 1e-12 * scale, "{nu:?}");
                let narrow = Complex64::new(narrow[i].re.into(), narrow[i].im.into());
                assert!((narrow - exact).norm() < 1e-6 * scale, "{nu:?}");
            }
        }
    }
}
