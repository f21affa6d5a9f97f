//! Local copies of blobs, by digest: mapped into memory, verified each time, fetched once even when many ask, the longest unused go first.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use photoneye_proto::v1::ArtifactRef;
use photoneye_store::{BlobDigest, Blobs as _, FolderStore, Mapped, StoreError};
use tokio::sync::Mutex as AsyncMutex;

use crate::remote::Remote;
use crate::{WorkError, blocking};

/// Most artifact keys that a lease request names.
const MAX_HOLDS: usize = 200;

/// A folder of blobs in front of the server's store.
pub(crate) struct Cache {
    folder: FolderStore,
    max_bytes: u64,
    remote: Remote,
    used: Mutex<Used>,
    /// One fetch at a time for each blob.
    flights: Mutex<HashMap<BlobDigest, Arc<AsyncMutex<()>>>>,
    /// Blobs found here and blobs fetched, since the server was told.
    hits: AtomicU64,
    misses: AtomicU64,
}

/// Which blobs are here and when they were last used.
#[derive(Default)]
struct Used {
    clock: u64,
    last: HashMap<BlobDigest, u64>,
    by_age: BTreeMap<u64, BlobDigest>,
    bytes: u64,
    artifacts: BTreeMap<BlobDigest, String>,
}

impl Used {
    fn touch(&mut self, digest: BlobDigest) {
        self.clock += 1;
        match self.last.insert(digest, self.clock) {
            Some(before) => {
                self.by_age.remove(&before);
            }
            None => self.bytes += digest.size,
        }
        self.by_age.insert(self.clock, digest);
    }

    /// Takes the longest unused blobs out until the rest fits; the last one used stays.
    fn overflow(&mut self, max_bytes: u64) -> Vec<BlobDigest> {
        let mut out = Vec::new();
        while self.bytes > max_bytes && self.by_age.len() > 1 {
            let Some((_, digest)) = self.by_age.pop_first() else {
                break;
            };
            self.forget(&digest);
            out.push(digest);
        }
        out
    }

    fn forget(&mut self, digest: &BlobDigest) {
        if let Some(time) = self.last.remove(digest) {
            self.by_age.remove(&time);
            self.bytes -= digest.size;
        }
        self.artifacts.remove(digest);
    }
}

impl Cache {
    /// Opens the folder and takes stock of what an earlier run left there.
    pub(crate) fn open(folder: &Path, max_bytes: u64, remote: Remote) -> Result<Self, StoreError> {
        let folder = FolderStore::open(folder)?;
        let mut used = Used::default();
        for digest in folder.list() {
            used.touch(digest);
        }
        for digest in used.overflow(max_bytes) {
            remove(&folder, &digest);
        }
        Ok(Self {
            folder,
            max_bytes,
            remote,
            used: Mutex::new(used),
            flights: Mutex::default(),
            hits: AtomicU64::new(0),
            misses: AtomicU64::new(0),
        })
    }

    /// The bytes of an artifact.
    pub(crate) async fn artifact(&self, artifact: &ArtifactRef) -> Result<Mapped, WorkError> {
        let bytes = self.blob(artifact.digest()).await?;
        if let Ok(digest) = artifact.digest().parse() {
            self.used().artifacts.insert(digest, artifact.key().to_owned());
        }
        Ok(bytes)
    }

    /// The bytes of a blob: from the folder, or from the server.
    pub(crate) async fn blob(&self, digest: &str) -> Result<Mapped, WorkError> {
        let digest: BlobDigest = digest
            .parse()
            .map_err(|error: photoneye_store::digest::NotADigest| WorkError::Model(error.to_string()))?;
        let flight = Arc::clone(self.flights().entry(digest).or_default());
        let bytes = {
            let _only = flight.lock().await;
            self.read_or_fetch(digest).await
        };
        // The last one in flight takes the entry away: one reference here, one in the map.
        let mut flights = self.flights();
        if Arc::strong_count(&flight) <= 2 {
            flights.remove(&digest);
        }
        bytes
    }

    async fn read_or_fetch(&self, digest: BlobDigest) -> Result<Mapped, WorkError> {
        let folder = self.folder.clone();
        let local = blocking(move || Ok(folder.map(&digest))).await?;
        if let Ok(map) = local {
            self.used().touch(digest);
            self.hits.fetch_add(1, Ordering::Relaxed);
            return Ok(map);
        }
        self.used().forget(&digest);
        self.misses.fetch_add(1, Ordering::Relaxed);
        let bytes = self.remote.get(digest).await?;
        if BlobDigest::of(&bytes) != digest {
            return Err(WorkError::Passing(format!("blob {digest} arrived damaged")));
        }
        self.keep(bytes).await
    }

    /// Keeps bytes that were just made, so that they need not be fetched back.
    pub(crate) async fn keep(&self, bytes: Vec<u8>) -> Result<Mapped, WorkError> {
        let folder = self.folder.clone();
        let (digest, map) = blocking(move || {
            let digest = folder.put(&bytes)?;
            Ok((digest, folder.map(&digest)?))
        })
        .await?;
        let gone = {
            let mut used = self.used();
            used.touch(digest);
            used.overflow(self.max_bytes)
        };
        for digest in gone {
            remove(&self.folder, &digest);
        }
        Ok(map)
    }

    /// Blobs found here and blobs fetched, since this was asked last.
    pub(crate) fn take_counts(&self) -> [u64; 2] {
        [&self.hits, &self.misses].map(|count| count.swap(0, Ordering::Relaxed))
    }

    /// Bytes of local copies.
    pub(crate) fn bytes(&self) -> u64 {
        self.used().bytes
    }

    /// Keys of artifacts that are here, for the server to prefer this worker.
    pub(crate) fn artifact_keys(&self) -> Vec<String> {
        let mut keys: Vec<String> = self.used().artifacts.values().take(MAX_HOLDS).cloned().collect();
        keys.sort();
        keys
    }

    fn used(&self) -> std::sync::MutexGuard<'_, Used> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn flights(&self) -> std::sync::MutexGuard<'_, HashMap<BlobDigest, Arc<AsyncMutex<()>>>> {
        self.flights.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn remove(folder: &FolderStore, digest: &BlobDigest) {
    if let Err(error) = std::fs::remove_file(folder.path(digest)) {
        tracing::debug!(%digest, %error, "a local copy could not be removed");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lazy_remote() -> Remote {
        let channel = tonic::transport::Endpoint::from_static("http://127.0.0.1:1").connect_lazy();
        Remote::new(channel, photoneye_proto::ApiKey::default())
    }

    #[tokio::test]
    async fn the_longest_unused_copies_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 250, lazy_remote()).unwrap();
        let text = |fill: u8| vec![fill; 100];
        let digest = |fill| BlobDigest::of(&text(fill)).to_string();
        cache.keep(text(1)).await.unwrap();
        cache.keep(text(2)).await.unwrap();
        assert!(*cache.blob(&digest(1)).await.unwrap() == *text(1));
        assert_eq!([cache.take_counts(), cache.take_counts()], [[1, 0], [0, 0]]);
        cache.keep(text(3)).await.unwrap();
        let here = |fill| cache.folder.has(&BlobDigest::of(&text(fill))).unwrap();
        assert_eq!([here(1), here(2), here(3)], [true, false, true]);
        // Another run finds them again.
        let again = Cache::open(folder.path(), 250, lazy_remote()).unwrap();
        assert_eq!(again.used().bytes, 200);
        assert!(again.flights().is_empty() && cache.flights().is_empty());
    }

    #[tokio::test]
    async fn text_that_is_no_digest_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 250, lazy_remote()).unwrap();
        assert!(matches!(cache.blob("b3:zz/1").await, Err(WorkError::Model(_))));
    }
}
