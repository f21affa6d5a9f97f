//! kill -9 in the middle of a job: it goes on after a restart and ends with the result of a calm run.

use std::process::Stdio;

use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment};

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
