//! What each engine costs in a scene, and which one `AUTO` takes. The only place where that is decided.
//!
//! A prediction is a function of the experiment alone: its constants were measured once, on one core of a 2026 server, and are never
//! adapted to a machine, so whoever runs an experiment again gets the same engine and the same counts.
//!
//! `events`: `photons · share · seconds an event + tables + pieces of work`; `expected`: the same for any light.

use super::setup::{Setup, UM_PER_TANGENT, setup};
use super::{Numerics, PlanError, PlannedTile, lit_wavelengths, planned_tiles};
use crate::experiment::{Engine, Experiment, RangeError};
use crate::exposure::EVENTS_NODE_UM;

/// CPU seconds per drawn photon of the `events` engine.
const SECONDS_PER_EVENT: f64 = 25e-9;
/// Share of the photons in the pupil that `events` draws, about.
const DRAWN_SHARE: f64 = 0.15;
/// Share of a white screen's light in a picture, about.
const LIT_SHARE: f64 = 0.5;
/// CPU seconds and bytes of one table to draw from, 3 mm pupil, and the powers of the pupil with which they grow.
const SECONDS_PER_TABLE: f64 = 1.5e-3;
const BYTES_PER_TABLE: f64 = 200e3;
const TABLE_POWERS: [i32; 2] = [5, 3];
/// CPU seconds of one piece of work, a block of 64 pixels near one wavelength of one primary.
const SECONDS_PER_PIECE: f64 = 0.5e-6;
/// CPU seconds of one pixel's place on the retina.
const SECONDS_PER_PLACE: f64 = 0.3e-6;
/// CPU seconds per photon of the `paper` engine.
const SECONDS_PER_PHOTON: f64 = 0.3e-6;
/// CPU seconds per point spread of the `paper` engine, at 1024 rays and 128 x 128 samples.
const SECONDS_PER_SPREAD: f64 = 0.06;
/// CPU seconds per cone that is made ready.
const SECONDS_PER_READY_CONE: f64 = 8e-6;
/// CPU seconds per cone and frame of the `expected` engine.
const SECONDS_PER_MEAN: f64 = 0.5e-6;
/// CPU seconds per pixel and primary of a picture that is looked up, transformed and added up.
const SECONDS_PER_LIGHT: f64 = 11e-9;
/// CPU seconds per cone and frame of counts that are gathered.
const SECONDS_PER_COUNT: f64 = 20e-9;
/// Basis images of several primaries, about, and of one.
pub(super) const IMAGES: f64 = 12.0;
const IMAGES_OF_ONE: f64 = 9.0;
/// CPU seconds per grid sample and basis image, and for each primary more: made ready, and of a frame.
const SECONDS_PER_READY_SAMPLE: [f64; 2] = [3e-9, 3e-9];
const SECONDS_PER_SAMPLE: [f64; 2] = [2.5e-9, 0.5e-9];
/// CPU seconds of the scattered light of a tile, with any engine: made ready, and of a frame; and per pixel of the display and primary.
const SECONDS_PER_SCATTERED_TILE: [f64; 2] = [0.6, 0.012];
const SECONDS_PER_SCATTERED_PIXEL: f64 = 40e-9;
/// `AUTO` takes `EVENTS` when it is predicted to take less than this share of what `EXPECTED` does.
const CLEARLY: f64 = 0.5;

/// Most photons that are listed, all frames, and in a frame.
const MAX_LISTED: f64 = 50e6;
const MAX_LISTED_IN_FRAME: f64 = 600e3;

/// What an engine costs beside the artifacts that all need, CPU seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EngineCost {
    pub(super) prepare: f64,
    pub(super) frame: f64,
}

impl EngineCost {
    /// Of all frames.
    pub(super) fn seconds(self, frames: u32) -> f64 {
        self.prepare + f64::from(frames) * self.frame
    }
}

/// The engine that `AUTO` takes for an experiment.
///
/// # Errors
/// Those of [`super::plan`].
pub fn automatic(experiment: &Experiment) -> Result<Engine, PlanError> {
    if !experiment.counts.poisson {
        return Ok(Engine::Expected);
    }
    let mut experiment = experiment.clone();
    experiment.counts.engine = Engine::Expected;
    experiment.validate()?;
    let setup = setup(&experiment)?;
    if clearly_not_events(&experiment, &setup) {
        return Ok(Engine::Expected);
    }
    let wavelengths = lit_wavelengths(&experiment)?;
    let tiles = planned_tiles(&experiment, &setup, &wavelengths.nodes_nm)?;
    let cones = super::cost::cones_in(&setup);
    let [expected, events] = both(&experiment, &setup, &tiles, cones);
    let better = events < CLEARLY * expected && drawn_in_target(&experiment, &setup, &tiles)?;
    Ok(if better { Engine::Events } else { Engine::Expected })
}

/// Whether the means of `events` are as good as an experiment asks for.
fn drawn_in_target(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> Result<bool, PlanError> {
    let mut experiment = experiment.clone();
    experiment.counts.engine = Engine::Events;
    let parts = super::error::estimate(&experiment, setup, tiles, &lit_wavelengths(&experiment)?);
    Ok(super::error::total(&parts) <= experiment.accuracy_target)
}

/// Whether the drawn photons of a whole screen alone take longer than `expected` does at most, with all frequencies of the eye: seen without
/// tracing a tile.
fn clearly_not_events(experiment: &Experiment, setup: &Setup) -> bool {
    if experiment.retina.region_deg.is_some() {
        return false;
    }
    let display = &experiment.display;
    let pixels = f64::from(display.width_px) * f64::from(display.height_px);
    let events = photons_per_pixel(experiment) * pixels * DRAWN_SHARE * SECONDS_PER_EVENT;
    let density = 2.0 * Numerics::new(experiment).oversampling * setup.cutoff(experiment);
    let samples: f64 = (setup.tiles.iter())
        .map(|tile| {
            let around = (tile.max - tile.min + 2.0 * setup.guard_um) / UM_PER_TANGENT * density;
            1.3 * around.x * around.y
        })
        .sum();
    let cones = super::cost::cones_in(setup);
    // What is made ready once counts as much as it would for one frame.
    let primaries = display.primaries.len() as f64;
    let of = |[each, more]: [f64; 2]| each + primaries * more;
    let images = samples * IMAGES * (of(SECONDS_PER_READY_SAMPLE) + of(SECONDS_PER_SAMPLE));
    let light = pixels * primaries * SECONDS_PER_LIGHT;
    let expected = cones * (SECONDS_PER_READY_CONE + SECONDS_PER_MEAN) + light + images;
    events > CLEARLY * expected
}

/// Whether the list of counted photons is as long as is served.
///
/// # Errors
/// With the predicted number, a bound for a white picture.
pub(super) fn check_list(experiment: &Experiment, tiles: &[PlannedTile]) -> Result<(), RangeError> {
    if !experiment.counts.photon_list {
        return Ok(());
    }
    let pixels = |t: &PlannedTile| t.scene.size_px.iter().map(|s| f64::from(*s)).product::<f64>();
    let per_pixel = photons_per_pixel(experiment) / LIT_SHARE * DRAWN_SHARE;
    let most = tiles.iter().map(pixels).fold(0.0, f64::max) * per_pixel;
    let all = tiles.iter().map(pixels).sum::<f64>() * per_pixel * f64::from(experiment.frames);
    if most > MAX_LISTED_IN_FRAME || all > MAX_LISTED {
        let value = format!("true with up to {all:.0} photons, {most:.0} in a frame");
        let allowed = format!(
            "true with at most {MAX_LISTED:.0} photons, {MAX_LISTED_IN_FRAME:.0} in a frame and tile"
        );
        return Err(RangeError::new("counts.photon_list", value, &allowed));
    }
    Ok(())
}

/// Why an engine counts an experiment, for people.
pub(super) fn reason(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile], cones: f64) -> String {
    let [expected, events] = both(experiment, setup, tiles, cones);
    let counts = &experiment.counts;
    let why = match counts.engine {
        Engine::Paper => "asked for",
        Engine::Expected if !counts.poisson => "means are asked for",
        Engine::Expected if events < CLEARLY * expected => match drawn_in_target(experiment, setup, tiles) {
            Ok(true) => "asked for",
            _ => "EVENTS is faster, but not as exact as the target",
        },
        Engine::Events if events >= CLEARLY * expected => "asked for",
        Engine::Expected => "EVENTS is not clearly faster",
        Engine::Events => "clearly faster",
    };
    format!("{why}; predicted seconds of counting: EXPECTED {expected:.3}, EVENTS {events:.3}")
}

/// Predicted seconds of `expected` and `events`, all frames.
fn both(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile], cones: f64) -> [f64; 2] {
    [Engine::Expected, Engine::Events]
        .map(|engine| cost(engine, experiment, setup, tiles, cones).seconds(experiment.frames))
}

/// What an engine costs, with the light scattered in the eye.
pub(super) fn cost(
    engine: Engine,
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    cones: f64,
) -> EngineCost {
    let own = own_cost(engine, experiment, setup, tiles, cones);
    if experiment.eye.stray_light.is_none() {
        return own;
    }
    let [ready, frame] = SECONDS_PER_SCATTERED_TILE.map(|seconds| seconds * tiles.len() as f64);
    let display = &experiment.display;
    let pixels = f64::from(display.width_px) * f64::from(display.height_px) * tiles.len() as f64;
    let light = pixels * super::lit::computed_primaries(experiment) as f64 * SECONDS_PER_SCATTERED_PIXEL;
    EngineCost { prepare: own.prepare + ready, frame: own.frame + frame + light }
}

/// The same without it.
fn own_cost(
    engine: Engine,
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    cones: f64,
) -> EngineCost {
    let waves = tiles.first().map_or(0, |t| t.kernels.nodes_nm.len()) as f64;
    let ready = cones * SECONDS_PER_READY_CONE;
    match engine {
        // Images of the grid, and a sum a cone.
        Engine::Expected => {
            let samples: f64 = tiles.iter().map(|t| t.scene.samples.iter().product::<usize>() as f64).sum();
            let primaries = super::lit::computed_primaries(experiment);
            let images = if primaries == 1 { IMAGES_OF_ONE } else { IMAGES };
            let primaries = primaries as f64;
            let of = |[each, more]: [f64; 2]| samples * images * (each + primaries * more);
            let light = pixels_of(tiles) * primaries * SECONDS_PER_LIGHT;
            EngineCost {
                prepare: ready + of(SECONDS_PER_READY_SAMPLE),
                frame: light + of(SECONDS_PER_SAMPLE) + cones * images / IMAGES * SECONDS_PER_MEAN,
            }
        }
        // Tables to draw from, then pixels and photons.
        Engine::Events => {
            let pupil = (experiment.eye.pupil_mm / 3.0).max(1.0).powi(TABLE_POWERS[0]);
            let pixels = pixels_of(tiles);
            let layers = super::lit::computed_primaries(experiment) as f64;
            let drawn = photons_per_pixel(experiment) * pixels * DRAWN_SHARE;
            EngineCost {
                prepare: ready + nodes(setup, EVENTS_NODE_UM) * waves * SECONDS_PER_TABLE * pupil,
                frame: drawn * SECONDS_PER_EVENT
                    + pixels * layers * (SECONDS_PER_PLACE + waves / 64.0 * SECONDS_PER_PIECE)
                    + cones * SECONDS_PER_COUNT,
            }
        }
        // Sums over rays, then every photon.
        Engine::Paper => {
            let rays = f64::from(experiment.counts.paper.rays) / 1024.0;
            let side = f64::from(experiment.counts.paper.samples) / 128.0;
            let display = &experiment.display;
            let pixels = f64::from(display.width_px) * f64::from(display.height_px);
            EngineCost {
                prepare: nodes(setup, 300.0) * waves * SECONDS_PER_SPREAD * rays * side * side,
                frame: photons_per_pixel(experiment) * pixels * SECONDS_PER_PHOTON,
            }
        }
    }
}

/// Field nodes of a patch at a distance, about.
fn nodes(setup: &Setup, um: f64) -> f64 {
    let size = setup.region.max - setup.region.min;
    (size.x / um + 2.0) * (size.y / um + 2.0)
}

/// Bytes of the tables of `events`.
pub(super) fn table_bytes(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> f64 {
    let waves = tiles.first().map_or(0, |t| t.kernels.nodes_nm.len()) as f64;
    let pupil = (experiment.eye.pupil_mm / 3.0).max(1.0).powi(TABLE_POWERS[1]);
    nodes(setup, EVENTS_NODE_UM) * waves * BYTES_PER_TABLE * pupil
}

/// Pixels of all windows.
fn pixels_of(tiles: &[PlannedTile]) -> f64 {
    tiles.iter().map(|t| t.scene.size_px.iter().map(|s| f64::from(*s)).product::<f64>()).sum()
}

/// Photons from a pixel into the pupil in a frame, about.
fn photons_per_pixel(experiment: &Experiment) -> f64 {
    let display = &experiment.display;
    let emitted = crate::display::emitters(display)
        .map_or(0.0, |e| e.iter().map(crate::display::Emitter::emitted).sum());
    LIT_SHARE * emitted * crate::display::pupil_share(display, experiment.eye.pupil_mm)
}
