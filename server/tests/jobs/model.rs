//! Every state that two workers, a user and a clock can bring a small job into, breadth first over the pure `step`.
//!
//! In each: the invariants hold; a write is accepted exactly when the writer's lease was not superseded, as an oracle beside
//! the machine keeps book; and from each the job can still come to its end, so that nothing hangs. With the worker's NAME
//! checked instead of the fence the same search finds a commit from a superseded lease.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use photoneye_server::jobs::lease::TTL_MS;
use photoneye_server::jobs::state::{Summary, WorkId};
use photoneye_server::jobs::{Command, Commit, NewArtifact, NewJob, Phase, Reply, State, step};
use photoneye_store::BlobDigest;

use crate::common::take;

/// Leases of one piece of work in a row; bounds the search.
const MOST_LEASES: u64 = 3;
const WORKERS: [&str; 2] = ["u", "v"];

/// The machine, what each worker believes to hold, and who really holds what until when.
#[derive(Clone)]
struct World {
    state: State,
    now_ms: u64,
    /// Computations under way: worker, work, fence. One may go on after its lease is gone.
    believed: BTreeSet<(usize, WorkId, u64)>,
    /// The oracle: worker, fence, end.
    granted: BTreeMap<WorkId, (usize, u64, u64)>,
    cancelled: bool,
    lost: u8,
    restarted: bool,
}

#[derive(Clone, Debug)]
enum Deed {
    Lease(usize),
    Commit(usize, WorkId, u64),
    Beat(usize, WorkId, u64),
    Fail(usize, WorkId, u64, bool),
    Release(usize, WorkId, u64),
    HalfATerm,
    Cancel,
    LoseChunk,
    LoseArtifact,
    Restart,
}

/// One artifact, two shards of one frame.
fn world() -> World {
    let artifact =
        NewArtifact { key: "a".into(), kind: "cones".into(), predicted_us: 1, ..NewArtifact::default() };
    let job = NewJob {
        id: "j".into(),
        frames: 2,
        artifacts: vec![artifact],
        tiles: vec![vec!["a".into()]],
        shards: vec![(0, 1, 0), (1, 1, 0)],
        shard_us: 1,
        tenant: "t".into(),
        ..NewJob::default()
    };
    let mut state = State::default();
    step(&mut state, Command::Create(Box::new(job)), 0);
    World {
        state,
        now_ms: 0,
        believed: BTreeSet::new(),
        granted: BTreeMap::new(),
        cancelled: false,
        lost: 0,
        restarted: false,
    }
}

impl World {
    fn deeds(&self) -> Vec<Deed> {
        let mut deeds = Vec::new();
        let leases = self.state.jobs["j"].shards.iter().map(|shard| &shard.lease);
        let fewest =
            leases.chain(self.state.artifacts.values().map(|a| &a.lease)).map(|lease| lease.fence).max();
        for worker in 0..WORKERS.len() {
            let busy = self.believed.iter().filter(|one| one.0 == worker).count();
            if busy < 2 && fewest.unwrap_or(0) < MOST_LEASES {
                deeds.push(Deed::Lease(worker));
            }
        }
        for (worker, id, fence) in self.believed.iter().cloned() {
            deeds.push(Deed::Commit(worker, id.clone(), fence));
            deeds.push(Deed::Beat(worker, id.clone(), fence));
            deeds.push(Deed::Fail(worker, id.clone(), fence, false));
            deeds.push(Deed::Fail(worker, id.clone(), fence, true));
            deeds.push(Deed::Release(worker, id, fence));
        }
        if !self.state.leased.is_empty() {
            deeds.push(Deed::HalfATerm);
        }
        if !self.cancelled {
            deeds.push(Deed::Cancel);
        }
        if self.lost < 1 {
            deeds.extend([Deed::LoseChunk, Deed::LoseArtifact]);
        }
        if !self.restarted {
            deeds.push(Deed::Restart);
        }
        deeds
    }

    fn execute(&mut self, command: Command) -> Reply {
        let (reply, _) = step(&mut self.state, command, self.now_ms);
        assert_eq!(self.state.check(), Ok(()));
        // Whatever took leases away took them from the oracle's book too.
        let state = &self.state;
        self.granted.retain(|id, _| state.lease(id).is_some_and(|lease| lease.phase == Phase::Leased));
        reply
    }

    /// A write of a worker: the machine and the oracle must agree on whether it may.
    fn write(&mut self, worker: usize, id: &WorkId, fence: u64, command: Command) -> Result<bool, String> {
        let (now_ms, granted) = (self.now_ms, self.granted.get(id).copied());
        let may = granted.is_some_and(|(who, minted, _)| (who, minted) == (worker, fence));
        let held = self.execute(command) == Reply::Held(true);
        if held == may {
            return Ok(held);
        }
        Err(format!("at {now_ms} {} wrote {id} under fence {fence}, granted is {granted:?}", WORKERS[worker]))
    }

    /// Does it, or says why it must not have happened. `by_name`: the machine is made to check the name only.
    fn act(&mut self, deed: &Deed, by_name: bool) -> Result<(), String> {
        match deed {
            Deed::Lease(worker) => {
                if let Reply::Leased(Some((id, fence))) = self.execute(take(WORKERS[*worker])) {
                    assert!(!self.granted.contains_key(&id), "{id} was handed out twice");
                    self.granted.insert(id.clone(), (*worker, fence, self.now_ms + TTL_MS));
                    self.believed.insert((*worker, id, fence));
                }
            }
            Deed::Commit(worker, id, fence) => {
                self.believed.remove(&(*worker, id.clone(), *fence));
                let lease = self.state.lease(id).cloned().unwrap_or_default();
                let named = by_name && lease.worker == WORKERS[*worker];
                let shown = if named { lease.fence } else { *fence };
                let command =
                    Command::Commit { id: id.clone(), fence: shown, commit: result(id), report_json: None };
                self.write(*worker, id, *fence, command)?;
            }
            Deed::Beat(worker, id, fence) => {
                if self.write(
                    *worker,
                    id,
                    *fence,
                    Command::Beat { id: id.clone(), fence: *fence, stage: String::new() },
                )? {
                    self.granted.insert(id.clone(), (*worker, *fence, self.now_ms + TTL_MS));
                } else {
                    self.believed.remove(&(*worker, id.clone(), *fence));
                }
            }
            Deed::Fail(worker, id, fence, deterministic) => {
                self.believed.remove(&(*worker, id.clone(), *fence));
                let (message, deterministic) = ("m".to_owned(), *deterministic);
                self.write(
                    *worker,
                    id,
                    *fence,
                    Command::Fail { id: id.clone(), fence: *fence, message, deterministic },
                )?;
            }
            Deed::Release(worker, id, fence) => {
                self.believed.remove(&(*worker, id.clone(), *fence));
                self.write(*worker, id, *fence, Command::Release { id: id.clone(), fence: *fence })?;
            }
            Deed::HalfATerm => {
                self.now_ms += TTL_MS / 2;
                let over: Vec<WorkId> = self
                    .granted
                    .iter()
                    .filter(|(_, grant)| grant.2 <= self.now_ms)
                    .map(|(id, _)| id.clone())
                    .collect();
                self.execute(Command::Reap);
                assert!(
                    over.iter().all(|id| !self.granted.contains_key(id)),
                    "a vanished worker keeps its lease"
                );
            }
            Deed::Cancel => {
                self.cancelled = true;
                self.execute(Command::Cancel("j".into()));
            }
            Deed::LoseChunk => {
                self.lost += 1;
                self.execute(Command::LostChunk("j".into(), 0, 0));
            }
            Deed::LoseArtifact => {
                self.lost += 1;
                self.execute(Command::LostArtifact("a".into()));
            }
            Deed::Restart => {
                self.restarted = true;
                self.state.asked.clear();
                self.state.index(self.now_ms, true);
                let now_ms = self.now_ms;
                self.granted.values_mut().for_each(|grant| grant.2 = now_ms + TTL_MS);
            }
        }
        Ok(())
    }

    /// What tells worlds apart; counters that only grow do not.
    fn name(&self) -> [u8; 32] {
        let mut state = self.state.clone();
        for job in state.jobs.values_mut() {
            (job.version, job.pass_us, job.finished_ms, job.error) = (0, 0, None, None);
        }
        (state.queues, state.passes) = (BTreeMap::new(), BTreeMap::new());
        let ages: Vec<(&WorkId, u64)> =
            self.granted.iter().map(|(id, grant)| (id, grant.2.saturating_sub(self.now_ms))).collect();
        for id in state.leased.clone() {
            state.change(&id, |lease| lease.expires_ms = lease.expires_ms.saturating_sub(self.now_ms));
        }
        for lease in state.jobs.values_mut().flat_map(|job| &mut job.shards).map(|shard| &mut shard.lease) {
            forget_old(lease);
        }
        state.artifacts.values_mut().for_each(|artifact| forget_old(&mut artifact.lease));
        let rest = (&self.believed, ages, self.cancelled, self.lost, self.restarted);
        *blake3::hash(format!("{state:?}{rest:?}").as_bytes()).as_bytes()
    }

    fn ended(&self) -> bool {
        !self.state.jobs["j"].state.active()
    }
}

fn forget_old(lease: &mut photoneye_server::jobs::Lease) {
    if lease.phase != Phase::Leased {
        (lease.expires_ms, lease.worker) = (0, String::new());
    }
}

fn result(id: &WorkId) -> Commit {
    match id {
        WorkId::Build(key) => Commit::Artifact { digest: BlobDigest::of(key.as_bytes()), cones: Some(3) },
        WorkId::Shard(_, number) => {
            let chunk = (*number, BlobDigest::of(&number.to_le_bytes()), Summary::default());
            Commit::Shard { chunks: vec![chunk], audit: Vec::new() }
        }
    }
}

/// All worlds, or the way to the first wrong deed.
fn explore(by_name: bool) -> Result<usize, (String, Vec<Deed>)> {
    let first = world();
    let mut number_of = HashMap::from([(first.name(), 0)]);
    let mut came_from: Vec<Option<(usize, Deed)>> = vec![None];
    let mut before: Vec<Vec<usize>> = vec![Vec::new()];
    // Ends: the job has, or the search does.
    let mut ends = VecDeque::new();
    let mut next = VecDeque::from([(0, first)]);
    while let Some((number, world)) = next.pop_front() {
        let deeds = world.deeds();
        let bounded = !deeds.iter().any(|deed| matches!(deed, Deed::Lease(_)));
        if world.ended() || bounded {
            ends.push_back(number);
        }
        for deed in deeds {
            let mut after = world.clone();
            if let Err(wrong) = after.act(&deed, by_name) {
                let mut way = vec![deed];
                let mut at = number;
                while let Some((from, deed)) = &came_from[at] {
                    way.push(deed.clone());
                    at = *from;
                }
                way.reverse();
                return Err((wrong, way));
            }
            let count = number_of.len();
            let there = *number_of.entry(after.name()).or_insert(count);
            if there == count {
                came_from.push(Some((number, deed)));
                before.push(Vec::new());
                next.push_back((there, after));
            }
            before[there].push(number);
        }
    }
    // Backwards from the ends: who is not reached hangs.
    let mut can_end = vec![false; before.len()];
    while let Some(number) = ends.pop_front() {
        if !std::mem::replace(&mut can_end[number], true) {
            ends.extend(&before[number]);
        }
    }
    assert!(can_end.iter().all(|can| *can), "a job can hang");
    Ok(before.len())
}

#[test]
fn no_superseded_lease_writes_and_no_job_hangs() {
    let worlds = explore(false).unwrap_or_else(|(wrong, way)| panic!("{wrong}: {way:#?}"));
    println!("{worlds} states");
    assert!(worlds > 10_000, "{worlds} states are too few to mean something");
}

#[test]
fn checking_the_name_instead_of_the_fence_is_not_enough() {
    let (wrong, way) = explore(true).unwrap_err();
    println!("{wrong} after {way:?}");
    assert!(way.len() <= 8);
}
