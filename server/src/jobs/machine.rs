//! The machine at work: a store with one writer, a copy of its state for readers, a clock, and a bell that rings when something
//! changed.
//!
//! Readers never wait for the disk: they look at a copy, on which the steps of a batch are repeated once the batch is durable.
//! A step is a function of state, command and time, so the copy says the same.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use super::clock::Clock;
use super::command::{Ask, Command, Reply};
use super::recall::Recalled;
use super::state::{State, WorkId};
use super::step::step;
use super::store::{Batch, Documents, JobStore, StoreError};

/// How often leases are looked over.
const REAP_EVERY: Duration = Duration::from_secs(1);

/// Commands that are made durable together, at most.
const BATCH: usize = 64;

/// Jobs that ended long ago and were read lately, at most.
const READ_AGAIN: usize = 8;

type Waiting = (Command, oneshot::Sender<Result<Reply, StoreError>>);

/// Runs steps one after the other; what waits while one transaction is written goes into the next one together.
pub struct Machine {
    shared: Arc<Shared>,
    documents: Documents,
    queue: mpsc::Sender<Waiting>,
}

/// What the writer and the readers have in common.
struct Shared {
    /// What is durable.
    state: RwLock<State>,
    /// Jobs that ended long ago, each in a state of its own; the latest read is the last.
    old: Mutex<VecDeque<(String, Arc<State>)>>,
    changed: watch::Sender<u64>,
    clock: Clock,
    stopped: CancellationToken,
    writing: tokio::sync::Mutex<()>,
}

impl Machine {
    /// A machine over a store. Must be called inside a runtime.
    pub fn new(store: impl JobStore + 'static, clock: Clock) -> Self {
        let documents = store.documents();
        let shared = Arc::new(Shared {
            state: RwLock::new(store.state().clone()),
            old: Mutex::default(),
            changed: watch::Sender::new(0),
            clock,
            stopped: CancellationToken::new(),
            writing: tokio::sync::Mutex::default(),
        });
        let (queue, waiting) = mpsc::channel(1024);
        // A task of its own: a caller that goes away does not leave a transaction half done.
        tokio::spawn(write(Box::new(store), waiting, Arc::clone(&shared)));
        Self { shared, documents, queue }
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
    pub fn read<T>(&self, look: impl FnOnce(&State) -> T) -> T {
        look(&self.shared.state.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Looks at the state with a job in it that may have ended long ago.
    ///
    /// # Errors
    /// When the store cannot read it.
    pub async fn read_job<T>(&self, id: &str, look: impl FnOnce(&State) -> T) -> Result<T, StoreError> {
        {
            let state = self.shared.state.read().unwrap_or_else(PoisonError::into_inner);
            if state.jobs.contains_key(id) {
                return Ok(look(&state));
            }
        }
        if let Some(state) = self.shared.old(id) {
            return Ok(look(&state));
        }
        let found = Arc::new(self.documents.job(id).await?.unwrap_or_default());
        // What is at work changes, what ended does not.
        if found.jobs.get(id).is_some_and(|job| !job.state.active()) {
            self.shared.keep_old(id, &found);
        }
        Ok(look(&found))
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
        self.shared.clock.now_ms()
    }

    /// Nothing is written any more when this returns.
    pub async fn stop(&self) {
        self.shared.stopped.cancel();
        drop(self.shared.writing.lock().await);
    }

    /// Rings after every change.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.shared.changed.subscribe()
    }

    /// Work for a worker, waiting for it when there is none.
    ///
    /// # Errors
    /// When the store cannot keep the lease.
    pub async fn lease(&self, ask: &Ask, wait: Duration) -> Result<Option<(WorkId, u64)>, StoreError> {
        let until = tokio::time::Instant::now() + wait;
        let mut changes = self.changes();
        loop {
            changes.mark_unchanged();
            if let Reply::Leased(Some(work)) = self.execute(Command::Lease(ask.clone())).await? {
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
            Command::Beat { .. } | Command::Note(_) | Command::Sweep(_) => Self::Silent,
            Command::Reap => Self::Reap,
            Command::Create(_)
            | Command::Lease(_)
            | Command::Commit { .. }
            | Command::Fail { .. }
            | Command::Release { .. }
            | Command::Cancel(_)
            | Command::Disown
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

impl Shared {
    /// A job that ended long ago and was read lately.
    fn old(&self, id: &str) -> Option<Arc<State>> {
        let mut old = self.old.lock().unwrap_or_else(PoisonError::into_inner);
        let place = old.iter().position(|(name, _)| name == id)?;
        let entry = old.remove(place)?;
        let state = Arc::clone(&entry.1);
        old.push_back(entry);
        Some(state)
    }

    fn keep_old(&self, id: &str, found: &Arc<State>) {
        let mut old = self.old.lock().unwrap_or_else(PoisonError::into_inner);
        // If it came back to work meanwhile, what was read may be over.
        if self.state.read().unwrap_or_else(PoisonError::into_inner).jobs.contains_key(id) {
            return;
        }
        old.retain(|(name, _)| name != id);
        old.push_back((id.to_owned(), Arc::clone(found)));
        if old.len() > READ_AGAIN {
            old.pop_front();
        }
    }

    /// Repeats a batch on the readers' copy.
    fn repeat(&self, store: &dyn JobStore, recalled: Recalled, commands: Vec<Command>, now_ms: u64) {
        // Lost results and who asks again bring an old job back to work; an old one may be deleted.
        let changed = |command: &Command| match command {
            Command::Create(new) => new.local,
            other => matches!(other, Command::LostChunk(..) | Command::Sweep(_)),
        };
        let changed = commands.iter().any(changed);
        {
            let mut state = self.state.write().unwrap_or_else(PoisonError::into_inner);
            state.take_in(recalled);
            for command in commands {
                step(&mut state, command, now_ms);
            }
            store.settle(&mut state);
        }
        if changed {
            self.old.lock().unwrap_or_else(PoisonError::into_inner).clear();
        }
    }
}

/// Carries out what waits, a batch a transaction, until the machine is gone or stopped.
async fn write(mut store: Box<dyn JobStore>, mut waiting: mpsc::Receiver<Waiting>, shared: Arc<Shared>) {
    let mut batch = Vec::with_capacity(BATCH);
    loop {
        tokio::select! {
            biased;
            () = shared.stopped.cancelled() => return,
            count = waiting.recv_many(&mut batch, BATCH) => if count == 0 { return },
        }
        let (commands, senders): (Vec<_>, Vec<_>) = batch.drain(..).unzip();
        let kinds: Vec<Kind> = commands.iter().map(Kind::of).collect();
        let _writing = shared.writing.lock().await;
        if shared.stopped.is_cancelled() {
            return;
        }
        let now_ms = shared.clock.now_ms();
        let leased = store.state().leased.len();
        match store.execute_all(&commands, now_ms).await {
            Ok(Batch { replies, recalled }) => {
                shared.repeat(store.as_ref(), recalled, commands, now_ms);
                let freed = store.state().leased.len() != leased;
                if kinds.iter().zip(&replies).any(|(kind, reply)| kind.rings(reply, freed)) {
                    shared.changed.send_modify(|count| *count += 1);
                }
                for (sender, reply) in senders.into_iter().zip(replies) {
                    let _ = sender.send(Ok(reply));
                }
            }
            Err(error) => {
                tracing::error!(%error, commands = senders.len(), "not kept, nothing has happened");
                *shared.state.write().unwrap_or_else(PoisonError::into_inner) = store.state().clone();
                let text = error.to_string();
                for sender in senders {
                    let _ = sender.send(Err(StoreError::Batch(text.clone())));
                }
            }
        }
    }
}
