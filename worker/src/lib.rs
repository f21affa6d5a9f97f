//! Lease, build or fetch artifacts, run shards, commit.
