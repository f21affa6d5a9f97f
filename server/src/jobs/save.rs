//! What a batch of steps changed, as one statement: a row put into the view of `save.sql`.

use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnection;

use super::command::{Effects, Record, Row};
use super::lease::{Lease, Phase};
use super::state::{Artifact, Chunk, Job, JobState, Shard, State};
use super::store::StoreError;

/// Rows for the columns of the view, in their order.
#[derive(Default)]
struct Tables {
    new_jobs: Vec<Value>,
    jobs: Vec<Value>,
    artifacts: Vec<Value>,
    shards: Vec<Value>,
    chunks: Vec<Value>,
    requests: Vec<Value>,
    documents: Vec<Value>,
    audit: Vec<Value>,
    uploads: Vec<Value>,
    alarms: Vec<Value>,
}

/// Prepares a connection for [`save`].
pub(super) async fn prepare(db: &mut SqliteConnection) -> Result<(), StoreError> {
    sqlx::raw_sql(include_str!("save.sql")).execute(db).await?;
    Ok(())
}

/// Writes rows as the state has them now, all or none.
pub(super) async fn save(
    db: &mut SqliteConnection,
    state: &State,
    effects: &Effects,
    now_ms: u64,
) -> Result<(), StoreError> {
    let mut tables = Tables::default();
    effects.rows.iter().try_for_each(|row| tables.add(state, row))?;
    for (id, text) in &effects.documents {
        tables.documents.push(json!({"id": id, "text": &**text}));
    }
    effects.records.iter().for_each(|record| tables.record(record, now_ms));
    let mut query = sqlx::query("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
    for rows in tables.in_order() {
        let text = serde_json::to_string(&rows).map_err(|error| StoreError::Row(error.to_string()))?;
        query = query.bind(text);
    }
    query.execute(db).await?;
    Ok(())
}

impl Tables {
    fn in_order(self) -> [Vec<Value>; 10] {
        [
            self.new_jobs,
            self.jobs,
            self.artifacts,
            self.shards,
            self.chunks,
            self.requests,
            self.documents,
            self.audit,
            self.uploads,
            self.alarms,
        ]
    }

    fn add(&mut self, state: &State, row: &Row) -> Result<(), StoreError> {
        let job_of = |id: &str| state.jobs.get(id).ok_or_else(|| gone("job"));
        match row {
            Row::NewJob(id) => self.new_jobs.push(new_job(job_of(id)?)?),
            Row::Job(id) => self.jobs.push(job(job_of(id)?)),
            Row::Shard(id, number) => {
                let found = job_of(id)?.shards.get(*number as usize).ok_or_else(|| gone("shard"))?;
                self.shards.push(shard(id, *number, found)?);
            }
            Row::Artifact(key) => {
                let found = state.artifacts.get(key).ok_or_else(|| gone("artifact"))?;
                self.artifacts.push(artifact(found));
            }
            Row::Chunk(id, frame, tile) => {
                let found = job_of(id)?.chunks.get(&(*frame, *tile)).ok_or_else(|| gone("chunk"))?;
                self.chunks.push(chunk(id, *frame, *tile, found)?);
            }
            Row::Request(id) => {
                let (job, body) = state.requests.get(id).ok_or_else(|| gone("request"))?;
                self.requests.push(json!({"id": id, "job": job, "body": body}));
            }
        }
        Ok(())
    }

    fn record(&mut self, record: &Record, now_ms: u64) {
        let at_ms = signed(now_ms);
        let (table, row) = match record {
            Record::Audit { tenant, who, action, object } => (
                &mut self.audit,
                json!({"at_ms": at_ms, "tenant": tenant, "who": who, "action": action, "object": object}),
            ),
            Record::Upload { tenant, digest } => {
                (&mut self.uploads, json!({"at_ms": at_ms, "tenant": tenant, "digest": digest.to_string()}))
            }
            Record::Alarm { work, first, second } => {
                let (first, second) = (first.to_string(), second.to_string());
                (&mut self.alarms, json!({"at_ms": at_ms, "work": work, "first": first, "second": second}))
            }
        };
        table.push(row);
    }
}

fn new_job(job: &Job) -> Result<Value, StoreError> {
    Ok(json!({
        "id": job.id,
        "number": signed(job.number),
        "state": number_of(&JobState::ALL, &job.state),
        "experiment_digest": job.experiment_digest,
        "experiment_text": job.experiment_text,
        "plan_text": job.plan_text,
        "created_ms": signed(job.created_ms),
        "finished_ms": job.finished_ms.map(signed),
        "frames": job.frames,
        "artifacts": job.artifacts,
        "tiles": job.tiles,
        "error": job.error,
        "warnings": job.warnings,
        "goal": job.goal.as_ref().map(text_of).transpose()?,
        "result_digest": job.result_digest,
        "version": signed(job.version),
        "pass_us": signed(job.pass_us),
        "shard_us": signed(job.shard_us),
        "tenant": job.tenant,
        "priority": job.priority,
        "shard_count": job.shard_count,
        "local": job.local,
    }))
}

fn job(job: &Job) -> Value {
    json!({
        "id": job.id,
        "state": number_of(&JobState::ALL, &job.state),
        "created_ms": signed(job.created_ms),
        "finished_ms": job.finished_ms.map(signed),
        "error": job.error,
        "warnings": job.warnings,
        "result_digest": job.result_digest,
        "version": signed(job.version),
        "pass_us": signed(job.pass_us),
        "cones": job.cones.map(signed),
    })
}

fn artifact(artifact: &Artifact) -> Value {
    let row = json!({
        "key": artifact.key,
        "kind": artifact.kind,
        "inputs": artifact.inputs,
        "digest": artifact.digest.map(|digest| digest.to_string()),
        "cones": artifact.cones.map(signed),
        "predicted_us": signed(artifact.predicted_us),
        "previous": artifact.previous.map(|digest| digest.to_string()),
    });
    with_lease(row, &artifact.lease)
}

fn shard(job: &str, number: u32, shard: &Shard) -> Result<Value, StoreError> {
    let row = json!({
        "job": job,
        "number": number,
        "first_frame": shard.first_frame,
        "frame_count": shard.frame_count,
        "tile": shard.tile,
        "audit": text_of(&shard.audit)?,
    });
    Ok(with_lease(row, &shard.lease))
}

fn with_lease(mut row: Value, lease: &Lease) -> Value {
    row["phase"] = number_of(&Phase::ALL, &lease.phase).into();
    row["fence"] = signed(lease.fence).into();
    row["worker"] = lease.worker.as_str().into();
    row["local"] = lease.local.into();
    row["failures"] = lease.failures.into();
    row["losses"] = lease.losses.into();
    row
}

fn chunk(job: &str, frame: u32, tile: u32, chunk: &Chunk) -> Result<Value, StoreError> {
    let summary = text_of(&chunk.summary)?;
    Ok(json!({
        "job": job,
        "frame": frame,
        "tile": tile,
        "seq": signed(chunk.seq),
        "digest": chunk.digest.to_string(),
        "first_cone": signed(chunk.first_cone),
        "cones": signed(chunk.cones),
        "summary": summary,
    }))
}

/// JSON as a text in the text: numbers keep their digits.
fn text_of<T: serde::Serialize>(value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::Row(error.to_string()))
}

/// A row names something that is not there.
fn gone(what: &str) -> StoreError {
    StoreError::Row(format!("a changed {what} is gone"))
}

/// SQLite's integers are signed; the same 64 bits.
fn signed(value: u64) -> i64 {
    value as i64
}

fn number_of<T: PartialEq>(all: &[T], value: &T) -> i64 {
    all.iter().position(|one| one == value).unwrap_or_default() as i64
}
