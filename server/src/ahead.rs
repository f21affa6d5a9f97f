//! The next chunk of a stream is read and verified while the one before is on its way to the reader. A few streams at a time may do so:
//! so many chunks are read ahead in the whole server, and one whose reader does not come for it in time is given back.

use std::sync::Arc;
use std::time::Duration;

use photoneye_store::{BlobDigest, Blobs};
use tokio::sync::{Mutex, OwnedSemaphorePermit, Semaphore};
use tokio_util::task::AbortOnDropHandle;

/// Chunks that are read ahead at the same time, at most.
const PLACES: usize = 2;
/// A chunk that was read ahead waits for its reader so long.
const KEPT: Duration = Duration::from_secs(1);

/// Where chunks are read to.
pub struct Places(Arc<Semaphore>);

impl Default for Places {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(PLACES)))
    }
}

impl Places {
    /// Begins to read a blob, when there is a place.
    pub fn read(&self, blobs: &Arc<dyn Blobs>, digest: BlobDigest) -> Option<Ahead> {
        let free = Arc::clone(&self.0).try_acquire_owned().ok()?;
        let place = Place::default();
        // Who comes for it waits until it is read.
        let mut filling = Arc::clone(&place).try_lock_owned().ok()?;
        let (blobs, kept) = (Arc::clone(blobs), Arc::clone(&place));
        let reading = tokio::spawn(async move {
            let read = tokio::task::spawn_blocking(move || blobs.get(&digest)).await;
            *filling = read.ok().and_then(Result::ok).map(|bytes| (bytes, free));
            drop(filling);
            tokio::time::sleep(KEPT).await;
            drop(kept.lock().await.take());
        });
        Some(Ahead { digest, place, _reading: AbortOnDropHandle::new(reading) })
    }
}

/// Bytes and the permit for them.
type Place = Arc<Mutex<Option<(Vec<u8>, OwnedSemaphorePermit)>>>;

/// A blob that is being read ahead, or was; given back when dropped.
pub struct Ahead {
    digest: BlobDigest,
    place: Place,
    _reading: AbortOnDropHandle<()>,
}

impl Ahead {
    /// What was read, if it is this blob, could be read, and was not given back.
    pub async fn take(self, digest: &BlobDigest) -> Option<Vec<u8>> {
        if self.digest != *digest {
            return None;
        }
        self.place.lock().await.take().map(|(bytes, _)| bytes)
    }
}

#[cfg(test)]
mod tests {
    use photoneye_store::FolderStore;

    use super::*;

    #[tokio::test]
    async fn few_are_read_ahead_and_what_nobody_comes_for_is_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let blobs: Arc<dyn Blobs> = Arc::new(FolderStore::open(folder.path()).unwrap());
        let [a, b, c] = [b"a", b"b", b"c"].map(|text| blobs.put(text).unwrap());
        let places = Places::default();
        let (first, second) = (places.read(&blobs, a).unwrap(), places.read(&blobs, b).unwrap());
        assert!(places.read(&blobs, c).is_none());
        assert_eq!(first.take(&a).await.unwrap(), b"a");
        let third = places.read(&blobs, c).unwrap();
        assert!(third.take(&a).await.is_none());
        tokio::time::sleep(KEPT + KEPT / 2).await;
        assert_eq!(places.0.available_permits(), PLACES);
        assert!(second.take(&b).await.is_none());
        let missing = places.read(&blobs, BlobDigest::of(b"nobody put this")).unwrap();
        assert!(missing.take(&BlobDigest::of(b"nobody put this")).await.is_none());
    }
}
