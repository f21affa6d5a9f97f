//! How regular the mosaic gets, by eccentricity (§15.4).
//!
//! The paper has 41 sub-cycles at the fovea and lets them drop outside, "to simulate the less hexagonally regular patterns that occur once rod cells
//! start appearing between cone cells". Fewer sub-cycles alone leave too even a mosaic: nearest neighbours come as far as 0.95 of the median
//! distance, 0.90 in life. So nominal radii ("individual", §15) vary about the one of the target density, more so where rods are.
//! The numbers were found by comparing with living mosaics: share of six-sided cells, nearest-neighbour distance, hexatic order.
//!
//! `radius` makes up for the density that a texture leads to; what is left is for the feedback of `front`.

use super::super::field::Field;

/// (visual degrees on the scale of the fovea, sub-cycles, relative spread of radii, radius over half the hexagonal spacing);
/// linear between, constant beyond.
const TEXTURE: [(f64, f64, f64, f64); 4] =
    [(0.0, 41.0, 0.03, 1.008), (0.5, 41.0, 0.03, 0.993), (1.0, 20.0, 0.10, 0.944), (2.0, 16.0, 0.10, 0.931)];

/// Bound of nominal radii over the spacing of a cone near by: 2.5 standard deviations of 0.10 and 6 % of feedback on half of it, and 2 % for the
/// change of the spacing from cone to cone.
pub(super) const LARGEST_RADIUS: f64 = 0.5 * 1.01 * 1.25 * 1.06 * 1.02;

/// The texture at one eccentricity.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texture {
    /// Sub-cycles of a growth cycle.
    pub(super) sub_cycles: u32,
    /// Relative standard deviation of nominal radii.
    pub(super) spread: f64,
    /// Mean radius in units of half the hexagonal spacing.
    pub(super) radius: f64,
}

/// The texture at an eccentricity, µm.
pub(super) fn texture(field: &Field, rho: f64) -> Texture {
    let deg = rho * field.params.geometry.visual.deg_per_um();
    let i = TEXTURE.partition_point(|t| t.0 <= deg).clamp(1, TEXTURE.len() - 1);
    let (a, b) = (TEXTURE[i - 1], TEXTURE[i]);
    let t = ((deg - a.0) / (b.0 - a.0)).clamp(0.0, 1.0);
    let mix = |x: f64, y: f64| x + t * (y - x);
    let sub_cycles = field.params.cycles.unwrap_or_else(|| mix(a.1, b.1).round() as u32);
    Texture { sub_cycles, spread: mix(a.2, b.2), radius: mix(a.3, b.3) }
}
