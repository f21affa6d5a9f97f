//! A blob store in a local folder.
//!
//! `blobs/<first two hex digits>/<hex>-<size>`: written to `tmp/`, synced, renamed, folder synced; so a blob is whole or not
//! there. A blob whose size or hash is wrong when it is read is moved to `damaged/` and reported.

use std::fs::{self, File};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use crate::{BlobDigest, BlobSink, Blobs, Mapped, StoreError};

/// Read at once while verifying.
const PIECE: usize = 256 << 10;

/// Unfinished files older than this belong to nobody.
const STALE: Duration = Duration::from_hours(1);

/// Blobs in a folder.
#[derive(Clone, Debug)]
pub struct FolderStore {
    root: PathBuf,
}

impl FolderStore {
    /// Opens a store, making its folders when they are not there.
    ///
    /// # Errors
    /// When the folder cannot be made or written; the error names it.
    pub fn open(root: impl Into<PathBuf>) -> Result<Self, StoreError> {
        let store = Self { root: root.into() };
        for folder in ["blobs", "tmp", "damaged"] {
            let path = store.root.join(folder);
            fs::create_dir_all(&path).map_err(|e| io_error("make", &path, e))?;
        }
        store.remove_stale();
        // A folder that cannot be written is an error now, not at the first commit.
        drop(Sink::new(&store)?);
        Ok(store)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a blob is or would be.
    pub fn path(&self, digest: &BlobDigest) -> PathBuf {
        let hex = digest.hex();
        self.root.join("blobs").join(&hex[..2]).join(format!("{hex}-{}", digest.size))
    }

    /// Digests of the blobs in the folder, oldest first; their bytes are not looked at.
    pub fn list(&self) -> Vec<BlobDigest> {
        self.list_with_times().into_iter().map(|(_, digest)| digest).collect()
    }

    /// The same with the time when each was last written or read.
    pub fn list_with_times(&self) -> Vec<(SystemTime, BlobDigest)> {
        let mut found: Vec<(SystemTime, BlobDigest)> = Vec::new();
        for shelf in fs::read_dir(self.root.join("blobs")).into_iter().flatten().flatten() {
            for file in fs::read_dir(shelf.path()).into_iter().flatten().flatten() {
                let name = file.file_name().to_string_lossy().replacen('-', "/", 1);
                let modified = file.metadata().and_then(|data| data.modified());
                if let (Ok(digest), Ok(time)) = (format!("b3:{name}").parse(), modified) {
                    found.push((time, digest));
                }
            }
        }
        found.sort_unstable();
        found
    }

    /// Removes a blob; it is no error when it is not there.
    ///
    /// # Errors
    /// When the file cannot be removed.
    pub fn remove(&self, digest: &BlobDigest) -> Result<(), StoreError> {
        let path = self.path(digest);
        match fs::remove_file(&path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io_error("remove", &path, e)),
            Ok(()) | Err(_) => Ok(()),
        }
    }

    /// Removes a blob if it was neither written nor read for so long; says whether it did.
    ///
    /// # Errors
    /// When the file cannot be removed.
    pub fn remove_unused(&self, digest: &BlobDigest, unused: Duration) -> Result<bool, StoreError> {
        let modified = fs::metadata(self.path(digest)).and_then(|data| data.modified()).ok();
        let age = modified.and_then(|time| SystemTime::now().duration_since(time).ok());
        let old = age.is_some_and(|age| age >= unused);
        if old {
            self.remove(digest)?;
        }
        Ok(old)
    }

    fn remove_stale(&self) {
        let Ok(entries) = fs::read_dir(self.root.join("tmp")) else {
            return;
        };
        for entry in entries.flatten() {
            let written = entry.metadata().and_then(|data| data.modified()).ok();
            let age = written.and_then(|time| SystemTime::now().duration_since(time).ok());
            if age.is_some_and(|age| age > STALE) {
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    fn open_file(&self, digest: &BlobDigest) -> Result<(File, PathBuf), StoreError> {
        let path = self.path(digest);
        match File::open(&path) {
            Ok(file) => {
                // Read lately: eviction takes others first. A file system that keeps no times loses nothing else.
                let _ = file.set_modified(SystemTime::now());
                Ok((file, path))
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => Err(StoreError::Missing(*digest)),
            Err(e) => Err(io_error("read", &path, e)),
        }
    }

    /// A blob mapped into memory, verified: one pass over its bytes and no copy.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Damaged`], or the store cannot read.
    pub fn map(&self, digest: &BlobDigest) -> Result<Mapped, StoreError> {
        let (file, path) = self.open_file(digest)?;
        let length = file.metadata().map_err(|e| io_error("read", &path, e))?.len();
        if length != digest.size {
            return Err(self.set_aside(digest, &path));
        }
        let map = Mapped::new(&file).map_err(|e| io_error("map", &path, e))?;
        if BlobDigest::of(&map) == *digest { Ok(map) } else { Err(self.set_aside(digest, &path)) }
    }

    /// Moves a damaged blob aside, so that it is missing from now on and can be looked at.
    fn set_aside(&self, digest: &BlobDigest, path: &Path) -> StoreError {
        let name = path.file_name().unwrap_or_default();
        let aside = self.root.join("damaged").join(name);
        if let Err(error) = fs::rename(path, &aside).or_else(|_| fs::remove_file(path)) {
            tracing::warn!(%digest, %error, "cannot set a damaged blob aside");
        }
        tracing::warn!(%digest, "damaged blob set aside");
        StoreError::Damaged(*digest)
    }
}

impl Blobs for FolderStore {
    fn begin(&self) -> Result<Box<dyn BlobSink>, StoreError> {
        Ok(Box::new(Sink::new(self)?))
    }

    fn open(&self, digest: &BlobDigest) -> Result<Box<dyn Read + Send>, StoreError> {
        let (mut file, path) = self.open_file(digest)?;
        let (mut hasher, mut size) = (blake3::Hasher::new(), 0);
        let mut piece = vec![0; PIECE];
        loop {
            let n = file.read(&mut piece).map_err(|e| io_error("read", &path, e))?;
            if n == 0 {
                break;
            }
            hasher.update(&piece[..n]);
            size += n as u64;
        }
        if size != digest.size || hasher.finalize().as_bytes() != &digest.hash {
            return Err(self.set_aside(digest, &path));
        }
        file.rewind().map_err(|e| io_error("read", &path, e))?;
        Ok(Box::new(file))
    }

    fn get(&self, digest: &BlobDigest) -> Result<Vec<u8>, StoreError> {
        let (mut file, path) = self.open_file(digest)?;
        let length = file.metadata().map_err(|e| io_error("read", &path, e))?.len();
        if length != digest.size {
            return Err(self.set_aside(digest, &path));
        }
        let mut bytes = Vec::with_capacity(length as usize);
        file.read_to_end(&mut bytes).map_err(|e| io_error("read", &path, e))?;
        if BlobDigest::of(&bytes) == *digest { Ok(bytes) } else { Err(self.set_aside(digest, &path)) }
    }

    fn has(&self, digest: &BlobDigest) -> Result<bool, StoreError> {
        let path = self.path(digest);
        match fs::metadata(&path) {
            Ok(data) => Ok(data.len() == digest.size),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(e) => Err(io_error("read", &path, e)),
        }
    }
}

/// A blob on its way into the folder.
struct Sink {
    store: FolderStore,
    file: File,
    path: PathBuf,
    hasher: blake3::Hasher,
    size: u64,
}

impl Sink {
    fn new(store: &FolderStore) -> Result<Self, StoreError> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let name =
            format!("{}-{}-{}", std::process::id(), now.as_nanos(), COUNTER.fetch_add(1, Ordering::Relaxed));
        let path = store.root.join("tmp").join(name);
        let file = File::create_new(&path).map_err(|e| io_error("write", &path, e))?;
        Ok(Self { store: store.clone(), file, path, hasher: blake3::Hasher::new(), size: 0 })
    }
}

impl BlobSink for Sink {
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.file.write_all(bytes).map_err(|e| io_error("write", &self.path, e))?;
        self.hasher.update(bytes);
        self.size += bytes.len() as u64;
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<BlobDigest, StoreError> {
        let digest = BlobDigest { hash: self.hasher.finalize().into(), size: self.size };
        // A whole copy that is there already is durable already; a damaged one is replaced.
        if self.store.open(&digest).is_ok() {
            return Ok(digest);
        }
        self.file.sync_all().map_err(|e| io_error("sync", &self.path, e))?;
        let target = self.store.path(&digest);
        let folder = target.parent().unwrap_or(&self.store.root);
        if !folder.is_dir() {
            fs::create_dir_all(folder).map_err(|e| io_error("make", folder, e))?;
            sync_folder(&self.store.root.join("blobs"))?;
        }
        fs::rename(&self.path, &target).map_err(|e| io_error("write", &target, e))?;
        sync_folder(folder)?;
        Ok(digest)
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // After a rename there is nothing left under this name.
        let _ = fs::remove_file(&self.path);
    }
}

fn sync_folder(path: &Path) -> Result<(), StoreError> {
    let folder = File::open(path).map_err(|e| io_error("sync", path, e))?;
    folder.sync_all().map_err(|e| io_error("sync", path, e))
}

fn io_error(action: &'static str, path: &Path, source: io::Error) -> StoreError {
    StoreError::Io { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, FolderStore) {
        let folder = tempfile::tempdir().unwrap();
        let store = FolderStore::open(folder.path()).unwrap();
        (folder, store)
    }

    #[test]
    fn bytes_come_back() {
        let (_folder, store) = store();
        for bytes in [vec![], vec![7], vec![1; 3 * PIECE + 1]] {
            let digest = store.put(&bytes).unwrap();
            assert_eq!(digest, BlobDigest::of(&bytes));
            assert_eq!(store.put(&bytes).unwrap(), digest);
            assert!(store.has(&digest).unwrap());
            assert_eq!(store.get(&digest).unwrap(), bytes);
            assert!(*store.map(&digest).unwrap() == *bytes);
            let mut read = Vec::new();
            store.open(&digest).unwrap().read_to_end(&mut read).unwrap();
            assert_eq!(read, bytes);
        }
        assert_eq!(fs::read_dir(store.root().join("tmp")).unwrap().count(), 0);
    }

    #[test]
    fn missing_is_said() {
        let (_folder, store) = store();
        let digest = BlobDigest::of(b"nobody put this");
        assert!(!store.has(&digest).unwrap());
        assert!(matches!(store.get(&digest), Err(StoreError::Missing(d)) if d == digest));
    }

    #[test]
    fn damage_is_found_set_aside_and_healed() {
        let (_folder, store) = store();
        let digest = store.put(b"twelve bytes").unwrap();
        for damaged in [&b"twelve bytez"[..], b"twelve", b"twelve bytes and more", b""] {
            for by in 0..3 {
                fs::write(store.path(&digest), damaged).unwrap();
                let error = match by {
                    0 => store.get(&digest).err(),
                    1 => store.open(&digest).err(),
                    _ => store.map(&digest).err(),
                };
                assert!(matches!(error, Some(StoreError::Damaged(d)) if d == digest));
                assert!(matches!(store.get(&digest), Err(StoreError::Missing(_))));
                store.put(b"twelve bytes").unwrap();
                assert_eq!(store.get(&digest).unwrap(), b"twelve bytes");
            }
        }
        // Putting heals even before anybody has noticed.
        fs::write(store.path(&digest), b"twelve bytez").unwrap();
        store.put(b"twelve bytes").unwrap();
        assert_eq!(store.get(&digest).unwrap(), b"twelve bytes");
        assert!(fs::read_dir(store.root().join("damaged")).unwrap().count() > 0);
    }

    #[test]
    fn a_map_outlives_its_file() {
        let (_folder, store) = store();
        let digest = store.put(&vec![9; 100_000]).unwrap();
        let map = store.map(&digest).unwrap();
        fs::remove_file(store.path(&digest)).unwrap();
        assert!(matches!(store.map(&digest), Err(StoreError::Missing(_))));
        assert!(map.iter().all(|&byte| byte == 9));
    }

    #[test]
    fn a_dropped_sink_leaves_nothing() {
        let (_folder, store) = store();
        let mut sink = store.begin().unwrap();
        sink.write(b"half").unwrap();
        drop(sink);
        assert_eq!(fs::read_dir(store.root().join("tmp")).unwrap().count(), 0);
    }

    #[test]
    fn an_impossible_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        let error = FolderStore::open(file.join("store")).unwrap_err().to_string();
        assert!(error.contains("cannot make") && error.contains("file/store"), "{error}");
    }
}
