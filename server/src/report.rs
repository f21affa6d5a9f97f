//! report.json of a finished job: what was asked, what was planned, what it cost and where the photons went.

use std::collections::BTreeMap;

use photoneye_eye::experiment::COUNTS_VERSION;
use photoneye_eye::exposure::audit::{AuditSample, verdict};
use photoneye_eye::report::WorkReport;
use photoneye_proto::v1;
use serde_json::{Value, json};

use crate::error::{Error, Kind};
use crate::jobs::state::{Summary, WorkId};
use crate::jobs::{Job, JobState, State};
use crate::service::Service;

/// Frames whose statistics are listed.
const MAX_FRAMES: usize = 10_000;

/// What the report takes from the machine.
struct Facts {
    work: Vec<WorkId>,
    digests: Value,
    artifacts: Value,
    frames: Value,
    /// Cones of the result.
    cones: u64,
    wall_seconds: f64,
    warnings: Vec<String>,
    /// Names of the documents that hold experiment and plan.
    texts: [String; 2],
}

impl Service {
    /// The report of a job that succeeded.
    ///
    /// # Errors
    /// When there is no such job or it has not succeeded.
    pub async fn report(&self, id: &str) -> Result<Value, Error> {
        let facts = self
            .look(id, |state, job| match job.state {
                JobState::Succeeded => Ok(facts(state, job)),
                other => Err(Error::new(Kind::NotReady, format!("the job is not done: {other:?}"))),
            })
            .await??;
        let mut merged = WorkReport::default();
        for work in &facts.work {
            let text = self.machine.document(&format!("report/{work}")).await?;
            let report = text.and_then(|text| serde_json::from_str::<WorkReport>(&text).ok());
            if let Some(report) = report {
                merged.merge(&report);
            }
        }
        merged.audit.sort_by_key(|s| (s.frame, s.tile, s.cone));
        let mut plan: Value = self.stored(&facts.texts[1]).await?;
        let spec = plan["spec"].take();
        // The same cones in every frame.
        let first = facts.frames.get(0).map_or(&Value::Null, |frame| &frame["types"]);
        let cones = json!({"l": first["l"]["cones"], "m": first["m"]["cones"], "s": first["s"]["cones"]});
        let counted = |name: &str| cones[name].as_u64().unwrap_or(0);
        let in_statistics = counted("l") + counted("m") + counted("s");
        let edge_cones = facts.cones.saturating_sub(in_statistics);
        let resolved: Value = self.stored(&facts.texts[0]).await?;
        Ok(json!({
            "id": id,
            "warnings": facts.warnings,
            "spec": spec,
            "resolved": resolved,
            "digests": facts.digests,
            "engine": plan["engine"],
            "versions": {"photoneye": env!("CARGO_PKG_VERSION"), "counts": COUNTS_VERSION},
            "error_estimate": {
                "parts": plan["error_estimate"],
                "how": "predicted before the run for the chosen settings, from errors measured on scenes from flat to a single lit pixel; relative error of the mean per cone, L1 over cones",
            },
            "audit": audit(&merged.audit, &resolved, plan["engine"].as_str() != Some("EXPECTED")),
            "prediction": prediction(&plan, &merged),
            "plan": plan,
            "artifacts": facts.artifacts,
            "wall_seconds": facts.wall_seconds,
            "seconds": merged.seconds,
            "cpu_seconds": merged.cpu_seconds,
            "peak_memory_bytes": merged.peak_memory_bytes,
            "photon_budget": merged.budget,
            "diagnostics": merged.diagnostics,
            "cones": cones,
            "edge_cones": edge_cones,
            "frames": facts.frames,
        }))
    }

    async fn stored(&self, name: &str) -> Result<Value, Error> {
        let text = self.machine.document(name).await?.unwrap_or_default();
        serde_json::from_str(&text).map_err(|error| Error::new(Kind::Internal, format!("{name}: {error}")))
    }
}

/// What the cones that were computed again say.
fn audit(samples: &[AuditSample], resolved: &Value, drawn: bool) -> Value {
    let Some(found) = verdict(samples, drawn) else { return Value::Null };
    let target = resolved["accuracy_target"].as_f64().unwrap_or(0.0);
    json!({
        "cones": found.cones,
        "relative_error": found.relative_error,
        "bound_95": found.bound_95,
        "lower_bound_95": found.lower_bound_95,
        "by_chance": found.by_chance,
        "target": target,
        "within_target": found.relative_error - found.by_chance.max(0.0) <= target,
        "how": "cones chosen at random, half of them by their light, computed again by a direct sum over pixels, wavelengths and time of point spreads traced for each cone; good to about 1e-4",
        "samples": samples,
    })
}

/// What was foreseen and what it took.
fn prediction(plan: &Value, merged: &WorkReport) -> Value {
    let cpu: f64 = merged.cpu_seconds.values().sum();
    json!({
        "predicted_seconds": plan["predicted_seconds"],
        "cpu_seconds": cpu,
        "predicted_bytes": plan["predicted_bytes"],
        "peak_bytes": merged.peak_memory_bytes,
    })
}

impl Service {
    /// The report in the schema's words.
    ///
    /// # Errors
    /// As [`Service::report`].
    pub async fn report_message(&self, id: &str) -> Result<v1::Report, Error> {
        let report = self.report(id).await?;
        let number = |part: &str, name: &str| report[part][name].as_f64();
        let audit = report["audit"].is_object().then(|| v1::Audit {
            cones: report["audit"]["cones"].as_u64().map(|n| n as u32),
            relative_error: number("audit", "relative_error"),
            bound_95: number("audit", "bound_95"),
            by_chance: number("audit", "by_chance"),
            target: number("audit", "target"),
            within_target: report["audit"]["within_target"].as_bool(),
            lower_bound_95: number("audit", "lower_bound_95"),
        });
        let prediction = v1::Prediction {
            predicted_seconds: number("prediction", "predicted_seconds"),
            cpu_seconds: number("prediction", "cpu_seconds"),
            predicted_bytes: number("prediction", "predicted_bytes"),
            peak_bytes: number("prediction", "peak_bytes"),
        };
        Ok(v1::Report { json: Some(report.to_string()), audit, prediction: Some(prediction) })
    }
}

fn facts(state: &State, job: &Job) -> Facts {
    let builds = job.artifacts.iter().map(|key| WorkId::Build(key.clone()));
    let shards = (0..job.shards.len() as u32).map(|number| WorkId::Shard(job.id.clone(), number));
    let artifacts: Vec<Value> = job
        .artifacts
        .iter()
        .filter_map(|key| state.artifacts.get(key))
        .map(|one| json!({"kind": one.kind, "key": one.key, "digest": one.digest.map(|d| d.to_string()), "cones": one.cones}))
        .collect();
    let all_cones = keys_of(job, 0).filter_map(|key| state.artifacts.get(key)?.cones).sum();
    // The keys of a job's retina and optics, in tile order; one tile has one of each.
    let keys = |place: usize| -> Vec<&String> { keys_of(job, place).collect() };
    let digests = json!({"spec": job.experiment_digest, "retina": keys(0), "optics": keys(1), "result": job.result_digest});
    let ended = job.finished_ms.unwrap_or(job.created_ms);
    Facts {
        work: builds.chain(shards).collect(),
        digests,
        artifacts: artifacts.into(),
        frames: frames(job),
        cones: all_cones,
        warnings: job.warnings.clone(),
        wall_seconds: ended.saturating_sub(job.created_ms) as f64 / 1e3,
        texts: [job.experiment_text.clone(), job.plan_text.clone()],
    }
}

/// Keys of one kind of artifact, in tile order.
fn keys_of(job: &Job, place: usize) -> impl Iterator<Item = &String> {
    job.tiles.iter().filter_map(move |tile| tile.get(place))
}

/// Mean, variance and Fano factor per frame and cone type.
fn frames(job: &Job) -> Value {
    let mut frames: BTreeMap<u32, Vec<&Summary>> = BTreeMap::new();
    for ((frame, _), chunk) in &job.chunks {
        frames.entry(*frame).or_default().push(&chunk.summary);
    }
    let list = frames.into_iter().take(MAX_FRAMES).map(|(frame, tiles)| {
        let types =
            ["l", "m", "s"].iter().enumerate().map(|(i, name)| ((*name).to_owned(), of_type(&tiles, i)));
        json!({"frame": frame, "types": types.collect::<serde_json::Map<String, Value>>()})
    });
    list.collect::<Vec<_>>().into()
}

fn of_type(tiles: &[&Summary], i: usize) -> Value {
    let total = |values: fn(&Summary) -> &Vec<f64>| -> f64 {
        tiles.iter().filter_map(|tile| values(tile).get(i)).sum()
    };
    let cones: u64 = tiles.iter().filter_map(|tile| tile.cones.get(i)).sum();
    if cones == 0 {
        return json!({"cones": 0});
    }
    let n = cones as f64;
    let mean = total(|tile| &tile.sum) / n;
    let variance = (total(|tile| &tile.sum_squares) / n - mean * mean).max(0.0);
    let fano = if mean > 0.0 { Value::from(variance / mean) } else { Value::Null };
    json!({"cones": cones, "mean": mean, "variance": variance, "fano": fano})
}
