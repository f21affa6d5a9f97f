//! A report holds the experiment: run again it is the same one.

use std::fs;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment, texts};
use crate::{report, run};

/// `spec` of a report was the model's own JSON, which no command reads, with seeds as numbers that JSON
/// readers round.
#[test]
fn the_spec_of_a_report_is_the_same_experiment() {
    let place = tempdir().unwrap();
    for seed in [None, Some(u64::MAX.to_string())] {
        let mut experiment = small_experiment(2);
        experiment["counts"] = json!({});
        experiment["gaze"] = json!({"movement": {"walk": {}}});
        if let Some(seed) = &seed {
            experiment["counts"] = json!({"seed": seed});
        }
        let first = report(place.path(), &experiment);
        let spec = first["spec"].clone();
        for given in [&spec["counts"]["seed"], &spec["gaze"]["movement"]["seed"]] {
            assert!(given.is_string(), "{spec}");
        }
        assert!(seed.is_none_or(|seed| spec["counts"]["seed"] == json!(seed)));
        let again = report(place.path(), &spec);
        assert_eq!(again["digests"], first["digests"]);
        assert_eq!(again["spec"], spec);
    }
}

/// A server gives the experiment back before it is computed, and whatever becomes of it.
#[test]
fn a_job_holds_its_experiment() {
    let place = tempdir().unwrap();
    // Nobody works.
    let server = Server::start(place.path(), 0);
    let (status, job) = server.post("/v1/jobs", None, &small_experiment(1).to_string());
    assert_eq!(status, 201, "{job}");
    let id = job["id"].as_str().unwrap();
    let found = server.get_json(&["/v1/jobs/", id].concat());
    let spec = &found["plan"]["spec"];
    assert_eq!(spec["display"]["preset"], json!("lcos-3chip"));
    let (_, again) = server.post("/v1/plans", None, &spec.to_string());
    let digest = &again["plan"]["experiment_digest"];
    assert!(digest.is_string() && *digest == job["plan"]["experiment_digest"], "{again}");
}

/// The plan of a file and the plan of the spec that it prints are one.
#[test]
fn a_plan_prints_the_experiment() {
    let place = tempdir().unwrap();
    let planned = |spec: &Value| -> Value {
        fs::write(place.path().join("spec.json"), spec.to_string()).unwrap();
        let output = photoneye(place.path()).args(["--json", "plan", "spec.json"]).output().unwrap();
        let (out, err) = texts(&output);
        assert!(output.status.success(), "{err}");
        serde_json::from_str(&out).unwrap()
    };
    let first = planned(&small_experiment(1));
    assert_eq!(planned(&first["spec"]), first);
    assert!(run(place.path(), &first["spec"]).status.success());
}
