//! Rows in SQLite: one writer connection with BEGIN IMMEDIATE, and read-only connections for texts.
//!
//! The state is held in memory; a command's rows are written in one transaction before its answer goes out. When they could
//! not be written, or the caller went away half-way, the state is read anew from the database.

use std::path::Path;
use std::str::FromStr as _;
use std::time::Duration;

use futures::FutureExt as _;
use futures::future::BoxFuture;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteRow,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _, Row as _, SqlSafeStr as _};

use photoneye_store::BlobDigest;

use super::command::{Command, Effects, Reply, Row};
use super::lease::{Lease, Phase};
use super::state::{Artifact, Chunk, Job, JobState, Shard, State};
use super::step::step;
use super::store::{Documents, JobStore, StoreError};

/// The tables, step by step.
const MIGRATIONS: [(i64, &str, &str); 1] = [(1, "jobs", include_str!("../../../migrations/0001_jobs.sql"))];

/// Read-only connections.
const READERS: u32 = 4;

/// Keeps rows in a database file.
pub struct SqliteStore {
    state: State,
    writer: SqliteConnection,
    readers: SqlitePool,
    /// The state may be ahead of the database.
    unsaved: bool,
}

impl SqliteStore {
    /// Opens a database, making or migrating it; leases of local workers of an earlier process are over.
    ///
    /// # Errors
    /// When the file cannot be opened, is of another program, or cannot be migrated.
    pub async fn open(path: &Path, now_ms: u64) -> Result<Self, StoreError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(5))
            .foreign_keys(true)
            .disable_statement_logging();
        let mut writer = options.connect().await?;
        migrator().run(&mut writer).await?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .min_connections(0)
            .connect_lazy_with(options.create_if_missing(false).read_only(true));
        let state = load(&mut writer, now_ms).await?;
        Ok(Self { state, writer, readers, unsaved: false })
    }

    async fn save(&mut self, effects: &Effects) -> Result<(), StoreError> {
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
        transaction.commit().await?;
        Ok(())
    }
}

impl JobStore for SqliteStore {
    fn execute(&mut self, command: Command, now_ms: u64) -> BoxFuture<'_, Result<Reply, StoreError>> {
        async move {
            if self.unsaved {
                self.state = load(&mut self.writer, now_ms).await?;
            }
            self.unsaved = true;
            let effects = step(&mut self.state, command, now_ms);
            if !effects.rows.is_empty() || !effects.documents.is_empty() {
                self.save(&effects).await?;
            }
            self.unsaved = false;
            Ok(effects.reply)
        }
        .boxed()
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

async fn save_row(db: &mut SqliteConnection, state: &State, row: &Row) -> Result<(), StoreError> {
    match row {
        Row::Job(id) => save_job(db, job_of(state, id)?).await,
        Row::Shard(id, number) => {
            let shard = job_of(state, id)?.shards.get(*number as usize);
            save_shard(db, id, *number, shard.ok_or_else(|| gone("shard"))?).await
        }
        Row::Artifact(key) => {
            save_artifact(db, state.artifacts.get(key).ok_or_else(|| gone("artifact"))?).await
        }
        Row::Chunk(id, frame, tile) => {
            let chunk = job_of(state, id)?.chunks.get(&(*frame, *tile));
            save_chunk(db, id, *frame, *tile, chunk.ok_or_else(|| gone("chunk"))?).await
        }
        Row::Request(request) => {
            let (job, body) = state.requests.get(request).ok_or_else(|| gone("request"))?;
            sqlx::query("INSERT INTO requests (id, job, body) VALUES (?, ?, ?)")
                .bind(request.clone())
                .bind(job.clone())
                .bind(body.clone())
                .execute(db)
                .await?;
            Ok(())
        }
    }
}

fn job_of<'a>(state: &'a State, id: &str) -> Result<&'a Job, StoreError> {
    state.jobs.get(id).ok_or_else(|| gone("job"))
}

fn gone(what: &str) -> StoreError {
    StoreError::Row(format!("a changed {what} is gone"))
}

async fn save_job(db: &mut SqliteConnection, job: &Job) -> Result<(), StoreError> {
    let updated = sqlx::query(
        "UPDATE jobs SET state = ?, finished_ms = ?, error = ?, result_digest = ?, version = ?, pass_us = ? WHERE id = ?",
    )
    .bind(number_of(&JobState::ALL, &job.state))
    .bind(job.finished_ms.map(signed))
    .bind(job.error.clone())
    .bind(job.result_digest.clone())
    .bind(signed(job.version))
    .bind(signed(job.pass_us))
    .bind(job.id.clone())
    .execute(&mut *db)
    .await?;
    if updated.rows_affected() > 0 {
        return Ok(());
    }
    sqlx::query(
        "INSERT INTO jobs (id, number, state, experiment_digest, created_ms, finished_ms, frames, artifacts, tiles, error,
         result_digest, version, pass_us, shard_us) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(job.id.clone())
    .bind(signed(job.number))
    .bind(number_of(&JobState::ALL, &job.state))
    .bind(job.experiment_digest.clone())
    .bind(signed(job.created_ms))
    .bind(job.finished_ms.map(signed))
    .bind(job.frames)
    .bind(json(&job.artifacts)?)
    .bind(json(&job.tiles)?)
    .bind(job.error.clone())
    .bind(job.result_digest.clone())
    .bind(signed(job.version))
    .bind(signed(job.pass_us))
    .bind(signed(job.shard_us))
    .execute(db)
    .await?;
    Ok(())
}

async fn save_shard(
    db: &mut SqliteConnection,
    job: &str,
    number: u32,
    shard: &Shard,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO shards (job, number, first_frame, frame_count, tile, phase, fence, worker, local, failures, losses)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (job, number) DO UPDATE SET phase = excluded.phase,
         fence = excluded.fence, worker = excluded.worker, local = excluded.local, failures = excluded.failures,
         losses = excluded.losses",
    )
    .bind(job.to_owned())
    .bind(number)
    .bind(shard.first_frame)
    .bind(shard.frame_count)
    .bind(shard.tile)
    .bind(number_of(&Phase::ALL, &shard.lease.phase))
    .bind(signed(shard.lease.fence))
    .bind(shard.lease.worker.clone())
    .bind(shard.lease.local)
    .bind(shard.lease.failures)
    .bind(shard.lease.losses)
    .execute(db)
    .await?;
    Ok(())
}

async fn save_artifact(db: &mut SqliteConnection, artifact: &Artifact) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO artifacts (key, kind, inputs, digest, cones, predicted_us, phase, fence, worker, local, failures, losses)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET digest = excluded.digest,
         cones = excluded.cones, phase = excluded.phase, fence = excluded.fence, worker = excluded.worker,
         local = excluded.local, failures = excluded.failures, losses = excluded.losses",
    )
    .bind(artifact.key.clone())
    .bind(artifact.kind.clone())
    .bind(json(&artifact.inputs)?)
    .bind(artifact.digest.map(|digest| digest.to_string()))
    .bind(artifact.cones.map(signed))
    .bind(signed(artifact.predicted_us))
    .bind(number_of(&Phase::ALL, &artifact.lease.phase))
    .bind(signed(artifact.lease.fence))
    .bind(artifact.lease.worker.clone())
    .bind(artifact.lease.local)
    .bind(artifact.lease.failures)
    .bind(artifact.lease.losses)
    .execute(db)
    .await?;
    Ok(())
}

async fn save_chunk(
    db: &mut SqliteConnection,
    job: &str,
    frame: u32,
    tile: u32,
    chunk: &Chunk,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO chunks (job, frame, tile, seq, digest, first_cone, cones, summary) VALUES (?, ?, ?, ?, ?, ?, ?, ?)
         ON CONFLICT (job, frame, tile) DO UPDATE SET digest = excluded.digest, summary = excluded.summary",
    )
    .bind(job.to_owned())
    .bind(frame)
    .bind(tile)
    .bind(signed(chunk.seq))
    .bind(chunk.digest.to_string())
    .bind(signed(chunk.first_cone))
    .bind(signed(chunk.cones))
    .bind(json(&chunk.summary)?)
    .execute(db)
    .await?;
    Ok(())
}

/// Reads everything back.
async fn load(db: &mut SqliteConnection, now_ms: u64) -> Result<State, StoreError> {
    let mut state = State::default();
    for row in sqlx::query("SELECT * FROM jobs").fetch_all(&mut *db).await? {
        let job = job_from(&row)?;
        state.jobs.insert(job.id.clone(), job);
    }
    for row in sqlx::query("SELECT * FROM shards ORDER BY job, number").fetch_all(&mut *db).await? {
        let job = state.jobs.get_mut(row.try_get::<&str, _>("job")?).ok_or_else(|| gone("job"))?;
        job.shards.push(Shard {
            first_frame: row.try_get("first_frame")?,
            frame_count: row.try_get("frame_count")?,
            tile: row.try_get("tile")?,
            lease: lease_from(&row)?,
        });
    }
    for row in sqlx::query("SELECT * FROM chunks").fetch_all(&mut *db).await? {
        let job = state.jobs.get_mut(row.try_get::<&str, _>("job")?).ok_or_else(|| gone("job"))?;
        let chunk = Chunk {
            seq: unsigned(&row, "seq")?,
            digest: digest_from(row.try_get("digest")?)?,
            first_cone: unsigned(&row, "first_cone")?,
            cones: unsigned(&row, "cones")?,
            summary: from_json(&row, "summary")?,
        };
        job.chunks.insert((row.try_get("frame")?, row.try_get("tile")?), chunk);
    }
    for row in sqlx::query("SELECT * FROM artifacts").fetch_all(&mut *db).await? {
        let artifact = artifact_from(&row)?;
        state.artifacts.insert(artifact.key.clone(), artifact);
    }
    for row in sqlx::query("SELECT * FROM requests").fetch_all(&mut *db).await? {
        state.requests.insert(row.try_get("id")?, (row.try_get("job")?, row.try_get("body")?));
    }
    state.index(now_ms);
    Ok(state)
}

fn job_from(row: &SqliteRow) -> Result<Job, StoreError> {
    Ok(Job {
        id: row.try_get("id")?,
        number: unsigned(row, "number")?,
        state: of_number(&JobState::ALL, row, "state")?,
        experiment_digest: row.try_get("experiment_digest")?,
        created_ms: unsigned(row, "created_ms")?,
        finished_ms: row.try_get::<Option<i64>, _>("finished_ms")?.map(|ms| ms as u64),
        frames: row.try_get("frames")?,
        artifacts: from_json(row, "artifacts")?,
        tiles: from_json(row, "tiles")?,
        error: row.try_get("error")?,
        result_digest: row.try_get("result_digest")?,
        version: unsigned(row, "version")?,
        pass_us: unsigned(row, "pass_us")?,
        shard_us: unsigned(row, "shard_us")?,
        ..Job::default()
    })
}

fn artifact_from(row: &SqliteRow) -> Result<Artifact, StoreError> {
    let digest: Option<&str> = row.try_get("digest")?;
    Ok(Artifact {
        key: row.try_get("key")?,
        kind: row.try_get("kind")?,
        inputs: from_json(row, "inputs")?,
        digest: digest.map(digest_from).transpose()?,
        cones: row.try_get::<Option<i64>, _>("cones")?.map(|cones| cones as u64),
        predicted_us: unsigned(row, "predicted_us")?,
        lease: lease_from(row)?,
    })
}

fn lease_from(row: &SqliteRow) -> Result<Lease, StoreError> {
    Ok(Lease {
        phase: of_number(&Phase::ALL, row, "phase")?,
        fence: unsigned(row, "fence")?,
        worker: row.try_get("worker")?,
        local: row.try_get("local")?,
        expires_ms: 0,
        failures: row.try_get("failures")?,
        losses: row.try_get("losses")?,
    })
}

fn digest_from(text: &str) -> Result<BlobDigest, StoreError> {
    BlobDigest::from_str(text).map_err(|error| StoreError::Row(error.to_string()))
}

/// SQLite's integers are signed; the same 64 bits.
fn signed(value: u64) -> i64 {
    value as i64
}

fn unsigned(row: &SqliteRow, column: &str) -> Result<u64, StoreError> {
    Ok(row.try_get::<i64, _>(column)? as u64)
}

fn number_of<T: PartialEq>(all: &[T], value: &T) -> i64 {
    all.iter().position(|one| one == value).unwrap_or_default() as i64
}

fn of_number<T: Copy>(all: &[T], row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    let number: u32 = row.try_get(column)?;
    let value = all.get(number as usize).copied();
    value.ok_or_else(|| StoreError::Row(format!("{column} is {number}")))
}

fn json<T: serde::Serialize>(value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::Row(error.to_string()))
}

fn from_json<T: serde::de::DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    serde_json::from_str(row.try_get(column)?).map_err(|error| StoreError::Row(format!("{column}: {error}")))
}
