//! Which cones are neighbours: those that share a wall of their cells (§15.4, last paragraph).
//!
//! The walls are the retina's own. Where the aperture is smaller than the cell, the cell is the aperture grown about the cone's centre by
//! sqrt(cell area/aperture area). Two cells share a wall where a side of the one runs back along a side of the other (within 0.03 spacings,
//! more than limited cells and rounding need) for at least 0.1 spacings, the shortest wall that cells have: cones that meet only at a
//! corner of four or five are not neighbours. Spacings are of the hexagonal lattice with the cell's area; lengths are
//! measured across the cones (`local`). The relation is symmetric.
//!
//! A cone is an edge cone when a side of its cell has no neighbour over 0.1 spacings or more: at the edge of the region, of
//! the retina, of the optic disc, at a void or a lost cone.
//!
//! # Cost
//! Measured: 4.6 µs a cone, one thread (29,449 cones in 0.14 s); 29 bytes a cone kept.

use glam::DVec2;

use super::grid::Grid;
use super::local::{Frame, local};
use super::mosaic::Retina;

/// Shortest shared wall, in spacings.
const SHORTEST: f64 = 0.1;
/// Two sides are one wall up to this distance, in spacings.
const APART: f64 = 0.03;

/// Neighbours of every cone of a retina, by their index in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NeighbourGraph {
    start: Vec<u32>,
    neighbour: Vec<u32>,
    edge: Vec<bool>,
}

impl NeighbourGraph {
    /// The graph of a retina.
    pub fn new(retina: &Retina) -> Self {
        let cells = Cells::new(retina);
        let mut pairs = Vec::new();
        let mut covered = vec![0.0; cells.corner.len()];
        let mean_reach = cells.reach.iter().sum::<f64>() / cells.reach.len().max(1) as f64;
        let grid = Grid::new(&cells.centre, 2.0 * mean_reach);
        for (i, (&centre, &reach)) in cells.centre.iter().zip(&cells.reach).enumerate() {
            // A pair is found once, from the cell that reaches farther.
            grid.near(centre, 2.0 * reach, |j| {
                let other = j as usize;
                let first = (cells.reach[other], other) < (reach, i);
                if first && cells.centre[other].distance(centre) <= reach + cells.reach[other] {
                    let pair = (i.min(other), i.max(other));
                    if cells.shared(retina, pair, &mut covered) {
                        pairs.push((pair.0 as u32, pair.1 as u32));
                        pairs.push((pair.1 as u32, pair.0 as u32));
                    }
                }
            });
        }
        pairs.sort_unstable();
        let mut start = vec![0; retina.len() + 1];
        for &(i, _) in &pairs {
            start[i as usize + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let edge = (0..retina.len()).map(|i| cells.is_open(retina, i, &covered)).collect();
        Self { start, neighbour: pairs.into_iter().map(|(_, j)| j).collect(), edge }
    }

    /// Number of cones.
    pub fn len(&self) -> usize {
        self.edge.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.edge.is_empty()
    }

    /// The neighbours of a cone, ascending; none when there is no such cone.
    pub fn neighbours(&self, cone: u32) -> &[u32] {
        let Some(&[from, to]) = self.start.get(cone as usize..).and_then(|s| s.first_chunk()) else {
            return &[];
        };
        &self.neighbour[from as usize..to as usize]
    }

    /// Whether a part of the cone's wall has no neighbour.
    pub fn is_edge(&self, cone: u32) -> bool {
        self.edge.get(cone as usize).copied().unwrap_or(true)
    }

    /// First entry of each cone in [`NeighbourGraph::neighbour`]; one more than cones.
    pub fn start(&self) -> &[u32] {
        &self.start
    }

    /// The neighbours of cone after cone.
    pub fn neighbour(&self) -> &[u32] {
        &self.neighbour
    }

    /// Cones by their number of hops from `cone`, 0 to `n`, each generation ascending; shorter when no cone is farther, empty
    /// when there is no such cone.
    pub fn generations(&self, cone: u32, n: usize) -> Vec<Vec<u32>> {
        let mut generations: Vec<Vec<u32>> = Vec::new();
        if cone as usize >= self.len() {
            return generations;
        }
        let mut last = vec![cone];
        while !last.is_empty() && generations.len() < n {
            let mut next: Vec<u32> = last.iter().flat_map(|&c| self.neighbours(c)).copied().collect();
            next.sort_unstable();
            next.dedup();
            // A neighbour of a generation is in it, in the one before or in the next.
            let before = generations.last();
            next.retain(|c| {
                last.binary_search(c).is_err() && before.is_none_or(|b| b.binary_search(c).is_err())
            });
            generations.push(std::mem::replace(&mut last, next));
        }
        if !last.is_empty() {
            generations.push(last);
        }
        generations
    }
}

/// Full cells, absolute, µm of the chart.
struct Cells {
    start: Vec<usize>,
    corner: Vec<DVec2>,
    centre: Vec<DVec2>,
    /// Distance of the farthest corner.
    reach: Vec<f64>,
    /// Spacing across the cone.
    spacing: Vec<f64>,
}

impl Cells {
    fn new(retina: &Retina) -> Self {
        let n = retina.len();
        let mut cells = Self {
            start: vec![0],
            corner: Vec::with_capacity(retina.polygon_xy.len() / 2),
            centre: Vec::with_capacity(n),
            reach: Vec::with_capacity(n),
            spacing: Vec::with_capacity(n),
        };
        for i in 0..n {
            let centre = retina.center(i);
            let (area, aperture) = (f64::from(retina.cell_area_um2[i]), f64::from(retina.aperture_um2[i]));
            let grow = if aperture > 0.0 { (area / aperture).sqrt() } else { 1.0 };
            let mut reach = 0.0_f64;
            for corner in retina.polygon(i) {
                let arm = (corner - centre) * grow;
                reach = reach.max(arm.length());
                cells.corner.push(centre + arm);
            }
            cells.start.push(cells.corner.len());
            cells.centre.push(centre);
            // A hair more, so that cells that touch are found.
            cells.reach.push(reach * (1.0 + APART));
            cells.spacing.push((area / 0.75_f64.sqrt()).sqrt());
        }
        cells
    }

    /// The sides of a cell as (slot, from, to), µm across a cone about `origin`.
    fn sides(
        &self,
        i: usize,
        frame: Frame,
        origin: DVec2,
    ) -> impl Iterator<Item = (usize, DVec2, DVec2)> + '_ {
        let (first, count) = (self.start[i], self.start[i + 1] - self.start[i]);
        let at = move |m: usize| frame.plane_from_chart(self.corner[first + m % count] - origin);
        (0..count).map(move |m| (first + m, at(m), at(m + 1)))
    }

    /// Whether two cells share a wall; what they share is added to `covered` of their sides.
    fn shared(&self, retina: &Retina, (i, j): (usize, usize), covered: &mut [f64]) -> bool {
        let origin = self.centre[i];
        let frame = local(&retina.params.geometry, origin).metric.frame();
        let spacing = 0.5 * (self.spacing[i] + self.spacing[j]);
        let mut total = 0.0;
        for (slot, a, b) in self.sides(i, frame, origin) {
            for (other, c, d) in self.sides(j, frame, origin) {
                let length = overlap([a, b], [c, d], APART * spacing);
                if length > 0.0 {
                    total += length;
                    covered[slot] += length;
                    covered[other] += length;
                }
            }
        }
        total >= SHORTEST * spacing
    }

    /// Whether a part of a side of cell `i` is not covered.
    fn is_open(&self, retina: &Retina, i: usize, covered: &[f64]) -> bool {
        let frame = local(&retina.params.geometry, self.centre[i]).metric.frame();
        let mut sides = self.sides(i, frame, self.centre[i]);
        sides.any(|(slot, a, b)| a.distance(b) - covered[slot] >= SHORTEST * self.spacing[i])
    }
}

/// Length over which the side c → d runs back along the side a → b, no farther from it than `apart`.
fn overlap([a, b]: [DVec2; 2], [c, d]: [DVec2; 2], apart: f64) -> f64 {
    let side = b - a;
    let length = side.length();
    let along = side / length.max(f64::MIN_POSITIVE);
    if along.perp_dot(c - a).abs() > apart || along.perp_dot(d - a).abs() > apart {
        return 0.0;
    }
    // For two cells that do not overlap c is farther along than d.
    along.dot(c - a).min(length) - along.dot(d - a).max(0.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::mosaic::{ConeType, Cones};
    use super::super::types::Kind;
    use super::super::{RegionUm, RetinaParams, build_region};
    use super::*;

    pub(in super::super) fn patch(centre: DVec2, half: f64) -> Retina {
        let region = RegionUm { min: centre - half, max: centre + half };
        build_region(&RetinaParams::default(), &region).unwrap()
    }

    /// `rings` of hexagonal cells, 3 µm apart, about a cone; half of each cell is aperture.
    pub(in super::super) fn hexagons(rings: i32) -> Retina {
        let mut cones = Cones::default();
        let kind = Kind { cone_type: ConeType::L, pointing: [0.0; 2] };
        for b in -rings..=rings {
            for a in -rings..=rings {
                if (a + b).abs() <= rings {
                    let at =
                        3.0 * DVec2::new(f64::from(a) + 0.5 * f64::from(b), 0.75_f64.sqrt() * f64::from(b));
                    let turn = |k: i32| std::f64::consts::FRAC_PI_3 * (f64::from(k) + 0.5);
                    let cell: Vec<DVec2> =
                        (0..6).map(|k| at + 3.0_f64.sqrt() * DVec2::from_angle(turn(k))).collect();
                    cones.push(cones.len() as u64, at, kind, &cell, 1.0, 0.5);
                }
            }
        }
        let region = RegionUm { min: DVec2::splat(-1e3), max: DVec2::splat(1e3) };
        Retina::gather(&[&cones], &region, &RetinaParams::default())
    }

    /// The cone nearest to a place.
    pub(in super::super) fn nearest(retina: &Retina, at: DVec2) -> u32 {
        let distance = |i: &usize| retina.center(*i).distance(at);
        (0..retina.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap() as u32
    }

    #[test]
    fn hexagons_have_the_neighbours_of_a_lattice() {
        let retina = hexagons(4);
        let graph = NeighbourGraph::new(&retina);
        let sizes: Vec<usize> =
            graph.generations(nearest(&retina, DVec2::ZERO), 9).iter().map(Vec::len).collect();
        assert_eq!(sizes, [1, 6, 12, 18, 24]);
        assert_eq!((0..61).filter(|&c| graph.is_edge(c)).count(), 24);
        assert_eq!(graph.generations(61, 2).len(), 0);
    }

    #[test]
    fn few_cones() {
        for (rings, edges) in [(0, 0), (1, 12)] {
            let retina = hexagons(rings);
            let graph = NeighbourGraph::new(&retina);
            assert_eq!((graph.len(), graph.neighbour().len()), (retina.len(), 2 * edges));
            let open = (0..graph.len() as u32).filter(|&c| graph.is_edge(c)).count();
            assert_eq!(open, [1, 6][rings as usize]);
        }
        let none =
            Retina::gather(&[], &RegionUm { min: DVec2::ZERO, max: DVec2::ONE }, &RetinaParams::default());
        let graph = NeighbourGraph::new(&none);
        assert!(graph.is_empty() && graph.neighbours(0).is_empty() && graph.is_edge(0));
        assert!(graph.generations(0, 3).is_empty());
    }

    /// Symmetric, sorted, planar: by Euler six neighbours on the mean in the interior, less two for each corner of four and four for each
    /// corner of five: walls under 0.1 spacings, 2 to 3 % of all.
    #[test]
    fn mosaics_give_planar_graphs() {
        for (at, half) in
            [(DVec2::ZERO, 80.0), (DVec2::new(600.0, 0.0), 200.0), (DVec2::new(-9_000.0, 9_000.0), 300.0)]
        {
            let retina = patch(at, half);
            let graph = NeighbourGraph::new(&retina);
            assert_eq!(graph, NeighbourGraph::new(&retina));
            let (mut inner, mut degree) = (0.0, 0.0);
            for i in 0..graph.len() as u32 {
                let near = graph.neighbours(i);
                assert!(near.is_sorted() && !near.contains(&i));
                assert!(near.iter().all(|&j| graph.neighbours(j).contains(&i)));
                if !graph.is_edge(i) {
                    (inner, degree) = (inner + 1.0, degree + near.len() as f64);
                    assert!((3..=12).contains(&near.len()), "{near:?}");
                }
            }
            let rim = 1.0 - inner / graph.len() as f64;
            let expected = 5.0 / (graph.len() as f64).sqrt();
            assert!((5.8..6.0).contains(&(degree / inner)), "{at} {}", degree / inner);
            assert!(rim < expected, "{rim} {expected}");
        }
    }
}
