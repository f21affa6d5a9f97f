//! The machine at work: a store behind a lock, a clock, and a bell that rings when something changed.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use super::command::{Command, Reply};
use super::state::{State, WorkId};
use super::store::{Documents, JobStore, StoreError};

/// How often leases are looked over.
const REAP_EVERY: Duration = Duration::from_secs(1);

/// Commands that are made durable together, at most.
const BATCH: usize = 64;

type Waiting = (Command, oneshot::Sender<Result<Reply, StoreError>>);

/// Runs steps one after the other; what waits while one transaction is written goes into the next one together.
pub struct Machine {
    store: Arc<Mutex<Box<dyn JobStore>>>,
    documents: Documents,
    queue: mpsc::Sender<Waiting>,
    changed: Arc<watch::Sender<u64>>,
    clock: Clock,
    stopped: CancellationToken,
}

impl Machine {
    /// A machine over a store. Must be called inside a runtime.
    pub fn new(store: impl JobStore + 'static, clock: Clock) -> Self {
        let documents = store.documents();
        let store: Arc<Mutex<Box<dyn JobStore>>> = Arc::new(Mutex::new(Box::new(store)));
        let changed = Arc::new(watch::Sender::new(0));
        let (queue, waiting) = mpsc::channel(1024);
        let stopped = CancellationToken::new();
        // A task of its own: a caller that goes away does not leave a transaction half done.
        tokio::spawn(write(Arc::clone(&store), waiting, Arc::clone(&changed), clock, stopped.clone()));
        Self { store, documents, queue, changed, clock, stopped }
    }

    /// Carries out a command.
    ///
    /// # Errors
    /// When the store could not keep what it changed; then nothing was changed.
    pub async fn execute(&self, command: Command) -> Result<Reply, StoreError> {
        let (sender, reply) = oneshot::channel();
        self.queue.send((command, sender)).await.map_err(|_| StoreError::Stopped)?;
        reply.await.map_err(|_| StoreError::Stopped)?
    }

    /// Looks at what is at work.
    pub async fn read<T>(&self, look: impl FnOnce(&State) -> T) -> T {
        look(self.store.lock().await.state())
    }

    /// Looks at the state with a job in it that may have ended long ago.
    ///
    /// # Errors
    /// When the store cannot read it.
    pub async fn read_job<T>(&self, id: &str, look: impl FnOnce(&State) -> T) -> Result<T, StoreError> {
        let mut store = self.store.lock().await;
        if !store.state().jobs.contains_key(id) {
            store.recall_job(id).await?;
        }
        Ok(look(store.state()))
    }

    /// Texts and lists, read beside the writer.
    pub fn documents(&self) -> &Documents {
        &self.documents
    }

    /// One of the store's texts.
    ///
    /// # Errors
    /// When the store cannot read.
    pub async fn document(&self, id: &str) -> Result<Option<String>, StoreError> {
        self.documents.get(id).await
    }

    /// The machine's time, ms since 1970.
    pub fn now_ms(&self) -> u64 {
        self.clock.now_ms()
    }

    /// Nothing is written any more when this returns.
    pub async fn stop(&self) {
        self.stopped.cancel();
        drop(self.store.lock().await);
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

/// Whether others want to know about a command.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Silent,
    Reap,
    Other,
}

impl Kind {
    fn of(command: &Command) -> Self {
        match command {
            Command::Beat { .. } | Command::Note(_) => Self::Silent,
            Command::Reap => Self::Reap,
            Command::Create(_)
            | Command::Lease { .. }
            | Command::Commit { .. }
            | Command::Fail { .. }
            | Command::Release { .. }
            | Command::Cancel(_)
            | Command::LostArtifact(_)
            | Command::LostChunk(..) => Self::Other,
        }
    }

    fn rings(self, reply: &Reply, freed: bool) -> bool {
        match self {
            Self::Silent => false,
            Self::Reap => freed,
            Self::Other => !matches!(reply, Reply::Leased(None) | Reply::Held(false)),
        }
    }
}

/// Carries out what waits, a batch a transaction, until the machine is gone or stopped.
async fn write(
    store: Arc<Mutex<Box<dyn JobStore>>>,
    mut waiting: mpsc::Receiver<Waiting>,
    changed: Arc<watch::Sender<u64>>,
    clock: Clock,
    stopped: CancellationToken,
) {
    let mut batch = Vec::with_capacity(BATCH);
    loop {
        tokio::select! {
            biased;
            () = stopped.cancelled() => return,
            count = waiting.recv_many(&mut batch, BATCH) => if count == 0 { return },
        }
        let (commands, senders): (Vec<_>, Vec<_>) = batch.drain(..).unzip();
        let kinds: Vec<Kind> = commands.iter().map(Kind::of).collect();
        let mut store = store.lock().await;
        if stopped.is_cancelled() {
            return;
        }
        let leased = store.state().leased.len();
        let result = store.execute_all(commands, clock.now_ms()).await;
        let freed = store.state().leased.len() != leased;
        drop(store);
        match result {
            Ok(replies) => {
                if kinds.iter().zip(&replies).any(|(kind, reply)| kind.rings(reply, freed)) {
                    changed.send_modify(|count| *count += 1);
                }
                for (sender, reply) in senders.into_iter().zip(replies) {
                    let _ = sender.send(Ok(reply));
                }
            }
            Err(error) => {
                tracing::error!(%error, commands = senders.len(), "not kept, nothing has happened");
                let text = error.to_string();
                for sender in senders {
                    let _ = sender.send(Err(StoreError::Batch(text.clone())));
                }
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
