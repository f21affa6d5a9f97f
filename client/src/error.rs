//! Why a call failed, in words for people.

use std::error::Error as _;

use tonic::{Code, Status};

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The URL cannot be used.
    #[error("`{0}` is not a server address of the form http://host:port or https://host:port")]
    Url(String),
    /// The key cannot be sent.
    #[error("the API key is not plain text")]
    Key,
    /// Certificates cannot be used.
    #[error("TLS: {0}")]
    Tls(String),
    /// Nobody answers.
    #[error("the server cannot be reached: {0}")]
    Unreachable(String),
    /// The server's answer: which field is wrong, or what it cannot do.
    #[error("{}", .0.message())]
    Refused(Box<Status>),
    /// The server does not keep to the schema.
    #[error("the server answered with {0}")]
    Protocol(&'static str),
}

impl ClientError {
    /// The gRPC code of an answer; `None` when there was none.
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Refused(status) => Some(status.code()),
            Self::Url(_) | Self::Key | Self::Tls(_) | Self::Unreachable(_) | Self::Protocol(_) => None,
        }
    }
}

impl From<Status> for ClientError {
    fn from(status: Status) -> Self {
        if is_transient(&status) && status.code() != Code::ResourceExhausted {
            Self::Unreachable(innermost(&status))
        } else {
            Self::Refused(Box::new(status))
        }
    }
}

/// Whether the same call may succeed later: the connection broke, or the server is starting, stopping or busy.
pub(crate) fn is_transient(status: &Status) -> bool {
    matches!(status.code(), Code::Unavailable | Code::ResourceExhausted)
        || status.source().is_some()
        || status.message().starts_with("Service was not ready")
}

/// The cause at the end of the chain, such as "Connection refused".
fn innermost(status: &Status) -> String {
    let mut cause = status.source();
    while let Some(next) = cause.and_then(std::error::Error::source) {
        cause = Some(next);
    }
    let text = cause.map_or_else(|| status.message().to_owned(), ToString::to_string);
    text.split(" (os error").next().unwrap_or_default().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_not_repeated_but_broken_connections_are() {
        assert!(is_transient(&Status::unavailable("starting")));
        assert!(!is_transient(&Status::invalid_argument("eye.pupil_mm: 99")));
        assert!(!is_transient(&Status::not_found("no such job")));
        let error = ClientError::from(Status::invalid_argument("eye.pupil_mm: 99 is out of range"));
        assert_eq!(error.to_string(), "eye.pupil_mm: 99 is out of range");
        assert_eq!(error.code(), Some(Code::InvalidArgument));
    }
}
