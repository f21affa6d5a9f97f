//! Engine `events`: photon by photon, but only photons that could count (§22, thinned).
//!
//! A frame's photons of primary k near wavelength node m reach the pupil from pixel p as a Poisson number of mean n_kp·share. Of these
//! only a share W_km, the most that any cone could count of them, is drawn; each drawn photon gets a pixel (by its light), a place in the
//! pixel, a time, a point spread (one of the four nearest field nodes, by chance with bilinear weights), a landing point and so a
//! cone, which counts it with probability w/W, its own share over the most. Thinning a Poisson process leaves a Poisson process, so counts
//! have the same distribution as in `paper` and `expected`; the weights w are those of `expected` (see `spectral`).
//!
//! Light of the screen beyond the window is added as a Poisson number a cone ([`beyond`]); so is light scattered in the eye, and of the
//! image's photons only those that are not scattered are drawn ([`scattered`]).
//!
//! Landing: place on the screen -> retina at 543 nm by a polynomial fitted to chief rays, affine inside a pixel; plus the transverse chromatic
//! shift of the node; plus an offset from the point spread's table ([`spread`]).
//!
//! # Randomness
//! A piece of work is one layer of light from one block of pixels near one wavelength node. Its key is made of seed, frame, tile and the
//! piece's number, and every photon hashes its numbers from key and place in the piece; sums are of whole numbers: the same bytes for any
//! number of threads. With a list of photons each course of the light is a layer of its own even for an eye that rests.
//!
//! # Cost
//! Time grows with the number of drawn photons, not with cones or pixels; the tables take milliseconds a node and wavelength.

mod beyond;
mod dice;
mod landing;
mod list;
mod piece;
mod scattered;
mod sight;
mod spread;
mod stage;
mod tables;

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use rayon::prelude::*;

use super::cones::ConeTable;
use super::expected::Means;
use super::inputs::Inputs;
use super::light::Shown;
use super::primaries::Primaries;
use super::scene::Scene;
use super::source::{Layer, Projector};
use super::stray::Veil;
use super::turned::{Displaced, Turn, Turning};
use crate::display::EmissionLaw;
use crate::experiment::Experiment;
use crate::exposure::Photon;
use crate::optics::BeamField;
use crate::retina::ConeIndex;
use crate::rng::{Purpose, Stream, mixed};
use beyond::{Beyond, More};
use landing::Landing;
use list::{Lister, MAX_PHOTONS};
use piece::{BLOCK, BLOCK_TANGENT, Block, GRAIN, Piece, Tally, Wave};
use scattered::Scattered;
use sight::Sight;
use stage::Stage;
use tables::Tables;

pub(crate) use tables::NODE_UM;

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
    /// Light of the screen beyond the window.
    beyond: Option<Beyond>,
    /// Light scattered in the eye, and the fraction that is not.
    scattered: Option<Scattered>,
    kept: f64,
    /// How the cones see the screen as the eye turns.
    turning: Option<Turning>,
    beams: BeamField,
    law: EmissionLaw,
    /// Whether counted photons are listed.
    listed: bool,
}

/// One frame.
pub struct Drawn {
    /// By cone.
    pub counts: Vec<u32>,
    /// Unbiased estimates of the photons that arrived and were guided.
    pub means: Means,
    /// Photons that were followed.
    pub photons: u64,
    /// Those that were counted, in order of time, when they are asked for.
    pub list: Option<Vec<Photon>>,
}

impl Events {
    /// Prepares tables and cones.
    ///
    /// # Errors
    /// When a part of the window is not seen or the pupil cannot be traced.
    pub fn new(
        experiment: &Experiment,
        inputs: &Inputs,
        primaries: &Primaries,
        cones: &ConeTable,
    ) -> Result<Self, String> {
        let Inputs { retina, projection, scene, .. } = inputs;
        let Primaries { kernels, projector } = primaries;
        let (low, high) =
            super::bounds(cones.cones.iter().flat_map(|c| c.polygon_px.iter().map(|p| scene.tangent(*p))));
        let landing = Landing::new(projection, scene, [low, high])?;
        let index = ConeIndex::new(retina);
        let tables = Tables::new((inputs, kernels), (cones, &index), &landing, experiment)?;
        let [width, height] = scene.size_px;
        let law = projector.display.emission_law;
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        let middle = |(column, row)| DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let slant = pixels
            .map(|pixel| super::cones::entering(law, &inputs.beams, scene.tangent(middle(pixel))))
            .collect();
        let veil = |stray| Veil::new((experiment, inputs), primaries, cones, stray);
        let veil = experiment.eye.stray_light.map(veil).transpose()?;
        let kept = veil.as_ref().map_or(1.0, Veil::kept);
        let (seed, ids) = (experiment.noise_seed(), &retina.id);
        Ok(Self {
            seed,
            place: mixed(kernels.spec().field_um[0].x.to_bits(), kernels.spec().field_um[0].y.to_bits()),
            scene: scene.clone(),
            index,
            landing,
            tables,
            slant,
            beyond: Beyond::new(scene, primaries, cones, veil.is_some()),
            scattered: veil.map(|veil| Scattered { veil, seed, ids: ids.clone() }),
            kept,
            turning: inputs.turning(experiment),
            beams: inputs.beams.clone(),
            law,
            listed: experiment.counts.photon_list,
        })
    }

    /// Simulates a frame.
    ///
    /// # Errors
    /// When more photons are to be listed than are served.
    pub fn frame(&self, shown: &Shown, projector: &Projector) -> Result<Drawn, String> {
        let source = if self.listed {
            projector.frame_in_time(shown, &self.scene)
        } else {
            projector.frame(shown, &self.scene)
        };
        let sight = |part: f64| {
            let seconds = (f64::from(shown.index) + part) / projector.display.frame_rate_hz;
            let tangent = projector.gaze.screen_tangent(seconds);
            DVec2::new(tangent.x, -tangent.y) / self.scene.tangent_per_px
        };
        let layers: Vec<(usize, &Layer, Sight)> = (0..)
            .zip(&source.primaries)
            .flat_map(|(primary, p)| p.layers.iter().map(move |layer| (primary, layer)))
            .map(|(primary, layer)| (primary, layer, Sight::new(layer, &sight)))
            .collect();
        let turn = self.turning.as_ref().map(|turning| turning.in_frame(shown.index));
        // Pieces of work are taken as they come: what each draws depends on its own numbers only, and all sums are of whole numbers.
        let blocks = self.blocks().into_iter().product::<usize>();
        let next = AtomicUsize::new(0);
        let tallies: Vec<Tally> = (0..rayon::current_num_threads().max(1))
            .into_par_iter()
            .with_max_len(1)
            .map(|_| {
                let (mut tally, mut stage) = (Tally::new(self.tables.cones()), Stage::new());
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= blocks * layers.len() {
                        return tally;
                    }
                    let (layer, block) = (number / blocks, number % blocks);
                    let state = (&mut stage, &mut tally);
                    self.piece((shown, turn.as_ref()), projector, &layers[layer], [layer, block], state);
                }
            })
            .collect();
        let mut sum = Tally::new(self.tables.cones());
        for tally in tallies {
            sum.add(tally);
        }
        let mut means = Means {
            isomerized: Vec::new(),
            arrived: sum.arrived as f64 * GRAIN,
            guided: sum.guided as f64 * GRAIN,
            clamped: 0,
        };
        if let Some(beyond) = &self.beyond {
            let frame = u64::from(shown.index);
            let stream = &mut Stream::new(self.seed, Purpose::Events, frame, mixed(self.place, u64::MAX));
            let list = self.listed.then_some(&mut sum.list);
            let mut more = More { counts: &mut sum.counts, means: &mut means, list };
            beyond.count((shown, &source), (projector, self.kept), &self.tables, stream, &mut more);
        }
        if let Some(scattered) = &self.scattered {
            let list = self.listed.then_some(&mut sum.list);
            let mut more = More { counts: &mut sum.counts, means: &mut means, list };
            scattered.count(shown, projector, &self.tables, &mut more);
        }
        means.isomerized = sum.counts.iter().map(|count| f64::from(*count)).collect();
        let list = self.listed.then(|| listed(sum.list)).transpose()?;
        Ok(Drawn { counts: sum.counts, means, photons: sum.drawn, list })
    }

    /// Pixels along the side of a block.
    fn block_px(&self) -> usize {
        ((BLOCK_TANGENT / self.scene.tangent_per_px) as usize).clamp(1, BLOCK)
    }

    /// Blocks of pixels along each side of the window.
    fn blocks(&self) -> [usize; 2] {
        self.scene.size_px.map(|size| (size as usize).div_ceil(self.block_px()))
    }

    /// All photons of a layer from a block of pixels.
    fn piece(
        &self,
        (shown, turn): (&Shown, Option<&Turn>),
        projector: &Projector,
        (primary, layer, sight): &(usize, &Layer, Sight),
        [number, block]: [usize; 2],
        (stage, tally): (&mut Stage, &mut Tally),
    ) {
        // Take the light of the block's pixels, each where the turned eye sees it.
        let [width, height] = self.scene.size_px.map(|size| size as usize);
        let (side, across) = (self.block_px(), self.blocks()[0]);
        let (left, top) = (block % across * side, block / across * side);
        let rows = top..(top + side).min(height);
        let pixels = rows.flat_map(|row| (left..(left + side).min(width)).map(move |column| [column, row]));
        let bounds = sight.bounds();
        let block_of_light = Block::new(pixels.filter_map(|[column, row]| {
            let pixel = row * width + column;
            let light = layer.light[pixel] * layer.photons * self.kept;
            let corner = DVec2::new(column as f64, row as f64);
            if light <= 0.0 {
                return None;
            }
            let (displaced, entering) = turn.map_or((Displaced::AT_REST, self.slant[pixel]), |turn| {
                let middle = corner + 0.5 - 0.5 * (bounds[0] + bounds[1]);
                turn.entering(middle, &self.scene, (self.law, &self.beams))
            });
            let (place, light) = ((corner - displaced.apart, displaced.stretch), light * entering);
            (light > 0.0).then(|| (light, self.landing.patch(&self.scene, place, bounds)))
        }));
        if block_of_light.is_dark() {
            return;
        }
        // Find the cones that it falls on.
        let corner = self.scene.tangent(DVec2::new(left as f64, top as f64) - 0.5 * (bounds[0] + bounds[1]));
        let origin = self.index.origin(self.landing.um(corner));
        let cones = (&self.index, origin, self.tables.field(&self.index, origin));
        let piece = Piece::new(&projector.emitters[*primary], sight, block_of_light, cones);
        // Draw photons near each wavelength, with a stream of their own.
        for wave in 0..self.tables.waves() {
            let rate = self.tables.most(*primary, wave);
            if rate <= 0.0 {
                continue;
            }
            let frame_s = 1.0 / projector.display.frame_rate_hz;
            let lister = self.tables.wavelengths(*primary, wave).zip(layer.course.as_ref());
            let lister = lister.map(|(wavelengths, course)| Lister {
                wavelengths,
                course,
                frame: shown.index,
                frame_s,
            });
            let part = Wave { beam: self.tables.beam(*primary, wave), rate, lister };
            let number = ((number * self.tables.waves() + wave) as u64) << 40 | block as u64;
            let frame = u64::from(shown.index);
            let mut stream = Stream::new(self.seed, Purpose::Events, frame, mixed(self.place, number));
            piece.count(&self.landing, &part, &mut stream, (stage, tally));
        }
    }
}

/// The photons of a frame in an order that does not depend on who counted them.
fn listed(mut photons: Vec<Photon>) -> Result<Vec<Photon>, String> {
    if photons.len() > MAX_PHOTONS {
        return Err(format!(
            "counts.photon_list: more than {MAX_PHOTONS} photons are counted in one frame and tile; take a dimmer display, a higher frame rate or a smaller patch"
        ));
    }
    let key = |p: &Photon| (p.time_s.to_bits(), p.cone, p.wavelength_nm.to_bits());
    photons.sort_unstable_by_key(key);
    Ok(photons)
}
