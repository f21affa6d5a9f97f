//! What all cones together receive, without the image that each of them sees.
//!
//! The ledger of photons asks for Σ_cones w_cone ∫ I over the cone's aperture, I the image of arriving photons: one number. With
//! the cones' stencils added up on the grid, W_g = Σ_cones w_cone stencil_g, it is Σ_g W_g I_g = Re Σ_ν m_ν c_ν conj(Ŵ_ν), c the image's
//! coefficients at the kept half of the frequencies, m = 2 but for ν = 0, Ŵ the transform of W: no image is made and no cone visited
//! in any frame.

use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::expected::BasisImage;
use super::gather::Stencils;
use super::grid::{Band, Planar, Real, picture_spectrum};

/// `[primary][frequency]`: weights by which what the display sends adds to a sum over cones.
#[derive(Clone, Debug)]
pub struct ConeSum(Vec<Vec<Complex64>>);

impl ConeSum {
    /// The sum over cones with `weights[cone]`, given each cone's `coefficients[cone][r]` of the basis `images`.
    pub fn new(
        images: &[BasisImage],
        coefficients: &[Vec<f64>],
        weights: &[f64],
        stencils: &Stencils,
        band: &Band,
        samples: [usize; 2],
    ) -> Self {
        let spectra: Vec<Vec<Complex64>> = (0..images.len())
            .into_par_iter()
            .map(|r| {
                let mut grid = vec![0.0; samples[0] * samples[1]];
                for (cone, (own, weight)) in coefficients.iter().zip(weights).enumerate() {
                    stencils.add(cone, own[r] * weight, &mut grid, samples);
                }
                picture_spectrum(&grid, samples, samples, band)
            })
            .collect();
        let primaries = images.first().map_or(0, |image| image.kernels.len());
        let by_primary = (0..primaries).map(|primary| {
            let at = |(i, nu): (usize, [i32; 2])| {
                let twice = if nu == [0, 0] { 1.0 } else { 2.0 };
                let kernel = |r: usize| images[r].kernels[primary].at(i);
                twice * (0..images.len()).map(|r| kernel(r) * spectra[r][i].conj()).sum::<Complex64>()
            };
            band.iter().enumerate().map(at).collect()
        });
        Self(by_primary.collect())
    }

    /// The sum in a frame of which `drive[primary][frequency]` is sent.
    pub fn of<T: Real>(&self, drive: &[Planar<T>]) -> f64 {
        let part = |(weights, sent): (&Vec<Complex64>, &Planar<T>)| {
            weights.iter().enumerate().map(|(i, w)| (w * sent.at(i)).re).sum::<f64>()
        };
        self.0.iter().zip(drive).map(part).sum()
    }
}
