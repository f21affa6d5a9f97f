//! The whole over real sockets, with the real binary: what a user types and what comes out.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod access;
mod bad_input;
mod crash;
mod figures;
mod optics;
mod rest;
mod retina;
mod run;
mod study;
mod support;
mod torture;
mod video;
mod warnings;
