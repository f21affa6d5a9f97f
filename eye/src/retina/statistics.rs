//! How a mosaic compares with its targets and with living mosaics.
//!
//! Cones nearer than three spacings to the edge of the region are left out of what needs neighbours. Neighbours are those of the plain Voronoi
//! diagram (no radii), as in studies of living eyes. |ψ6| is |mean of exp(6iα)| over a cone's neighbours, α their directions.

use glam::DVec2;

use super::cells::{Cells, diagram, neighbours};
use super::field::Field;
use super::force::{NEIGHBOUR, RADIUS_FACTOR};
use super::grid::Grid;
use super::mosaic::Retina;
use super::relax::Relaxed;
use super::tile::RegionUm;

/// Edges of the default bands, visual degrees.
const BANDS_DEG: [f64; 14] = [0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 110.0];
/// Steps per side of the grid that integrates the target.
const STEPS: usize = 700;
/// Spacings between the edge of the region and the first cone that counts.
const MARGIN: f64 = 3.0;

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
    /// L, M and S cones.
    pub types: [u64; 3],
    /// S cones that the target share asks for there.
    pub target_s: f64,
    /// Cones with all their neighbours in the region; the following are means over them.
    pub interior: u64,
    /// Share with six neighbours.
    pub six_share: f64,
    /// Mean number of cones with D <= 1.5 (§15.4).
    pub within_1_5: f64,
    /// Nearest-neighbour distance over the median of the six nearest: mean.
    pub nearest_mean: f64,
    /// Nearest-neighbour distance over the median of the six nearest: standard deviation.
    pub nearest_sd: f64,
    /// Mean |ψ6|.
    pub psi6: f64,
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
}

/// Figures of a mosaic.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// The whole region as one band.
    pub all: Band,
    /// Bands of eccentricity with at least one cone.
    pub bands: Vec<Band>,
}

/// Statistics in bands from 0 to 110 visual degrees.
pub fn statistics(retina: &Retina) -> Statistics {
    statistics_in_bands(retina, &BANDS_DEG)
}

/// Statistics in bands with the given ascending edges, visual degrees.
pub fn statistics_in_bands(retina: &Retina, edges_deg: &[f64]) -> Statistics {
    let field = Field::new(&retina.params);
    let mut bands: Vec<Band> =
        edges_deg.windows(2).map(|e| Band { from_deg: e[0], to_deg: e[1], ..Band::default() }).collect();
    let last = edges_deg.last().copied().unwrap_or(0.0);
    let mut all =
        Band { from_deg: edges_deg.first().copied().unwrap_or(0.0), to_deg: last, ..Band::default() };
    let band_of = |at: DVec2| {
        let deg = field.density.visual_deg(at);
        edges_deg.partition_point(|&e| e <= deg).checked_sub(1).filter(|&b| b + 1 < edges_deg.len())
    };
    add_targets(&field, &retina.region, &mut bands, &mut all, band_of);
    let cones = as_relaxed(&field, retina);
    let cells = diagram(&cones, |_| true);
    let grid = Grid::new(&cones.at, 2.0 * cones.spacing.iter().copied().fold(0.0, f64::max));
    for i in 0..retina.len() {
        let Some(b) = band_of(cones.at[i]) else { continue };
        let sample = sample(&retina.region, &cones, &cells, &grid, i);
        for band in [&mut bands[b], &mut all] {
            band.cones += 1;
            band.types[retina.cone_type[i] as usize] += 1;
            band.coverage += f64::from(retina.aperture_um2[i] / retina.cell_area_um2[i]);
            if let Some(s) = &sample {
                band.interior += 1;
                band.six_share += f64::from(u8::from(s.six));
                band.within_1_5 += s.within;
                band.nearest_mean += s.nearest;
                band.nearest_sd += s.nearest * s.nearest;
                band.psi6 += s.psi6;
            }
        }
    }
    bands.retain(|b| b.cones > 0);
    for band in bands.iter_mut().chain([&mut all]) {
        let n = (band.interior as f64).max(1.0);
        band.coverage /= (band.cones as f64).max(1.0);
        for sum in [&mut band.six_share, &mut band.within_1_5, &mut band.nearest_mean, &mut band.psi6] {
            *sum /= n;
        }
        band.nearest_sd = (band.nearest_sd / n - band.nearest_mean * band.nearest_mean).max(0.0).sqrt();
    }
    Statistics { all, bands }
}

/// Integrates the targets over each band within the region (midpoint rule).
fn add_targets(
    field: &Field,
    region: &RegionUm,
    bands: &mut [Band],
    all: &mut Band,
    band_of: impl Fn(DVec2) -> Option<usize>,
) {
    let step = (region.max - region.min) / STEPS as f64;
    let radius = field.params.geometry.radius_um;
    for j in 0..STEPS {
        for i in 0..STEPS {
            let at = region.min + step * DVec2::new(i as f64 + 0.5, j as f64 + 0.5);
            let Some(b) = band_of(at).filter(|_| field.density.is_retina(at)) else {
                continue;
            };
            let theta = at.length() / radius;
            let sphere = if theta > 1e-9 { theta.sin() / theta } else { 1.0 };
            let cones = 1e-6 * field.density.per_mm2(at) * step.x * step.y * sphere;
            let s = cones * field.density.s_share(at);
            for band in [&mut bands[b], &mut *all] {
                band.target_cones += cones;
                band.target_s += s;
            }
        }
    }
}

/// The retina's cones with target radii and metrics, for the neighbour search.
fn as_relaxed(field: &Field, retina: &Retina) -> Relaxed {
    let mut cones = Relaxed::default();
    for i in 0..retina.len() {
        let at = retina.center(i);
        let here = field.local(at);
        let spacing = field.spacing_with(at, here.cos_tilt);
        cones.at.push(at);
        cones.metric.push(here.metric);
        cones.spacing.push(spacing);
        cones.radius.push(0.5 * RADIUS_FACTOR * spacing);
    }
    cones
}

struct Sample {
    six: bool,
    within: f64,
    nearest: f64,
    psi6: f64,
}

/// What one cone adds; `None` near the edge of the region.
fn sample(region: &RegionUm, cones: &Relaxed, cells: &Cells, grid: &Grid, i: usize) -> Option<Sample> {
    let (p, metric, spacing) = (cones.at[i], cones.metric[i], cones.spacing[i]);
    let margin = MARGIN * spacing / metric.shortest();
    let (labels, closed) = neighbours(cells, i);
    if !region.grown(-margin).contains(p) || !closed {
        return None;
    }
    let frame = metric.frame();
    let mut distance: Vec<f64> = Vec::new();
    let mut within = 0.0;
    grid.near(p, 2.2 * spacing / metric.shortest(), |j| {
        if j as usize != i {
            let d = metric.length2(cones.at[j as usize] - p).sqrt();
            distance.push(d);
            if d <= NEIGHBOUR * (cones.radius[i] + cones.radius[j as usize]) {
                within += 1.0;
            }
        }
    });
    distance.sort_unstable_by(f64::total_cmp);
    let mut order = DVec2::ZERO;
    for &n in labels {
        let u = frame.plane_from_chart(cones.at[n as usize] - p);
        order += DVec2::from_angle(6.0 * u.to_angle());
    }
    let median = 0.5 * (distance.get(2)? + distance.get(3)?);
    Some(Sample {
        six: labels.len() == 6,
        within,
        nearest: distance.first()? / median,
        psi6: order.length() / labels.len() as f64,
    })
}
