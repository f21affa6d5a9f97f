//! Where the machine's rows are kept.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures::FutureExt as _;
use futures::future::BoxFuture;

use super::command::{Command, Reply};
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

/// Keeps what the machine's steps change. A command whose rows could not be kept has not happened.
pub trait JobStore: Send {
    /// Carries out commands one after the other; what they changed is durable when this returns.
    ///
    /// # Errors
    /// When the rows cannot be kept; then none of the commands has happened.
    fn execute_all(
        &mut self,
        commands: Vec<Command>,
        now_ms: u64,
    ) -> BoxFuture<'_, Result<Vec<Reply>, StoreError>>;

    /// Carries out one command.
    ///
    /// # Errors
    /// As [`JobStore::execute_all`].
    fn execute(&mut self, command: Command, now_ms: u64) -> BoxFuture<'_, Result<Reply, StoreError>> {
        let replies = self.execute_all(vec![command], now_ms);
        async move { replies.await?.pop().ok_or_else(|| StoreError::Died("no answer".into())) }.boxed()
    }

    /// Brings a job that was forgotten back to hand.
    ///
    /// # Errors
    /// When the rows cannot be read.
    fn recall_job<'a>(&'a mut self, id: &'a str) -> BoxFuture<'a, Result<(), StoreError>>;

    /// The state.
    fn state(&self) -> &State;

    /// How to read texts without holding the store.
    fn documents(&self) -> Documents;
}

/// Reads texts: `experiment/<job>`, `plan/<job>`, `artifact/<key>`, `report/<work>`.
#[derive(Clone)]
pub enum Documents {
    /// In memory.
    Memory(Arc<Mutex<BTreeMap<String, String>>>),
    /// Read-only connections.
    Sqlite(sqlx::SqlitePool),
}

impl Documents {
    /// One text, if there is one.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn get(&self, id: &str) -> Result<Option<String>, StoreError> {
        match self {
            Self::Memory(texts) => Ok(texts.lock().unwrap_or_else(PoisonError::into_inner).get(id).cloned()),
            Self::Sqlite(pool) => Ok(sqlx::query_scalar("SELECT text FROM documents WHERE id = ?")
                .bind(id.to_owned())
                .fetch_optional(pool)
                .await?),
        }
    }
}
