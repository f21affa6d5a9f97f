//! Where the machine's rows are kept.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures::FutureExt as _;
use futures::future::BoxFuture;

use super::command::{Command, Reply};
use super::recall::{self, Recalled};
use super::state::State;

/// Why a store cannot keep or read rows.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database refused.
    #[error("database: {0}")]
    Database(#[from] sqlx::Error),
    /// The database cannot be brought to this version's tables.
    #[error("database migration: {0}")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// A row is not what this program writes.
    #[error("database row of another shape: {0}")]
    Row(String),
    /// The step died; nothing was kept.
    #[error("the job machine stumbled: {0}")]
    Died(String),
    /// The batch that a command was in could not be kept; nothing of it was.
    #[error("{0}")]
    Batch(String),
    /// The server stops.
    #[error("the server is stopping")]
    Stopped,
}

/// What carrying out a batch of commands gave.
#[derive(Debug, Default)]
pub struct Batch {
    /// An answer for each command.
    pub replies: Vec<Reply>,
    /// What was read again before the first of them.
    pub recalled: Recalled,
}

/// Keeps what the machine's steps change. A command whose rows could not be kept has not happened.
pub trait JobStore: Send {
    /// Carries out commands one after the other; what they changed is durable when this returns.
    ///
    /// # Errors
    /// When the rows cannot be kept; then none of the commands has happened.
    fn execute_all<'a>(
        &'a mut self,
        commands: &'a [Command],
        now_ms: u64,
    ) -> BoxFuture<'a, Result<Batch, StoreError>>;

    /// Carries out one command.
    ///
    /// # Errors
    /// As [`JobStore::execute_all`].
    fn execute(&mut self, command: Command, now_ms: u64) -> BoxFuture<'_, Result<Reply, StoreError>> {
        async move {
            let batch = self.execute_all(&[command], now_ms).await?;
            batch.replies.into_iter().next().ok_or_else(|| StoreError::Died("no answer".into()))
        }
        .boxed()
    }

    /// What this store does to its state after a batch, done to a copy.
    fn settle(&self, state: &mut State);

    /// The state.
    fn state(&self) -> &State;

    /// How to read texts without holding the store.
    fn documents(&self) -> Documents;
}

/// Reads texts: `text/<hash>` (experiments and plans), `artifact/<key>`, `report/<work>`.
#[derive(Clone)]
pub enum Documents {
    /// In memory.
    Memory(Arc<Mutex<BTreeMap<String, Arc<str>>>>),
    /// Read-only connections.
    Sqlite(sqlx::SqlitePool),
}

impl Documents {
    /// A state with one job in it, if there is such a job.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn job(&self, id: &str) -> Result<Option<State>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(None);
        };
        let mut state = State::default();
        // One view of the database.
        let mut transaction = pool.begin().await?;
        state.take_in(recall::job(&mut transaction, &state, id).await?);
        Ok((!state.jobs.is_empty()).then_some(state))
    }

    /// One text, if there is one.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn get(&self, id: &str) -> Result<Option<String>, StoreError> {
        match self {
            Self::Memory(texts) => {
                let texts = texts.lock().unwrap_or_else(PoisonError::into_inner);
                Ok(texts.get(id).map(ToString::to_string))
            }
            Self::Sqlite(pool) => Ok(sqlx::query_scalar("SELECT text FROM documents WHERE id = ?")
                .bind(id.to_owned())
                .fetch_optional(pool)
                .await?),
        }
    }
}
