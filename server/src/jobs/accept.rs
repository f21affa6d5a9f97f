//! A job is accepted: its rows, its texts, and the artifacts that are not known yet.

use super::command::{NewArtifact, NewJob, Record, Reply, Row};
use super::lease::{Lease, Phase};
use super::state::{Artifact, Job, Shard, WorkId};
use super::step::Step;

impl Step<'_> {
    pub(super) fn create(&mut self, new: NewJob) -> Reply {
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
