//! Cell walls by averaging (§15.3, Figure 5).
//!
//! The neighbours of a cone are those with D <= 1.5, in counter-clockwise order. A corner of its cell is the average of the centres of cones that all meet there:
//! * p, n_i and n_i+1, mutual neighbours (Figure 5b): three;
//! * where the lines between two pairs of neighbours cross, the four cones (5d) or, when crossings hang together, five or more (5e);
//! * where n_i and n_i+1 are not neighbours there is a void: p has a corner half-way to each of them (5c).
//!
//! # As printed
//! Rules are tried for 5, 4, 3 and 2 consecutive neighbours of each cone. Seen from each of its cones a group has to come out the same, and "n_i or n_i+2
//! is closer to p than n_i+1" does not hold from all sides of every group. Crossing lines do: p-n_i+1 is the longer diagonal seen from p just when it crosses
//! n_i-n_i+2. A line that crosses one whose four cones are not all mutual neighbours is dropped when it is the longer of the two, so the lines
//! that are left cross in groups of mutual neighbours ("a complex test" of 5e).
//!
//! Averages of disordered cones need not be convex: a cell loses its reflex corners and is counted.

use glam::DVec2;

use super::super::force::NEIGHBOUR;
use super::super::relax::{Relaxed, quantized};
use super::pairs::{Body, Links, Pairs, mean_spacing};
use super::repair::DEGENERATE;
use super::sectors::Sectors;
use super::texture::LARGEST_RADIUS;

/// Most cones that share a corner.
const MOST: usize = 8;

/// Cells of the cones with `rows` 0 of a batch.
#[derive(Debug, Default)]
pub(super) struct Walls {
    start: Vec<u32>,
    corner: Vec<DVec2>,
    /// Close pair, void, concave.
    flags: Vec<[bool; 3]>,
}

impl Walls {
    /// Corners of a cell, absolute, counter-clockwise.
    pub(super) fn polygon(&self, i: usize) -> &[DVec2] {
        &self.corner[self.start[i] as usize..self.start[i + 1] as usize]
    }

    /// Whether the cone has a degenerate neighbour, a void beside it, and a cell that lost a corner.
    pub(super) fn flags(&self, i: usize) -> [bool; 3] {
        self.flags[i]
    }
}

/// The graph of neighbours of a batch.
struct Graph<'a> {
    at: &'a [DVec2],
    bodies: &'a [Body],
    links: Links,
}

/// Builds the cells.
pub(super) fn averaged_walls(batch: &Relaxed) -> Walls {
    let n = batch.at.len();
    let bodies: Vec<Body> = (0..n)
        .map(|i| Body {
            at: batch.at[i],
            metric: batch.metric[i],
            radius: batch.radius[i],
            largest: LARGEST_RADIUS * batch.spacing[i],
            moves: false,
        })
        .collect();
    let sectors = Sectors::new(&batch.at, mean_spacing(&bodies));
    let links = Pairs::within(&bodies, &sectors, NEIGHBOUR).both_ways(&bodies, NEIGHBOUR);
    let graph = Graph { at: &batch.at, bodies: &bodies, links };
    let mut walls = Walls { start: vec![0], ..Walls::default() };
    for i in 0..n {
        let mut flags = [false; 3];
        if batch.rows[i] <= 0.0 {
            let first = walls.corner.len();
            flags[1] = graph.cell(i as u32, &mut walls.corner);
            flags[2] = make_convex(&mut walls.corner, first);
            let links = graph.links.of(i);
            flags[0] =
                links.iter().any(|&j| super::pairs::are_within(&bodies[i], &bodies[j as usize], DEGENERATE));
        }
        walls.flags.push(flags);
        walls.start.push(walls.corner.len() as u32);
    }
    walls
}

impl Graph<'_> {
    fn at(&self, i: u32) -> DVec2 {
        self.at[i as usize]
    }

    fn are_neighbours(&self, a: u32, b: u32) -> bool {
        self.links.of(a as usize).contains(&b)
    }

    /// Whether the lines a-b and c-d cross.
    fn cross(&self, [a, b]: [u32; 2], [c, d]: [u32; 2]) -> bool {
        let side = |p: u32, q: u32, r: u32| (self.at(q) - self.at(p)).perp_dot(self.at(r) - self.at(p));
        side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
    }

    /// Lines between neighbours that cross the line a-b.
    fn crossings(&self, a: u32, b: u32) -> Vec<[u32; 2]> {
        let mut found = Vec::new();
        // One end of a crossing line at least is a neighbour of a or of b; try both.
        for near in [a, b] {
            for &c in self.links.of(near as usize) {
                for &d in self.links.of(c as usize) {
                    let line = [c.min(d), c.max(d)];
                    let apart = ![a, b].contains(&c) && ![a, b].contains(&d);
                    if apart && !found.contains(&line) && self.cross([a, b], line) {
                        found.push(line);
                    }
                }
            }
        }
        found.sort_unstable();
        found
    }

    /// D of a pair, squared.
    fn d2(&self, a: u32, b: u32) -> f64 {
        let (p, n) = (&self.bodies[a as usize], &self.bodies[b as usize]);
        let reach = p.radius + n.radius;
        super::pairs::distance2(p, n) / (reach * reach)
    }

    /// Whether the line a-b stands: no shorter line crosses it without all four cones being mutual neighbours.
    fn stands(&self, a: u32, b: u32) -> bool {
        let line = [a.min(b), a.max(b)];
        self.crossings(a, b).into_iter().all(|other| {
            let mutual = [a, b].iter().all(|&p| other.iter().all(|&q| self.are_neighbours(p, q)));
            mutual || (self.d2(line[0], line[1]), line) < (self.d2(other[0], other[1]), other)
        })
    }

    /// The cones of all lines that hang together with a-b by crossings, sorted.
    fn group(&self, a: u32, b: u32) -> Vec<u32> {
        let mut lines = vec![[a.min(b), a.max(b)]];
        let mut cones = lines[0].to_vec();
        let mut next = 0;
        while next < lines.len() && cones.len() < MOST {
            let [p, q] = lines[next];
            next += 1;
            for line in self.crossings(p, q) {
                if !lines.contains(&line) && self.stands(line[0], line[1]) {
                    lines.push(line);
                    cones.extend(line);
                }
            }
            cones.sort_unstable();
            cones.dedup();
        }
        cones
    }

    /// Appends the corners of the cell of `p`; true when a void is beside it.
    fn cell(&self, p: u32, corners: &mut Vec<DVec2>) -> bool {
        let here = self.at(p);
        let mut around: Vec<(f64, u32, bool)> = Vec::new();
        for &n in self.links.of(p as usize) {
            if self.stands(p, n) {
                let crossed = self.crossings(p, n).iter().any(|l| self.stands(l[0], l[1]));
                around.push((super::sectors::turn(self.at(n) - here), n, crossed));
            }
        }
        around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // Start at a line that nothing crosses.
        let Some(first) = around.iter().position(|a| !a.2) else { return true };
        around.rotate_left(first);
        let mut void = false;
        let mut i = 0;
        while i < around.len() {
            let next = (i + 1..around.len()).find(|&k| !around[k].2);
            let (u, v) = (around[i].1, around[next.unwrap_or(0)].1);
            if next.unwrap_or(around.len()) > i + 1 {
                corners.push(self.mean(&self.group(p, around[i + 1].1)));
            } else if self.are_neighbours(u, v) && self.stands(u, v) {
                let mut three = [p, u, v];
                three.sort_unstable();
                corners.push(self.mean(&three));
            } else {
                void = true;
                for n in [u, v] {
                    corners.push(self.mean(&[p.min(n), p.max(n)]));
                }
            }
            i = next.unwrap_or(around.len());
        }
        void
    }

    /// The average of the centres of sorted cones: the same bits for each of them.
    fn mean(&self, cones: &[u32]) -> DVec2 {
        let first = self.at(cones[0]);
        let sum: DVec2 = cones.iter().map(|&c| self.at(c) - first).sum();
        quantized(first + sum / cones.len() as f64)
    }
}

/// Takes doubled corners and those at which the polygon from `first` on turns right out; true when one was reflex.
fn make_convex(corner: &mut Vec<DVec2>, first: usize) -> bool {
    let mut concave = false;
    loop {
        let n = corner.len() - first;
        let at = |m: usize| corner[first + m % n];
        let found = (0..n).find(|&m| n > 1 && at(m) == at(m + 1)).map(|m| (m, false)).or_else(|| {
            (0..n)
                .find(|&m| n > 3 && (at(m) - at(m + n - 1)).perp_dot(at(m + 1) - at(m)) < 0.0)
                .map(|m| (m, true))
        });
        let Some((m, reflex)) = found else { return concave };
        concave |= reflex;
        corner.remove(first + m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retina::clip::area;
    use crate::retina::local::Metric;
    use crate::retina::mosaic::morton;

    fn batch(at: Vec<DVec2>, wanted: f64) -> Relaxed {
        let n = at.len();
        let mut batch = Relaxed {
            rows: at.iter().map(|p| f64::from(u8::from(p.abs().max_element() > wanted))).collect(),
            id: at.iter().map(|p| morton(*p)).collect(),
            at,
            radius: vec![0.5; n],
            spacing: vec![1.0; n],
            ..Relaxed::default()
        };
        batch.metric = vec![Metric { xx: 1.0, xy: 0.0, yy: 1.0 }; n];
        batch
    }

    /// Squares meet in corners of four cones (5d), hexagons in corners of three (5b).
    #[test]
    fn lattices() {
        let grid = |step: DVec2| {
            (-6..=6)
                .flat_map(|a| (-6..=6).map(move |b| DVec2::X * f64::from(a) + step * f64::from(b)))
                .collect::<Vec<_>>()
        };
        for (step, corners, size) in
            [(DVec2::Y, 4, 1.0), (DVec2::new(0.5, 0.75_f64.sqrt()), 6, 0.75_f64.sqrt())]
        {
            let batch = batch(grid(step), 1.1);
            let walls = averaged_walls(&batch);
            for i in (0..batch.at.len()).filter(|&i| batch.rows[i] <= 0.0) {
                assert_eq!(walls.polygon(i).len(), corners);
                assert!((area(walls.polygon(i)) - size).abs() < 1e-4);
                assert_eq!(walls.flags(i), [false; 3]);
            }
        }
    }

    /// Five mutual neighbours meet in one corner; five that are not leave a void with two corners for each (5c).
    #[test]
    fn pentagons() {
        for (side, void) in [(0.9, false), (1.1, true)] {
            let radius = side / (2.0 * (std::f64::consts::PI / 5.0).sin());
            let at: Vec<DVec2> = (0..5)
                .map(|k| DVec2::from_angle(f64::from(k) * std::f64::consts::TAU / 5.0) * radius)
                .collect();
            let bodies: Vec<Body> = at
                .iter()
                .map(|&at| Body {
                    at,
                    metric: batch(vec![at], 1.0).metric[0],
                    radius: 0.5,
                    largest: 0.5,
                    moves: false,
                })
                .collect();
            let links =
                Pairs::within(&bodies, &Sectors::new(&at, 1.0), NEIGHBOUR).both_ways(&bodies, NEIGHBOUR);
            let graph = Graph { at: &at, bodies: &bodies, links };
            for p in 0..5 {
                let mut corners = Vec::new();
                graph.cell(p, &mut corners);
                let middle = corners.iter().any(|c| c.length() < 1e-4);
                assert_eq!(middle, !void, "{side} {p} {corners:?}");
            }
        }
    }
}
