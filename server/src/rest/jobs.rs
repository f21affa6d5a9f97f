//! Jobs and plans over REST.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::State;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use futures::StreamExt as _;
use http::{HeaderMap, StatusCode, header};
use photoneye_proto::{FieldError, experiment_from_json, v1};
use serde::Deserialize;

use super::extract::{Path, Query};
use super::{Shared, spec_text};
use crate::access::Caller;
use crate::admit::Wish;
use crate::error::Error;

/// A comment goes to silent readers so often.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

pub(super) async fn plan(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<v1::PlanReply>, Error> {
    let experiment = experiment_from_json(&spec_text(&headers, body).await?)?;
    Ok(Json(service.plan(&caller, &experiment).await?))
}

#[derive(Deserialize)]
pub(super) struct Priority {
    priority: Option<String>,
}

pub(super) async fn create(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    Query(query): Query<Priority>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Error> {
    let experiment = experiment_from_json(&spec_text(&headers, body).await?)?;
    let key = headers.get("idempotency-key").map(|key| match key.to_str() {
        Ok(key) if !key.is_empty() && key.len() <= 255 => Ok(key.to_owned()),
        _ => Err(FieldError::new("Idempotency-Key", "is 1 to 255 characters of plain text")),
    });
    let priority =
        query.priority.map(|text| text.parse().map_err(|_| FieldError::new("priority", "is not a number")));
    let wish = Wish { request_id: key.transpose()?, priority: priority.transpose()?, local: false };
    let (job, new) = service.create(&caller, &experiment, wish).await?;
    let place = [(header::LOCATION, format!("/v1/jobs/{}", job.id()))];
    let status = if new { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, place, Json(job)).into_response())
}

pub(super) async fn get(State(service): Shared, Path(id): Path<String>) -> Result<Json<v1::Job>, Error> {
    Ok(Json(service.job(&id).await?))
}

pub(super) async fn cancel(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    Path(id): Path<String>,
) -> Result<Json<v1::Job>, Error> {
    Ok(Json(service.cancel(&caller, &id).await?))
}

#[derive(Deserialize)]
pub(super) struct Page {
    page: Option<String>,
    page_size: Option<String>,
}

pub(super) async fn list(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    Query(query): Query<Page>,
) -> Result<Json<v1::ListJobsReply>, Error> {
    let size =
        query.page_size.map(|size| size.parse().map_err(|_| FieldError::new("page_size", "is not a number")));
    Ok(Json(service.list(&caller, query.page.as_deref(), size.transpose()?).await?))
}

pub(super) async fn events(
    State(service): Shared,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Error> {
    let last = headers.get("last-event-id").map(|last| {
        let number = last.to_str().ok().and_then(|text| text.parse().ok());
        number.ok_or_else(|| FieldError::new("Last-Event-ID", "is not a number"))
    });
    let events = Arc::clone(&service).watch(id, last.transpose()?.unwrap_or(0)).await?;
    let events = events.map(|event| {
        let data = serde_json::to_string(&event.job).unwrap_or_default();
        let seq = event.seq().to_string();
        Ok::<_, Infallible>(Event::default().id(seq).retry(Duration::from_secs(1)).data(data))
    });
    // A proxy such as nginx passes events on as they come only when it is told.
    let at_once = [("x-accel-buffering", "no")];
    Ok((at_once, Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE))))
}
