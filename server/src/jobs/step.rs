//! The machine's logic: a command changes the state and says which rows a store has to keep. No I/O, no clock, no randomness.

use photoneye_eye::exposure::audit::AuditSample;
use photoneye_store::BlobDigest;

use super::command::{Ask, Command, Commit, Effects, Record, Reply, Row};
use super::lease::{Lease, Verdict};
use super::pick::pick;
use super::state::{Chunk, Job, JobState, State, Summary, WorkId};

/// Carries out a command at a time (ms since 1970).
pub fn step(state: &mut State, command: Command, now_ms: u64) -> (Reply, Effects) {
    let mut step = Step { state, now_ms, effects: Effects::default() };
    let reply = match command {
        Command::Create(job) => step.create(*job),
        Command::Lease(ask) => Reply::Leased(step.lease(&ask)),
        Command::Beat { id, fence, stage } => Reply::Held(step.beat(&id, fence, stage)),
        Command::Commit { id, fence, commit, report_json } => step.commit(&id, fence, commit, report_json),
        Command::Fail { id, fence, message, deterministic } => {
            let verdict = step.change(&id, |lease| lease.fail(fence, deterministic)).flatten();
            if verdict == Some(Verdict::GivenUp) {
                step.give_up(&id, &message);
            }
            Reply::Held(verdict.is_some())
        }
        Command::Release { id, fence } => {
            let held = step.state.lease(&id).is_some_and(|lease| lease.held(fence));
            if held {
                step.change(&id, Lease::reopen);
            }
            Reply::Held(held)
        }
        Command::Cancel(job) => step.cancel(&job),
        Command::Disown => step.disown(),
        Command::Reap => step.reap(),
        Command::LostArtifact(key) => step.lost_artifact(key),
        Command::LostChunk(job, frame, tile) => step.lost_chunk(&job, frame, tile),
        Command::Sweep(what) => step.sweep(what),
        Command::Note(record) => {
            step.effects.records.push(record);
            Reply::Done
        }
    };
    let Step { state, effects, .. } = step;
    debug_assert_eq!(state.check(), Ok(()));
    (reply, effects)
}

/// A command on its way through the state.
pub(super) struct Step<'a> {
    pub(super) state: &'a mut State,
    pub(super) now_ms: u64,
    pub(super) effects: Effects,
}

impl Step<'_> {
    /// Changes a lease and marks its row.
    pub(super) fn change<T>(&mut self, id: &WorkId, change: impl FnOnce(&mut Lease) -> T) -> Option<T> {
        let result = self.state.change(id, change)?;
        self.effects.rows.insert(match id {
            WorkId::Build(key) => Row::Artifact(key.clone()),
            WorkId::Shard(job, number) => Row::Shard(job.clone(), *number),
        });
        Some(result)
    }

    /// Changes a job as its users see it.
    pub(super) fn change_job(&mut self, id: &str, change: impl FnOnce(&mut Job)) {
        if let Some(job) = self.state.jobs.get_mut(id) {
            change(job);
            job.version += 1;
            self.effects.rows.insert(Row::Job(id.to_owned()));
        }
    }

    fn lease(&mut self, ask: &Ask) -> Option<(WorkId, u64)> {
        let id = pick(self.state, ask)?;
        let now_ms = self.now_ms;
        let fence = self.change(&id, |lease| lease.take(&ask.worker, ask.local, now_ms)).flatten()?;
        let (payers, cost) = match &id {
            WorkId::Shard(job, _) => (vec![job.clone()], self.state.jobs.get(job)?.shard_us),
            WorkId::Build(key) => (self.state.users_of(key), self.state.artifacts.get(key)?.predicted_us),
        };
        let share = cost / (payers.len() as u64).max(1);
        for job in payers {
            self.state.charge(&job, share.max(1));
            self.change_job(&job, |job| job.state = JobState::Running);
        }
        Some((id, fence))
    }

    /// A heartbeat changes nothing that a restart would need.
    fn beat(&mut self, id: &WorkId, fence: u64, stage: String) -> bool {
        let now_ms = self.now_ms;
        let held = self.state.change(id, |lease| lease.beat(fence, now_ms)).unwrap_or(false);
        if held && !stage.is_empty() {
            let jobs = match id {
                WorkId::Shard(job, _) => vec![job.clone()],
                WorkId::Build(key) => self.state.users_of(key),
            };
            for job in jobs {
                if let Some(job) = self.state.jobs.get_mut(&job) {
                    job.stage.clone_from(&stage);
                }
            }
        }
        held
    }

    fn commit(&mut self, id: &WorkId, fence: u64, commit: Commit, report_json: Option<String>) -> Reply {
        if !self.state.lease(id).is_some_and(|lease| lease.held(fence)) {
            return Reply::Held(false);
        }
        match (id, commit) {
            (WorkId::Build(key), Commit::Artifact { digest, cones }) => {
                self.commit_artifact(id, key, digest, cones);
            }
            (WorkId::Shard(job, number), Commit::Shard { chunks, audit }) => {
                if let Err(reason) = self.commit_chunks(job, *number, chunks) {
                    return Reply::Unfit(reason);
                }
                self.keep_audit(job, *number, audit);
            }
            (WorkId::Build(_), Commit::Shard { .. }) => {
                return Reply::Unfit("a build commits an artifact".into());
            }
            (WorkId::Shard(..), Commit::Artifact { .. }) => {
                return Reply::Unfit("a shard commits chunks".into());
            }
        }
        self.change(id, |lease| lease.commit(fence));
        if let Some(report) = report_json {
            self.effects.documents.push((format!("report/{id}"), report.into()));
        }
        if let WorkId::Shard(job, _) = id {
            self.finish_when_done(job);
        }
        Reply::Held(true)
    }

    /// The same work gave other bytes: somebody has to look, and both are kept.
    fn alarm(&mut self, work: String, first: BlobDigest, second: BlobDigest) {
        self.state.nondeterministic += 1;
        self.effects.records.push(Record::Alarm { work, first, second });
    }

    fn commit_artifact(&mut self, id: &WorkId, key: &str, digest: BlobDigest, cones: Option<u64>) {
        let previous = self.state.artifacts.get(key).and_then(|artifact| artifact.previous);
        if let Some(first) = previous.filter(|first| *first != digest) {
            self.alarm(id.to_string(), first, digest);
        }
        if let Some(artifact) = self.state.artifacts.get_mut(key) {
            artifact.previous = None;
            artifact.digest = Some(digest);
            artifact.cones = cones.or(artifact.cones);
        }
        self.state.asked.remove(key);
        for job in self.state.users_of(key) {
            self.change_job(&job, |_| ());
        }
    }

    /// Numbers the chunks of a shard in the order of commits; one that was there before keeps its number.
    fn commit_chunks(
        &mut self,
        job_id: &str,
        number: u32,
        chunks: Vec<(u32, BlobDigest, Summary)>,
    ) -> Result<(), String> {
        let job = self.state.jobs.get(job_id).ok_or("no such job")?;
        let shard = job.shards.get(number as usize).ok_or("no such shard")?;
        let tile = shard.tile;
        let frames = shard.first_frame..shard.first_frame + shard.frame_count;
        if !chunks.iter().map(|chunk| chunk.0).eq(frames.clone()) {
            return Err(format!("the shard's frames are {frames:?}, in this order, a chunk each"));
        }
        let first_cone = *self.state.first_cones(job).0.get(tile as usize).ok_or("no such tile")?;
        let cones = job.tiles.get(tile as usize).and_then(|tile| tile.first());
        let cones = cones.and_then(|key| self.state.artifacts.get(key)?.cones).unwrap_or(0);
        for (frame, digest, _) in &chunks {
            let job = self.state.jobs.get(job_id);
            let earlier = job.and_then(|job| job.chunks.get(&(*frame, tile))).map(|chunk| chunk.digest);
            if let Some(first) = earlier.filter(|first| first != digest) {
                self.alarm(format!("s/{job_id}/{number} frame {frame}"), first, *digest);
            }
        }
        let job = self.state.jobs.get_mut(job_id).ok_or("no such job")?;
        for (frame, digest, summary) in chunks {
            let next = job.chunks.len() as u64 + 1;
            let earlier = job.chunks.get(&(frame, tile));
            let seq = earlier.map_or(next, |earlier| earlier.seq);
            if seq == next {
                job.order.push((frame, tile));
            }
            job.chunks.insert((frame, tile), Chunk { seq, digest, first_cone, cones, summary });
            self.effects.rows.insert(Row::Chunk(job_id.to_owned(), frame, tile));
        }
        Ok(())
    }

    /// A shard that is computed again replaces its audit; the row is written with the lease.
    fn keep_audit(&mut self, job: &str, number: u32, audit: Vec<AuditSample>) {
        let job = self.state.jobs.get_mut(job);
        if let Some(shard) = job.and_then(|job| job.shards.get_mut(number as usize)) {
            shard.audit = audit;
        }
    }

    fn finish_when_done(&mut self, id: &str) {
        let now_ms = self.now_ms;
        let done = self.state.jobs.get(id).is_some_and(|job| job.left == 0);
        let cones = self.state.jobs.get(id).and_then(|job| self.state.first_cones(job).1);
        if done {
            self.state.deactivate(id);
        }
        self.change_job(id, |job| {
            if done {
                job.cones = cones;
                job.state = JobState::Succeeded;
                job.finished_ms = Some(now_ms);
                job.result_digest = Some(job.digest_of_chunks());
                job.warnings = job.judge();
            }
        });
    }
}
