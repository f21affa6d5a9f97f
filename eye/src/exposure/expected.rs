//! Engine `expected`: the exact mean of every cone's count.
//!
//! Photons of a Poisson source that are lost or counted independently give independent Poisson counts, so a mean per cone and one
//! draw per cone is the same distribution as following every photon. In pixel coordinates the density of counts is
//! `I(x) = Σ_k N_k Σ_ij a_k[ij] (rect_k * drift_k * K_k)(x - x_ij)`; its Fourier coefficients on the period (P_x, P_y) are
//! `N_k Â_k(ν) R_k(ν) D_k(ν) K_k(ν) / (P_x P_y)`. Each basis kernel gives one image; a cone's mean is the sum of its images'
//! integrals over its aperture ([`super::spread`]) with its own coefficients.
//!
//! # Cost
//! Per frame one small transform per primary, half an inverse transform of the grid per basis image and a sparse gather per cone;
//! independent of luminance.

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::{Complex32, Complex64};

use super::arriving::ConeSum;
use super::cones::{ConeTable, MappedCone};
use super::grid::{Frequency, picture_spectrum, two_images};
use super::inputs::Inputs;
use super::kernel::Kernels;
use super::scene::Scene;
use super::source::{Source, SourcePrimary, pixel_transform};
use super::spectral::KINDS;
use super::spread::{LANES, Spread, polygon_nodes};
use crate::display::Emitter;

/// Index of the kind that counts arriving photons.
pub const ARRIVING: usize = KINDS.len() - 1;

/// Numerical settings.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Width of the spreading kernel, samples.
    pub spread_width: usize,
    /// Transform images in single precision (relative error about 1e-6 of the brightest).
    pub single: bool,
}

impl Settings {
    /// Settings for an accuracy target.
    pub fn for_target(target: f64) -> Self {
        let spread_width = match target {
            t if t >= 0.005 => 6,
            t if t >= 5e-4 => 8,
            _ => 10,
        };
        Self { spread_width, single: target >= 5e-4 }
    }
}

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

/// One basis image.
pub struct BasisImage {
    kind: usize,
    /// `[primary][frequency]`.
    pub kernels: Vec<Vec<Complex32>>,
}

/// The weights of all cones on the grid.
#[derive(Default)]
pub struct Stencils {
    stencils: Vec<Stencil>,
    weights: Vec<f32>,
}

struct Stencil {
    first: [u32; 2],
    size: [u32; 2],
    offset: usize,
}

/// A prepared scene.
pub struct Expected {
    scene: Scene,
    frequencies: Vec<Frequency>,
    /// `[primary][frequency]`: transform of the pixel's rectangles over P_x P_y φ̂_x φ̂_y.
    pixels: Vec<Vec<Complex64>>,
    /// Whether images are transformed in single precision.
    single: bool,
    /// Images of isomerizations, those of a kind together.
    images: Vec<BasisImage>,
    stencils: Stencils,
    /// By cone: coefficients of its kind's images, with the cone's own factor in them.
    coefficients: Vec<Vec<f64>>,
    kinds: Vec<usize>,
    arrived: ConeSum,
    guided: ConeSum,
}

impl Expected {
    /// Prepares a scene's cones and kernels.
    pub fn new(inputs: &Inputs, cones: &ConeTable, settings: Settings) -> Self {
        let Inputs { kernels, projector, .. } = inputs;
        let scene = inputs.scene.clone();
        let spread = Spread::new(settings.spread_width, 1.6);
        let frequencies = kept_frequencies(&scene);
        let pixels = pixel_transforms(&scene, &spread, &frequencies, &projector.emitters);
        let mut images = basis_images(&scene, kernels, &frequencies, cones);
        let arriving = images.split_off(images.iter().take_while(|image| image.kind != ARRIVING).count());
        let stencils = Stencils::new(&scene, &spread, cones);
        let of_cones = |kind: &(dyn Fn(&MappedCone) -> usize + Sync),
                        factor: &(dyn Fn(&MappedCone) -> f64 + Sync)| {
            let of_cone = |cone: &MappedCone| {
                let own = kernels.coefficients(kind(cone), cone.um, cone.ecc_deg);
                own.into_iter().map(|c| c * factor(cone)).collect()
            };
            cones.cones.par_iter().map(of_cone).collect::<Vec<Vec<f64>>>()
        };
        let coefficients = of_cones(&|c| c.cone_type as usize, &|c| c.geometry * c.pointing);
        let received = of_cones(&|_| ARRIVING, &|c| c.geometry);
        let sum = |weight: &dyn Fn(&MappedCone) -> f64| {
            let weights: Vec<f64> = cones.cones.iter().map(weight).collect();
            ConeSum::new(&arriving, &received, &weights, &stencils, &frequencies, scene.samples)
        };
        let (arrived, guided) = (sum(&|_| 1.0), sum(&|c| c.pointing));
        Self {
            scene,
            pixels,
            single: settings.single,
            images,
            stencils,
            coefficients,
            kinds: cones.cones.iter().map(|c| c.cone_type as usize).collect(),
            arrived,
            guided,
            frequencies,
        }
    }

    /// Means of one frame of a source.
    pub fn frame(&self, source: &Source) -> Means {
        let drive = self.drive(source);
        let pairs: Vec<[usize; 2]> =
            (0..self.images.len()).step_by(2).map(|i| [i, (i + 1).min(self.images.len() - 1)]).collect();
        let grids: Vec<Vec<f32>> = pairs
            .par_iter()
            .map(|&[a, b]| {
                let (first, second) =
                    (self.coefficients_of_image(a, &drive), self.coefficients_of_image(b, &drive));
                if self.single {
                    two_images::<f32>(&self.frequencies, &first, &second, self.scene.samples)
                } else {
                    two_images::<f64>(&self.frequencies, &first, &second, self.scene.samples)
                }
            })
            .collect::<Vec<_>>()
            .into_iter()
            .flatten()
            .take(self.images.len())
            .collect();
        let (arrived, guided) = (self.arrived.of(&drive), self.guided.of(&drive));
        self.gather(&grids, arrived, guided)
    }

    /// `[primary][frequency]`: what the display sends, before the eye.
    fn drive(&self, source: &Source) -> Vec<Vec<Complex64>> {
        let [px, py] = self.scene.period_px;
        let size = self.scene.size_px.map(|s| s as usize);
        let sent = |(primary, pixel): (&SourcePrimary, &Vec<Complex64>)| {
            let mut sent = vec![Complex64::ZERO; self.frequencies.len()];
            for layer in &primary.layers {
                let spectrum = picture_spectrum(&layer.light, size, [px, py], &self.frequencies);
                let add = |(((nu, pixel), light), sum): (
                    ((&Frequency, &Complex64), &Complex64),
                    &mut Complex64,
                )| {
                    let cycles = DVec2::new(f64::from(nu.x) / px as f64, f64::from(nu.y) / py as f64);
                    *sum += light * pixel * layer.movement(cycles);
                };
                let terms = self.frequencies.par_iter().zip(pixel).zip(&spectrum).zip(&mut sent);
                terms.with_min_len(4096).for_each(add);
            }
            sent
        };
        source.primaries.iter().zip(&self.pixels).map(sent).collect()
    }

    fn coefficients_of_image(&self, image: usize, drive: &[Vec<Complex64>]) -> Vec<Complex64> {
        let mut sum = vec![Complex64::ZERO; self.frequencies.len()];
        for (kernel, sent) in self.images[image].kernels.iter().zip(drive) {
            for ((s, k), d) in sum.iter_mut().zip(kernel).zip(sent) {
                *s += d * Complex64::new(f64::from(k.re), f64::from(k.im));
            }
        }
        sum
    }

    fn gather(&self, grids: &[Vec<f32>], arrived: f64, guided: f64) -> Means {
        let values: Vec<f64> = (0..self.kinds.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|cone| {
                let kind = self.kinds[cone];
                let own = grids.iter().zip(&self.images).filter(|(_, image)| image.kind == kind);
                let parts = own.zip(&self.coefficients[cone]).map(|((grid, _), coefficient)| {
                    coefficient * self.stencils.integral(cone, grid, self.scene.samples)
                });
                parts.sum()
            })
            .collect();
        let clamped = values.iter().filter(|v| **v < 0.0).count() as u64;
        Means { isomerized: values.into_iter().map(|v| v.max(0.0)).collect(), arrived, guided, clamped }
    }
}

impl Stencils {
    fn new(scene: &Scene, spread: &Spread, cones: &ConeTable) -> Self {
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
            all.stencils.push(Stencil { first: cone.first, size: cone.size, offset });
        }
        all
    }

    fn of(&self, cone: usize) -> ([usize; 2], [usize; 2], &[f32]) {
        let stencil = &self.stencils[cone];
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

    /// Integral of one image over a cone's aperture.
    fn integral(&self, cone: usize, grid: &[f32], [columns, rows]: [usize; 2]) -> f64 {
        let ([first_x, first_y], [nx, _], weights) = self.of(cone);
        // Rows are sums of four lanes, so that they are computed four at a time; their order is fixed.
        let mut lanes = [0.0_f32; LANES];
        for (dy, line) in weights.chunks_exact(nx.max(1)).enumerate() {
            let row = &grid[((first_y + dy) % rows) * columns..][..columns];
            if first_x + nx <= columns {
                let (line, _) = line.as_chunks::<LANES>();
                let (row, _) = row[first_x..first_x + nx].as_chunks::<LANES>();
                for (w, g) in line.iter().zip(row) {
                    (0..LANES).for_each(|i| lanes[i] += w[i] * g[i]);
                }
            } else {
                for (dx, w) in line.iter().enumerate() {
                    lanes[dx % LANES] += w * row[(first_x + dx) % columns];
                }
            }
        }
        lanes.iter().map(|lane| f64::from(*lane)).sum()
    }
}

/// Frequencies of the half plane inside the band.
fn kept_frequencies(scene: &Scene) -> Vec<Frequency> {
    let [px, py] = scene.period_px.map(|p| p as f64);
    let band_px = scene.band * scene.tangent_per_px;
    // The grid cannot tell its highest frequency from its negative.
    let limit = |p: f64, samples: usize| ((band_px * p) as i32).min(samples as i32 / 2 - 1);
    let (most_x, most_y) = (limit(px, scene.samples[0]), limit(py, scene.samples[1]));
    let mut kept = Vec::new();
    for x in -most_x..=most_x {
        for y in 0..=most_y {
            let cycles = DVec2::new(f64::from(x) / px, f64::from(y) / py);
            if (y > 0 || x >= 0) && cycles.length() <= band_px {
                kept.push(Frequency { x, y });
            }
        }
    }
    kept
}

/// `[primary][frequency]`: transform of the pixel's rectangles, divided by the period's area and by the spreading kernel's.
fn pixel_transforms(
    scene: &Scene,
    spread: &Spread,
    frequencies: &[Frequency],
    emitters: &[Emitter],
) -> Vec<Vec<Complex64>> {
    let [px, py] = scene.period_px.map(|p| p as f64);
    let table = |samples: usize| -> Vec<f64> {
        (0..=samples / 2).map(|n| spread.transform(n as f64 / samples as f64)).collect()
    };
    let (along_x, along_y) = (table(scene.samples[0]), table(scene.samples[1]));
    let transform = |emitter: &Emitter| {
        let at = |nu: &Frequency| {
            let cycles = DVec2::new(f64::from(nu.x) / px, f64::from(nu.y) / py);
            let spreading = along_x[nu.x.unsigned_abs() as usize] * along_y[nu.y.unsigned_abs() as usize];
            pixel_transform(emitter, cycles) / (px * py * spreading)
        };
        frequencies.iter().map(at).collect()
    };
    emitters.iter().map(transform).collect()
}

/// Every basis kernel on the kept frequencies; kinds without cones are left out.
fn basis_images(
    scene: &Scene,
    kernels: &Kernels,
    frequencies: &[Frequency],
    cones: &ConeTable,
) -> Vec<BasisImage> {
    let shape = kernels.shape();
    let [px, py] = scene.period_px.map(|p| p as f64);
    let stencils: Vec<_> = frequencies
        .par_iter()
        .map(|nu| {
            // Screen y is up, pixel y is down.
            let cycles = DVec2::new(f64::from(nu.x) / px, -f64::from(nu.y) / py) / scene.tangent_per_px;
            shape.stencil(cycles)
        })
        .collect();
    let present = |kind: usize| kind == ARRIVING || cones.cones.iter().any(|c| c.cone_type as usize == kind);
    let jobs: Vec<(usize, usize)> = (0..KINDS.len())
        .filter(|&kind| present(kind))
        .flat_map(|kind| (0..kernels.rank(kind)).map(move |r| (kind, r)))
        .collect();
    jobs.par_iter()
        .map(|&(kind, r)| {
            let kernels = (0..kernels.spec().primaries.len())
                .map(|primary| {
                    let table = kernels.table(kind, r, primary);
                    let value = |s: &Option<_>| s.as_ref().map_or(Complex64::ZERO, |s| shape.read(table, s));
                    stencils.iter().map(value).map(|z| Complex32::new(z.re as f32, z.im as f32)).collect()
                })
                .collect();
            BasisImage { kind, kernels }
        })
        .collect()
}
