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
use super::light::{Segment, Shown};
use super::poisson;
use super::scene::Scene;
use super::source::{Layer, Projector};
use crate::display::Emitter;
use crate::experiment::Experiment;
use crate::retina::ConeIndex;
use crate::rng::{Purpose, Stream, mixed};
use landing::{Landing, Patch};
use tables::Tables;

/// Pixels that share a Poisson draw.
const CHUNK: usize = 64;
/// Arriving photons are added up as whole multiples of this share: then the order of adding does not matter.
const GRAIN: f64 = 1.0 / 1_048_576.0;

/// The prepared engine.
pub struct Events {
    seed: u64,
    /// Hash of the result tile's place: tiles draw photons of their own.
    place: u64,
    scene: Scene,
    index: ConeIndex,
    landing: Landing,
    tables: Tables,
    /// By pixel of the window: share of its light that meets the pupil, relative to the gaze centre.
    slant: Vec<f64>,
}

/// What one thread has counted, and the grains of photons that arrived and were guided.
struct Tally {
    counts: Vec<u32>,
    arrived: u64,
    guided: u64,
}

/// One frame's photons of one layer of light near one wavelength node.
struct Beam<'a> {
    emitter: &'a Emitter,
    primary: usize,
    wave: usize,
    layer: &'a Layer,
    /// By pixel: light that meets the pupil.
    light: &'a [f64],
    /// Share of it that is drawn.
    rate: f64,
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
        let Inputs { retina, kernels, projection, projector, scene, .. } = inputs;
        let (low, high) =
            super::bounds(cones.cones.iter().flat_map(|c| c.polygon_px.iter().map(|p| scene.tangent(*p))));
        let landing = Landing::new(projection, scene, [low, high])?;
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
            place: mixed(kernels.spec().field_um[0].x.to_bits(), kernels.spec().field_um[0].y.to_bits()),
            scene: scene.clone(),
            index: ConeIndex::new(retina),
            landing,
            tables,
            slant,
        })
    }

    /// Simulates a frame: counts by cone, and unbiased estimates of the photons that arrived and were guided.
    pub fn frame(&self, shown: &Shown, projector: &Projector) -> (Vec<u32>, Means) {
        let source = projector.frame(shown, &self.scene);
        let layers: Vec<(usize, &Layer, Vec<f64>)> = (0..)
            .zip(&source.primaries)
            .flat_map(|(primary, p)| p.layers.iter().map(move |layer| (primary, layer)))
            .map(|(primary, layer)| {
                let light = layer.light.iter().zip(&self.slant).map(|(light, slant)| light * slant);
                (primary, layer, light.collect())
            })
            .collect();
        // Pieces of work in a fixed order; what each draws depends on its own numbers only, and counts are whole numbers.
        let chunks = self.slant.len().div_ceil(CHUNK);
        let pieces: Vec<(usize, usize, usize)> = (0..layers.len())
            .flat_map(|l| (0..self.tables.waves()).map(move |m| (l, m)))
            .flat_map(|(l, m)| (0..chunks).map(move |chunk| (l, m, chunk)))
            .collect();
        let groups = rayon::current_num_threads().max(1);
        let tallies: Vec<Tally> = (0..groups)
            .into_par_iter()
            .map(|group| {
                let mut tally = Tally { counts: vec![0; self.tables.cones()], arrived: 0, guided: 0 };
                for &(l, wave, chunk) in pieces.iter().skip(group).step_by(groups) {
                    let (primary, layer, light) = &layers[l];
                    let share: f64 = layer.segments.iter().map(|s| s.share).sum();
                    let beam = Beam {
                        emitter: &projector.emitters[*primary],
                        primary: *primary,
                        wave,
                        layer,
                        light,
                        rate: share * self.tables.most(*primary, wave),
                    };
                    let number = ((l * self.tables.waves() + wave) as u64) << 40 | chunk as u64;
                    let stream = Stream::new(
                        self.seed,
                        Purpose::Events,
                        u64::from(shown.index),
                        mixed(self.place, number),
                    );
                    self.chunk(stream, &beam, chunk, &mut tally);
                }
                tally
            })
            .collect();
        let mut counts = vec![0_u32; self.tables.cones()];
        let (mut arrived, mut guided) = (0, 0);
        for tally in tallies {
            counts.iter_mut().zip(tally.counts).for_each(|(sum, count)| *sum = sum.saturating_add(count));
            (arrived, guided) = (arrived + tally.arrived, guided + tally.guided);
        }
        let means = Means {
            isomerized: counts.iter().map(|count| f64::from(*count)).collect(),
            arrived: arrived as f64 * GRAIN,
            guided: guided as f64 * GRAIN,
            clamped: 0,
        };
        (counts, means)
    }

    /// All photons of a beam from one chunk of pixels.
    fn chunk(&self, mut stream: Stream, beam: &Beam, chunk: usize, tally: &mut Tally) {
        let from = chunk * CHUNK;
        let pixels = CHUNK.min(beam.light.len() - from);
        let mut cumulative = [0.0; CHUNK];
        let mut total = 0.0;
        for (sum, light) in cumulative.iter_mut().zip(&beam.light[from..]) {
            total += light;
            *sum = total;
        }
        let drawn = poisson::from_stream(&mut stream, total * beam.rate) as u64;
        if drawn == 0 {
            return;
        }
        let width = self.scene.size_px[0] as usize;
        let patches: Vec<Patch> = (from..from + pixels)
            .map(|pixel| {
                let corner = DVec2::new((pixel % width) as f64, (pixel / width) as f64);
                self.landing.patch(&self.scene, corner, &beam.layer.segments)
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
        let Some(seen) = patch.landing(&self.landing, place, sight(&beam.layer.segments, time)) else {
            return;
        };
        let node = self.tables.node(seen, beam.wave, dice.pair());
        let offset = node.spread.draw(dice.bits(), || dice.pair());
        let landed = seen + node.shift_um + node.chart_from_tangents * offset;
        let Some(owner) = self.index.owner(landed) else {
            return;
        };
        let cone = owner as usize;
        let odds = self.tables.odds(cone, beam.primary, beam.wave, node);
        tally.arrived += (odds.arrived / GRAIN) as u64;
        tally.guided += (odds.guided / GRAIN) as u64;
        if dice.pair().x < odds.counted {
            tally.counts[cone] = tally.counts[cone].saturating_add(1);
        }
    }
}

/// The line of sight when a photon leaves, for a uniform number: pixels from the gaze centre.
fn sight(segments: &[Segment], uniform: f64) -> DVec2 {
    let total: f64 = segments.iter().map(|s| s.share).sum();
    let mut left = uniform * total;
    let last = segments.len() - 1;
    let mut chosen = &segments[last];
    for segment in &segments[..last] {
        if left < segment.share {
            chosen = segment;
            break;
        }
        left -= segment.share;
    }
    let u = if chosen.share > 0.0 { (left / chosen.share).clamp(0.0, 1.0) } else { 0.5 };
    // The light falls as e^{-decay x}: the inverse of its distribution.
    let x = if chosen.decay < 1e-9 { u } else { -(u * (-chosen.decay).exp_m1()).ln_1p() / chosen.decay };
    chosen.sight[0].lerp(chosen.sight[1], x)
}

/// A point of the emitter's rectangles, pixel units.
fn place(emitter: &Emitter, dice: &mut Dice) -> DVec2 {
    let uniform = if emitter.rects.len() > 1 { dice.pair().x } else { 0.0 };
    let [x0, y0, x1, y1] = emitter.rect(uniform);
    let place = DVec2::new(x0, y0) + DVec2::new(x1 - x0, y1 - y0) * dice.pair();
    if emitter.spot_sd_px > 0.0 {
        let pair = dice.pair();
        let radius = emitter.spot_sd_px * (-2.0 * (1.0 - pair.x).ln()).sqrt();
        return place + DVec2::from_angle(std::f64::consts::TAU * pair.y) * radius;
    }
    place
}
