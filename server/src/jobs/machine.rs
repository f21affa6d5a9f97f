//! The machine at work: a store behind a lock, a clock, and a bell that rings when something changed.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use tokio::sync::{Mutex, watch};

use super::command::{Command, Reply};
use super::state::{State, WorkId};
use super::store::{JobStore, StoreError};

/// How often leases are looked over.
const REAP_EVERY: Duration = Duration::from_secs(1);

/// Runs steps one after the other.
pub struct Machine {
    store: Arc<Mutex<Box<dyn JobStore>>>,
    changed: Arc<watch::Sender<u64>>,
    clock: Clock,
}

impl Machine {
    /// A machine over a store.
    pub fn new(store: impl JobStore + 'static, clock: Clock) -> Self {
        Self { store: Arc::new(Mutex::new(Box::new(store))), changed: Arc::new(watch::Sender::new(0)), clock }
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// When the store could not keep what it changed; then nothing was changed.
    pub async fn execute(&self, command: Command) -> Result<Reply, StoreError> {
        // A task of its own: a caller that goes away does not leave a transaction half done.
        let (store, changed, clock) = (Arc::clone(&self.store), Arc::clone(&self.changed), self.clock);
        let task = tokio::spawn(async move {
            let mut store = store.lock().await;
            let leased = store.state().leased.len();
            let beat = matches!(command, Command::Beat { .. });
            let reap = matches!(command, Command::Reap);
            let reply = store.execute(command, clock.now_ms()).await?;
            let idle = beat || reply == Reply::Leased(None) || (reap && store.state().leased.len() == leased);
            drop(store);
            if !idle {
                changed.send_modify(|count| *count += 1);
            }
            Ok(reply)
        });
        task.await.map_err(|error| StoreError::Died(error.to_string()))?
    }

    /// Looks at the state.
    pub async fn read<T>(&self, look: impl FnOnce(&State) -> T) -> T {
        look(self.store.lock().await.state())
    }

    /// One of the store's texts.
    ///
    /// # Errors
    /// When the store cannot read.
    pub async fn document(&self, id: &str) -> Result<Option<String>, StoreError> {
        let documents = self.store.lock().await.documents();
        documents.get(id).await
    }

    /// Rings after every change.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Work for a worker, waiting for it when there is none.
    ///
    /// # Errors
    /// When the store cannot keep the lease.
    pub async fn lease(
        &self,
        worker: &str,
        local: bool,
        holds: &BTreeSet<String>,
        wait: Duration,
    ) -> Result<Option<(WorkId, u64)>, StoreError> {
        let until = tokio::time::Instant::now() + wait;
        let mut changes = self.changes();
        loop {
            changes.mark_unchanged();
            let command = Command::Lease { worker: worker.to_owned(), local, holds: holds.clone() };
            if let Reply::Leased(Some(work)) = self.execute(command).await? {
                return Ok(Some(work));
            }
            let rung = tokio::time::timeout_at(until, changes.changed()).await;
            if !matches!(rung, Ok(Ok(()))) {
                return Ok(None);
            }
        }
    }

    /// Takes leases from vanished workers, for ever.
    pub async fn reap(&self) {
        let mut tick = tokio::time::interval(REAP_EVERY);
        loop {
            tick.tick().await;
            if let Err(error) = self.execute(Command::Reap).await {
                tracing::error!(%error, "cannot look leases over");
            }
        }
    }
}

/// Milliseconds since 1970 that never jump while the process runs.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    base_ms: u64,
    start: Instant,
}

impl Clock {
    /// A clock that is right now.
    pub fn new() -> Self {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self { base_ms: now.as_millis() as u64, start: Instant::now() }
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
