//! What there is to choose from, and how the service is.

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use http::{StatusCode, header};
use photoneye_eye::catalog;
use serde_json::{Value, json};

use super::Shared;
use crate::error::Error;

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

/// Retinas that are built, and what can be asked for.
pub(super) async fn retinas(State(service): Shared) -> Result<Json<Value>, Error> {
    let cached = service.machine.documents().retinas().await?;
    let generators = json!([
        {"name": "DOMAIN", "description": "patches of hexagonal lattice, relaxed; tiles are pure functions"},
        {"name": "RING", "description": "the paper's growth from a seed of seven cones, ring after ring"},
    ]);
    let peak = json!({"min": 98_200, "max": 324_100, "default": 199_000});
    Ok(Json(json!({"retinas": cached, "generators": generators, "peak_density_per_mm2": peak})))
}

/// Ready: the blob store can write and the job machine answers.
pub(super) async fn ready(State(service): Shared) -> Response {
    let written = service.with_blobs(|blobs| blobs.begin().map(drop)).await;
    let active = service.machine.read(|state| state.active.len());
    match written {
        Ok(()) => Json(json!({"status": "ready", "active_jobs": active})).into_response(),
        Err(error) => {
            let body = json!({"status": "not ready", "reason": error.to_string()});
            (StatusCode::SERVICE_UNAVAILABLE, Json(body)).into_response()
        }
    }
}

pub(super) async fn metrics(State(service): Shared) -> Result<Response, Error> {
    let jobs = service.machine.documents().count_jobs().await?;
    let workers = service.fleet.alive();
    let text = service.machine.read(|state| service.metrics.text(state, &jobs, workers));
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response())
}

/// Workers that were heard lately, with what they do and use.
pub(super) async fn workers(State(service): Shared) -> Json<Value> {
    Json(service.fleet.list())
}
