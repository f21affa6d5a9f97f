//! The job machine: its steps, its stores, and every state of a small world.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::too_many_lines,
    reason = "a test says by panicking what is wrong"
)]

mod common;
mod machine;
mod model;
mod random;
mod speed;
mod stored;
mod warnings;
