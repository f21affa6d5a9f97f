//! Work from the server's side, over gRPC.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use photoneye_eye::exposure::audit::AuditSample;
use photoneye_eye::report::WorkReport;
use photoneye_proto::v1;
use photoneye_proto::v1::commit_request::Done;
use photoneye_proto::v1::lease_reply::{Nothing, Work};
use photoneye_proto::v1::workers_server::Workers;
use photoneye_store::{BlobDigest, Blobs};
use tonic::{Request, Response, Status};

use super::{Local, needed};
use crate::error::{Error, Kind};
use crate::fleet::Word;
use crate::jobs::lease::TTL_MS;
use crate::jobs::state::{Summary, WorkId};
use crate::jobs::{Ask, Command, Commit, Reply, State};
use crate::service::{Service, unexpected};

/// Longest wait for work, ms.
const MAX_WAIT_MS: u32 = 30_000;

pub(super) struct Door(pub Arc<Service>);

#[tonic::async_trait]
impl Workers for Door {
    async fn lease(&self, request: Request<v1::LeaseRequest>) -> Result<Response<v1::LeaseReply>, Status> {
        let local = request.extensions().get::<Local>().is_some();
        let request = request.into_inner();
        self.0.fleet.heard(request.worker(), |word| *word = Word::default());
        self.0.metrics.worker_hits.fetch_add(request.cache_hits(), Ordering::Relaxed);
        self.0.metrics.worker_misses.fetch_add(request.cache_misses(), Ordering::Relaxed);
        let wait = Duration::from_millis(u64::from(request.wait_ms().min(MAX_WAIT_MS)));
        let until = tokio::time::Instant::now() + wait;
        let ask = Ask {
            worker: request.worker().to_owned(),
            local,
            holds: request.holds.iter().cloned().collect(),
            most: self.0.limits.tenant_leases,
            local_only: self.0.local_only,
        };
        loop {
            let wait = until.saturating_duration_since(tokio::time::Instant::now());
            let leased = self.0.machine.lease(&ask, wait).await.map_err(Error::from)?;
            let Some((id, fence)) = leased else {
                return Ok(Response::new(v1::LeaseReply {
                    work: Some(Work::Nothing(Nothing {})),
                    ..v1::LeaseReply::default()
                }));
            };
            // Inputs whose bytes are gone are built again first.
            if let Some(work) = self.work(&id).await? {
                tracing::debug!(work = %id, fence, worker = request.worker(), "leased");
                return Ok(Response::new(v1::LeaseReply {
                    work: Some(work),
                    id: Some(id.to_string()),
                    fence: Some(fence),
                    ttl_ms: Some(TTL_MS as u32),
                }));
            }
            self.held(Command::Release { id, fence }).await?;
        }
    }

    async fn heartbeat(
        &self,
        request: Request<v1::HeartbeatRequest>,
    ) -> Result<Response<v1::HeartbeatReply>, Status> {
        let request = request.into_inner();
        self.0.fleet.heard(request.worker(), |word| {
            *word = Word {
                work: request.id().to_owned(),
                stage: request.stage().chars().take(200).collect(),
                progress: request.progress(),
                memory_bytes: request.memory_bytes(),
                cpu_seconds: request.cpu_seconds(),
                cache_bytes: request.cache_bytes(),
            };
        });
        let keep = self
            .held(Command::Beat {
                id: work_id(request.id())?,
                fence: needed("fence", request.fence)?,
                stage: request.stage().chars().take(200).collect(),
            })
            .await?;
        Ok(Response::new(v1::HeartbeatReply { keep: Some(keep) }))
    }

    async fn commit(&self, request: Request<v1::CommitRequest>) -> Result<Response<v1::CommitReply>, Status> {
        let request = request.into_inner();
        let commit = match needed("done", request.done)? {
            Done::Artifact(artifact) => {
                let digest = digest("artifact.digest", artifact.digest())?;
                self.stored("artifact.digest", vec![digest]).await?;
                Commit::Artifact { digest, cones: artifact.cones }
            }
            Done::Shard(shard) => {
                let chunks = shard.chunks.into_iter().map(|chunk| {
                    let digest = digest("shard.chunks.digest", chunk.digest())?;
                    let frame = needed("shard.chunks.frame", chunk.frame)?;
                    let (sum, sum_squares, cones) = (chunk.sum, chunk.sum_squares, chunk.cones);
                    Ok((frame, digest, Summary { sum, sum_squares, cones }))
                });
                let chunks = chunks.collect::<Result<Vec<_>, Status>>()?;
                let digests = chunks.iter().map(|(_, digest, _)| *digest).collect();
                self.stored("shard.chunks.digest", digests).await?;
                Commit::Shard { chunks, audit: audited(request.report_json.as_deref()) }
            }
        };
        let command = Command::Commit {
            id: request.id.as_deref().map_or_else(|| work_id(""), work_id)?,
            fence: needed("fence", request.fence)?,
            commit,
            report_json: request.report_json.clone(),
        };
        let accepted = self.held(command).await?;
        if accepted && let Some(report) = &request.report_json {
            self.0.metrics.worked(report);
        }
        tracing::debug!(work = request.id, accepted, "commit");
        Ok(Response::new(v1::CommitReply { accepted: Some(accepted) }))
    }

    async fn fail(&self, request: Request<v1::FailRequest>) -> Result<Response<v1::FailReply>, Status> {
        let request = request.into_inner();
        tracing::warn!(work = request.id(), message = request.message(), "a computation failed");
        let accepted = self
            .held(Command::Fail {
                id: work_id(request.id())?,
                fence: needed("fence", request.fence)?,
                message: request.message().chars().take(2000).collect(),
                deterministic: request.deterministic(),
            })
            .await?;
        Ok(Response::new(v1::FailReply { accepted: Some(accepted) }))
    }
}

impl Door {
    /// Whether the worker held its lease.
    async fn held(&self, command: Command) -> Result<bool, Status> {
        match self.0.machine.execute(command).await.map_err(Error::from)? {
            Reply::Held(held) => {
                if !held {
                    self.0.metrics.fenced.fetch_add(1, Ordering::Relaxed);
                }
                Ok(held)
            }
            Reply::Unfit(reason) => Err(Error::new(Kind::Invalid, reason).into()),
            other => Err(unexpected(&other).into()),
        }
    }

    /// Refuses digests whose bytes are not in the store: a commit without them would promise what is not there.
    async fn stored(&self, field: &str, digests: Vec<BlobDigest>) -> Result<(), Status> {
        match self.missing(digests).await?.first() {
            None => Ok(()),
            Some(digest) => {
                Err(Error::new(Kind::NotReady, format!("{field}: no blob {digest}; upload it first")).into())
            }
        }
    }

    /// Those that are not in the store.
    async fn missing(&self, digests: Vec<BlobDigest>) -> Result<Vec<BlobDigest>, Error> {
        let look = move |blobs: &dyn Blobs| {
            let mut missing = Vec::new();
            for digest in digests {
                if !blobs.has(&digest)? {
                    missing.push(digest);
                }
            }
            Ok(missing)
        };
        self.0.with_blobs(look).await
    }

    /// What a leased piece of work is; `None` when bytes that it needs are gone, which is noted.
    async fn work(&self, id: &WorkId) -> Result<Option<Work>, Status> {
        let keys = match id {
            WorkId::Build(key) => {
                let inputs = |state: &State| state.artifacts.get(key).map(|artifact| artifact.inputs.clone());
                self.0.machine.read(inputs).unwrap_or_default()
            }
            WorkId::Shard(job, number) => {
                let tile = |state: &State| {
                    let job = state.jobs.get(job)?;
                    job.tiles.get(job.shards.get(*number as usize)?.tile as usize).cloned()
                };
                self.0.machine.read(tile).unwrap_or_default()
            }
        };
        let find = |state: &State| -> Vec<_> {
            let artifacts = keys.iter().map(|key| state.artifacts.get(key));
            artifacts
                .map(|found| {
                    found.map(|artifact| (artifact.kind.clone(), artifact.digest)).unwrap_or_default()
                })
                .collect()
        };
        let found = self.0.machine.read(find);
        let missing = self.missing(found.iter().filter_map(|(_, digest)| *digest).collect()).await?;
        let mut references = Vec::new();
        for (key, (kind, digest)) in keys.into_iter().zip(found) {
            let Some(digest) = digest.filter(|digest| !missing.contains(digest)) else {
                tracing::warn!(key, kind, "an artifact is gone and will be built again");
                self.0.machine.execute(Command::LostArtifact(key)).await.map_err(Error::from)?;
                return Ok(None);
            };
            references.push(v1::ArtifactRef {
                key: Some(key),
                kind: Some(kind),
                digest: Some(digest.to_string()),
            });
        }
        match id {
            WorkId::Build(key) => self.build(key, references).await.map(Some),
            WorkId::Shard(job, number) => self.shard(job, *number, references).await.map(Some),
        }
    }

    async fn build(&self, key: &str, inputs: Vec<v1::ArtifactRef>) -> Result<Work, Status> {
        let kind =
            self.0.machine.read(|state| state.artifacts.get(key).map(|artifact| artifact.kind.clone()));
        let spec_json = self.0.machine.document(&format!("artifact/{key}")).await.map_err(Error::from)?;
        Ok(Work::Build(v1::Build { key: Some(key.to_owned()), kind, spec_json, inputs }))
    }

    async fn shard(&self, id: &str, number: u32, artifacts: Vec<v1::ArtifactRef>) -> Result<Work, Status> {
        let name = self.0.look(id, |_, job| job.experiment_text.clone()).await?;
        let experiment_json = self.0.machine.document(&name).await.map_err(Error::from)?;
        let work = self
            .0
            .look(id, |state, job| {
                let shard = job.shards.get(number as usize)?;
                let first_cone = state.first_cones(job).0.get(shard.tile as usize).copied()?;
                Some(v1::Shard {
                    job: Some(id.to_owned()),
                    experiment_json,
                    first_frame: Some(shard.first_frame),
                    frame_count: Some(shard.frame_count),
                    tile: Some(shard.tile),
                    artifacts,
                    first_cone: Some(first_cone),
                })
            })
            .await?;
        Ok(Work::Shard(work.ok_or_else(|| Status::internal("a leased shard is gone"))?))
    }
}

/// The cones that a shard's report says were computed again.
fn audited(report_json: Option<&str>) -> Vec<AuditSample> {
    let Some(report) = report_json else { return Vec::new() };
    match serde_json::from_str::<WorkReport>(report) {
        Ok(report) => report.audit,
        Err(error) => {
            tracing::warn!(%error, "a worker's report cannot be read; its audit is left out");
            Vec::new()
        }
    }
}

fn digest(field: &str, text: &str) -> Result<BlobDigest, Status> {
    text.parse().map_err(|error: photoneye_store::digest::NotADigest| {
        Status::invalid_argument(format!("{field}: {error}"))
    })
}

fn work_id(text: &str) -> Result<WorkId, Status> {
    text.parse().map_err(|error: String| Status::invalid_argument(format!("id: {error}")))
}
