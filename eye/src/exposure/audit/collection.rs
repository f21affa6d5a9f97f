//! What one cone's place on the retina collects: for each primary the density, per µm² of retina, with which photons from a point of the
//! screen are counted at an offset ξ from the point's image.
//!
//! `k(ξ) = Σ_λ share(λ)·caught(λ)·PSF_λ(ξ − δ(λ))` by point spreads traced at the cone's own field point, at wavelengths of its own, sampled
//! 2.5 times as finely as their cutoff asks and read by six-point polynomials. Outside of the window a pupil with an edge spreads as
//! `c/|ξ|³`; c is what is missing from the whole, which is known.

use std::f64::consts::SQRT_2;

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::super::spectral::{Absorbers, Kind, Paths, paths_at};
use super::super::transfer::{FieldPoint, spot_radius_um, wavefront_options};
use crate::display::Emitter;
use crate::optics::Projection;
use crate::psf::{GridAxes, PsfGrid, Wavefront, WavefrontOptions, psf};

/// Window: at least so many µm each way, so many times the geometric spot and so many widths of the diffraction pattern.
const LEAST_UM: f64 = 36.0;
const SPOTS: f64 = 1.3;
const WIDTHS: f64 = 12.0;
/// Samples per sample that the cutoff asks, of a wavelength shorter than most.
const FINER: f64 = 2.5;
const SHORT: f64 = 0.15;
/// Most samples across the window.
const MOST_SAMPLES: usize = 768;
/// Points of a polynomial on either side.
const REACH: usize = 3;
/// Distance to the points beside at which the change of the centroid is taken, µm.
const STEP_UM: f64 = 50.0;
/// Wavelengths at which it is taken.
const DENSITIES: usize = 5;

/// What is the same for all cones.
pub struct Optics<'a> {
    /// Screen and eye.
    pub projection: &'a Projection,
    /// Media and pigments.
    pub absorbers: Absorbers,
    /// Wavelengths of the point spreads, nm.
    pub nodes_nm: Vec<f64>,
    /// Spacing, nm.
    pub step_nm: f64,
    /// Stiles-Crawford coefficient, base 10, 1/mm².
    pub rho10_per_mm2: f64,
}

/// The spread of one primary's light.
struct Spread {
    values: Vec<f64>,
    /// Density at distance r outside of the window, times r³.
    tail: f64,
    total: f64,
}

/// Products of the gaps between six samples.
const GAPS: [f64; 2 * REACH] = [-120.0, 24.0, -12.0, 12.0, -24.0, 120.0];

/// What a place on the retina collects: densities (1/µm²), or after [`Collection::over`] shares that an aperture counts.
pub struct Collection {
    /// Offset on the retina (µm along its tangents) from an offset on the screen (tangents).
    pub to_retina: DMat2,
    grid: PsfGrid,
    inside_um: f64,
    spreads: Vec<Spread>,
}

impl Collection {
    /// For cones of a kind at a place (µm) and visual eccentricity (degrees).
    ///
    /// # Errors
    /// When the place sees no screen or the pupil cannot be traced.
    pub fn new(
        optics: &Optics,
        emitters: &[Emitter],
        kind: Kind,
        um: DVec2,
        ecc_deg: f64,
    ) -> Result<Self, String> {
        let point = FieldPoint::new(optics.projection, um)?;
        let nodes = &optics.nodes_nm;
        let waves: Vec<Wavefront> =
            nodes.par_iter().map(|nm| optics.wavefront(&point, *nm)).collect::<Result<_, _>>()?;
        let densities = optics.densities(&point)?;
        let paths: Vec<Paths> = waves.iter().map(|w| Paths::new(w, &optics.absorbers.media)).collect();
        let grid = window(&waves);
        let to_tangents = point.chart_from_tangents().inverse();
        let images: Vec<Vec<f64>> = waves
            .par_iter()
            .zip(&densities)
            .map(|(w, density)| {
                // The window stands about the image at the reference wavelength; the spread of this one lies beside.
                let shift = to_tangents * (w.landing_um - point.landing_um);
                let scale = density * w.density_per_um2();
                psf(w, &PsfGrid { centre_um: -shift, ..grid }).into_iter().map(|v| v * scale).collect()
            })
            .collect();
        let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
        let spread = |emitter: &Emitter| {
            let mut weights = vec![0.0; nodes.len()];
            for p in &emitter.photons {
                let caught = optics.absorbers.caught_at(kind, p.nm, ecc_deg, paths_at(nodes, &paths, p.nm));
                hats(nodes, optics.step_nm, p.nm, |i, hat| weights[i] += hat * p.emitted * caught);
            }
            let emitted = emitter.emitted().max(f64::MIN_POSITIVE);
            let mut values = vec![0.0; grid.samples * grid.samples];
            let mut total = 0.0;
            for (((weight, image), w), density) in weights.iter().zip(&images).zip(&waves).zip(&densities) {
                let weight = weight / emitted;
                total += weight * density * w.throughput();
                values.iter_mut().zip(image).for_each(|(sum, v)| *sum += weight * v);
            }
            let inner = || REACH..grid.samples - REACH;
            let inside: f64 =
                inner().map(|i| inner().map(|j| values[i * grid.samples + j]).sum::<f64>()).sum();
            let missing = total - inside * grid.pitch_um().powi(2);
            // ∫ r⁻³ over the plane outside of a square of half side R is 4√2/R.
            Spread { values, tail: missing.max(0.0) * inside_um / (4.0 * SQRT_2), total }
        };
        let spreads = emitters.iter().map(spread).collect();
        Ok(Self { to_retina: point.frequency_map.inverse().transpose(), grid, inside_um, spreads })
    }

    /// Half of the window's side, µm.
    pub fn window_um(&self) -> f64 {
        self.inside_um
    }

    /// Shortest period in the spread, µm.
    pub fn period_um(&self) -> f64 {
        2.0 * FINER * self.grid.pitch_um()
    }

    /// Share of a primary's photons through the pupil that is counted, all offsets together.
    pub fn total(&self, primary: usize) -> f64 {
        self.spreads[primary].total
    }

    /// The same integrated over an aperture: points about its centre (µm) with areas (µm²).
    #[must_use]
    pub fn over(mut self, aperture: &[(DVec2, f64)]) -> Self {
        let (samples, pitch) = (self.grid.samples, self.grid.pitch_um());
        let most = aperture.iter().map(|(p, _)| p.abs().max_element()).fold(0.0, f64::max);
        let half = (most / pitch).ceil() as usize + REACH;
        let side = 2 * half + 1;
        // An offset has the same polynomials at every sample: one stencil for all points.
        let mut stencil = vec![0.0; side * side];
        for (point, area) in aperture {
            let along = [point.x, point.y].map(|um| {
                let place = um / pitch + half as f64;
                let first = (place.floor() as usize + 1 - REACH).min(side - 2 * REACH);
                (first, lagrange(place - first as f64))
            });
            for (di, wi) in along[0].1.iter().enumerate() {
                for (dj, wj) in along[1].1.iter().enumerate() {
                    stencil[(along[0].0 + di) * side + along[1].0 + dj] += area * wi * wj;
                }
            }
        }
        let area: f64 = aperture.iter().map(|a| a.1).sum();
        for spread in &mut self.spreads {
            let mut sums = vec![0.0; samples * samples];
            for i in half..samples.saturating_sub(half) {
                for (di, taps) in stencil.chunks_exact(side).enumerate() {
                    let row = &spread.values[(i + di - half) * samples..][..samples];
                    let line = &mut sums[i * samples..][half..samples - half];
                    for (j, sum) in line.iter_mut().enumerate() {
                        *sum += taps.iter().zip(&row[j..j + side]).map(|(t, v)| t * v).sum::<f64>();
                    }
                }
            }
            spread.values = sums;
            spread.tail *= area;
            spread.total *= area;
        }
        self.inside_um -= half as f64 * pitch;
        self
    }

    /// The density, or the share, at an offset (µm).
    pub fn at(&self, primary: usize, xi: DVec2) -> f64 {
        let spread = &self.spreads[primary];
        if xi.abs().max_element() > self.inside_um {
            return spread.tail / xi.length().powi(3);
        }
        let samples = self.grid.samples;
        let [(i, across), (j, down)] = [self.stencil(xi.x), self.stencil(xi.y)];
        let mut sum = 0.0;
        for (di, wi) in across.iter().enumerate() {
            let row = &spread.values[(i + di) * samples + j..][..2 * REACH];
            sum += wi * row.iter().zip(&down).map(|(v, w)| v * w).sum::<f64>();
        }
        sum
    }

    /// First of the six samples around a place along one axis, and their weights.
    fn stencil(&self, um: f64) -> (usize, [f64; 2 * REACH]) {
        let place = um / self.grid.pitch_um() + 0.5 * self.grid.samples as f64 - 0.5;
        let first = (place.floor() as usize + 1).saturating_sub(REACH).min(self.grid.samples - 2 * REACH);
        (first, lagrange(place - first as f64))
    }
}

/// Weights of the polynomial through six samples at `t` samples from the first.
fn lagrange(t: f64) -> [f64; 2 * REACH] {
    std::array::from_fn(|i| {
        (0..2 * REACH).map(|j| if i == j { 1.0 } else { t - j as f64 }).product::<f64>() / GAPS[i]
    })
}

impl Optics<'_> {
    fn wavefront(&self, point: &FieldPoint, nm: f64) -> Result<Wavefront, String> {
        let eye = self.projection.eye();
        let degree = Some(if eye.state().pupil_mm <= 4.0 { 10 } else { 14 });
        let options = WavefrontOptions { degree, ..wavefront_options(self.rho10_per_mm2) };
        Wavefront::new(eye, point.object, nm, &options).map_err(|e| e.to_string())
    }

    /// How much denser the retina receives an even field than the map of chief rays says, by wavelength: at five wavelengths, a polynomial
    /// between. A parabola through three made everything 2e-4 too bright in white light.
    fn densities(&self, point: &FieldPoint) -> Result<Vec<f64>, String> {
        let nodes = &self.nodes_nm;
        let (Some(first), Some(last)) = (nodes.first(), nodes.last()) else { return Ok(Vec::new()) };
        let part = |i: usize| first + (last - first) * i as f64 / (DENSITIES - 1) as f64;
        let mut at: Vec<f64> = (0..DENSITIES).map(part).collect();
        at.dedup();
        let density = |nm: &f64| -> Result<f64, String> {
            let moved = |step: DVec2| -> Result<DVec2, String> {
                let beside = FieldPoint::new(self.projection, point.landing_um + step)?;
                let wave = self.wavefront(&beside, *nm)?;
                Ok(wave.landing_um - beside.landing_um + beside.chart_from_tangents() * wave.centroid_um())
            };
            let x = moved(DVec2::X * STEP_UM)?.x - moved(DVec2::X * -STEP_UM)?.x;
            let y = moved(DVec2::Y * STEP_UM)?.y - moved(DVec2::Y * -STEP_UM)?.y;
            Ok(1.0 / (1.0 + (x + y) / (2.0 * STEP_UM)))
        };
        let values: Vec<f64> = at.par_iter().map(density).collect::<Result<_, _>>()?;
        let between = |nm: &f64| {
            let weight = |i: usize| -> f64 {
                (0..at.len()).filter(|j| *j != i).map(|j| (nm - at[j]) / (at[i] - at[j])).product()
            };
            (0..at.len()).map(|i| weight(i) * values[i]).sum()
        };
        Ok(nodes.iter().map(between).collect())
    }
}

/// The window that holds all wavelengths' spreads.
fn window(waves: &[Wavefront]) -> PsfGrid {
    let width = |w: &Wavefront| {
        let radius = w.axes.x_axis.length().max(w.axes.y_axis.length());
        w.wavelength_um() / (2.0 * radius)
    };
    // Wavelengths rise.
    let at = |part: f64| &waves[(part * (waves.len() - 1) as f64).round() as usize];
    // The ends of the spectrum are far out of focus and give little.
    let spot = spot_radius_um(at(SHORT)).max(spot_radius_um(at(1.0 - SHORT))).max(spot_radius_um(at(0.5)));
    let half = (SPOTS * spot + WIDTHS * width(at(0.5))).max(LEAST_UM);
    let pitch = 0.5 * width(at(SHORT)) / FINER;
    let samples = ((2.0 * half / pitch).ceil() as usize).clamp(8 * REACH, MOST_SAMPLES);
    let half_width_um = half.min(0.5 * pitch * samples as f64);
    let axes = GridAxes::Retina;
    PsfGrid { samples, half_width_um, centre_um: DVec2::ZERO, axes, nodes: None, fraunhofer: true }
}

/// Weights of the cubic through the four nodes around a wavelength, those of the same stretch of light; the end's value beyond its ends.
fn hats(nodes: &[f64], step_nm: f64, nm: f64, mut put: impl FnMut(usize, f64)) {
    let joined = |i: usize| nodes[i + 1] - nodes[i] <= step_nm * (1.0 + 1e-9);
    let above = nodes.partition_point(|node| *node < nm).min(nodes.len() - 1);
    if nodes[above] <= nm || above == 0 {
        return put(above, 1.0);
    }
    if !joined(above - 1) {
        let nearer = if nm - nodes[above - 1] < nodes[above] - nm { above - 1 } else { above };
        return put(nearer, 1.0);
    }
    let mut range = [above - 1, above];
    while range[0] > 0 && joined(range[0] - 1) && above - range[0] < 2 {
        range[0] -= 1;
    }
    while range[1] + 1 < nodes.len() && joined(range[1]) && range[1] - above < 1 {
        range[1] += 1;
    }
    for i in range[0]..=range[1] {
        let others = (range[0]..=range[1]).filter(|j| *j != i);
        put(i, others.map(|j| (nm - nodes[j]) / (nodes[i] - nodes[j])).product());
    }
}

#[cfg(test)]
mod tests {
    use super::hats;

    #[test]
    fn cubics_are_read_exactly_and_gaps_are_not_crossed() {
        let nodes = [400.0, 405.0, 410.0, 415.0, 420.0, 543.0];
        let read = |nm: f64, f: fn(f64) -> f64| {
            let mut sum = 0.0;
            hats(&nodes, 5.0, nm, |i, w| sum += w * f(nodes[i]));
            sum
        };
        assert!((read(407.0, |x| x.powi(3)) / 407.0_f64.powi(3) - 1.0).abs() < 1e-12);
        assert!((read(418.0, |x| x * x) / 418.0_f64.powi(2) - 1.0).abs() < 1e-12);
        assert!((read(543.0, |x| x) - 543.0).abs() < 1e-12);
        assert!((read(450.0, |x| x) - 420.0).abs() < 1e-12);
    }
}
