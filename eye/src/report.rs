//! What a piece of work tells beside its result: seconds per stage, memory, photon fates, rare events. Pieces are merged by
//! adding, in any order (sums of f64 are made in frame order by whoever merges, so that reports are reproducible too).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::exposure::AuditSample;

/// Where the photons of the shown frames went, in photons (means, not draws). Every photon has one fate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhotonBudget {
    /// Left the lit pixels, into the half space.
    pub emitted: f64,
    /// Did not meet the entrance pupil.
    pub missed_pupil: f64,
    /// Reflected at the surfaces of cornea and lens, where reflections are computed; else they are among those of the cornea.
    #[serde(default)]
    pub reflected: f64,
    /// Absorbed or scattered in the cornea.
    pub cornea: f64,
    /// Absorbed or scattered in the lens.
    pub lens: f64,
    /// Absorbed in the macular pigment.
    pub macula: f64,
    /// Fell between the apertures or outside the simulated patch.
    pub between_cones: f64,
    /// Entered an aperture from a direction that the cone does not guide.
    pub stiles_crawford: f64,
    /// Passed the pigment.
    pub not_absorbed: f64,
    /// Absorbed without isomerizing.
    pub not_isomerized: f64,
    /// Isomerized, by cone type L, M, S.
    pub isomerized: [f64; 3],
    /// No photons and so not among the fates: isomerizations without light, which are in the counts too.
    #[serde(default)]
    pub dark: f64,
}

impl PhotonBudget {
    /// The sum of all fates; equals `emitted`.
    pub fn fates(&self) -> f64 {
        self.missed_pupil + self.into_pupil()
    }

    /// Photons that entered the pupil: the sum of their fates, because the emission less those that missed it loses seven digits.
    pub fn into_pupil(&self) -> f64 {
        self.reflected
            + self.cornea
            + self.lens
            + self.macula
            + self.between_cones
            + self.stiles_crawford
            + self.not_absorbed
            + self.not_isomerized
            + self.isomerized.iter().sum::<f64>()
    }

    /// Adds another part.
    pub fn add(&mut self, other: &Self) {
        self.emitted += other.emitted;
        self.missed_pupil += other.missed_pupil;
        self.reflected += other.reflected;
        self.dark += other.dark;
        self.cornea += other.cornea;
        self.lens += other.lens;
        self.macula += other.macula;
        self.between_cones += other.between_cones;
        self.stiles_crawford += other.stiles_crawford;
        self.not_absorbed += other.not_absorbed;
        self.not_isomerized += other.not_isomerized;
        for (mine, theirs) in self.isomerized.iter_mut().zip(other.isomerized) {
            *mine += theirs;
        }
    }
}

/// The report of one build or shard.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorkReport {
    /// Wall seconds by stage.
    pub seconds: BTreeMap<String, f64>,
    /// CPU seconds by stage.
    #[serde(default)]
    pub cpu_seconds: BTreeMap<String, f64>,
    /// Cones that were computed again.
    #[serde(default)]
    pub audit: Vec<AuditSample>,
    /// Largest memory of the process so far, bytes.
    pub peak_memory_bytes: u64,
    /// Photon fates of the frames of a shard.
    pub budget: PhotonBudget,
    /// Counts of rare events (rays lost, degenerate pairs, voids, clamps).
    pub diagnostics: BTreeMap<String, u64>,
    /// Cones by type L, M, S in an artifact that has them.
    #[serde(default)]
    pub cones: [u64; 3],
    /// Sum of counts by type.
    pub counted: [f64; 3],
}

impl WorkReport {
    /// Adds another report: seconds, fates and events add up, memory is the maximum.
    pub fn merge(&mut self, other: &Self) {
        for (stage, seconds) in &other.seconds {
            *self.seconds.entry(stage.clone()).or_default() += seconds;
        }
        for (stage, seconds) in &other.cpu_seconds {
            *self.cpu_seconds.entry(stage.clone()).or_default() += seconds;
        }
        self.audit.extend(&other.audit);
        self.peak_memory_bytes = self.peak_memory_bytes.max(other.peak_memory_bytes);
        self.budget.add(&other.budget);
        for (event, count) in &other.diagnostics {
            *self.diagnostics.entry(event.clone()).or_default() += count;
        }
        for i in 0..3 {
            self.counted[i] += other.counted[i];
        }
    }
}
