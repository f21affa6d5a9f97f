//! Audit: a few cones of a result, chosen at random, computed again by a slow sum that shares no kernel, grid or basis with the engines
//! (`direct` over the point spreads of `collection`); and what that says of the whole result ([`verdict`]).
//!
//! Sample j of K stands for one (frame, tile) of all, evenly, and there for one cone, with probability `q = ½ m/Σm + ½ 1/N`: lit cones come
//! often, and a cone that wrongly got nothing comes too. `Σ|m − reference|/q` over samples estimates the sum over all cones.
//!
//! # Accuracy
//! One line of light against Huygens' wavelets of every source point: lit cones at the fovea to 1e-4, at 10°
//! to 4e-4 (3 mm) and 8e-4 (6 mm), at 20° to 3e-4 and, 8 mm, 7e-4. Distances within a PSF are taken to first
//! order, which is what is left at large pupils beside the fovea. Tails are good to some per cent of
//! themselves. Wavelengths are 10 or 7 nm apart, with cubics between.

mod collection;
mod direct;
mod local;
mod optics;
mod scattered;
mod tail;
mod verdict;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::cones::ConeTable;
use super::light::Shown;
use super::source::Projector;
use super::spectral::{Absorbers, KINDS, Kind, Paths, wavelength_nodes};
use crate::cone::pigment::{Pigments, unbleached};
use crate::display::PhotonSample;
use crate::experiment::Experiment;
use crate::media::Media;
use crate::optics::{BeamField, Projection};
use crate::retina::Retina;
use crate::rng::{Purpose, Stream};
use direct::{Cone, Lights};
use optics::Optics;
pub use verdict::{Verdict, verdict};

/// Spacing of the wavelengths, nm: up to 4 mm of pupil, and beyond. At 3 mm 10 nm instead of 5 change L and M
/// cones by 2e-5, S cones by 4e-4.
const STEP_NM: [f64; 2] = [10.0, 7.0];
/// Largest pupil of the first.
const SMALL_PUPIL_MM: f64 = 4.0;
/// A wavelength of which less is caught by any kind of cone, against all, per nm, is left out.
const NOTHING: f64 = 1e-6;

/// Spacing of the wavelengths behind a pupil, nm.
fn step_nm(pupil_mm: f64) -> f64 {
    STEP_NM[usize::from(pupil_mm > SMALL_PUPIL_MM)]
}

/// What one audited cone takes.
pub struct Work {
    /// Spacing of its wavelengths, nm.
    pub step_nm: f64,
    /// Source points beside the cone's own place.
    pub beside: usize,
    /// One of so many wavelengths is traced for them.
    pub sparse: usize,
    /// Samples along a side of a point spread.
    pub samples: usize,
    /// Whether it comes from a fast transform.
    pub fast: bool,
}

impl Work {
    /// For a pupil, a geometric spot (radius, µm and unit tangents) and the widths of the diffraction patterns of a usual
    /// and a short wavelength (µm).
    pub fn new(pupil_mm: f64, spot_um: f64, spot: f64, widths_um: [f64; 2]) -> Self {
        let (_, samples) = optics::size(spot_um, widths_um, f64::INFINITY);
        Self {
            step_nm: step_nm(pupil_mm),
            beside: local::Stencil::new(spot).offsets().len(),
            sparse: collection::SPARSE,
            samples,
            fast: optics::is_fast(samples),
        }
    }
}

/// One cone that was computed twice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditSample {
    /// Frame.
    pub frame: u32,
    /// Result tile.
    pub tile: u32,
    /// The cone's stable number.
    pub cone: u64,
    /// What the engine gave: a mean, or with `events` and `paper` a count.
    pub value: f64,
    /// The mean by the direct sum.
    pub reference: f64,
    /// Probability with which the cone was chosen in its frame and tile.
    pub probability: f64,
    /// Sum of `value` over all cones of the frame and tile.
    pub total: f64,
}

/// What is audited: one frame of one tile.
pub struct Audited<'a> {
    /// The experiment.
    pub experiment: &'a Experiment,
    /// Screen and eye.
    pub projection: &'a Projection,
    /// Light that enters the pupil from each point of the screen.
    pub beams: &'a BeamField,
    /// Light and movement.
    pub projector: &'a Projector,
    /// The tile's cones.
    pub retina: &'a Retina,
    /// The same as the engine sees them; only the pointing factors are taken from it.
    pub table: &'a ConeTable,
    /// Number of the tile, of how many.
    pub tile: [u32; 2],
}

/// The samples that fall on a frame of a tile, `[number, of how many]`.
pub fn samples(experiment: &Experiment, [tile, tiles]: [u32; 2], frame: u32) -> Vec<u32> {
    let pairs = f64::from(experiment.frames) * f64::from(tiles);
    let here = u64::from(frame) * u64::from(tiles) + u64::from(tile);
    let falls = |j: &u32| {
        let mut stream = Stream::new(experiment.counts.seed, Purpose::Audit, u64::from(*j), 0);
        (stream.uniform() * pairs) as u64 == here
    };
    (0..experiment.audit_cones).filter(falls).collect()
}

impl Audited<'_> {
    /// Computes the samples of a frame again; `values` are the engine's, by cone.
    ///
    /// # Errors
    /// When a cone sees no screen or the pupil cannot be traced.
    pub fn run(&self, shown: &Shown, values: &[f64]) -> Result<Vec<AuditSample>, String> {
        let samples = samples(self.experiment, self.tile, shown.index);
        let total: f64 = values.iter().sum();
        if samples.is_empty() || values.is_empty() {
            return Ok(Vec::new());
        }
        let optics = self.optics()?;
        let lights = Lights::new(self.projector, shown);
        let even = 1.0 / values.len() as f64;
        let probability = |i: usize| if total > 0.0 { 0.5 * (values[i] / total + even) } else { even };
        let one = |j: &u32| {
            let mut stream = Stream::new(self.experiment.counts.seed, Purpose::Audit, u64::from(*j), 1);
            let mut left = stream.uniform();
            let chosen = (0..values.len()).find(|i| {
                left -= probability(*i);
                left <= 0.0
            });
            let i = chosen.unwrap_or(values.len() - 1);
            let cone = Cone {
                um: DVec2::new(self.retina.x_um[i], self.retina.y_um[i]),
                polygon_um: self.retina.polygon(i).collect(),
                kind: self.retina.cone_type[i],
                pointing: self.table.cones[i].pointing,
            };
            let reference = direct::mean(self.experiment, &optics, self.projector, (shown, &lights), &cone)?;
            Ok(AuditSample {
                frame: shown.index,
                tile: self.tile[0],
                cone: self.retina.id[i],
                value: values[i],
                reference,
                probability: probability(i),
                total,
            })
        };
        // One cone at a time, each on all threads: its point spreads fill memory.
        samples.iter().map(one).collect()
    }

    fn absorbers(&self) -> Result<Absorbers, String> {
        let eye = &self.experiment.eye;
        let mut media = Media::new(eye.lens_density_scale, eye.macular_peak_density)?
            .with_cornea_scale(eye.cornea_density_scale);
        if eye.reflection_losses {
            media = media.with_reflections(|nm| self.projection.eye().indices(nm));
        }
        let part = self.experiment.retina.bleaching_td.map_or(1.0, unbleached);
        Ok(Absorbers { media, pigments: Pigments::new()?.with_unbleached(part) })
    }

    /// The eye at wavelengths of the audit's own.
    fn optics(&self) -> Result<Optics<'_>, String> {
        let absorbers = self.absorbers()?;
        let paths = Paths { cornea: 1.0, lens: 1.0 };
        let mut lit = Vec::new();
        for emitter in &self.projector.emitters {
            for kind in KINDS.into_iter().filter(|kind| *kind != Kind::Arriving) {
                let caught = |nm: f64| absorbers.caught_at(kind, nm, 0.0, paths);
                let all: f64 = emitter.photons.iter().map(|p| p.emitted * caught(p.nm)).sum();
                let spacing = spacing_nm(&emitter.photons);
                let counts =
                    emitter.photons.iter().filter(|p| p.emitted * caught(p.nm) > NOTHING * spacing * all);
                lit.extend(counts.map(|p| p.nm));
            }
        }
        if lit.is_empty() {
            lit.push(555.0);
        }
        let step_nm = step_nm(self.experiment.eye.pupil_mm);
        Ok(Optics {
            projection: self.projection,
            beams: self.beams,
            emission_law: self.experiment.display.emission_law,
            absorbers,
            nodes_nm: wavelength_nodes(lit, step_nm),
            step_nm,
            rho10_per_mm2: self.experiment.eye.stiles_crawford_rho10_per_mm2,
        })
    }
}

/// Spacing of a spectrum's samples, nm; that of a line is 1.
fn spacing_nm(photons: &[PhotonSample]) -> f64 {
    match photons {
        [a, b, ..] => b.nm - a.nm,
        _ => 1.0,
    }
}
