//! What SQLite keeps: readers beside the writer, restarts with another idea of the time, and the deletion of what is over.

use photoneye_server::jobs::clock::Clock;
use photoneye_server::jobs::sqlite::SqliteStore;
use photoneye_server::jobs::{Command, JobState, JobStore, Machine, Reply, Sweep, Text, lease};

use crate::common::{HOUR_MS, commit, create, job, take};

/// The readers' copy says what the database says, for jobs at hand, forgotten ones, and one that came back to work.
#[tokio::test]
async fn readers_see_what_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.db");
    let store = SqliteStore::open(&file, 0).await.unwrap().keep(1);
    let machine = Machine::new(store, Clock::new());
    let work = async || {
        while let Reply::Leased(Some((id, fence))) = machine.execute(take("w")).await.unwrap() {
            let command = machine.read(|state| commit(state, id, fence, 0));
            assert_eq!(machine.execute(command).await.unwrap(), Reply::Held(true));
        }
    };
    let ids: Vec<String> = (0..8).map(|number| format!("job {number}")).collect();
    for id in &ids {
        machine.execute(create(id)).await.unwrap();
        if id == "job 5" {
            machine.execute(take("gone")).await.unwrap();
            machine.execute(Command::Cancel(id.clone())).await.unwrap();
        }
        work().await;
    }
    assert!(machine.read(|state| !state.jobs.contains_key("job 0")), "forgotten");
    // Read before, so that the readers remember it as it was.
    let lost = || machine.read_job("job 0", |state| state.jobs["job 0"].state);
    assert_eq!(lost().await.unwrap(), JobState::Succeeded);
    machine.execute(Command::LostChunk("job 0".into(), 3, 1)).await.unwrap();
    assert_eq!(lost().await.unwrap(), JobState::Running);
    work().await;
    machine.execute(create("at work")).await.unwrap();
    machine.execute(take("w")).await.unwrap();

    let mut stored = SqliteStore::open(&file, 0).await.unwrap();
    for id in ids.iter().map(String::as_str).chain(["at work"]) {
        stored.recall_job(id).await.unwrap();
        let read = machine.read_job(id, |state| state.jobs[id].clone()).await.unwrap();
        let [read, stored] = [read, stored.state().jobs[id].clone()].map(|mut job| {
            job.open.retain(|_, shards| !shards.is_empty());
            job.shards.iter_mut().for_each(|shard| shard.lease.expires_ms = 0);
            job
        });
        assert_eq!(read, stored);
    }
    assert!(machine.read_job("no such job", |state| state.jobs.is_empty()).await.unwrap());
}

/// The clock of a server that was away is an hour behind or before: who holds a lease keeps it, who vanished loses it after one
/// term, and nothing is doubled.
#[tokio::test]
async fn a_clock_that_jumps_moves_no_lease() {
    for jump in [-HOUR_MS, HOUR_MS] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("jobs.db");
        let before = 1000 * HOUR_MS as u64;
        let mut store = SqliteStore::open(&file, before).await.unwrap();
        store.execute(create("a"), before).await.unwrap();
        let mut leases = Vec::new();
        for worker in ["stays", "vanishes"] {
            let Reply::Leased(Some(lease)) = store.execute(take(worker), before).await.unwrap() else {
                panic!()
            };
            leases.push(lease);
        }
        drop(store);
        let after = before.saturating_add_signed(jump);
        let mut store = SqliteStore::open(&file, after).await.unwrap();
        store.execute(Command::Reap, after + lease::TTL_MS - 1).await.unwrap();
        let (id, fence) = leases[0].clone();
        let command = commit(store.state(), id, fence, 0);
        assert_eq!(store.execute(command.clone(), after).await.unwrap(), Reply::Held(true), "{jump}");
        assert_eq!(store.execute(command, after).await.unwrap(), Reply::Held(false), "{jump}: twice");
        store.execute(Command::Reap, after + lease::TTL_MS).await.unwrap();
        let (id, fence) = leases[1].clone();
        let command = commit(store.state(), id, fence, 0);
        assert_eq!(store.execute(command, after).await.unwrap(), Reply::Held(false), "{jump}");
        while let Reply::Leased(Some((id, fence))) = store.execute(take("w"), after).await.unwrap() {
            let command = commit(store.state(), id, fence, 0);
            store.execute(command, after).await.unwrap();
        }
        let job = &store.state().jobs["a"];
        assert_eq!((job.state, job.chunks.len()), (JobState::Succeeded, 8));
    }
}

/// Tables do not grow without bound: what belongs to jobs that are over goes with them, the rest stays.
#[tokio::test]
async fn what_is_over_for_long_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.db");
    let mut store = SqliteStore::open(&file, 0).await.unwrap().keep(2);
    for number in 0..20_u64 {
        let mut new = job(&format!("job {number}"), Some((format!("request {number}"), "body".into())));
        new.experiment = Text::of(format!("experiment {number}"));
        new.artifacts[3].key = format!("kernel {number}");
        new.tiles.iter_mut().for_each(|tile| tile[1] = format!("kernel {number}"));
        store.execute(Command::Create(Box::new(new)), 1000 * number).await.unwrap();
        while let Reply::Leased(Some((id, fence))) = store.execute(take("w"), 1000 * number).await.unwrap() {
            let command = commit(store.state(), id, fence, 0);
            store.execute(command, 1000 * number).await.unwrap();
        }
    }
    store.execute(create("at work"), 0).await.unwrap();
    let mut db = photoneye_server::jobs::sqlite::connect(&file).await.unwrap();
    let mut counts = async || -> Vec<i64> {
        let mut counts = Vec::new();
        for query in [
            "SELECT count(*) FROM jobs",
            "SELECT count(*) FROM shards",
            "SELECT count(*) FROM chunks",
            "SELECT count(*) FROM requests",
            "SELECT count(*) FROM artifacts",
            "SELECT count(*) FROM audit",
            "SELECT count(*) FROM documents",
        ] {
            counts.push(sqlx::query_scalar(query).fetch_one(&mut db).await.unwrap());
        }
        counts
    };
    // Per job four shards of two chunks, a kernel, an experiment and five reports; mosaic and cones belong to
    // all, and one text is the plan of all and the last one's experiment.
    let shared = |jobs: i64| 3 + 3 + 1 + jobs * (1 + 1 + 1 + 4) + 1;
    assert_eq!(counts().await, [21, 84, 160, 20, 3 + 20 + 1, 21, shared(20)]);
    let mut sweep = async |before_ms, kept_jobs, kept_audit| {
        let sweep = Command::Sweep(Sweep { before_ms, kept_jobs, kept_audit });
        assert_eq!(store.execute(sweep, 0).await.unwrap(), Reply::Done);
        assert_eq!(store.state().check(), Ok(()));
    };
    sweep(0, u64::MAX, u64::MAX).await;
    assert_eq!(counts().await[0], 21, "nothing is over");
    // By number: of 21 jobs the last 11.
    sweep(0, 11, 15).await;
    assert_eq!(counts().await, [11, 44, 80, 10, 3 + 10 + 1, 15, shared(10)]);
    // By age: those that ended before second 15, and all records are younger.
    sweep(15_000, u64::MAX, u64::MAX).await;
    assert_eq!(counts().await, [6, 24, 40, 5, 3 + 5 + 1, 5, shared(5)]);
    // What is at work stays in any case.
    sweep(u64::MAX / 2, 0, 0).await;
    assert_eq!(counts().await, [1, 4, 0, 0, 4, 0, shared(0)]);
}
