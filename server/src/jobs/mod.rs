//! The job machine: jobs are artifact builds and shards; workers lease them, keep the lease alive and commit.
//!
//! [`step()`] is the whole logic, without I/O; a store only keeps what it changed.

mod accept;
pub mod clock;
pub mod command;
mod ends;
mod index;
mod invariants;
pub mod lease;
mod lists;
pub mod machine;
pub mod memory;
mod pick;
mod recall;
mod rows;
mod save;
pub mod sqlite;
pub mod state;
pub mod step;
pub mod store;
mod sweep;

pub use command::{Ask, Command, Commit, NewArtifact, NewJob, Record, Reply, Sweep, Text};
pub use lease::{Lease, Phase};
pub use machine::Machine;
pub use recall::Recalled;
pub use state::{Artifact, Chunk, Job, JobState, Shard, State};
pub use step::step;
pub use store::{JobStore, StoreError};
