//! Content-addressed blobs and the stored (Arrow) form of cones and counts.
//!
//! Stored bytes are verified when they are written and when they are read; damaged ones are moved aside and count as missing,
//! so that whoever needs them makes them again.

pub mod digest;
pub mod folder;
pub mod mapped;
pub mod npy;
pub mod photons;
pub mod table;

pub use digest::BlobDigest;
pub use folder::FolderStore;
pub use mapped::Mapped;

use std::io::Read;
use std::path::PathBuf;

/// Why a blob cannot be had or kept.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file system refused.
    #[error("cannot {action} {path}: {source}")]
    Io {
        /// What was tried: read, write, make, ….
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No such blob.
    #[error("no blob {0}")]
    Missing(BlobDigest),
    /// The stored bytes are not those that the digest names; they have been moved aside.
    #[error("blob {0} is damaged")]
    Damaged(BlobDigest),
}

impl StoreError {
    /// Whether making the blob again would help: it is missing or damaged.
    pub fn is_absent(&self) -> bool {
        matches!(self, Self::Missing(_) | Self::Damaged(_))
    }
}

/// Bytes kept under the hash of their content. All calls block: async callers use a blocking thread.
pub trait Blobs: Send + Sync {
    /// Keeps bytes; durable when it returns. The same bytes again cost a read.
    ///
    /// # Errors
    /// When the store cannot write.
    fn put(&self, bytes: &[u8]) -> Result<BlobDigest, StoreError> {
        let mut sink = self.begin()?;
        sink.write(bytes)?;
        sink.finish()
    }

    /// Begins a blob that arrives in pieces; dropping the sink leaves nothing behind.
    ///
    /// # Errors
    /// When the store cannot write.
    fn begin(&self) -> Result<Box<dyn BlobSink>, StoreError>;

    /// Opens a blob whose bytes have just been verified, at the cost of one pass over them and no memory.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Damaged`], or the store cannot read.
    fn open(&self, digest: &BlobDigest) -> Result<Box<dyn Read + Send>, StoreError>;

    /// All bytes of a blob, verified.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Damaged`], or the store cannot read.
    fn get(&self, digest: &BlobDigest) -> Result<Vec<u8>, StoreError>;

    /// Whether a blob of that digest and size is there; its bytes are not verified.
    ///
    /// # Errors
    /// When the store cannot look.
    fn has(&self, digest: &BlobDigest) -> Result<bool, StoreError>;
}

/// A blob that is being written.
pub trait BlobSink: Send {
    /// Adds bytes.
    ///
    /// # Errors
    /// When the store cannot write.
    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError>;

    /// Makes the blob durable under its digest.
    ///
    /// # Errors
    /// When the store cannot write.
    fn finish(self: Box<Self>) -> Result<BlobDigest, StoreError>;
}
