//! One kind of error, mapped once to HTTP and once to gRPC.

use axum::response::{IntoResponse, Response};
use http::{StatusCode, header};
use photoneye_proto::FieldError;
use serde_json::json;

use crate::jobs;

/// Kinds of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The request does not fit the schema or the model.
    Invalid,
    /// There is no such thing.
    NotFound,
    /// The path does not take the method.
    WrongMethod,
    /// A body is compressed.
    WrongEncoding,
    /// The request id came with another body before.
    OtherBody,
    /// Not now: what is asked for is not there yet, or not any more.
    NotReady,
    /// Over a limit of size.
    TooLarge,
    /// Over a limit of load; later it may pass.
    Busy,
    /// Something that the server needs does not answer.
    Unavailable,
    /// The server is wrong.
    Internal,
    /// Nobody says who asks.
    Unauthenticated,
    /// Who asks may not.
    Forbidden,
}

/// What went wrong with a request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", FieldError::new(field.clone().unwrap_or_default(), message.clone()))]
pub struct Error {
    /// The kind.
    pub kind: Kind,
    /// What is wrong, for people.
    pub message: String,
    /// The field that is wrong.
    pub field: Option<String>,
    /// When it may pass, seconds from now.
    pub retry_after_s: u32,
}

impl Error {
    /// An error without a field.
    pub fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), field: None, retry_after_s: 5 }
    }

    /// The HTTP status.
    pub fn status(&self) -> StatusCode {
        match self.kind {
            Kind::Invalid => StatusCode::BAD_REQUEST,
            Kind::NotFound => StatusCode::NOT_FOUND,
            Kind::WrongMethod => StatusCode::METHOD_NOT_ALLOWED,
            Kind::WrongEncoding => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Kind::OtherBody => StatusCode::UNPROCESSABLE_ENTITY,
            Kind::NotReady => StatusCode::CONFLICT,
            Kind::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Kind::Busy => StatusCode::TOO_MANY_REQUESTS,
            Kind::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
            Kind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
            Kind::Unauthenticated => StatusCode::UNAUTHORIZED,
            Kind::Forbidden => StatusCode::FORBIDDEN,
        }
    }

    /// The gRPC code.
    pub fn code(&self) -> tonic::Code {
        match self.kind {
            Kind::Invalid => tonic::Code::InvalidArgument,
            Kind::NotFound => tonic::Code::NotFound,
            Kind::WrongMethod | Kind::WrongEncoding => tonic::Code::Unimplemented,
            Kind::OtherBody => tonic::Code::AlreadyExists,
            Kind::NotReady => tonic::Code::FailedPrecondition,
            Kind::TooLarge => tonic::Code::OutOfRange,
            Kind::Busy => tonic::Code::ResourceExhausted,
            Kind::Unavailable => tonic::Code::Unavailable,
            Kind::Internal => tonic::Code::Internal,
            Kind::Unauthenticated => tonic::Code::Unauthenticated,
            Kind::Forbidden => tonic::Code::PermissionDenied,
        }
    }
}

impl From<FieldError> for Error {
    fn from(error: FieldError) -> Self {
        Self {
            kind: Kind::Invalid,
            message: error.message,
            field: (!error.path.is_empty()).then_some(error.path),
            retry_after_s: 5,
        }
    }
}

impl From<jobs::StoreError> for Error {
    fn from(error: jobs::StoreError) -> Self {
        tracing::error!(%error, "job store");
        Self::new(Kind::Unavailable, error.to_string())
    }
}

impl From<photoneye_store::StoreError> for Error {
    fn from(error: photoneye_store::StoreError) -> Self {
        if error.is_absent() {
            return Self::new(Kind::NotFound, error.to_string());
        }
        tracing::error!(%error, "blob store");
        Self::new(Kind::Unavailable, error.to_string())
    }
}

impl From<photoneye_store::table::TableError> for Error {
    fn from(error: photoneye_store::table::TableError) -> Self {
        Self::new(Kind::Internal, error.to_string())
    }
}

impl From<tokio::task::JoinError> for Error {
    fn from(error: tokio::task::JoinError) -> Self {
        tracing::error!(%error, "a task died");
        Self::new(Kind::Internal, "a task of the server died")
    }
}

impl From<Error> for tonic::Status {
    fn from(error: Error) -> Self {
        let mut status = Self::new(error.code(), error.to_string());
        if matches!(error.kind, Kind::Busy | Kind::Unavailable) {
            status.metadata_mut().insert("retry-after", error.retry_after_s.into());
        }
        status
    }
}

impl IntoResponse for Error {
    fn into_response(self) -> Response {
        let (status, retry_after_s) = (self.status(), self.retry_after_s);
        let title = status.canonical_reason().unwrap_or_default();
        let mut problem =
            json!({"type": "about:blank", "title": title, "status": status.as_u16(), "detail": self.message});
        if let Some(field) = self.field {
            problem["field"] = field.into();
        }
        let kind = [(header::CONTENT_TYPE, "application/problem+json")];
        let mut response = (status, kind, problem.to_string()).into_response();
        if status == StatusCode::TOO_MANY_REQUESTS || status == StatusCode::SERVICE_UNAVAILABLE {
            response.headers_mut().insert(header::RETRY_AFTER, retry_after_s.into());
        }
        if status == StatusCode::UNAUTHORIZED {
            let scheme = http::HeaderValue::from_static("Bearer");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, scheme);
        }
        response
    }
}
