//! The sub-cycles of one growth cycle: equation (4) over the live ring.
//!
//! p' = p + K1·r·toward + K2·r·random - K3·r·Σ spline(D)·(n - p)/|n - p|, all cones at once, at most 0.2 r; `toward` is the unit vector to the
//! foveal centre across the cone, `random` has a length from 0 to 1 in any direction, K2 falls linearly to 0 over the sub-cycles.
//!
//! # Stability
//! K3 = 0.2 is below the limit of 0.208 (`force`).
//!
//! # Cost
//! Most of the generator's: a cone is moved in six growth cycles, 246 times at the fovea and 96 times from 2° on.

use glam::DVec2;

use super::super::clip::directions;
use super::super::force::{limited, push};
use super::cone::Cone;
use super::pairs::{Body, Pairs, distance2};
use super::sectors::Sectors;
use super::texture::LARGEST_RADIUS;
use crate::math;
use crate::rng::{Purpose, Stream};

/// Drive towards the centre, in radii a sub-cycle.
const K1: f64 = 0.01;
/// Random kicks at the first sub-cycle, in radii.
const K2: f64 = 0.2;
/// Strength of the repulsion.
pub(super) const K3: f64 = 0.2;
/// Directions of the random kicks.
const KICKS: usize = 1_024;
/// D up to which the wide list has to be right at the end.
const KNOWN: f64 = 1.5;

/// Constants of a cone's steps, µm of the chart.
struct Drive {
    toward: DVec2,
    /// Chart steps of a kick of one K2 along the two axes of the plane across the cone.
    kick: [DVec2; 2],
}

/// What a growth cycle leaves.
pub(super) struct Settled {
    /// The cones as bodies, at their new places.
    pub(super) bodies: Vec<Body>,
    /// All pairs with D <= 1.5, and more.
    pub(super) pairs: Pairs,
    /// Root mean square step of the last sub-cycle, in radii.
    pub(super) last_step: f64,
}

/// The random directions.
pub(super) fn kicks() -> Vec<DVec2> {
    directions(KICKS)
}

/// The cones in the order of bins, so that neighbours are close in memory.
pub(super) fn sorted(cones: &[Cone]) -> Vec<Cone> {
    let at: Vec<DVec2> = cones.iter().map(|c| c.at).collect();
    let spacing = cones.iter().map(|c| c.spacing / c.metric.shortest()).sum::<f64>();
    let sectors = Sectors::new(&at, spacing / cones.len().max(1) as f64);
    sectors.order().iter().map(|&i| cones[i as usize].clone()).collect()
}

/// Cones as bodies; those that are frozen do not move.
pub(super) fn bodies<'a>(cones: impl Iterator<Item = &'a Cone>) -> Vec<Body> {
    cones
        .map(|c| Body {
            at: c.at,
            metric: c.metric,
            radius: c.radius,
            largest: LARGEST_RADIUS * c.spacing,
            moves: !c.frozen,
        })
        .collect()
}

/// Runs the sub-cycles of one growth cycle.
pub(super) fn settle(cones: &mut [Cone], count: u32, kicks: &[DVec2]) -> Settled {
    let mut bodies = bodies(cones.iter());
    let drives: Vec<Drive> = cones.iter().map(drive).collect();
    let (mut wide, mut short) = (Pairs::wide(&bodies), Pairs::default());
    let mut sums = vec![DVec2::ZERO; bodies.len()];
    let mut last_step = 0.0;
    for sub_cycle in 0..count {
        if short.short_is_stale(&bodies) {
            if wide.wide_is_stale_for_short(&bodies) {
                wide = Pairs::wide(&bodies);
            }
            wide.shorten(&bodies, &mut short);
        }
        sum_forces(cones, &bodies, &short, &mut sums);
        let left = 1.0 - f64::from(sub_cycle + 1) / f64::from(count);
        last_step = step(cones, &mut bodies, &drives, left, &sums, kicks);
    }
    if wide.wide_is_stale(&bodies, KNOWN) {
        wide = Pairs::wide(&bodies);
    }
    for (cone, body) in cones.iter_mut().zip(&bodies) {
        cone.at = body.at;
    }
    Settled { bodies, pairs: wide, last_step }
}

fn drive(cone: &Cone) -> Drive {
    let frame = cone.metric.frame();
    let kick = [DVec2::X, DVec2::Y].map(|e| frame.chart_from_plane(e) * (K2 * cone.radius));
    let out2 = cone.metric.length2(cone.at);
    let toward = if out2 > 0.0 { cone.at * (-K1 * cone.radius / out2.sqrt()) } else { DVec2::ZERO };
    Drive { toward, kick }
}

/// Equation (4), the sum over neighbours.
fn sum_forces(cones: &mut [Cone], bodies: &[Body], pairs: &Pairs, sums: &mut [DVec2]) {
    sums.fill(DVec2::ZERO);
    for (i, p) in bodies.iter().enumerate() {
        let mut sum = sums[i];
        for &j in pairs.of(i) {
            let n = &bodies[j as usize];
            let reach = p.radius + n.radius;
            let l2 = distance2(p, n);
            if l2 > reach * reach {
                continue;
            }
            let push = push(n.at - p.at, l2, reach).unwrap_or_else(|| {
                cones[i].coincident = cones[i].coincident.saturating_add(1);
                hashed_direction(cones[i].id, cones[j as usize].id)
            });
            sum -= push;
            sums[j as usize] += push;
        }
        sums[i] = sum;
    }
}

/// A direction for two cones in the same place.
fn hashed_direction(a: u64, b: u64) -> DVec2 {
    math::unit(Stream::new(a, Purpose::Mosaic, b, 0).uniform() * std::f64::consts::TAU)
}

/// Equation (4), the step; returns its root mean square in radii. `left` is the share of K2 that is left.
fn step(
    cones: &mut [Cone],
    bodies: &mut [Body],
    drives: &[Drive],
    left: f64,
    sums: &[DVec2],
    kicks: &[DVec2],
) -> f64 {
    let (mut square, mut moved) = (0.0, 0.0);
    for (i, body) in bodies.iter_mut().enumerate() {
        if !body.moves {
            continue;
        }
        let (drive, cone) = (&drives[i], &mut cones[i]);
        let word = cone.stream.word();
        let size = left * f64::from(word >> 10) / f64::from(1_u32 << 22);
        let kick = kicks[word as usize % KICKS] * size;
        let wanted =
            (K3 * body.radius) * sums[i] + drive.toward + drive.kick[0] * kick.x + drive.kick[1] * kick.y;
        let length2 = body.metric.length2(wanted);
        let (step, cut) = limited(wanted, length2, body.radius);
        body.at += step;
        cone.limited = cone.limited.saturating_add(u8::from(cut));
        square += length2 / (body.radius * body.radius);
        moved += 1.0;
    }
    (square / f64::max(moved, 1.0)).sqrt()
}
