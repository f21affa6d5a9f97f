//! The job machine: whatever happens, in memory and in SQLite the same, and only the holder of a lease writes.

use std::collections::BTreeSet;

use photoneye_server::jobs::clock::Clock;
use photoneye_server::jobs::memory::MemoryStore;
use photoneye_server::jobs::sqlite::SqliteStore;
use photoneye_server::jobs::state::{Summary, WorkId};
use photoneye_server::jobs::{
    Command, Commit, JobState, JobStore, Machine, NewArtifact, NewJob, Phase, Record, Reply, State, Sweep,
    Text, lease, step,
};
use photoneye_store::BlobDigest;
use proptest::prelude::*;

/// A job: two tiles whose cones are both made from one mosaic tile, one kernel, two shards a tile.
fn job(id: &str, request: Option<(String, String)>) -> NewJob {
    let artifact = |key: &str, inputs: &[&str]| NewArtifact {
        key: key.into(),
        kind: "kind".into(),
        spec_json: "{}".into(),
        inputs: inputs.iter().map(ToString::to_string).collect(),
        predicted_us: 1000,
    };
    NewJob {
        id: id.into(),
        experiment_digest: "e".into(),
        experiment: Text::of("{}"),
        plan: Text::of("{}"),
        frames: 4,
        artifacts: vec![
            artifact("mosaic", &[]),
            artifact("cones0", &["mosaic"]),
            artifact("cones1", &["mosaic"]),
            artifact("kernel", &[]),
        ],
        tiles: vec![vec!["cones0".into(), "kernel".into()], vec!["cones1".into(), "kernel".into()]],
        shards: vec![(0, 2, 0), (0, 2, 1), (2, 2, 0), (2, 2, 1)],
        shard_us: 500,
        request,
        tenant: "local".into(),
        priority: 5,
        by: "test".into(),
    }
}

fn create(id: &str) -> Command {
    Command::Create(Box::new(job(id, None)))
}

fn take(worker: &str) -> Command {
    Command::Lease { most: usize::MAX, worker: worker.into(), local: false, holds: BTreeSet::new() }
}

/// The right commit for a piece of work; `salt` stands for what the computation gave.
fn commit(state: &State, id: WorkId, fence: u64, salt: u32) -> Command {
    let commit = match &id {
        WorkId::Build(key) => Commit::Artifact { digest: BlobDigest::of(key.as_bytes()), cones: Some(10) },
        WorkId::Shard(job, number) => {
            let shard = &state.jobs[job].shards[*number as usize];
            let frames = shard.first_frame..shard.first_frame + shard.frame_count;
            let digest = |frame| BlobDigest::of(format!("{frame} {} {salt}", shard.tile).as_bytes());
            Commit::Shard(frames.map(|frame| (frame, digest(frame), Summary::default())).collect())
        }
    };
    Command::Commit { id, fence, commit, report_json: Some("{}".into()) }
}

/// Runs everything that there is to do.
fn drain(state: &mut State) -> usize {
    for done in 0.. {
        let Reply::Leased(Some((id, fence))) = step(state, take("w"), 0).0 else {
            return done;
        };
        let command = commit(state, id, fence, 0);
        assert_eq!(step(state, command, 0).0, Reply::Held(true));
    }
    unreachable!()
}

#[test]
fn a_job_runs_to_its_end_and_shares_its_artifacts() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    step(&mut state, create("b"), 0);
    assert_eq!(drain(&mut state), 4 + 4 + 4);
    let (a, b) = (&state.jobs["a"], &state.jobs["b"]);
    assert_eq!((a.state, b.state), (JobState::Succeeded, JobState::Succeeded));
    assert_eq!(a.result_digest, b.result_digest);
    let mut numbers: Vec<u64> = a.chunks.values().map(|chunk| chunk.seq).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, (1..=8).collect::<Vec<_>>());
    assert_eq!(a.chunks[&(0, 1)].first_cone, 10);
    assert_eq!(state.first_cones(a), (vec![0, 10], Some(20)));
}

#[test]
fn a_superseded_lease_cannot_commit() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    let Reply::Leased(Some((id, old))) = step(&mut state, take("w"), 0).0 else { panic!() };
    step(&mut state, Command::Reap, lease::TTL_MS);
    let Reply::Leased(Some((again, new))) = step(&mut state, take("w"), lease::TTL_MS).0 else { panic!() };
    assert_eq!(again, id);
    let late = commit(&state, id.clone(), old, 1);
    assert_eq!(step(&mut state, late, lease::TTL_MS).0, Reply::Held(false));
    assert!(!state.ready("kernel") && !state.ready("mosaic"));
    let right = commit(&state, id, new, 0);
    assert_eq!(step(&mut state, right, lease::TTL_MS).0, Reply::Held(true));
}

#[test]
fn a_deterministic_failure_ends_every_job_that_needs_the_work() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    step(&mut state, create("b"), 0);
    let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
    let fail = Command::Fail { id, fence, message: "no such eye".into(), deterministic: true };
    step(&mut state, fail, 5);
    for job in state.jobs.values() {
        assert_eq!(job.state, JobState::Failed);
        assert_eq!(job.error.as_deref(), Some("building kind: no such eye"));
    }
    assert_eq!(step(&mut state, take("w"), 5).0, Reply::Leased(None));
    // The next job tries again.
    step(&mut state, create("c"), 6);
    assert_eq!(drain(&mut state), 8);
    assert_eq!(state.jobs["c"].state, JobState::Succeeded);
}

#[test]
fn a_cancelled_job_gives_its_work_back() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
    assert_eq!(step(&mut state, Command::Cancel("a".into()), 1).0, Reply::Done);
    assert_eq!(step(&mut state, Command::Cancel("x".into()), 1).0, Reply::NoSuchJob);
    let beat = Command::Beat { id: id.clone(), fence, stage: String::new() };
    assert_eq!(step(&mut state, beat, 2).0, Reply::Held(false));
    assert_eq!(step(&mut state, take("w"), 2).0, Reply::Leased(None));
    assert!(state.jobs["a"].shards.iter().all(|shard| shard.lease.phase == Phase::Cancelled));
}

#[test]
fn lost_bytes_are_made_again() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    drain(&mut state);
    let before = state.jobs["a"].clone();
    step(&mut state, Command::LostChunk("a".into(), 3, 1), 1);
    step(&mut state, Command::LostArtifact("kernel".into()), 1);
    assert_eq!(state.jobs["a"].state, JobState::Running);
    assert_eq!(drain(&mut state), 2);
    let after = &state.jobs["a"];
    assert_eq!((&after.chunks, &after.result_digest), (&before.chunks, &before.result_digest));
    assert_eq!(state.nondeterministic, 0);
    // Without a job that needs it, an artifact is made again when somebody asks.
    step(&mut state, Command::LostArtifact("cones1".into()), 2);
    assert_eq!(drain(&mut state), 1);
    assert!(state.ready("cones1"));
}

#[test]
fn another_result_for_the_same_work_raises_the_alarm() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    drain(&mut state);
    step(&mut state, Command::LostChunk("a".into(), 0, 0), 1);
    let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 1).0 else { panic!() };
    let other = commit(&state, id, fence, 1);
    step(&mut state, other, 1);
    assert_eq!(state.nondeterministic, 2);
}

#[test]
fn a_short_job_does_not_wait_for_a_long_one() {
    let mut state = State::default();
    let mut long = job("long", None);
    long.shards = (0..1000).map(|i| (2 * i, 2, 0)).collect();
    step(&mut state, Command::Create(Box::new(long)), 0);
    for _ in 0..50 {
        let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
        let command = commit(&state, id, fence, 0);
        step(&mut state, command, 0);
    }
    step(&mut state, create("short"), 0);
    for _ in 0..12 {
        let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
        let command = commit(&state, id, fence, 0);
        step(&mut state, command, 0);
    }
    assert_eq!(state.jobs["short"].state, JobState::Succeeded);
}

#[test]
fn tenants_share_and_priority_counts_inside_one_only() {
    let mut state = State::default();
    let mut new = |id: &str, tenant: &str, priority: u8, shards: u32| {
        let mut job = job(id, None);
        job.shards = (0..shards).map(|i| (2 * i, 2, 0)).collect();
        (job.tenant, job.priority) = (tenant.into(), priority);
        step(&mut state, Command::Create(Box::new(job)), 0);
    };
    // One tenant floods, with the highest priority; the other has two small jobs.
    for number in 0..20 {
        new(&format!("flood {number}"), "loud", 9, 100);
    }
    new("low", "quiet", 1, 10);
    new("high", "quiet", 2, 10);
    let mut order = Vec::new();
    for _ in 0..60 {
        let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
        if let WorkId::Shard(job, _) = &id {
            order.push(job.clone());
        }
        let command = commit(&state, id, fence, 0);
        step(&mut state, command, 0);
    }
    let quiet: Vec<&String> = order.iter().take(44).filter(|job| !job.starts_with("flood")).collect();
    assert!(quiet.len() >= 18, "{order:?}");
    assert!(quiet[..10].iter().all(|job| *job == "high"), "{quiet:?}");
}

#[test]
fn another_artifact_under_the_same_key_raises_the_alarm() {
    let mut state = State::default();
    step(&mut state, create("a"), 0);
    drain(&mut state);
    step(&mut state, Command::LostArtifact("kernel".into()), 1);
    let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 1).0 else { panic!() };
    let other = Commit::Artifact { digest: BlobDigest::of(b"other"), cones: None };
    let (_, effects) = step(&mut state, Command::Commit { id, fence, commit: other, report_json: None }, 1);
    assert_eq!(state.nondeterministic, 1);
    assert!(matches!(&effects.records[..], [Record::Alarm { first, second, .. }]
        if *first == BlobDigest::of(b"kernel") && *second == BlobDigest::of(b"other")));
}

const HOUR_MS: i64 = 3_600_000;

#[test]
fn a_tenant_holds_no_more_leases_than_it_may() {
    let mut state = State::default();
    for (id, tenant) in [("a", "loud"), ("b", "loud"), ("c", "quiet")] {
        let mut job = job(id, None);
        job.tenant = tenant.into();
        step(&mut state, Command::Create(Box::new(job)), 0);
    }
    // All that is built is there, and some of the shards.
    while let Reply::Leased(Some((id @ WorkId::Build(_), fence))) = step(&mut state, take("w"), 0).0 {
        let command = commit(&state, id, fence, 0);
        step(&mut state, command, 0);
    }
    let take = |state: &mut State| {
        let command = Command::Lease { most: 2, worker: "w".into(), local: false, holds: BTreeSet::new() };
        let Reply::Leased(leased) = step(state, command, 0).0 else { panic!() };
        leased
    };
    let leased: Vec<_> = std::iter::from_fn(|| take(&mut state)).collect();
    assert_eq!(state.holding, [("loud".to_owned(), 2), ("quiet".to_owned(), 2)].into());
    // Who gives one back gets one again.
    let loud = |(id, _): &&(WorkId, u64)| matches!(id, WorkId::Shard(job, _) if job != "c");
    let (id, fence) = leased.iter().find(loud).unwrap().clone();
    let command = commit(&state, id, fence, 0);
    step(&mut state, command, 0);
    assert!(take(&mut state).is_some() && take(&mut state).is_none());
    assert_eq!(state.holding["loud"], 2);
}

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

/// What a random caller does; numbers choose among what there is.
#[derive(Clone, Debug)]
enum Deed {
    Create(u8),
    Take,
    Commit { which: usize, salt: u32, stale: bool },
    Fail { which: usize, deterministic: bool },
    Release(usize),
    Beat(usize),
    Cancel(u8),
    Wait(u64),
    LostArtifact(u8),
    LostChunk(u8, u32, u32),
    Sweep(u64, u64),
    Jump(i64),
    Restart,
}

fn deed() -> impl Strategy<Value = Deed> {
    prop_oneof![
        2 => (0..6_u8).prop_map(Deed::Create),
        12 => Just(Deed::Take),
        10 => (0..4_usize, 0..20_u32, any::<bool>()).prop_map(|(which, salt, stale)| {
            Deed::Commit { which, salt: u32::from(salt == 0), stale: stale && salt < 5 }
        }),
        1 => (0..4_usize, 0..8_u8).prop_map(|(which, d)| Deed::Fail { which, deterministic: d == 0 }),
        1 => (0..4_usize).prop_map(Deed::Release),
        1 => (0..4_usize).prop_map(Deed::Beat),
        1 => (0..6_u8).prop_map(Deed::Cancel),
        2 => (0..2 * lease::TTL_MS).prop_map(Deed::Wait),
        1 => (0..4_u8).prop_map(Deed::LostArtifact),
        1 => (0..6_u8, 0..5_u32, 0..3_u32).prop_map(|(j, f, t)| Deed::LostChunk(j, f, t)),
        1 => (0..2 * lease::TTL_MS, 0..8_u64).prop_map(|(age, jobs)| Deed::Sweep(age, jobs)),
        1 => (-HOUR_MS..HOUR_MS).prop_map(Deed::Jump),
        1 => Just(Deed::Restart),
    ]
}

/// The command of a deed in a state; `None` when there is nothing to do it to.
fn command(deed: &Deed, state: &State, count: usize, now: u64) -> Option<Command> {
    let held = |which: usize| {
        let id = state.leased.iter().nth(which % state.leased.len().max(1))?.clone();
        let fence = state.lease(&id)?.fence;
        Some((id, fence))
    };
    Some(match deed {
        Deed::Create(n) => {
            let request = (*n < 3).then(|| (format!("request {n}"), format!("body {}", n % 2)));
            let mut new = job(&format!("job {count}"), request);
            new.tenant = ["a", "b"][usize::from(*n % 2)].into();
            new.priority = 5 + n / 4;
            Command::Create(Box::new(new))
        }
        Deed::Take => take("w"),
        Deed::Commit { which, salt, stale } => {
            let (id, fence) = held(*which)?;
            commit(state, id, fence - u64::from(*stale), *salt)
        }
        Deed::Fail { which, deterministic } => {
            let (id, fence) = held(*which)?;
            Command::Fail { id, fence, message: "m".into(), deterministic: *deterministic }
        }
        Deed::Release(which) => {
            let (id, fence) = held(*which)?;
            Command::Release { id, fence }
        }
        Deed::Beat(which) => {
            let (id, fence) = held(*which)?;
            Command::Beat { id, fence, stage: "s".into() }
        }
        Deed::Cancel(n) => Command::Cancel(format!("job {n}")),
        Deed::Wait(_) => Command::Reap,
        Deed::LostArtifact(n) => {
            Command::LostArtifact(["mosaic", "cones0", "cones1", "kernel"][*n as usize].into())
        }
        Deed::LostChunk(n, frame, tile) => Command::LostChunk(format!("job {n}"), *frame, *tile),
        Deed::Sweep(age, kept_jobs) => {
            let before_ms = now.saturating_sub(*age);
            Command::Sweep(Sweep { before_ms, kept_jobs: *kept_jobs, kept_audit: 5 })
        }
        Deed::Jump(_) | Deed::Restart => return None,
    })
}

/// What is not stored does not count.
fn stored(state: &State) -> State {
    let mut state = state.clone();
    state.asked.clear();
    state.requests.clear();
    state.jobs.values_mut().for_each(|job| job.stage.clear());
    state.index(0, false);
    state.jobs.values_mut().for_each(|job| job.open.retain(|_, shards| !shards.is_empty()));
    state
}

/// Memory knows everything; SQLite forgets what ended and finds it again.
async fn assert_same(memory: &MemoryStore, sqlite: &mut SqliteStore) {
    for id in memory.state().jobs.keys() {
        sqlite.recall_job(id).await.unwrap();
    }
    let (mut a, b) = (stored(memory.state()), stored(sqlite.state()));
    a.artifacts.retain(|key, _| b.artifacts.contains_key(key));
    // Who has no job at work need not be known.
    assert_eq!(a, b);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn memory_and_sqlite_agree(deeds in prop::collection::vec(deed(), 1..120), kept in 0..3_usize) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            // In memory where that can be had: what is tested is what is stored, not the disk.
            let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
            let file = folder.path().join("jobs.db");
            let mut memory = MemoryStore::default();
            let mut sqlite = SqliteStore::open(&file, 0).await.unwrap().keep(kept);
            // Some hours after the beginning of time, so that it can go back.
            let mut now = 1000 * HOUR_MS as u64;
            for (count, deed) in deeds.iter().enumerate() {
                if let Deed::Wait(ms) = deed {
                    now += ms;
                }
                // A clock that jumps does so while the server is away: in a process it is monotonic.
                if let Deed::Jump(ms) = deed {
                    now = now.saturating_add_signed(*ms);
                }
                let Some(command) = command(deed, memory.state(), count, now) else {
                    drop(sqlite);
                    sqlite = SqliteStore::open(&file, now).await.unwrap().keep(kept);
                    assert_same(&memory, &mut sqlite).await;
                    // The restart gave new terms and forgot who asked; let both begin from there.
                    let mut state = memory.state().clone();
                    state.asked.clear();
                    state.jobs.values_mut().for_each(|job| job.stage.clear());
                    state.index(now, true);
                    memory = MemoryStore::of(state);
                    continue;
                };
                let a = memory.execute(command.clone(), now).await.unwrap();
                let b = sqlite.execute(command, now).await.unwrap();
                assert_eq!(a, b);
                assert_eq!(memory.state().check(), Ok(()));
                assert_eq!(sqlite.state().check(), Ok(()));
                assert!(sqlite.state().jobs.len() <= sqlite.state().active.len() + 2 * kept);
            }
            assert_same(&memory, &mut sqlite).await;
        });
    }
}

/// `cargo test --release -p photoneye-server --test jobs speed -- --ignored --nocapture`
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "a measurement"]
async fn speed_of_lease_and_commit() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let mut store = SqliteStore::open(&folder.path().join("jobs.db"), 0).await.unwrap();
    let mut long = job("a", None);
    long.shards = (0..5000).map(|i| (2 * i, 2, 0)).collect();
    store.execute(Command::Create(Box::new(long)), 0).await.unwrap();
    let start = std::time::Instant::now();
    let mut count = 0;
    while let Reply::Leased(Some((id, fence))) = store.execute(take("w"), 0).await.unwrap() {
        let command = commit(store.state(), id, fence, 0);
        store.execute(command, 0).await.unwrap();
        count += 1;
    }
    let rate = f64::from(count) / start.elapsed().as_secs_f64();
    println!("{count} leases and commits, {rate:.0} per second by one worker, one after the other");
    let start = std::time::Instant::now();
    drop(store);
    let store = SqliteStore::open(&folder.path().join("jobs.db"), 0).await.unwrap();
    // A job that ended is not kept in memory.
    println!("opened again in {:?}, {} jobs in memory", start.elapsed(), store.state().jobs.len());
    drop(store);

    let store = SqliteStore::open(&folder.path().join("many.db"), 0).await.unwrap();
    let machine = std::sync::Arc::new(Machine::new(store, Clock::new()));
    let mut long = job("a", None);
    long.shards = (0..10_000).map(|i| (2 * i, 2, 0)).collect();
    machine.execute(Command::Create(Box::new(long))).await.unwrap();
    let start = std::time::Instant::now();
    let work = |number: usize| {
        let machine = std::sync::Arc::clone(&machine);
        tokio::spawn(async move {
            let mut count = 0;
            loop {
                match machine.execute(take(&format!("worker {number}"))).await.unwrap() {
                    Reply::Leased(Some((id, fence))) => {
                        let command = machine.read(|state| commit(state, id, fence, 0));
                        machine.execute(command).await.unwrap();
                        count += 1;
                    }
                    // What is built first is at work.
                    _ if machine.read(|state| state.jobs["a"].state.active()) => {
                        tokio::task::yield_now().await;
                    }
                    _ => return count,
                }
            }
        })
    };
    let mut count = 0;
    for worker in (0..16).map(work).collect::<Vec<_>>() {
        count += worker.await.unwrap();
    }
    let rate = f64::from(count) / start.elapsed().as_secs_f64();
    println!("{count} leases and commits, {rate:.0} per second by 16 workers");

    // Thousands of jobs wait for builds that are at work.
    let mut store = SqliteStore::open(&folder.path().join("waiting.db"), 0).await.unwrap();
    for number in 0..5000 {
        store.execute(create(&format!("job {number}")), 0).await.unwrap();
    }
    while let Reply::Leased(Some(_)) = store.execute(take("w"), 0).await.unwrap() {}
    let start = std::time::Instant::now();
    assert_eq!(store.execute(take("w"), 0).await.unwrap(), Reply::Leased(None));
    println!("{:?} to find nothing to do among 5000 jobs", start.elapsed());
}
