//! Has old jobs and records deleted, and removes what they leave in the blob store. And keeps the store within a size: what was
//! not read for longest goes first. Results and artifacts are made again when somebody asks; uploads cannot be, and what a job at
//! work needs stays too.

use std::collections::BTreeSet;
use std::time::{Duration, SystemTime};

use photoneye_store::{BlobDigest, FolderStore};

use crate::error::Error;
use crate::jobs::{Command, State, Sweep};
use crate::service::Service;

/// How often it looks.
const EVERY: Duration = Duration::from_mins(1);
/// How often it has old rows deleted, and the blobs that no row names.
const SWEEP_EVERY: Duration = Duration::from_hours(1);
/// Younger than this stays: it may be on its way into a commit.
const YOUNG: Duration = Duration::from_mins(10);
/// A blob that no row names stays so long: a worker puts the first frames of a shard long before it commits the shard.
const UNNAMED: Duration = Duration::from_hours(24);
/// Blobs looked up at once.
const PART: usize = 500;

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

    /// Has old jobs, records and blobs deleted, for ever.
    pub(crate) async fn sweep(&self, folder: &FolderStore) {
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
            // Found by looking, not by a list of what was deleted: after a crash in between it is found the next time.
            match self.remove_unnamed(folder).await {
                Ok(0) => {}
                Ok(count) => tracing::info!(count, "blobs removed that nothing names any more"),
                Err(error) => tracing::error!(%error, "cannot remove blobs"),
            }
        }
    }

    /// Removes blobs that no job, artifact, upload or alarm names; says how many.
    async fn remove_unnamed(&self, folder: &FolderStore) -> Result<usize, Error> {
        let store = folder.clone();
        let list = tokio::task::spawn_blocking(move || store.list_with_times()).await?;
        let old: Vec<BlobDigest> = list
            .into_iter()
            .take_while(|(time, _)| age(*time) >= UNNAMED)
            .map(|(_, digest)| digest)
            .collect();
        let mut count = 0;
        for part in old.chunks(PART) {
            let texts: Vec<String> = part.iter().map(ToString::to_string).collect();
            let named = self.machine.documents().named(&texts).await?;
            for digest in part.iter().filter(|digest| !named.contains(&digest.to_string())) {
                let (store, digest) = (folder.clone(), *digest);
                let removed = move || store.remove_unused(&digest, UNNAMED);
                count += usize::from(tokio::task::spawn_blocking(removed).await??);
            }
        }
        Ok(count)
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
            if bytes <= most_bytes || age(time) < young {
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

/// How long ago a time was.
fn age(time: SystemTime) -> Duration {
    SystemTime::now().duration_since(time).unwrap_or_default()
}

/// What jobs at work have and need.
fn in_use(state: &State) -> BTreeSet<BlobDigest> {
    let jobs = || state.active.iter().filter_map(|id| state.jobs.get(id));
    let chunks = jobs().flat_map(|job| job.chunks.values().map(|chunk| chunk.digest));
    let keys = jobs().flat_map(|job| &job.artifacts).chain(&state.asked);
    let artifacts = keys.filter_map(|key| state.artifacts.get(key)?.digest);
    chunks.chain(artifacts).collect()
}
