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
    let mut moved: Vec<(&[Segment], Vec<Complex64>)> = Vec::new();
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
                let factors = pixel.iter().zip(movement).map(|(pixel, movement)| pixel * movement);
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

/// Transform of a movement at every kept frequency, as [`super::light::movement`] has it at one.
fn movement(segments: &[Segment], scene: &Scene, band: &Band) -> Vec<Complex64> {
    let mut sum = vec![Complex64::ZERO; band.len];
    for segment in segments {
        let straight = Straight::new(segment, scene, band);
        for run in &band.runs {
            straight.add(run, &mut sum[run.range()]);
        }
    }
    sum
}

/// Tables of one straight movement.
struct Straight {
    share: f64,
    decay: f64,
    /// By |cycles| along x and by cycles along y, in a period: turns of half a path, their cosine and sine, and e^{2πi} of its middle.
    axes: [Vec<(f64, Complex64, Complex64)>; 2],
}

impl Straight {
    fn new(segment: &Segment, scene: &Scene, band: &Band) -> Self {
        let [from, to] = segment.sight;
        let (middle, length) = (0.5 * (from + to), to - from);
        let most = band.most();
        let axes = [0, 1].map(|axis| {
            let entry = |n: usize| {
                let cycles = n as f64 / scene.period_px[axis] as f64;
                let half = PI * cycles * length[axis];
                (half, Complex64::cis(half), Complex64::cis(TAU * cycles * middle[axis]))
            };
            (0..=most[axis]).map(entry).collect()
        });
        Self { share: segment.share, decay: segment.decay, axes }
    }

    /// Adds the transform at a run of frequencies.
    fn add(&self, run: &Run, sums: &mut [Complex64]) {
        let (mut half_x, mut turn_x, mut middle_x) = self.axes[0][run.x.unsigned_abs() as usize];
        if run.x < 0 {
            (half_x, turn_x, middle_x) = (-half_x, turn_x.conj(), middle_x.conj());
        }
        // A light e^{-λx} on a path: its centre is not the path's, but the integral is as short.
        let falls = self.decay >= 1e-9;
        let scale = if falls { self.decay / -(-self.decay).exp_m1() } else { 1.0 };
        for (sum, (half_y, turn_y, middle_y)) in sums.iter_mut().zip(&self.axes[1][run.y as usize..]) {
            let half = half_x + half_y;
            let middle = middle_x * middle_y;
            // e^{i·half}.
            let turn = turn_x * turn_y;
            *sum += self.share
                * if falls {
                    // ∫ e^{-λx} e^{2πi ν·s(x)} dx = e^{2πi ν·s(0)} (e^z - 1)/z with z = -λ + 2i·half.
                    let z = Complex64::new(-self.decay, 2.0 * half);
                    let mean = if z.norm_sqr() < 1e-6 {
                        1.0 + z * (0.5 + z * (1.0 / 6.0 + z / 24.0))
                    } else {
                        (turn * turn * (-self.decay).exp() - 1.0) / z
                    };
                    middle * turn.conj() * (scale * mean)
                } else {
                    middle * if half.abs() < 3e-4 { 1.0 - half * half / 6.0 } else { turn.im / half }
                };
        }
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
            assert!((made[i] - exact).norm() < 1e-9, "{cycles}: {} {exact}", made[i]);
        }
    }
}
