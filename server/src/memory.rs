//! Memory that was freed goes back to the system when there is nothing to do. glibc keeps it for the threads that freed it, in up to
//! eight arenas a core: 60 MB after a small job. Here arenas are as many as cores, and what is free in them is given back.

use std::time::Duration;

use crate::service::Service;

/// After a change it may soon go on: so long is waited.
const PAUSE: Duration = Duration::from_secs(2);
/// Without any change it is done so often: answers to readers take memory too.
const AT_LEAST: Duration = Duration::from_mins(1);

impl Service {
    /// Gives memory back whenever no work is leased, for ever.
    pub(crate) async fn give_memory_back(&self) {
        let mut changes = self.machine.changes();
        loop {
            let _ = tokio::time::timeout(AT_LEAST, changes.changed()).await;
            tokio::time::sleep(PAUSE).await;
            if self.machine.read(|state| state.leased.is_empty()) {
                let _ = tokio::task::spawn_blocking(give_back).await;
            }
        }
    }
}

/// Bounds the arenas of this process; those that are there already stay.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub(crate) fn share_arenas() {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let most = libc::c_int::try_from(cores.max(2)).unwrap_or(libc::c_int::MAX);
    // SAFETY: mallopt takes two numbers; any thread may call it.
    #[allow(unsafe_code, reason = "a setting of the system's allocator")]
    let _ = unsafe { libc::mallopt(libc::M_ARENA_MAX, most) };
}

/// A few milliseconds at most.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn give_back() {
    // SAFETY: malloc_trim takes a number and touches only what is free; any thread may call it.
    #[allow(unsafe_code, reason = "a call of the system's allocator")]
    let _ = unsafe { libc::malloc_trim(0) };
}

/// Other allocators give back by themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn share_arenas() {}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn give_back() {}
