//! The machine's logic: a command changes the state and says which rows a store has to keep. No I/O, no clock, no randomness.

use std::collections::BTreeSet;

use photoneye_store::BlobDigest;

use super::command::{Command, Commit, Effects, NewArtifact, NewJob, Record, Reply, Row, Sweep};
use super::lease::{Lease, MAX_LOSSES, Phase, Verdict};
use super::pick::pick;
use super::state::{Artifact, Chunk, Job, JobState, Shard, State, Summary, WorkId};

/// Carries out a command at a time (ms since 1970).
pub fn step(state: &mut State, command: Command, now_ms: u64) -> (Reply, Effects) {
    let mut step = Step { state, now_ms, effects: Effects::default() };
    let reply = match command {
        Command::Create(job) => step.create(*job),
        Command::Lease { most, worker, local, holds } => {
            Reply::Leased(step.lease(most, &worker, local, &holds))
        }
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

struct Step<'a> {
    state: &'a mut State,
    now_ms: u64,
    effects: Effects,
}

impl Step<'_> {
    /// Changes a lease and marks its row.
    fn change<T>(&mut self, id: &WorkId, change: impl FnOnce(&mut Lease) -> T) -> Option<T> {
        let result = self.state.change(id, change)?;
        self.effects.rows.insert(match id {
            WorkId::Build(key) => Row::Artifact(key.clone()),
            WorkId::Shard(job, number) => Row::Shard(job.clone(), *number),
        });
        Some(result)
    }

    /// Changes a job as its users see it.
    fn change_job(&mut self, id: &str, change: impl FnOnce(&mut Job)) {
        if let Some(job) = self.state.jobs.get_mut(id) {
            change(job);
            job.version += 1;
            self.effects.rows.insert(Row::Job(id.to_owned()));
        }
    }

    fn create(&mut self, new: NewJob) -> Reply {
        if let Some((request, body)) = &new.request {
            match self.state.requests.get(request) {
                Some((job, earlier)) if earlier == body => return Reply::Created(job.clone(), false),
                Some(_) => return Reply::OtherBody,
                None => {}
            }
            self.state.requests.insert(request.clone(), (new.id.clone(), body.clone()));
            self.effects.rows.insert(Row::Request(request.clone()));
        }
        let keys = new.artifacts.iter().map(|artifact| artifact.key.clone()).collect();
        for artifact in new.artifacts {
            self.add_artifact(artifact);
        }
        let id = new.id;
        let texts = [new.experiment, new.plan];
        let [experiment_text, plan_text] = texts.map(|text| {
            self.effects.documents.push((text.id.clone(), text.text));
            text.id
        });
        let shards = new.shards.iter().map(|&(first_frame, frame_count, tile)| Shard {
            first_frame,
            frame_count,
            tile,
            lease: Lease::default(),
        });
        let job = Job {
            id: id.clone(),
            number: self.state.next_number,
            tenant: new.tenant,
            priority: new.priority,
            experiment_digest: new.experiment_digest,
            experiment_text,
            plan_text,
            created_ms: self.now_ms,
            frames: new.frames,
            artifacts: keys,
            tiles: new.tiles,
            shards: shards.collect(),
            shard_count: new.shards.len() as u32,
            left: new.shards.len(),
            pass_us: 0,
            shard_us: new.shard_us,
            version: 1,
            ..Job::default()
        };
        self.effects.records.push(Record::Audit {
            tenant: job.tenant.clone(),
            who: new.by,
            action: "create job",
            object: id.clone(),
        });
        self.effects.rows.insert(Row::NewJob(id.clone()));
        self.state.next_number += 1;
        self.state.jobs.insert(id.clone(), Job { pass_us: self.least_pass(&job.tenant), ..job });
        self.state.activate(&id);
        for number in 0..new.shards.len() as u32 {
            self.change(&WorkId::Shard(id.clone(), number), |_| ());
        }
        Reply::Created(id, true)
    }

    /// A new job is served like the one of its tenant that had least.
    fn least_pass(&self, tenant: &str) -> u64 {
        let queue = self.state.queues.get(tenant).into_iter().flatten();
        // The first of each priority had least there.
        let mut least = None;
        let mut last = None;
        for (priority, pass_us, ..) in queue {
            if last != Some(priority) {
                least = Some(least.map_or(*pass_us, |least: u64| least.min(*pass_us)));
                last = Some(priority);
            }
        }
        least.unwrap_or(0)
    }

    /// Adds an artifact that is not known; one that failed or was cancelled gets another chance.
    fn add_artifact(&mut self, new: NewArtifact) {
        let id = WorkId::Build(new.key.clone());
        match self.state.lease(&id).map(|lease| lease.phase) {
            Some(Phase::Failed | Phase::Cancelled) => {
                self.change(&id, Lease::renew);
            }
            Some(Phase::Open | Phase::Leased | Phase::Done) => {}
            None => {
                self.effects.documents.push((format!("artifact/{}", new.key), new.spec_json));
                self.effects.rows.insert(Row::Artifact(new.key.clone()));
                let artifact = Artifact {
                    key: new.key.clone(),
                    kind: new.kind,
                    inputs: new.inputs,
                    predicted_us: new.predicted_us,
                    ..Artifact::default()
                };
                self.state.artifacts.insert(new.key, artifact);
            }
        }
    }

    fn lease(
        &mut self,
        most: usize,
        worker: &str,
        local: bool,
        holds: &BTreeSet<String>,
    ) -> Option<(WorkId, u64)> {
        let id = pick(self.state, most, holds)?;
        let now_ms = self.now_ms;
        let fence = self.change(&id, |lease| lease.take(worker, local, now_ms)).flatten()?;
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
            (WorkId::Shard(job, number), Commit::Shard(chunks)) => {
                if let Err(reason) = self.commit_chunks(job, *number, chunks) {
                    return Reply::Unfit(reason);
                }
            }
            (WorkId::Build(_), Commit::Shard(_)) => {
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
            }
        });
    }

    /// Work that cannot be done ends every job that needs it.
    fn give_up(&mut self, id: &WorkId, message: &str) {
        let (jobs, what) = match id {
            WorkId::Build(key) => {
                let kind = self.state.artifacts.get(key).map_or("artifact", |artifact| &artifact.kind);
                (self.state.users_of(key), format!("building {kind}: {message}"))
            }
            WorkId::Shard(job, _) => (vec![job.clone()], format!("computing counts: {message}")),
        };
        for job in jobs {
            self.end(&job, JobState::Failed, Some(what.clone()));
        }
    }

    /// Ends a job early: its shards are taken away, and builds that no other job wants.
    fn end(&mut self, id: &str, state: JobState, error: Option<String>) {
        let now_ms = self.now_ms;
        self.state.deactivate(id);
        self.change_job(id, |job| {
            job.state = state;
            job.error = error;
            job.finished_ms = Some(now_ms);
        });
        let Some(job) = self.state.jobs.get(id) else {
            return;
        };
        let unfinished = |shard: &Shard| matches!(shard.lease.phase, Phase::Open | Phase::Leased);
        let shards = (0_u32..).zip(&job.shards).filter(|(_, shard)| unfinished(shard));
        let shards: Vec<WorkId> = shards.map(|(n, _)| WorkId::Shard(id.to_owned(), n)).collect();
        let builds = job.artifacts.iter().map(|key| WorkId::Build(key.clone()));
        let builds: Vec<WorkId> = builds.filter(|id| self.state.leased.contains(id)).collect();
        for shard in shards {
            self.change(&shard, Lease::cancel);
        }
        for build in builds {
            if let WorkId::Build(key) = &build
                && self.state.users_of(key).is_empty()
            {
                self.change(&build, Lease::reopen);
            }
        }
    }

    fn cancel(&mut self, id: &str) -> Reply {
        match self.state.jobs.get(id) {
            None => return Reply::NoSuchJob,
            Some(job) if job.state.active() => self.end(id, JobState::Cancelled, None),
            Some(_) => {}
        }
        Reply::Done
    }

    fn reap(&mut self) -> Reply {
        let now_ms = self.now_ms;
        let over = |id: &&WorkId| self.state.lease(id).is_some_and(|lease| lease.expires_ms <= now_ms);
        let expired: Vec<WorkId> = self.state.leased.iter().filter(over).cloned().collect();
        for id in expired {
            // A job that ended meanwhile may have taken it away.
            let verdict = self.change(&id, |lease| lease.expire(now_ms)).flatten();
            if verdict == Some(Verdict::GivenUp) {
                self.give_up(&id, &format!("its worker vanished {MAX_LOSSES} times"));
            }
        }
        Reply::Done
    }

    fn sweep(&mut self, what: Sweep) -> Reply {
        let next = self.state.next_number;
        self.state.jobs.retain(|_, job| {
            let old = job.finished_ms.is_some_and(|ms| ms < what.before_ms)
                || job.number < next.saturating_sub(what.kept_jobs);
            // From the latest the next one gets its number.
            job.state.active() || !old || job.number + 1 == next
        });
        let jobs = &self.state.jobs;
        self.state.requests.retain(|_, (job, _)| jobs.contains_key(job));
        self.state.forget_artifacts();
        self.effects.sweep = Some(what);
        Reply::Done
    }

    fn lost_artifact(&mut self, key: String) -> Reply {
        let id = WorkId::Build(key.clone());
        let reopen = match self.state.lease(&id).map(|lease| lease.phase) {
            Some(Phase::Done | Phase::Failed | Phase::Cancelled) => true,
            Some(Phase::Open | Phase::Leased) => false,
            None => return Reply::Done,
        };
        if reopen {
            self.change(&id, Lease::renew);
            if let Some(artifact) = self.state.artifacts.get_mut(&key) {
                artifact.previous = artifact.digest.take().or(artifact.previous);
            }
        }
        self.state.asked.insert(key);
        Reply::Done
    }

    fn lost_chunk(&mut self, id: &str, frame: u32, tile: u32) -> Reply {
        let Some(job) = self.state.jobs.get(id) else {
            return Reply::NoSuchJob;
        };
        let holds = |shard: &Shard| {
            shard.tile == tile
                && shard.lease.phase == Phase::Done
                && (shard.first_frame..shard.first_frame + shard.frame_count).contains(&frame)
        };
        let alive = job.state.active() || job.state == JobState::Succeeded;
        let Some(number) = job.shards.iter().position(holds).filter(|_| alive) else {
            return Reply::Done;
        };
        let pass_us = self.least_pass(&job.tenant);
        self.change(&WorkId::Shard(id.to_owned(), number as u32), Lease::renew);
        self.change_job(id, |job| {
            if job.state == JobState::Succeeded {
                job.pass_us = pass_us;
            }
            job.state = JobState::Running;
            job.finished_ms = None;
            job.result_digest = None;
        });
        if !self.state.active.contains(id) {
            self.state.activate(id);
        }
        Reply::Done
    }
}
