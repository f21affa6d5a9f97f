//! Relaxation of the domain generator: birth, sub-cycles of equation (4), removal of degenerate pairs, and the proof that the halo was
//! thick enough.
//!
//! In a sub-cycle every cone steps by K2·r·random - K3·r·Σ spline(D)·unit vector, all at once, at most 0.2 r. K2 falls linearly to 0
//! over the cone's own number of sub-cycles; after those it rests. Radii and metrics are those of the birth place. Half-way and at the
//! end one cone of every pair with D < 0.6 is removed (§15.4); births make up for it.
//!
//! A cone near the rim of the halo misses neighbours and goes wrong; the error spreads by one neighbour a sub-cycle. `exact` follows it: a
//! cone stays exact while every cone with D < 1.1 is (1 for the force, 0.1 for a step of a wrong cone). Rows that cannot
//! reach the tile any more are given up early, which saves a third of the work.
//!
//! A push is rounded to a multiple of 2^-40 before it is added: such sums are exact, so their order does not matter and a cone gets the
//! same bits in every tile.
//!
//! # Stability
//! See `force`: K3 = 0.19 < 0.208, radius factor 1.05.
//!
//! # Cost
//! Half of the generator's time.

use glam::DVec2;

use super::clip::directions;
use super::field::Field;
use super::force::{DEGENERATE, K2, K3, RADIUS_FACTOR, limited, push};
use super::grid::Grid;
use super::lattice::births;
use super::local::{Frame, Metric};
use super::mosaic::morton;
use super::tile::RegionUm;
use crate::math;
use crate::rng::{Purpose, Stream, mixed};

/// `b` of the random stream of a cone's radius and kicks.
const CONE_STREAM: u64 = 2;
/// D up to which a wrong neighbour makes a cone wrong.
const SPOIL: f64 = 1.1;
/// Pairs are listed up to this far beyond `SPOIL`, and listed anew when a cone has moved that many radii. The second shell of
/// neighbours begins just beyond.
const SKIN: f64 = 0.45;
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
/// Added and taken away again, this rounds numbers below 2^11 to a multiple of 2^-40.
const ROUNDER: f64 = 6_144.0;
/// Points of one side of a tile at which the spacing is looked up.
const SIDE_POINTS: usize = 8;
/// Final places lie on this grid, µm: then corners relative to them are exact in f32 and corners of two tiles agree.
pub(super) const QUANTUM_UM: f64 = 1.0 / 65_536.0;

/// Rounds a chart point to the grid.
pub(super) fn quantized(p: DVec2) -> DVec2 {
    (p / QUANTUM_UM).round() * QUANTUM_UM
}

/// Relaxed cones of a tile and its halo, in Morton order of the birth place.
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
    /// Places of the cones that were removed, one of each degenerate pair.
    pub(super) removed: Vec<DVec2>,
    /// Last steps of the cones: sum of squares in radii, and how many.
    pub(super) last_steps: (f64, f64),
}

impl Relaxed {
    /// Whether all cones born within `rows` of the tile are exact.
    pub(super) fn is_exact(&self, rows: f64) -> bool {
        self.rows.iter().zip(&self.exact).all(|(r, e)| *e || *r > rows)
    }
}

/// Places the cones of `tile` and its halo and relaxes them; `factor` widens the halo.
pub(super) fn relax(field: &Field, tile: &RegionUm, exact_rows: f64, factor: f64) -> Relaxed {
    relax_with(field, tile, exact_rows, factor, K3)
}

/// As [`relax`] with another K3: to see the iteration grow unstable.
pub(super) fn relax_with(field: &Field, tile: &RegionUm, exact_rows: f64, factor: f64, k3: f64) -> Relaxed {
    // Most sub-cycles are at the tile's point nearest to the fovea, the largest spread of radii at the farthest.
    let texture = field.texture(tile.nearest(DVec2::ZERO));
    let spread_max = field.texture(DVec2::new(tile.farthest_from_origin(), 0.0)).radius_spread;
    let per_cycle = (SPREAD_ROWS[0] + SPREAD_ROWS[1] * spread_max) * factor;
    let kept = exact_rows + SLACK_ROWS;
    let halo = kept + RIM_ROWS + per_cycle * f64::from(texture.cycles);
    let (mut cones, mut bodies) = born(field, tile, halo);
    let last = bodies.iter().map(|b| b.cycles).max().unwrap_or(0);
    let first = bodies.iter().map(|b| b.cycles).min().unwrap_or(0);
    let kicks = directions(KICKS);
    let frames: Vec<Frame> = cones.metric.iter().map(Metric::frame).collect();
    let mut pairs = Pairs::default();
    let mut sums = vec![Sum::default(); bodies.len()];
    for cycle in 0..last {
        if pairs.are_stale(&bodies) {
            pairs.list(&cones, &bodies);
        }
        sum_forces(&mut cones, &bodies, &pairs, &mut sums);
        let needed = kept + per_cycle * f64::from(last - 1 - cycle);
        let kick = |i: usize, body: &Body| {
            let word = mixed(body.key, u64::from(cycle));
            let size = (word >> 11) as f64 / (1_u64 << 53) as f64;
            let left = 1.0 - f64::from(cycle + 1) / f64::from(body.cycles);
            frames[i].chart_from_plane(kicks[word as usize % KICKS]) * (K2 * left * size)
        };
        let force = |i: usize, body: &Body| k3 * sums[i].force + kick(i, body);
        step(&mut cones, &mut bodies, cycle, needed, &sums, force);
        if (first / 2..=last / 2).contains(&cycle) {
            let is_due = |p: &Body, n: &Body| p.cycles.min(n.cycles) / 2 == cycle;
            part_degenerate_pairs(&mut cones, &mut bodies, &mut pairs, is_due);
        }
    }
    if pairs.are_stale(&bodies) {
        pairs.list(&cones, &bodies);
    }
    part_degenerate_pairs(&mut cones, &mut bodies, &mut pairs, |_, _| true);
    cones.settled(&bodies)
}

/// What the inner loop reads of a cone, together in memory.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Body {
    at: DVec2,
    metric: Metric,
    radius: f64,
    /// Of the random kicks.
    key: u64,
    cycles: u32,
    exact: bool,
    /// Removed as one of a degenerate pair.
    gone: bool,
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
    let border_spacing = BorderSpacing::new(field, tile);
    let mut order: Vec<(u64, u32)> =
        births.at.iter().enumerate().map(|(i, &at)| (morton(at), i as u32)).collect();
    order.sort_unstable_by_key(|&(code, i)| (code, births.id[i as usize]));
    let (mut cones, mut bodies) = (Relaxed::default(), Vec::with_capacity(order.len()));
    cones.reserve(order.len());
    for (_, i) in order {
        let (at, id) = (births.at[i as usize], births.id[i as usize]);
        let here = field.local(at);
        let spacing = field.spacing_with(at, here.cos_tilt);
        let border = tile.nearest(at);
        let rows = if border == at {
            0.0
        } else {
            here.metric.length2(at - border).sqrt() / spacing.max(border_spacing.at(border))
        };
        if rows > halo {
            continue;
        }
        let texture = field.texture(at);
        let mut stream = Stream::new(field.params.seed, Purpose::Mosaic, id, CONE_STREAM);
        let normal = stream.normal_pair().0.clamp(-RADIUS_SIGMAS, RADIUS_SIGMAS);
        let radius = 0.5 * RADIUS_FACTOR * spacing * (1.0 + texture.radius_spread * normal);
        let exact = rows <= halo - RIM_ROWS;
        let (key, cycles) = (stream.bits(), texture.cycles);
        bodies.push(Body { at, metric: here.metric, radius, key, cycles, exact, gone: false });
        cones.id.push(id);
        cones.radius.push(radius);
        cones.spacing.push(spacing);
        cones.metric.push(here.metric);
        cones.rows.push(rows);
    }
    cones.limited = vec![0; cones.id.len()];
    cones.coincident = vec![0; cones.id.len()];
    (cones, bodies)
}

/// Spacings on the border of a tile: between the places looked up, the larger of the two.
struct BorderSpacing {
    tile: RegionUm,
    /// Along x at the lower and upper edge, along y at the left and right edge.
    side: [[f64; SIDE_POINTS + 1]; 4],
}

impl BorderSpacing {
    fn new(field: &Field, tile: &RegionUm) -> Self {
        let size = tile.max - tile.min;
        let side =
            [(DVec2::X, 0.0), (DVec2::X, 1.0), (DVec2::Y, 0.0), (DVec2::Y, 1.0)].map(|(along, across)| {
                std::array::from_fn(|k| {
                    let part = along * (k as f64 / SIDE_POINTS as f64) + (DVec2::ONE - along) * across;
                    field.spacing(tile.min + part * size)
                })
            });
        Self { tile: *tile, side }
    }

    fn at(&self, border: DVec2) -> f64 {
        let part = (border - self.tile.min) / (self.tile.max - self.tile.min);
        let (side, along) = if border.y <= self.tile.min.y {
            (0, part.x)
        } else if border.y >= self.tile.max.y {
            (1, part.x)
        } else if border.x <= self.tile.min.x {
            (2, part.y)
        } else {
            (3, part.y)
        };
        let k = ((along * SIDE_POINTS as f64) as usize).min(SIDE_POINTS - 1);
        self.side[side][k].max(self.side[side][k + 1])
    }
}

impl Relaxed {
    fn reserve(&mut self, n: usize) {
        self.id.reserve(n);
        self.radius.reserve(n);
        self.spacing.reserve(n);
        self.metric.reserve(n);
        self.rows.reserve(n);
    }

    /// The cones that are left, at their final places.
    fn settled(mut self, bodies: &[Body]) -> Self {
        self.at = bodies.iter().map(|b| quantized(b.at)).collect();
        self.exact = bodies.iter().map(|b| b.exact).collect();
        if !self.removed.is_empty() {
            let left = |i: usize| !bodies[i].gone;
            keep_where(&mut self.id, left);
            keep_where(&mut self.at, left);
            keep_where(&mut self.radius, left);
            keep_where(&mut self.spacing, left);
            keep_where(&mut self.metric, left);
            keep_where(&mut self.rows, left);
            keep_where(&mut self.exact, left);
            keep_where(&mut self.limited, left);
            keep_where(&mut self.coincident, left);
        }
        self
    }
}

/// Keeps the items at the wanted indices.
fn keep_where<T>(items: &mut Vec<T>, wanted: impl Fn(usize) -> bool) {
    let mut i = 0;
    items.retain(|_| {
        i += 1;
        wanted(i - 1)
    });
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
                // Beyond the ora, where the chart folds up, nothing is born.
                let p = p.clamp_length_max(1.02 * field.density.ora_um());
                let here = field.local(p);
                field.spacing_with(p, here.cos_tilt) / here.metric.shortest()
            })
            .fold(0.0, f64::max);
        by = halo * widest * 1.02;
    }
    tile.grown(by)
}

/// Pairs that may come within reach, each once.
#[derive(Default)]
struct Pairs {
    /// The first of the pairs of a run.
    first: Vec<u32>,
    /// Where the run of each first begins in `second`; one more entry.
    start: Vec<u32>,
    second: Vec<u32>,
    /// Places when the list was made.
    at: Vec<DVec2>,
}

impl Pairs {
    /// Lists them anew.
    fn list(&mut self, cones: &Relaxed, bodies: &[Body]) {
        // The largest partner near by, in spacings of a cone; neighbouring spacings differ by a few per cent.
        let widest = cones.radius.iter().zip(&cones.spacing).map(|(r, s)| r / s).fold(0.0, f64::max);
        let mean = cones.radius.iter().sum::<f64>() / cones.radius.len().max(1) as f64;
        self.at.clear();
        self.at.extend(bodies.iter().map(|b| b.at));
        let grid = Grid::new(&self.at, 2.0 * mean);
        self.first.clear();
        self.start.clear();
        self.second.clear();
        let reach = |i: u32| {
            let (body, spacing) = (&bodies[i as usize], cones.spacing[i as usize]);
            body.metric.box_of((SPOIL + SKIN) * (body.radius + 1.06 * widest * spacing))
        };
        grid.each_with_later(reach, |i, run| {
            if self.first.last() != Some(&i) {
                self.first.push(i);
                self.start.push(self.second.len() as u32);
            }
            let body = &bodies[i as usize];
            for (k, &j) in run.item.iter().enumerate() {
                if run.holds(k) && are_near(body, &bodies[j as usize]) {
                    self.second.push(j);
                }
            }
        });
        self.start.push(self.second.len() as u32);
    }

    /// Whether some cone has moved more than `SKIN` radii since the list was made.
    fn are_stale(&self, bodies: &[Body]) -> bool {
        self.at.len() != bodies.len()
            || bodies.iter().zip(&self.at).any(|(b, &at)| {
                let limit = 0.98 * SKIN * b.radius;
                b.metric.length2(b.at - at) > limit * limit
            })
    }

    /// Calls `f` with every pair.
    fn each(&self, mut f: impl FnMut(usize, usize)) {
        for (&i, run) in self.first.iter().zip(self.start.windows(2)) {
            for &j in &self.second[run[0] as usize..run[1] as usize] {
                f(i as usize, j as usize);
            }
        }
    }
}

/// Whether a pair belongs on the list.
#[inline]
fn are_near(p: &Body, n: &Body) -> bool {
    let cutoff = (SPOIL + SKIN) * (p.radius + n.radius);
    (p.exact || n.exact) && !p.gone && !n.gone && length2(p, n) < cutoff * cutoff
}

/// Squared distance of two cones across their mean direction.
#[inline]
fn length2(p: &Body, n: &Body) -> f64 {
    0.5 * p.metric.plus(&n.metric).length2(n.at - p.at)
}

/// Equation (4), the sum; and which cones had a wrong neighbour.
fn sum_forces(cones: &mut Relaxed, bodies: &[Body], pairs: &Pairs, sums: &mut [Sum]) {
    sums.fill(Sum::default());
    for (&i, run) in pairs.first.iter().zip(pairs.start.windows(2)) {
        let i = i as usize;
        let p = &bodies[i];
        let mut sum = sums[i];
        for &j in &pairs.second[run[0] as usize..run[1] as usize] {
            let other = j as usize;
            let n = &bodies[other];
            let reach = p.radius + n.radius;
            let l2 = length2(p, n);
            if p.exact != n.exact && l2 < SPOIL * SPOIL * reach * reach {
                sum.spoiled = true;
                sums[other].spoiled = true;
            }
            let push = push(n.at - p.at, l2, reach).unwrap_or_else(|| {
                cones.coincident[i] = cones.coincident[i].saturating_add(1);
                hashed_direction(cones.id[i], cones.id[other])
            });
            let push = (push + ROUNDER) - ROUNDER;
            sum.force -= push;
            sums[other].force += push;
        }
        sums[i] = sum;
    }
}

/// Removes one cone of every degenerate pair that is due; where a wrong cone takes part nothing is certain and nothing done.
fn part_degenerate_pairs(
    cones: &mut Relaxed,
    bodies: &mut [Body],
    pairs: &mut Pairs,
    is_due: impl Fn(&Body, &Body) -> bool,
) {
    let mut gone = Vec::new();
    pairs.each(|i, j| {
        let (p, n) = (&bodies[i], &bodies[j]);
        // A hair more, as rounding and other metrics of the same pair may differ.
        let limit = 1.003 * DEGENERATE * (p.radius + n.radius);
        if length2(p, n) < limit * limit && p.exact && n.exact && is_due(p, n) {
            // The one of the larger id goes: any rule that all tiles share will do.
            gone.push(if cones.id[i] > cones.id[j] { i } else { j });
        }
    });
    if gone.is_empty() {
        return;
    }
    for i in gone {
        if !bodies[i].gone {
            bodies[i].gone = true;
            cones.removed.push(bodies[i].at);
        }
    }
    let mut kept = 0;
    let mut run_start = 0;
    for run in 0..pairs.first.len() {
        let i = pairs.first[run] as usize;
        let run_end = pairs.start[run + 1] as usize;
        for k in run_start..run_end {
            let j = pairs.second[k];
            pairs.second[kept] = j;
            kept += usize::from(!bodies[i].gone && !bodies[j as usize].gone);
        }
        run_start = run_end;
        pairs.start[run + 1] = kept as u32;
    }
    pairs.second.truncate(kept);
}

/// A direction for two cones in the same place.
fn hashed_direction(a: u64, b: u64) -> DVec2 {
    math::unit(Stream::new(a, Purpose::Mosaic, b, CONE_STREAM).uniform() * std::f64::consts::TAU)
}

/// Equation (4), the step of all exact cones; `kick` is the random part in radii.
fn step(
    cones: &mut Relaxed,
    bodies: &mut [Body],
    cycle: u32,
    needed: f64,
    sums: &[Sum],
    force: impl Fn(usize, &Body) -> DVec2,
) {
    for (i, body) in bodies.iter_mut().enumerate() {
        if cycle >= body.cycles || !body.exact || body.gone {
            continue;
        }
        if sums[i].spoiled || cones.rows[i] > needed {
            body.exact = false;
            continue;
        }
        let wanted = body.radius * force(i, body);
        let (moved, cut) = limited(wanted, body.metric.length2(wanted), body.radius);
        body.at += moved;
        cones.limited[i] += u8::from(cut);
        if cycle + 1 == body.cycles {
            let (sum, count) = cones.last_steps;
            cones.last_steps = (sum + (moved.length() / body.radius).powi(2), count + 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retina::RetinaParams;

    /// Two cones in one place part in opposite directions that depend on their streams alone, and are counted.
    #[test]
    fn coincident_cones_part() {
        let p = RetinaParams::default();
        let field = Field::new(&p);
        let tile = RegionUm { min: DVec2::splat(50.0), max: DVec2::splat(55.0) };
        let (mut cones, mut bodies) = born(&field, &tile, 4.0);
        bodies.truncate(2);
        bodies[1].at = bodies[0].at;
        for body in &mut bodies {
            body.exact = true;
        }
        let mut pairs = Pairs::default();
        pairs.list(&cones, &bodies);
        let mut sums = vec![Sum::default(); 2];
        sum_forces(&mut cones, &bodies, &pairs, &mut sums);
        let size = sums[0].force.length();
        assert!(sums[0].force == -sums[1].force && size > 0.5 && size < 2.0, "{size}");
        assert_eq!(cones.coincident[..2].iter().sum::<u8>(), 1);
    }
}
