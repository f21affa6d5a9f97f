//! From images on the grid to cones: each cone's weights, and the sums over them.
//!
//! Lines of images hold the columns that cones read; where these go all around the period they repeat their first ones at their end, so that
//! no stencil has to wrap around.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;

use super::cones::{ConeTable, MappedCone};
use super::grid::Real;
use super::images::{SHEET, Sheet, Span};
use super::scene::Scene;
use super::spread::{COLUMNS, Spread, SpreadTable, Stencil, polygon_nodes};

/// Cones whose weights are made together.
const CONES: usize = 1024;

/// The weights of all cones on the grid.
#[derive(Default)]
pub struct Stencils {
    cones: Vec<Stencil>,
    weights: Vec<f32>,
    /// Columns and rows that cones read.
    spans: [Span; 2],
}

impl Stencils {
    /// The weights of a scene's cones.
    pub fn new(scene: &Scene, spread: &Spread, cones: &ConeTable) -> Self {
        let per_px = scene.samples_per_px();
        let spread = SpreadTable::new(spread);
        let weights_of = |cones: &[MappedCone]| {
            let mut weights = Vec::new();
            let of_cone = |cone: &MappedCone| {
                let mut nodes = polygon_nodes(&cone.polygon_px);
                // Positions in samples, areas in pixels.
                for (place, _) in &mut nodes {
                    *place *= per_px;
                }
                spread.weights(&nodes, scene.samples, &mut weights)
            };
            (cones.iter().map(of_cone).collect::<Vec<Stencil>>(), weights)
        };
        let gathered: Vec<_> = cones.cones.par_chunks(CONES).map(weights_of).collect();
        let mut all = Self::default();
        all.weights.reserve_exact(gathered.iter().map(|(_, weights)| weights.len()).sum());
        for (cones, weights) in gathered {
            let before = all.weights.len();
            all.cones.extend(cones.iter().map(|cone| Stencil { offset: before + cone.offset, ..*cone }));
            all.weights.extend_from_slice(&weights);
        }
        all.spans = [0, 1].map(|axis| {
            let run = |stencil: &Stencil| (stencil.first[axis] as usize, stencil.size[axis] as usize);
            Span::new(scene.samples[axis], all.cones.iter().map(run))
        });
        all
    }

    /// Cones.
    pub fn len(&self) -> usize {
        self.cones.len()
    }

    /// Columns and rows of the grid that cones read.
    pub fn spans(&self) -> &[Span; 2] {
        &self.spans
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
            let (inside, around) = line.split_at(line.len().min(columns - first_x));
            for (sum, weight) in row[first_x..].iter_mut().zip(inside) {
                *sum += factor * f64::from(*weight);
            }
            for (sum, weight) in row.iter_mut().zip(around) {
                *sum += factor * f64::from(*weight);
            }
        }
    }

    /// Adds to some cones' sums the integrals of a sheet's images over their apertures times the cones' coefficients, `[cone][image]`.
    pub fn gather<T: Real>(
        &self,
        sheet: &Sheet<T>,
        cones: Range<usize>,
        coefficients: &[f32],
        sums: &mut [f64],
    ) {
        match sheet.fours {
            1 => gather::<T, 1>(self, sheet, cones, coefficients, sums),
            2 => gather::<T, 2>(self, sheet, cones, coefficients, sums),
            3 => gather::<T, 3>(self, sheet, cones, coefficients, sums),
            _ => gather::<T, { SHEET / 4 }>(self, sheet, cones, coefficients, sums),
        }
    }
}

/// As [`Stencils::gather`] for a sheet of F fours of images.
#[multiversion(targets("x86_64+avx2"))]
fn gather<T: Real, const F: usize>(
    stencils: &Stencils,
    sheet: &Sheet<T>,
    cones: Range<usize>,
    coefficients: &[f32],
    sums: &mut [f64],
) {
    let [across, down] = &stencils.spans;
    for ((cone, own), sum) in cones.zip(coefficients.chunks_exact(4 * F)).zip(sums) {
        let ([x, y], [nx, _], weights) = stencils.of(cone);
        let (left, top) = (across.place(x), down.place(y));
        // Even and odd columns apart: two chains of additions, in a fixed order.
        let (mut even, mut odd) = ([T::Four::default(); F], [T::Four::default(); F]);
        for (dy, line) in weights.chunks_exact(nx.max(1)).enumerate() {
            let row = sheet.rows[(top + dy) % sheet.rows.len()].as_chunks::<F>().0;
            let samples = row[left..left + nx].as_chunks::<COLUMNS>().0;
            for (w, s) in line.as_chunks::<COLUMNS>().0.iter().zip(samples) {
                for four in 0..F {
                    even[four] += s[0][four] * T::of(w[0]);
                    odd[four] += s[1][four] * T::of(w[1]);
                }
            }
        }
        let mut all = 0.0;
        for four in 0..F {
            let images = T::wide_four(even[four] + odd[four]);
            for (image, own) in images.iter().zip(&own[4 * four..]) {
                all += image * f64::from(*own);
            }
        }
        *sum += all;
    }
}
