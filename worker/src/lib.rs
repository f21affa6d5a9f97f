//! The worker: lease -> build an artifact or compute a shard -> commit.
//!
//! A worker dials out; it needs no open port and keeps nothing that it could not fetch or make again. Every write carries the
//! fence token of its lease, so that a worker that was given up for dead can do no harm when it comes back. The model runs on
//! blocking threads, never on the threads that talk to the server.

mod build;
mod cache;
mod cpu;
mod lease;
mod memory;
mod pictures;
mod remote;
mod scene;
mod shard;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use photoneye_proto::{ApiKey, v1};
use photoneye_store::{StoreError, table::TableError};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use tonic::transport::Channel;
use tracing::Instrument as _;

use cache::Cache;
use lease::Lease;
use remote::Remote;
use scene::Scenes;

/// How a worker works.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder of the local copies of artifacts and pictures.
    pub cache_dir: PathBuf,
    /// Most bytes of local copies; the ones not used for longest go first.
    pub cache_max_bytes: u64,
    /// Stop after this long without work; `None`: never.
    pub idle_exit: Option<Duration>,
    /// Name shown in logs and at the server.
    pub name: String,
    /// Leases worked on at the same time, 1 or more.
    pub leases: usize,
    /// API key to show; `None` where none is asked for.
    pub api_key: Option<String>,
}

/// Why a worker cannot start.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The cache folder cannot be used.
    #[error(transparent)]
    Cache(#[from] StoreError),
    /// The key cannot be sent.
    #[error("the API key is not plain text")]
    Key,
}

/// Why a piece of work did not end with a commit.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WorkError {
    /// The same inputs would fail again.
    #[error("{0}")]
    Model(String),
    /// Another try may succeed.
    #[error("{0}")]
    Passing(String),
    /// The lease is gone; nobody waits for the answer.
    #[error("the lease was withdrawn")]
    Dropped,
}

impl From<StoreError> for WorkError {
    fn from(error: StoreError) -> Self {
        Self::Passing(error.to_string())
    }
}

impl From<TableError> for WorkError {
    fn from(error: TableError) -> Self {
        Self::Model(error.to_string())
    }
}

/// Everything the leases of one worker share.
pub(crate) struct Shared {
    pub remote: Remote,
    pub cache: Cache,
    pub scenes: Scenes,
    pub cpu: Arc<cpu::Ledger>,
}

/// Takes work from a server until it is told to stop.
pub struct Worker {
    shared: Arc<Shared>,
    options: Options,
}

impl Worker {
    /// A worker that takes its work over `server`.
    ///
    /// # Errors
    /// When the cache folder cannot be made or written.
    pub fn new(server: Channel, options: Options) -> Result<Self, Error> {
        let key = options.api_key.as_deref().map_or(Some(ApiKey::default()), ApiKey::new);
        let remote = Remote::new(server, key.ok_or(Error::Key)?);
        let shared = Shared {
            cache: Cache::open(&options.cache_dir, options.cache_max_bytes, remote.clone())?,
            remote,
            scenes: Scenes::default(),
            cpu: Arc::default(),
        };
        Ok(Self { shared: Arc::new(shared), options })
    }

    /// Works until `shutdown`, or until there was no work for [`Options::idle_exit`]. Work that was begun before a shutdown is
    /// finished and committed; who cannot wait for it drops the future: the lease runs out and another worker takes it.
    pub async fn run(self, shutdown: CancellationToken) {
        let mut leases = JoinSet::new();
        for number in 0..self.options.leases.max(1) {
            let name = format!("{}/{number}", self.options.name);
            let (shared, idle_exit) = (Arc::clone(&self.shared), self.options.idle_exit);
            let shutdown = shutdown.clone();
            leases.spawn(async move { take_leases(&shared, &name, idle_exit, &shutdown).await });
        }
        while let Some(ended) = leases.join_next().await {
            if let Err(error) = ended {
                tracing::error!(%error, "a lease loop ended by itself");
            }
        }
    }
}

async fn take_leases(
    shared: &Arc<Shared>,
    name: &str,
    idle_exit: Option<Duration>,
    shutdown: &CancellationToken,
) {
    let mut last_work = Instant::now();
    loop {
        let holds = shared.cache.artifact_keys();
        let reply = tokio::select! {
            () = shutdown.cancelled() => return,
            reply = shared.remote.lease(name, holds, shared.cache.take_counts()) => reply,
        };
        let (Some(id), Some(work)) = (reply.id.clone(), reply.work.clone()) else {
            if idle_exit.is_some_and(|limit| last_work.elapsed() >= limit) {
                tracing::info!(worker = name, "no work, stopping");
                return;
            }
            continue;
        };
        let span = tracing::info_span!("work", lease = id, fence = reply.fence());
        do_work(shared, Lease::start(shared, name, id, &reply), work).instrument(span).await;
        last_work = Instant::now();
    }
}

/// Does one piece of work and tells the server how it ended.
async fn do_work(shared: &Arc<Shared>, lease: Lease, work: v1::lease_reply::Work) {
    let outcome = match work {
        v1::lease_reply::Work::Nothing(_) => return,
        v1::lease_reply::Work::Build(build) => build::run(shared, &lease, build).await,
        v1::lease_reply::Work::Shard(shard) => shard::run(shared, &lease, shard).await,
    };
    match outcome {
        Ok(done) => lease.commit(&shared.remote, done).await,
        Err(WorkError::Dropped) => tracing::info!(lease = lease.id(), "work dropped"),
        Err(error) => {
            tracing::warn!(lease = lease.id(), %error, "work failed");
            let deterministic = matches!(error, WorkError::Model(_));
            lease.fail(&shared.remote, error.to_string(), deterministic).await;
        }
    }
}

/// Runs the model on a blocking thread; a panic is an error of the model, not of the worker.
pub(crate) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, WorkError> + Send + 'static,
) -> Result<T, WorkError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(error) if error.is_panic() => {
            Err(WorkError::Model("the model panicked; please report this".into()))
        }
        Err(_) => Err(WorkError::Dropped),
    }
}
