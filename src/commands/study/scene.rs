//! Experiments run in this process, stage by stage with their CPU seconds, without a server: plan, artifacts, preparation, frames.

use std::collections::BTreeMap;

use photoneye_eye::artifact::{ArtifactSpec, Input};
use photoneye_eye::digest::Digest;
use photoneye_eye::experiment::Experiment;
use photoneye_eye::exposure::{AuditSample, Exposure, FrameCounts};
use photoneye_eye::plan::{Stages, plan};
use photoneye_eye::report::PhotonBudget;
use photoneye_eye::video::Picture;
use serde_json::{Value, json};

use super::clock::Stopwatch;

/// The model's experiment of a JSON text's value.
///
/// # Errors
/// The field that is wrong.
pub fn experiment(spec: &Value) -> Result<Experiment, String> {
    let message = photoneye_proto::experiment_from_json(&spec.to_string()).map_err(|e| e.to_string())?;
    photoneye_server::spec::experiment(&message).map_err(|e| e.to_string())
}

/// A checkerboard on a projector, still, means asked for: the scene of which others are changes.
pub fn standard(side_px: u32, square_px: u32) -> Value {
    let middle = f64::from(side_px) / 2.0;
    json!({
        "display": {"preset": "lcos-3chip", "width_px": side_px, "height_px": side_px},
        "video": {"pattern": {"checkerboard": {"square_px": square_px}}},
        "gaze": {"center_px": [middle, middle], "movement": {"still": {}}},
        "counts": {"engine": "EXPECTED", "noise": "NONE", "seed": 5},
        "frames": {"count": 1},
    })
}

/// Sets a field of a specification by its path of names.
pub fn with(mut spec: Value, changes: &[(&str, Value)]) -> Value {
    for (path, value) in changes {
        let mut place = &mut spec;
        for name in path.split('.') {
            if !place.is_object() {
                *place = json!({});
            }
            place = &mut place[name];
        }
        *place = value.clone();
    }
    spec
}

/// What a run gave.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Counts or means by cone, summed over the frames.
    pub counts: Vec<f64>,
    /// Fates of the photons of all frames.
    pub budget: PhotonBudget,
    /// CPU seconds; none for a mosaic that was there already.
    pub stages: Stages,
    /// Cones that were computed again.
    pub audit: Vec<AuditSample>,
}

/// Runs experiments; mosaics are kept from one to the next.
#[derive(Default)]
pub struct Runner {
    kept: BTreeMap<Digest, Vec<u8>>,
}

impl Runner {
    /// Runs an experiment; `pictures` are its frames' pictures, the last one stays; none for a drawn pattern.
    ///
    /// # Errors
    /// What the planner or the model refuses.
    pub fn run(&mut self, experiment: &Experiment, pictures: &[Picture]) -> Result<Outcome, String> {
        let plan = plan(experiment).map_err(|e| e.to_string())?;
        let mut stages = Stages::default();
        let mut optics: BTreeMap<Digest, Vec<u8>> = BTreeMap::new();
        for artifact in &plan.artifacts {
            if self.kept.contains_key(&artifact.key) {
                continue;
            }
            let is_mosaic =
                matches!(artifact.spec, ArtifactSpec::RetinaTile { .. } | ArtifactSpec::Cones { .. });
            let watch = Stopwatch::start();
            let built = {
                let bytes = |key: &Digest| self.kept.get(key).or_else(|| optics.get(key));
                let inputs: Option<Vec<Input>> =
                    artifact.inputs.iter().map(|k| Some((*k, bytes(k)?.as_slice()))).collect();
                let inputs = inputs.ok_or("the plan names an artifact before its inputs")?;
                artifact.spec.build(&inputs).map_err(|e| e.to_string())?.bytes
            };
            *(if is_mosaic { &mut stages.mosaic } else { &mut stages.optics }) += watch.seconds();
            (if is_mosaic { &mut self.kept } else { &mut optics }).insert(artifact.key, built);
        }
        let mut outcome =
            Outcome { counts: Vec::new(), budget: PhotonBudget::default(), stages, audit: Vec::new() };
        for keys in &plan.tile_artifacts {
            let bytes: Vec<&[u8]> = keys
                .iter()
                .filter_map(|k| self.kept.get(k).or_else(|| optics.get(k)))
                .map(Vec::as_slice)
                .collect();
            outcome.tile(experiment, &bytes, pictures)?;
        }
        Ok(outcome)
    }
}

impl Outcome {
    fn tile(
        &mut self,
        experiment: &Experiment,
        artifacts: &[&[u8]],
        pictures: &[Picture],
    ) -> Result<(), String> {
        let watch = Stopwatch::start();
        let exposure = Exposure::new(experiment, artifacts).map_err(|e| e.to_string())?;
        self.stages.prepare += watch.seconds();
        let first = self.counts.len();
        self.counts.resize(first + exposure.len(), 0.0);
        for index in 0..experiment.frames {
            let watch = Stopwatch::start();
            let picture = pictures.get(index as usize).or(pictures.last());
            exposure.make_ready(index, picture, &[]).map_err(|e| e.to_string())?;
            self.stages.prepare += watch.seconds();
            let watch = Stopwatch::start();
            let frame = exposure.frame(index, picture).map_err(|e| e.to_string())?;
            self.stages.frames += watch.seconds();
            let watch = Stopwatch::start();
            self.audit.extend(exposure.audit(index, picture, &[], &frame).map_err(|e| e.to_string())?);
            self.stages.audit += watch.seconds();
            let sums = self.counts[first..].iter_mut();
            match frame.counts {
                FrameCounts::Counts(counts) => sums.zip(counts).for_each(|(s, c)| *s += f64::from(c)),
                FrameCounts::Means(means) => sums.zip(means).for_each(|(s, m)| *s += f64::from(m)),
            }
            self.budget.add(&frame.budget);
        }
        Ok(())
    }
}

/// Σ|a − b|/Σb; `None` when they are not of the same cones or b is dark.
pub fn l1(a: &[f64], b: &[f64]) -> Option<f64> {
    let total: f64 = b.iter().sum();
    let off: f64 = a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum();
    (a.len() == b.len() && total > 0.0).then_some(off / total)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_scene_runs_and_its_photons_are_all_there() {
        let region = json!({"x_min": -0.05, "x_max": 0.05, "y_min": -0.05, "y_max": 0.05});
        let spec = with(standard(8, 2), &[("retina.region_deg", region), ("accuracy.target", json!(0.02))]);
        let experiment = experiment(&spec).unwrap();
        let mut runner = Runner::default();
        let first = runner.run(&experiment, &[]).unwrap();
        let again = runner.run(&experiment, &[]).unwrap();
        assert!(first.counts == again.counts && first.stages.mosaic > 0.0);
        assert!((first.budget.fates() / first.budget.emitted - 1.0).abs() < 1e-9);
        assert_eq!(l1(&first.counts, &again.counts), Some(0.0));
    }
}
