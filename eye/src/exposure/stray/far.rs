//! Light from afar: blocks of the display, the wider the farther they are.
//!
//! `V(x) = Σ_b Σ_i L_bi e_bi S(θ_xbi) (1 − χ(θ_xbi))`: light L of node i of block b ([`super::lattice`]), e
//! what of it enters the pupil. The blocks of a level are leaves, two by two of those of the level before,
//! with [`NODES`] nodes along a side; for a point x a block counts as one when it is no wider than [`WIDTH`]
//! of its distance. A quadratic of a function that falls as θ⁻³ over a quarter of the distance is off by 0.5
//! % at most. Points are [`STEP_DEG`] apart, with cubics between: what is left is smooth over
//! [`near::FROM_DEG`](super::near).

use glam::DVec2;
use rayon::prelude::*;

use super::angle::Scatter;
use super::chart::{Chart, Points, Screen, angle_deg};
use super::lattice::{Axis, Lattice, chebyshev, lagrange, overhang};
use super::near::{FROM_DEG, near_part};
use crate::display::Emitter;

/// Widest block, parts of its distance.
const WIDTH: f64 = 0.25;
/// Side of a leaf, and nodes along a side of every block.
const LEAF_DEG: f64 = 0.15;
const NODES: usize = 3;
const ALL: usize = NODES * NODES;
/// Most levels: 2^10 leaves along a side.
const MOST_LEVELS: u32 = 11;
/// Distance of the points, degrees.
const STEP_DEG: f64 = 0.2;

/// Blocks of a level.
#[derive(Clone, Copy, Debug)]
struct Level {
    /// Number of the first block, all levels together.
    first: usize,
    /// Blocks across and down.
    size: [usize; 2],
    /// Side, pixels.
    side_px: f64,
}

/// The far light of a tile.
pub struct Far {
    points: Points,
    lattice: Lattice,
    /// Leaves first.
    levels: Vec<Level>,
    blocks: usize,
    /// `[half][parent's node][node]`: along an axis, from a block to the one above.
    up: [[[f64; NODES]; NODES]; 2],
    /// By point: blocks with the weights of their nodes.
    sources: Vec<Vec<(u32, [f32; ALL])>>,
}

/// What looks for the blocks of a point.
struct Search<'a> {
    screen: &'a Screen<'a>,
    scatter: &'a Scatter,
    levels: &'a [Level],
    first_px: DVec2,
    /// The node's places in a block, 0 to 1.
    nodes: Vec<f64>,
}

impl Search<'_> {
    /// Adds a block's part in what a point receives, or those of the blocks that it is made of.
    fn add(&self, place: (usize, [usize; 2]), way: glam::DVec3, list: &mut Vec<(u32, [f32; ALL])>) {
        let (number, [column, row]) = place;
        let level = &self.levels[number];
        if column >= level.size[0] || row >= level.size[1] {
            return;
        }
        let corner = self.first_px + level.side_px * DVec2::new(column as f64, row as f64);
        let theta = angle_deg(self.screen.way(corner + 0.5 * level.side_px), way);
        let side_deg = level.side_px / self.screen.px_per_deg();
        if theta + side_deg < FROM_DEG {
            return;
        }
        if number > 0 && side_deg > WIDTH * theta {
            for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                self.add((number - 1, [2 * column + x, 2 * row + y]), way, list);
            }
            return;
        }
        let weight = |i: usize| {
            let px = corner + level.side_px * DVec2::new(self.nodes[i % NODES], self.nodes[i / NODES]);
            let theta = angle_deg(self.screen.way(px), way);
            let far = 1.0 - near_part(theta);
            if far > 0.0 { (far * self.scatter.per_sr(theta) * self.screen.entering(px)) as f32 } else { 0.0 }
        };
        list.push(((level.first + row * level.size[0] + column) as u32, std::array::from_fn(weight)));
    }
}

impl Far {
    /// Over receivers in a rectangle of places.
    pub fn new(
        screen: &Screen,
        (chart, bounds): (&Chart, [DVec2; 2]),
        emitters: &[Emitter],
        scatter: &Scatter,
    ) -> Self {
        let size = screen.size.map(f64::from);
        let hang = [overhang(emitters, 0), overhang(emitters, 1)];
        let from = DVec2::new(hang[0][0], hang[1][0]);
        let length = DVec2::new(size[0] - 1.0 + hang[0][1], size[1] - 1.0 + hang[1][1]) - from;
        let least = length.max_element() / f64::from(1 << (MOST_LEVELS - 1));
        let leaf_px = (LEAF_DEG * screen.px_per_deg()).max(least);
        let leaves = (length / leaf_px).ceil().to_array().map(|n| (n as usize).max(1));
        let axes = [0, 1].map(|axis| Axis::new(from[axis], leaf_px, leaves[axis], NODES));
        let lattice = Lattice::new(axes, screen.size.map(|size| 0..size), emitters);
        let (levels, blocks) = levels(leaves, leaf_px);
        let nodes = chebyshev(NODES);
        let mut up = [[[0.0; NODES]; NODES]; 2];
        for (half, up) in up.iter_mut().enumerate() {
            for (k, node) in nodes.iter().enumerate() {
                lagrange(&nodes, 0.5 * (half as f64 + node), |i, value| up[i][k] = value);
            }
        }
        let points = Points::new(bounds, STEP_DEG, |n| n);
        let search = Search { screen, scatter, levels: &levels, first_px: from, nodes };
        let of_point = |i: usize| {
            let way = chart.way(points.at([i % points.size[0], i / points.size[0]]));
            let mut list = Vec::new();
            search.add((levels.len() - 1, [0, 0]), way, &mut list);
            list
        };
        let sources = (0..points.size[0] * points.size[1]).into_par_iter().map(of_point).collect();
        Self { points, lattice, levels, blocks, up, sources }
    }

    /// V of an emitter at the points, from the light of all pixels of the display, `width` in a row.
    pub fn light(&self, emitter: usize, pixels: &[f64], width: usize) -> Vec<f64> {
        let blocks = self.block_light(&self.lattice.light(emitter, pixels, width));
        let value = |list: &Vec<(u32, [f32; ALL])>| {
            let of_block = |(block, weights): &(u32, [f32; ALL])| {
                let nodes = &blocks[*block as usize];
                weights.iter().zip(nodes).map(|(weight, light)| f64::from(*weight) * light).sum::<f64>()
            };
            list.iter().map(of_block).sum()
        };
        self.sources.par_iter().map(value).collect()
    }

    /// Light of all blocks' nodes from that of the lattice's nodes.
    fn block_light(&self, nodes: &[f64]) -> Vec<[f64; ALL]> {
        let mut blocks = vec![[0.0; ALL]; self.blocks];
        let across = self.levels[0].size[0];
        for (number, block) in blocks[..across * self.levels[0].size[1]].iter_mut().enumerate() {
            let corner = number / across * NODES * across * NODES + number % across * NODES;
            for (row, line) in block.chunks_exact_mut(NODES).enumerate() {
                line.copy_from_slice(&nodes[corner + row * across * NODES..][..NODES]);
            }
        }
        for pair in self.levels.windows(2) {
            let [below, above] = [pair[0], pair[1]];
            for number in 0..below.size[0] * below.size[1] {
                let (column, row) = (number % below.size[0], number / below.size[0]);
                let light = blocks[below.first + number];
                if light.iter().all(|light| light.abs() <= 0.0) {
                    continue;
                }
                let [by_column, by_row] = [column % 2, row % 2].map(|half| &self.up[half]);
                let to = &mut blocks[above.first + row / 2 * above.size[0] + column / 2];
                for (node, to) in to.iter_mut().enumerate() {
                    let (across, down) = (&by_column[node % NODES], &by_row[node / NODES]);
                    let rows = light.chunks_exact(NODES).zip(down);
                    let row = |(line, down): (&[f64], &f64)| {
                        down * line.iter().zip(across).map(|(light, weight)| light * weight).sum::<f64>()
                    };
                    *to += rows.map(row).sum::<f64>();
                }
            }
        }
        blocks
    }

    /// V at a place.
    pub fn read(&self, values: &[f64], place_deg: DVec2) -> f64 {
        self.points.read(|at| values[at], &self.points.stencil(place_deg))
    }
}

/// Levels of blocks, up to one block, and the number of all blocks.
fn levels(leaves: [usize; 2], leaf_px: f64) -> (Vec<Level>, usize) {
    let mut levels = vec![Level { first: 0, size: leaves, side_px: leaf_px }];
    let mut blocks = leaves[0] * leaves[1];
    while let Some(last) = levels.last().copied().filter(|level| level.size != [1, 1]) {
        let size = last.size.map(|n| n.div_ceil(2));
        levels.push(Level { first: blocks, size, side_px: 2.0 * last.side_px });
        blocks += size[0] * size[1];
    }
    (levels, blocks)
}
