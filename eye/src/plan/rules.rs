//! The omissions that can be switched off one by one, to see what they are worth and that they change nothing beyond their bounds.

use serde::{Deserialize, Serialize};

/// An omission. Names are those of the schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Rule {
    /// Cones beyond the picture, its blur and its movement.
    ConesOutside,
    /// Wavelengths that nobody emits or catches.
    Wavelengths,
    /// Points of the field that a small patch does not need.
    FieldNodes,
    /// The course of time before an eye that does not move.
    StillEye,
    /// Points along eccentricity where nothing changes with it (beyond the macula and the taper of the pigments).
    Eccentricities,
    /// Primaries that no picture lights.
    UnlitPrimaries,
    /// Frames that show the same as the first.
    RepeatedFrames,
    /// Frames and tiles without light.
    DarkTiles,
    /// Types of cone that there are none of, or that catch nothing of the light.
    BlindTypes,
    /// Frequencies that blur and apertures average away.
    CoarseGrids,
    /// Pointing errors of cones that change less than the target.
    Pointing,
    /// Single primaries where gray pictures have several shine together.
    JoinedPrimaries,
}

impl Rule {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::ConesOutside,
        Self::Wavelengths,
        Self::FieldNodes,
        Self::StillEye,
        Self::Eccentricities,
        Self::UnlitPrimaries,
        Self::RepeatedFrames,
        Self::DarkTiles,
        Self::BlindTypes,
        Self::CoarseGrids,
        Self::Pointing,
        Self::JoinedPrimaries,
    ];

    /// Whether an experiment lets it be made.
    pub fn applies(self, experiment: &crate::experiment::Experiment) -> bool {
        !experiment.computed_anyway.contains(&self)
    }
}
