//! Engine `events`: photon by photon, but only photons that could count (§22, thinned).
//!
//! A frame's photons of primary k near wavelength node m reach the pupil from pixel p as a Poisson number of mean n_kp·share. Of these
//! only a share W_km, the most that any cone could count of them, is drawn; each drawn photon gets a pixel (by its light), a place in the
//! pixel, a time, a point spread (one of the four nearest field nodes, by chance with bilinear weights), a landing point and so a
//! cone, which counts it with probability w/W, its own share over the most. Thinning a Poisson process leaves a Poisson process, so counts
//! have the same distribution as in `paper` and `expected`; the weights w are those of `expected` (see `spectral`).
//!
//! Landing: place on the screen -> retina at 543 nm by a polynomial fitted to chief rays, affine inside a pixel; plus the transverse chromatic
//! shift of the node; plus an offset from the point spread's table ([`spread`]).
//!
//! # Cost
//! Time grows with the number of drawn photons, not with cones or pixels; the tables take milliseconds a node and wavelength.

mod landing;
mod spread;
mod tables;

use glam::DVec2;
use rayon::prelude::*;

use super::cones::ConeTable;
use super::expected::Means;
use super::inputs::Inputs;
use super::poisson;
use super::scene::Scene;
use super::source::Projector;
use crate::display::Emitter;
use crate::experiment::Experiment;
use crate::retina::ConeIndex;
use crate::rng::{Purpose, Stream, mixed};
use crate::video::Picture;
use landing::{Landing, Patch};
use tables::Tables;

/// Pixels that share a Poisson draw.
const CHUNK: usize = 64;
/// Arriving photons are added up as whole multiples of this share, so that the order of adding does not matter.
const GRAIN: f64 = 1.0 / 1_048_576.0;

/// The prepared engine.
pub struct Events {
    seed: u64,
    scene: Scene,
    index: ConeIndex,
    landing: Landing,
    tables: Tables,
    /// By pixel of the window: share of its light that meets the pupil, relative to the gaze centre.
    slant: Vec<f64>,
}

/// What one thread has counted.
struct Tally {
    counts: Vec<u32>,
    arriving: Vec<u64>,
}

/// One frame's photons of one emitter and wavelength node.
struct Beam<'a> {
    emitter: &'a Emitter,
    primary: usize,
    wave: usize,
    /// Mean photons drawn per unit of light.
    rate: f64,
    /// Line of sight when the light goes on and off, unit tangents.
    sight: [DVec2; 2],
}

/// Random bits of one chunk of a beam: a hashed counter.
struct Dice {
    key: u64,
    counter: u64,
}

impl Dice {
    fn bits(&mut self) -> u64 {
        self.counter += 1;
        mixed(self.key, self.counter)
    }

    /// Two uniform numbers of 32 bits in [0, 1).
    fn pair(&mut self) -> DVec2 {
        const UNIT: f64 = 1.0 / 4_294_967_296.0;
        let bits = self.bits();
        DVec2::new(f64::from(bits as u32) * UNIT, f64::from((bits >> 32) as u32) * UNIT)
    }
}

impl Events {
    /// Prepares tables and cones.
    ///
    /// # Errors
    /// When a part of the window is not seen or the pupil cannot be traced.
    pub fn new(experiment: &Experiment, inputs: &Inputs, cones: &ConeTable) -> Result<Self, String> {
        let Inputs { retina, projection, projector, scene, .. } = inputs;
        let landing = Landing::new(projection, scene)?;
        let tables = Tables::new(inputs, cones, &landing, experiment.accuracy_target)?;
        let [width, height] = scene.size_px;
        let law = projector.display.emission_law;
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        let middle = |(column, row)| DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let slant = pixels
            .map(|pixel| super::cones::slant_factor(law, projection, scene.tangent(middle(pixel))))
            .collect();
        Ok(Self {
            seed: experiment.counts.seed,
            scene: scene.clone(),
            index: ConeIndex::new(retina),
            landing,
            tables,
            slant,
        })
    }

    /// Simulates frame `index`: counts by cone, and an unbiased estimate of the photons that arrived at each.
    pub fn frame(&self, index: u32, picture: &Picture, projector: &Projector) -> (Vec<u32>, Means) {
        let seconds = 1.0 / projector.display.frame_rate_hz;
        let beams: Vec<(Beam, Vec<f64>)> = (0..projector.emitters.len())
            .map(|primary| {
                let emitter = &projector.emitters[primary];
                let mut light = projector.drive(emitter, picture, &self.scene);
                light.iter_mut().zip(&self.slant).for_each(|(light, slant)| *light *= slant);
                let sight = emitter
                    .lit
                    .map(|part| projector.gaze.screen_tangent((f64::from(index) + part) * seconds));
                let rate = emitter.emitted() * projector.pupil_share;
                (Beam { emitter, primary, wave: 0, rate, sight }, light)
            })
            .collect();
        // Pieces of work in a fixed order; what each draws depends on its own numbers only, and counts are whole numbers.
        let chunks = self.slant.len().div_ceil(CHUNK);
        let pieces: Vec<(usize, usize, usize)> = (0..beams.len())
            .flat_map(|k| (0..self.tables.waves()).map(move |m| (k, m)))
            .flat_map(|(k, m)| (0..chunks).map(move |chunk| (k, m, chunk)))
            .collect();
        let groups = rayon::current_num_threads().max(1);
        let tallies: Vec<Tally> = (0..groups)
            .into_par_iter()
            .map(|group| {
                let cones = self.tables.cones();
                let mut tally = Tally { counts: vec![0; cones], arriving: vec![0; cones] };
                for &(k, wave, chunk) in pieces.iter().skip(group).step_by(groups) {
                    let (beam, light) = &beams[k];
                    let rate = beam.rate * self.tables.most(k, wave);
                    let beam = Beam { wave, rate, ..*beam };
                    self.chunk(index, &beam, light, chunk, &mut tally);
                }
                tally
            })
            .collect();
        let cones = self.tables.cones();
        let (mut counts, mut arriving) = (vec![0_u32; cones], vec![0_u64; cones]);
        for tally in tallies {
            counts.iter_mut().zip(tally.counts).for_each(|(sum, count)| *sum = sum.saturating_add(count));
            arriving.iter_mut().zip(tally.arriving).for_each(|(sum, part)| *sum += part);
        }
        let means = Means {
            isomerized: counts.iter().map(|count| f64::from(*count)).collect(),
            arriving: arriving.iter().map(|grains| *grains as f64 * GRAIN).collect(),
            clamped: 0,
        };
        (counts, means)
    }

    /// All photons of a beam from one chunk of pixels.
    fn chunk(&self, index: u32, beam: &Beam, light: &[f64], chunk: usize, tally: &mut Tally) {
        let from = chunk * CHUNK;
        let mut cumulative = [0.0; CHUNK];
        let mut total = 0.0;
        for (sum, light) in cumulative.iter_mut().zip(&light[from..]) {
            total += light;
            *sum = total;
        }
        let pixels = CHUNK.min(light.len() - from);
        let mean = total * beam.rate;
        if mean <= 0.0 {
            return;
        }
        let number = ((beam.primary * self.tables.waves() + beam.wave) as u64) << 40 | chunk as u64;
        let mut stream = Stream::new(self.seed, Purpose::Events, u64::from(index), number);
        let drawn = poisson::from_stream(&mut stream, mean) as u64;
        if drawn == 0 {
            return;
        }
        let width = self.scene.size_px[0] as usize;
        let patches: Vec<Patch> = (from..from + pixels)
            .map(|pixel| {
                let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
                self.landing.patch(&self.scene, corner, beam.sight)
            })
            .collect();
        let mut dice = Dice { key: stream.bits(), counter: 0 };
        for _ in 0..drawn {
            let pair = dice.pair();
            let pixel = cumulative[..pixels - 1].partition_point(|sum| *sum <= pair.x * total);
            self.photon(beam, &patches[pixel], pair.y, &mut dice, tally);
        }
    }

    /// One photon from a pixel: where it lands, and what the cone there does with it.
    fn photon(&self, beam: &Beam, patch: &Patch, time: f64, dice: &mut Dice, tally: &mut Tally) {
        let place = place(beam.emitter, dice);
        let landed = patch.landing(&self.landing, place, time);
        let node = self.tables.node(landed, beam.wave, dice.pair());
        let landed = landed + node.shift_um + node.spread.draw(dice.bits(), || dice.pair());
        let Some(owner) = self.index.owner(landed) else {
            return;
        };
        let cone = owner as usize;
        let (counted, arrived) = self.tables.odds(cone, beam.primary, beam.wave, node);
        tally.arriving[cone] += (arrived / GRAIN) as u64;
        if dice.pair().x < counted {
            tally.counts[cone] = tally.counts[cone].saturating_add(1);
        }
    }
}

/// A point of the emitter's rectangles, pixel units.
fn place(emitter: &Emitter, dice: &mut Dice) -> DVec2 {
    let mut chosen = emitter.rects[emitter.rects.len() - 1].0;
    if emitter.rects.len() > 1 {
        let mut left = dice.pair().x;
        for (rect, share) in &emitter.rects {
            if left < *share {
                chosen = *rect;
                break;
            }
            left -= share;
        }
    }
    let [x0, y0, x1, y1] = chosen;
    DVec2::new(x0, y0) + DVec2::new(x1 - x0, y1 - y0) * dice.pair()
}
