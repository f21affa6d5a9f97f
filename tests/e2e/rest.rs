//! REST from a plain HTTP client, against a server and a worker in two processes.

use std::fs;
use std::process::{Child, Stdio};

use photoneye_store::table::read_cones_file;
use serde_json::Value;
use tempfile::tempdir;

use crate::support::{Server, photoneye, read_npy, small_experiment};

#[test]
fn a_job_over_rest() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    let _worker = Killed(
        photoneye(place.path())
            .args(["worker", "--server", &server.url, "--cache", "cache"])
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let experiment = small_experiment(3).to_string();

    // The same key again is the same job; with another body it is refused.
    let (status, job) = server.post("/v1/jobs", Some("key-1"), &experiment);
    assert_eq!(status, 201, "{job}");
    let id = job["id"].as_str().unwrap();
    let (status, again) = server.post("/v1/jobs", Some("key-1"), &experiment);
    assert_eq!((status, again["id"].as_str()), (200, Some(id)));
    let (status, problem) = server.post("/v1/jobs", Some("key-1"), &small_experiment(4).to_string());
    assert_eq!(status, 422, "{problem}");

    // Events end with the job; their ids are whole numbers that rise.
    let (status, events) = server.get(&format!("/v1/jobs/{id}/events"));
    let events = String::from_utf8(events).unwrap();
    assert_eq!(status, 200);
    assert!(events.contains("SUCCEEDED"), "{events}");
    let ids: Vec<u64> = events
        .lines()
        .filter_map(|line| line.strip_prefix("id:"))
        .map(|id| id.trim().parse().unwrap())
        .collect();
    assert!(!ids.is_empty() && ids.is_sorted_by(|a, b| a < b), "{ids:?}");

    // What it counted, in every form.
    let job = server.success(id);
    let cones = server.get(&format!("/v1/jobs/{id}/cones.arrow")).1;
    let cones = read_cones_file(&cones).unwrap();
    assert_eq!(job["cones"].as_str().unwrap(), cones.len().to_string());
    let (shape, counts) = read_npy(&server.get(&format!("/v1/jobs/{id}/counts.npy")).1);
    assert_eq!(shape, [3, cones.len()]);
    assert!(counts.iter().any(|&count| count > 0));
    assert!(server.get(&format!("/v1/jobs/{id}/frames/2.png")).1.starts_with(b"\x89PNG"));
    assert_eq!(server.get(&format!("/v1/jobs/{id}/frames/3.png")).0, 404);
    let (status, results) = server.get(&format!("/v1/jobs/{id}/results?from=1"));
    assert!(status == 200 && results.len() > 100);
    let report = server.get_json(&format!("/v1/jobs/{id}/report"));
    assert!(report["photon_budget"]["emitted"].as_f64().unwrap() > 0.0);
    assert!(server.get_json("/v1/jobs").to_string().contains(id));
}

#[test]
fn a_cancelled_job_stays_cancelled() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 1);
    let id = server.submit(&small_experiment(20_000));
    let (status, job) = server.post(&format!("/v1/jobs/{id}/cancel"), None, "");
    assert_eq!((status, job["state"].as_str()), (200, Some("CANCELLED")), "{job}");
    // Others are served.
    server.success(&server.submit(&small_experiment(1)));
    assert_eq!(server.get_json(&format!("/v1/jobs/{id}"))["state"], "CANCELLED");
}

#[test]
fn lists_health_and_description_answer() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    assert!(server.get_json("/v1/displays").to_string().contains("lcos-3chip"));
    assert!(server.get_json("/v1/spectra").to_string().contains("projector-uhp"));
    assert_eq!(server.get_json("/openapi.json")["openapi"].as_str().map(|v| &v[..2]), Some("3."));
    for path in ["/v1/eyes", "/v1/retinas", "/healthz", "/readyz", "/metrics", "/docs"] {
        assert_eq!(server.get(path).0, 200, "{path}");
    }
    for path in ["/v1/jobs/none", "/v1/nothing", "/v1/blobs/b3:00/1"] {
        assert!((400..500).contains(&server.get(path).0), "{path}");
    }
}

/// The same message gets the same verdict over REST (POST) and over gRPC (the command line).
#[test]
fn rest_and_grpc_give_the_same_verdict() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    let cases: [(&str, Value, &str); 6] = [
        ("/eye", serde_json::json!({"pupill_mm": 3}), "eye.pupill_mm"),
        ("/eye", serde_json::json!({"pupil_mm": 99}), "eye.pupil_mm"),
        ("/eye", serde_json::json!({"preset": "none"}), "eye.preset"),
        ("/counts", serde_json::json!({"engine": "FAST"}), "counts.engine"),
        ("/frames", serde_json::json!({"count": 0}), "frames.count"),
        ("/display", serde_json::json!({"preset": "lcos-3chip", "width_px": 0}), "display.width_px"),
    ];
    for (place_of_change, value, field) in cases {
        let mut experiment = small_experiment(1);
        experiment[&place_of_change[1..]] = value;
        let (status, problem) = server.post("/v1/jobs", None, &experiment.to_string());
        assert!((400..500).contains(&status) && problem.to_string().contains(field), "{problem}");

        fs::write(place.path().join("wrong.json"), experiment.to_string()).unwrap();
        let plan =
            photoneye(place.path()).args(["plan", "wrong.json", "--server", &server.url]).output().unwrap();
        assert_eq!(plan.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&plan.stderr).contains(field), "{plan:?}");
    }
}

/// A process that ends with the test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
