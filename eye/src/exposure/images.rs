//! Real images from their spectra: two from one complex inverse transform, at the samples that cones read.
//!
//! The transform along y is made of a few columns of all images at a time, the one along x of a row of all images at a time.

use std::cmp::Ordering;
use std::ops::Range;
use std::sync::Arc;

use multiversion::multiversion;
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::basis::BasisTable;
use super::grid::{Band, Planar, Real, Run};

/// Frequencies along x, of either sign, whose columns are transformed together: a cache line of a row holds so many numbers.
const TOGETHER: usize = 8;
/// Rows that are transformed together.
const ROWS: usize = 32;

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

/// Most images of a sheet.
pub const SHEET: usize = 16;

/// Some images side by side at the samples that cones read, four and four, filled up with images of 0.
pub struct Sheet<T: Real> {
    /// Fours of images, up to [`SHEET`]/4.
    pub fours: usize,
    /// By row of the span: `[column of the span][four]`; columns behind the last are 0.
    pub rows: Vec<Vec<T::Four>>,
}

/// Fours of images of a sheet that begins at one of so many.
pub fn fours(images: usize, first: usize) -> usize {
    (images - first).min(SHEET).div_ceil(4)
}

/// The images of a `basis` of what is sent (`drive[primary][frequency]`), at the columns and rows of two spans; reading may go on for
/// `beyond` columns behind the last.
pub fn sheets<T: Real>(
    (band, basis): (&Band, &BasisTable),
    drive: &[Planar<T>],
    transforms: &Transforms<T>,
    [across, down]: &[Span; 2],
    beyond: usize,
) -> Vec<Sheet<T>> {
    let zero = Complex::new(T::zero(), T::zero());
    let [columns, rows] = transforms.samples;
    let (pairs, most) = (basis.images.div_ceil(2), band.most()[0]);
    let starts: Vec<usize> = (0..=most).step_by(TOGETHER).collect();
    let workspace = || {
        let batch = vec![zero; 2 * TOGETHER * rows * pairs];
        ([Planar::zeros(rows), Planar::zeros(rows)], batch, Vec::new())
    };
    let of_batch = |(sums, batch, scratch): &mut (_, Vec<_>, _), &from: &usize| {
        let count = TOGETHER.min(most + 1 - from);
        let inside = |run: &&Run| (from..from + count).contains(&(run.x.unsigned_abs() as usize));
        for run in band.runs.iter().filter(inside) {
            columns_of_run(basis, drive, run, (sums, batch, rows));
        }
        transforms.process(1, batch, scratch);
        batch_by_row(batch, down)
    };
    let batches: Vec<Vec<Complex<T>>> = starts.par_iter().map_init(workspace, of_batch).collect();
    let down = down.distinct();
    let of_rows = |first: usize, block: usize| {
        let places = block * ROWS..down.min((block + 1) * ROWS);
        let pairs = first / 2..pairs.min(first / 2 + SHEET / 2);
        let size = columns * pairs.len();
        let mut lines = vec![zero; size * places.len()];
        for (batch, &from) in batches.iter().zip(&starts) {
            for (at, pair) in pairs.clone().enumerate() {
                for (row, place) in lines.chunks_exact_mut(size).zip(places.clone()) {
                    let sides = &batch[(pair * down + place) * 2 * TOGETHER..][..2 * TOGETHER];
                    put_into_line(sides, from, most, &mut row[at * columns..][..columns]);
                }
            }
        }
        transforms.process(0, &mut lines, &mut Vec::new());
        let row = |lines: &[Complex<T>]| side_by_side(lines, across, columns, beyond);
        lines.chunks_exact(size).map(row).collect::<Vec<_>>()
    };
    let of_sheet = |first: usize| Sheet {
        fours: fours(basis.images, first),
        rows: (0..down.div_ceil(ROWS)).into_par_iter().flat_map_iter(|block| of_rows(first, block)).collect(),
    };
    (0..basis.images).step_by(SHEET).map(of_sheet).collect()
}

/// Lines `[pair of images][column]` as `[column of the span][four]`.
fn side_by_side<T: Real>(lines: &[Complex<T>], across: &Span, columns: usize, beyond: usize) -> Vec<T::Four> {
    let fours = lines.len().div_ceil(2 * columns);
    let mut row = vec![T::Four::default(); (across.len + beyond) * fours];
    let none = vec![Complex::new(T::zero(), T::zero()); columns];
    for (four, pairs) in lines.chunks(2 * columns).enumerate() {
        let (first, second) = pairs.split_at(columns);
        let second = if second.is_empty() { &none } else { second };
        let mut places = row.chunks_exact_mut(fours);
        for range in across.ranges() {
            for ((a, b), place) in first[range.clone()].iter().zip(&second[range]).zip(&mut places) {
                place[four] = T::four([a.re, a.im, b.re, b.im]);
            }
        }
    }
    row
}

/// Columns of a batch `[pair][+x, -x][row]` as `[pair][row of the span][+x upwards, -x upwards]`.
fn batch_by_row<T: Real>(batch: &[Complex<T>], down: &Span) -> Vec<Complex<T>> {
    let rows = down.period;
    let size = down.distinct() * 2 * TOGETHER;
    let mut by_row = vec![Complex::new(T::zero(), T::zero()); batch.len() / rows * down.distinct()];
    for (sides, by_row) in batch.chunks_exact(2 * TOGETHER * rows).zip(by_row.chunks_exact_mut(size.max(1))) {
        for (k, line) in sides.chunks_exact(rows).enumerate() {
            let at = if k < TOGETHER { k } else { 3 * TOGETHER - 1 - k };
            let mut places = by_row.as_chunks_mut::<{ 2 * TOGETHER }>().0.iter_mut();
            for range in down.ranges() {
                for (z, place) in line[range].iter().zip(&mut places) {
                    place[at] = *z;
                }
            }
        }
    }
    by_row
}

/// Puts the two sides of a batch that begins `from` a frequency, of which there are `most`, into a line of all frequencies.
fn put_into_line<T: Real>(sides: &[Complex<T>], from: usize, most: usize, line: &mut [Complex<T>]) {
    let (plus, minus) = sides.split_at(TOGETHER);
    let columns = line.len();
    // Nearly all are whole: copies of a length that the compiler knows.
    if from > 0 && from + TOGETHER <= most + 1 {
        line[from..from + TOGETHER].copy_from_slice(&plus[..TOGETHER]);
        line[columns + 1 - from - TOGETHER..][..TOGETHER].copy_from_slice(&minus[..TOGETHER]);
        return;
    }
    let count = TOGETHER.min(most + 1 - from);
    line[from..from + count].copy_from_slice(&plus[..count]);
    // Frequency 0 has no negative.
    let minus = &minus[TOGETHER - count..TOGETHER - usize::from(from == 0)];
    line[columns + 1 - from - count..][..minus.len()].copy_from_slice(minus);
}

/// Puts the sums of kernels times what is sent on a run, for all images, into the run's columns of a batch `[pair][+x, -x][row]` and into those of the
/// negative frequencies.
#[multiversion(targets("x86_64+avx2"))]
fn columns_of_run<T: Real>(
    basis: &BasisTable,
    drive: &[Planar<T>],
    run: &Run,
    ([a, b], batch, rows): (&mut [Planar<T>; 2], &mut [Complex<T>], usize),
) {
    let zero = Complex::new(T::zero(), T::zero());
    let at = run.x.unsigned_abs() as usize % TOGETHER;
    // Between the frequencies of either sign.
    let gap = run.y as usize + run.len..rows + 1 - run.y as usize - run.len;
    for (pair, sides) in batch.chunks_exact_mut(2 * TOGETHER * rows).enumerate() {
        sum_of_products(basis, 2 * pair, drive, run, a);
        sum_of_products(basis, 2 * pair + 1, drive, run, b);
        let (plus, minus) = sides.split_at_mut(TOGETHER * rows);
        let (right, left) = (&mut plus[at * rows..][..rows], &mut minus[at * rows..][..rows]);
        if run.x >= 0 {
            right[gap.clone()].fill(zero);
            left[gap.clone()].fill(zero);
        }
        match run.x.cmp(&0) {
            Ordering::Greater => put(run, [a, b], right, Some(left)),
            Ordering::Less => put(run, [a, b], left, Some(right)),
            // Both are one column.
            Ordering::Equal => put(run, [a, b], right, None),
        }
    }
}

/// Puts a + i·b of a run into its column and conj(a) + i·conj(b) at the negative frequencies into the other one (the same where there is
/// none); of the mean only the former stays.
#[inline(always)]
#[allow(clippy::inline_always)] // in the caller's vector code only when inlined
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

/// Σ over primaries of an image's kernel times drive on a run of frequencies, in the first places of `sums`; 0 for an image that is not there.
#[inline(always)]
#[allow(clippy::inline_always)] // in the caller's vector code only when inlined
fn sum_of_products<T: Real>(
    basis: &BasisTable,
    image: usize,
    drive: &[Planar<T>],
    run: &Run,
    sums: &mut Planar<T>,
) {
    let (re, im) = (&mut sums.re[..run.len], &mut sums.im[..run.len]);
    re.fill(T::zero());
    im.fill(T::zero());
    if image >= basis.images {
        return;
    }
    for (primary, sent) in drive.iter().enumerate() {
        let (k_re, k_im) = basis.of(run, image, primary);
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

    /// Images on a grid of 12 x 10 at all columns and the rows of a span.
    fn made<T: Real>(band: &Band, kernels: &[&Vec<Complex64>], down: Span) -> Vec<Sheet<T>> {
        let kernels: Vec<Vec<Vec<Complex64>>> =
            kernels.iter().map(|kernel| vec![(*kernel).clone()]).collect();
        let basis = BasisTable::for_test(&kernels, band);
        let drive = [Planar::new(vec![Complex64::ONE; band.len].into_iter())];
        let across = Span { start: 0, len: 12, period: 12 };
        sheets((band, &basis), &drive, &Transforms::new([12, 10]), &[across, down], 1)
    }

    #[test]
    fn waves_come_back_separately() {
        let band = Band::new([12, 10], [12, 10], 0.4);
        let place = |wanted: [i32; 2]| band.iter().position(|nu| nu == wanted).unwrap();
        let kernel = |waves: &[([i32; 2], Complex64)]| {
            let mut kernel = vec![Complex64::ZERO; band.len];
            for (nu, z) in waves {
                kernel[place(*nu)] = *z;
            }
            kernel
        };
        let first = kernel(&[([0, 0], Complex64::ONE), ([2, 0], Complex64::new(0.25, 0.0))]);
        let second = kernel(&[([-3, 1], Complex64::new(0.0, -0.5)), ([0, 2], Complex64::new(0.125, 0.0))]);
        // On three sheets, the last one with one image.
        let many: Vec<_> = (0..33).map(|i| if i % 2 == 0 { &first } else { &second }).collect();
        for span in [Span { start: 0, len: 12, period: 10 }, Span { start: 7, len: 6, period: 10 }] {
            let wide = made::<f64>(&band, &many, span);
            let narrow = made::<f32>(&band, &many[..2], span);
            assert_eq!(wide.iter().map(|sheet| sheet.fours).collect::<Vec<_>>(), [4, 4, 1]);
            for place in 0..span.distinct() {
                for x in 0..12 {
                    let (fx, fy) = (x as f64 / 12.0, ((span.start + place) % 10) as f64 / 10.0);
                    let one = 1.0 + 0.5 * (TAU * 2.0 * fx).cos();
                    let two = (TAU * (fy - 3.0 * fx)).sin() + 0.25 * (TAU * 2.0 * fy).cos();
                    for image in 0..36 {
                        let exact = [one, two, 0.0][if image > 32 { 2 } else { image % 2 }];
                        let (sheet, at) = (&wide[image / SHEET], image % SHEET);
                        let four = sheet.rows[place][x * sheet.fours + at / 4].to_array();
                        assert!((four[at % 4] - exact).abs() < 1e-12);
                    }
                    let four = narrow[0].rows[place][x].to_array();
                    let off = |image: usize, exact: f64| (four[image] - exact as f32).abs();
                    assert!(off(0, one) + off(1, two) + off(2, 0.0) < 1e-6);
                }
            }
        }
    }

    #[test]
    fn spans_hold_runs_without_a_break() {
        let span = Span::new(10, [(8, 4), (0, 3), (9, 1)].into_iter());
        assert_eq!(span, Span { start: 8, len: 5, period: 10 });
        assert_eq!([8, 0, 2].map(|sample| span.place(sample)), [0, 2, 4]);
        // Everything is used: a run that goes around the end finds its samples behind it.
        let whole = Span::new(10, [(0, 6), (6, 4), (7, 5)].into_iter());
        assert_eq!((whole.len, whole.distinct()), (12, 10));
        for span in [span, whole] {
            let ranges: Vec<usize> = span.ranges().flatten().collect();
            let samples = (0..span.len).map(|place| (span.start + place) % span.period);
            assert_eq!(ranges, samples.collect::<Vec<_>>());
        }
        assert_eq!(Span::new(10, std::iter::empty()).len, 0);
    }
}
