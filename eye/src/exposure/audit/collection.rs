//! What one cone collects: for each primary the density, per µm² of retina, with which photons of a point of the screen are
//! counted at the offset ρ of the cone from that point's image.
//!
//! Each source point has a PSF of its own. Around a cone at x they are traced at x itself and at a few source points beside it
//! (two where the geometric spot is small, five elsewhere), and a source at an offset δ on the screen has the PSF
//! `p(ρ; δ) = p₀(ρ) + Σ_s L_s(δ) [p_s − p₀](ρ)`, L the polynomials of the first or second degree through these points. ρ is the
//! exact offset `−X(δ)`, X the map of chief rays about x to second order. The differences are taken at every fourth
//! wavelength: they are small. A PSF that is narrow keeps its form and is only displaced: by the traced change of its centroid.
//!
//! `p(ρ) = Σ_λ fraction(λ)·caught(λ)·PSF_λ(ρ − shift(λ))` by PSFs at wavelengths of its own, sampled 2.5 times as finely as
//! their cutoff asks and read by six-point polynomials. Outside of the window a pupil with an edge spreads as `c/|ρ|³`; c is
//! what is missing from the whole, which is known.

use std::f64::consts::SQRT_2;

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::super::spectral::{Absorbers, Kind, Paths, paths_at};
use super::super::transfer::{FieldPoint, spot_radius_um, wavefront_options};
use super::local::{Local, Stencil};
use crate::display::{EmissionLaw, Emitter};
use crate::optics::beam::nominal_mm2;
use crate::optics::{BeamField, Projection};
use crate::psf::sampled_fft::{Edge, psf as fast};
use crate::psf::{GridAxes, PsfGrid, Wavefront, WavefrontOptions, psf};

/// Window: at least so many µm each way, so many times the geometric spot and so many widths of the diffraction pattern.
const LEAST_UM: f64 = 36.0;
const SPOTS: f64 = 1.3;
const WIDTHS: f64 = 12.0;
/// Samples per sample that the cutoff asks, of a wavelength shorter than most.
const FINER: f64 = 2.5;
const SHORT: f64 = 0.15;
/// Most samples across the window.
const MOST_SAMPLES: usize = 2048;
/// Samples from which a PSF comes from a fast transform of so many points across the pupil, at least: at 6 and 8 mm cones change by 1e-4
/// from twice as many.
const FAST_FROM: usize = 448;
const ACROSS: usize = 256;
/// Wavelengths at which the displacement of PSFs is traced.
const DRIFTS: usize = 5;
/// One of so many wavelengths is traced for what differs between source points.
const SPARSE: usize = 4;
/// Points of a polynomial on either side.
const REACH: usize = 3;
/// Samples beyond the offsets asked for that are read: polynomials, and the bend of the image between corners.
const BESIDE: f64 = 8.0;

/// What is the same for all cones.
pub struct Optics<'a> {
    /// Screen and eye.
    pub projection: &'a Projection,
    /// Light that enters the pupil from each point of the screen.
    pub beams: &'a BeamField,
    /// How the screen's light falls with the angle.
    pub emission_law: EmissionLaw,
    /// Media and pigments.
    pub absorbers: Absorbers,
    /// Wavelengths of the PSFs, nm.
    pub nodes_nm: Vec<f64>,
    /// Spacing, nm.
    pub step_nm: f64,
    /// Stiles-Crawford coefficient, base 10, 1/mm².
    pub rho10_per_mm2: f64,
}

/// The PSF of one primary's light.
#[derive(Clone)]
struct Spread {
    values: Vec<f64>,
    /// Density at distance r outside of the window, times r³.
    tail: f64,
    total: f64,
}

/// Products of the gaps between six samples.
const GAPS: [f64; 2 * REACH] = [-120.0, 24.0, -12.0, 12.0, -24.0, 120.0];

/// What a cone collects: densities (1/µm²), or after [`Collection::over`] fractions that an aperture counts.
pub struct Collection {
    /// The screen about the cone.
    pub local: Local,
    grid: PsfGrid,
    inside_um: f64,
    /// By primary: of a source at the cone's own place.
    spreads: Vec<Spread>,
    /// `[point beside][primary]`: what that point's PSF has more.
    beside: Vec<Vec<Spread>>,
    /// By primary: displacement of the PSF (µm) by the offset of its source (unit tangents), where nothing else changes.
    drift: Vec<DMat2>,
    stencil: Stencil,
}

/// PSFs of one source point by wavelength, each of a density per photon that enters a pupil of the reference wavelength's beam.
struct Images {
    nodes_nm: Vec<f64>,
    paths: Vec<Paths>,
    totals: Vec<f64>,
    psfs: Vec<Vec<f64>>,
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
        let local = Local::new(optics, &point)?;
        // The cone's own place, at all wavelengths.
        let waves = optics.wavefronts(&point, &optics.nodes_nm)?;
        let grid = window(&waves);
        let own = optics.images(&point, &waves, grid);
        let weigh = |images: &Images, step_nm: f64| -> Vec<Spread> {
            let one = |emitter: &Emitter| optics.primary(images, emitter, (kind, ecc_deg, step_nm), &grid);
            emitters.iter().map(one).collect()
        };
        let spreads = weigh(&own, optics.step_nm);
        let stencil = Stencil::new(usual_spot_um(&waves) / local.um_per_tangent());
        if stencil.rigid {
            let drift = optics.drift((&point, stencil.step()), emitters, (kind, ecc_deg))?;
            let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
            return Ok(Self { local, grid, inside_um, spreads, beside: Vec::new(), drift, stencil });
        }
        // Source points beside it, at fewer wavelengths: what is different there.
        let coarse = own.every(SPARSE, optics.step_nm);
        let coarse_step = SPARSE as f64 * optics.step_nm;
        let base = weigh(&coarse, coarse_step);
        let difference = |offset: &DVec2| -> Result<Vec<Spread>, String> {
            let source = FieldPoint::at_tangent(optics.projection, point.tangent + *offset)?;
            let waves = optics.wavefronts(&source, &coarse.nodes_nm)?;
            let images = optics.images(&source, &waves, grid);
            let less = |(mut there, here): (Spread, &Spread)| {
                there.values.iter_mut().zip(&here.values).for_each(|(a, b)| *a -= b);
                Spread { tail: there.tail - here.tail, total: there.total - here.total, ..there }
            };
            Ok(weigh(&images, coarse_step).into_iter().zip(&base).map(less).collect())
        };
        let beside = stencil.offsets().iter().map(difference).collect::<Result<_, String>>()?;
        let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
        let drift = vec![DMat2::ZERO; emitters.len()];
        Ok(Self { local, grid, inside_um, spreads, beside, drift, stencil })
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

    /// The same integrated over an aperture: points about its centre (µm) with areas (µm²); where it is read later, offsets of
    /// sources on the screen (unit tangents) within two corners.
    #[must_use]
    pub fn over(mut self, aperture: &[(DVec2, f64)], [from, to]: [DVec2; 2]) -> Self {
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
        // Samples that are read: those of the PSF at the offsets asked for, and as many around as polynomials reach.
        let corners = [from, to, DVec2::new(from.x, to.y), DVec2::new(to.x, from.y)];
        let images = corners.map(|corner| -self.local.image_um(corner));
        let range = |axis: usize| {
            let place = |um: f64| um / pitch + 0.5 * samples as f64;
            let low = images.iter().map(|p| place(p[axis])).fold(f64::MAX, f64::min) - BESIDE;
            let high = images.iter().map(|p| place(p[axis])).fold(f64::MIN, f64::max) + BESIDE;
            let last = samples.saturating_sub(half).max(half);
            let first = (low.max(0.0) as usize).clamp(half, last);
            first..(high.max(0.0) as usize).clamp(first, last)
        };
        let (rows, columns) = (range(0), range(1));
        for spread in self.spreads.iter_mut().chain(self.beside.iter_mut().flatten()) {
            let mut sums = vec![0.0; samples * samples];
            for i in rows.clone() {
                for (di, taps) in stencil.chunks_exact(side).enumerate() {
                    let row = &spread.values[(i + di - half) * samples..][..samples];
                    let line = &mut sums[i * samples..][columns.clone()];
                    for (j, sum) in (columns.start - half..).zip(line) {
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

    /// The density, or the fraction, for a source at an offset on the screen (unit tangents) from the cone: of the photons that
    /// would enter the nominal pupil from the gaze centre.
    pub fn at(&self, primary: usize, offset: DVec2) -> f64 {
        let rho = -self.local.image_um(offset) - self.drift[primary] * offset;
        let outside = rho.abs().max_element() > self.inside_um;
        let own = self.read(&self.spreads[primary], rho, outside);
        // From afar only the light is another; the PSF's tail hardly changes.
        let change = if outside || self.beside.is_empty() {
            0.0
        } else {
            let weights = self.stencil.weights(offset);
            self.beside
                .iter()
                .zip(weights)
                .map(|(s, weight)| weight * self.read(&s[primary], rho, false))
                .sum()
        };
        self.local.light(offset) * (own + change)
    }

    /// One PSF at an offset of the cone from the source's image (µm).
    fn read(&self, spread: &Spread, rho: DVec2, outside: bool) -> f64 {
        if outside {
            return spread.tail / rho.length().powi(3);
        }
        let samples = self.grid.samples;
        let [(i, across), (j, down)] = [self.stencil_at(rho.x), self.stencil_at(rho.y)];
        let mut sum = 0.0;
        for (di, wi) in across.iter().enumerate() {
            let row = &spread.values[(i + di) * samples + j..][..2 * REACH];
            sum += wi * row.iter().zip(&down).map(|(v, w)| v * w).sum::<f64>();
        }
        sum
    }

    /// First of the six samples around a place along one axis, and their weights.
    fn stencil_at(&self, um: f64) -> (usize, [f64; 2 * REACH]) {
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

impl Images {
    /// Every so many wavelengths of each stretch of light and its ends.
    fn every(&self, step: usize, step_nm: f64) -> Self {
        let joined = |i: usize| self.nodes_nm[i + 1] - self.nodes_nm[i] <= step_nm * (1.0 + 1e-9);
        let (mut kept, mut first) = (Vec::new(), 0);
        for i in 0..self.nodes_nm.len() {
            let last = i + 1 == self.nodes_nm.len() || !joined(i);
            if (i - first).is_multiple_of(step) || last {
                kept.push(i);
            }
            if last {
                first = i + 1;
            }
        }
        Self {
            nodes_nm: kept.iter().map(|i| self.nodes_nm[*i]).collect(),
            paths: kept.iter().map(|i| self.paths[*i]).collect(),
            totals: kept.iter().map(|i| self.totals[*i]).collect(),
            psfs: kept.iter().map(|i| self.psfs[*i].clone()).collect(),
        }
    }
}

impl Optics<'_> {
    fn wavefronts(&self, point: &FieldPoint, nodes_nm: &[f64]) -> Result<Vec<Wavefront>, String> {
        let eye = self.projection.eye();
        let degree = Some(if eye.state().pupil_mm <= 4.0 { 10 } else { 14 });
        let options = WavefrontOptions { degree, ..wavefront_options(self.rho10_per_mm2) };
        let one = |nm: &f64| Wavefront::new(eye, point.object, *nm, &options).map_err(|e| e.to_string());
        nodes_nm.par_iter().map(one).collect()
    }

    /// By primary: how the centroid of the PSF moves from the chief ray's landing point at the reference wavelength, µm along the
    /// retina's tangents by unit tangents of the source, at five wavelengths weighted by what is caught near them.
    fn drift(
        &self,
        (point, step): (&FieldPoint, f64),
        emitters: &[Emitter],
        (kind, ecc_deg): (Kind, f64),
    ) -> Result<Vec<DMat2>, String> {
        let (Some(first), Some(last)) = (self.nodes_nm.first(), self.nodes_nm.last()) else {
            return Ok(vec![DMat2::ZERO; emitters.len()]);
        };
        let part = |i: usize| first + (last - first) * i as f64 / (DRIFTS - 1) as f64;
        let mut nodes: Vec<f64> = (0..DRIFTS).map(part).collect();
        nodes.dedup();
        let moved = |offset: DVec2| -> Result<Vec<DVec2>, String> {
            let source = FieldPoint::at_tangent(self.projection, point.tangent + offset)?;
            let to_tangents = source.chart_from_tangents().inverse();
            let of_wave = |w: &Wavefront| to_tangents * (w.landing_um - source.landing_um) + w.centroid_um();
            Ok(self.wavefronts(&source, &nodes)?.iter().map(of_wave).collect())
        };
        let (right, left) = (moved(step * DVec2::X)?, moved(-step * DVec2::X)?);
        let (above, below) = (moved(step * DVec2::Y)?, moved(-step * DVec2::Y)?);
        let paths = Paths { cornea: 1.0, lens: 1.0 };
        let of_emitter = |emitter: &Emitter| {
            let (mut sum, mut total) = (DMat2::ZERO, 0.0);
            for p in &emitter.photons {
                let caught = p.emitted * self.absorbers.caught_at(kind, p.nm, ecc_deg, paths);
                total += caught;
                // Cubic between the wavelengths that were traced.
                hats(&nodes, f64::MAX, p.nm, |i, hat| {
                    let by = DMat2::from_cols(right[i] - left[i], above[i] - below[i]);
                    sum += by * (caught * hat / (2.0 * step));
                });
            }
            if total > 0.0 { sum * (1.0 / total) } else { DMat2::ZERO }
        };
        Ok(emitters.iter().map(of_emitter).collect())
    }

    /// PSFs about the image of a source point at the reference wavelength.
    fn images(&self, point: &FieldPoint, waves: &[Wavefront], grid: PsfGrid) -> Images {
        let to_tangents = point.chart_from_tangents().inverse();
        let beam_mm2 =
            nominal_mm2(self.projection.eye().state().pupil_mm) * self.beams.relative(point.tangent);
        let image = |w: &Wavefront| {
            // The window stands about the image at the reference wavelength; the PSF of this one lies beside.
            let shift = to_tangents * (w.landing_um - point.landing_um);
            let scale = w.pupil_area_mm2 / beam_mm2 * w.density_per_um2();
            let grid = PsfGrid { centre_um: -shift, ..grid };
            let image =
                if grid.samples > FAST_FROM { fast(w, &grid, ACROSS, Edge::Covered) } else { psf(w, &grid) };
            image.into_iter().map(|v| v * scale).collect()
        };
        Images {
            nodes_nm: waves.iter().map(|w| w.wavelength_nm).collect(),
            paths: waves.iter().map(|w| Paths::new(w, &self.absorbers.media)).collect(),
            totals: waves.iter().map(|w| w.pupil_area_mm2 / beam_mm2 * w.throughput()).collect(),
            psfs: waves.par_iter().map(image).collect(),
        }
    }

    /// The PSF of a primary's light from those of wavelengths `step_nm` apart, weighted with what a kind of cone at an
    /// eccentricity catches.
    fn primary(
        &self,
        images: &Images,
        emitter: &Emitter,
        (kind, ecc_deg, step_nm): (Kind, f64, f64),
        grid: &PsfGrid,
    ) -> Spread {
        let nodes = &images.nodes_nm;
        let mut weights = vec![0.0; nodes.len()];
        for p in &emitter.photons {
            let paths = paths_at(nodes, &images.paths, p.nm);
            let caught = self.absorbers.caught_at(kind, p.nm, ecc_deg, paths);
            hats(nodes, step_nm, p.nm, |i, hat| weights[i] += hat * p.emitted * caught);
        }
        let emitted = emitter.emitted().max(f64::MIN_POSITIVE);
        let mut values = vec![0.0; grid.samples * grid.samples];
        let mut total = 0.0;
        for ((weight, image), whole) in weights.iter().zip(&images.psfs).zip(&images.totals) {
            let weight = weight / emitted;
            total += weight * whole;
            values.iter_mut().zip(image).for_each(|(sum, v)| *sum += weight * v);
        }
        let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
        let inner = || REACH..grid.samples - REACH;
        let inside: f64 = inner().map(|i| inner().map(|j| values[i * grid.samples + j]).sum::<f64>()).sum();
        let missing = total - inside * grid.pitch_um().powi(2);
        // ∫ r⁻³ over the plane outside of a square of half side R is 4√2/R.
        Spread { values, tail: missing.max(0.0) * inside_um / (4.0 * SQRT_2), total }
    }
}

/// Radius of the geometric spot, µm. Wavelengths rise; the ends of the spectrum are far out of focus and give little.
fn usual_spot_um(waves: &[Wavefront]) -> f64 {
    let at = |part: f64| &waves[(part * (waves.len() - 1) as f64).round() as usize];
    [SHORT, 0.5, 1.0 - SHORT].map(|part| spot_radius_um(at(part))).into_iter().fold(0.0, f64::max)
}

/// The window that holds all wavelengths' PSFs.
fn window(waves: &[Wavefront]) -> PsfGrid {
    let width = |w: &Wavefront| {
        let radius = w.axes.x_axis.length().max(w.axes.y_axis.length());
        w.wavelength_um() / (2.0 * radius)
    };
    let at = |part: f64| &waves[(part * (waves.len() - 1) as f64).round() as usize];
    let half = (SPOTS * usual_spot_um(waves) + WIDTHS * width(at(0.5))).max(LEAST_UM);
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
