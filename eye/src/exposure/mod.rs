//! Counting (§22): from a scene's cones and kernels to counts per cone and frame.

pub mod lowrank;
pub mod polar;
pub mod spread;

use serde::{Deserialize, Serialize};

use crate::experiment::Experiment;
use crate::report::PhotonBudget;
use crate::video::Picture;

/// Inputs of the optical kernels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KernelSpec {}

/// Counts of one frame, in the order of the cones.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameCounts {
    /// Poisson draws.
    Counts(Vec<u32>),
    /// Means.
    Means(Vec<f32>),
}

/// One computed frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Counts by cone.
    pub counts: FrameCounts,
    /// Photon fates.
    pub budget: PhotonBudget,
    /// Rare events.
    pub diagnostics: Vec<(String, u64)>,
}

/// Why a frame cannot be computed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ExposureError {
    /// An artifact is damaged.
    #[error("artifact {0} is damaged: {1}")]
    Artifact(&'static str, String),
    /// The model refuses.
    #[error("{0}")]
    Model(String),
}

/// A scene that is ready to be counted, frame by frame.
pub struct Exposure {}

impl Exposure {
    /// Prepares a scene: `cones` and `kernels` are the bytes of the two artifacts of a result tile, in the order of
    /// `Plan::tile_artifacts`.
    ///
    /// # Errors
    /// When an artifact's bytes are damaged or do not belong to the experiment.
    pub fn new(_experiment: &Experiment, _artifacts: &[impl AsRef<[u8]>]) -> Result<Self, ExposureError> {
        Err(ExposureError::Model("counting is being written".into()))
    }

    /// Computes frame `index`. `picture` is the frame's picture; `None` for a drawn pattern.
    ///
    /// # Errors
    /// When the picture does not have the display's size.
    pub fn frame(&self, _index: u32, _picture: Option<&Picture>) -> Result<Frame, ExposureError> {
        Err(ExposureError::Model("counting is being written".into()))
    }
}
