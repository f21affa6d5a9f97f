//! What a place of the retina asks of the mosaic: spacing, metric, and the texture of the domain generator.
//!
//! Texture over visual degrees, found by comparing with living mosaics (share of six-sided cells, nearest-neighbour distance,
//! hexatic order): patch width q in spacings, spread of the cones' radii, and the number of relaxation sub-cycles. All of it happens
//! within 1°, where the scale of the fovea gives visual degrees.

use glam::DVec2;

use super::density::Density;
use super::local::{Local, local};
use super::params::{Dropout, RetinaParams};
use crate::rng::{Purpose, Stream};

/// (visual degrees, patch width in spacings, relative spread of radii, sub-cycles, cones born per cone wanted); linear between, constant
/// beyond. The last column makes up for the degenerate pairs that lose a cone.
const TEXTURE: [(f64, f64, f64, f64, f64); 5] = [
    (0.0, 4.0, 0.08, 24.0, 1.004),
    (0.3, 4.0, 0.08, 24.0, 1.004),
    (0.5, 5.0, 0.08, 24.0, 1.002),
    (0.75, 5.0, 0.10, 20.0, 1.006),
    (1.0, 4.0, 0.18, 12.0, 1.0185),
];

/// The domain generator's texture at one place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texture {
    pub(super) patch: f64,
    pub(super) radius_spread: f64,
    pub(super) cycles: u32,
    /// Cones born per cone wanted.
    pub(super) births: f64,
}

/// Parameters with their density.
#[derive(Clone, Debug)]
pub(super) struct Field<'a> {
    pub(super) params: &'a RetinaParams,
    pub(super) density: Density,
}

impl<'a> Field<'a> {
    pub(super) fn new(params: &'a RetinaParams) -> Self {
        Self { params, density: Density::new(params) }
    }

    pub(super) fn local(&self, at: DVec2) -> Local {
        local(&self.params.geometry, at)
    }

    /// Area of a cell across the cone's direction, µm².
    pub(super) fn cell_area(&self, at: DVec2, cos_tilt: f64) -> f64 {
        1e6 * cos_tilt / self.density.per_mm2(at)
    }

    /// Spacing of the hexagonal lattice of the target density across the cones, µm.
    pub(super) fn spacing_with(&self, at: DVec2, cos_tilt: f64) -> f64 {
        (self.cell_area(at, cos_tilt) / 0.75_f64.sqrt()).sqrt()
    }

    /// `spacing_with` where the tilt is not at hand.
    pub(super) fn spacing(&self, at: DVec2) -> f64 {
        self.spacing_with(at, self.local(at).cos_tilt)
    }

    /// Spacing averaged over the four meridians at an eccentricity.
    pub(super) fn mean_spacing(&self, rho: f64) -> f64 {
        let at = [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y];
        at.iter().map(|&d| self.spacing(d * rho)).sum::<f64>() / 4.0
    }

    pub(super) fn texture(&self, at: DVec2) -> Texture {
        let deg = at.length() * self.params.geometry.visual.deg_per_um();
        let i = TEXTURE.partition_point(|t| t.0 <= deg).min(TEXTURE.len() - 1);
        let (a, b) = (TEXTURE[i.saturating_sub(1)], TEXTURE[i]);
        let t = if b.0 > a.0 { ((deg - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) } else { 1.0 };
        let mix = |x: f64, y: f64| x + t * (y - x);
        let cycles = self.params.cycles.unwrap_or_else(|| mix(a.3, b.3).round() as u32);
        Texture { patch: mix(a.1, b.1), radius_spread: mix(a.2, b.2), cycles, births: mix(a.4, b.4) }
    }

    /// Whether the cone `id` at a place is one of the retina: inside the ora, outside the optic disc, not dropped out.
    pub(super) fn keeps(&self, id: u64, at: DVec2) -> bool {
        let lost = |d: Dropout| Stream::new(d.seed, Purpose::Dropout, id, 0).uniform() < d.fraction;
        self.density.is_retina(at) && !self.params.dropout.is_some_and(lost)
    }
}
