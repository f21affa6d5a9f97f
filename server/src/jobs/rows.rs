//! The machine's rows in SQLite, as they are read.

use std::str::FromStr as _;

use photoneye_store::BlobDigest;
use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use super::lease::{Lease, Phase};
use super::state::{Artifact, Chunk, Job, JobState, Shard};
use super::store::StoreError;

/// A shard.
pub(super) fn shard_from(row: &SqliteRow) -> Result<Shard, StoreError> {
    Ok(Shard {
        first_frame: row.try_get("first_frame")?,
        frame_count: row.try_get("frame_count")?,
        tile: row.try_get("tile")?,
        lease: lease_from(row)?,
        // What another version wrote in other words is no reason not to start.
        audit: from_json(row, "audit").unwrap_or_else(|error| {
            tracing::warn!(%error, "an audit cannot be read and is left out");
            Vec::new()
        }),
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
        experiment_text: row.try_get("experiment_text")?,
        plan_text: row.try_get("plan_text")?,
        created_ms: unsigned(row, "created_ms")?,
        finished_ms: row.try_get::<Option<i64>, _>("finished_ms")?.map(|ms| ms as u64),
        frames: row.try_get("frames")?,
        artifacts: from_json(row, "artifacts")?,
        tiles: from_json(row, "tiles")?,
        error: row.try_get("error")?,
        warnings: from_json(row, "warnings")?,
        goal: row.try_get::<Option<&str>, _>("goal")?.map(|_| from_json(row, "goal")).transpose()?,
        result_digest: row.try_get("result_digest")?,
        version: unsigned(row, "version")?,
        pass_us: unsigned(row, "pass_us")?,
        shard_us: unsigned(row, "shard_us")?,
        tenant: row.try_get("tenant")?,
        priority: row.try_get("priority")?,
        shard_count: row.try_get("shard_count")?,
        cones: row.try_get::<Option<i64>, _>("cones")?.map(|cones| cones as u64),
        local: row.try_get("local")?,
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
fn unsigned(row: &SqliteRow, column: &str) -> Result<u64, StoreError> {
    Ok(row.try_get::<i64, _>(column)? as u64)
}

fn of_number<T: Copy>(all: &[T], row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    let number: u32 = row.try_get(column)?;
    let value = all.get(number as usize).copied();
    value.ok_or_else(|| StoreError::Row(format!("{column} is {number}")))
}

fn from_json<T: serde::de::DeserializeOwned>(row: &SqliteRow, column: &str) -> Result<T, StoreError> {
    serde_json::from_str(row.try_get(column)?).map_err(|error| StoreError::Row(format!("{column}: {error}")))
}
