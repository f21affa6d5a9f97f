//! Figures of a mosaic, in bands of eccentricity: against its targets and against living mosaics.
//!
//! Neighbours are those of the plain Voronoi diagram (no radii), as in studies of living eyes. |ψ6| is |mean of exp(6iα)| over a cone's
//! neighbours, α their directions. The Nyquist limit is that of a hexagonal lattice of the band's density n (cones per deg² of visual
//! field): 1/(√3·spacing) = sqrt(n/(2√3)) cycles per degree.

use super::census::Census;
use super::mosaic::{Counts, Retina};

/// Edges of the default bands, visual degrees.
pub const BANDS_DEG: [f64; 17] =
    [0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0, 130.0];

/// Names of the four sectors of a band: within 45° of these meridians.
pub const SECTORS: [&str; 4] = ["nasal", "superior", "temporal", "inferior"];

/// A quarter of a band.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sector {
    /// Cones.
    pub cones: u64,
    /// Cones that the target density asks for.
    pub target_cones: f64,
    /// Area of retina, mm².
    pub area_mm2: f64,
}

/// One band of eccentricity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Band {
    /// Inner edge, visual degrees.
    pub from_deg: f64,
    /// Outer edge, visual degrees.
    pub to_deg: f64,
    /// Cones in the band and the region.
    pub cones: u64,
    /// Cones that the target density asks for there.
    pub target_cones: f64,
    /// Nasal, superior, temporal and inferior quarter of the retina.
    pub sectors: [Sector; 4],
    /// Area of the visual field, deg² (solid angle).
    pub area_deg2: f64,
    /// L, M and S cones.
    pub types: [u64; 3],
    /// S cones that the target share asks for there.
    pub target_s: f64,
    /// Cones looked at that have all their neighbours in the region; the following are means over them.
    pub interior: u64,
    /// Of the cones looked at, those whose cell does not close within 1.25 spacings.
    pub open: u64,
    /// Share with six neighbours.
    pub six_share: f64,
    /// Mean number of cones with D <= 1.5 (§15.4), D by the target radii.
    pub within_1_5: f64,
    /// Nearest-neighbour distance over the median of the six nearest: mean.
    pub nearest_mean: f64,
    /// Nearest-neighbour distance over the median of the six nearest: standard deviation.
    pub nearest_sd: f64,
    /// Mean |ψ6|.
    pub psi6: f64,
    /// S cones far enough from the edges for their nearest S cone to be known.
    pub s_interior: u64,
    /// Mean distance of an S cone to the nearest other one, in units of 1/sqrt(S density); 0.5 at random.
    pub s_nearest: f64,
    /// Mean aperture over cell area.
    pub coverage: f64,
}

impl Band {
    /// Density over target.
    pub fn density_ratio(&self) -> f64 {
        self.cones as f64 / self.target_cones
    }

    /// Share of S cones.
    pub fn s_share(&self) -> f64 {
        self.types[2] as f64 / (self.cones as f64).max(1.0)
    }

    /// Share of S cones that the target asks for.
    pub fn target_s_share(&self) -> f64 {
        self.target_s / self.target_cones.max(1e-300)
    }

    /// Nyquist limit, cycles per degree; 0 in an empty band.
    pub fn nyquist_cpd(&self) -> f64 {
        (self.cones as f64 / self.area_deg2.max(1e-300) / 12.0_f64.sqrt()).sqrt()
    }
}

/// Figures of a mosaic.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// The whole region as one band.
    pub all: Band,
    /// Bands of eccentricity with at least one cone.
    pub bands: Vec<Band>,
    /// Rare events while the mosaic was made.
    pub counts: Counts,
}

/// Statistics of a region in bands from 0 to 130 visual degrees.
pub fn statistics(retina: &Retina) -> Statistics {
    statistics_in_bands(retina, &BANDS_DEG)
}

/// Statistics of a region in bands with the given ascending edges, visual degrees.
pub fn statistics_in_bands(retina: &Retina, edges_deg: &[f64]) -> Statistics {
    let mut census = Census::new(&retina.params, edges_deg, 1);
    census.add(retina, &retina.region);
    census.statistics()
}
