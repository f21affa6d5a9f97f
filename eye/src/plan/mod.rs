//! The plan: what a scene needs, what is left out and why, and what it costs, before anything is computed.

mod apertures;
mod band;
mod cost;
pub mod engine;
mod error;
pub mod focus;
pub mod largest;
mod lit;
mod numerics;
mod omissions;
mod rules;
pub mod seen;
pub mod setup;
mod wavelengths;

use std::collections::BTreeSet;

use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::artifact::ArtifactSpec;
use crate::cone::pigment::{Pigments, unbleached};
use crate::digest::Digest;
use crate::display::emitters;
use crate::experiment::{Engine, Experiment};
use crate::exposure::KernelSpec;
use crate::exposure::field::table_for;
use crate::exposure::inputs::pointing_of;
use crate::exposure::padua::FieldNodes;
use crate::exposure::scene::Scene;
use crate::exposure::spectral::Absorbers;
use crate::media::Media;
use crate::retina::{RegionUm, tiles_for};
pub use cost::{Machine, Stages};
use focus::Focused;
pub use numerics::{Knobs, Numerics};
pub use rules::Rule;
pub use seen::DisplaySeen;
use setup::Setup;

/// What will be computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Digest of the experiment.
    pub experiment: Digest,
    /// `EXPECTED`, `EVENTS` or `PAPER`.
    pub engine: String,
    /// Why, with the predicted seconds of `EXPECTED` and `EVENTS`.
    #[serde(default)]
    pub engine_reason: String,
    /// Retinal rectangle, µm of arc from the foveal centre.
    pub region: RegionUm,
    /// Wavelengths at which the optics are computed, nm.
    pub wavelengths_nm: Vec<f64>,
    /// Points of the field at which the optics are computed.
    pub field_nodes: u32,
    /// Sampling grid, samples.
    pub grid: [u32; 2],
    /// Artifacts, each after the ones it is made from.
    pub artifacts: Vec<PlannedArtifact>,
    /// Pieces of work, in frame and tile order.
    pub shards: Vec<Shard>,
    /// Per result tile, the keys of the artifacts that its shards need: first the cones, then the kernels.
    pub tile_artifacts: Vec<Vec<Digest>>,
    /// What is left out.
    pub omissions: Vec<Omission>,
    /// Cones in the region, about.
    pub predicted_cones: f64,
    /// CPU seconds without cached artifacts, about.
    pub predicted_seconds: f64,
    /// The same by stage.
    #[serde(default)]
    pub predicted_stages: Stages,
    /// Memory, bytes, about.
    pub predicted_bytes: f64,
    /// What the settings were chosen for: relative error of the mean per cone (L1 over cones), with its parts.
    pub error_estimate: Vec<ErrorPart>,
    /// Where the display is seen.
    #[serde(default)]
    pub display: DisplaySeen,
    /// How the eye is focused.
    #[serde(default)]
    pub focus: Focused,
    /// What the experiment is probably not meant to be.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// One part of the error estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorPart {
    /// Where it comes from.
    pub part: String,
    /// Relative error of the mean per cone, L1 over cones.
    pub relative: f64,
}

/// An artifact that the plan needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedArtifact {
    /// Hash of kind, version and inputs.
    pub key: Digest,
    /// The inputs.
    pub spec: ArtifactSpec,
    /// Keys of the artifacts it is made from.
    pub inputs: Vec<Digest>,
    /// CPU seconds to build, about.
    pub predicted_seconds: f64,
    /// Size, bytes, about.
    pub predicted_bytes: f64,
}

/// A piece of work: some frames of one result tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// First frame.
    pub first_frame: u32,
    /// Number of frames.
    pub frame_count: u32,
    /// Result tile: index into `tile_artifacts`.
    pub tile: u32,
}

/// Something that is not computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Omission {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
    /// Bound on the relative error that it causes.
    pub bound: f64,
}

/// Why there is no plan.
#[derive(Clone, Debug, thiserror::Error)]
pub enum PlanError {
    /// A field cannot be served.
    #[error(transparent)]
    Range(#[from] crate::experiment::RangeError),
    /// The optics refuse the eye or the scene.
    #[error("{0}")]
    Model(String),
}

/// Frames in one shard.
const SHARD_FRAMES: u32 = 16;

/// Plans an experiment. Runs in milliseconds; builds nothing.
///
/// # Errors
/// A field that is out of range or cannot be served, with its name, value and what is possible.
pub fn plan(experiment: &Experiment) -> Result<Plan, PlanError> {
    plan_on(experiment, &Machine::default())
}

/// As [`plan`], with the seconds of a machine.
///
/// # Errors
/// As [`plan`].
pub fn plan_on(experiment: &Experiment, machine: &Machine) -> Result<Plan, PlanError> {
    experiment.validate()?;
    let setup = setup::setup(experiment)?;
    pointing_of(experiment, &setup)?;
    let wavelengths = lit_wavelengths(experiment)?;
    let tiles = planned_tiles(experiment, &setup, &wavelengths.nodes_nm)?;
    let cost = cost::predict(experiment, &setup, &tiles, machine);
    let field_nodes = tiles.iter().map(|t| FieldNodes::count(t.kernels.field_nodes)).sum();
    let grid = tiles.iter().fold([0, 0], |g, t| [g[0].max(t.scene.samples[0]), g[1].max(t.scene.samples[1])]);
    let error_estimate = error::estimate(experiment, &setup, &tiles, &wavelengths);
    if !error::is_met(experiment, &error_estimate) {
        error::refuse(experiment, &error_estimate, estimate)?;
    }
    let omissions = omissions::list(experiment, &setup, &tiles, &wavelengths);
    engine::check_list(experiment, &tiles)?;
    largest::check(experiment, &setup)?;
    let engine_reason = engine::reason(experiment, &setup, &tiles, cost.cones);
    let focus = focus::focused(experiment)?;
    let mut warnings = seen::warnings(experiment, &setup, &tiles);
    warnings.extend(seen::blur_warning(experiment, &focus));
    let count = tiles.len() as u32;
    let (artifacts, tile_artifacts) = artifacts(&setup, tiles, &cost)?;
    let frames = (0..experiment.frames)
        .step_by(SHARD_FRAMES as usize)
        .map(|first| (first, SHARD_FRAMES.min(experiment.frames - first)));
    let shards = frames
        .flat_map(|(first_frame, frame_count)| {
            (0..count).map(move |tile| Shard { first_frame, frame_count, tile })
        })
        .collect();
    Ok(Plan {
        experiment: experiment.digest().map_err(|e| PlanError::Model(e.to_string()))?,
        engine: match experiment.counts.engine {
            Engine::Expected => "EXPECTED".into(),
            Engine::Paper => "PAPER".into(),
            Engine::Events => "EVENTS".into(),
        },
        engine_reason,
        region: setup.region,
        field_nodes,
        grid: grid.map(|s| s as u32),
        artifacts,
        shards,
        tile_artifacts,
        omissions,
        predicted_cones: cost.cones,
        predicted_seconds: cost.stages.total(),
        predicted_stages: cost.stages,
        predicted_bytes: cost.bytes,
        error_estimate,
        display: seen::display_seen(experiment)?,
        focus,
        warnings,
        wavelengths_nm: wavelengths.nodes_nm,
    })
}

/// The error estimate of an experiment.
fn estimate(experiment: &Experiment) -> Result<Vec<ErrorPart>, PlanError> {
    let setup = setup::setup(experiment)?;
    let wavelengths = lit_wavelengths(experiment)?;
    let tiles = planned_tiles(experiment, &setup, &wavelengths.nodes_nm)?;
    Ok(error::estimate(experiment, &setup, &tiles, &wavelengths))
}

/// The wavelengths at which an experiment is computed.
fn lit_wavelengths(experiment: &Experiment) -> Result<wavelengths::Wavelengths, PlanError> {
    let emitters = emitters(&experiment.display).map_err(PlanError::Model)?;
    let absorbers = Absorbers {
        media: Media::new(experiment.eye.lens_density_scale, experiment.eye.macular_peak_density)
            .map_err(PlanError::Model)?
            .with_cornea_scale(experiment.eye.cornea_density_scale),
        pigments: Pigments::new().map_err(PlanError::Model)?.with_unbleached(part_unbleached(experiment)),
    };
    Ok(wavelengths::choose(experiment, &emitters, &lit::primaries(experiment), &absorbers))
}

/// The result tiles of an experiment.
fn planned_tiles(
    experiment: &Experiment,
    setup: &Setup,
    nodes_nm: &[f64],
) -> Result<Vec<PlannedTile>, PlanError> {
    let tile = |region: &RegionUm| {
        let scene = setup.scene(experiment, region)?;
        let kernels = kernel_spec(experiment, setup, region, &scene, nodes_nm.to_vec());
        Ok(PlannedTile { region: *region, scene, kernels })
    };
    let mut tiles: Vec<PlannedTile> = setup.tiles.par_iter().map(tile).collect::<Result<_, PlanError>>()?;
    let kernels: Vec<&KernelSpec> = tiles.iter().map(|tile| &tile.kernels).collect();
    let table =
        setup.reach_deg().and_then(|reach| table_for(&kernels, &setup.projection, reach)).map(Box::new);
    for tile in &mut tiles {
        tile.kernels.wavefronts.clone_from(&table);
    }
    Ok(tiles)
}

/// A result tile with what it is computed with.
struct PlannedTile {
    region: RegionUm,
    scene: Scene,
    kernels: KernelSpec,
}

/// The mosaic's tiles; then, for each result tile, the cones put together from them and the kernels; and what each tile's shards need.
fn artifacts(
    setup: &Setup,
    result_tiles: Vec<PlannedTile>,
    cost: &cost::Cost,
) -> Result<(Vec<PlannedArtifact>, Vec<Vec<Digest>>), PlanError> {
    let planned = |spec: ArtifactSpec, predicted_seconds: f64, predicted_bytes: f64| {
        let key = spec.key().map_err(|e| PlanError::Model(e.to_string()))?;
        Ok::<_, PlanError>(PlannedArtifact {
            key,
            inputs: spec.inputs().map_err(|e| PlanError::Model(e.to_string()))?,
            spec,
            predicted_seconds,
            predicted_bytes,
        })
    };
    let count = tiles_for(&setup.region).len() as f64;
    let parts = result_tiles.len() as f64;
    let mut artifacts: Vec<PlannedArtifact> = Vec::new();
    let mut known = BTreeSet::new();
    let mut needed = Vec::new();
    if let Some(table) = result_tiles.first().and_then(|tile| tile.kernels.wavefronts.clone()) {
        let traced = table.traced().map_err(|e| PlanError::Model(e.to_string()))? as f64;
        let (seconds, bytes) = (cost::SECONDS_PER_WAVEFRONT * traced, cost::BYTES_PER_WAVEFRONT * traced);
        artifacts.push(planned(ArtifactSpec::Wavefronts(table), seconds, bytes)?);
    }
    for PlannedTile { region, kernels, .. } in result_tiles {
        let kernels = ArtifactSpec::Kernels(Box::new(kernels));
        let kernels = planned(kernels, cost.stages.optics / parts, cost.kernel_bytes / parts)?;
        if let Some((table, type_unknown)) = &setup.mosaic {
            let params = Box::new(setup.retina.clone());
            let (table, type_unknown) = (table.clone(), *type_unknown);
            let cones = ArtifactSpec::MeasuredCones { table, params, type_unknown, region };
            let cones = planned(cones, cost.stages.mosaic / parts, cost.cones_bytes / parts)?;
            needed.push(vec![cones.key, kernels.key]);
            artifacts.extend([cones, kernels]);
            continue;
        }
        let mut mosaic = Vec::new();
        for tile in tiles_for(&region) {
            let spec = ArtifactSpec::RetinaTile { params: Box::new(setup.retina.clone()), tile };
            let tile = planned(spec, cost.stages.mosaic / count, cost.tiles_bytes / count)?;
            mosaic.push(tile.key);
            if known.insert(tile.key) {
                artifacts.push(tile);
            }
        }
        let cones = ArtifactSpec::Cones { tiles: mosaic, region };
        let cones = planned(cones, 0.02 * cost.stages.mosaic / parts, cost.cones_bytes / parts)?;
        needed.push(vec![cones.key, kernels.key]);
        artifacts.extend([cones, kernels]);
    }
    Ok((artifacts, needed))
}

/// Half of the longer side of a tile, visual degrees about.
fn half_side_deg(tile: &RegionUm) -> f64 {
    0.5 * (tile.max - tile.min).max_element() / setup::UM_PER_TANGENT * 180.0 / std::f64::consts::PI
}

/// Pupil beyond which the field takes one point a side more, mm. One lit pixel of one wavelength at 6 mm with three and four: 9.6e-4 and 8e-4.
const LARGE_PUPIL_MM: f64 = 4.5;

/// Blur beyond which it does, unit tangents. One lit pixel, 4 mm, 20° from the fovea, with three and four:
/// 3.4e-3 and 2.0e-3.
const WIDE_BLUR: f64 = 3e-3;
/// Target from which on that is not seen.
const COARSE_TARGET: f64 = 5e-3;

/// Points along each side of a tile at which the optics are computed.
fn field_nodes(experiment: &Experiment, setup: &Setup, tile: &RegionUm) -> u32 {
    if let Some(nodes) = experiment.counts.knobs.field_nodes {
        return nodes;
    }
    let nodes = match half_side_deg(tile) {
        _ if !Rule::FieldNodes.applies(experiment) => 4,
        half if half < 0.1 => 1,
        half if half < 0.9 => 2,
        _ => 3,
    };
    // Behind a large pupil PSFs change faster over the field, and spread farther.
    let blur = setup.seen(experiment, tile).map_or(0.0, |seen| seen.blur);
    let wide = blur > WIDE_BLUR && experiment.accuracy_target < COARSE_TARGET;
    let large = i32::from(experiment.eye.pupil_mm > LARGE_PUPIL_MM || wide);
    (nodes + large + Numerics::new(experiment).finer_field).max(1) as u32
}

/// Part of the cones' pigment that is not bleached.
fn part_unbleached(experiment: &Experiment) -> f64 {
    experiment.retina.bleaching_td.map_or(1.0, unbleached)
}

fn kernel_spec(
    experiment: &Experiment,
    setup: &Setup,
    tile: &RegionUm,
    scene: &Scene,
    nodes_nm: Vec<f64>,
) -> KernelSpec {
    let farthest =
        [tile.min, tile.max, DVec2::new(tile.min.x, tile.max.y), DVec2::new(tile.max.x, tile.min.y)]
            .iter()
            .map(|corner| corner.length())
            .fold(0.0, f64::max);
    let ecc_max = farthest / setup::UM_PER_TANGENT * 180.0 / std::f64::consts::PI;
    let nearest = DVec2::ZERO.clamp(tile.min, tile.max).length();
    let ecc_min = nearest / setup::UM_PER_TANGENT * 180.0 / std::f64::consts::PI;
    KernelSpec {
        prescription: setup.prescription.clone(),
        state: setup.state,
        screen: *setup.projection.screen(),
        emission_law: experiment.display.emission_law,
        field_um: [tile.min, tile.max],
        field_nodes: field_nodes(experiment, setup, tile),
        ecc_deg: [ecc_min, ecc_max],
        ecc_nodes: if omissions::beyond_gradients(experiment, ecc_min) {
            1
        } else {
            Numerics::new(experiment).ecc_nodes
        },
        nodes_nm,
        primaries: lit::spectra(experiment),
        lens_density_scale: experiment.eye.lens_density_scale,
        cornea_density_scale: experiment.eye.cornea_density_scale,
        macular_peak_density: experiment.eye.macular_peak_density,
        reflection_losses: experiment.eye.reflection_losses,
        stiles_crawford_rho10_per_mm2: experiment.eye.stiles_crawford_rho10_per_mm2,
        unbleached: part_unbleached(experiment),
        tolerance: Numerics::new(experiment).basis_tolerance,
        band: scene.band,
        wavefronts: None,
    }
}
