//! Results over REST.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use http::header::CONTENT_TYPE;
use photoneye_proto::FieldError;
use serde::Deserialize;
use serde_json::Value;

use super::Shared;
use super::extract::{Path, Query};
use crate::cones::SIDE_PX;
use crate::error::{Error, Kind};

#[derive(Deserialize)]
pub(super) struct From {
    from: Option<String>,
}

pub(super) async fn arrow(
    State(service): Shared,
    Path(id): Path<String>,
    Query(query): Query<From>,
) -> Result<Response, Error> {
    let from = query.from.as_deref().unwrap_or("1").parse();
    let from = from.map_err(|_| FieldError::new("from", "is not a sequence number, 1 or more"))?;
    let stream = Arc::clone(&service).arrow(id, from).await?;
    let kind = [(CONTENT_TYPE, "application/vnd.apache.arrow.stream")];
    Ok((kind, Body::from_stream(stream)).into_response())
}

pub(super) async fn npy(State(service): Shared, Path(id): Path<String>) -> Result<Response, Error> {
    let stream = Arc::clone(&service).npy(id).await?;
    Ok(([(CONTENT_TYPE, "application/octet-stream")], Body::from_stream(stream)).into_response())
}

pub(super) async fn photons(State(service): Shared, Path(id): Path<String>) -> Result<Response, Error> {
    let stream = Arc::clone(&service).photons(id).await?;
    let kind = [(CONTENT_TYPE, "application/vnd.apache.arrow.stream")];
    Ok((kind, Body::from_stream(stream)).into_response())
}

pub(super) async fn cones(State(service): Shared, Path(id): Path<String>) -> Result<Response, Error> {
    let file = service.cones_file(&id, false).await?;
    Ok(([(CONTENT_TYPE, "application/vnd.apache.arrow.file")], file).into_response())
}

#[derive(Deserialize)]
pub(super) struct Side {
    side: Option<String>,
}

pub(super) async fn picture(
    State(service): Shared,
    Path((id, frame)): Path<(String, String)>,
    Query(query): Query<Side>,
) -> Result<Response, Error> {
    let number = frame.strip_suffix(".png").and_then(|number| number.parse().ok());
    let number =
        number.ok_or_else(|| Error::new(Kind::NotFound, "pictures are frames/0.png, frames/1.png, …"))?;
    let side = query.side.map_or(Ok(SIDE_PX), |side| side.parse());
    let side = side.map_err(|_| FieldError::new("side", "is not a number of pixels"))?;
    let png = service.picture(&id, number, side).await?;
    Ok(([(CONTENT_TYPE, "image/png")], png).into_response())
}

pub(super) async fn report(State(service): Shared, Path(id): Path<String>) -> Result<Json<Value>, Error> {
    Ok(Json(service.report(&id).await?))
}
