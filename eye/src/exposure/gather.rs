//! From images on the grid to cones: each cone's weights, and the sums over them.
//!
//! Four images stand side by side at each sample of a sheet, which holds the samples that cones read; where these go all around the period
//! it repeats its first columns and rows at its end, so that no stencil has to wrap around.

use glam::Vec4;
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::cones::{ConeTable, MappedCone};
use super::grid::Real;
use super::images::{Span, Transforms};
use super::scene::Scene;
use super::spread::{Spread, polygon_nodes};

/// Images side by side.
pub const LANES: usize = 4;

/// The weights of all cones on the grid.
#[derive(Default)]
pub struct Stencils {
    cones: Vec<Stencil>,
    weights: Vec<f32>,
    /// Columns and rows that cones read.
    spans: [Span; 2],
}

#[derive(Clone, Copy)]
struct Stencil {
    first: [u32; 2],
    size: [u32; 2],
    offset: usize,
}

/// Four images at the samples of the spans, `[y][x]`.
pub struct Sheet(Vec<Vec4>);

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
            all.cones.push(Stencil { first: cone.first, size: cone.size, offset });
        }
        all.spans = [0, 1].map(|axis| {
            let run = |stencil: &Stencil| (stencil.first[axis] as usize, stencil.size[axis] as usize);
            Span::new(scene.samples[axis], all.cones.iter().map(run))
        });
        all
    }

    /// Rows of the grid that cones read.
    pub fn rows(&self) -> &Span {
        &self.spans[1]
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

    /// A sheet of one or two pairs of images of the rows that cones read, transformed along y.
    pub fn sheet<T: Real>(&self, mut pairs: Vec<Vec<Complex<T>>>, transforms: &Transforms<T>) -> Sheet {
        let [across, down] = self.spans;
        let columns = transforms.samples[0];
        let mut sheet = Vec::with_capacity(across.len * down.len);
        let mut scratch = Vec::new();
        for row in 0..down.distinct() {
            for pair in &mut pairs {
                transforms.process(0, &mut pair[row * columns..][..columns], &mut scratch);
            }
            let own = row * columns..(row + 1) * columns;
            let Some(first) = pairs.first().map(|pair| &pair[own.clone()]) else { break };
            let second = pairs.get(1).map(|pair| &pair[own]);
            for range in across.ranges() {
                let first = first[range.clone()].iter().map(|z| [z.re.single(), z.im.single()]);
                match second {
                    Some(second) => sheet.extend(
                        first
                            .zip(&second[range])
                            .map(|([a, b], z)| Vec4::new(a, b, z.re.single(), z.im.single())),
                    ),
                    None => sheet.extend(first.map(|[a, b]| Vec4::new(a, b, 0.0, 0.0))),
                }
            }
        }
        for row in down.distinct()..down.len {
            let same = (row - down.period) * across.len;
            sheet.extend_from_within(same..same + across.len);
        }
        Sheet(sheet)
    }

    /// Integrals of the images of a sheet over a cone's aperture.
    pub fn integrals(&self, cone: usize, sheet: &Sheet) -> [f32; LANES] {
        let ([first_x, first_y], [nx, _], weights) = self.of(cone);
        let [across, down] = &self.spans;
        let corner = down.place(first_y) * across.len + across.place(first_x);
        // Even and odd columns apart: two chains of additions, in a fixed order.
        let (mut even, mut odd) = (Vec4::ZERO, Vec4::ZERO);
        for (dy, line) in weights.chunks_exact(nx.max(1)).enumerate() {
            let row = &sheet.0[corner + dy * across.len..][..nx];
            let ((weights, _), (samples, _)) = (line.as_chunks::<2>(), row.as_chunks::<2>());
            for (w, s) in weights.iter().zip(samples) {
                even += w[0] * s[0];
                odd += w[1] * s[1];
            }
        }
        (even + odd).to_array()
    }
}
