//! Real images from their spectra: two from one complex inverse transform, in the rows of the grid that cones lie in.
//!
//! The transform along y is made of a few columns at a time, which are put down row by row while they are at hand; the one along x is left to
//! the reader of the rows.

use std::cmp::Ordering;
use std::ops::Range;
use std::sync::Arc;

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::grid::{Band, Planar, Real, Run};

/// Frequencies along x, of either sign, whose columns are transformed together: a cache line of a row holds so many numbers.
const TOGETHER: usize = 8;

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

    /// Transforms lines along an axis in place.
    pub fn process(&self, axis: usize, lines: &mut [Complex<T>], scratch: &mut Vec<Complex<T>>) {
        let zero = Complex::new(T::zero(), T::zero());
        scratch.resize(self.along[axis].get_inplace_scratch_len(), zero);
        self.along[axis].process_with_scratch(lines, scratch);
    }
}

/// The part of a periodic axis that is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Its first sample.
    pub start: usize,
    /// Samples from there on; more than the period's when the first ones are there again at the end.
    pub len: usize,
    /// Samples in a period.
    pub period: usize,
}

impl Span {
    /// The shortest span that holds runs of samples (first, length), each shorter than a period, as they are.
    pub fn new(period: usize, runs: impl Iterator<Item = (usize, usize)> + Clone) -> Self {
        let mut used = vec![false; period];
        for (first, len) in runs.clone() {
            (first..first + len).for_each(|sample| used[sample % period] = true);
        }
        // It begins behind the longest gap.
        let (mut longest, mut gap, mut start) = (0, 0, 0);
        for sample in 0..2 * period {
            gap = if used[sample % period] { 0 } else { (gap + 1).min(period) };
            if gap > longest {
                (longest, start) = (gap, (sample + 1) % period);
            }
        }
        let span = Self { start, len: 0, period };
        let len = runs.map(|(first, len)| span.place(first) + len).max().unwrap_or(0);
        Self { len, ..span }
    }

    /// Place in the span of a sample.
    pub fn place(&self, sample: usize) -> usize {
        (sample + self.period - self.start) % self.period
    }

    /// Sample at a place of the span.
    pub fn sample(&self, place: usize) -> usize {
        (self.start + place) % self.period
    }

    /// The samples in order, as ranges that do not go around the end.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let Self { start, len, period } = *self;
        let first = len.min(period - start);
        let rest = move |from: usize| 0..(len - from).min(period);
        let second = rest(first);
        let third = rest(first + second.len());
        [start..start + first, second, third].into_iter()
    }

    /// Samples of the span, each once.
    pub fn distinct(&self) -> usize {
        self.len.min(self.period)
    }
}

/// The sums over primaries of kernels times what is sent (`drive[primary][frequency]`), for two images as one complex one, transformed
/// along y only: the rows of a span, `[row][x]`. The second image may have no kernels: it is 0.
pub fn two_images<T: Real>(
    band: &Band,
    [first, second]: [&[Planar<f32>]; 2],
    drive: &[Planar<T>],
    transforms: &Transforms<T>,
    span: &Span,
) -> Vec<Complex<T>> {
    let [columns, rows] = transforms.samples;
    let zero = Complex::new(T::zero(), T::zero());
    let mut image = vec![zero; columns * span.distinct()];
    let most = band.most()[0];
    let mut scratch = Vec::new();
    let (mut a, mut b) = (Planar::<T>::zeros(rows), Planar::<T>::zeros(rows));
    // Columns x and -x of some frequencies: a frequency and its negative stand in both.
    let mut batch = vec![zero; 2 * TOGETHER * rows];
    for from in (0..=most).step_by(TOGETHER) {
        let count = TOGETHER.min(most + 1 - from);
        let batch = &mut batch[..2 * count * rows];
        batch.fill(zero);
        let (plus, minus) = batch.split_at_mut(count * rows);
        for run in
            band.runs.iter().filter(|run| (from..from + count).contains(&(run.x.unsigned_abs() as usize)))
        {
            sum_of_products(first, drive, run, &mut a);
            sum_of_products(second, drive, run, &mut b);
            let at = run.x.unsigned_abs() as usize - from;
            let (right, left) = (&mut plus[at * rows..][..rows], &mut minus[at * rows..][..rows]);
            match run.x.cmp(&0) {
                Ordering::Greater => put(run, [&a, &b], right, Some(left)),
                Ordering::Less => put(run, [&a, &b], left, Some(right)),
                // Both are one column.
                Ordering::Equal => put(run, [&a, &b], right, None),
            }
        }
        transforms.process(1, batch, &mut scratch);
        let (plus, minus) = batch.split_at(count * rows);
        for place in 0..span.distinct() {
            let y = span.sample(place);
            let row = &mut image[place * columns..][..columns];
            for (z, line) in row[from..from + count].iter_mut().zip(plus.chunks_exact(rows)) {
                *z = line[y];
            }
            for (at, line) in minus.chunks_exact(rows).enumerate().skip(usize::from(from == 0)) {
                row[columns - from - at] = line[y];
            }
        }
    }
    image
}

/// Puts a + i·b of a run into its column and conj(a) + i·conj(b) at the negative frequencies into the other one (the same where there is
/// none); of the mean only the former stays.
fn put<T: Real>(
    run: &Run,
    [a, b]: [&Planar<T>; 2],
    own: &mut [Complex<T>],
    other: Option<&mut [Complex<T>]>,
) {
    let (rows, from) = (own.len(), run.y as usize);
    let parts = |skip: usize| {
        let (a_re, a_im) = (&a.re[skip..run.len], &a.im[skip..run.len]);
        let (b_re, b_im) = (&b.re[skip..run.len], &b.im[skip..run.len]);
        a_re.iter().zip(a_im).zip(b_re.iter().zip(b_im))
    };
    for (z, ((a_re, a_im), (b_re, b_im))) in own[from..from + run.len].iter_mut().zip(parts(0)) {
        *z = Complex::new(*a_re - *b_im, *a_im + *b_re);
    }
    let alone = other.is_none();
    let other = other.unwrap_or(own);
    let skip = usize::from(from == 0);
    if skip == 1 && !alone {
        other[0] = Complex::new(a.re[0] + b.im[0], b.re[0] - a.im[0]);
    }
    let mirrored = other[rows + 1 - from - run.len..=rows - from - skip].iter_mut().rev();
    for (z, ((a_re, a_im), (b_re, b_im))) in mirrored.zip(parts(skip)) {
        *z = Complex::new(*a_re + *b_im, *b_re - *a_im);
    }
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

    /// Rows of a span of a grid of 12 x 10, both ways transformed.
    fn image<T: Real>(
        band: &Band,
        kernels: [&[Planar<f32>]; 2],
        drive: &[Planar<T>],
        span: &Span,
    ) -> Vec<Complex<T>> {
        let transforms = Transforms::new([12, 10]);
        let mut image = two_images(band, kernels, drive, &transforms, span);
        transforms.process(0, &mut image, &mut Vec::new());
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
        let second = kernel(&[([-3, 1], Complex64::new(0.0, -0.5)), ([0, 2], Complex64::new(0.125, 0.0))]);
        let ones = || vec![Complex64::ONE; band.len].into_iter();
        let (drive64, drive32) = ([Planar::new(ones())], [Planar::new(ones())]);
        for span in [Span { start: 0, len: 12, period: 10 }, Span { start: 7, len: 6, period: 10 }] {
            let wide = image::<f64>(&band, [&first, &second], &drive64, &span);
            let narrow = image::<f32>(&band, [&first, &second], &drive32, &span);
            let alone = image::<f64>(&band, [&first, &[]], &drive64, &span);
            for place in 0..span.distinct() {
                for x in 0..12 {
                    let (fx, fy) = (x as f64 / 12.0, span.sample(place) as f64 / 10.0);
                    let at = place * 12 + x;
                    let one = 1.0 + 0.5 * (TAU * 2.0 * fx).cos();
                    let two = (TAU * (fy - 3.0 * fx)).sin() + 0.25 * (TAU * 2.0 * fy).cos();
                    let exact = Complex64::new(one, two);
                    assert!((wide[at] - exact).norm() < 1e-12);
                    assert!((alone[at] - one).norm() < 1e-12);
                    let off = (narrow[at].re - one as f32).abs() + (narrow[at].im - two as f32).abs();
                    assert!(off < 1e-6);
                }
            }
        }
    }

    #[test]
    fn spans_hold_runs_without_a_break() {
        let span = Span::new(10, [(8, 4), (0, 3), (9, 1)].into_iter());
        assert_eq!(span, Span { start: 8, len: 5, period: 10 });
        assert_eq!([8, 0, 2].map(|sample| span.place(sample)), [0, 2, 4]);
        assert_eq!([0, 2, 4].map(|place| span.sample(place)), [8, 0, 2]);
        // Everything is used: a run that goes around the end finds its samples behind it.
        let whole = Span::new(10, [(0, 6), (6, 4), (7, 5)].into_iter());
        assert_eq!((whole.len, whole.distinct()), (12, 10));
        for span in [span, whole] {
            let ranges: Vec<usize> = span.ranges().flatten().collect();
            assert_eq!(ranges, (0..span.len).map(|place| span.sample(place)).collect::<Vec<_>>());
        }
        assert_eq!(Span::new(10, std::iter::empty()).len, 0);
    }
}
