//! The REST door.

mod blobs;
mod catalog;
mod docs;
mod extract;
mod jobs;
mod results;

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{FromRequest as _, Request};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, post, put};
use axum::{Json, Router};
use http::{HeaderMap, header};
use http_body_util::{BodyExt as _, LengthLimitError, Limited};

use crate::error::{Error, Kind};
use crate::service::Service;

/// Largest spec, bytes.
const MAX_SPEC: usize = 1 << 20;

type Shared = axum::extract::State<Arc<Service>>;

/// All REST routes; what no route takes is refused as a problem, or as gRPC when it is gRPC.
pub fn routes(service: Arc<Service>) -> Router {
    Router::new()
        .route("/v1/jobs", post(jobs::create).get(jobs::list))
        .route("/v1/jobs/{id}", get(jobs::get))
        .route("/v1/jobs/{id}/cancel", post(jobs::cancel))
        .route("/v1/jobs/{id}/events", get(jobs::events))
        .route("/v1/jobs/{id}/results", get(results::arrow))
        .route("/v1/jobs/{id}/counts.npy", get(results::npy))
        .route("/v1/jobs/{id}/photons.arrow", get(results::photons))
        .route("/v1/jobs/{id}/cones.arrow", get(results::cones))
        .route("/v1/jobs/{id}/frames/{frame}", get(results::picture))
        .route("/v1/jobs/{id}/report", get(results::report))
        .route("/v1/plans", post(jobs::plan))
        .route("/v1/blobs", put(blobs::put))
        .route("/v1/blobs/{*digest}", get(blobs::get))
        .route("/v1/displays", get(catalog::displays))
        .route("/v1/eyes", get(catalog::eyes))
        .route("/v1/spectra", get(catalog::spectra))
        .route("/v1/retinas", get(catalog::retinas))
        .route("/v1/workers", get(catalog::workers))
        .route("/healthz", get(|| async { Json(serde_json::json!({"status": "ok"})) }))
        .route("/readyz", get(catalog::ready))
        .route("/metrics", get(catalog::metrics))
        .route("/openapi.json", get(docs::openapi))
        .route("/docs", get(docs::page))
        .method_not_allowed_fallback(wrong_method)
        .layer(axum::middleware::from_fn(uncompressed))
        .with_state(service)
}

/// Refuses bodies that are compressed: none is unpacked.
async fn uncompressed(request: Request, next: axum::middleware::Next) -> Response {
    let encoding = request.headers().get(header::CONTENT_ENCODING);
    let encoding = encoding.map(|value| String::from_utf8_lossy(value.as_bytes()).trim().to_owned());
    match encoding {
        Some(name) if !name.is_empty() && !name.eq_ignore_ascii_case("identity") => {
            let message =
                format!("Content-Encoding `{name}` is not read; send the body as it is, without compression");
            Error::new(Kind::WrongEncoding, message).into_response()
        }
        _ => next.run(request).await,
    }
}

async fn wrong_method(request: Request) -> Response {
    let message = format!("{} does not take {}", request.uri().path(), request.method());
    Error::new(Kind::WrongMethod, message).into_response()
}

/// For paths that neither door knows.
pub async fn unknown(request: Request) -> Response {
    if crate::access::is_grpc(request.headers()) {
        return tonic::Status::unimplemented(format!("no method {}", request.uri().path()))
            .into_http::<Body>();
    }
    Error::new(Kind::NotFound, format!("no such path: {}", request.uri().path())).into_response()
}

/// The text of a spec: the body itself, or its form field `spec`.
async fn spec_text(headers: &HeaderMap, body: Body) -> Result<String, Error> {
    let body = Limited::new(body, MAX_SPEC).collect().await.map_err(|error| {
        if error.is::<LengthLimitError>() {
            Error::new(Kind::TooLarge, format!("the body is larger than {MAX_SPEC} bytes"))
        } else {
            Error::new(Kind::Invalid, format!("the body broke off: {error}"))
        }
    })?;
    let bytes = body.to_bytes();
    let kind = headers.get(header::CONTENT_TYPE).map(http::HeaderValue::as_bytes).unwrap_or_default();
    if kind.starts_with(b"application/x-www-form-urlencoded") {
        // Some clients call everything a form; JSON begins with a brace, a form with a name.
        if !bytes.trim_ascii_start().starts_with(b"{") {
            return form_field(bytes).await;
        }
    }
    String::from_utf8(bytes.into()).map_err(|_| Error::new(Kind::Invalid, "the body is not UTF-8 text"))
}

async fn form_field(bytes: bytes::Bytes) -> Result<String, Error> {
    #[derive(serde::Deserialize)]
    struct Fields {
        spec: String,
    }
    let kind = (header::CONTENT_TYPE, "application/x-www-form-urlencoded");
    let request = Request::builder().method(http::Method::POST).header(kind.0, kind.1);
    let request =
        request.body(Body::from(bytes)).map_err(|_| Error::new(Kind::Invalid, "the body is not a form"))?;
    let form = axum::Form::<Fields>::from_request(request, &()).await;
    Ok(form.map_err(|_| Error::new(Kind::Invalid, "the form has no field `spec`"))?.0.spec)
}
