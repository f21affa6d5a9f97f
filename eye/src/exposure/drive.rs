//! What the display sends in a frame, before the eye, at the kept frequencies: `N_k Â_k(ν) R_k(ν) D_k(ν)` of each primary.
//!
//! The transform of a straight movement at (ν_x, ν_y) needs sines of sums of a number that hangs on ν_x only and one that hangs on
//! ν_y only: they are made from tables along each axis.

use std::f64::consts::{PI, TAU};

use multiversion::multiversion;
use rayon::prelude::*;
use rustfft::num_complex::{Complex, Complex64};

use super::grid::{Band, Planar, Real, Run};
use super::light::Segment;
use super::picture_spectrum::PictureSpectrum;
use super::scene::Scene;
use super::source::{Layer, Source};

/// `[primary][frequency]`: what the display sends; `pixels[primary][frequency]` is the transform of a pixel, `pictures` makes those of
/// their light.
pub fn drive<T: Real>(
    source: &Source,
    pixels: &[Vec<Complex64>],
    pictures: &PictureSpectrum,
    (scene, band): (&Scene, &Band),
) -> Vec<Planar<T>> {
    // Primaries that shine at the same time share their movement.
    let mut moved: Vec<(&[Segment], Planar<f64>)> = Vec::new();
    for layer in source.primaries.iter().flat_map(|p| &p.layers) {
        if !layer.is_at_rest() && moved.iter().all(|(segments, _)| *segments != layer.segments) {
            moved.push((&layer.segments, movement(&layer.segments, scene, band)));
        }
    }
    let add_layer = |layer: &Layer, pixel: &[Complex64], sent: &mut Planar<T>| {
        let light = layer.light.spectrum(|light| pictures.of::<T>(light, band));
        let movement = moved.iter().find(|(segments, _)| *segments == layer.segments);
        match movement {
            Some((_, movement)) => {
                let factors = pixel.iter().enumerate().map(|(i, pixel)| pixel * movement.at(i));
                add(sent, light, factors, layer.photons);
            }
            None => add(sent, light, pixel.iter().copied(), layer.photons),
        }
    };
    let of_primary = |(primary, pixel): (&super::source::SourcePrimary, &Vec<Complex64>)| {
        let mut sent = Planar::zeros(band.len);
        primary.layers.iter().for_each(|layer| add_layer(layer, pixel, &mut sent));
        sent
    };
    source.primaries.par_iter().zip(pixels).map(of_primary).collect()
}

/// Adds a layer's light times factors, times its photons.
#[multiversion(targets("x86_64+avx2"))]
fn add<T: Real>(
    sent: &mut Planar<T>,
    light: &[Complex<T>],
    factors: impl Iterator<Item = Complex64>,
    photons: f64,
) {
    for (((light, factor), to_re), to_im) in light.iter().zip(factors).zip(&mut sent.re).zip(&mut sent.im) {
        let (re, im) = (T::narrow(photons * factor.re), T::narrow(photons * factor.im));
        *to_re = *to_re + (light.re * re - light.im * im);
        *to_im = *to_im + (light.re * im + light.im * re);
    }
}

/// Segments whose tables are made together.
const TOGETHER: usize = 64;

/// Transform of a movement at every kept frequency, as [`super::light::movement`] has it at one.
fn movement(segments: &[Segment], scene: &Scene, band: &Band) -> Planar<f64> {
    let mut sums: Vec<Planar<f64>> = band.runs.iter().map(|run| Planar::zeros(run.len)).collect();
    for segments in segments.chunks(TOGETHER) {
        let straights: Vec<Straight> = segments.iter().map(|s| Straight::new(s, scene, band)).collect();
        sums.par_iter_mut().zip(&band.runs).for_each(|(sum, run)| {
            for straight in &straights {
                if straight.falls() { straight.add_falling(run, sum) } else { straight.add_even(run, sum) }
            }
        });
    }
    let (re, im): (Vec<_>, Vec<_>) = sums.into_iter().map(|sum| (sum.re, sum.im)).unzip();
    Planar { re: re.concat(), im: im.concat() }
}

/// Tables of one straight movement.
struct Straight {
    share: f64,
    decay: f64,
    /// By |cycles| along x and by cycles along y, in a period.
    axes: [Axis; 2],
}

/// What a movement along one axis gives at each frequency.
struct Axis {
    /// Turns of half the path, radians.
    half: Vec<f64>,
    /// e^{i·half}.
    turn: Planar<f64>,
    /// e^{2πi} of the path's middle.
    middle: Planar<f64>,
}

impl Axis {
    fn new(middle: f64, length: f64, period_px: usize, most: usize) -> Self {
        let cycles = |n: usize| n as f64 / period_px as f64;
        let half = |n: usize| PI * cycles(n) * length;
        Self {
            half: (0..=most).map(half).collect(),
            turn: Planar::new((0..=most).map(|n| Complex64::cis(half(n)))),
            middle: Planar::new((0..=most).map(|n| Complex64::cis(TAU * cycles(n) * middle))),
        }
    }

    /// At a frequency of either sign.
    fn at(&self, cycles: i32) -> (f64, Complex64, Complex64) {
        let n = cycles.unsigned_abs() as usize;
        let (half, turn, middle) = (self.half[n], self.turn.at(n), self.middle.at(n));
        if cycles < 0 { (-half, turn.conj(), middle.conj()) } else { (half, turn, middle) }
    }
}

impl Straight {
    fn new(segment: &Segment, scene: &Scene, band: &Band) -> Self {
        let [from, to] = segment.sight;
        let (middle, length) = (0.5 * (from + to), to - from);
        let axis = |a: usize| Axis::new(middle[a], length[a], scene.period_px[a], band.most()[a]);
        Self { share: segment.share, decay: segment.decay, axes: [0, 1].map(axis) }
    }

    /// Whether its light falls on the way.
    fn falls(&self) -> bool {
        self.decay >= 1e-9
    }

    /// Adds the transform of even light at a run of frequencies: `share·e^{2πiν·middle}·sin(half)/half`.
    fn add_even(&self, run: &Run, sum: &mut Planar<f64>) {
        let of_x = self.axes[0].at(run.x);
        let Axis { half, turn, middle } = &self.axes[1];
        let places = run.y as usize..run.y as usize + run.len;
        let half = &half[places.clone()];
        add_sincs(self.share, of_x, half, turn.of(places.clone()), middle.of(places), sum);
    }

    /// Adds the transform of light e^{-λx} at a run of frequencies: its centre is not the path's, but the integral is as short.
    fn add_falling(&self, run: &Run, sum: &mut Planar<f64>) {
        let (half_x, turn_x, middle_x) = self.axes[0].at(run.x);
        let scale = self.share * self.decay / -(-self.decay).exp_m1();
        for i in 0..run.len {
            let (half_y, turn_y, middle_y) = self.axes[1].at(run.y + i as i32);
            // ∫ e^{-λx} e^{2πi ν·s(x)} dx = e^{2πi ν·s(0)} (e^z - 1)/z with z = -λ + 2i·half.
            let z = Complex64::new(-self.decay, 2.0 * (half_x + half_y));
            let turn = turn_x * turn_y;
            let mean = if z.norm_sqr() < 1e-6 {
                1.0 + z * (0.5 + z * (1.0 / 6.0 + z / 24.0))
            } else {
                (turn * turn * (-self.decay).exp() - 1.0) / z
            };
            let value = middle_x * middle_y * turn.conj() * (scale * mean);
            sum.re[i] += value.re;
            sum.im[i] += value.im;
        }
    }
}

/// Adds `share·m·sin(h)/h`, m the product of middles and h the sum of halves, e^{ih} the product of turns, of a number along x and those along y.
#[multiversion(targets("x86_64+avx2"))]
fn add_sincs(
    share: f64,
    (half_x, turn_x, middle_x): (f64, Complex64, Complex64),
    half: &[f64],
    (turn_re, turn_im): (&[f64], &[f64]),
    (middle_re, middle_im): (&[f64], &[f64]),
    sum: &mut Planar<f64>,
) {
    let len = half.len();
    let (turn_re, turn_im) = (&turn_re[..len], &turn_im[..len]);
    let (middle_re, middle_im) = (&middle_re[..len], &middle_im[..len]);
    let (re, im) = (&mut sum.re[..len], &mut sum.im[..len]);
    for i in 0..len {
        let h = half_x + half[i];
        let sine = turn_x.re * turn_im[i] + turn_x.im * turn_re[i];
        let small = h.abs() < 3e-4;
        let sinc = share * if small { 1.0 - h * h / 6.0 } else { sine / h };
        re[i] += sinc * (middle_x.re * middle_re[i] - middle_x.im * middle_im[i]);
        im[i] += sinc * (middle_x.re * middle_im[i] + middle_x.im * middle_re[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exposure::light;
    use glam::DVec2;

    /// The tables against the closed form at one frequency.
    #[test]
    fn tables_give_the_transform_of_a_movement() {
        let scene = Scene::for_test([40, 30], [80, 64]);
        let band = Band::new(scene.period_px, scene.samples, 0.9);
        let sight = [DVec2::new(0.2, -0.1), DVec2::new(3.0, 0.7)];
        let segments: Vec<Segment> = [0.0, 1e-7, 1e-3, 0.4, 5.0, 60.0]
            .into_iter()
            .map(|decay| Segment { share: 0.3, decay, sight })
            .chain([Segment { share: 0.2, decay: 0.0, sight: [DVec2::splat(1e-9); 2] }])
            .collect();
        let made = movement(&segments, &scene, &band);
        for (i, [x, y]) in band.iter().enumerate() {
            let cycles = DVec2::new(f64::from(x) / 40.0, f64::from(y) / 30.0);
            let exact = light::movement(&segments, cycles);
            assert!((made.at(i) - exact).norm() < 1e-9, "{cycles}: {} {exact}", made.at(i));
        }
    }
}
