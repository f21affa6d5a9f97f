//! The model against independent references: slow and readable, sharing no code with the fast path beyond the
//! eye's data tables.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod stray;
#[path = "../support/mod.rs"]
mod support;
