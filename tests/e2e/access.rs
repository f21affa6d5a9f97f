//! Keys and the doctor on the command line: a server that others can reach, a worker and a user with a key each.

use std::fs;
use std::process::Stdio;

use serde_json::Value;
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment, succeed};

#[test]
fn a_server_with_keys_serves_those_who_have_one() {
    let place = tempdir().unwrap();
    let create = |roles: &[&str]| {
        let mut command = photoneye(place.path());
        command.args(["keys", "create", "--data", "data", "--tenant", "lab", "--json"]);
        for role in roles {
            command.args(["--role", role]);
        }
        let made: Value = serde_json::from_str(&succeed(&mut command)).unwrap();
        (made["id"].as_str().unwrap().to_owned(), made["key"].as_str().unwrap().to_owned())
    };
    let ((user_id, user), (_, worker)) = (create(&["read", "submit"]), create(&["worker"]));
    // With keys, an address that others can reach is allowed.
    let server = Server::start_on(place.path(), 0, "0.0.0.0:0");
    let url = server.url.replace("0.0.0.0", "127.0.0.1");
    fs::write(place.path().join("spec.json"), small_experiment(2).to_string()).unwrap();
    let run = |key: &str| {
        let mut command = photoneye(place.path());
        command.args(["run", "spec.json", "--out", "out", "--server", &url]).env("PHOTONEYE_API_KEY", key);
        command.output().unwrap()
    };
    let mut working = photoneye(place.path())
        .args(["worker", "--server", &url, "--cache", "cache", "--idle-exit", "1", "--api-key", &worker])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let done = run(&user);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(working.wait().unwrap().success(), "an idle worker stops by itself");
    assert!(!run("").status.success() && !run(&worker).status.success());

    let list = succeed(photoneye(place.path()).args(["keys", "list", "--data", "data"]));
    assert!(list.lines().count() == 2 && list.contains("lab") && !list.contains(&user), "{list}");
    succeed(photoneye(place.path()).args(["keys", "revoke", &user_id, "--data", "data"]));
    std::thread::sleep(std::time::Duration::from_millis(1200));
    assert!(!run(&user).status.success());
    let wrong = photoneye(place.path()).args(["keys", "create", "--role", "king"]).output().unwrap();
    assert_eq!(wrong.status.code(), Some(2));
}

#[test]
fn the_doctor_finds_what_is_wrong() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 1);
    let id = server.submit(&small_experiment(1));
    server.success(&id);
    let doctor = |args: &[&str]| {
        let mut command = photoneye(place.path());
        command.args(["doctor", "--data", "data", "--listen", "127.0.0.1:0"]).args(args);
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (code, said) = doctor(&["--server", &server.url]);
    assert!(code == Some(0) && said.contains("all whole") && said.contains("answers in"), "{code:?} {said}");
    let shelf = fs::read_dir(place.path().join("data/blobs")).unwrap().next().unwrap().unwrap().path();
    let blob = fs::read_dir(shelf).unwrap().next().unwrap().unwrap().path();
    fs::write(blob, b"damaged").unwrap();
    let (_, said) = doctor(&[]);
    assert!(said.contains("1 of ") && said.contains("made again"), "{said}");
    drop(server);
    let (code, said) = doctor(&["--server", "http://127.0.0.1:9"]);
    assert!(code == Some(1) && said.contains("is it running"), "{said}");
    fs::write(place.path().join("data/photoneye.db"), vec![7; 9000]).unwrap();
    let (code, said) = doctor(&[]);
    assert!(code == Some(1) && said.contains("backup"), "{said}");
}
