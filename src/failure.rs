//! How a command ends when it does not succeed: one clear line and an exit code (1 failed, 2 wrong use).

use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Why a command ended.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// What the user asked for cannot be meant: wrong option, file, field or value.
    #[error("{0}")]
    Usage(String),
    /// It was meant, but it did not work.
    #[error("{0}")]
    Failed(String),
    /// Whoever reads our output has gone; nothing to say and nobody to hear it.
    #[error("the reader has gone")]
    BrokenPipe,
}

impl Failure {
    /// Wrong use.
    pub fn usage(message: impl ToString) -> Self {
        Self::Usage(message.to_string())
    }

    /// Did not work.
    pub fn failed(message: impl ToString) -> Self {
        Self::Failed(message.to_string())
    }

    /// A file or folder that cannot be read, written or made.
    pub fn file(action: &str, path: &Path, error: &std::io::Error) -> Self {
        Self::Failed(format!("cannot {action} {}: {}", path.display(), plain(error)))
    }

    /// Writes the line and gives the exit code.
    pub fn report(&self) -> ExitCode {
        let code = match self {
            Self::BrokenPipe => return ExitCode::SUCCESS,
            Self::Usage(_) => 2,
            Self::Failed(_) => 1,
        };
        // If even standard error is closed, the exit code has to do.
        let _ = writeln!(std::io::stderr(), "photoneye: {}", one_line(&self.to_string()));
        ExitCode::from(code)
    }
}

impl From<photoneye_client::ClientError> for Failure {
    fn from(error: photoneye_client::ClientError) -> Self {
        use photoneye_client::ClientError::{Key, Protocol, Refused, Tls, Unreachable, Url};
        match &error {
            Refused(status) if status.code() == tonic::Code::InvalidArgument => Self::usage(error),
            Url(_) | Key | Tls(_) => Self::usage(error),
            Refused(_) | Unreachable(_) | Protocol(_) => Self::failed(error),
        }
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        if error.kind() == std::io::ErrorKind::BrokenPipe {
            Self::BrokenPipe
        } else {
            Self::failed(plain(&error))
        }
    }
}

/// What clap says: help and version are a success, everything else is wrong use.
pub fn of_arguments(error: &clap::Error) -> ExitCode {
    let _ = error.print();
    if error.use_stderr() { ExitCode::from(2) } else { ExitCode::SUCCESS }
}

/// The system's words without its error number.
pub fn plain(error: &std::io::Error) -> String {
    let text = error.to_string();
    let end = text.find(" (os error").unwrap_or(text.len());
    text[..end].to_lowercase()
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
