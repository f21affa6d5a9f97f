//! In front of both doors: who asks, may they, is the job theirs; and each request is counted.

use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use http::request::Parts;
use http::{HeaderMap, Method, header};
use tonic::Status;

use super::{Caller, Role};
use crate::error::{Error, Kind};
use crate::grpc::Local;
use crate::service::Service;

/// Lets a request in, or answers it.
pub async fn guard(State(service): State<Arc<Service>>, request: Request, next: Next) -> Response {
    let started = Instant::now();
    let (mut parts, body) = request.into_parts();
    let grpc = is_grpc(&parts.headers);
    let response = match admit(&service, &parts).await {
        Ok(caller) => {
            parts.extensions.insert(caller);
            next.run(Request::from_parts(parts, body)).await
        }
        Err(error) if grpc => Status::from(error).into_http::<Body>(),
        Err(error) => error.into_response(),
    };
    // gRPC says how it went in a header when it went wrong at once, and at the end of a stream otherwise.
    let code = response.headers().get("grpc-status").and_then(|code| code.to_str().ok());
    service.metrics.answered(grpc, response.status().as_u16(), code, started.elapsed());
    response
}

async fn admit(service: &Service, request: &Parts) -> Result<Caller, Error> {
    let path = request.uri.path();
    let needed = needed(&request.method, path);
    if needed.is_empty() || request.extensions.get::<Local>().is_some() {
        return Ok(Caller::trusted());
    }
    let caller = service.access.caller(shown(&request.headers)).await?;
    if !needed.iter().any(|role| caller.may(*role)) {
        let words: Vec<&str> = needed.iter().map(|role| role.name()).collect();
        let message = format!("this API key may not do that; the role needed is {}", words.join(" or "));
        return Err(Error::new(Kind::Forbidden, message));
    }
    if let Some(id) = job_of(path) {
        service.owned(&caller, id).await?;
    }
    Ok(caller)
}

/// The key that a request shows: `Authorization: Bearer KEY` or `X-API-Key: KEY`.
fn shown(headers: &HeaderMap) -> Option<&str> {
    let text = |name| headers.get(name).and_then(|value: &http::HeaderValue| value.to_str().ok());
    let bearer = text(header::AUTHORIZATION.as_str()).and_then(|value| {
        let (scheme, key) = value.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(key.trim())
    });
    bearer.or_else(|| text("x-api-key"))
}

/// One of these roles is needed; none for what says nothing about anybody.
fn needed(method: &Method, path: &str) -> &'static [Role] {
    use Role::{Admin, Read, Submit, Worker};
    let writes = *method == Method::POST || *method == Method::PUT;
    match path {
        "/healthz" | "/readyz" | "/openapi.json" | "/docs" => &[],
        "/v1/workers" => &[Admin],
        "/v1/plans" => &[Read, Submit],
        "/photoneye.v1.Blobs/Put" => &[Submit, Worker],
        "/photoneye.v1.Blobs/Get" => &[Read, Submit, Worker],
        "/photoneye.v1.Experiments/CreateJob" | "/photoneye.v1.Experiments/CancelJob" => &[Submit],
        _ if path.starts_with("/photoneye.v1.Workers/") => &[Worker],
        _ if path.starts_with("/grpc.") => &[],
        _ if path.starts_with("/v1/blobs") && !writes => &[Read, Submit, Worker],
        _ if path.starts_with("/v1/") && writes => &[Submit],
        _ => &[Read, Submit],
    }
}

/// The job that a REST path is about.
fn job_of(path: &str) -> Option<&str> {
    path.strip_prefix("/v1/jobs/")?.split('/').next().filter(|id| !id.is_empty())
}

/// Whether a request speaks gRPC.
pub fn is_grpc(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).map(http::HeaderValue::as_bytes);
    kind.is_some_and(|kind| kind.starts_with(b"application/grpc"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_key_opens_only_what_workers_need() {
        let worker = Caller { tenant: "t".into(), who: "k".into(), roles: vec![Role::Worker] };
        let may = |method: Method, path: &str| needed(&method, path).iter().any(|role| worker.may(*role));
        for path in ["/photoneye.v1.Workers/Lease", "/photoneye.v1.Blobs/Put", "/photoneye.v1.Blobs/Get"] {
            assert!(may(Method::POST, path), "{path}");
        }
        for path in ["/photoneye.v1.Experiments/CreateJob", "/photoneye.v1.Experiments/ListJobs", "/v1/jobs"]
        {
            assert!(!may(Method::POST, path) && !may(Method::GET, path), "{path}");
        }
        assert!(!may(Method::GET, "/metrics") && !may(Method::GET, "/v1/jobs/j1/report"));
    }
}
