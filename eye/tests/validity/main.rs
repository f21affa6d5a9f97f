//! The model against independent references: each file computes a quantity a second time, slowly and readably, from the eye's
//! data and traced rays or from a published law, and holds the model to it. `docs/validation.md` lists the results.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they find"
)]

mod cones;
mod direction;
mod events;
mod media;
mod paper;
mod pupil;

mod screens;
mod source;
mod stray;
#[path = "../support/mod.rs"]
mod support;
