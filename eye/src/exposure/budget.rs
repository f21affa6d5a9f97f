//! The ledger of photons: every photon that a frame emits has one fate, and the fates add up to the emission.
//!
//! Sums are over pixels for what happens before the cones and over cones for the rest; what reached the retina and entered no
//! simulated aperture is "between cones", which holds the light beyond the patch too. Of several result tiles the first one accounts
//! for the screen; the others move what their cones caught out of "between cones".

use glam::DVec2;
use multiversion::multiversion;
use rayon::prelude::*;

use super::cones::{ConeTable, entering};
use super::expected::Means;
use super::inputs::Inputs;
use super::light::{Shown, Window, courses};
use super::primaries::Primaries;
use super::source::{Projector, Source};
use crate::display::Emitter;
use crate::media::MACULA_EDGE_DEG;
use crate::report::PhotonBudget;

/// Sums that are kept side by side, in a fixed order.
const LANES: usize = 8;
/// Steps of eccentricity in the table of the macula.
const STEPS: usize = 100;

/// Shares of one primary's photons that enter the pupil.
#[derive(Clone, Debug)]
struct Shares {
    reflected: f64,
    cornea: f64,
    lens: f64,
    /// Absorbed in the macula at each step of eccentricity.
    macula: Vec<f64>,
}

/// One primary's photons in a frame.
#[derive(Clone, Copy, Debug, Default)]
struct Sent {
    emitted: f64,
    /// Into the pupil.
    entered: f64,
    /// Absorbed in the macula.
    macula: f64,
}

/// What the budget needs of a scene.
#[derive(Clone, Debug)]
pub struct Ledger {
    shares: Vec<Shares>,
    /// Share of the light that cones aimed at the pupil's centre accept.
    throughput: f64,
    /// Slant factor by pixel of the display, row-major.
    slant: Vec<f32>,
    /// `[primary][pixel]`: share of what meets the pupil at the gaze centre that the macula absorbs.
    macula: Vec<Vec<f32>>,
}

impl Ledger {
    /// Prepares the sums.
    ///
    /// # Errors
    /// When the embedded tables cannot be read.
    pub fn new(inputs: &Inputs, primaries: &Primaries, centre_px: [f64; 2]) -> Result<Self, String> {
        let Primaries { kernels, projector } = primaries;
        let beams = &inputs.beams;
        let absorbers = kernels.spec().absorbers()?;
        let media = &absorbers.media;
        let cornea = |nm: f64| media.cornea(nm, kernels.paths_at(nm).cornea);
        let lens = |nm: f64| media.lens(nm, kernels.paths_at(nm).lens);
        let shares: Vec<Shares> = kernels
            .shares()
            .iter()
            .map(|primary| {
                let sum =
                    |f: &dyn Fn(f64) -> f64| primary.iter().map(|(nm, share)| share * f(*nm)).sum::<f64>();
                let before = |nm: f64| cornea(nm) * lens(nm);
                let macula = (0..=STEPS).map(|i| {
                    let ecc_deg = MACULA_EDGE_DEG * i as f64 / STEPS as f64;
                    sum(&|nm| before(nm) * (1.0 - media.macula(nm, ecc_deg)))
                });
                Shares {
                    reflected: sum(&|nm| media.reflected(nm)),
                    cornea: sum(&|nm| 1.0 - media.reflected(nm) - cornea(nm)),
                    lens: sum(&|nm| cornea(nm) * (1.0 - lens(nm))),
                    macula: macula.collect(),
                }
            })
            .collect();
        let display = &projector.display;
        let per_px = display.pixel_pitch_cm / display.distance_cm;
        // The screen's light is accounted for once, with the first tile; sums over tiles are exact.
        let (columns, rows) = if inputs.first_tile { (display.width_px, display.height_px) } else { (0, 0) };
        let pixels = columns as usize * rows as usize;
        let mut slant = vec![0.0_f32; pixels];
        let mut ecc_deg = vec![0.0_f32; pixels];
        // Row by row, on all threads.
        slant
            .par_chunks_mut(columns.max(1) as usize)
            .zip(ecc_deg.par_chunks_mut(columns.max(1) as usize))
            .enumerate()
            .for_each(|(row, (slant, ecc_deg))| {
                for (column, (slant, ecc_deg)) in slant.iter_mut().zip(ecc_deg).enumerate() {
                    let at = DVec2::new(column as f64 + 0.5, row as f64 + 0.5) - DVec2::from_array(centre_px);
                    let tangent = DVec2::new(at.x, -at.y) * per_px;
                    *slant = entering(display.emission_law, beams, tangent) as f32;
                    *ecc_deg = inputs.projection.screen().eccentricity_deg(tangent) as f32;
                }
            });
        let of_primary = |shares: &Shares| {
            let absorbed = |(slant, ecc_deg): (&f32, &f32)| {
                *slant * interpolate(&shares.macula, f64::from(*ecc_deg) / MACULA_EDGE_DEG) as f32
            };
            slant.iter().zip(&ecc_deg).map(absorbed).collect()
        };
        let macula = shares.iter().map(of_primary).collect();
        Ok(Self { shares, throughput: kernels.throughput(), slant, macula })
    }

    /// Whether a primary's layers hold the light of every pixel of the display.
    fn is_whole(&self, source: &Source, primary: usize) -> bool {
        let layers = &source.primaries[primary].layers;
        source.covers_display && layers.iter().all(|layer| layer.light.len() == self.slant.len())
    }

    /// Sums over pixels of a primary's layers.
    fn sent_by(&self, source: &Source, primary: usize, pupil_share: f64) -> Sent {
        let mut sums = Sent::default();
        for layer in &source.primaries[primary].layers {
            let sent = layer.sent();
            let [emitted, entered, macula] = layer.light.sums(|light| self.over_pixels(light, primary));
            sums.emitted += emitted * sent / pupil_share;
            sums.entered += entered * sent;
            sums.macula += macula * sent;
        }
        sums
    }

    /// The same for pixels that the source does not hold.
    fn sent(&self, projector: &Projector, emitter: &Emitter, primary: usize, shown: &Shown) -> Sent {
        let display = &projector.display;
        let courses = courses(emitter, display, shown.index);
        let size = if self.slant.is_empty() { [0; 2] } else { [display.width_px, display.height_px] };
        let window = Window { first: [0; 2], size };
        let light = window.frame_light(display, emitter, &courses, shown);
        let [emitted, entered, macula] = self.over_pixels(&light, primary);
        let photons = emitter.emitted();
        let met = photons * projector.pupil_share;
        Sent { emitted: emitted * photons, entered: entered * met, macula: macula * met }
    }

    /// Sums over pixels of their light alone, with the slant and with the slant and what the macula absorbs of a primary.
    fn over_pixels(&self, light: &[f64], primary: usize) -> [f64; 3] {
        sums(light, &self.slant, &self.macula[primary])
    }

    /// The budget of one frame; where its light is at hand as a `source` it need not be made again.
    pub fn budget(
        &self,
        projector: &Projector,
        (shown, source): (&Shown, Option<&Source>),
        cones: &ConeTable,
        means: &Means,
    ) -> PhotonBudget {
        let mut budget = PhotonBudget::default();
        let mut reached = 0.0;
        for (k, (emitter, shares)) in projector.emitters.iter().zip(&self.shares).enumerate() {
            let Sent { emitted, entered, macula } = match source {
                Some(source) if self.is_whole(source, k) => self.sent_by(source, k, projector.pupil_share),
                _ => self.sent(projector, emitter, k, shown),
            };
            budget.emitted += emitted;
            budget.missed_pupil += emitted - entered;
            budget.reflected += entered * shares.reflected;
            budget.cornea += entered * shares.cornea;
            budget.lens += entered * shares.lens;
            budget.macula += macula;
            reached += entered * (1.0 - shares.reflected - shares.cornea - shares.lens) - macula;
        }
        let Means { arrived, guided, .. } = *means;
        for (cone, mean) in cones.cones.iter().zip(&means.isomerized) {
            budget.isomerized[cone.cone_type as usize] += mean;
        }
        let isomerized: f64 = budget.isomerized.iter().sum();
        let absorbed = isomerized / crate::cone::ISOMERIZATION;
        budget.between_cones = reached * self.throughput - arrived;
        budget.stiles_crawford = reached * (1.0 - self.throughput) + arrived - guided;
        budget.not_absorbed = guided - absorbed;
        budget.not_isomerized = absorbed - isomerized;
        budget
    }
}

/// Sums of the light alone and with each of two tables.
#[multiversion(targets("x86_64+avx2"))]
fn sums(light: &[f64], slant: &[f32], macula: &[f32]) -> [f64; 3] {
    let mut sums = [[0.0; LANES]; 3];
    let (whole, rest) = light.as_chunks::<LANES>();
    let ((slant, slant_rest), (macula, macula_rest)) =
        (slant.as_chunks::<LANES>(), macula.as_chunks::<LANES>());
    for ((light, slant), macula) in whole.iter().zip(slant).zip(macula) {
        for lane in 0..LANES {
            sums[0][lane] += light[lane];
            sums[1][lane] += light[lane] * f64::from(slant[lane]);
            sums[2][lane] += light[lane] * f64::from(macula[lane]);
        }
    }
    for (lane, ((light, slant), macula)) in rest.iter().zip(slant_rest).zip(macula_rest).enumerate() {
        sums[0][lane] += light;
        sums[1][lane] += light * f64::from(*slant);
        sums[2][lane] += light * f64::from(*macula);
    }
    sums.map(|lanes| lanes.iter().sum())
}

/// Linear interpolation in equal steps over [0, 1]; the last value beyond.
fn interpolate(values: &[f64], at: f64) -> f64 {
    let place = at.clamp(0.0, 1.0) * (values.len() - 1) as f64;
    let below = (place as usize).min(values.len() - 2);
    let t = place - below as f64;
    values[below] * (1.0 - t) + values[below + 1] * t
}
