//! Relaxation of the domain generator: birth, sub-cycles of equation (4), and the proof that the halo was thick enough.
//!
//! In a sub-cycle every cone steps by K2·r·random - K3·r·Σ spline(D)·unit vector, all at once, at most 0.2 r. K2 falls linearly to 0
//! over the cone's own number of sub-cycles; after those it rests. Radii and metrics are those of the birth place.
//!
//! A cone near the rim of the halo misses neighbours and goes wrong; the error spreads by one neighbour a sub-cycle. `exact` follows it: a
//! cone stays exact while every cone with D < 1.1 is (1 for the force, 0.1 for a step of a wrong cone). Rows that cannot
//! reach the tile any more are given up early, which saves a third of the work.
//!
//! Sums run over pairs in Morton order of the birth places, so a cone gets the same bits in every tile.
//!
//! # Stability
//! See `force`: K3 = 0.19 < 0.208, radius factor 1.05.
//!
//! # Cost
//! Half of the generator's time: some 2 µs per cone born, and a tile of 12,000 cones has 37,000 born in it and its halo at the fovea.

use glam::DVec2;

use super::clip::directions;
use super::field::Field;
use super::force::{K2, K3, RADIUS_FACTOR, limited, push};
use super::grid::Grid;
use super::lattice::births;
use super::local::Metric;
use super::mosaic::morton;
use super::tile::RegionUm;
use crate::math;
use crate::rng::{Purpose, Stream};

/// `b` of the random stream of a cone's radius and kicks.
const CONE_STREAM: u64 = 2;
/// D up to which a wrong neighbour makes a cone wrong.
const SPOIL: f64 = 1.1;
/// Pairs are listed up to this far beyond `SPOIL`, and listed anew when a cone has moved that many radii.
const SKIN: f64 = 0.3;
/// The same for the wider list that the short one is taken from.
const WIDE_SKIN: f64 = 1.0;
/// Rows by which errors spread in one sub-cycle, for equal radii and per unit of radius spread.
const SPREAD_ROWS: [f64; 2] = [0.97, 0.6];
/// Rows by which one chain of errors can be ahead of the mean.
const SLACK_ROWS: f64 = 1.2;
/// Rows at the rim of the halo that lack neighbours at birth.
const RIM_ROWS: f64 = 2.0;
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

/// Relaxed cones of a tile and its halo, in Morton order of the birth place: the same order of two cones in every tile.
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
    /// Encounters of each cone with one in the same place.
    pub(super) coincident: Vec<u8>,
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
    // Most sub-cycles are at the tile's point nearest to the fovea, the largest spread of radii at the farthest.
    let texture = field.texture(tile.nearest(DVec2::ZERO));
    let spread_max = field.texture(DVec2::new(tile.farthest_from_origin(), 0.0)).radius_spread;
    let per_cycle = (SPREAD_ROWS[0] + SPREAD_ROWS[1] * spread_max) * factor;
    let kept = exact_rows + SLACK_ROWS;
    let halo = kept + RIM_ROWS + per_cycle * f64::from(texture.cycles);
    let (mut cones, mut bodies) = born(field, tile, halo);
    let last = bodies.iter().map(|b| b.cycles).max().unwrap_or(0);
    let kicks = directions(KICKS);
    let (mut wide, mut pairs) = (Pairs::default(), Pairs::default());
    let mut sums = vec![Sum::default(); bodies.len()];
    for cycle in 0..last {
        if pairs.are_stale(&bodies, SKIN) {
            if wide.are_stale(&bodies, WIDE_SKIN - SKIN) {
                wide = Pairs::new(&cones, &bodies);
            }
            wide.shorten(&bodies, &mut pairs);
        }
        sum_forces(&mut cones, &bodies, &pairs, &mut sums);
        let needed = kept + per_cycle * f64::from(last - 1 - cycle);
        step(&mut cones, &mut bodies, cycle, needed, &sums, &kicks);
    }
    cones.at.extend(bodies.iter().map(|b| quantized(b.at)));
    cones.exact.extend(bodies.iter().map(|b| b.exact));
    cones
}

/// What the inner loop reads of a cone, together in memory.
#[derive(Clone, Copy, Debug)]
struct Body {
    at: DVec2,
    metric: Metric,
    radius: f64,
    cycles: u32,
    exact: bool,
}

/// The sum of equation (4) over a cone's neighbours.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    force: DVec2,
    /// A neighbour was wrong.
    spoiled: bool,
}

/// Birth: places, radii, metrics, and the distance from the tile in rows.
fn born(field: &Field, tile: &RegionUm, halo: f64) -> (Relaxed, Vec<Body>) {
    let births = births(field, &halo_region(field, tile, halo));
    let mut order: Vec<(u64, u64, usize)> =
        births.at.iter().zip(&births.id).enumerate().map(|(i, (&at, &id))| (morton(at), id, i)).collect();
    order.sort_unstable();
    let (mut cones, mut bodies) = (Relaxed::default(), Vec::new());
    for (_, id, i) in order {
        let at = births.at[i];
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
        let radius = 0.5 * RADIUS_FACTOR * spacing * (1.0 + texture.radius_spread * normal);
        let exact = rows <= halo - RIM_ROWS;
        bodies.push(Body { at, metric: here.metric, radius, cycles: texture.cycles, exact });
        cones.id.push(id);
        cones.radius.push(radius);
        cones.spacing.push(spacing);
        cones.metric.push(here.metric);
        cones.rows.push(rows);
        cones.stream.push(stream);
    }
    cones.limited = vec![0; cones.id.len()];
    cones.coincident = vec![0; cones.id.len()];
    (cones, bodies)
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
    /// The wide list, by a grid.
    fn new(cones: &Relaxed, bodies: &[Body]) -> Self {
        // The largest partner near by, in spacings of a cone; neighbouring spacings differ by a few per cent.
        let widest = cones.radius.iter().zip(&cones.spacing).map(|(r, s)| r / s).fold(0.0, f64::max);
        let shortest = cones.metric.iter().map(Metric::shortest).fold(1.0, f64::min);
        let mean = cones.radius.iter().sum::<f64>() / cones.radius.len().max(1) as f64;
        let at: Vec<DVec2> = bodies.iter().map(|b| b.at).collect();
        let grid = Grid::new(&at, 2.0 * mean);
        let mut pairs = Self { start: vec![0], other: Vec::with_capacity(12 * at.len()), at };
        let mut near = Vec::new();
        for (i, body) in bodies.iter().enumerate() {
            let reach = (SPOIL + WIDE_SKIN) * (body.radius + 1.06 * widest * cones.spacing[i]) / shortest;
            near.clear();
            grid.near_slices(body.at, reach, |items| near.extend_from_slice(items));
            let first = pairs.other.len();
            keep(&near, &mut pairs.other, |j| {
                (j as usize > i) & are_near(body, &bodies[j as usize], WIDE_SKIN)
            });
            pairs.other[first..].sort_unstable();
            pairs.start.push(pairs.other.len() as u32);
        }
        pairs
    }

    /// Fills `short` with the pairs that may come within reach before the next look.
    fn shorten(&self, bodies: &[Body], short: &mut Self) {
        short.start.clear();
        short.start.push(0);
        short.other.clear();
        for (i, body) in bodies.iter().enumerate() {
            let others = &self.other[self.start[i] as usize..self.start[i + 1] as usize];
            short.other.extend(others.iter().filter(|&&j| are_near(body, &bodies[j as usize], SKIN)));
            short.start.push(short.other.len() as u32);
        }
        short.at.clear();
        short.at.extend(bodies.iter().map(|b| b.at));
    }

    /// Whether some cone has moved more than `skin` radii since the list was made.
    fn are_stale(&self, bodies: &[Body], skin: f64) -> bool {
        self.at.len() != bodies.len()
            || bodies.iter().zip(&self.at).any(|(b, &at)| {
                let limit = 0.98 * skin * b.radius;
                b.metric.length2(b.at - at) > limit * limit
            })
    }
}

/// Appends the chosen items, without a branch per item.
#[inline]
fn keep(from: &[u32], to: &mut Vec<u32>, chosen: impl Fn(u32) -> bool) {
    let mut end = to.len();
    to.resize(end + from.len(), 0);
    for &j in from {
        to[end] = j;
        end += usize::from(chosen(j));
    }
    to.truncate(end);
}

/// Whether a pair belongs on the list with this skin.
#[inline]
fn are_near(p: &Body, n: &Body, skin: f64) -> bool {
    let cutoff = (SPOIL + skin) * (p.radius + n.radius);
    (p.exact | n.exact) & (length2(p, n) < cutoff * cutoff)
}

/// Squared distance of two cones across their mean direction.
#[inline]
fn length2(p: &Body, n: &Body) -> f64 {
    0.5 * p.metric.plus(&n.metric).length2(n.at - p.at)
}

/// Equation (4), the sum; and which cones had a wrong neighbour.
fn sum_forces(cones: &mut Relaxed, bodies: &[Body], pairs: &Pairs, sums: &mut [Sum]) {
    sums.fill(Sum::default());
    for (i, p) in bodies.iter().enumerate() {
        let mut sum = sums[i];
        for &j in &pairs.other[pairs.start[i] as usize..pairs.start[i + 1] as usize] {
            let other = j as usize;
            let n = &bodies[other];
            let reach = p.radius + n.radius;
            let l2 = length2(p, n);
            if l2 > SPOIL * SPOIL * reach * reach {
                continue;
            }
            if p.exact != n.exact {
                sum.spoiled = true;
                sums[other].spoiled = true;
            }
            if l2 > reach * reach {
                continue;
            }
            let push = push(n.at - p.at, l2, reach).unwrap_or_else(|| {
                cones.coincident[i] = cones.coincident[i].saturating_add(1);
                hashed_direction(cones.id[i], cones.id[other])
            });
            sum.force -= push;
            sums[other].force += push;
        }
        sums[i] = sum;
    }
}

/// A direction for two cones in the same place.
fn hashed_direction(a: u64, b: u64) -> DVec2 {
    math::unit(Stream::new(a, Purpose::Mosaic, b, CONE_STREAM).uniform() * std::f64::consts::TAU)
}

/// Equation (4), the step of all exact cones.
fn step(cones: &mut Relaxed, bodies: &mut [Body], cycle: u32, needed: f64, sums: &[Sum], kicks: &[DVec2]) {
    for (i, body) in bodies.iter_mut().enumerate() {
        if cycle >= body.cycles || !body.exact {
            continue;
        }
        if sums[i].spoiled || cones.rows[i] > needed {
            body.exact = false;
            continue;
        }
        let left = 1.0 - f64::from(cycle + 1) / f64::from(body.cycles);
        let word = cones.stream[i].word();
        let size = f64::from(word >> 10) / f64::from(1_u32 << 22);
        let kick = body.metric.frame().chart_from_plane(kicks[word as usize % KICKS]) * (K2 * left * size);
        let wanted = body.radius * (K3 * sums[i].force + kick);
        let (moved, cut) = limited(wanted, body.metric.length2(wanted), body.radius);
        body.at += moved;
        cones.limited[i] += u8::from(cut);
    }
}
