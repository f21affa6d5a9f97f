//! What all cones together receive, without the image that each of them sees.
//!
//! The ledger of photons asks for Σ_cones w_cone ∫ I over the cone's aperture, I the image of arriving photons: one number. With
//! the cones' stencils added up on the grid, W_g = Σ_cones w_cone stencil_g, it is Σ_g W_g I_g = Re Σ_ν m_ν c_ν conj(Ŵ_ν), c the image's
//! coefficients at the kept half of the frequencies, m = 2 but for ν = 0, Ŵ the transform of W: no image is made and no cone visited
//! in any frame.

use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::basis::BasisTable;
use super::gather::Stencils;
use super::grid::{Band, Planar, Real, Run, dot};
use super::picture_spectrum::PictureSpectrum;

/// `[primary][frequency]`: conjugates of the weights by which what the display sends adds to a sum over cones.
#[derive(Clone, Debug)]
pub struct ConeSum(Vec<Planar<f32>>);

impl ConeSum {
    /// The sum over cones with `weights[cone]`, given each cone's `coefficients[cone][r]` of the `basis`.
    pub fn new(
        basis: &BasisTable,
        coefficients: &[Vec<f64>],
        weights: &[f64],
        stencils: &Stencils,
        band: &Band,
        samples: [usize; 2],
    ) -> Self {
        let spectrum = PictureSpectrum::new(samples, samples, band, false);
        let spectra: Vec<Vec<Complex64>> = (0..basis.images)
            .into_par_iter()
            .map(|r| {
                let mut grid = vec![0.0; samples[0] * samples[1]];
                for (cone, (own, weight)) in coefficients.iter().zip(weights).enumerate() {
                    stencils.add(cone, own[r] * weight, &mut grid, samples);
                }
                spectrum.of(&grid, band)
            })
            .collect();
        let by_primary = (0..basis.primaries).map(|primary| {
            let of_run = |run: &Run| -> Vec<Complex64> {
                let at = |i: usize| {
                    let twice = if [run.x, run.y + i as i32] == [0, 0] { 1.0 } else { 2.0 };
                    let of_image = |(image, spectrum): (usize, &Vec<Complex64>)| {
                        let (re, im) = basis.of(run, image, primary);
                        Complex64::new(f64::from(re[i]), -f64::from(im[i])) * spectrum[run.at + i]
                    };
                    twice * spectra.iter().enumerate().map(of_image).sum::<Complex64>()
                };
                (0..run.len).map(at).collect()
            };
            Planar::new(band.runs.iter().flat_map(of_run))
        });
        Self(by_primary.collect())
    }

    /// The sum in a frame of which `drive[primary][frequency]` is sent.
    pub fn of<T: Real>(&self, drive: &[Planar<T>]) -> f64 {
        let part = |(weights, sent): (&Planar<f32>, &Planar<T>)| {
            dot(&weights.re, &sent.re) + dot(&weights.im, &sent.im)
        };
        self.0.iter().zip(drive).map(part).sum()
    }
}
