//! Relaxation of the domain generator: birth, sub-cycles of equation (4), and the proof that the halo was thick enough.
//!
//! In a sub-cycle every cone steps by K2·r·random - K3·r·Σ spline(D)·unit vector, all at once, at most 0.2 r. K2 falls linearly to 0
//! over the cone's own number of sub-cycles; after those it rests. Radii and metrics are those of the birth place.
//!
//! A cone near the rim of the halo misses neighbours and goes wrong; the error spreads by one neighbour a sub-cycle. `exact` follows it: a
//! cone stays exact while every cone with D < 1.1 is (1 for the force, 0.1 for a step of a wrong cone). Rows that cannot
//! reach the tile any more are given up early, which saves a third of the work.
//!
//! Sums run over pairs in ascending order of the global ids, so a cone gets the same bits in every tile.
//!
//! # Stability
//! See `force`: K3 = 0.19 < 0.208, radius factor 1.05.
//!
//! # Cost
//! About 1.5 µs per cone in the halo and the tile.

use glam::DVec2;

use super::clip::directions;
use super::field::Field;
use super::force::{K2, K3, RADIUS_FACTOR, limited, push};
use super::grid::Grid;
use super::lattice::births;
use super::local::Metric;
use super::tile::RegionUm;
use crate::rng::{Purpose, Stream};

/// `b` of the random stream of a cone's radius and kicks.
const CONE_STREAM: u64 = 2;
/// D up to which a wrong neighbour makes a cone wrong.
const SPOIL: f64 = 1.1;
/// Pairs are listed up to this far beyond `SPOIL`, and listed anew when a cone has moved half of it in radii.
const SKIN: f64 = 0.3;
/// Rows by which errors spread in one sub-cycle, for equal radii and per unit of radius spread.
const SPREAD_ROWS: [f64; 2] = [1.09, 0.9];
/// Directions of the random kicks.
const KICKS: usize = 1_024;
/// Radii stay within this many standard deviations.
const RADIUS_SIGMAS: f64 = 2.5;
/// Final places lie on this grid, µm: then corners relative to them are exact in f32 and corners of two tiles agree.
pub(super) const QUANTUM_UM: f64 = 1.0 / 65_536.0;

/// Rounds a chart point to the grid.
pub(super) fn quantized(p: DVec2) -> DVec2 {
    (p / QUANTUM_UM).round() * QUANTUM_UM
}

/// Relaxed cones of a tile and its halo, sorted by id.
#[derive(Debug, Default)]
pub(super) struct Relaxed {
    pub(super) id: Vec<u64>,
    pub(super) at: Vec<DVec2>,
    pub(super) radius: Vec<f64>,
    pub(super) spacing: Vec<f64>,
    pub(super) metric: Vec<Metric>,
    /// Rows of cones between the birth place and the tile.
    pub(super) rows: Vec<f64>,
    pub(super) exact: Vec<bool>,
    /// Steps of each cone that were cut to the limit.
    pub(super) limited: Vec<u8>,
    /// Coincident pairs met.
    pub(super) coincident: u64,
    cycles: Vec<u32>,
    stream: Vec<Stream>,
}

impl Relaxed {
    /// Whether all cones born within `rows` of the tile are exact.
    pub(super) fn is_exact(&self, rows: f64) -> bool {
        self.rows.iter().zip(&self.exact).all(|(r, e)| *e || *r > rows)
    }
}

/// Places the cones of `tile` and its halo and relaxes them; `factor` widens the halo.
pub(super) fn relax(field: &Field, tile: &RegionUm, exact_rows: f64, factor: f64) -> Relaxed {
    // The texture is coarsest work at the tile's nearest point to the fovea.
    let texture = field.texture(tile.nearest(DVec2::ZERO));
    let spread_max = field
        .texture(DVec2::new(tile.farthest_from_origin(), 0.0))
        .radius_spread;
    let per_cycle = (SPREAD_ROWS[0] + SPREAD_ROWS[1] * spread_max) * factor;
    let halo = exact_rows + 2.5 + per_cycle * f64::from(texture.cycles);
    let mut cones = born(field, tile, halo);
    let last = cones.cycles.iter().copied().max().unwrap_or(0);
    let kicks = directions(KICKS);
    let mut pairs = Pairs::default();
    let mut force = vec![DVec2::ZERO; cones.at.len()];
    let mut spoiled = vec![false; cones.at.len()];
    for cycle in 0..last {
        if pairs.are_stale(&cones) {
            pairs = Pairs::new(&cones);
        }
        sum_forces(&mut cones, &pairs, &mut force, &mut spoiled);
        let needed = exact_rows + per_cycle * f64::from(last - 1 - cycle);
        step(&mut cones, cycle, needed, &force, &spoiled, &kicks);
    }
    for p in &mut cones.at {
        *p = quantized(*p);
    }
    cones
}

/// Birth: places, radii, metrics, and the distance from the tile in rows.
fn born(field: &Field, tile: &RegionUm, halo: f64) -> Relaxed {
    let births = births(field, &halo_region(field, tile, halo));
    let mut cones = Relaxed::default();
    for (&id, &at) in births.id.iter().zip(&births.at) {
        let here = field.local(at);
        let spacing = field.spacing_with(at, here.cos_tilt);
        let border = tile.nearest(at);
        let rows = if border == at {
            0.0
        } else {
            here.metric.length2(at - border).sqrt() / spacing.max(field.spacing(border))
        };
        if rows > halo {
            continue;
        }
        let texture = field.texture(at);
        let mut stream = Stream::new(field.params.seed, Purpose::Mosaic, id, CONE_STREAM);
        let normal = stream.normal_pair().0.clamp(-RADIUS_SIGMAS, RADIUS_SIGMAS);
        cones.id.push(id);
        cones.at.push(at);
        cones
            .radius
            .push(0.5 * RADIUS_FACTOR * spacing * (1.0 + texture.radius_spread * normal));
        cones.spacing.push(spacing);
        cones.metric.push(here.metric);
        cones.rows.push(rows);
        cones.exact.push(rows <= halo - 2.5);
        cones.cycles.push(texture.cycles);
        cones.stream.push(stream);
    }
    cones.limited = vec![0; cones.id.len()];
    cones
}

/// A rectangle that holds the halo: grown until its rim is `halo` of its own largest spacings away.
fn halo_region(field: &Field, tile: &RegionUm, halo: f64) -> RegionUm {
    let mut by = 0.0;
    for _ in 0..8 {
        let region = tile.grown(by);
        let middle = 0.5 * (region.min + region.max);
        let corners = region.corners();
        let widest = (0..4)
            .flat_map(|m| [corners[m], 0.5 * (corners[m] + corners[(m + 1) % 4])])
            .chain([middle])
            .map(|p| {
                let here = field.local(p);
                field.spacing_with(p, here.cos_tilt) / here.metric.shortest()
            })
            .fold(0.0, f64::max);
        by = halo * widest * 1.02;
    }
    tile.grown(by)
}

/// Pairs (i, j > i) that may come within reach, in order of i and j.
#[derive(Default)]
struct Pairs {
    start: Vec<u32>,
    other: Vec<u32>,
    at: Vec<DVec2>,
}

impl Pairs {
    fn new(cones: &Relaxed) -> Self {
        let widest = cones.radius.iter().copied().fold(0.0, f64::max);
        let shortest = cones.metric.iter().map(Metric::shortest).fold(1.0, f64::min);
        let mean = cones.radius.iter().sum::<f64>() / cones.radius.len().max(1) as f64;
        let grid = Grid::new(&cones.at, 2.0 * mean);
        let mut pairs = Self {
            start: vec![0],
            other: Vec::with_capacity(4 * cones.at.len()),
            at: cones.at.clone(),
        };
        for i in 0..cones.at.len() {
            let first = pairs.other.len();
            // The largest partner near by: spacing varies slowly, radii by the spread.
            let partner = (1.6 * cones.spacing[i]).min(widest);
            let reach = (SPOIL + SKIN) * (cones.radius[i] + partner) / shortest;
            grid.near(cones.at[i], reach, |j| {
                let n = j as usize;
                if n > i && (cones.exact[i] || cones.exact[n]) {
                    let cutoff = (SPOIL + SKIN) * (cones.radius[i] + cones.radius[n]);
                    if length2(cones, i, n) < cutoff * cutoff {
                        pairs.other.push(j);
                    }
                }
            });
            pairs.other[first..].sort_unstable();
            pairs.start.push(pairs.other.len() as u32);
        }
        pairs
    }

    fn are_stale(&self, cones: &Relaxed) -> bool {
        self.at.len() != cones.at.len()
            || (0..cones.at.len()).any(|i| {
                let limit = 0.98 * SKIN * cones.radius[i];
                cones.metric[i].length2(cones.at[i] - self.at[i]) > limit * limit
            })
    }
}

/// Squared distance of two cones across their mean direction.
#[inline]
fn length2(cones: &Relaxed, i: usize, n: usize) -> f64 {
    let d = cones.at[n] - cones.at[i];
    0.5 * cones.metric[i].plus(&cones.metric[n]).length2(d)
}

/// Equation (4), the sum; and which cones had a wrong neighbour.
fn sum_forces(cones: &mut Relaxed, pairs: &Pairs, force: &mut [DVec2], spoiled: &mut [bool]) {
    force.fill(DVec2::ZERO);
    spoiled.fill(false);
    for i in 0..cones.at.len() {
        for &j in &pairs.other[pairs.start[i] as usize..pairs.start[i + 1] as usize] {
            let n = j as usize;
            let reach = cones.radius[i] + cones.radius[n];
            let l2 = length2(cones, i, n);
            if l2 > (SPOIL * reach).powi(2) {
                continue;
            }
            if cones.exact[i] != cones.exact[n] {
                spoiled[i] = true;
                spoiled[n] = true;
            }
            if l2 > reach * reach {
                continue;
            }
            let push = push(cones.at[n] - cones.at[i], l2, reach).unwrap_or_else(|| {
                cones.coincident += 1;
                hashed_direction(cones.id[i], cones.id[n])
            });
            force[i] -= push;
            force[n] += push;
        }
    }
}

/// A direction for two cones in the same place.
fn hashed_direction(a: u64, b: u64) -> DVec2 {
    DVec2::from_angle(Stream::new(a, Purpose::Mosaic, b, CONE_STREAM).uniform() * std::f64::consts::TAU)
}

/// Equation (4), the step of all exact cones.
fn step(cones: &mut Relaxed, cycle: u32, needed: f64, force: &[DVec2], spoiled: &[bool], kicks: &[DVec2]) {
    for i in 0..cones.at.len() {
        if cycle >= cones.cycles[i] || !cones.exact[i] {
            continue;
        }
        if spoiled[i] || cones.rows[i] > needed {
            cones.exact[i] = false;
            continue;
        }
        let (r, metric) = (cones.radius[i], cones.metric[i]);
        let left = 1.0 - f64::from(cycle + 1) / f64::from(cones.cycles[i]);
        let word = cones.stream[i].word();
        let size = f64::from(word >> 10) / f64::from(1_u32 << 22);
        let kick = metric.frame().chart_from_plane(kicks[word as usize % KICKS]) * (K2 * left * size);
        let wanted = r * (K3 * force[i] + kick);
        let (moved, cut) = limited(wanted, metric.length2(wanted), r);
        cones.at[i] += moved;
        cones.limited[i] += u8::from(cut);
    }
}
