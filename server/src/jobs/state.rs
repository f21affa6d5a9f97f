//! What the machine knows: jobs with their shards and chunks, artifacts shared by all jobs, and indexes over both.
//!
//! Texts (experiments, plans, artifact inputs, reports) are documents of the store and not held here.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;

use photoneye_eye::exposure::audit::{AuditSample, verdict};
use photoneye_store::BlobDigest;
use serde::{Deserialize, Serialize};

use super::lease::{Lease, Phase};

/// Why a local job of an earlier process was cancelled.
pub const ORPHAN: &str =
    "the process that ran it ended before it did; run the same experiment again to go on with it";

/// Where a job stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobState {
    /// Accepted.
    #[default]
    Queued,
    /// A worker has begun.
    Running,
    /// All results are there.
    Succeeded,
    /// It cannot be done; the job says why.
    Failed,
    /// Not wanted any more.
    Cancelled,
}

impl JobState {
    /// All, in the order of their numbers in the schema.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// Whether work may still be done.
    pub fn active(self) -> bool {
        matches!(self, Self::Queued | Self::Running)
    }
}

/// By what a job's audit is judged.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// `accuracy.target`: relative error of the mean per cone, L1 over cones.
    pub target: f64,
    /// Whether values of the engine are counts and not means.
    pub drawn: bool,
    /// What the plan warned of.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// A job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Job {
    /// Its name for users.
    pub id: String,
    /// Order of creation.
    pub number: u64,
    /// Whose it is.
    pub tenant: String,
    /// 0 to 9; the higher is served first, among the jobs of one tenant.
    pub priority: u8,
    /// Where it stands.
    pub state: JobState,
    /// Digest of the validated experiment.
    pub experiment_digest: String,
    /// Name of the document that holds the experiment.
    pub experiment_text: String,
    /// Name of the document that holds the plan.
    pub plan_text: String,
    /// Accepted, ms since 1970.
    pub created_ms: u64,
    /// Ended, ms since 1970.
    pub finished_ms: Option<u64>,
    /// Number of frames.
    pub frames: u32,
    /// Keys of its artifacts, each after the ones it is made from.
    pub artifacts: Vec<String>,
    /// Per result tile the keys of the artifacts that its shards need, the cones first.
    pub tiles: Vec<Vec<String>>,
    /// Its shards.
    pub shards: Vec<Shard>,
    /// How many they are; known also where the shards themselves are not loaded.
    pub shard_count: u32,
    /// Cones in its result, once it succeeded.
    pub cones: Option<u64>,
    /// Results by frame and tile.
    pub chunks: BTreeMap<(u32, u32), Chunk>,
    /// Frame and tile of each chunk in the order of commits. Not stored: follows from the chunks.
    pub order: Vec<(u32, u32)>,
    /// Why it failed.
    pub error: Option<String>,
    /// What its users have to know of its result, a sentence each; only when it succeeded.
    pub warnings: Vec<String>,
    /// By what its audit is judged; `None`: not at all.
    pub goal: Option<Goal>,
    /// Digest over all chunks, when it succeeded.
    pub result_digest: Option<String>,
    /// Rises with every change that a user can see.
    pub version: u64,
    /// Work handed out so far, microseconds as predicted; the job that had least is served next.
    pub pass_us: u64,
    /// Predicted work of one shard, microseconds.
    pub shard_us: u64,
    /// Whether whoever made it lives in this process and dies with it.
    pub local: bool,
    /// What a worker said last. Not stored.
    pub stage: String,
    /// Open shards by tile. Not stored: follows from the shards.
    pub open: BTreeMap<u32, BTreeSet<u32>>,
    /// Shards that are not done. Not stored: follows from the shards.
    pub left: usize,
}

/// Some frames of one tile.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shard {
    /// First frame.
    pub first_frame: u32,
    /// Number of frames.
    pub frame_count: u32,
    /// Result tile.
    pub tile: u32,
    /// Who is at it.
    pub lease: Lease,
    /// Cones of its frames that were computed again, when it is done.
    pub audit: Vec<AuditSample>,
}

/// Something built once, under the hash of its inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Artifact {
    /// Its key.
    pub key: String,
    /// What it is.
    pub kind: String,
    /// Keys of the artifacts that it is made from.
    pub inputs: Vec<String>,
    /// Its bytes, when it is built.
    pub digest: Option<BlobDigest>,
    /// Its bytes before they were lost: made again, they must be the same.
    pub previous: Option<BlobDigest>,
    /// Cones in it; stays known when the bytes are lost.
    pub cones: Option<u64>,
    /// Predicted work, microseconds.
    pub predicted_us: u64,
    /// Who is at it.
    pub lease: Lease,
}

/// Sums over the counts of one chunk, by cone type L, M, S.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Sum of counts.
    pub sum: Vec<f64>,
    /// Sum of their squares.
    pub sum_squares: Vec<f64>,
    /// Number of cones.
    pub cones: Vec<u64>,
}

/// Counts of one tile of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// Place in the order of commits, from 1, without gaps.
    pub seq: u64,
    /// Where the bytes are.
    pub digest: BlobDigest,
    /// Row of the cone table at which it begins.
    pub first_cone: u64,
    /// Number of cones.
    pub cones: u64,
    /// For people.
    pub summary: Summary,
}

/// A piece of work, written `b/<key>` or `s/<job>/<number>`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WorkId {
    /// The build of an artifact.
    Build(String),
    /// A shard of a job.
    Shard(String, u32),
}

impl fmt::Display for WorkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Build(key) => write!(f, "b/{key}"),
            Self::Shard(job, number) => write!(f, "s/{job}/{number}"),
        }
    }
}

impl FromStr for WorkId {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not the id of a lease");
        match text.split_once('/').ok_or_else(wrong)? {
            ("b", key) => Ok(Self::Build(key.to_owned())),
            ("s", rest) => {
                let (job, number) = rest.split_once('/').ok_or_else(wrong)?;
                Ok(Self::Shard(job.to_owned(), number.parse().map_err(|_| wrong())?))
            }
            _ => Err(wrong()),
        }
    }
}

/// Place of a job among those of its tenant: the higher priority first, then the job that had least, then the older.
pub type Place = (Reverse<u8>, u64, u64, String);

/// What is at work, and what ended lately. A store may forget jobs that ended and read them again when somebody asks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Jobs by id.
    pub jobs: BTreeMap<String, Job>,
    /// Artifacts by key.
    pub artifacts: BTreeMap<String, Artifact>,
    /// Job and digest of the body by request id.
    pub requests: BTreeMap<String, (String, String)>,
    /// Number of the next job.
    pub next_number: u64,
    /// Ids of active jobs. Not stored: follows from the jobs.
    pub active: BTreeSet<String>,
    /// Active jobs of each tenant in the order in which they are served. Not stored: follows from the jobs.
    pub queues: BTreeMap<String, BTreeSet<Place>>,
    /// Work handed out to each tenant with active jobs, microseconds as predicted; the one that had least is served next.
    /// Not stored: a restart begins the shares anew.
    pub passes: BTreeMap<String, u64>,
    /// Active jobs that need an artifact. Not stored: follows from the jobs.
    pub users: BTreeMap<String, BTreeSet<String>>,
    /// Leased work. Not stored: follows from the leases.
    pub leased: BTreeSet<WorkId>,
    /// Leased shards of each tenant. Not stored: follows from the leases.
    pub holding: BTreeMap<String, usize>,
    /// Artifacts that somebody reads although no active job needs them. Not stored: whoever reads asks again.
    pub asked: BTreeSet<String>,
    /// Results and artifacts that came out differently the second time.
    pub nondeterministic: u64,
}

impl State {
    /// The lease of a piece of work.
    pub fn lease(&self, id: &WorkId) -> Option<&Lease> {
        match id {
            WorkId::Build(key) => Some(&self.artifacts.get(key)?.lease),
            WorkId::Shard(job, number) => Some(&self.jobs.get(job)?.shards.get(*number as usize)?.lease),
        }
    }

    /// Changes a lease and keeps the indexes right. `None` when there is no such work.
    pub fn change<T>(&mut self, id: &WorkId, change: impl FnOnce(&mut Lease) -> T) -> Option<T> {
        let (result, phase) = match id {
            WorkId::Build(key) => {
                let lease = &mut self.artifacts.get_mut(key)?.lease;
                (change(lease), lease.phase)
            }
            WorkId::Shard(job, number) => {
                let job = self.jobs.get_mut(job)?;
                let shard = job.shards.get_mut(*number as usize)?;
                let was_done = shard.lease.phase == Phase::Done;
                let result = change(&mut shard.lease);
                let phase = shard.lease.phase;
                job.left = job.left + usize::from(was_done) - usize::from(phase == Phase::Done);
                let (was, is) = (self.leased.contains(id), phase == Phase::Leased);
                if was != is {
                    let held = self.holding.entry(job.tenant.clone()).or_default();
                    *held = *held + usize::from(is) - usize::from(was);
                    if *held == 0 {
                        self.holding.remove(&job.tenant);
                    }
                }
                let open = job.open.entry(shard.tile).or_default();
                if phase == Phase::Open {
                    open.insert(*number);
                } else {
                    open.remove(number);
                }
                (result, phase)
            }
        };
        if phase == Phase::Leased {
            self.leased.insert(id.clone());
        } else {
            self.leased.remove(id);
        }
        Some(result)
    }

    /// Rebuilds what is not stored. After a restart the workers of the earlier process are gone; the others get a whole term.
    pub fn index(&mut self, now_ms: u64, restarted: bool) {
        self.leased.clear();
        self.holding.clear();
        self.active.clear();
        self.queues.clear();
        self.users.clear();
        self.passes.clear();
        let active = self.jobs.values().filter(|job| job.state.active()).map(|job| job.id.clone());
        for id in active.collect::<Vec<_>>() {
            self.activate(&id);
        }
        self.jobs.values_mut().for_each(Job::index);
        let builds = self.artifacts.keys().map(|key| WorkId::Build(key.clone()));
        let shards = self
            .jobs
            .values()
            .flat_map(|job| (0..job.shards.len()).map(|number| WorkId::Shard(job.id.clone(), number as u32)));
        for id in builds.chain(shards).collect::<Vec<_>>() {
            self.change(&id, |lease| {
                let gone = lease.local && restarted;
                lease.expires_ms = if gone { 0 } else { now_ms + super::lease::TTL_MS };
            });
        }
    }

    /// Row of the cone table at which each tile begins, as far as that is known, and the total when all of it is.
    pub fn first_cones(&self, job: &Job) -> (Vec<u64>, Option<u64>) {
        let mut firsts = Vec::new();
        let mut next = 0;
        for tile in &job.tiles {
            firsts.push(next);
            let cones =
                tile.first().and_then(|key| self.artifacts.get(key)).and_then(|artifact| artifact.cones);
            let Some(cones) = cones else {
                return (firsts, None);
            };
            next += cones;
        }
        (firsts, Some(next))
    }

    /// Local jobs that are not finished: orphans, when the process has just started.
    pub fn orphans(&self) -> Vec<String> {
        let local = |id: &&String| self.jobs.get(*id).is_some_and(|job| job.local);
        self.active.iter().filter(local).cloned().collect()
    }

    /// Active jobs that need an artifact.
    pub fn users_of(&self, key: &str) -> Vec<String> {
        self.users.get(key).into_iter().flatten().cloned().collect()
    }

    /// Whether an artifact's bytes are there.
    pub fn ready(&self, key: &str) -> bool {
        self.artifacts.get(key).is_some_and(|artifact| artifact.lease.phase == Phase::Done)
    }
}

impl Job {
    /// Rebuilds what is not stored of one job.
    pub fn index(&mut self) {
        let mut order: Vec<_> = self.chunks.iter().map(|(place, chunk)| (chunk.seq, *place)).collect();
        order.sort_unstable();
        self.order = order.into_iter().map(|(_, place)| place).collect();
        self.left = self.shards.iter().filter(|shard| shard.lease.phase != Phase::Done).count();
    }

    /// Cones that were computed again, in the order of frames, tiles and cones.
    pub fn audit(&self) -> Vec<AuditSample> {
        let mut samples: Vec<AuditSample> =
            self.shards.iter().flat_map(|shard| &shard.audit).copied().collect();
        samples.sort_by_key(|s| (s.frame, s.tile, s.cone));
        samples
    }

    /// What the plan and the audit of a finished job warn of; all shards have to be there.
    pub(super) fn judge(&self) -> Vec<String> {
        let Some(goal) = &self.goal else { return Vec::new() };
        let missed = verdict(&self.audit(), goal.drawn).and_then(|found| found.warning(goal.target));
        goal.warnings.iter().cloned().chain(missed).collect()
    }

    /// Digest over all chunks: BLAKE3 over frame, tile (u32 little-endian) and the chunk's hash, in frame and tile order.
    pub fn digest_of_chunks(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for ((frame, tile), chunk) in &self.chunks {
            hasher.update(&frame.to_le_bytes());
            hasher.update(&tile.to_le_bytes());
            hasher.update(&chunk.digest.hash);
        }
        format!("b3:{}", hasher.finalize().to_hex())
    }
}
