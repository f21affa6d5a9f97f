//! From images on the grid to cones: each cone's weights, and the sums over them.
//!
//! Four images stand side by side at each sample of a sheet, so that a cone's weights are read once for all images of its kind; the sheet
//! repeats its first columns and rows at its end, so that no stencil has to wrap around.

use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::cones::{ConeTable, MappedCone};
use super::grid::{Columns, Real, Transforms};
use super::scene::Scene;
use super::spread::{Spread, polygon_nodes};

/// Images side by side.
pub const LANES: usize = 4;
/// Rows that are transformed together: what a cache line holds of a column.
const ROWS: usize = 8;

/// The weights of all cones on the grid.
#[derive(Default)]
pub struct Stencils {
    cones: Vec<Stencil>,
    weights: Vec<f32>,
    /// Most columns and rows of a stencil.
    most: [usize; 2],
}

#[derive(Clone, Copy)]
struct Stencil {
    first: [u32; 2],
    size: [u32; 2],
    offset: usize,
}

/// Four images, `[y][x][lane]`, with their first columns and rows once more at the end.
pub struct Sheet {
    values: Vec<[f32; LANES]>,
    pitch: usize,
}

impl Stencils {
    /// The weights of a scene's cones.
    pub fn new(scene: &Scene, spread: &Spread, cones: &ConeTable) -> Self {
        let per_px = scene.samples_per_px();
        let weights_of = |cone: &MappedCone| {
            // Positions in samples, areas in pixels.
            let nodes: Vec<_> =
                polygon_nodes(&cone.polygon_px).into_iter().map(|(p, w)| (p * per_px, w)).collect();
            spread.weights(&nodes, scene.samples)
        };
        let gathered: Vec<_> = cones.cones.par_iter().map(weights_of).collect();
        let mut all = Self::default();
        for cone in gathered {
            let offset = all.weights.len();
            all.weights.extend(cone.values);
            let size = cone.size.map(|s| s as usize);
            all.most = [all.most[0].max(size[0]), all.most[1].max(size[1])];
            all.cones.push(Stencil { first: cone.first, size: cone.size, offset });
        }
        all
    }

    fn of(&self, cone: usize) -> ([usize; 2], [usize; 2], &[f32]) {
        let stencil = self.cones[cone];
        let size = stencil.size.map(|v| v as usize);
        (stencil.first.map(|v| v as usize), size, &self.weights[stencil.offset..][..size[0] * size[1]])
    }

    /// Adds a cone's weights times `factor` to a grid `[y][x]`.
    pub fn add(&self, cone: usize, factor: f64, grid: &mut [f64], [columns, rows]: [usize; 2]) {
        let ([first_x, first_y], [nx, _], weights) = self.of(cone);
        for (dy, line) in weights.chunks_exact(nx.max(1)).enumerate() {
            let row = &mut grid[((first_y + dy) % rows) * columns..][..columns];
            for (dx, weight) in line.iter().enumerate() {
                row[(first_x + dx) % columns] += factor * f64::from(*weight);
            }
        }
    }

    /// A sheet of one or two pairs of images.
    pub fn sheet<T: Real>(&self, pairs: &[Columns<T>], transforms: &Transforms<T>) -> Sheet {
        let [columns, rows] = transforms.samples;
        let pitch = columns + self.most[0];
        let mut values = vec![[0.0; LANES]; pitch * (rows + self.most[1])];
        let mut block = vec![Complex::new(T::zero(), T::zero()); ROWS.min(rows) * columns];
        let mut scratch = Vec::new();
        for top in (0..rows).step_by(ROWS) {
            let count = ROWS.min(rows - top);
            for (pair, images) in pairs.iter().enumerate() {
                let block = &mut block[..count * columns];
                images.rows(transforms, top, block, &mut scratch);
                for (row, line) in block.chunks_exact(columns).enumerate() {
                    let sheet = &mut values[(top + row) * pitch..][..columns];
                    for (lanes, z) in sheet.iter_mut().zip(line) {
                        (lanes[2 * pair], lanes[2 * pair + 1]) = (z.re.single(), z.im.single());
                    }
                }
            }
            for line in values[top * pitch..(top + count) * pitch].chunks_exact_mut(pitch) {
                for column in columns..pitch {
                    line[column] = line[column % columns];
                }
            }
        }
        for row in rows..rows + self.most[1] {
            values.copy_within((row % rows) * pitch..(row % rows + 1) * pitch, row * pitch);
        }
        Sheet { values, pitch }
    }

    /// Integrals of the images of a sheet over a cone's aperture.
    pub fn integrals(&self, cone: usize, sheet: &Sheet) -> [f32; LANES] {
        let ([first_x, first_y], [nx, _], weights) = self.of(cone);
        // Even and odd columns apart: two chains of additions, in a fixed order.
        let (mut even, mut odd) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for (dy, line) in weights.chunks_exact(nx.max(1)).enumerate() {
            let row = &sheet.values[(first_y + dy) * sheet.pitch + first_x..][..nx];
            let ((weights, _), (samples, _)) = (line.as_chunks::<2>(), row.as_chunks::<2>());
            for (w, s) in weights.iter().zip(samples) {
                for lane in 0..LANES {
                    even[lane] += w[0] * s[0][lane];
                    odd[lane] += w[1] * s[1][lane];
                }
            }
        }
        std::array::from_fn(|lane| even[lane] + odd[lane])
    }
}
