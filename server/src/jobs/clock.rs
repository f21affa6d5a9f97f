//! The machine's time.

use std::time::{Instant, SystemTime};

/// Milliseconds since 1970 that never jump while the process runs: the wall clock is read once, the rest is monotonic.
///
/// A wall clock that is set an hour forward or back moves no lease. After a restart every lease gets a whole term again, so
/// that a jump between two processes moves none either; what it moves are the times that people read.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    base_ms: u64,
    start: Instant,
}

impl Clock {
    /// A clock that is right now.
    pub fn new() -> Self {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self::at(now.as_millis() as u64)
    }

    /// A clock that begins at a time, ms since 1970.
    pub fn at(base_ms: u64) -> Self {
        Self { base_ms, start: Instant::now() }
    }

    /// The time.
    pub fn now_ms(&self) -> u64 {
        self.base_ms + self.start.elapsed().as_millis() as u64
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}
