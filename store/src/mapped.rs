//! A verified blob as memory of the file itself: its pages are the system's file cache, shared by all workers on a machine and given
//! back when memory is short. Nothing is copied.
//!
//! A blob's file is written under another name, renamed once and never written again; removing it leaves existing maps whole (POSIX).
//! Whoever else writes into the store's folder can harm a running worker: the folder belongs to the service alone.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::sync::Arc;

use memmap2::Mmap;

/// The bytes of a blob, mapped. Clones share one map.
#[derive(Clone, Debug)]
pub struct Mapped(Arc<Mmap>);

impl Mapped {
    /// Maps a whole file, read-only.
    pub(crate) fn new(file: &File) -> io::Result<Self> {
        // SAFETY: the file is a blob: it is never written after its rename (see above), so the bytes do not change under the map.
        #[allow(unsafe_code, reason = "the system call that maps a file")]
        let map = unsafe { Mmap::map(file) }?;
        Ok(Self(Arc::new(map)))
    }
}

impl Deref for Mapped {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl AsRef<[u8]> for Mapped {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}
