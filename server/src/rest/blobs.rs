//! Uploads and downloads over REST.

use axum::body::Body;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use axum::{Extension, Json};
use futures::StreamExt as _;
use http::{HeaderMap, Method, StatusCode, header};
use photoneye_proto::{FieldError, v1};
use photoneye_store::BlobDigest;

use super::Shared;
use super::extract::Path;
use crate::access::Caller;
use crate::error::{Error, Kind};
use crate::transfer::{Upload, pieces};

pub(super) async fn put(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    body: Body,
) -> Result<(StatusCode, Json<v1::PutBlobReply>), Error> {
    let length = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok());
    let mut upload = Upload::begin(&service, length).await?;
    let mut stream = body.into_data_stream();
    while let Some(piece) = stream.next().await {
        let piece =
            piece.map_err(|error| Error::new(Kind::Invalid, format!("the body broke off: {error}")))?;
        upload.push(piece)?;
    }
    let digest = upload.finish().await?;
    service.uploaded(&caller, digest).await?;
    let digest = Some(digest.to_string());
    Ok((StatusCode::CREATED, Json(v1::PutBlobReply { digest })))
}

/// GET and HEAD: the digest is the rest of the path, with its slash.
pub(super) async fn get(
    State(service): Shared,
    Extension(caller): Extension<Caller>,
    method: Method,
    Path(digest): Path<String>,
) -> Result<Response, Error> {
    let digest: BlobDigest = digest
        .parse()
        .map_err(|error: photoneye_store::digest::NotADigest| FieldError::new("digest", error.to_string()))?;
    service.readable(&caller, &digest).await?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::CONTENT_LENGTH, digest.size.to_string()),
        (header::ETAG, format!("\"{}\"", digest.hex())),
    ];
    if method == Method::HEAD {
        return if service.with_blobs(move |blobs| blobs.has(&digest)).await? {
            Ok((headers, Body::empty()).into_response())
        } else {
            Err(Error::new(Kind::NotFound, format!("no blob {digest}")))
        };
    }
    let reader = service.with_blobs(move |blobs| blobs.open(&digest)).await?;
    Ok((headers, Body::from_stream(pieces(reader))).into_response())
}
