//! One lease: its heartbeat, and the two ways to end it.
//!
//! The heartbeat comes at a third of the lease's time to live. When the server says that the lease is gone, or nothing was
//! heard for a whole time to live, the work is dropped: somebody else has it by now, and a late commit would be refused.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use photoneye_eye::report::WorkReport;
use photoneye_proto::v1;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::remote::{Remote, repeat};
use crate::{Shared, WorkError, memory};

/// When the first heartbeat comes.
const FIRST_BEAT: Duration = Duration::from_secs(1);

/// What the heartbeat tells.
#[derive(Clone, Debug, Default)]
struct Progress {
    part: f64,
    stage: String,
}

/// A lease that is kept alive until it is dropped.
pub(crate) struct Lease {
    id: String,
    fence: u64,
    gone: CancellationToken,
    progress: Arc<Mutex<Progress>>,
    /// Stops the heartbeat with the lease.
    _beating: DropGuard,
}

/// The result of a piece of work, ready to be committed.
pub(crate) struct Done {
    pub(crate) done: v1::commit_request::Done,
    pub(crate) report: WorkReport,
}

impl Lease {
    /// Starts the heartbeat of a lease that was just given.
    pub(crate) fn start(shared: &Arc<Shared>, worker: &str, id: String, reply: &v1::LeaseReply) -> Self {
        let time_to_live = Duration::from_millis(u64::from(reply.ttl_ms().max(300)));
        let gone = CancellationToken::new();
        let ended = CancellationToken::new();
        let progress = Arc::new(Mutex::new(Progress::default()));
        let heartbeat = Heartbeat {
            shared: Arc::clone(shared),
            worker: worker.to_owned(),
            id: id.clone(),
            fence: reply.fence(),
            progress: Arc::clone(&progress),
        };
        tokio::spawn({
            let (gone, ended) = (gone.clone(), ended.clone());
            async move {
                tokio::select! {
                    () = ended.cancelled() => {}
                    () = heartbeat.beat(time_to_live) => gone.cancel(),
                }
            }
        });
        Self { id, fence: reply.fence(), gone, progress, _beating: ended.drop_guard() }
    }

    /// For logs.
    pub(crate) fn id(&self) -> &str {
        &self.id
    }

    /// Tells the next heartbeat how far the work is, 0 to 1, and what it is about.
    pub(crate) fn progress(&self, part: f64, stage: &str) {
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        *progress = Progress { part, stage: stage.to_owned() };
    }

    /// Whether the work is still wanted; asked between frames.
    pub(crate) fn check(&self) -> Result<(), WorkError> {
        if self.gone.is_cancelled() { Err(WorkError::Dropped) } else { Ok(()) }
    }

    /// Commits the result.
    pub(crate) async fn commit(self, remote: &Remote, done: Done) {
        let request = v1::CommitRequest {
            id: Some(self.id.clone()),
            fence: Some(self.fence),
            report_json: serde_json::to_string(&done.report).ok(),
            done: Some(done.done),
        };
        let reply = repeat(|| {
            let (mut service, request) = (remote.workers(), request.clone());
            async move { service.commit(request).await }
        });
        match reply.await.map(tonic::Response::into_inner) {
            Ok(reply) if reply.accepted() => tracing::debug!(lease = self.id, "committed"),
            Ok(_) => tracing::info!(lease = self.id, "superseded, nothing was written"),
            Err(error) => tracing::warn!(lease = self.id, %error, "not committed"),
        }
    }

    /// Gives the work back with the reason.
    pub(crate) async fn fail(self, remote: &Remote, message: String, deterministic: bool) {
        let request = v1::FailRequest {
            id: Some(self.id.clone()),
            fence: Some(self.fence),
            message: Some(message),
            deterministic: Some(deterministic),
        };
        let reply = repeat(|| {
            let (mut service, request) = (remote.workers(), request.clone());
            async move { service.fail(request).await }
        });
        if let Err(error) = reply.await {
            tracing::warn!(lease = self.id, %error, "the failure could not be told; the lease will run out");
        }
    }
}

/// The task that keeps a lease alive.
struct Heartbeat {
    shared: Arc<Shared>,
    worker: String,
    id: String,
    fence: u64,
    progress: Arc<Mutex<Progress>>,
}

impl Heartbeat {
    /// Returns when the lease is gone.
    async fn beat(self, time_to_live: Duration) {
        let mut heard = Instant::now();
        // The first one comes early, so that people see what long work is about.
        let mut pause = (time_to_live / 3).min(FIRST_BEAT);
        loop {
            tokio::time::sleep(pause).await;
            pause = time_to_live / 3;
            let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let request = v1::HeartbeatRequest {
                id: Some(self.id.clone()),
                fence: Some(self.fence),
                progress: Some(progress.part),
                stage: Some(progress.stage),
                worker: Some(self.worker.clone()),
                memory_bytes: Some(memory::now_bytes()),
                cpu_seconds: Some(memory::cpu_seconds()),
                cache_bytes: Some(self.shared.cache.bytes()),
            };
            let mut service = self.shared.remote.workers();
            match tokio::time::timeout(time_to_live / 3, service.heartbeat(request)).await {
                Ok(Ok(reply)) if reply.get_ref().keep() => heard = Instant::now(),
                Ok(Ok(_)) => return,
                Ok(Err(_)) | Err(_) => {
                    if heard.elapsed() >= time_to_live {
                        return;
                    }
                }
            }
        }
    }
}
