//! kill -9 in the middle of a job: it goes on after a restart, or when it is run again, and ends with the result of a calm run.

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use photoneye_store::table::read_counts;
use photoneye_store::{Blobs as _, FolderStore};
use tempfile::tempdir;

use crate::support::{PATIENCE, Server, photoneye, small_experiment, succeed, texts};

const FRAMES: u32 = 400;

#[test]
fn a_killed_server_finishes_its_jobs_with_the_same_result() {
    let calm_place = tempdir().unwrap();
    let calm_server = Server::start(calm_place.path(), 2);
    let calm = calm_server.success(&calm_server.submit(&small_experiment(FRAMES)));

    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 1);
    let address = server.address().to_owned();
    let id = server.submit(&small_experiment(FRAMES));
    server.wait(&id, |job| job["progress"]["shards_done"].as_u64() >= Some(1) || job["state"] == "SUCCEEDED");
    server.kill();
    let server = Server::start_on(place.path(), 1, &address);
    let job = server.success(&id);
    assert!(job["result_digest"].is_string());
    assert_eq!(job["result_digest"], calm["result_digest"]);
}

#[test]
fn a_killed_worker_is_replaced() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    let id = server.submit(&small_experiment(FRAMES));
    let worker = |cache: &str| {
        let mut command = photoneye(place.path());
        command.args(["worker", "--server", &server.url, "--cache", cache, "--workers", "1"]);
        command.stderr(Stdio::null()).spawn().unwrap()
    };
    let mut first = worker("cache-1");
    server.wait(&id, |job| job["state"] != "QUEUED");
    first.kill().unwrap();
    first.wait().unwrap();
    let mut second = worker("cache-2");
    let job = server.success(&id);
    second.kill().unwrap();
    second.wait().unwrap();
    assert_eq!(job["progress"]["shards_done"], job["progress"]["shards_total"]);
}

/// A `run` that was killed burdens no other run; the same one again goes on with the shards that were done.
#[test]
fn a_killed_run_is_gone_on_with_by_the_same_run_only() {
    let place = tempdir().unwrap();
    let write = |name: &str, frames| {
        fs::write(place.path().join(name), small_experiment(frames).to_string()).unwrap();
    };
    write("long.json", FRAMES);
    write("short.json", 1);
    let run = |spec: &str, data: &str, out: &str| {
        let mut command = photoneye(place.path());
        command.args(["run", spec, "--data", data, "--out", out, "--workers", "1", "--pictures", "1"]);
        command
    };
    let counts = |out: &str| fs::read(place.path().join(out).join("counts.npy")).unwrap();
    // Nobody computes: what is there is looked at.
    let jobs = || Server::start(place.path(), 0).get_json("/v1/jobs")["jobs"].as_array().unwrap().clone();
    succeed(&mut run("long.json", "calm-data", "calm"));

    let data = place.path().join("data");
    let mut killed = run("long.json", "data", "killed").stderr(Stdio::null()).spawn().unwrap();
    let started = Instant::now();
    while frames_in(&data) < FRAMES as usize / 4 {
        assert!(started.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();

    let output = run("short.json", "data", "short").output().unwrap();
    let (out, err) = texts(&output);
    assert!(output.status.success() && err.contains("the process that ran it ended"), "{out}\n{err}");
    let [short, long] = &jobs()[..] else { panic!("two jobs") };
    assert_eq!((&short["state"], &long["state"]), (&"SUCCEEDED".into(), &"CANCELLED".into()));
    assert!(long["error"].as_str().unwrap().contains("run the same experiment again"), "{long}");
    let done = long["progress"]["shards_done"].as_u64().unwrap();
    assert!(done > 0 && done < long["progress"]["shards_total"].as_u64().unwrap(), "{long}");

    let output = run("long.json", "data", "again").output().unwrap();
    let (out, err) = texts(&output);
    assert!(output.status.success() && !err.contains("ended before"), "{out}\n{err}");
    assert!(counts("again") == counts("calm"));
    let after = jobs();
    assert_eq!((after.len(), &after[1]["id"], &after[1]["state"]), (2, &long["id"], &"SUCCEEDED".into()));
    assert!(!place.path().join("killed").exists());
}

/// A `run` in the data folder of a server that was stopped does its own job; those that wait there go on with the next server.
#[test]
fn a_run_leaves_what_waits_for_a_server() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    let id = server.submit(&small_experiment(3));
    server.kill();
    fs::write(place.path().join("mine.json"), small_experiment(2).to_string()).unwrap();
    let run = ["run", "mine.json", "--data", "data", "--out", "mine", "--workers", "1", "--pictures", "1"];
    succeed(photoneye(place.path()).args(run));

    let server = Server::start(place.path(), 0);
    let job = server.get_json(&format!("/v1/jobs/{id}"));
    assert_eq!(job["progress"]["shards_done"], 0, "{job}");
    server.kill();
    Server::start(place.path(), 1).success(&id);
}

/// Result chunks in a data folder.
fn frames_in(data: &Path) -> usize {
    if !data.join("blobs").exists() {
        return 0;
    }
    let store = FolderStore::open(data).unwrap();
    let counts = |digest| store.get(&digest).is_ok_and(|bytes| read_counts(&bytes).is_ok());
    store.list().into_iter().filter(|digest| counts(*digest)).count()
}
