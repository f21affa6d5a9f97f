//! Voids and degenerate pairs (§15.3, §15.4).
//!
//! A void is an empty circle: a corner of the Voronoi cell of a cone (across the cone) that is at least 0.85 spacings from it, and so from all
//! cones. Five cones in a regular pentagon one spacing apart have a corner at 0.85 spacings; the polygon of their walls' midpoints is as large as
//! a cell and a quarter, the size from which §15.3 seeds a new cone. A missing cone of a hexagonal lattice leaves 1.0, a lattice
//! without faults has 0.58.
//! Each cone is searched once its row has settled and again when it is about to be frozen.
//!
//! A degenerate pair has D < 0.65 after it has settled; its younger cone is removed.

use std::collections::BTreeMap;

use glam::DVec2;

use super::super::clip::{Convex, directions};
use super::cone::Cone;
use super::pairs::{Body, Links, Pairs, are_within};
use super::sectors::turn;

/// Radius of the empty circle that makes a void, in spacings.
pub(super) const VOID: f64 = 0.85;
/// A new cone is placed at most this far from the cone that found the void, in spacings.
const FARTHEST: f64 = 1.0;
/// Size limit of the cells that are searched, in spacings.
const LARGEST: f64 = 1.25;
/// D below which a pair is degenerate.
pub(super) const DEGENERATE: f64 = 0.65;
/// Hops from the edge at which a row has settled.
const SETTLED: u8 = 3;
/// D of the cones that bound a cell.
const BOUNDING: f64 = 2.0;

/// Cones that have settled and are too close to an older one.
pub(super) fn degenerate(cones: &[Cone], bodies: &[Body], pairs: &Pairs, depth: &[u8]) -> Vec<bool> {
    let mut removed = vec![false; cones.len()];
    for (i, p) in bodies.iter().enumerate() {
        for &j in pairs.of(i) {
            let j = j as usize;
            let settled = depth[i].max(depth[j]) >= SETTLED && (p.moves || bodies[j].moves);
            if settled && !removed[i] && !removed[j] && are_within(p, &bodies[j], DEGENERATE) {
                removed[if cones[i].id > cones[j].id { i } else { j }] = true;
            }
        }
    }
    removed
}

/// Places of new cones in the voids next to cones that are due for a search: settled, about to be frozen at `freeze` hops, and no deeper
/// than `deepest`, where the cones round a new one would leave before it has come to rest.
pub(super) fn voids(
    cones: &mut [Cone],
    bodies: &[Body],
    pairs: &Pairs,
    depth: &[u8],
    [freeze, deepest]: [u8; 2],
) -> Vec<DVec2> {
    let due = |c: &Cone, d: u8| !c.frozen && d >= if c.searched { freeze } else { SETTLED } && d <= deepest;
    let links = pairs.both_ways(bodies, BOUNDING);
    let circle = directions(12);
    let mut cell = Convex::default();
    let mut found = Vec::new();
    for i in 0..cones.len() {
        if due(&cones[i], depth[i]) {
            cones[i].searched = true;
            found.extend(void_beside(&cones[i], i, bodies, &links, &circle, &mut cell));
        }
    }
    apart(found)
}

/// An empty circle.
struct Void {
    at: DVec2,
    /// In spacings.
    radius: f64,
    finder: u64,
    /// No other new cone within this, µm of the chart.
    clearance: f64,
}

/// The largest void at a corner of the cell of cone `i`.
fn void_beside(
    cone: &Cone,
    i: usize,
    bodies: &[Body],
    links: &Links,
    circle: &[DVec2],
    cell: &mut Convex,
) -> Option<Void> {
    let frame = cone.metric.frame();
    cell.reset_regular(circle, LARGEST * cone.spacing);
    for &j in links.of(i) {
        let d = frame.plane_from_chart(bodies[j as usize].at - cone.at);
        cell.cut(d, 0.5 * d.length_squared(), j);
    }
    let corner = cell.corner.iter().copied().reduce(|a, b| if b.length() > a.length() { b } else { a })?;
    let radius = corner.length() / cone.spacing;
    if radius < VOID {
        return None;
    }
    let at = cone.at + frame.chart_from_plane(corner * (FARTHEST / radius).min(1.0));
    Some(Void { at, radius, finder: cone.id, clearance: VOID * cone.spacing / cone.metric.shortest() })
}

/// The voids, larger ones first, without those too close to one before.
fn apart(mut found: Vec<Void>) -> Vec<DVec2> {
    found.sort_by(|a, b| b.radius.total_cmp(&a.radius).then(a.finder.cmp(&b.finder)));
    // Taken places by their turn about the centre; bits of positive numbers sort as the numbers do.
    let mut taken: BTreeMap<u64, DVec2> = BTreeMap::new();
    let mut places = Vec::new();
    for void in found {
        let (t, half) = (turn(void.at), 1.6 * void.clearance / void.at.length().max(1e-9));
        let is_near = |p: &DVec2| p.distance_squared(void.at) < void.clearance * void.clearance;
        // The range may go over the start of the circle on either side.
        let crowded = [-4.0, 0.0, 4.0].iter().any(|shift| {
            let (low, high) = ((t - half + shift).max(0.0), (t + half + shift).max(0.0));
            taken.range(low.to_bits()..=high.to_bits()).any(|(_, p)| is_near(p))
        });
        if !crowded {
            taken.insert(t.to_bits(), void.at);
            places.push(void.at);
        }
    }
    places
}
