//! How fast the machine is over SQLite. Measurements, run by hand:
//! `cargo test --release -p photoneye-server --test jobs speed -- --ignored --nocapture`

use photoneye_server::jobs::clock::Clock;
use photoneye_server::jobs::sqlite::SqliteStore;
use photoneye_server::jobs::{Command, JobStore, Machine, Reply};

use crate::common::{commit, create, job, take};

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
