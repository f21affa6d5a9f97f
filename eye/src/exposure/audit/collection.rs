//! What one cone collects: for each primary the density, per µm² of retina, with which photons of a point of the screen are
//! counted at the offset ρ of the cone from that point's image.
//!
//! Each source point has a PSF of its own. Around a cone at x they are traced at x itself and at a few source
//! points beside it (two where the geometric spot is small, five elsewhere), and a source at an offset δ on
//! the screen has the PSF `p(ρ; δ) = p₀(ρ) + Σ_s L_s(δ) [p_s − p₀](ρ)`, L the polynomials of the first or
//! second degree through these points. ρ is the exact offset `−X(δ)`, X the map of chief rays about x to
//! second order. The differences are taken at every fourth wavelength: they are small.
//!
//! `p(ρ) = Σ_λ fraction(λ)·caught(λ)·PSF_λ(ρ − shift(λ))` by PSFs at wavelengths of its own, sampled 2.5
//! times as finely as their cutoff asks and read by six-point polynomials. Outside of the window it is the
//! wave from the pupil's edge ([`super::tail`]), with the light that is missing from the whole, which is
//! known.

use glam::DVec2;
use multiversion::multiversion;
use rayon::prelude::*;

use super::super::spectral::Kind;
use super::super::transfer::FieldPoint;
use super::local::{Local, Stencil};
use super::optics::{Optics, REACH, Spread, every, usual_spot_um, window};
use crate::display::Emitter;
use crate::psf::{PsfGrid, Wavefront};

/// One of so many wavelengths is traced for what differs between source points.
pub const SPARSE: usize = 4;
/// Samples beyond the offsets asked for that are read: polynomials, and the bend of the image between corners.
const BESIDE: f64 = 8.0;

/// Products of the gaps between six samples.
const GAPS: [f64; 2 * REACH] = [-120.0, 24.0, -12.0, 12.0, -24.0, 120.0];

/// What a cone collects: densities (1/µm²), or after [`Collection::over`] fractions that an aperture counts.
pub struct Collection {
    /// The screen about the cone.
    pub local: Local,
    grid: PsfGrid,
    inside_um: f64,
    period_um: f64,
    /// By primary: of a source at the cone's own place.
    spreads: Vec<Spread>,
    /// `[point beside][primary]`: what that point's PSF has more.
    beside: Vec<Vec<Spread>>,
    stencil: Stencil,
}

impl Collection {
    /// For cones of a kind at a place (µm) and visual eccentricity (degrees), with an aperture about so wide
    /// (µm).
    ///
    /// # Errors
    /// When the place sees no screen or the pupil cannot be traced.
    pub fn new(
        optics: &Optics,
        emitters: &[Emitter],
        kind: Kind,
        (um, aperture_um): (DVec2, f64),
        ecc_deg: f64,
    ) -> Result<Self, String> {
        let point = FieldPoint::new(optics.projection, um)?;
        let local = Local::new(optics, &point)?;
        let seen = (kind, ecc_deg);
        // The cone's own place, at all wavelengths.
        let waves = optics.wavefronts(&point, &optics.nodes_nm)?;
        let (grid, period_um) = window(&waves, aperture_um);
        let weights = |waves: &[Wavefront], step_nm: f64| -> Vec<Vec<f64>> {
            emitters.iter().map(|emitter| optics.weights(waves, emitter, seen, step_nm)).collect()
        };
        let mut wanted = weights(&waves, optics.step_nm);
        let stencil = Stencil::new(usual_spot_um(&waves) / local.um_per_tangent());
        let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
        // The same from fewer wavelengths, for what differs at source points beside it.
        let few = every(&optics.nodes_nm, SPARSE, optics.step_nm);
        let step_nm = SPARSE as f64 * optics.step_nm;
        let few_nm: Vec<f64> = few.iter().map(|i| optics.nodes_nm[*i]).collect();
        let few_waves: Vec<Wavefront> = few.iter().map(|i| waves[*i].clone()).collect();
        for of_few in weights(&few_waves, step_nm) {
            let mut of_all = vec![0.0; waves.len()];
            few.iter().zip(of_few).for_each(|(i, weight)| of_all[*i] = weight);
            wanted.push(of_all);
        }
        let mut spreads = optics.spreads(&point, &waves, &wanted, grid);
        let base = spreads.split_off(emitters.len());
        let difference = |offset: &DVec2| -> Result<Vec<Spread>, String> {
            let source = FieldPoint::at_tangent(optics.projection, point.tangent + *offset)?;
            let waves = optics.wavefronts(&source, &few_nm)?;
            let mut spreads = optics.spreads(&source, &waves, &weights(&waves, step_nm), grid);
            spreads.iter_mut().zip(&base).for_each(|(there, here)| there.subtract(here));
            Ok(spreads)
        };
        let beside = stencil.offsets().iter().map(difference).collect::<Result<_, String>>()?;
        Ok(Self { local, grid, inside_um, period_um, spreads, beside, stencil })
    }

    /// Half of the window's side, µm.
    pub fn window_um(&self) -> f64 {
        self.inside_um
    }

    /// Shortest period in the spread, µm.
    pub fn period_um(&self) -> f64 {
        self.period_um
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
        let all: Vec<&mut Spread> = self.spreads.iter_mut().chain(self.beside.iter_mut().flatten()).collect();
        all.into_par_iter().for_each(|spread| {
            let mut sums = vec![0.0; samples * samples];
            for i in rows.clone() {
                let line = &mut sums[i * samples..][columns.clone()];
                for (di, taps) in stencil.chunks_exact(side).enumerate() {
                    let row = &spread.values[(i + di - half) * samples..][columns.start - half..];
                    taps.iter().enumerate().for_each(|(dj, tap)| add(line, &row[dj..], *tap));
                }
            }
            spread.values = sums;
            spread.tail.scale(area);
            spread.total *= area;
        });
        self.inside_um -= half as f64 * pitch;
        self
    }

    /// The density, or the fraction, for a source at an offset on the screen (unit tangents) from the cone: of the photons that
    /// would enter the nominal pupil from the gaze centre.
    pub fn at(&self, primary: usize, offset: DVec2) -> f64 {
        let rho = -self.local.image_um(offset);
        let outside = rho.abs().max_element() > self.inside_um;
        let own = self.read(&self.spreads[primary], rho, outside);
        // From afar only the light is another; the PSF's tail hardly changes.
        let change = if outside {
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
            return spread.tail.at(rho);
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

/// Adds a part of a row of samples to another.
#[multiversion(targets("x86_64+avx2"))]
fn add(to: &mut [f64], from: &[f64], part: f64) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += part * from);
}
