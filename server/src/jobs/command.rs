//! What can happen to the machine, what it answers, and what it leaves to be stored.

use std::collections::BTreeSet;
use std::sync::Arc;

use photoneye_eye::exposure::audit::AuditSample;
use photoneye_store::BlobDigest;

use super::state::{Goal, Summary, WorkId};

/// What can happen.
#[derive(Clone, Debug)]
pub enum Command {
    /// A job is accepted.
    Create(Box<NewJob>),
    /// A worker asks for work.
    Lease(Ask),
    /// A worker is alive.
    Beat {
        /// Its work.
        id: WorkId,
        /// Its fence.
        fence: u64,
        /// What it does, for people.
        stage: String,
    },
    /// A worker has finished.
    Commit {
        /// Its work.
        id: WorkId,
        /// Its fence.
        fence: u64,
        /// What it made.
        commit: Commit,
        /// What it says about that, the model's own JSON.
        report_json: Option<String>,
    },
    /// A computation failed.
    Fail {
        /// The work.
        id: WorkId,
        /// The worker's fence.
        fence: u64,
        /// Why.
        message: String,
        /// The same inputs would fail again.
        deterministic: bool,
    },
    /// A lease is given back; counts as nothing.
    Release {
        /// The work.
        id: WorkId,
        /// The worker's fence.
        fence: u64,
    },
    /// A user does not want a job any more.
    Cancel(String),
    /// The server starts: who made local jobs before is gone.
    Disown,
    /// Time has passed.
    Reap,
    /// An artifact's bytes are missing or damaged, and somebody wants them.
    LostArtifact(String),
    /// A result's bytes are missing or damaged: job, frame, tile.
    LostChunk(String, u32, u32),
    /// Something to be kept on record.
    Note(Record),
    /// What is over for long may go.
    Sweep(Sweep),
}

/// What a worker asks for.
#[derive(Clone, Debug, Default)]
pub struct Ask {
    /// Its name.
    pub worker: String,
    /// Whether it lives in this process.
    pub local: bool,
    /// Keys of the artifacts that it holds.
    pub holds: BTreeSet<String>,
    /// Shards that one tenant may have at work at the same time.
    pub most: usize,
    /// Whether only local jobs are worked on; the others wait for another process.
    pub local_only: bool,
}

/// How much of what is over is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    /// Jobs that ended, and records, from before this time go, ms since 1970.
    pub before_ms: u64,
    /// Of all jobs the latest so many stay, and those that are at work.
    pub kept_jobs: u64,
    /// Records of the audit that stay, the latest.
    pub kept_audit: u64,
}

/// A job to be accepted.
#[derive(Clone, Debug, Default)]
pub struct NewJob {
    /// Its name.
    pub id: String,
    /// Digest of the validated experiment.
    pub experiment_digest: String,
    /// The validated experiment, the model's own JSON.
    pub experiment: Text,
    /// The plan, the schema's JSON.
    pub plan: Text,
    /// Number of frames.
    pub frames: u32,
    /// Artifacts, each after the ones it is made from.
    pub artifacts: Vec<NewArtifact>,
    /// Per result tile the keys of the artifacts that its shards need, the cones first.
    pub tiles: Vec<Vec<String>>,
    /// First frame, number of frames, tile.
    pub shards: Vec<(u32, u32, u32)>,
    /// Predicted work of one shard, microseconds.
    pub shard_us: u64,
    /// By what its audit is judged; `None`: not at all.
    pub goal: Option<Goal>,
    /// Request id and digest of the request's body.
    pub request: Option<(String, String)>,
    /// Whose it is.
    pub tenant: String,
    /// 0 to 9; the higher is served first, among the jobs of one tenant.
    pub priority: u8,
    /// Who sent it, for the audit.
    pub by: String,
    /// Whether they live in this process and die with it.
    pub local: bool,
}

/// A text under the hash of its content: jobs that share it, store it once.
#[derive(Clone, Debug)]
pub struct Text {
    /// Its name among the documents.
    pub id: String,
    /// The text.
    pub text: Arc<str>,
}

impl Text {
    /// Names a text.
    pub fn of(text: impl Into<Arc<str>>) -> Self {
        let text = text.into();
        Self { id: format!("text/{}", blake3::hash(text.as_bytes()).to_hex()), text }
    }
}

impl Default for Text {
    fn default() -> Self {
        Self::of("")
    }
}

/// An artifact that a job needs.
#[derive(Clone, Debug, Default)]
pub struct NewArtifact {
    /// Its key.
    pub key: String,
    /// What it is.
    pub kind: String,
    /// Its inputs, the model's own JSON.
    pub spec_json: Arc<str>,
    /// Keys of the artifacts that it is made from.
    pub inputs: Vec<String>,
    /// Predicted work, microseconds.
    pub predicted_us: u64,
}

/// What a worker made; its bytes are in the store already.
#[derive(Clone, Debug)]
pub enum Commit {
    /// An artifact.
    Artifact {
        /// Its bytes.
        digest: BlobDigest,
        /// Cones in it.
        cones: Option<u64>,
    },
    /// A shard.
    Shard {
        /// Frame, digest and summary of each chunk, in frame order.
        chunks: Vec<(u32, BlobDigest, Summary)>,
        /// Cones of its frames that were computed again.
        audit: Vec<AuditSample>,
    },
}

/// What the machine answers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Nothing to say.
    Done,
    /// The job, and whether it is new.
    Created(String, bool),
    /// That request id came with another body before.
    OtherBody,
    /// Work and its fence.
    Leased(Option<(WorkId, u64)>),
    /// Whether the worker held the lease; if not, nothing was changed.
    Held(bool),
    /// No such job.
    NoSuchJob,
    /// The commit does not fit the work.
    Unfit(String),
}

/// A row that changed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Row {
    /// A job that was not stored before.
    NewJob(String),
    /// A job.
    Job(String),
    /// A shard of a job.
    Shard(String, u32),
    /// An artifact.
    Artifact(String),
    /// A result: job, frame, tile.
    Chunk(String, u32, u32),
    /// A request id.
    Request(String),
}

/// Something kept on record that the machine itself never reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Record {
    /// Who did what to which job, key or blob.
    Audit {
        /// Whose it is.
        tenant: String,
        /// Id of the key, or the name of the worker.
        who: String,
        /// What was done.
        action: &'static str,
        /// To what.
        object: String,
    },
    /// A tenant has uploaded bytes.
    Upload {
        /// Whose they are.
        tenant: String,
        /// The bytes.
        digest: BlobDigest,
    },
    /// The same work gave other bytes. Both are kept.
    Alarm {
        /// The work.
        work: String,
        /// What it gave first.
        first: BlobDigest,
        /// What it gave now.
        second: BlobDigest,
    },
}

/// What steps did.
#[derive(Clone, Debug, Default)]
pub struct Effects {
    /// Rows to be kept, as the state has them now.
    pub rows: BTreeSet<Row>,
    /// Texts to be kept, by name.
    pub documents: Vec<(String, Arc<str>)>,
    /// Things to be kept on record.
    pub records: Vec<Record>,
    /// What is to be deleted.
    pub sweep: Option<Sweep>,
}

impl Effects {
    /// Adds what another step did.
    pub fn add(&mut self, other: Self) {
        self.rows.extend(other.rows);
        self.documents.extend(other.documents);
        self.records.extend(other.records);
        self.sweep = other.sweep.or(self.sweep.take());
    }

    /// Whether there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() && self.documents.is_empty() && self.records.is_empty()
    }
}
