//! Whatever happens, in memory and in SQLite the same.

use photoneye_server::jobs::memory::MemoryStore;
use photoneye_server::jobs::sqlite::SqliteStore;
use photoneye_server::jobs::{Command, JobStore, State, Sweep, lease};
use proptest::prelude::*;

use crate::common::{HOUR_MS, commit, create_local, job, take};

/// What a random caller does; numbers choose among what there is.
#[derive(Clone, Debug)]
enum Deed {
    Create(u8),
    CreateLocal,
    Disown,
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
        2 => Just(Deed::CreateLocal),
        1 => Just(Deed::Disown),
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
        Deed::CreateLocal => create_local(&format!("job {count}")),
        Deed::Disown => Command::Disown,
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
