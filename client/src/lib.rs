//! Rust client of the service.
