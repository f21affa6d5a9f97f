//! The machine's state and the model's plan in the schema's words.

use photoneye_eye::plan::Plan;
use photoneye_proto::v1;

use crate::jobs::{Job, JobState, Phase, State};

/// The plan of an experiment; `cached` says which artifacts are there already.
pub fn plan(
    plan: &Plan,
    (experiment, spec): (&str, v1::Experiment),
    cached: impl Fn(&str) -> bool,
) -> v1::Plan {
    let artifacts = plan.artifacts.iter().map(|artifact| {
        let key = artifact.key.to_string();
        v1::PlannedArtifact {
            kind: Some(artifact.spec.kind().to_owned()),
            cached: Some(cached(&key)),
            key: Some(key),
            predicted_seconds: Some(artifact.predicted_seconds),
        }
    });
    let there = plan.artifacts.iter().filter(|artifact| cached(&artifact.key.to_string())).count();
    let made = (there > 0).then(|| v1::Omission {
        what: Some("artifacts that are there already".to_owned()),
        why: Some(format!(
            "{there} of {} were built before, under the hash of the same inputs",
            plan.artifacts.len()
        )),
        bound: Some(0.0),
    });
    let omissions = plan.omissions.iter().map(|omission| v1::Omission {
        what: Some(omission.what.clone()),
        why: Some(omission.why.clone()),
        bound: Some(omission.bound),
    });
    let parts = plan
        .error_estimate
        .iter()
        .map(|part| v1::ErrorPart { part: Some(part.part.clone()), relative: Some(part.relative) });
    let frames = plan.shards.iter().map(|shard| shard.first_frame + shard.frame_count).max();
    let region = &plan.region;
    v1::Plan {
        spec: Some(spec),
        experiment_digest: Some(experiment.to_owned()),
        engine: Some(plan.engine.clone()),
        engine_reason: Some(plan.engine_reason.clone()),
        region_um: vec![region.min.x, region.max.x, region.min.y, region.max.y],
        wavelengths_nm: plan.wavelengths_nm.clone(),
        field_nodes: Some(plan.field_nodes),
        grid_width: Some(plan.grid[0]),
        grid_height: Some(plan.grid[1]),
        frames,
        tiles: Some(plan.tile_artifacts.len() as u32),
        predicted_cones: Some(plan.predicted_cones),
        artifacts: artifacts.collect(),
        omissions: omissions.chain(made).collect(),
        predicted_seconds: Some(plan.predicted_seconds),
        predicted_bytes: Some(plan.predicted_bytes),
        error_estimate: parts.collect(),
        warnings: plan.warnings.clone(),
        focus: Some(v1::EyeFocus {
            wanted_d: Some(plan.focus.wanted_d),
            far_point_d: Some(plan.focus.far_point_d),
            accommodation_d: Some(plan.focus.accommodation_d),
            residual_d: Some(plan.focus.residual_d),
        }),
        display: Some(v1::DisplaySeen {
            fixated_cm: Some(plan.display.fixated_cm),
            turned_deg: Some(plan.display.turned_deg),
            corners_deg: plan.display.corners_deg.concat(),
            px_per_deg: plan.display.px_per_deg.to_vec(),
            px_per_deg_at_edges: plan.display.px_per_deg_at_edges.to_vec(),
        }),
    }
}

/// A job without its plan.
pub fn job(state: &State, job: &Job) -> v1::Job {
    let seconds = |ms: u64| ms as f64 / 1e3;
    v1::Job {
        id: Some(job.id.clone()),
        state: JobState::ALL.iter().position(|one| *one == job.state).map(|number| number as i32),
        experiment_digest: Some(job.experiment_digest.clone()),
        created_unix_s: Some(seconds(job.created_ms)),
        finished_unix_s: job.finished_ms.map(seconds),
        progress: Some(progress(state, job)),
        error: job.error.clone(),
        warnings: job.warnings.clone(),
        result_digest: job.result_digest.clone(),
        plan: None,
        tenant: Some(job.tenant.clone()),
        priority: Some(job.priority.into()),
        cones: job.cones.or_else(|| state.first_cones(job).1),
    }
}

fn progress(state: &State, job: &Job) -> v1::Progress {
    let ready = job.artifacts.iter().filter(|key| state.ready(key)).count();
    // What was built for a job that ended may be gone by now.
    let done = job.state == JobState::Succeeded;
    let (ready, builds_total) =
        if done { (job.artifacts.len(), job.artifacts.len()) } else { (ready, job.artifacts.len()) };
    let leased = job.shards.iter().any(|shard| shard.lease.phase == Phase::Leased);
    let stage = match job.state {
        JobState::Queued => "waiting for a worker".to_owned(),
        JobState::Running if !job.stage.is_empty() => job.stage.clone(),
        JobState::Running if leased => "computing counts".to_owned(),
        JobState::Running => "building artifacts".to_owned(),
        JobState::Succeeded => "done".to_owned(),
        JobState::Failed => "failed".to_owned(),
        JobState::Cancelled => "cancelled".to_owned(),
    };
    v1::Progress {
        builds_done: Some(ready as u32),
        builds_total: Some(builds_total as u32),
        shards_done: Some(job.shard_count - job.left as u32),
        shards_total: Some(job.shard_count),
        stage: Some(stage),
    }
}
