//! REST and gRPC front end, job machine, SQLite.

pub mod jobs;
pub mod spec;
