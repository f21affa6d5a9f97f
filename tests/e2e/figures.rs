//! What the service costs. Measurements, run by hand and one at a time:
//! `cargo test --release --test e2e figures -- --ignored --nocapture --test-threads 1`

use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(0.0)
}

#[test]
#[ignore = "a measurement"]
fn overhead_over_the_model() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 1);
    let mut scene = small_experiment(1);
    // The size of Figure 12.
    scene["display"] = json!({"preset": "lcos-3chip", "width_px": 30, "height_px": 30, "pixel_pitch_cm": 0.58, "distance_cm": 800});
    scene.as_object_mut().unwrap().remove("retina");
    // The default target, and that of pictures.
    for (target, frames) in
        [0.001, 0.01].into_iter().flat_map(|target| [1, 16, 64].map(|frames| (target, frames)))
    {
        scene["accuracy"]["target"] = json!(target);
        scene["frames"]["count"] = json!(frames);
        server.success(&server.submit(&scene));
        let mut best = (f64::INFINITY, 0.0);
        for seed in 0..5 {
            scene["counts"]["seed"] = json!((10 * frames + seed).to_string());
            let started = Instant::now();
            let id = server.submit(&scene);
            server.success(&id);
            let user_seconds = started.elapsed().as_secs_f64();
            let report = server.get_json(&format!("/v1/jobs/{id}/report"));
            let model = number(&report["seconds"]["count"]) + number(&report["seconds"]["prepare"]);
            let whole = number(&report["wall_seconds"]);
            if whole - model < best.0 {
                best = (whole - model, model);
            }
            println!(
                "target {target}, {frames} frames: job {whole:.3} s, model {model:.3} s, as a user sees it {user_seconds:.3} s"
            );
        }
        println!(
            "target {target}, {frames} frames, best of 5: overhead {:.1} ms, {:.1} %",
            1e3 * best.0,
            100.0 * best.0 / best.1
        );
    }
}

#[test]
#[ignore = "a measurement"]
fn two_workers_against_one() {
    let seconds = |count: usize| {
        let place = tempdir().unwrap();
        let server = Server::start(place.path(), 0);
        let mut scene = small_experiment(64 * 16);
        // The size of Figure 12 with an eye that moves: each frame is work of its own.
        scene["display"] = json!({"preset": "lcos-3chip", "width_px": 30, "height_px": 30, "pixel_pitch_cm": 0.58, "distance_cm": 800});
        scene["gaze"] = json!({"movement": {"walk": {}}});
        scene["accuracy"]["target"] = json!(0.001);
        scene.as_object_mut().unwrap().remove("retina");
        let start = |number: usize| -> Child {
            let mut command = photoneye(place.path());
            command.args([
                "worker",
                "--server",
                &server.url,
                "--workers",
                "1",
                "--cache",
                &format!("cache-{number}"),
            ]);
            command.env("RAYON_NUM_THREADS", "1").stderr(Stdio::null()).spawn().unwrap()
        };
        let mut workers: Vec<Child> = (0..count).map(start).collect();
        // Warm: retina and optics are there.
        server.success(&server.submit(&scene));
        scene["counts"]["seed"] = json!("77");
        let started = Instant::now();
        let id = server.submit(&scene);
        // Who asks 50 times a second takes some of what is measured.
        while !matches!(
            server.get_json(&format!("/v1/jobs/{id}"))["state"].as_str(),
            Some("SUCCEEDED" | "FAILED")
        ) {
            std::thread::sleep(Duration::from_millis(200));
        }
        let job = server.success(&id);
        let seconds = started.elapsed().as_secs_f64();
        println!("{count} worker(s): {seconds:.2} s for {} shards", job["progress"]["shards_total"]);
        for worker in &mut workers {
            worker.kill().unwrap();
            worker.wait().unwrap();
        }
        seconds
    };
    let (one, two) = (seconds(1), seconds(2));
    println!("speedup {:.2}", one / two);
}

#[test]
#[ignore = "a measurement"]
fn memory_of_an_idle_server() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 2);
    println!("idle server with two workers: {:.1} MB resident", server.resident_bytes() as f64 / 1e6);
    // Jobs that ended do not stay in memory, and what was freed goes back to the system soon after.
    for _ in 0..5 {
        for seed in 0..100 {
            let mut scene = small_experiment(4);
            scene["counts"]["seed"] = json!(seed.to_string());
            let id = server.submit(&scene);
            server.success(&id);
        }
        std::thread::sleep(std::time::Duration::from_secs(4));
        println!("after 100 more jobs: {:.1} MB resident", server.resident_bytes() as f64 / 1e6);
    }
}
