//! The steps of the machine: what becomes of jobs, leases, failures and lost bytes.

use photoneye_server::jobs::state::{ORPHAN, WorkId};
use photoneye_server::jobs::{
    Ask, Command, Commit, JobState, NewJob, Phase, Record, Reply, State, lease, step,
};
use photoneye_store::BlobDigest;

use crate::common::{ask, commit, create, create_local, drain, job, take};

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
        let command = Command::Lease(Ask { most: 2, ..ask("w") });
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

/// Who runs one experiment in a folder does not do what waits there for a server.
#[test]
fn only_local_jobs_are_worked_on_where_that_is_asked_for() {
    let mut state = State::default();
    step(&mut state, create("waits"), 0);
    let local_only = || Command::Lease(Ask { local_only: true, ..ask("w") });
    assert_eq!(step(&mut state, local_only(), 0).0, Reply::Leased(None));
    step(&mut state, create_local("mine"), 0);
    while let Reply::Leased(Some((id, fence))) = step(&mut state, local_only(), 0).0 {
        let command = commit(&state, id, fence, 0);
        assert_eq!(step(&mut state, command, 0).0, Reply::Held(true));
    }
    assert_eq!(state.jobs["mine"].state, JobState::Succeeded);
    assert!(state.jobs["waits"].state.active() && state.jobs["waits"].chunks.is_empty());
    // What was built is there for it.
    assert_eq!(drain(&mut state), 4);
    assert_eq!(state.jobs["waits"].result_digest, state.jobs["mine"].result_digest);
}

/// A job that was run in a process that is gone is over; who asks for the same gets it again, with what was done.
#[test]
fn a_local_job_ends_with_its_process_and_goes_on_when_asked_for_again() {
    let mut calm = State::default();
    step(&mut calm, create("calm"), 0);
    drain(&mut calm);

    let mut state = State::default();
    step(&mut state, create_local("mine"), 0);
    step(&mut state, create("queued"), 0);
    // All builds and three of the shards, one of them of the job that stays.
    for _ in 0..4 + 3 {
        let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
        let command = commit(&state, id, fence, 0);
        step(&mut state, command, 0);
    }
    let Reply::Leased(Some((id, fence))) = step(&mut state, take("w"), 0).0 else { panic!() };
    let done = state.jobs["mine"].chunks.clone();
    assert!(!done.is_empty() && done.len() < 8, "{}", done.len());

    step(&mut state, Command::Disown, 1000);
    let mine = &state.jobs["mine"];
    assert_eq!((mine.state, mine.error.as_deref()), (JobState::Cancelled, Some(ORPHAN)));
    assert!(state.jobs["queued"].state.active());
    if matches!(&id, WorkId::Shard(job, _) if job == "mine") {
        let late = commit(&state, id, fence, 0);
        assert_eq!(step(&mut state, late, 1000).0, Reply::Held(false));
    }

    // Another experiment, other pieces, or somebody outside: a job of its own.
    let new = |id: &str| NewJob { local: true, ..job(id, None) };
    for (other, id) in [
        (NewJob { experiment_digest: "other".into(), ..new("a") }, "a"),
        (NewJob { shards: vec![(0, 4, 0), (0, 4, 1)], ..new("b") }, "b"),
        (job("c", None), "c"),
    ] {
        let reply = step(&mut state.clone(), Command::Create(Box::new(other)), 2000).0;
        assert_eq!(reply, Reply::Created(id.into(), true));
    }
    let reply = step(&mut state, create_local("again"), 2000).0;
    assert_eq!(reply, Reply::Created("mine".into(), true));
    assert!(state.jobs["mine"].state.active() && state.jobs["mine"].chunks == done);
    assert_eq!((state.jobs["mine"].created_ms, &state.jobs["mine"].error), (2000, &None));
    step(&mut state, Command::Reap, 2000 + lease::TTL_MS);
    drain(&mut state);
    let mine = &state.jobs["mine"];
    assert_eq!(mine.result_digest, calm.jobs["calm"].result_digest);
    // What was done kept its number.
    assert!(done.iter().all(|(place, chunk)| mine.chunks[place].seq == chunk.seq));
    // A job that succeeded is not gone on with.
    assert_eq!(step(&mut state, create_local("next"), 3000).0, Reply::Created("next".into(), true));
}
