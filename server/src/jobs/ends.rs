//! How things end, and begin again: failures, cancels, vanished workers, lost bytes, and what is over for long.

use super::command::{Reply, Sweep};
use super::lease::{Lease, MAX_LOSSES, Phase, Verdict};
use super::state::{JobState, ORPHAN, Shard, WorkId};
use super::step::Step;

impl Step<'_> {
    /// Work that cannot be done ends every job that needs it.
    pub(super) fn give_up(&mut self, id: &WorkId, message: &str) {
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

    pub(super) fn cancel(&mut self, id: &str) -> Reply {
        match self.state.jobs.get(id) {
            None => return Reply::NoSuchJob,
            Some(job) if job.state.active() => self.end(id, JobState::Cancelled, None),
            Some(_) => {}
        }
        Reply::Done
    }

    /// Nobody waits for the local jobs of an earlier process: it was killed, perhaps for the memory that they took.
    pub(super) fn disown(&mut self) -> Reply {
        for id in self.state.orphans() {
            self.end(&id, JobState::Cancelled, Some(ORPHAN.into()));
        }
        Reply::Done
    }

    pub(super) fn reap(&mut self) -> Reply {
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

    pub(super) fn sweep(&mut self, what: Sweep) -> Reply {
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

    pub(super) fn lost_artifact(&mut self, key: String) -> Reply {
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

    pub(super) fn lost_chunk(&mut self, id: &str, frame: u32, tile: u32) -> Reply {
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
            job.warnings.clear();
        });
        if !self.state.active.contains(id) {
            self.state.activate(id);
        }
        Reply::Done
    }
}
