//! A job is accepted: its rows, its texts, and the artifacts that are not known yet. Who ran the same in a process that is gone
//! gets that job again, with what was done.

use super::command::{NewArtifact, NewJob, Record, Reply, Row};
use super::lease::{Lease, Phase};
use super::state::{Artifact, Job, JobState, Shard, WorkId};
use super::step::Step;

impl Step<'_> {
    pub(super) fn create(&mut self, new: NewJob) -> Reply {
        if let Some((request, body)) = &new.request {
            match self.state.requests.get(request) {
                Some((job, earlier)) if earlier == body => return Reply::Created(job.clone(), false),
                Some(_) => return Reply::OtherBody,
                None => {}
            }
        }
        let left_over = self.left_over(&new);
        let id = left_over.clone().unwrap_or_else(|| new.id.clone());
        if let Some((request, body)) = new.request.clone() {
            self.state.requests.insert(request.clone(), (id.clone(), body));
            self.effects.rows.insert(Row::Request(request));
        }
        self.effects.records.push(Record::Audit {
            tenant: new.tenant.clone(),
            who: new.by.clone(),
            action: "create job",
            object: id.clone(),
        });
        match left_over {
            Some(_) => self.go_on(&id, new.artifacts),
            None => self.begin(new),
        }
        Reply::Created(id, true)
    }

    /// The last local job for the same experiment, when it was cancelled and would be done in the same pieces.
    fn left_over(&self, new: &NewJob) -> Option<String> {
        let same = |job: &&Job| job.local && new.local && job.experiment_digest == new.experiment_digest;
        let last = self.state.jobs.values().filter(same).max_by_key(|job| job.number)?;
        let pieces = |shard: &Shard| (shard.first_frame, shard.frame_count, shard.tile);
        let fits = last.state == JobState::Cancelled
            && last.tenant == new.tenant
            && last.tiles == new.tiles
            && last.artifacts.iter().eq(new.artifacts.iter().map(|artifact| &artifact.key))
            && last.shards.iter().map(pieces).eq(new.shards.iter().copied());
        fits.then(|| last.id.clone())
    }

    /// Goes on with a cancelled job; what was done stays done.
    fn go_on(&mut self, id: &str, artifacts: Vec<NewArtifact>) {
        for artifact in artifacts {
            self.add_artifact(artifact);
        }
        let Some(job) = self.state.jobs.get(id) else {
            return;
        };
        let (pass_us, now_ms) = (self.least_pass(&job.tenant), self.now_ms);
        let stopped = (0_u32..).zip(&job.shards).filter(|(_, shard)| shard.lease.phase != Phase::Done);
        let stopped: Vec<WorkId> = stopped.map(|(n, _)| WorkId::Shard(id.to_owned(), n)).collect();
        for shard in stopped {
            self.change(&shard, Lease::renew);
        }
        self.change_job(id, |job| {
            job.state = JobState::Queued;
            job.error = None;
            job.finished_ms = None;
            job.created_ms = now_ms;
            job.pass_us = pass_us;
        });
        self.state.activate(id);
    }

    fn begin(&mut self, new: NewJob) {
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
            ..Shard::default()
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
            goal: new.goal,
            version: 1,
            local: new.local,
            ..Job::default()
        };
        self.effects.rows.insert(Row::NewJob(id.clone()));
        self.state.next_number += 1;
        self.state.jobs.insert(id.clone(), Job { pass_us: self.least_pass(&job.tenant), ..job });
        self.state.activate(&id);
        for number in 0..new.shards.len() as u32 {
            self.change(&WorkId::Shard(id.clone(), number), |_| ());
        }
    }

    /// A new job is served like the one of its tenant that had least.
    pub(super) fn least_pass(&self, tenant: &str) -> u64 {
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
}
