//! Keeps the blob store within a size: what was not read for longest goes first. Results and artifacts are made again when
//! somebody asks; uploads cannot be, and what a job at work needs stays too. And it has old jobs and records deleted.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use photoneye_store::{BlobDigest, FolderStore};

use crate::error::Error;
use crate::jobs::{Command, State, Sweep};
use crate::service::Service;

/// How often it looks.
const EVERY: Duration = Duration::from_mins(1);
/// How often it has old rows deleted.
const SWEEP_EVERY: Duration = Duration::from_hours(1);
/// Younger than this stays: it may be on its way into a commit.
const YOUNG: Duration = Duration::from_mins(10);

impl Service {
    /// Looks again and again, for ever; without a size, never.
    pub(crate) async fn keep_size(&self, folder: &FolderStore, most_bytes: Option<u64>) {
        let Some(most_bytes) = most_bytes else {
            return std::future::pending().await;
        };
        let mut tick = tokio::time::interval(EVERY);
        loop {
            tick.tick().await;
            match self.evict(folder, most_bytes, YOUNG).await {
                Ok(0) => {}
                Ok(count) => tracing::info!(count, "blobs evicted"),
                Err(error) => tracing::error!(%error, "cannot make room"),
            }
        }
    }

    /// Has old jobs and records deleted, for ever.
    pub(crate) async fn sweep(&self) {
        let limits = &self.limits;
        let mut tick = tokio::time::interval(SWEEP_EVERY);
        loop {
            tick.tick().await;
            let kept_ms = limits.keep_days.map(|days| (days * 86_400_000.0) as u64);
            let sweep = Sweep {
                before_ms: kept_ms.map_or(0, |kept_ms| self.machine.now_ms().saturating_sub(kept_ms)),
                kept_jobs: limits.kept_jobs,
                kept_audit: limits.kept_audit,
            };
            if let Err(error) = self.machine.execute(Command::Sweep(sweep)).await {
                tracing::error!(%error, "cannot delete what is over");
            }
        }
    }

    /// Removes blobs until the rest fits; says how many.
    pub(crate) async fn evict(
        &self,
        folder: &FolderStore,
        most_bytes: u64,
        young: Duration,
    ) -> Result<usize, Error> {
        let store = folder.clone();
        let list = tokio::task::spawn_blocking(move || store.list_with_times()).await?;
        let mut bytes: u64 = list.iter().map(|(_, digest)| digest.size).sum();
        if bytes <= most_bytes {
            return Ok(0);
        }
        let pins = self.machine.read(in_use);
        let mut count = 0;
        for (time, digest) in list {
            let age = SystemTime::now().duration_since(time).unwrap_or_default();
            if bytes <= most_bytes || age < young {
                break;
            }
            if pins.contains(&digest) || self.machine.documents().uploaded(&digest.to_string()).await? {
                continue;
            }
            let store = folder.clone();
            tokio::task::spawn_blocking(move || store.remove(&digest)).await??;
            bytes -= digest.size;
            count += 1;
        }
        Ok(count)
    }
}

/// What jobs at work have and need.
fn in_use(state: &State) -> BTreeSet<BlobDigest> {
    let jobs = || state.active.iter().filter_map(|id| state.jobs.get(id));
    let chunks = jobs().flat_map(|job| job.chunks.values().map(|chunk| chunk.digest));
    let keys = jobs().flat_map(|job| &job.artifacts).chain(&state.asked);
    let artifacts = keys.filter_map(|key| state.artifacts.get(key)?.digest);
    chunks.chain(artifacts).collect()
}
