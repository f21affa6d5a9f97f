//! Where the machine's rows are kept.

use std::collections::BTreeMap;

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
}

/// Keeps what the machine's steps change. A command whose rows could not be kept has not happened.
pub trait JobStore: Send {
    /// Carries out a command; what it changed is durable when this returns.
    ///
    /// # Errors
    /// When the rows cannot be kept.
    fn execute(&mut self, command: Command, now_ms: u64) -> BoxFuture<'_, Result<Reply, StoreError>>;

    /// The state.
    fn state(&self) -> &State;

    /// How to read texts without holding the store.
    fn documents(&self) -> Documents;
}

/// Reads texts: `experiment/<job>`, `plan/<job>`, `artifact/<key>`, `report/<work>`.
#[derive(Clone)]
pub enum Documents {
    /// A copy.
    Memory(BTreeMap<String, String>),
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
            Self::Memory(texts) => Ok(texts.get(id).cloned()),
            Self::Sqlite(pool) => Ok(sqlx::query_scalar("SELECT text FROM documents WHERE id = ?")
                .bind(id.to_owned())
                .fetch_optional(pool)
                .await?),
        }
    }
}
