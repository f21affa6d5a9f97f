//! Deletes what is over for long: jobs with their shards, results and requests, texts and artifacts that no job left needs, and
//! records. Blobs are the janitor's.

use sqlx::Connection as _;
use sqlx::sqlite::SqliteConnection;

use super::command::Sweep;
use super::recall::list;
use super::state::State;
use super::store::StoreError;

/// Jobs deleted at once, at most: others wait meanwhile.
const MOST: u32 = 10_000;

/// Jobs with everything that is theirs; the parameter is a list of their ids.
const OF_JOBS: [&str; 5] = [
    "DELETE FROM documents WHERE id IN (SELECT 'report/s/' || job || '/' || number FROM shards
     WHERE job IN (SELECT value FROM json_each(?)))",
    "DELETE FROM requests WHERE job IN (SELECT value FROM json_each(?))",
    "DELETE FROM chunks WHERE job IN (SELECT value FROM json_each(?))",
    "DELETE FROM shards WHERE job IN (SELECT value FROM json_each(?))",
    "DELETE FROM jobs WHERE id IN (SELECT value FROM json_each(?))",
];

/// Artifacts with everything that is theirs; the parameter is a list of their keys.
const OF_ARTIFACTS: [&str; 2] = [
    "DELETE FROM documents WHERE id IN (SELECT 'artifact/' || value FROM json_each(?1)
     UNION ALL SELECT 'report/b/' || value FROM json_each(?1))",
    "DELETE FROM artifacts WHERE key IN (SELECT value FROM json_each(?))",
];

/// Deletes; the state says what is at hand and has to stay.
pub(super) async fn sweep(db: &mut SqliteConnection, state: &State, what: &Sweep) -> Result<(), StoreError> {
    let mut transaction = db.begin_with("BEGIN IMMEDIATE").await?;
    let jobs: Vec<(String, String, String)> = sqlx::query_as(
        "SELECT id, experiment_text, plan_text FROM jobs
         WHERE state > 1 AND number < ? AND (finished_ms < ? OR number < ?) ORDER BY number LIMIT ?",
    )
    .bind(signed(state.next_number.saturating_sub(1)))
    .bind(signed(what.before_ms))
    .bind(signed(state.next_number.saturating_sub(what.kept_jobs)))
    .bind(MOST)
    .fetch_all(&mut *transaction)
    .await?;
    let ids: Vec<&String> = jobs.iter().map(|(id, ..)| id).collect();
    let texts: Vec<&String> = jobs.iter().flat_map(|(_, experiment, plan)| [experiment, plan]).collect();
    for query in OF_JOBS {
        sqlx::query(query).bind(list(&ids)?).execute(&mut *transaction).await?;
    }
    sqlx::query(
        "DELETE FROM documents WHERE id IN (SELECT value FROM json_each(?))
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE experiment_text = documents.id)
         AND NOT EXISTS (SELECT 1 FROM jobs WHERE plan_text = documents.id)",
    )
    .bind(list(&texts)?)
    .execute(&mut *transaction)
    .await?;
    let unused: Vec<String> = sqlx::query_scalar(
        "SELECT key FROM artifacts WHERE key NOT IN (SELECT value FROM jobs, json_each(jobs.artifacts))",
    )
    .fetch_all(&mut *transaction)
    .await?;
    let unused: Vec<&String> = unused.iter().filter(|key| !state.artifacts.contains_key(*key)).collect();
    for query in OF_ARTIFACTS {
        sqlx::query(query).bind(list(&unused)?).execute(&mut *transaction).await?;
    }
    sqlx::query("DELETE FROM audit WHERE at_ms < ? OR id <= (SELECT max(id) FROM audit) - ?")
        .bind(signed(what.before_ms))
        .bind(signed(what.kept_audit))
        .execute(&mut *transaction)
        .await?;
    transaction.commit().await?;
    if !jobs.is_empty() {
        tracing::info!(jobs = jobs.len(), artifacts = unused.len(), "deleted what is over for long");
    }
    Ok(())
}

/// As much as SQLite can hold.
fn signed(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}
