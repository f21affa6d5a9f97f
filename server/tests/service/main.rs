//! The server over real sockets.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test says by panicking what is wrong")]

mod access;
mod common;
mod doors;
mod streams;
mod upkeep;
mod warnings;
