//! What there is to choose from, and how the service is.

use std::fmt::Write as _;

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use http::{StatusCode, header};
use photoneye_eye::catalog;
use serde_json::{Value, json};

use super::Shared;
use crate::jobs::{JobState, Phase, State as Jobs};

/// Presets with their files' content.
fn presets(folder: &str) -> Json<Value> {
    let list = catalog::names(folder).into_iter().map(|name| {
        let file = catalog::text(folder, name).and_then(|text| serde_json::from_str::<Value>(text).ok());
        json!({"name": name, folder.trim_end_matches('s'): file})
    });
    Json(json!({folder: list.collect::<Vec<_>>()}))
}

pub(super) async fn displays() -> Json<Value> {
    presets("displays")
}

pub(super) async fn eyes() -> Json<Value> {
    presets("eyes")
}

/// Columns of the tables, as `table/column`.
pub(super) async fn spectra() -> Json<Value> {
    let columns = catalog::names("spectra").into_iter().flat_map(|table| {
        let text = catalog::text("spectra", table).unwrap_or_default();
        let mut lines = text.lines();
        let header = lines.find(|line| !line.starts_with('#') && !line.trim().is_empty()).unwrap_or_default();
        let comments = text.lines().take_while(|line| line.starts_with('#'));
        let about: Vec<&str> = comments.map(|line| line.trim_start_matches(['#', ' '])).collect();
        let about = about.join(" ");
        // Only what is given against wavelength is a spectrum.
        let columns: Vec<&str> =
            if header.starts_with("nm,") { header.split(',').skip(1).collect() } else { Vec::new() };
        columns
            .into_iter()
            .map(move |column| json!({"name": format!("{table}/{column}"), "description": about.clone()}))
    });
    Json(json!({"spectra": columns.collect::<Vec<_>>()}))
}

pub(super) async fn retinas() -> Json<Value> {
    let generators = json!([
        {"name": "DOMAIN", "description": "patches of hexagonal lattice, relaxed; tiles are pure functions", "built": true},
        {"name": "RING", "description": "the paper's growth from a seed of seven cones, ring after ring", "built": true},
    ]);
    let peak = json!({"min": 98_200, "max": 324_100, "default": 199_000});
    Json(json!({"retinas": generators, "peak_density_per_mm2": peak}))
}

/// Ready: the blob store can write and the job machine answers.
pub(super) async fn ready(State(service): Shared) -> Response {
    let written = service.with_blobs(|blobs| blobs.begin().map(drop)).await;
    let active = service.machine.read(|state| state.active.len()).await;
    match written {
        Ok(()) => Json(json!({"status": "ready", "active_jobs": active})).into_response(),
        Err(error) => {
            let body = json!({"status": "not ready", "reason": error.to_string()});
            (StatusCode::SERVICE_UNAVAILABLE, Json(body)).into_response()
        }
    }
}

pub(super) async fn metrics(State(service): Shared) -> Response {
    let text = service.machine.read(metrics_text).await;
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response()
}

fn metrics_text(state: &Jobs) -> String {
    let mut text = String::new();
    let mut gauge = |name: &str, help: &str, values: &[(String, usize)]| {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "# HELP photoneye_{name} {help}\n# TYPE photoneye_{name} gauge");
        for (labels, value) in values {
            let _ = writeln!(text, "photoneye_{name}{labels} {value}");
        }
    };
    let of_state = |one: JobState| state.jobs.values().filter(|job| job.state == one).count();
    let label = |key: &str, value: String| format!("{{{key}=\"{}\"}}", value.to_lowercase());
    let jobs: Vec<_> =
        JobState::ALL.iter().map(|one| (label("state", format!("{one:?}")), of_state(*one))).collect();
    gauge("jobs", "Jobs by state.", &jobs);
    let of_phase =
        |one: Phase| state.artifacts.values().filter(|artifact| artifact.lease.phase == one).count();
    let artifacts: Vec<_> =
        Phase::ALL.iter().map(|one| (label("phase", format!("{one:?}")), of_phase(*one))).collect();
    gauge("artifacts", "Artifacts by phase.", &artifacts);
    let total = |value: usize| [(String::new(), value)];
    gauge("leases", "Work that workers hold.", &total(state.leased.len()));
    let left = state.active.iter().filter_map(|id| state.jobs.get(id)).map(|job| job.left).sum();
    gauge("shards_left", "Shards of active jobs that are not done.", &total(left));
    let chunks = state.jobs.values().map(|job| job.chunks.len()).sum();
    gauge("chunks", "Result chunks.", &total(chunks));
    gauge(
        "nondeterministic_results",
        "Results that came out differently the second time; must be 0.",
        &total(state.nondeterministic as usize),
    );
    text
}
