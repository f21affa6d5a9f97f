//! The reference: Huygens' sum over traced rays, read as the integral that it is. Slow; f64 throughout.
//!
//! field(ξ) = Σ over rays of weight·a·exp(i k' (W + |Q − ξ| − R)), Q the ray's point on the reference sphere of radius
//! R about the landing point. `a` is 1 for `Uniform`; for `Flux` √(dF/dstop · dq/dstop), by finite differences of
//! neighbouring rays. The distance is taken exactly, or by its part linear in ξ (Fraunhofer), −q·ξ.
//!
//! # Cost
//! rays × samples sines: 0.1–1 s for 128×128.

use super::matrix::PsfGrid;
use super::wavefront::{Amplitude, WavefrontOptions};
use crate::optics::{Object, OpticsError, PupilBundle, PupilNodes, PupilRay, SchematicEye};
use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// How the sum is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HuygensOptions {
    /// Gauss nodes in r² of the stop.
    pub radial: usize,
    /// Uniform azimuths.
    pub azimuth: usize,
    /// The exact distance, or its part linear in ξ.
    pub exact_distance: bool,
}

/// Finite difference step in stop radii.
const STEP: f64 = 2e-4;

/// The point spread, row-major, as [`super::matrix::psf`]: 1 = the same pupil with no path difference, at its centre.
///
/// # Errors
/// As [`super::Wavefront::new`].
pub fn psf(
    eye: &SchematicEye,
    object: Object,
    wavelength_nm: f64,
    wavefront: &WavefrontOptions,
    options: &HuygensOptions,
    grid: &PsfGrid,
) -> Result<Vec<f64>, OpticsError> {
    let points = PupilNodes { radial: options.radial, azimuth: options.azimuth, edge: 0 }.points();
    psf_of_points(eye, object, wavelength_nm, wavefront, &points, options.exact_distance, grid)
}

/// The same over rays through any points of the unit stop, with their weights: what §21 does with random ones.
///
/// # Errors
/// As [`super::Wavefront::new`].
pub fn psf_of_points(
    eye: &SchematicEye,
    object: Object,
    wavelength_nm: f64,
    wavefront: &WavefrontOptions,
    points: &[(DVec2, f64)],
    exact_distance: bool,
    grid: &PsfGrid,
) -> Result<Vec<f64>, OpticsError> {
    let bundle = PupilBundle::trace_points(eye, object, wavelength_nm, points, &[])?;
    let weights = weights(eye, object, &bundle, wavefront)?;
    let total: f64 = weights.iter().sum();
    let (e_i, e_j) = grid.axes_of(super::wavefront::meridional_angle_of(eye, &bundle));
    let wavelength_um = bundle.wavelength_mm() * 1e3;
    let radius_um = bundle.radius_mm * 1e3;
    let n = grid.samples;
    let sum_at = |index: usize| {
        let xi = grid.centre_um + grid.offset(index / n) * e_i + grid.offset(index % n) * e_j;
        let (mut re, mut im) = (0.0, 0.0);
        for (ray, weight) in bundle.rays.iter().zip(&weights) {
            let distance = if exact_distance { farther(ray, xi, radius_um) } else { -ray.q.dot(xi) };
            let (sin, cos) = (TAU * (ray.opd_mm * 1e3 + distance) / wavelength_um).sin_cos();
            re += weight * cos;
            im += weight * sin;
        }
        (re * re + im * im) / (total * total)
    };
    Ok((0..n * n).into_par_iter().map(sum_at).collect())
}

/// |Q − ξ| − R without cancellation, µm.
fn farther(ray: &PupilRay, xi: DVec2, radius: f64) -> f64 {
    let across = ray.q * radius - xi;
    let distance = (across.length_squared() + (ray.q_normal * radius).powi(2)).sqrt();
    (xi.length_squared() - 2.0 * radius * ray.q.dot(xi)) / (distance + radius)
}

/// Amplitude of each ray times the area of the stop that it stands for.
pub(super) fn weights(
    eye: &SchematicEye,
    object: Object,
    bundle: &PupilBundle,
    options: &WavefrontOptions,
) -> Result<Vec<f64>, OpticsError> {
    let rho = options.stiles_crawford.map_or(0.0, |s| s.rho_base10_per_mm2);
    let entrance_mm = eye.entrance_radius_mm()?;
    let mut weights: Vec<f64> = bundle
        .rays
        .iter()
        .map(|r| r.weight * 10.0_f64.powf(-0.5 * rho * (bundle.entrance(r) * entrance_mm).length_squared()))
        .collect();
    if options.amplitude == Amplitude::Flux {
        let around = [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y];
        let points: Vec<(DVec2, f64)> =
            bundle.rays.iter().flat_map(|r| around.map(|e| (r.stop + STEP * e, 0.0))).collect();
        let near = PupilBundle::trace_points(eye, object, bundle.wavelength_nm, &points, &[])?;
        for ((weight, ray), n) in weights.iter_mut().zip(&bundle.rays).zip(near.rays.chunks_exact(4)) {
            let area = |f: fn(&PupilRay) -> DVec2| {
                ((f(&n[0]) - f(&n[1])) / (2.0 * STEP)).perp_dot((f(&n[2]) - f(&n[3])) / (2.0 * STEP)).abs()
            };
            *weight *= (ray.irradiance * area(|r| r.launch) * area(|r| r.q)).sqrt();
        }
    }
    Ok(weights)
}
