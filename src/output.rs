//! Standard output: facts for people or, with --json, for programs. A reader that has gone is not an error.

use std::fmt::Arguments;
use std::io::{IsTerminal as _, Write as _};

use crate::failure::Failure;

/// Writes one line.
///
/// # Errors
/// When standard output cannot be written.
pub fn line(text: Arguments) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    Ok(writeln!(out, "{text}")?)
}

/// Writes a value as indented JSON.
///
/// # Errors
/// When standard output cannot be written.
pub fn json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::failed)?;
    line(format_args!("{text}"))
}

/// Writes a value as one line of JSON, for streams of them.
///
/// # Errors
/// When standard output cannot be written.
pub fn json_line(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string(value).map_err(Failure::failed)?;
    line(format_args!("{text}"))
}

/// Writes a line for people on standard error: progress that is not the result.
pub fn note(text: Arguments) {
    // Progress that nobody can see is no reason to stop.
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Whether progress goes to a terminal, where bars may be drawn.
pub fn is_terminal() -> bool {
    std::io::stderr().is_terminal()
}
