//! Independent references: published tables and closed forms, computed apart from the model's fast paths; one file a topic.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

#[path = "../support/mod.rs"]
mod support;

mod direction;
mod media;
mod paper;
