//! Inputs from real use that once gave a wrong answer silently. Each has the right value, or a refusal that names
//! field, value and remedy.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod counts;
mod dark;
mod films;
mod focus;
mod gaze;
mod geometry;
mod luminance;
mod mosaic;
mod noise;
mod pictures;
mod rerun;
mod schema;
#[path = "../e2e/support.rs"]
#[allow(dead_code, reason = "shared with the end-to-end tests")]
mod support;

use std::path::Path;
use std::process::Output;

use serde_json::Value;

use support::{photoneye, texts};

/// Runs an experiment in a folder, with results in its folder `out`.
fn run(folder: &Path, experiment: &Value) -> Output {
    std::fs::write(folder.join("spec.json"), experiment.to_string()).unwrap();
    photoneye(folder).args(["run", "spec.json", "--out", "out"]).output().unwrap()
}

/// Runs an experiment in a folder and gives its report.
fn report(folder: &Path, experiment: &Value) -> Value {
    let output = run(folder, experiment);
    assert!(output.status.success(), "{}", texts(&output).1);
    let report = std::fs::read(folder.join("out/report.json")).unwrap();
    std::fs::remove_dir_all(folder.join("out")).unwrap();
    serde_json::from_slice(&report).unwrap()
}

/// Asserts a refusal, exit code 2, whose last line has all words; nothing is left behind.
fn assert_refused(folder: &Path, output: &Output, words: &[&str]) {
    let (_, err) = texts(output);
    let line = err.lines().last().unwrap_or_default();
    assert_eq!(output.status.code(), Some(2), "{err}");
    for word in words {
        assert!(line.contains(word), "`{word}` is not in `{line}`");
    }
    assert!(!folder.join("out").exists());
}
