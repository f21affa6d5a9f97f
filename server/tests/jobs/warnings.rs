//! A job that its audit finds above its target says so: judged once, when the last shard is there, over restarts and
//! lost results.

use std::path::Path;

use photoneye_eye::exposure::audit::AuditSample;
use photoneye_eye::report::WorkReport;
use photoneye_server::jobs::sqlite::{SqliteStore, connect};
use photoneye_server::jobs::state::{Goal, WorkId};
use photoneye_server::jobs::{Command, Commit, JobState, JobStore, NewJob, Reply, State, Text};

use crate::common::{commit, job, take};

/// Three cones of each shard of [`job`], each with this relative error.
fn samples(number: u32, error: f64) -> Vec<AuditSample> {
    let sample = |cone: u64| AuditSample {
        frame: number / 2 * 2,
        tile: number % 2,
        cone,
        value: 10.0 * (1.0 + error),
        reference: 10.0,
        probability: 0.1,
        total: 100.0,
    };
    (0..3).map(sample).collect()
}

/// The right commit for a piece of work, with cones that were computed again.
fn audited(state: &State, id: WorkId, fence: u64, error: f64) -> Command {
    let number = if let WorkId::Shard(_, number) = id { number } else { 0 };
    let mut command = commit(state, id, fence, 0);
    if let Command::Commit { commit: Commit::Shard { audit, .. }, report_json, .. } = &mut command {
        *audit = samples(number, error);
        let report = WorkReport { audit: audit.clone(), ..WorkReport::default() };
        *report_json = Some(serde_json::to_string(&report).unwrap());
    }
    command
}

fn judged(id: &str, target: f64) -> Command {
    Command::Create(Box::new(NewJob {
        goal: Some(Goal { target, drawn: false, warnings: Vec::new() }),
        experiment: Text::of(format!("{{\"accuracy_target\":{target}}}")),
        plan: Text::of("{\"engine\":\"EXPECTED\"}"),
        ..job(id, None)
    }))
}

async fn open(file: &Path) -> SqliteStore {
    SqliteStore::open(file, 0).await.unwrap()
}

/// Does some pieces of work; gives how many were there to do.
async fn work(store: &mut SqliteStore, most: usize, error: f64) -> usize {
    for done in 0..most {
        let Reply::Leased(Some((id, fence))) = store.execute(take("w"), 0).await.unwrap() else {
            return done;
        };
        let command = audited(store.state(), id, fence, error);
        assert_eq!(store.execute(command, 0).await.unwrap(), Reply::Held(true));
    }
    most
}

async fn stored(file: &Path, id: &str) -> (JobState, Vec<String>) {
    let mut store = open(file).await;
    store.recall_job(id).await.unwrap();
    let job = &store.state().jobs[id];
    (job.state, job.warnings.clone())
}

#[tokio::test]
async fn a_missed_target_is_said_over_restarts_and_lost_results() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.db");
    let mut store = open(&file).await;
    store.execute(judged("a", 1e-3), 0).await.unwrap();
    // Four artifacts and three of four shards; then the server starts again.
    assert_eq!(work(&mut store, 7, 0.02).await, 7);
    assert!(store.state().jobs["a"].warnings.is_empty());
    drop(store);
    let mut store = open(&file).await;
    assert_eq!(work(&mut store, 9, 0.02).await, 1);
    let said = store.state().jobs["a"].warnings.clone();
    assert_eq!(
        said,
        [
            "accuracy: 12 cones computed again show a relative error of 2.0e-2 (at least 2.0e-2 with 95 % confidence), \
          above accuracy.target 0.001"
        ]
    );
    assert_eq!(stored(&file, "a").await, (JobState::Succeeded, said.clone()));
    let listed = store.documents().jobs(u64::MAX, 10, None).await.unwrap();
    assert_eq!(listed[0].warnings, said);

    // A job that computes lost results again warns of nothing until it has succeeded again.
    store.execute(Command::LostChunk("a".into(), 3, 1), 0).await.unwrap();
    assert_eq!(stored(&file, "a").await, (JobState::Running, vec![]));
    let mut store = open(&file).await;
    assert_eq!(work(&mut store, 9, 0.02).await, 1);
    assert_eq!(stored(&file, "a").await, (JobState::Succeeded, said));
}

#[tokio::test]
async fn no_audit_or_a_kept_target_gives_no_warning() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.db");
    let mut store = open(&file).await;
    store.execute(judged("kept", 0.05), 0).await.unwrap();
    work(&mut store, 99, 0.02).await;
    store.execute(judged("not audited", 1e-3), 0).await.unwrap();
    while let Reply::Leased(Some((id, fence))) = store.execute(take("w"), 0).await.unwrap() {
        let command = commit(store.state(), id, fence, 0);
        store.execute(command, 0).await.unwrap();
    }
    for id in ["kept", "not audited"] {
        assert_eq!(stored(&file, id).await, (JobState::Succeeded, vec![]), "{id}");
    }
}

/// A job that was at work when the server was of an earlier version is judged by what its documents say; what cannot
/// be read is left out.
#[tokio::test]
async fn a_job_from_before_is_judged() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.db");
    let mut store = open(&file).await;
    store.execute(judged("a", 0.0123), 0).await.unwrap();
    store.execute(Command::Create(Box::new(job("no target", None))), 0).await.unwrap();
    assert_eq!(work(&mut store, 7, 0.02).await, 7);
    drop(store);
    let mut db = connect(&file).await.unwrap();
    for query in [
        "ALTER TABLE jobs DROP COLUMN warnings",
        "ALTER TABLE jobs DROP COLUMN goal",
        "ALTER TABLE shards DROP COLUMN audit",
        "DELETE FROM _sqlx_migrations WHERE version = 5",
        "UPDATE documents SET text = '{\"audit\":[{\"other\":1}]}' WHERE id = 'report/s/a/0'",
    ] {
        sqlx::query(query).execute(&mut db).await.unwrap();
    }
    drop(db);
    let mut store = open(&file).await;
    assert_eq!(
        store.state().jobs["a"].goal,
        Some(Goal { target: 0.0123, drawn: false, warnings: Vec::new() })
    );
    assert_eq!(store.state().jobs["no target"].goal, None);
    work(&mut store, 99, 0.02).await;
    let (state, said) = stored(&file, "a").await;
    assert!(state == JobState::Succeeded && said[0].starts_with("accuracy: 9 cones"), "{said:?}");
}
