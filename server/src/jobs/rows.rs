//! The machine's rows in SQLite: how each is written and read.

use std::str::FromStr as _;

use photoneye_store::BlobDigest;
use sqlx::Row as _;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::command::{Record, Row};
use super::lease::{Lease, Phase};
use super::state::{Artifact, Chunk, Job, JobState, Shard, State};
use super::store::StoreError;

/// Writes a row as the state has it now.
pub(super) async fn save_row(db: &mut SqliteConnection, state: &State, row: &Row) -> Result<(), StoreError> {
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

/// A row names something that is not there.
pub(super) fn gone(what: &str) -> StoreError {
    StoreError::Row(format!("a changed {what} is gone"))
}

async fn save_job(db: &mut SqliteConnection, job: &Job) -> Result<(), StoreError> {
    let updated = sqlx::query(
        "UPDATE jobs SET state = ?, finished_ms = ?, error = ?, result_digest = ?, version = ?, pass_us = ?, cones = ?
         WHERE id = ?",
    )
    .bind(number_of(&JobState::ALL, &job.state))
    .bind(job.finished_ms.map(signed))
    .bind(job.error.clone())
    .bind(job.result_digest.clone())
    .bind(signed(job.version))
    .bind(signed(job.pass_us))
    .bind(job.cones.map(signed))
    .bind(job.id.clone())
    .execute(&mut *db)
    .await?;
    if updated.rows_affected() > 0 {
        return Ok(());
    }
    sqlx::query(
        "INSERT INTO jobs (id, number, state, experiment_digest, created_ms, finished_ms, frames, artifacts, tiles, error,
         result_digest, version, pass_us, shard_us, tenant, priority, shard_count)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
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
    .bind(job.tenant.clone())
    .bind(job.priority)
    .bind(job.shard_count)
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
        "INSERT INTO artifacts (key, kind, inputs, digest, cones, predicted_us, phase, fence, worker, local, failures, losses,
         previous) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET digest = excluded.digest,
         previous = excluded.previous,
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
    .bind(artifact.previous.map(|digest| digest.to_string()))
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

/// Writes a record.
pub(super) async fn save_record(
    db: &mut SqliteConnection,
    record: &Record,
    now_ms: u64,
) -> Result<(), StoreError> {
    let query = match record {
        Record::Audit { tenant, who, action, object } => {
            sqlx::query("INSERT INTO audit (at_ms, tenant, who, action, object) VALUES (?, ?, ?, ?, ?)")
                .bind(signed(now_ms))
                .bind(tenant.clone())
                .bind(who.clone())
                .bind(*action)
                .bind(object.clone())
        }
        Record::Upload { tenant, digest } => {
            sqlx::query("INSERT OR IGNORE INTO uploads (at_ms, tenant, digest) VALUES (?, ?, ?)")
                .bind(signed(now_ms))
                .bind(tenant.clone())
                .bind(digest.to_string())
        }
        Record::Alarm { work, first, second } => {
            sqlx::query("INSERT INTO alarms (at_ms, work, first, second) VALUES (?, ?, ?, ?)")
                .bind(signed(now_ms))
                .bind(work.clone())
                .bind(first.to_string())
                .bind(second.to_string())
        }
    };
    query.execute(db).await?;
    Ok(())
}

/// A shard.
pub(super) fn shard_from(row: &SqliteRow) -> Result<Shard, StoreError> {
    Ok(Shard {
        first_frame: row.try_get("first_frame")?,
        frame_count: row.try_get("frame_count")?,
        tile: row.try_get("tile")?,
        lease: lease_from(row)?,
    })
}

/// A result's place and what is known of it.
pub(super) fn chunk_from(row: &SqliteRow) -> Result<((u32, u32), Chunk), StoreError> {
    let chunk = Chunk {
        seq: unsigned(row, "seq")?,
        digest: digest_from(row.try_get("digest")?)?,
        first_cone: unsigned(row, "first_cone")?,
        cones: unsigned(row, "cones")?,
        summary: from_json(row, "summary")?,
    };
    Ok(((row.try_get("frame")?, row.try_get("tile")?), chunk))
}

/// A job without its shards and chunks.
pub(super) fn job_from(row: &SqliteRow) -> Result<Job, StoreError> {
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
        tenant: row.try_get("tenant")?,
        priority: row.try_get("priority")?,
        shard_count: row.try_get("shard_count")?,
        cones: row.try_get::<Option<i64>, _>("cones")?.map(|cones| cones as u64),
        ..Job::default()
    })
}

/// An artifact.
pub(super) fn artifact_from(row: &SqliteRow) -> Result<Artifact, StoreError> {
    let digest: Option<&str> = row.try_get("digest")?;
    let previous: Option<&str> = row.try_get("previous")?;
    Ok(Artifact {
        key: row.try_get("key")?,
        kind: row.try_get("kind")?,
        inputs: from_json(row, "inputs")?,
        digest: digest.map(digest_from).transpose()?,
        previous: previous.map(digest_from).transpose()?,
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
