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
    /// Photons that arrive inside each aperture (with the pupil's apodization in them).
    pub arriving: Vec<f64>,
    /// Cones whose mean came out below 0 (rounding, ringing) and was set to 0.
    pub clamped: u64,
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
    /// (kind, `[primary][frequency]`) of each basis image.
    images: Vec<(usize, Vec<Vec<Complex32>>)>,
    stencils: Vec<Stencil>,
    weights: Vec<f32>,
    /// By cone: coefficients of its own kind's images, then of the arriving images.
    coefficients: Vec<Vec<f64>>,
    factors: Vec<[f64; 2]>,
    kinds: Vec<usize>,
}

impl Expected {
    /// Prepares a scene's cones and kernels.
    pub fn new(inputs: &Inputs, cones: &ConeTable, settings: Settings) -> Self {
        let Inputs { kernels, projector, .. } = inputs;
        let scene = inputs.scene.clone();
        let spread = Spread::new(settings.spread_width, 1.6);
        let frequencies = kept_frequencies(&scene);
        let pixels = pixel_transforms(&scene, &spread, &frequencies, &projector.emitters);
        let images = basis_images(&scene, kernels, &frequencies, cones);
        let per_px = scene.samples_per_px();
        let gathered: Vec<_> = cones
            .cones
            .par_iter()
            .map(|cone| {
                // Positions in samples, areas in pixels.
                let nodes: Vec<_> =
                    polygon_nodes(&cone.polygon_px).into_iter().map(|(p, w)| (p * per_px, w)).collect();
                spread.weights(&nodes, scene.samples)
            })
            .collect();
        let mut weights = Vec::new();
        let stencils = gathered
            .into_iter()
            .map(|w| {
                let offset = weights.len();
                weights.extend(w.values);
                Stencil { first: w.first, size: w.size, offset }
            })
            .collect();
        let coefficients = cones.cones.par_iter().map(|cone| coefficients_of(kernels, cone)).collect();
        Self {
            scene,
            frequencies,
            pixels,
            single: settings.single,
            images,
            stencils,
            weights,
            coefficients,
            factors: cones.cones.iter().map(|c| [c.geometry * c.pointing, c.geometry]).collect(),
            kinds: cones.cones.iter().map(|c| c.cone_type as usize).collect(),
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
        self.gather(&grids)
    }

    /// `[primary][frequency]`: what the display sends, before the eye.
    fn drive(&self, source: &Source) -> Vec<Vec<Complex64>> {
        let [px, py] = self.scene.period_px;
        let size = self.scene.size_px.map(|s| s as usize);
        let sent = |(primary, pixel): (&SourcePrimary, &Vec<Complex64>)| {
            let spectrum = picture_spectrum(&primary.light, size, [px, py], &self.frequencies);
            let at = |((nu, pixel), light): ((&Frequency, &Complex64), &Complex64)| {
                let cycles = DVec2::new(f64::from(nu.x) / px as f64, f64::from(nu.y) / py as f64);
                light * pixel * primary.movement(cycles)
            };
            self.frequencies.par_iter().zip(pixel).zip(&spectrum).with_min_len(4096).map(at).collect()
        };
        source.primaries.iter().zip(&self.pixels).map(sent).collect()
    }

    fn coefficients_of_image(&self, image: usize, drive: &[Vec<Complex64>]) -> Vec<Complex64> {
        let mut sum = vec![Complex64::ZERO; self.frequencies.len()];
        for (kernel, sent) in self.images[image].1.iter().zip(drive) {
            for ((s, k), d) in sum.iter_mut().zip(kernel).zip(sent) {
                *s += d * Complex64::new(f64::from(k.re), f64::from(k.im));
            }
        }
        sum
    }

    fn gather(&self, grids: &[Vec<f32>]) -> Means {
        let values: Vec<[f64; 2]> = (0..self.stencils.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|cone| {
                let coefficients = &self.coefficients[cone];
                let mut sums = [0.0; 2];
                let mut used = 0;
                for (slot, kind) in [self.kinds[cone], ARRIVING].into_iter().enumerate() {
                    for (grid, _) in grids.iter().zip(&self.images).filter(|(_, image)| image.0 == kind) {
                        sums[slot] += coefficients[used] * self.integral(cone, grid);
                        used += 1;
                    }
                }
                [sums[0] * self.factors[cone][0], sums[1] * self.factors[cone][1]]
            })
            .collect();
        let clamped = values.iter().filter(|v| v[0] < 0.0).count() as u64;
        Means {
            isomerized: values.iter().map(|v| v[0].max(0.0)).collect(),
            arriving: values.iter().map(|v| v[1].max(0.0)).collect(),
            clamped,
        }
    }

    /// Integral of one image over a cone's aperture.
    fn integral(&self, cone: usize, grid: &[f32]) -> f64 {
        let [columns, rows] = self.scene.samples;
        let stencil = &self.stencils[cone];
        let [first_x, first_y] = stencil.first.map(|v| v as usize);
        let [nx, ny] = stencil.size.map(|v| v as usize);
        let weights = &self.weights[stencil.offset..stencil.offset + nx * ny];
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
            pixel_transform(&emitter.rects, cycles) / (px * py * spreading)
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
) -> Vec<(usize, Vec<Vec<Complex32>>)> {
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
            let primaries = (0..kernels.spec().primaries.len())
                .map(|primary| {
                    let table = kernels.table(kind, r, primary);
                    let value = |s: &Option<_>| s.as_ref().map_or(Complex64::ZERO, |s| shape.read(table, s));
                    stencils.iter().map(value).map(|z| Complex32::new(z.re as f32, z.im as f32)).collect()
                })
                .collect();
            (kind, primaries)
        })
        .collect()
}

fn coefficients_of(kernels: &Kernels, cone: &MappedCone) -> Vec<f64> {
    let mut coefficients = kernels.coefficients(cone.cone_type as usize, cone.um, cone.ecc_deg);
    coefficients.extend(kernels.coefficients(ARRIVING, cone.um, cone.ecc_deg));
    coefficients
}
