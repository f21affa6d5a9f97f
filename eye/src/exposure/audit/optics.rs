//! The eye of the audit: point spread functions of one source point at wavelengths of the audit's own, and
//! their sums weighted by a primary's light.

use glam::DVec2;
use rayon::prelude::*;

use super::super::spectral::{Absorbers, Kind, Paths, paths_at};
use super::super::transfer::{FieldPoint, spot_radius_um, wavefront_options};
use super::tail::Tail;
use crate::display::{EmissionLaw, Emitter};
use crate::optics::beam::nominal_mm2;
use crate::optics::{BeamField, Projection};
use crate::psf::sampled_fft::{Edge, psf as fast};
use crate::psf::{GridAxes, PsfGrid, Wavefront, WavefrontOptions, psf};

/// Window: at least so many µm each way, so many times the geometric spot and so many widths of the
/// diffraction pattern.
const LEAST_UM: f64 = 36.0;
const SPOTS: f64 = 1.3;
const WIDTHS: f64 = 12.0;
/// Samples per sample that the cutoff asks, of a wavelength shorter than most.
const FINER: f64 = 2.5;
/// The same of a window that would have more than [`FAST_FROM`]: aberrations leave little at the cutoff of a
/// large pupil.
const FINER_WIDE: f64 = 1.75;
const SHORT: f64 = 0.15;
/// Samples across an aperture, at least, where the window is too large for finer ones.
const PER_APERTURE: f64 = 8.0;
/// Most samples across the window.
const MOST_SAMPLES: usize = 2048;
/// Samples from which a PSF comes from a fast transform of so many points across the pupil, at least: at 6
/// and 8 mm cones change by 1e-4 from twice as many.
const FAST_FROM: usize = 448;
const ACROSS: usize = 256;
/// Points of a polynomial on either side.
pub const REACH: usize = 3;
/// Point spreads that are held at a time, whatever the number of threads.
const HELD: usize = 4;

/// What is the same for all cones.
pub struct Optics<'a> {
    /// Screen and eye.
    pub projection: &'a Projection,
    /// Light that enters the pupil from each point of the screen.
    pub beams: &'a BeamField,
    /// How the screen's light falls with the angle.
    pub emission_law: EmissionLaw,
    /// Media and pigments.
    pub absorbers: Absorbers,
    /// Wavelengths of the PSFs, nm.
    pub nodes_nm: Vec<f64>,
    /// Spacing, nm.
    pub step_nm: f64,
    /// Stiles-Crawford coefficient, base 10, 1/mm².
    pub rho10_per_mm2: f64,
}

/// The PSF of one primary's light.
pub struct Spread {
    /// Densities, row by row, 1/µm².
    pub values: Vec<f64>,
    /// Outside of the window.
    pub tail: Tail,
    /// All offsets together.
    pub total: f64,
}

impl Spread {
    /// What this one has more than another.
    pub fn subtract(&mut self, other: &Self) {
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a -= b);
        self.tail.add(&other.tail, -1.0);
        self.total -= other.total;
    }
}

impl Optics<'_> {
    /// Wavefronts of a source point at wavelengths (nm).
    ///
    /// # Errors
    /// When the pupil cannot be traced.
    pub fn wavefronts(&self, point: &FieldPoint, nodes_nm: &[f64]) -> Result<Vec<Wavefront>, String> {
        let eye = self.projection.eye();
        let degree = Some(if eye.state().pupil_mm <= 4.0 { 10 } else { 14 });
        let options = WavefrontOptions { degree, ..wavefront_options(self.rho10_per_mm2) };
        let one = |nm: &f64| Wavefront::new(eye, point.object, *nm, &options).map_err(|e| e.to_string());
        nodes_nm.par_iter().map(one).collect()
    }

    /// By wavelength: the share of a primary's photons whose spread that wavelength stands for, times what a
    /// kind of cone at an eccentricity catches of them.
    pub fn weights(
        &self,
        waves: &[Wavefront],
        emitter: &Emitter,
        (kind, ecc_deg): (Kind, f64),
        step_nm: f64,
    ) -> Vec<f64> {
        let nodes: Vec<f64> = waves.iter().map(|w| w.wavelength_nm).collect();
        let paths: Vec<Paths> = waves.iter().map(|w| Paths::new(w, &self.absorbers.media)).collect();
        let emitted = emitter.emitted().max(f64::MIN_POSITIVE);
        let mut weights = vec![0.0; nodes.len()];
        for p in &emitter.photons {
            let caught = self.absorbers.caught_at(kind, p.nm, ecc_deg, paths_at(&nodes, &paths, p.nm));
            hats(&nodes, step_nm, p.nm, |i, hat| weights[i] += hat * p.emitted * caught / emitted);
        }
        weights
    }

    /// The PSFs of a source point about its image at the reference wavelength, summed over wavelengths by
    /// each of several sets of weights: of photons that enter a pupil of the reference wavelength's beam.
    pub fn spreads(
        &self,
        point: &FieldPoint,
        waves: &[Wavefront],
        weights: &[Vec<f64>],
        grid: PsfGrid,
    ) -> Vec<Spread> {
        let to_tangents = point.chart_from_tangents().inverse();
        let nominal_mm2 = nominal_mm2(self.projection.eye().state().pupil_mm);
        let beam_mm2 = nominal_mm2 * self.beams.relative(point.tangent);
        let image = |w: &Wavefront| -> Vec<f64> {
            // The window stands about the image at the reference wavelength; the PSF of this one lies beside.
            let shift = to_tangents * (w.landing_um - point.landing_um);
            let grid = PsfGrid { centre_um: -shift, ..grid };
            if is_fast(grid.samples) { fast(w, &grid, ACROSS, Edge::Covered) } else { psf(w, &grid) }
        };
        let empty = |weights: &Vec<f64>| {
            let whole = waves.iter().map(|w| w.pupil_area_mm2 / beam_mm2 * w.throughput());
            let total = weights.iter().zip(whole).map(|(weight, whole)| weight * whole).sum();
            Spread { values: vec![0.0; grid.samples * grid.samples], tail: Tail::none(), total }
        };
        let mut spreads: Vec<Spread> = weights.iter().map(empty).collect();
        // A few wavelengths at a time: point spreads of a large pupil are large.
        for first in (0..waves.len()).step_by(HELD) {
            let group = &waves[first..waves.len().min(first + HELD)];
            let images: Vec<Vec<f64>> = group.par_iter().map(image).collect();
            spreads.par_iter_mut().zip(weights).for_each(|(spread, weights)| {
                for ((image, w), weight) in images.iter().zip(group).zip(&weights[first..]) {
                    let scale = weight * w.pupil_area_mm2 / beam_mm2 * w.density_per_um2();
                    if scale != 0.0 {
                        spread.values.iter_mut().zip(image).for_each(|(sum, v)| *sum += scale * v);
                    }
                }
            });
        }
        for (wave, w) in waves.iter().enumerate() {
            let tail = Tail::new(w, to_tangents * (w.landing_um - point.landing_um));
            for (spread, weights) in spreads.iter_mut().zip(weights) {
                spread.tail.add(&tail, weights[wave] * w.pupil_area_mm2 / beam_mm2);
            }
        }
        let inside_um = grid.half_width_um - REACH as f64 * grid.pitch_um();
        for spread in &mut spreads {
            let inner = || REACH..grid.samples - REACH;
            let inside: f64 =
                inner().map(|i| inner().map(|j| spread.values[i * grid.samples + j]).sum::<f64>()).sum();
            let missing = spread.total - inside * grid.pitch_um().powi(2);
            spread.tail.with_energy(missing.max(0.0), inside_um);
        }
        spreads
    }
}

/// Every so many of the wavelengths of each stretch of light, and its ends.
pub fn every(nodes_nm: &[f64], step: usize, step_nm: f64) -> Vec<usize> {
    let joined = |i: usize| nodes_nm[i + 1] - nodes_nm[i] <= step_nm * (1.0 + 1e-9);
    let (mut kept, mut first) = (Vec::new(), 0);
    for i in 0..nodes_nm.len() {
        let last = i + 1 == nodes_nm.len() || !joined(i);
        if (i - first).is_multiple_of(step) || last {
            kept.push(i);
        }
        if last {
            first = i + 1;
        }
    }
    kept
}

/// Radius of the geometric spot, µm. Wavelengths rise; the ends of the spectrum are far out of focus and give
/// little.
pub fn usual_spot_um(waves: &[Wavefront]) -> f64 {
    let at = |part: f64| &waves[(part * (waves.len() - 1) as f64).round() as usize];
    [SHORT, 0.5, 1.0 - SHORT].map(|part| spot_radius_um(at(part))).into_iter().fold(0.0, f64::max)
}

/// Half side of a window (µm) and its samples, for a geometric spot (radius, µm) and the widths of the diffraction
/// patterns of a usual and a short wavelength (µm). One that is too large for [`MOST_SAMPLES`] has samples farther
/// apart, as far as an aperture so wide (µm) averages over them.
pub fn size(spot_um: f64, [usual_um, short_um]: [f64; 2], aperture_um: f64) -> (f64, usize) {
    let half_um = (SPOTS * spot_um + WIDTHS * usual_um).max(LEAST_UM);
    let samples = |finer: f64| (4.0 * half_um * finer / short_um).ceil() as usize;
    let finer = if samples(FINER) > FAST_FROM { FINER_WIDE } else { FINER };
    let finest_um = 0.5 * short_um / finer;
    let pitch_um = (2.0 * half_um / MOST_SAMPLES as f64).min(aperture_um / PER_APERTURE).max(finest_um);
    let samples = ((2.0 * half_um / pitch_um).ceil() as usize).clamp(8 * REACH, MOST_SAMPLES);
    (half_um.min(0.5 * pitch_um * samples as f64), samples)
}

/// Whether PSFs of so many samples a side come from fast transforms.
pub fn is_fast(samples: usize) -> bool {
    samples as f64 > FAST_FROM as f64 * FINER_WIDE / FINER
}

/// The window that holds all wavelengths' PSFs, for an aperture about so wide (µm), and the shortest period in them, µm.
pub fn window(waves: &[Wavefront], aperture_um: f64) -> (PsfGrid, f64) {
    let width = |part: f64| {
        let w = &waves[(part * (waves.len() - 1) as f64).round() as usize];
        w.wavelength_um() / (2.0 * w.axes.x_axis.length().max(w.axes.y_axis.length()))
    };
    let period_um = width(SHORT);
    let (half_width_um, samples) = size(usual_spot_um(waves), [width(0.5), period_um], aperture_um);
    let axes = GridAxes::Retina;
    let grid =
        PsfGrid { samples, half_width_um, centre_um: DVec2::ZERO, axes, nodes: None, fraunhofer: true };
    (grid, period_um)
}

/// Weights of the cubic through the four nodes around a wavelength, those of the same stretch of light; the
/// end's value beyond its ends.
fn hats(nodes: &[f64], step_nm: f64, nm: f64, mut put: impl FnMut(usize, f64)) {
    let joined = |i: usize| nodes[i + 1] - nodes[i] <= step_nm * (1.0 + 1e-9);
    let above = nodes.partition_point(|node| *node < nm).min(nodes.len() - 1);
    if nodes[above] <= nm || above == 0 {
        return put(above, 1.0);
    }
    if !joined(above - 1) {
        let nearer = if nm - nodes[above - 1] < nodes[above] - nm { above - 1 } else { above };
        return put(nearer, 1.0);
    }
    let mut range = [above - 1, above];
    while range[0] > 0 && joined(range[0] - 1) && above - range[0] < 2 {
        range[0] -= 1;
    }
    while range[1] + 1 < nodes.len() && joined(range[1]) && range[1] - above < 1 {
        range[1] += 1;
    }
    for i in range[0]..=range[1] {
        let others = (range[0]..=range[1]).filter(|j| *j != i);
        put(i, others.map(|j| (nm - nodes[j]) / (nodes[i] - nodes[j])).product());
    }
}

#[cfg(test)]
mod tests {
    use super::hats;

    #[test]
    fn cubics_are_read_exactly_and_gaps_are_not_crossed() {
        let nodes = [400.0, 405.0, 410.0, 415.0, 420.0, 543.0];
        let read = |nm: f64, f: fn(f64) -> f64| {
            let mut sum = 0.0;
            hats(&nodes, 5.0, nm, |i, w| sum += w * f(nodes[i]));
            sum
        };
        assert!((read(407.0, |x| x.powi(3)) / 407.0_f64.powi(3) - 1.0).abs() < 1e-12);
        assert!((read(418.0, |x| x * x) / 418.0_f64.powi(2) - 1.0).abs() < 1e-12);
        assert!((read(543.0, |x| x) - 543.0).abs() < 1e-12);
        assert!((read(450.0, |x| x) - 420.0).abs() < 1e-12);
    }
}
