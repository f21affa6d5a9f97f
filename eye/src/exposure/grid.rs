//! The kept frequencies of the periodic grid, and numbers at them.

use std::ops::{Add, AddAssign, Mul, Range};
use std::sync::OnceLock;

use glam::{DVec4, Vec4};
use multiversion::multiversion;
use rustfft::FftNum;
use rustfft::num_complex::Complex;

/// The precision of a transform.
pub trait Real: FftNum {
    /// Four numbers side by side.
    type Four: Copy
        + Default
        + Send
        + Sync
        + AddAssign
        + Add<Output = Self::Four>
        + Mul<Self, Output = Self::Four>;
    /// Four numbers.
    fn four(values: [Self; 4]) -> Self::Four;
    /// The same in double precision.
    fn wide_four(values: Self::Four) -> [f64; 4];
    /// Which of two places is for numbers of this precision.
    fn kept<'a>(
        single: &'a OnceLock<Vec<Complex<f32>>>,
        double: &'a OnceLock<Vec<Complex<f64>>>,
    ) -> &'a OnceLock<Vec<Complex<Self>>>;
    /// From double precision.
    fn narrow(value: f64) -> Self;
    /// From single precision.
    fn of(value: f32) -> Self;
    /// To double precision.
    fn wide(self) -> f64;
}

impl Real for f32 {
    type Four = Vec4;
    #[inline]
    fn four(values: [Self; 4]) -> Vec4 {
        Vec4::from_array(values)
    }
    #[inline]
    fn wide_four(values: Vec4) -> [f64; 4] {
        values.as_dvec4().to_array()
    }
    fn kept<'a>(
        single: &'a OnceLock<Vec<Complex<f32>>>,
        _: &'a OnceLock<Vec<Complex<f64>>>,
    ) -> &'a OnceLock<Vec<Complex<Self>>> {
        single
    }
    #[inline]
    fn narrow(value: f64) -> Self {
        value as Self
    }
    #[inline]
    fn of(value: f32) -> Self {
        value
    }
    #[inline]
    fn wide(self) -> f64 {
        self.into()
    }
}

impl Real for f64 {
    type Four = DVec4;
    #[inline]
    fn four(values: [Self; 4]) -> DVec4 {
        DVec4::from_array(values)
    }
    #[inline]
    fn wide_four(values: DVec4) -> [f64; 4] {
        values.to_array()
    }
    fn kept<'a>(
        _: &'a OnceLock<Vec<Complex<f32>>>,
        double: &'a OnceLock<Vec<Complex<f64>>>,
    ) -> &'a OnceLock<Vec<Complex<Self>>> {
        double
    }
    #[inline]
    fn narrow(value: f64) -> Self {
        value
    }
    #[inline]
    fn of(value: f32) -> Self {
        Self::from(value)
    }
    #[inline]
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
    pub fn range(&self) -> Range<usize> {
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
            let inside = |y: &i32| {
                let (along_x, along_y) = (f64::from(x) / px, f64::from(*y) / py);
                along_x * along_x + along_y * along_y <= cycles_per_px * cycles_per_px
            };
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

    /// One number.
    #[inline]
    pub fn at(&self, place: usize) -> Complex<T> {
        Complex::new(self.re[place], self.im[place])
    }

    /// Real and imaginary parts of some.
    pub fn of(&self, places: Range<usize>) -> (&[T], &[T]) {
        (&self.re[places.clone()], &self.im[places])
    }

    /// From numbers.
    pub fn new(values: impl Iterator<Item = Complex<f64>>) -> Self {
        let (re, im) = values.map(|z| (T::narrow(z.re), T::narrow(z.im))).unzip();
        Self { re, im }
    }
}

/// Sums that are kept side by side.
const LANES: usize = 8;

/// Sum of products, in a fixed order.
#[multiversion(targets("x86_64+avx2"))]
pub fn dot<T: Real>(weights: &[f32], values: &[T]) -> f64 {
    let mut sums = [0.0; LANES];
    let ((weights, rest), (values, values_rest)) =
        (weights.as_chunks::<LANES>(), values.as_chunks::<LANES>());
    for (weights, values) in weights.iter().zip(values) {
        for lane in 0..LANES {
            sums[lane] += f64::from(weights[lane]) * values[lane].wide();
        }
    }
    for ((sum, weight), value) in sums.iter_mut().zip(rest).zip(values_rest) {
        *sum += f64::from(*weight) * value.wide();
    }
    sums.iter().sum()
}
