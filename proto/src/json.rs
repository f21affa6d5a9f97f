//! Reads messages from JSON with errors that name the field.

use std::fmt;

use serde::de::DeserializeOwned;

use crate::v1;

/// What is wrong with which field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldError {
    /// The field, as `display.primaries[1].spectrum.line.nm`; empty for the message itself.
    pub path: String,
    /// What is wrong with it.
    pub message: String,
}

impl FieldError {
    /// An error about one field.
    pub fn new(path: impl Into<String>, message: impl Into<String>) -> Self {
        Self { path: path.into(), message: message.into() }
    }
}

impl fmt::Display for FieldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.path.is_empty() {
            f.write_str(&self.message)
        } else {
            write!(f, "{}: {}", self.path, self.message)
        }
    }
}

impl std::error::Error for FieldError {}

/// Reads one message of the schema.
///
/// # Errors
/// The first field that does not fit the schema: unknown, of another type, not one of an enum's values, or given twice.
pub fn from_json<T: DeserializeOwned>(text: &str) -> Result<T, FieldError> {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let path = error.path().to_string();
        let inner = error.into_inner();
        let message = inner.to_string();
        if inner.is_data() {
            FieldError::new(if path == "." { "" } else { &path }, without_position(&message))
        } else {
            FieldError::new("", format!("not JSON: {message}"))
        }
    })?;
    deserializer.end().map_err(|error| FieldError::new("", format!("not JSON: {error}")))?;
    Ok(value)
}

/// Reads an experiment.
///
/// # Errors
/// As [`from_json`].
pub fn experiment_from_json(text: &str) -> Result<v1::Experiment, FieldError> {
    // A byte order mark, as editors of Windows put it first, does no harm.
    from_json(text.strip_prefix('\u{feff}').unwrap_or(text))
}

/// The field path says more than the line does.
fn without_position(message: &str) -> &str {
    message.rfind(" at line ").map_or(message, |end| &message[..end])
}
