//! Indexes over the active jobs: who is served next, and who needs an artifact; and what may be forgotten.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use super::lease::Phase;
use super::state::{Job, Place, State, WorkId};

/// Jobs that ended and stay at hand; a store that can read them again forgets the rest.
pub const KEPT_JOBS: usize = 64;
/// Results of such jobs, together.
pub const KEPT_CHUNKS: usize = 200_000;

fn place(job: &Job) -> Place {
    (Reverse(job.priority), job.pass_us, job.number, job.id.clone())
}

impl State {
    /// A job may be worked on from now on.
    pub fn activate(&mut self, id: &str) {
        let Some(job) = self.jobs.get(id) else {
            return;
        };
        self.active.insert(id.to_owned());
        // A tenant who comes back is served like the one that had least; idle time earns nothing.
        let least = self.passes.values().min().copied().unwrap_or(0);
        self.passes.entry(job.tenant.clone()).or_insert(least);
        self.queues.entry(job.tenant.clone()).or_default().insert(place(job));
        for key in &job.artifacts {
            self.users.entry(key.clone()).or_default().insert(id.to_owned());
        }
    }

    /// Nobody works on a job any more.
    pub fn deactivate(&mut self, id: &str) {
        let Some(job) = self.jobs.get(id).filter(|_| self.active.contains(id)) else {
            return;
        };
        self.active.remove(id);
        if let Some(queue) = self.queues.get_mut(&job.tenant) {
            queue.remove(&place(job));
            if queue.is_empty() {
                self.queues.remove(&job.tenant);
                self.passes.remove(&job.tenant);
            }
        }
        for key in &job.artifacts {
            if let Some(users) = self.users.get_mut(key) {
                users.remove(id);
                if users.is_empty() {
                    self.users.remove(key);
                }
            }
        }
    }

    /// Charges an active job and its tenant for work that was handed out.
    pub fn charge(&mut self, id: &str, cost_us: u64) {
        let Some(job) = self.jobs.get_mut(id) else {
            return;
        };
        let before = place(job);
        job.pass_us = job.pass_us.saturating_add(cost_us);
        let after = place(job);
        let tenant = job.tenant.clone();
        if let Some(queue) = self.queues.get_mut(&tenant)
            && queue.remove(&before)
        {
            queue.insert(after);
        }
        if let Some(pass) = self.passes.get_mut(&tenant) {
            *pass = pass.saturating_add(cost_us);
        }
    }

    /// After a batch: forgets what can be read again.
    pub fn settle(&mut self, kept_jobs: usize) {
        self.requests.clear();
        self.forget(kept_jobs);
    }

    /// Forgets jobs that ended, the oldest first, and artifacts that nobody at hand needs, when there are many of them.
    fn forget(&mut self, kept_jobs: usize) {
        let ended = |job: &&Job| !job.state.active();
        let chunks: usize = self.jobs.values().filter(ended).map(|job| job.chunks.len()).sum();
        if self.jobs.len() - self.active.len() <= 2 * kept_jobs && chunks <= KEPT_CHUNKS {
            return;
        }
        let mut old: Vec<_> =
            self.jobs.values().filter(ended).map(|job| (job.finished_ms, job.number)).collect();
        old.sort_unstable_by_key(|&age| Reverse(age));
        let mut stay = BTreeSet::new();
        let mut room = KEPT_CHUNKS / 2;
        let by_number: std::collections::BTreeMap<u64, (&String, usize)> =
            self.jobs.values().map(|job| (job.number, (&job.id, job.chunks.len()))).collect();
        for (_, number) in old.into_iter().take(kept_jobs) {
            let Some((id, chunks)) = by_number.get(&number).filter(|(_, chunks)| *chunks <= room) else {
                break;
            };
            room -= chunks;
            stay.insert((*id).clone());
        }
        self.jobs.retain(|id, job| job.state.active() || stay.contains(id));
        self.forget_artifacts();
    }

    /// Forgets artifacts that no job at hand needs and nobody asks for.
    pub fn forget_artifacts(&mut self) {
        let mut needed: BTreeSet<String> =
            self.jobs.values().flat_map(|job| &job.artifacts).cloned().collect();
        // What is asked for, and what that is made from.
        let mut asked: Vec<&String> = self.asked.iter().collect();
        while let Some(key) = asked.pop() {
            if needed.insert(key.clone()) {
                asked.extend(self.artifacts.get(key).into_iter().flat_map(|artifact| &artifact.inputs));
            }
        }
        self.artifacts.retain(|key, artifact| needed.contains(key) || artifact.lease.phase == Phase::Leased);
    }

    /// Whether a piece of work is at hand.
    pub fn knows(&self, id: &WorkId) -> bool {
        self.lease(id).is_some()
    }
}
