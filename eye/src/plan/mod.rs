//! The plan: what a scene needs, what is left out and why, and what it costs, before anything is computed.

use serde::{Deserialize, Serialize};

use crate::artifact::ArtifactSpec;
use crate::digest::Digest;
use crate::experiment::Experiment;
use crate::retina::RegionUm;

/// What will be computed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Digest of the experiment.
    pub experiment: Digest,
    /// `EXPECTED` or `PAPER`.
    pub engine: String,
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
    /// Memory, bytes, about.
    pub predicted_bytes: f64,
    /// What the settings were chosen for: relative error of the mean per cone (L1 over cones), with its parts.
    pub error_estimate: Vec<ErrorPart>,
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

/// Plans an experiment. Runs in milliseconds; builds nothing.
///
/// # Errors
/// A field that is out of range or cannot be served, with its name, value and what is possible.
pub fn plan(experiment: &Experiment) -> Result<Plan, PlanError> {
    experiment.validate()?;
    Err(PlanError::Model("planning is being written".into()))
}
