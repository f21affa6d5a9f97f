//! What `photoneye doctor` asks about a data folder: the database and the blobs.

use std::path::Path;
use std::time::{Duration, Instant};

use photoneye_store::{Blobs as _, FolderStore};
use sqlx::ConnectOptions as _;

use crate::jobs::sqlite::options;
use crate::jobs::store::StoreError;

/// What the database says about itself.
#[derive(Clone, Debug, Default)]
pub struct Database {
    /// `ok`, or what is damaged.
    pub integrity: String,
    /// The latest time that it knows, ms since 1970.
    pub latest_ms: u64,
    /// Jobs.
    pub jobs: u64,
    /// Work that gave other bytes the second time.
    pub alarms: u64,
    /// API keys that hold.
    pub keys: u64,
}

/// Looks a database over, without changing it.
///
/// # Errors
/// When it cannot be read.
pub async fn database(data: &Path) -> Result<Database, StoreError> {
    let file = data.join("photoneye.db");
    let mut db = options(&file).create_if_missing(false).connect().await?;
    let integrity: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check(5)").fetch_all(&mut db).await?;
    let (jobs, latest, alarms, keys): (i64, Option<i64>, i64, i64) = sqlx::query_as(
        "SELECT (SELECT count(*) FROM jobs), (SELECT max(max(created_ms, coalesce(finished_ms, 0))) FROM jobs),
         (SELECT count(*) FROM alarms), (SELECT count(*) FROM api_keys WHERE revoked_ms IS NULL)",
    )
    .fetch_one(&mut db)
    .await?;
    Ok(Database {
        integrity: integrity.join("; "),
        latest_ms: latest.unwrap_or(0) as u64,
        jobs: jobs as u64,
        alarms: alarms as u64,
        keys: keys as u64,
    })
}

/// What reading blobs found.
#[derive(Clone, Copy, Debug, Default)]
pub struct BlobReport {
    /// Blobs in the folder.
    pub all: u64,
    /// Read and found whole.
    pub whole: u64,
    /// Read and found damaged; set aside, so that they are made again.
    pub damaged: u64,
}

/// Reads blobs, the latest first, until the time is over (`None`: all), and holds them against their digests.
///
/// # Errors
/// When the folder cannot be read.
pub fn blobs(data: &Path, time: Option<Duration>) -> Result<BlobReport, photoneye_store::StoreError> {
    let store = FolderStore::open(data)?;
    let started = Instant::now();
    let mut report = BlobReport::default();
    for digest in store.list().into_iter().rev() {
        report.all += 1;
        if time.is_some_and(|time| started.elapsed() > time) {
            continue;
        }
        match store.open(&digest) {
            Ok(_) => report.whole += 1,
            Err(error) if error.is_absent() => report.damaged += 1,
            Err(error) => return Err(error),
        }
    }
    Ok(report)
}
