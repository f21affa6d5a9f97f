//! Reading the state: what is at work when a server starts, and what was forgotten when somebody asks for it.

use std::collections::BTreeSet;

use sqlx::sqlite::SqliteConnection;

use super::command::Command;
use super::lease::Phase;
use super::rows::{artifact_from, chunk_from, job_from, shard_from};
use super::state::{Artifact, Job, State, WorkId};
use super::store::StoreError;

/// What was read again.
#[derive(Clone, Debug, Default)]
pub struct Recalled {
    jobs: Vec<Job>,
    artifacts: Vec<Artifact>,
    /// Id, job, digest of the body.
    requests: Vec<(String, String, String)>,
}

impl State {
    /// Takes in what was read again; what is at hand stays as it is.
    pub fn take_in(&mut self, recalled: Recalled) {
        for job in recalled.jobs {
            self.jobs.entry(job.id.clone()).or_insert(job);
        }
        for artifact in recalled.artifacts {
            self.artifacts.entry(artifact.key.clone()).or_insert(artifact);
        }
        for (id, job, body) in recalled.requests {
            self.requests.entry(id).or_insert((job, body));
        }
    }
}

/// Reads what is at work.
pub(super) async fn load(db: &mut SqliteConnection) -> Result<State, StoreError> {
    let mut state = State::default();
    let last: Option<i64> = sqlx::query_scalar("SELECT max(number) FROM jobs").fetch_one(&mut *db).await?;
    state.next_number = last.map_or(0, |last| last as u64 + 1);
    let alarms: i64 = sqlx::query_scalar("SELECT count(*) FROM alarms").fetch_one(&mut *db).await?;
    state.nondeterministic = alarms as u64;
    // Queued and running.
    let active: Vec<String> =
        sqlx::query_scalar("SELECT id FROM jobs WHERE state IN (0, 1)").fetch_all(&mut *db).await?;
    for id in active {
        let found = job(db, &state, &id).await?;
        state.take_in(found);
    }
    let leased = sqlx::query_scalar("SELECT key FROM artifacts WHERE phase = ?").bind(Phase::Leased as i64);
    let leased: Vec<String> = leased.fetch_all(&mut *db).await?;
    let artifacts = artifacts(db, &state, leased).await?;
    state.take_in(Recalled { artifacts, ..Recalled::default() });
    Ok(state)
}

/// Reads what commands are about and the state has forgotten.
pub(super) async fn commands(
    db: &mut SqliteConnection,
    state: &State,
    commands: &[Command],
) -> Result<Recalled, StoreError> {
    let (mut keys, mut ids, mut jobs) = (Vec::new(), Vec::new(), BTreeSet::<String>::new());
    for command in commands {
        match command {
            Command::Create(new) => {
                let id = new.request.iter().map(|(id, _)| id);
                ids.extend(id.filter(|id| !state.requests.contains_key(*id)));
                keys.extend(new.artifacts.iter().map(|artifact| artifact.key.clone()));
                if new.local {
                    let query = sqlx::query_scalar(
                        "SELECT id FROM jobs WHERE local = 1 AND experiment_digest = ? ORDER BY number DESC LIMIT 1",
                    );
                    jobs.extend(query.bind(new.experiment_digest.clone()).fetch_optional(&mut *db).await?);
                }
            }
            Command::Cancel(job) | Command::LostChunk(job, ..) => {
                jobs.insert(job.clone());
            }
            Command::LostArtifact(key) => keys.push(key.clone()),
            Command::Lease(_)
            | Command::Beat { .. }
            | Command::Commit { .. }
            | Command::Fail { .. }
            | Command::Release { .. }
            | Command::Disown
            | Command::Reap
            | Command::Note(_)
            | Command::Sweep(_) => {}
        }
    }
    let mut recalled = Recalled { artifacts: artifacts(db, state, keys).await?, ..Recalled::default() };
    if !ids.is_empty() {
        let query = "SELECT id, job, body FROM requests WHERE id IN (SELECT value FROM json_each(?))";
        recalled.requests = sqlx::query_as(query).bind(list(&ids)?).fetch_all(&mut *db).await?;
    }
    for id in jobs {
        let found = job(db, state, &id).await?;
        recalled.jobs.extend(found.jobs);
        recalled.artifacts.extend(found.artifacts);
    }
    Ok(recalled)
}

/// Reads a job with its shards, results and artifacts, if it is not at hand.
pub(super) async fn job(db: &mut SqliteConnection, state: &State, id: &str) -> Result<Recalled, StoreError> {
    if state.jobs.contains_key(id) {
        return Ok(Recalled::default());
    }
    let row = sqlx::query("SELECT * FROM jobs WHERE id = ?").bind(id.to_owned());
    let Some(row) = row.fetch_optional(&mut *db).await? else {
        return Ok(Recalled::default());
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
    let artifacts = artifacts(db, state, job.artifacts.clone()).await?;
    Ok(Recalled { jobs: vec![job], artifacts, requests: Vec::new() })
}

/// Reads artifacts and what they are made from, if they are not at hand.
async fn artifacts(
    db: &mut SqliteConnection,
    state: &State,
    mut wanted: Vec<String>,
) -> Result<Vec<Artifact>, StoreError> {
    let mut found: Vec<Artifact> = Vec::new();
    let mut seen = BTreeSet::new();
    loop {
        wanted.retain(|key| !state.knows(&WorkId::Build(key.clone())) && seen.insert(key.clone()));
        if wanted.is_empty() {
            return Ok(found);
        }
        let query = sqlx::query("SELECT * FROM artifacts WHERE key IN (SELECT value FROM json_each(?))");
        let rows = query.bind(list(&wanted)?).fetch_all(&mut *db).await?;
        wanted.clear();
        for row in rows {
            let artifact = artifact_from(&row)?;
            wanted.extend(artifact.inputs.iter().cloned());
            found.push(artifact);
        }
    }
}

/// A list as one parameter.
pub(super) fn list<T: serde::Serialize>(values: &[T]) -> Result<String, StoreError> {
    serde_json::to_string(values).map_err(|error| StoreError::Row(error.to_string()))
}
