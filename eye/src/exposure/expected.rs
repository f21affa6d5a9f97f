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

use std::sync::Arc;

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::arriving::ConeSum;
use super::basis::BasisTable;
use super::cones::{ConeTable, MappedCone};
use super::drive::drive;
use super::gather::Stencils;
use super::grid::{Band, Planar, Real};
use super::images::{SHEET, Transforms, fours, sheets};
use super::kernel::Kernels;
use super::picture_spectrum::PictureSpectrum;
use super::primaries::Primaries;
use super::scene::Scene;
use super::source::{Source, pixel_transform};
use super::spectral::ARRIVING;
use super::spread::{COLUMNS, Spread};
use super::turned::Turning;
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

impl Means {
    /// Sets means below 0 to 0: when all light is in them, so that ringing around a bright pixel adds nothing to what is dim beside it.
    pub fn clamp(&mut self) {
        for mean in self.isomerized.iter_mut().filter(|mean| **mean < 0.0) {
            (*mean, self.clamped) = (0.0, self.clamped + 1);
        }
    }
}

/// Cones that are gathered together.
const CONES: usize = 512;

/// A prepared scene.
pub struct Expected {
    scene: Scene,
    band: Band,
    /// `[primary][frequency]`: transform of the pixel's rectangles over P_x P_y φ̂_x φ̂_y.
    pixels: Vec<Vec<Complex64>>,
    pictures: PictureSpectrum,
    transforms: Precision,
    /// Of isomerizations.
    basis: BasisTable,
    stencils: Stencils,
    /// How cones see the screen as the eye turns, with what their stencils are made of.
    turning: Option<(Turning, Spread, ConeTable)>,
    /// By sheet: coefficients of the cones' images, `[cone][image]`, with the cone's own factor in them; 0 for a type that is not computed.
    coefficients: Vec<Vec<f32>>,
    arrived: ConeSum,
    guided: ConeSum,
}

/// What is kept from one frame of a scene to the next: how the cones see the screen after the last turn of
/// the eye, in steps. Whatever is in it, frames are the same.
#[derive(Clone, Default)]
pub struct Memo(Option<([i64; 2], Arc<Turned>)>);

/// What the cones see after a turn of the eye.
struct Turned {
    stencils: Stencils,
    light: Vec<f64>,
}

/// The transforms of images, and the precision of all numbers at the kept frequencies.
enum Precision {
    Single(Transforms<f32>),
    Double(Transforms<f64>),
}

impl Expected {
    /// Prepares a scene's cones and kernels.
    pub fn new(
        scene: &Scene,
        primaries: &Primaries,
        (cones, turning): (&ConeTable, Option<Turning>),
        settings: &Numerics,
    ) -> Self {
        let Primaries { kernels, projector } = primaries;
        // Prepare the transforms of pixels and pictures, and the basis kernels at their frequencies.
        let scene = scene.clone();
        let spread = Spread::new(settings.spread_width, 1.6);
        let band = Band::new(scene.period_px, scene.samples, scene.band * scene.tangent_per_px);
        let pixels = pixel_transforms(&scene, &spread, &band, &projector.emitters);
        let size = scene.size_px.map(|s| s as usize);
        let pictures = PictureSpectrum::new(size, scene.period_px, &band, settings.single);
        let basis = BasisTable::new(&scene, kernels, &band, 0);
        let arriving = BasisTable::new(&scene, kernels, &band, ARRIVING);
        // Prepare what each cone reads of the images, and the sums over all cones.
        let seeing = seeing(kernels, cones, settings.blind_below);
        let stencils = Stencils::new(&scene, &spread, cones);
        let places: Vec<Vec<f64>> =
            cones.cones.par_iter().map(|c| kernels.weights(c.um, c.ecc_deg)).collect();
        let received: Vec<Vec<f64>> =
            places.par_iter().map(|place| kernels.coefficients_at(ARRIVING, place)).collect();
        let sum = |weight: &dyn Fn(&MappedCone) -> f64| {
            let weights: Vec<f64> = cones.cones.iter().map(weight).collect();
            ConeSum::new(&arriving, &received, &weights, &stencils, &band, scene.samples)
        };
        let (arrived, guided) = (sum(&|_| 1.0), sum(&|c| c.pointing));
        let coefficients = coefficients(kernels, seeing, cones, &places);
        let transforms = if settings.single {
            Precision::Single(Transforms::new(scene.samples))
        } else {
            Precision::Double(Transforms::new(scene.samples))
        };
        let turning = turning.map(|turning| (turning, spread, cones.clone()));
        Self {
            scene,
            band,
            pixels,
            pictures,
            transforms,
            basis,
            stencils,
            turning,
            coefficients,
            arrived,
            guided,
        }
    }

    /// Means of one frame of a source.
    pub fn frame(&self, source: &Source, index: u32, memo: &mut Memo) -> Means {
        let Some((turning, spread, cones)) = &self.turning else {
            return self.frame_by(source, &self.stencils);
        };
        let steps = turning.steps_in_frame(index);
        let last = memo.0.take().filter(|(of, _)| *of == steps);
        let turned = last.map_or_else(
            || {
                let (cones, light) = turning.after_steps(steps).cones(cones);
                Arc::new(Turned { stencils: Stencils::new(&self.scene, spread, &cones), light })
            },
            |(_, turned)| turned,
        );
        memo.0 = Some((steps, Arc::clone(&turned)));
        let mut means = self.frame_by(source, &turned.stencils);
        means.isomerized.iter_mut().zip(&turned.light).for_each(|(mean, light)| *mean *= light);
        means
    }

    fn frame_by(&self, source: &Source, stencils: &Stencils) -> Means {
        match &self.transforms {
            Precision::Single(transforms) => self.frame_in(source, transforms, stencils),
            Precision::Double(transforms) => self.frame_in(source, transforms, stencils),
        }
    }

    fn frame_in<T: Real>(&self, source: &Source, transforms: &Transforms<T>, stencils: &Stencils) -> Means {
        let drive: Vec<Planar<T>> = drive(source, &self.pixels, &self.pictures, (&self.scene, &self.band));
        let (arrived, guided) = (self.arrived.of(&drive), self.guided.of(&drive));
        let sheets = sheets((&self.band, &self.basis), &drive, transforms, stencils.spans(), COLUMNS);
        let mut values = vec![0.0; stencils.len()];
        values.par_chunks_mut(CONES).enumerate().for_each(|(part, values)| {
            let cones = part * CONES..part * CONES + values.len();
            for (sheet, coefficients) in sheets.iter().zip(&self.coefficients) {
                let images = 4 * sheet.fours;
                let own = &coefficients[cones.start * images..cones.end * images];
                stencils.gather(sheet, cones.clone(), own, values);
            }
        });
        Means { isomerized: values, arrived, guided, clamped: 0 }
    }
}

/// By sheet: coefficients of the cones' images, `[cone][image]`.
fn coefficients(
    kernels: &Kernels,
    seeing: [bool; ARRIVING],
    cones: &ConeTable,
    places: &[Vec<f64>],
) -> Vec<Vec<f32>> {
    let rank = kernels.rank(0);
    let of_sheet = |first: usize| {
        let images = 4 * fours(rank, first);
        let mut coefficients = vec![0.0; images * places.len()];
        let cones = cones.cones.par_iter().zip(places);
        coefficients.par_chunks_mut(images).zip(cones).for_each(|(own_images, (cone, place))| {
            let kind = cone.cone_type as usize;
            if seeing[kind] {
                let own = kernels.coefficients_at(kind, place);
                let images = own_images.iter_mut().zip(&own[first..]);
                images.for_each(|(to, own)| *to = (own * cone.pointing) as f32);
            }
        });
        coefficients
    };
    (0..rank).step_by(SHEET).map(of_sheet).collect()
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
        let primaries = 0..kernels.shares().len();
        let of =
            |p: usize| own.iter().enumerate().map(|(r, c)| c * kernels.table(kind, r, p)[0].re).sum::<f64>();
        primaries.map(of).fold(0.0, f64::max)
    });
    let best = catches.into_iter().fold(0.0, f64::max);
    catches.map(|catch| catch > 0.0 && catch >= blind_below * best)
}
