//! A low-rank basis at the kept frequencies, in the order in which frames read it.

use glam::DVec2;
use rayon::prelude::*;
#[cfg(test)]
use rustfft::num_complex::Complex64;

use super::grid::{Band, Run};
use super::kernel::Kernels;
use super::scene::Scene;

/// The basis kernels of a kind of cones: `[run][image][primary]`, then real and imaginary parts of the run's frequencies. A frame reads
/// all of it once, from start to end.
#[derive(Clone, Debug, Default)]
pub struct BasisTable {
    /// Basis kernels, each of which gives an image.
    pub images: usize,
    /// Primaries of the display.
    pub primaries: usize,
    values: Vec<f32>,
}

impl BasisTable {
    /// The basis of a kind on the kept frequencies of a scene.
    pub fn new(scene: &Scene, kernels: &Kernels, band: &Band, kind: usize) -> Self {
        let shape = kernels.shape();
        let [px, py] = scene.period_px.map(|p| p as f64);
        let (images, primaries) = (kernels.rank(kind), kernels.shares().len());
        let of_run = |run: &Run| -> Vec<f32> {
            let stencils: Vec<_> = (0..run.len)
                .map(|i| {
                    // Screen y is up, pixel y is down.
                    let cycles = DVec2::new(f64::from(run.x) / px, -f64::from(run.y + i as i32) / py);
                    shape.stencil(cycles / scene.tangent_per_px)
                })
                .collect();
            let mut values = Vec::with_capacity(2 * images * primaries * run.len);
            for (image, primary) in (0..images).flat_map(|image| (0..primaries).map(move |p| (image, p))) {
                let mut kernel = shape.read_all(kernels.table(kind, image, primary), &stencils);
                // A table's directions differ at frequency 0 in the imaginary part, which is none there.
                if (run.x, run.y) == (0, 0) {
                    kernel[0].im = 0.0;
                }
                values.extend(kernel.iter().map(|z| z.re as f32));
                values.extend(kernel.iter().map(|z| z.im as f32));
            }
            values
        };
        let runs: Vec<Vec<f32>> = band.runs.par_iter().map(of_run).collect();
        Self { images, primaries, values: runs.concat() }
    }

    /// Kernels `[image][primary][frequency]` as a table.
    #[cfg(test)]
    pub fn for_test(kernels: &[Vec<Vec<Complex64>>], band: &Band) -> Self {
        let mut values = Vec::new();
        for run in &band.runs {
            for kernel in kernels.iter().flatten() {
                values.extend(kernel[run.range()].iter().map(|z| z.re as f32));
                values.extend(kernel[run.range()].iter().map(|z| z.im as f32));
            }
        }
        Self { images: kernels.len(), primaries: kernels.first().map_or(0, Vec::len), values }
    }

    /// Real and imaginary parts of an image's kernel for a primary on a run.
    #[inline]
    pub fn of(&self, run: &Run, image: usize, primary: usize) -> (&[f32], &[f32]) {
        let before = self.images * self.primaries * run.at + (image * self.primaries + primary) * run.len;
        self.values[2 * before..][..2 * run.len].split_at(run.len)
    }
}
