//! Independent references: slow and readable, they share no code with what they check beyond the data tables.
//! One file a topic.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod cones;
