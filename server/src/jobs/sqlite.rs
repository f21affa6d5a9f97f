//! Rows in SQLite: one writer connection with BEGIN IMMEDIATE, and read-only connections for texts and lists.
//!
//! What is at work is held in memory; jobs that ended are read again when somebody asks. The rows of a batch of commands are
//! written in one transaction before any of their answers goes out. When they could not be written, the state is read anew.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use futures::FutureExt as _;
use futures::future::BoxFuture;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, SqlSafeStr as _};

use super::command::{Command, Effects};
use super::index::KEPT_JOBS;
use super::recall;
use super::save::{prepare, save};
use super::state::State;
use super::step::step;
use super::store::{Batch, Documents, JobStore, StoreError};
use super::sweep::sweep;

/// The tables, step by step.
const MIGRATIONS: [(i64, &str, &str); 5] = [
    (1, "jobs", include_str!("../../../migrations/0001_jobs.sql")),
    (2, "tenants", include_str!("../../../migrations/0002_tenants.sql")),
    (3, "texts", include_str!("../../../migrations/0003_texts.sql")),
    (4, "local", include_str!("../../../migrations/0004_local.sql")),
    (5, "warnings", include_str!("../../../migrations/0005_warnings.sql")),
];

/// Read-only connections.
const READERS: u32 = 4;

/// Names of stored texts that are remembered, so that they are not written again.
const KEPT_TEXTS: usize = 1000;

/// Keeps rows in a database file.
pub struct SqliteStore {
    state: State,
    writer: SqliteConnection,
    file: PathBuf,
    readers: SqlitePool,
    /// The state may be ahead of the database.
    unsaved: bool,
    /// Jobs that ended and stay at hand.
    kept_jobs: usize,
    /// Texts that are stored.
    texts: BTreeSet<String>,
}

/// How the database is opened, by the server and by commands beside it.
pub fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .pragma("wal_autocheckpoint", "4000")
        .pragma("cache_size", "-16000")
        .busy_timeout(Duration::from_secs(5))
        .foreign_keys(true)
        .disable_statement_logging()
}

/// A connection that may write, to tables of this version.
///
/// # Errors
/// When the file cannot be opened, is of another program, or cannot be migrated.
pub async fn connect(path: &Path) -> Result<SqliteConnection, StoreError> {
    let mut writer = options(path).connect().await?;
    migrator().run(&mut writer).await?;
    Ok(writer)
}

impl SqliteStore {
    /// Opens a database, making or migrating it; leases of local workers of an earlier process are over.
    ///
    /// # Errors
    /// When the file cannot be opened, is of another program, or cannot be migrated.
    pub async fn open(path: &Path, now_ms: u64) -> Result<Self, StoreError> {
        let mut writer = connect(path).await?;
        prepare(&mut writer).await?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .min_connections(0)
            .test_before_acquire(false)
            .connect_lazy_with(options(path).create_if_missing(false).read_only(true));
        let mut state = recall::load(&mut writer).await?;
        state.index(now_ms, true);
        Ok(Self {
            state,
            writer,
            file: path.to_owned(),
            readers,
            unsaved: false,
            kept_jobs: KEPT_JOBS,
            texts: BTreeSet::new(),
        })
    }

    /// How many jobs that ended stay at hand.
    pub fn keep(mut self, jobs: usize) -> Self {
        self.kept_jobs = jobs;
        self
    }

    async fn run(&mut self, commands: &[Command], now_ms: u64) -> Result<Batch, StoreError> {
        if self.unsaved {
            self.reload(now_ms).await?;
        }
        self.unsaved = true;
        let recalled = recall::commands(&mut self.writer, &self.state, commands).await?;
        self.state.take_in(recalled.clone());
        let mut replies = Vec::with_capacity(commands.len());
        let mut all = Effects::default();
        for command in commands {
            let (reply, effects) = step(&mut self.state, command.clone(), now_ms);
            replies.push(reply);
            all.add(effects);
        }
        all.documents.retain(|(id, _)| !self.texts.contains(id));
        if !all.is_empty() {
            save(&mut self.writer, &self.state, &all, now_ms).await?;
        }
        self.unsaved = false;
        if let Some(what) = &all.sweep {
            // What could not be deleted now is deleted the next time.
            let swept = sweep(&mut self.writer, &self.state, what).await;
            swept.unwrap_or_else(|error| tracing::error!(%error, "cannot delete what is over"));
            self.texts.clear();
        }
        if self.texts.len() > KEPT_TEXTS {
            self.texts.clear();
        }
        // Under the hash of its content a text is what it is.
        let shared = all.documents.into_iter().map(|(id, _)| id).filter(|id| id.starts_with("text/"));
        self.texts.extend(shared);
        self.state.settle(self.kept_jobs);
        Ok(Batch { replies, recalled })
    }

    /// Goes back to what the database says, over a new connection: the old one may be what failed.
    async fn reload(&mut self, now_ms: u64) -> Result<(), StoreError> {
        self.writer = options(&self.file).connect().await?;
        prepare(&mut self.writer).await?;
        self.texts.clear();
        self.state = recall::load(&mut self.writer).await?;
        self.state.index(now_ms, false);
        self.unsaved = false;
        Ok(())
    }

    /// Brings a job that was forgotten back to hand.
    ///
    /// # Errors
    /// When the rows cannot be read.
    pub async fn recall_job(&mut self, id: &str) -> Result<(), StoreError> {
        let found = recall::job(&mut self.writer, &self.state, id).await?;
        self.state.take_in(found);
        Ok(())
    }
}

impl JobStore for SqliteStore {
    fn execute_all<'a>(
        &'a mut self,
        commands: &'a [Command],
        now_ms: u64,
    ) -> BoxFuture<'a, Result<Batch, StoreError>> {
        async move {
            let result = self.run(commands, now_ms).await;
            if result.is_err() && self.unsaved {
                // Nobody may see what has not happened. If even this fails, the next command tries again.
                self.reload(now_ms).await.unwrap_or_else(|error| tracing::error!(%error, "cannot read back"));
            }
            result
        }
        .boxed()
    }

    fn settle(&self, state: &mut State) {
        state.settle(self.kept_jobs);
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn documents(&self) -> Documents {
        Documents::Sqlite(self.readers.clone())
    }
}

fn migrator() -> Migrator {
    let steps = MIGRATIONS.map(|(version, name, text)| {
        Migration::new(version, name.into(), MigrationType::Simple, text.into_sql_str(), false)
    });
    Migrator::with_migrations(steps.into())
}
