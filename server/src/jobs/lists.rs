//! What is read from the database beside the writer: lists, counts, keys, who may read which blob.

use std::collections::BTreeSet;

use serde_json::{Value, json};
use sqlx::Row as _;

use super::recall::list;
use super::rows::job_from;
use super::state::{Job, JobState};
use super::store::{Documents, StoreError};
use crate::access::keys::{Stored, stored};

/// Retinas listed, the latest.
const MOST_RETINAS: u32 = 200;

impl Documents {
    /// Jobs before a number, newest first, of one tenant or of all; without shards, but with the number that is left.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn jobs(&self, before: u64, most: u32, tenant: Option<&str>) -> Result<Vec<Job>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(Vec::new());
        };
        let rows = sqlx::query(
            "SELECT *, (SELECT count(*) FROM shards WHERE job = jobs.id AND phase = 2) AS done FROM jobs
             WHERE number < ?1 AND (?2 IS NULL OR tenant = ?2) ORDER BY number DESC LIMIT ?3",
        )
        .bind(i64::try_from(before).unwrap_or(i64::MAX))
        .bind(tenant.map(str::to_owned))
        .bind(most)
        .fetch_all(pool)
        .await?;
        let with_left = rows.iter().map(|row| {
            let mut job = job_from(row)?;
            let done: u32 = row.try_get("done")?;
            job.left = job.shard_count.saturating_sub(done) as usize;
            Ok(job)
        });
        with_left.collect()
    }

    /// Job and digest of the body that came with a request id.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn request(&self, id: &str) -> Result<Option<(String, String)>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(None);
        };
        let query = sqlx::query_as("SELECT job, body FROM requests WHERE id = ?").bind(id.to_owned());
        Ok(query.fetch_optional(pool).await?)
    }

    /// Number of jobs in each state.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn count_jobs(&self) -> Result<[u64; 5], StoreError> {
        let mut counts = [0; 5];
        if let Self::Sqlite(pool) = self {
            let rows = sqlx::query("SELECT state, count(*) AS count FROM jobs GROUP BY state");
            for row in rows.fetch_all(pool).await? {
                let state: u32 = row.try_get("state")?;
                if let Some(count) = counts.get_mut(state as usize).filter(|_| JobState::ALL.len() == 5) {
                    *count = row.try_get::<i64, _>("count")? as u64;
                }
            }
        }
        Ok(counts)
    }

    /// Which of these artifacts are built.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn built(&self, keys: &[String]) -> Result<BTreeSet<String>, StoreError> {
        let mut built = BTreeSet::new();
        if let Self::Sqlite(pool) = self {
            let query =
                "SELECT key FROM artifacts WHERE phase = 2 AND key IN (SELECT value FROM json_each(?))";
            let keys = serde_json::to_string(keys).map_err(|error| StoreError::Row(error.to_string()))?;
            let found: Vec<String> = sqlx::query_scalar(query).bind(keys).fetch_all(pool).await?;
            built.extend(found);
        }
        Ok(built)
    }

    /// Whether a tenant may read a blob: it uploaded it, it is a result of its jobs, or it is an artifact, which all share.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn may_read(&self, tenant: &str, digest: &str) -> Result<bool, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(true);
        };
        let query = "SELECT EXISTS (SELECT 1 FROM uploads WHERE tenant = ?1 AND digest = ?2)
             OR EXISTS (SELECT 1 FROM artifacts WHERE digest = ?2)
             OR EXISTS (SELECT 1 FROM chunks JOIN jobs ON jobs.id = chunks.job WHERE digest = ?2 AND tenant = ?1)";
        let found: i64 =
            sqlx::query_scalar(query).bind(tenant.to_owned()).bind(digest.to_owned()).fetch_one(pool).await?;
        Ok(found != 0)
    }

    /// Whether anybody uploaded a blob: it cannot be made again.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn uploaded(&self, digest: &str) -> Result<bool, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(true);
        };
        let query = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM uploads WHERE digest = ?)");
        Ok(query.bind(digest.to_owned()).fetch_one(pool).await.map(|found: i64| found != 0)?)
    }

    /// Which of these digests anything names: a result, an artifact, an upload, or an alarm, whose bytes are both kept.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn named(&self, digests: &[String]) -> Result<BTreeSet<String>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(digests.iter().cloned().collect());
        };
        let query = "SELECT value FROM json_each(?) WHERE
             EXISTS (SELECT 1 FROM chunks WHERE digest = value)
             OR EXISTS (SELECT 1 FROM artifacts WHERE digest = value)
             OR EXISTS (SELECT 1 FROM uploads WHERE digest = value)
             OR value IN (SELECT previous FROM artifacts WHERE previous IS NOT NULL)
             OR value IN (SELECT first FROM alarms UNION ALL SELECT second FROM alarms)";
        let found: Vec<String> = sqlx::query_scalar(query).bind(list(digests)?).fetch_all(pool).await?;
        Ok(found.into_iter().collect())
    }

    /// All API keys, revoked ones too.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn keys(&self) -> Result<Vec<Stored>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(Vec::new());
        };
        sqlx::query("SELECT * FROM api_keys").fetch_all(pool).await?.iter().map(stored).collect()
    }

    /// Built retinas: their parameters, figures, and where they come from.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn retinas(&self) -> Result<Vec<Value>, StoreError> {
        let Self::Sqlite(pool) = self else {
            return Ok(Vec::new());
        };
        let rows = sqlx::query(
            "SELECT a.key, a.digest, a.cones, a.worker, a.inputs, spec.text AS spec, report.text AS report,
                    (SELECT tile.text FROM documents AS tile WHERE tile.id = 'artifact/' || (a.inputs ->> 0)) AS tile
             FROM artifacts AS a JOIN documents AS spec ON spec.id = 'artifact/' || a.key
             LEFT JOIN documents AS report ON report.id = 'report/b/' || a.key
             WHERE a.kind = 'cones' AND a.phase = 2 ORDER BY a.key LIMIT ?",
        )
        .bind(MOST_RETINAS)
        .fetch_all(pool)
        .await?;
        let json_of =
            |text: Option<&str>| text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or(Value::Null);
        let retina = |row: &sqlx::sqlite::SqliteRow| {
            let (spec, tile) = (json_of(row.try_get("spec")?), json_of(row.try_get("tile")?));
            let report = json_of(row.try_get("report")?);
            let inside = |spec: &Value, name: &str| {
                spec.as_object()
                    .and_then(|spec| spec.values().next())
                    .map_or(Value::Null, |inner| inner[name].clone())
            };
            let own = inside(&spec, "params");
            let params = if own.is_null() { inside(&tile, "params") } else { own };
            Ok(json!({
                "key": row.try_get::<&str, _>("key")?,
                "digest": row.try_get::<Option<&str>, _>("digest")?,
                "region_um": inside(&spec, "region"),
                "parameters": params,
                "statistics": {
                    "cones": row.try_get::<Option<i64>, _>("cones")?,
                    "cones_by_type": report["cones"],
                    "diagnostics": report["diagnostics"],
                },
                "provenance": {
                    "made_from": json_of(row.try_get("inputs")?),
                    "worker": row.try_get::<&str, _>("worker")?,
                    "seconds": report["seconds"],
                },
            }))
        };
        rows.iter().map(retina).collect()
    }
}
