//! `study`: each topic, quick: its page, tables and pictures are there, and the figures are what they must be. And the ways of `psf`.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::tempdir;

use crate::support::{photoneye, small_experiment, succeed};

/// Runs a topic; gives what it said as JSON.
fn study(place: &Path, topic: &str, more: &[&str]) -> Value {
    let mut command = photoneye(place);
    command.args(["study", topic, "--quick", "--json", "--out", topic]).args(more);
    let said: Value = serde_json::from_str(&succeed(&mut command)).unwrap();
    let page = fs::read_to_string(place.join(topic).join("index.html")).unwrap();
    // Every file that the page names is there and is what its name says.
    for (mark, head) in [("src=\"", b"\x89PNG".as_slice()), ("href=\"", b"".as_slice())] {
        for part in page.split(mark).skip(1) {
            let name = part.split('"').next().unwrap();
            let bytes = fs::read(place.join(topic).join(name)).unwrap();
            assert!(bytes.len() > 50 && bytes.starts_with(head), "{name}");
        }
    }
    said
}

fn rows(said: &Value, table: &str) -> Vec<Value> {
    said["tables"][table].as_array().unwrap_or_else(|| panic!("no table {table}: {said}")).clone()
}

#[test]
fn optics() {
    let place = tempdir().unwrap();
    let said = study(place.path(), "optics", &[]);
    // Figure 11: a hole at 0.5 dioptres, the brightest ring at 3.9 µm.
    let hole = rows(&said, "figure11").into_iter().find(|r| r["object_D"] == 0.5).unwrap();
    let ratio = hole["middle/ring"].as_f64().unwrap();
    assert!((ratio - 0.4).abs() < 0.05, "{hole}");
    // Figure 10: 95° lands at 109 to 110° of retina.
    let edge = rows(&said, "chief-rays").pop().unwrap();
    assert!((edge["retinal_deg_from_axis"].as_f64().unwrap() - 109.5).abs() < 1.0, "{edge}");
    // The Airy disc's closed form.
    let airy = &rows(&said, "airy")[0];
    assert!(airy["largest difference / peak"].as_f64().unwrap() < 1e-9, "{airy}");
}

/// Figures 13, 14 and 16 say what the paper says of them.
#[test]
fn figures() {
    let place = tempdir().unwrap();
    let said = study(place.path(), "figures", &[]);
    let letters = rows(&said, "letters");
    let right = |chart: &str, row: &str| {
        let found = letters.iter().find(|r| r["chart"] == chart && r["row"] == row);
        found.and_then(|r| r["read right"].as_f64()).unwrap_or_else(|| panic!("{chart} {row}: {letters:?}"))
    };
    assert!(right("Figure 13, 543 nm", "20/12") >= 4.0 && right("Figure 13, 543 nm", "20/15") >= 4.0);
    let five = rows(&said, "mean-of-five");
    let correlation = |what: &str| {
        five.iter().find(|r| r["what"] == what).unwrap()["correlation with the right letters"]
            .as_f64()
            .unwrap()
    };
    assert!(correlation("mean of five, moved back") > correlation("one frame of an eye at rest"), "{five:?}");
}

#[test]
fn retina() {
    let place = tempdir().unwrap();
    let said = study(place.path(), "retina", &[]);
    let rows = rows(&said, "retina-cost");
    assert_eq!(rows.len(), 5);
    for row in rows {
        let per_cone = row["us_per_cone"].as_f64().unwrap();
        assert!(per_cone > 1.0 && per_cone < 1e4 && row["cones"].as_f64().unwrap() > 500.0, "{row}");
    }
}

#[test]
fn error_against_time() {
    let place = tempdir().unwrap();
    let spec = small_experiment(2);
    fs::write(place.path().join("own.json"), spec.to_string()).unwrap();
    let said = study(place.path(), "error-vs-time", &["--spec", "own.json"]);
    let row = &rows(&said, "error-vs-time-short")[0];
    assert_eq!(row["scene"], "own");
    // The default target is kept.
    assert!(row["error"].as_f64().unwrap() < 0.01, "{row}");
    let all = fs::read_to_string(place.path().join("error-vs-time/error-vs-time.csv")).unwrap();
    assert!(all.contains("accuracy.target") && all.contains("engine PAPER") && all.contains(",yes"), "{all}");
}

#[test]
fn every_extreme_case_holds() {
    let place = tempdir().unwrap();
    let said = study(place.path(), "stability", &[]);
    let rows = rows(&said, "stability");
    assert!(rows.len() > 90 && rows.iter().all(|row| row["verdict"] == "pass"));
}

/// Every way gives the same point spread within its error; the paper's window made whole holds all light.
#[test]
fn ways_to_a_point_spread() {
    let place = tempdir().unwrap();
    let peak = |more: &[&str]| {
        let mut command = photoneye(place.path());
        command.args(["psf", "--json", "--samples", "32", "--out", "p.npy"]).args(more);
        let said: Value = serde_json::from_str(&succeed(&mut command)).unwrap();
        (said["peak"].as_f64().unwrap(), said["energy_in_window"].as_f64().unwrap())
    };
    let (want, energy) = peak(&[]);
    assert!((energy - 0.9336).abs() < 0.002, "{energy}");
    for (method, within) in [
        ("gauss", 1e-6),
        ("huygens", 1e-4),
        ("grid", 0.02),
        ("stratified", 0.02),
        ("fft", 0.02),
        ("random", 0.2),
    ] {
        let (got, _) = peak(&["--method", method]);
        assert!((got / want - 1.0).abs() < within, "{method}: {got}, not {want}");
    }
    assert!((peak(&["--whole-window"]).1 - 1.0).abs() < 1e-9);
    assert!((peak(&["--field-deg", "5.4", "--node-um", "300"]).0 - want).abs() < 1e-12);
    assert!(
        peak(&["--wavelength-nm", "544", "--wavelength-step-nm", "10"]) == peak(&["--wavelength-nm", "540"])
    );
    let wrong = photoneye(place.path()).args(["psf", "--node-um", "0", "--out", "q.npy"]).output().unwrap();
    assert_eq!(wrong.status.code(), Some(2));
}
