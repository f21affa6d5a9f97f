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
use sqlx::{ConnectOptions as _, Connection as _, Row as _, SqlSafeStr as _};

use super::command::{Command, Effects, Reply};
use super::index::KEPT_JOBS;
use super::lease::Phase;
use super::rows::{artifact_from, chunk_from, job_from, save_record, save_row, shard_from};
use super::state::{State, WorkId};
use super::step::step;
use super::store::{Documents, JobStore, StoreError};

/// The tables, step by step.
const MIGRATIONS: [(i64, &str, &str); 2] = [
    (1, "jobs", include_str!("../../../migrations/0001_jobs.sql")),
    (2, "tenants", include_str!("../../../migrations/0002_tenants.sql")),
];

/// Read-only connections.
const READERS: u32 = 4;

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
}

/// How the database is opened, by the server and by commands beside it.
pub fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
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
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .min_connections(0)
            .connect_lazy_with(options(path).create_if_missing(false).read_only(true));
        let mut state = load(&mut writer).await?;
        state.index(now_ms, true);
        Ok(Self { state, writer, file: path.to_owned(), readers, unsaved: false, kept_jobs: KEPT_JOBS })
    }

    /// How many jobs that ended stay at hand.
    pub fn keep(mut self, jobs: usize) -> Self {
        self.kept_jobs = jobs;
        self
    }

    async fn run(&mut self, commands: Vec<Command>, now_ms: u64) -> Result<Vec<Reply>, StoreError> {
        if self.unsaved {
            self.reload(now_ms).await?;
        }
        self.unsaved = true;
        let mut replies = Vec::with_capacity(commands.len());
        let mut all =
            Effects { reply: Reply::Done, rows: BTreeSet::new(), documents: Vec::new(), records: Vec::new() };
        for command in commands {
            self.recall(&command).await?;
            let effects = step(&mut self.state, command, now_ms);
            all.rows.extend(effects.rows);
            all.documents.extend(effects.documents);
            all.records.extend(effects.records);
            replies.push(effects.reply);
        }
        if !all.rows.is_empty() || !all.documents.is_empty() || !all.records.is_empty() {
            self.save(&all, now_ms).await?;
        }
        self.unsaved = false;
        self.state.requests.clear();
        self.state.forget(self.kept_jobs);
        Ok(replies)
    }

    /// Goes back to what the database says, over a new connection: on a full disk SQLite has rolled the transaction back by
    /// itself, and the old connection would still believe that it is inside one.
    async fn reload(&mut self, now_ms: u64) -> Result<(), StoreError> {
        self.writer = options(&self.file).connect().await?;
        self.state = load(&mut self.writer).await?;
        self.state.index(now_ms, false);
        self.unsaved = false;
        Ok(())
    }

    async fn save(&mut self, effects: &Effects, now_ms: u64) -> Result<(), StoreError> {
        let mut transaction = self.writer.begin_with("BEGIN IMMEDIATE").await?;
        for row in &effects.rows {
            save_row(&mut transaction, &self.state, row).await?;
        }
        for (id, text) in &effects.documents {
            sqlx::query("INSERT OR REPLACE INTO documents (id, text) VALUES (?, ?)")
                .bind(id.clone())
                .bind(text.clone())
                .execute(&mut *transaction)
                .await?;
        }
        for record in &effects.records {
            save_record(&mut transaction, record, now_ms).await?;
        }
        transaction.commit().await?;
        Ok(())
    }

    /// Reads what a command is about and what was forgotten.
    async fn recall(&mut self, command: &Command) -> Result<(), StoreError> {
        match command {
            Command::Create(new) => {
                if let Some((id, _)) = &new.request {
                    recall_request(&mut self.writer, &mut self.state, id).await?;
                }
                for artifact in &new.artifacts {
                    recall_artifact(&mut self.writer, &mut self.state, &artifact.key).await?;
                }
                Ok(())
            }
            Command::Cancel(job) | Command::LostChunk(job, ..) => {
                recall_job(&mut self.writer, &mut self.state, job).await
            }
            Command::LostArtifact(key) => recall_artifact(&mut self.writer, &mut self.state, key).await,
            Command::Lease { .. }
            | Command::Beat { .. }
            | Command::Commit { .. }
            | Command::Fail { .. }
            | Command::Release { .. }
            | Command::Reap
            | Command::Note(_) => Ok(()),
        }
    }
}

impl JobStore for SqliteStore {
    fn execute_all(
        &mut self,
        commands: Vec<Command>,
        now_ms: u64,
    ) -> BoxFuture<'_, Result<Vec<Reply>, StoreError>> {
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

    fn recall_job<'a>(&'a mut self, id: &'a str) -> BoxFuture<'a, Result<(), StoreError>> {
        recall_job(&mut self.writer, &mut self.state, id).boxed()
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

/// Reads what is at work.
async fn load(db: &mut SqliteConnection) -> Result<State, StoreError> {
    let mut state = State::default();
    let last: Option<i64> = sqlx::query_scalar("SELECT max(number) FROM jobs").fetch_one(&mut *db).await?;
    state.next_number = last.map_or(0, |last| last as u64 + 1);
    let alarms: i64 = sqlx::query_scalar("SELECT count(*) FROM alarms").fetch_one(&mut *db).await?;
    state.nondeterministic = alarms as u64;
    // Queued and running.
    let active: Vec<String> =
        sqlx::query_scalar("SELECT id FROM jobs WHERE state IN (0, 1)").fetch_all(&mut *db).await?;
    for id in active {
        recall_job(db, &mut state, &id).await?;
    }
    let leased = sqlx::query_scalar("SELECT key FROM artifacts WHERE phase = ?").bind(Phase::Leased as i64);
    let leased: Vec<String> = leased.fetch_all(&mut *db).await?;
    for key in leased {
        recall_artifact(db, &mut state, &key).await?;
    }
    Ok(state)
}

/// Reads a job with its shards, results and artifacts, if it is not at hand.
async fn recall_job(db: &mut SqliteConnection, state: &mut State, id: &str) -> Result<(), StoreError> {
    if state.jobs.contains_key(id) {
        return Ok(());
    }
    let row = sqlx::query("SELECT * FROM jobs WHERE id = ?").bind(id.to_owned());
    let Some(row) = row.fetch_optional(&mut *db).await? else {
        return Ok(());
    };
    let mut job = job_from(&row)?;
    let shards = sqlx::query("SELECT * FROM shards WHERE job = ? ORDER BY number").bind(id.to_owned());
    for row in shards.fetch_all(&mut *db).await? {
        job.shards.push(shard_from(&row)?);
    }
    let chunks = sqlx::query("SELECT * FROM chunks WHERE job = ?").bind(id.to_owned());
    for row in chunks.fetch_all(&mut *db).await? {
        let (place, chunk) = chunk_from(&row)?;
        job.chunks.insert(place, chunk);
    }
    job.index();
    for key in job.artifacts.clone() {
        recall_artifact(db, state, &key).await?;
    }
    state.jobs.insert(id.to_owned(), job);
    Ok(())
}

/// Reads an artifact and what it is made from, if they are not at hand.
async fn recall_artifact(db: &mut SqliteConnection, state: &mut State, key: &str) -> Result<(), StoreError> {
    let mut wanted = vec![key.to_owned()];
    while let Some(key) = wanted.pop() {
        if state.knows(&WorkId::Build(key.clone())) {
            continue;
        }
        let row = sqlx::query("SELECT * FROM artifacts WHERE key = ?").bind(key.clone());
        if let Some(row) = row.fetch_optional(&mut *db).await? {
            let artifact = artifact_from(&row)?;
            wanted.extend(artifact.inputs.iter().cloned());
            state.artifacts.insert(key, artifact);
        }
    }
    Ok(())
}

async fn recall_request(db: &mut SqliteConnection, state: &mut State, id: &str) -> Result<(), StoreError> {
    if state.requests.contains_key(id) {
        return Ok(());
    }
    let row = sqlx::query("SELECT job, body FROM requests WHERE id = ?").bind(id.to_owned());
    if let Some(row) = row.fetch_optional(db).await? {
        state.requests.insert(id.to_owned(), (row.try_get("job")?, row.try_get("body")?));
    }
    Ok(())
}
