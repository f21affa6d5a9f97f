//! A point spread as the paper has it (§21): the squared modulus of the sum of some thousand perturbed rays' phases on a grid of
//! samples, in a window that holds where the rays land and is never smaller than a least width; kept as a cumulative table.

use glam::DVec2;
use rustfft::num_complex::Complex64;

use crate::experiment::PaperSettings;
use crate::optics::{Object, Projection, PupilBundle};
use crate::psf::{PsfGrid, Wavefront, WavefrontOptions, psf};
use crate::rng::Stream;

/// One point spread.
pub struct Spread {
    /// Cumulative probability, `[i][j]`, i along x_um.
    cumulative: Vec<f32>,
    /// Its values at the end of each row, so that a search first finds the row: fewer cache lines.
    row_ends: Vec<f32>,
    half_width_um: f64,
    samples: usize,
}

impl Spread {
    /// The spread of an object at a wavelength (nm); `rho` is the Stiles-Crawford coefficient (base 10, 1/mm²), `stream` perturbs
    /// the rays.
    ///
    /// # Errors
    /// When the pupil cannot be traced.
    pub fn new(
        projection: &Projection,
        object: Object,
        nm: f64,
        settings: &PaperSettings,
        rho: f64,
        stream: &mut Stream,
    ) -> Result<Self, String> {
        let samples = settings.samples as usize;
        let bundle = random_bundle(projection, object, nm, settings.rays, stream)?;
        let half_width_um = 0.5 * settings.window_um.max(spread_width_um(projection, &bundle));
        let eye = projection.eye();
        let entrance_mm = eye.entrance_radius_mm().map_err(|e| e.to_string())?;
        let apodized = |at: DVec2| 10_f64.powf(-0.5 * rho * (at * entrance_mm).length_squared());
        let amplitudes: Vec<f64> = bundle.rays.iter().map(|r| apodized(bundle.entrance(r))).collect();
        let cumulative = cumulative(&bundle, &amplitudes, samples, half_width_um);
        let row_ends = cumulative.chunks_exact(samples).map(|row| row[row.len() - 1]).collect();
        Ok(Self { cumulative, row_ends, half_width_um, samples })
    }

    /// The landing offset for a uniform number, µm.
    pub fn draw(&self, uniform: f64) -> DVec2 {
        let samples = self.samples;
        let above = |c: &f32| f64::from(*c) <= uniform;
        let row = self.row_ends.partition_point(above).min(samples - 1);
        let line = &self.cumulative[row * samples..(row + 1) * samples];
        let column = line.partition_point(above).min(samples - 1);
        let pitch = 2.0 * self.half_width_um / samples as f64;
        let offset = |i: usize| (i as f64 + 0.5) * pitch - self.half_width_um;
        DVec2::new(offset(row), offset(column))
    }
}

/// Part of a spread's light beyond the square window of a width (µm), which the engine puts back into it: 1 less the sum over the traced
/// wavefront's spread.
///
/// # Errors
/// When the pupil cannot be traced.
pub(crate) fn beyond_window(
    projection: &Projection,
    object: Object,
    nm: f64,
    width_um: f64,
    options: &WavefrontOptions,
) -> Result<f64, String> {
    let wave = Wavefront::new(projection.eye(), object, nm, options).map_err(|e| e.to_string())?;
    // Four samples a micrometre: the spread has none finer than 1 µm.
    let grid = PsfGrid::new((4.0 * width_um).ceil().clamp(16.0, 512.0) as usize, 0.5 * width_um);
    let inside: f64 =
        psf(&wave, &grid).iter().sum::<f64>() * wave.density_per_um2() * grid.pitch_um().powi(2);
    Ok((1.0 - inside / wave.throughput()).clamp(0.0, 1.0))
}

/// Randomly perturbed rays through the stop: one in each cell of a square lattice of k x k <= `rays` cells, which is wrapped onto
/// the disc without changing areas (Shirley & Chiu 1997).
fn random_bundle(
    projection: &Projection,
    object: Object,
    nm: f64,
    rays: u32,
    stream: &mut Stream,
) -> Result<PupilBundle, String> {
    let side = f64::from(rays).sqrt().floor() as u32;
    let points: Vec<(DVec2, f64)> = (0..side * side)
        .map(|cell| {
            let corner = DVec2::new(f64::from(cell % side), f64::from(cell / side));
            let place = corner + DVec2::new(stream.uniform(), stream.uniform());
            (concentric(place * (2.0 / f64::from(side)) - 1.0), 1.0)
        })
        .collect();
    PupilBundle::trace_points(projection.eye(), object, nm, &points, &[]).map_err(|e| e.to_string())
}

/// The square [-1, 1]² onto the unit disc, squares onto circles.
fn concentric(p: DVec2) -> DVec2 {
    if p.x.abs() > p.y.abs() {
        DVec2::from_angle(std::f64::consts::FRAC_PI_4 * p.y / p.x) * p.x
    } else if p.y.abs() > 0.0 {
        DVec2::from_angle(std::f64::consts::FRAC_PI_2 - std::f64::consts::FRAC_PI_4 * p.x / p.y) * p.y
    } else {
        DVec2::ZERO
    }
}

/// Width of the square around the landing point that holds where all rays land, µm.
fn spread_width_um(projection: &Projection, bundle: &PupilBundle) -> f64 {
    let fovea = projection.eye().fovea();
    let centre = fovea.um_from_point(bundle.landing);
    let far = bundle.rays.iter().map(|r| (fovea.um_from_point(r.landing) - centre).abs().max_element());
    2.0 * far.fold(0.0, f64::max)
}

/// Cumulative table of the point spread: squared modulus of the sum of all rays' phases, a product of two small matrices.
fn cumulative(bundle: &PupilBundle, amplitudes: &[f64], samples: usize, half_width_um: f64) -> Vec<f32> {
    let wavelength_um = bundle.wavelength_mm() * 1e3;
    let pitch = 2.0 * half_width_um / samples as f64;
    let turn = std::f64::consts::TAU / wavelength_um;
    let offset = |i: usize| (i as f64 + 0.5) * pitch - half_width_um;
    let mut field = vec![Complex64::ZERO; samples * samples];
    for (ray, amplitude) in bundle.rays.iter().zip(amplitudes) {
        let wave = |q: f64| (0..samples).map(|i| Complex64::cis(-turn * q * offset(i))).collect::<Vec<_>>();
        let (along_x, along_y) = (wave(ray.q.x), wave(ray.q.y));
        let start = Complex64::from_polar(*amplitude, turn * ray.opd_mm * 1e3);
        for (line, x) in field.chunks_exact_mut(samples).zip(&along_x) {
            let x = start * x;
            line.iter_mut().zip(&along_y).for_each(|(f, y)| *f += x * y);
        }
    }
    let total: f64 = field.iter().map(Complex64::norm_sqr).sum();
    let mut sum = 0.0;
    let add = |f: &Complex64| {
        sum += f.norm_sqr();
        (sum / total) as f32
    };
    field.iter().map(add).collect()
}
