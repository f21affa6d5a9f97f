//! `run`, `plan`, `render` and `worker`, as a user calls them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use photoneye_eye::report::PhotonBudget;
use photoneye_store::photons::read_photons_table;
use photoneye_store::table::read_cones_file;
use serde_json::Value;
use tempfile::tempdir;

use crate::support::{Server, photoneye, read_npy, small_experiment, succeed};

fn face() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/experiments/face.json")
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Writes a small experiment; gives the file's name.
fn write_small(folder: &Path, frames: u32) -> &'static str {
    fs::write(folder.join("small.json"), small_experiment(frames).to_string()).unwrap();
    "small.json"
}

#[test]
fn a_face_becomes_a_result_folder() {
    let place = tempdir().unwrap();
    let run = || {
        let mut command = photoneye(place.path());
        command.arg("run").arg(face());
        command
    };
    let said = succeed(&mut run());
    for words in ["leave the display", "enter the pupil", "lost in the lens", "isomerize", "out/face"] {
        assert!(said.contains(words), "`{words}` is not in\n{said}");
    }
    let out = place.path().join("out/face");
    let cones = read_cones_file(&fs::read(out.join("cones.arrow")).unwrap()).unwrap();
    let (shape, counts) = read_npy(&fs::read(out.join("counts.npy")).unwrap());
    assert_eq!(shape, [1, cones.len()]);
    assert!(cones.len() > 1000 && counts.iter().any(|&count| count > 0));
    assert!(fs::read(out.join("frames/0000.png")).unwrap().starts_with(b"\x89PNG"));
    // Six cones were computed again, and what was foreseen stands beside what it took.
    let report = read_json(&out.join("report.json"));
    let audit = &report["audit"];
    assert_eq!(audit["samples"].as_array().unwrap().len(), 6);
    assert!(audit["within_target"] == true && audit["bound_95"].as_f64().unwrap() < 0.02, "{audit}");
    assert!(said.contains("Audit"), "{said}");
    let foreseen = &report["prediction"];
    let ratio = foreseen["predicted_seconds"].as_f64().unwrap() / foreseen["cpu_seconds"].as_f64().unwrap();
    // Any machine, any load: only that both are there and of one kind.
    assert!(ratio > 0.02 && ratio < 50.0, "{foreseen}");
    // Nothing half-written is left beside it.
    assert_eq!(fs::read_dir(place.path().join("out")).unwrap().count(), 1);

    // The pictures come out again from what is in the folder.
    let picture = fs::read(out.join("frames/0000.png")).unwrap();
    fs::remove_dir_all(out.join("frames")).unwrap();
    succeed(photoneye(place.path()).arg("render").arg(&out));
    assert_eq!(fs::read(out.join("frames/0000.png")).unwrap(), picture);

    // A second run replaces the files, from cached artifacts, with the same counts.
    let before = fs::read(out.join("counts.npy")).unwrap();
    succeed(&mut run());
    assert_eq!(fs::read(out.join("counts.npy")).unwrap(), before);
}

#[test]
fn every_photon_has_one_fate() {
    let place = tempdir().unwrap();
    succeed(photoneye(place.path()).args(["run", write_small(place.path(), 2), "--out", "o"]));
    let report = read_json(&place.path().join("o/report.json"));
    let budget: PhotonBudget = serde_json::from_value(report["photon_budget"].clone()).unwrap();
    assert!(budget.emitted > 0.0 && budget.isomerized.iter().sum::<f64>() > 0.0);
    // Rounding of sums of about ten terms over all frames.
    let difference = (budget.fates() / budget.emitted - 1.0).abs();
    assert!(difference < 1e-9, "fates sum to {} of {}", budget.fates(), budget.emitted);
    assert!(place.path().join("o/frames/mean.png").exists());
}

#[test]
fn threads_workers_and_cache_do_not_change_a_byte() {
    let place = tempdir().unwrap();
    let spec = write_small(place.path(), 5);
    for (out, data, threads, workers) in [("a", "d1", "1", "1"), ("b", "d2", "2", "3"), ("c", "d2", "2", "1")]
    {
        let mut command = photoneye(place.path());
        command.args(["run", spec, "--out", out, "--data", data, "--workers", workers]);
        succeed(command.env("RAYON_NUM_THREADS", threads));
    }
    for file in ["counts.npy", "cones.arrow", "frames/0000.png", "frames/mean.png"] {
        let read = |out: &str| fs::read(place.path().join(out).join(file)).unwrap();
        assert!(read("a") == read("b") && read("b") == read("c"), "{file} differs");
    }
}

#[test]
fn a_plan_lists_what_it_leaves_out_with_bounds() {
    omissions_can_be_switched_off();
    let place = tempdir().unwrap();
    let said = succeed(photoneye(place.path()).arg("plan").arg(face()).arg("--json"));
    let plan: Value = serde_json::from_str(&said).unwrap();
    let omissions = plan["omissions"].as_array().unwrap();
    assert!(!omissions.is_empty(), "{plan}");
    for omission in omissions {
        assert!(omission["what"].is_string() && omission["why"].is_string(), "{omission}");
        assert!(omission["bound"].as_f64().is_some_and(|bound| bound >= 0.0), "{omission}");
    }
    assert!(plan["predicted_seconds"].as_f64().is_some_and(|s| s > 0.0), "{plan}");
    assert!(plan["predicted_bytes"].as_f64().is_some_and(|b| b > 0.0), "{plan}");
}

#[test]
fn means_are_floats_and_do_not_depend_on_the_seed() {
    let place = tempdir().unwrap();
    let spec = write_small(place.path(), 1);
    for (out, seed) in [("a", "counts.seed=1"), ("b", "counts.seed=2")] {
        let set = ["--set", "counts.noise=NONE", "--set", seed];
        succeed(photoneye(place.path()).args(["run", spec, "--out", out]).args(set));
    }
    let read = |out: &str| fs::read(place.path().join(out).join("counts.npy")).unwrap();
    assert!(read("a") == read("b"));
    assert!(String::from_utf8_lossy(&read("a")[..80]).contains("<f4"));
}

#[test]
fn a_worker_in_another_process_gives_the_same_bytes() {
    let place = tempdir().unwrap();
    let spec = write_small(place.path(), 3);
    succeed(photoneye(place.path()).args(["run", spec, "--out", "alone", "--data", "other"]));

    let server = Server::start(place.path(), 0);
    let mut worker = photoneye(place.path())
        .args(["worker", "--server", &server.url, "--cache", "cache", "--idle-exit", "1"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    succeed(photoneye(place.path()).args(["run", spec, "--out", "apart", "--server", &server.url]));
    for file in ["counts.npy", "cones.arrow"] {
        let read = |out: &str| fs::read(place.path().join(out).join(file)).unwrap();
        assert!(read("alone") == read("apart"), "{file} differs");
    }
    // The job by its id: submit, watch, results, jobs.
    let id =
        succeed(photoneye(place.path()).args(["submit", spec, "--server", &server.url, "--request-id", "k"]));
    let again =
        succeed(photoneye(place.path()).args(["submit", spec, "--server", &server.url, "--request-id", "k"]));
    assert_eq!(id, again);
    let mut results = photoneye(place.path());
    results.args(["results", id.trim(), "--out", "fetched"]);
    succeed(results.env("PHOTONEYE_SERVER", &server.url));
    assert!(succeed(photoneye(place.path()).args(["jobs", "--server", &server.url])).contains(id.trim()));
    assert!(worker.wait().unwrap().success());
}

/// photons.arrow holds counts.npy again, photon by photon, and is the same from the server and with other workers.
#[test]
fn a_list_of_photons_is_the_counts() {
    let place = tempdir().unwrap();
    let mut experiment = small_experiment(3);
    experiment["display"]["white_luminance_cd_m2"] = 2.0.into();
    experiment["counts"] = serde_json::json!({"seed": 5, "engine": "EVENTS", "photon_list": true});
    fs::write(place.path().join("list.json"), experiment.to_string()).unwrap();
    succeed(photoneye(place.path()).args(["run", "list.json", "--out", "a"]));
    let read = |name: &str| fs::read(place.path().join("a").join(name)).unwrap();
    let cones = read_cones_file(&read("cones.arrow")).unwrap();
    let (shape, counts) = read_npy(&read("counts.npy"));
    let (frames, photons) = read_photons_table(&read("photons.arrow")).unwrap();
    let mut again = vec![0; counts.len()];
    for (frame, id) in frames.iter().zip(&photons.cone) {
        let cone = cones.id.iter().position(|cone| cone == id).unwrap();
        again[*frame as usize * shape[1] + cone] += 1;
    }
    assert!(again == counts && frames.len() > 1000, "{} photons", frames.len());
    assert!(frames.is_sorted() && photons.time_s.iter().all(|t_s| *t_s < 3.0 / 24.0));

    let server = Server::start(place.path(), 2);
    let (status, job) = server.post("/v1/jobs", None, &experiment.to_string());
    assert_eq!(status, 201, "{job}");
    let id = job["id"].as_str().unwrap();
    server.success(id);
    let served = server.get(&format!("/v1/jobs/{id}/photons.arrow"));
    assert!(served.0 == 200 && served.1 == read("photons.arrow"));
    experiment["counts"]["engine"] = "EXPECTED".into();
    let (status, problem) = server.post("/v1/jobs", None, &experiment.to_string());
    assert!(status == 422 || status == 400, "{status}");
    assert!(problem.to_string().contains("counts.photon_list"), "{problem}");
}

/// Part of [`a_plan_lists_what_it_leaves_out_with_bounds`]: what is switched off is listed no more.
fn omissions_can_be_switched_off() {
    let place = tempdir().unwrap();
    let spec = write_small(place.path(), 1);
    let omissions = |more: &[&str]| -> Vec<String> {
        let mut command = photoneye(place.path());
        command.args(["plan", "--json", spec]).args(more);
        let plan: Value = serde_json::from_str(&succeed(&mut command)).unwrap();
        let listed = plan["omissions"].as_array().unwrap();
        listed.iter().map(|one| one["what"].as_str().unwrap().to_owned()).collect()
    };
    let frequencies = "spatial frequencies that blur and apertures average away".to_owned();
    let field = "points of the field".to_owned();
    let all = omissions(&[]);
    assert!(all.contains(&frequencies) && all.contains(&field), "{all:?}");
    let one = omissions(&["--set", "accuracy.computed_anyway=[\"COARSE_GRIDS\"]"]);
    assert!(!one.contains(&frequencies) && one.contains(&field), "{one:?}");
    let none = omissions(&["--set", "accuracy.omissions=false"]);
    assert!(!none.contains(&frequencies) && !none.contains(&field), "{none:?}");
}
