//! Engine `expected`: the exact mean of every cone's count.
//!
//! Photons of a Poisson source that are lost or counted independently give independent Poisson counts, so a mean per cone and one
//! draw per cone is the same distribution as following every photon. In pixel coordinates the density of counts is
//! `I(x) = Σ_k N_k Σ_ij a_k[ij] (rect_k * drift_k * K_k)(x - x_ij)`; its Fourier coefficients on the period (P_x, P_y) are
//! `N_k Â_k(ν) R_k(ν) D_k(ν) K_k(ν) / (P_x P_y)`. Each basis kernel gives one image; a cone's mean is the sum of its images'
//! integrals over its aperture ([`super::spread`], [`super::gather`]) with its own coefficients.
//!
//! # Cost
//! Per frame one small transform per primary, half an inverse transform of the grid per basis image (those of the rows that cones lie in)
//! and a sparse gather per cone; independent of luminance.

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::arriving::ConeSum;
use super::cones::{ConeTable, MappedCone};
use super::drive::drive;
use super::gather::{LANES, Sheet, Stencils};
use super::grid::{Band, Planar, Real};
use super::images::{Transforms, two_images};
use super::inputs::Inputs;
use super::kernel::Kernels;
use super::picture_spectrum::PictureSpectrum;
use super::scene::Scene;
use super::source::{Source, pixel_transform};
use super::spectral::ARRIVING;
use super::spread::Spread;
use crate::display::Emitter;
use crate::plan::Numerics;

/// Means of one frame.
#[derive(Clone, Debug)]
pub struct Means {
    /// Isomerizations by cone.
    pub isomerized: Vec<f64>,
    /// Photons that arrive inside all apertures (with the pupil's apodization in them).
    pub arrived: f64,
    /// The same after the cones' pointing errors.
    pub guided: f64,
    /// Cones whose mean came out below 0 (rounding, ringing) and was set to 0.
    pub clamped: u64,
}

/// A basis kernel at the kept frequencies, by primary.
pub type BasisKernel = Vec<Planar<f32>>;

/// A prepared scene.
pub struct Expected {
    scene: Scene,
    band: Band,
    /// `[primary][frequency]`: transform of the pixel's rectangles over P_x P_y φ̂_x φ̂_y.
    pixels: Vec<Vec<Complex64>>,
    pictures: PictureSpectrum,
    /// Whether images are transformed in single precision.
    single: bool,
    /// Of isomerizations.
    basis: Vec<BasisKernel>,
    stencils: Stencils,
    /// Coefficients of the cones' images, `[cone][sheet][lane]`, with the cone's own factor in them; 0 for a type that is not computed.
    coefficients: Vec<[f64; LANES]>,
    arrived: ConeSum,
    guided: ConeSum,
}

impl Expected {
    /// Prepares a scene's cones and kernels.
    pub fn new(inputs: &Inputs, cones: &ConeTable, settings: &Numerics) -> Self {
        let Inputs { kernels, projector, .. } = inputs;
        let scene = inputs.scene.clone();
        let spread = Spread::new(settings.spread_width, 1.6);
        let band = Band::new(scene.period_px, scene.samples, scene.band * scene.tangent_per_px);
        let pixels = pixel_transforms(&scene, &spread, &band, &projector.emitters);
        let size = scene.size_px.map(|s| s as usize);
        let pictures = PictureSpectrum::new(size, scene.period_px, &band, settings.single);
        let seeing = seeing(kernels, cones, settings.blind_below);
        let basis = basis_kernels(&scene, kernels, &band, 0);
        let arriving = basis_kernels(&scene, kernels, &band, ARRIVING);
        let stencils = Stencils::new(&scene, &spread, cones);
        let received: Vec<Vec<f64>> = (cones.cones.par_iter())
            .map(|c| {
                kernels
                    .coefficients(ARRIVING, c.um, c.ecc_deg)
                    .into_iter()
                    .map(|own| own * c.geometry)
                    .collect()
            })
            .collect();
        let sum = |weight: &dyn Fn(&MappedCone) -> f64| {
            let weights: Vec<f64> = cones.cones.iter().map(weight).collect();
            ConeSum::new(&arriving, &received, &weights, &stencils, &band, scene.samples)
        };
        let (arrived, guided) = (sum(&|_| 1.0), sum(&|c| c.pointing));
        let coefficients = coefficients(kernels, seeing, cones);
        Self {
            scene,
            pixels,
            pictures,
            single: settings.single,
            basis,
            stencils,
            coefficients,
            arrived,
            guided,
            band,
        }
    }

    /// Means of one frame of a source.
    pub fn frame(&self, source: &Source) -> Means {
        if self.single { self.frame_in::<f32>(source) } else { self.frame_in::<f64>(source) }
    }

    fn frame_in<T: Real>(&self, source: &Source) -> Means {
        let drive: Vec<Planar<T>> = drive(source, &self.pixels, &self.pictures, (&self.scene, &self.band));
        let transforms = Transforms::new(self.scene.samples);
        let pair = |kernels: &[BasisKernel]| {
            let second = kernels.get(1).map_or(&[][..], Vec::as_slice);
            two_images(&self.band, [&kernels[0], second], &drive, &transforms, self.stencils.rows())
        };
        let sheets: Vec<Sheet> = self
            .basis
            .par_chunks(LANES)
            .map(|kernels| {
                let pairs: Vec<_> = kernels.chunks(2).map(pair).collect();
                self.stencils.sheet(pairs, &transforms)
            })
            .collect();
        let (arrived, guided) = (self.arrived.of(&drive), self.guided.of(&drive));
        self.gather(&sheets, arrived, guided)
    }

    fn gather(&self, sheets: &[Sheet], arrived: f64, guided: f64) -> Means {
        let values: Vec<f64> = self
            .coefficients
            .par_chunks(sheets.len())
            .enumerate()
            .with_min_len(256)
            .map(|(cone, coefficients)| {
                let part = |(sheet, coefficients): (&Sheet, &[f64; LANES])| {
                    let integrals = self.stencils.integrals(cone, sheet);
                    integrals.iter().zip(coefficients).map(|(i, c)| f64::from(*i) * c).sum::<f64>()
                };
                sheets.iter().zip(coefficients).map(part).sum()
            })
            .collect();
        let clamped = values.iter().filter(|v| **v < 0.0).count() as u64;
        Means { isomerized: values.into_iter().map(|v| v.max(0.0)).collect(), arrived, guided, clamped }
    }
}

/// Coefficients of the cones' images, `[cone][sheet][lane]`.
fn coefficients(kernels: &Kernels, seeing: [bool; ARRIVING], cones: &ConeTable) -> Vec<[f64; LANES]> {
    let sheets = kernels.rank(0).div_ceil(LANES);
    let mut coefficients = vec![[0.0; LANES]; sheets * cones.cones.len()];
    coefficients.par_chunks_mut(sheets.max(1)).zip(&cones.cones).for_each(|(lanes, cone)| {
        let kind = cone.cone_type as usize;
        if seeing[kind] {
            let factor = cone.geometry * cone.pointing;
            for (r, own) in kernels.coefficients(kind, cone.um, cone.ecc_deg).into_iter().enumerate() {
                lanes[r / LANES][r % LANES] = own * factor;
            }
        }
    });
    coefficients
}

/// `[primary][frequency]`: transform of the pixel's rectangles, divided by the period's area and by the spreading kernel's.
fn pixel_transforms(
    scene: &Scene,
    spread: &Spread,
    band: &Band,
    emitters: &[Emitter],
) -> Vec<Vec<Complex64>> {
    let [px, py] = scene.period_px.map(|p| p as f64);
    let table = |samples: usize| -> Vec<f64> {
        (0..=samples / 2).map(|n| spread.transform(n as f64 / samples as f64)).collect()
    };
    let (along_x, along_y) = (table(scene.samples[0]), table(scene.samples[1]));
    let transform = |emitter: &Emitter| {
        let at = |[x, y]: [i32; 2]| {
            let cycles = DVec2::new(f64::from(x) / px, f64::from(y) / py);
            let spreading = along_x[x.unsigned_abs() as usize] * along_y[y.unsigned_abs() as usize];
            pixel_transform(emitter, cycles) / (px * py * spreading)
        };
        band.iter().map(at).collect()
    };
    emitters.iter().map(transform).collect()
}

/// Which types of cones are computed: those that catch more than `blind_below` of what the best one does.
fn seeing(kernels: &Kernels, cones: &ConeTable, blind_below: f64) -> [bool; ARRIVING] {
    let catches: [f64; ARRIVING] = std::array::from_fn(|kind| {
        let Some(cone) = cones.cones.iter().find(|c| c.cone_type as usize == kind) else { return 0.0 };
        let own = kernels.coefficients(kind, cone.um, cone.ecc_deg);
        let primaries = 0..kernels.spec().primaries.len();
        let of =
            |p: usize| own.iter().enumerate().map(|(r, c)| c * kernels.table(kind, r, p)[0].re).sum::<f64>();
        primaries.map(of).fold(0.0, f64::max)
    });
    let best = catches.into_iter().fold(0.0, f64::max);
    catches.map(|catch| catch > 0.0 && catch >= blind_below * best)
}

/// The basis kernels of a kind on the kept frequencies.
fn basis_kernels(scene: &Scene, kernels: &Kernels, band: &Band, kind: usize) -> Vec<BasisKernel> {
    let shape = kernels.shape();
    let [px, py] = scene.period_px.map(|p| p as f64);
    let stencils: Vec<_> = band
        .iter()
        .map(|[x, y]| {
            // Screen y is up, pixel y is down.
            let cycles = DVec2::new(f64::from(x) / px, -f64::from(y) / py) / scene.tangent_per_px;
            shape.stencil(cycles)
        })
        .collect();
    let of_primary = |r: usize, primary: usize| {
        let table = kernels.table(kind, r, primary);
        let value = |s: &Option<_>| s.as_ref().map_or(Complex64::ZERO, |s| shape.read(table, s));
        Planar::new(stencils.iter().map(value))
    };
    let primaries = kernels.spec().primaries.len();
    (0..kernels.rank(kind))
        .into_par_iter()
        .map(|r| (0..primaries).map(|primary| of_primary(r, primary)).collect())
        .collect()
}
