//! `retina` through the binary, and a measured mosaic as the retina of an experiment.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use photoneye_store::table::{ConeColumns, read_cones_file};
use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{photoneye, small_experiment, succeed, texts};

fn cones(path: &Path) -> ConeColumns {
    read_cones_file(&fs::read(path).unwrap()).unwrap()
}

/// The cones of a table as a user would have measured them.
fn csv(cones: &ConeColumns) -> String {
    let mut text = String::from("# measured by nobody\nx_um,y_um,type\n");
    for i in 0..cones.len() {
        let kind = ["L", "M", "S"][usize::from(cones.kind[i])];
        writeln!(text, "{},{},{kind}", cones.x_um[i], cones.y_um[i]).unwrap();
    }
    text
}

#[test]
fn a_patch_of_retina_does_not_depend_on_threads() {
    let place = tempdir().unwrap();
    for threads in ["1", "2"] {
        let mut command = photoneye(place.path());
        command.args(["retina", "--to-deg", "0.4", "--threads", threads, "--out", threads]);
        let said = succeed(&mut command);
        assert!(said.contains("cones:"), "{said}");
    }
    let read = |name: &str| fs::read(place.path().join(name)).unwrap();
    assert!(read("1") == read("2"));
    let cones = read_cones_file(&read("1")).unwrap();
    assert!(cones.ecc_deg.iter().all(|ecc| *ecc <= 0.4) && cones.len() > 2000, "{}", cones.len());
}

#[test]
fn tables_pictures_and_networks_of_a_mosaic() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    succeed(photoneye(place.path()).args([
        "retina",
        "--to-deg",
        "0.3",
        "--out",
        "a.arrow",
        "--statistics",
        "s.json",
        "--png",
        "pictures",
        "--neighbours",
        "n.csv",
        "--fields",
        "f.csv",
        "--surround-generations",
        "2",
    ]));
    let grown = cones(&at("a.arrow"));
    for picture in ["statistics", "patches", "fovea", "strip"] {
        let bytes = fs::read(at("pictures").join(format!("{picture}.png"))).unwrap();
        assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 5_000, "{picture}");
    }
    let statistics: Value = serde_json::from_slice(&fs::read(at("s.json")).unwrap()).unwrap();
    assert_eq!(statistics["all"]["cones"], grown.len(), "{statistics}");

    // Euler: a planar graph of triangles has close to three pairs a cone, fewer at the rim.
    let lines = |name: &str| fs::read_to_string(at(name)).unwrap().lines().count() - 1;
    let pairs = lines("n.csv") as f64 / grown.len() as f64;
    assert!((2.7..3.0).contains(&pairs), "{pairs}");
    // Centre of one, surround of two generations: 19 cones a field inside.
    let members = lines("f.csv") as f64 / grown.len() as f64;
    assert!((16.0..19.0).contains(&members), "{members}");

    // Out and in again: the same cones.
    fs::write(at("m.csv"), csv(&grown)).unwrap();
    succeed(
        photoneye(place.path()).args(["retina", "--to-deg", "0.3", "--import", "m.csv", "--out", "b.arrow"]),
    );
    let read = cones(&at("b.arrow"));
    assert_eq!(read.len(), grown.len());
    for (i, &row) in read.id.iter().enumerate() {
        let row = row as usize;
        assert!(read.x_um[i].to_bits() == grown.x_um[row].to_bits() && read.kind[i] == grown.kind[row]);
    }
}

#[test]
fn an_experiment_on_measured_cones() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |spec: &Value, out: &str| {
        fs::write(at("spec.json"), spec.to_string()).unwrap();
        let args = ["run", "spec.json", "--out", out, "--data", "data", "--set", "counts.noise=NONE"];
        photoneye(place.path()).args(args).output().unwrap()
    };
    let sum = |out: &str| {
        let report: Value = serde_json::from_slice(&fs::read(at(out).join("report.json")).unwrap()).unwrap();
        let counted = report["photon_budget"]["isomerized"].as_array().unwrap();
        counted.iter().map(|value| value.as_f64().unwrap()).sum::<f64>()
    };

    // The scene on a grown mosaic, then on the same cones as a table.
    let mut spec = small_experiment(1);
    let grown = run(&spec, "grown");
    assert!(grown.status.success(), "{:?}", texts(&grown));
    succeed(photoneye(place.path()).args(["retina", "--to-deg", "0.3", "--out", "m.arrow"]));
    let table = cones(&at("m.arrow"));
    fs::write(at("m.csv"), csv(&table)).unwrap();
    spec["retina"]["mosaic"] = json!({"file": "m.csv"});
    let measured = run(&spec, "measured");
    assert!(measured.status.success(), "{:?}", texts(&measured));
    let read = cones(&at("measured/cones.arrow"));
    assert_eq!(read.len(), cones(&at("grown/cones.arrow")).len());
    assert!(read.id.iter().zip(&read.kind).all(|(&row, kind)| table.kind[row as usize] == *kind));
    // Single cells differ (a plain Voronoi diagram in place of a power diagram), their sum does not.
    let ratio = sum("measured") / sum("grown");
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");

    // What is wrong is said with the file's name.
    for (text, part) in [
        ("x_um,y_um,type\n1,2,Q\n", "\"Q\" is not"),
        ("x_um,type\n1,L\n", "no column \"y_um\""),
        ("x_um,y_um,type\n3000,3000,L\n", "no cone of it lies in the scene's patch"),
    ] {
        fs::write(at("m.csv"), text).unwrap();
        let wrong = run(&spec, "wrong");
        let (_, err) = texts(&wrong);
        assert!(!wrong.status.success() && err.contains(part), "{err}");
        assert!(err.contains("m.csv") || part.starts_with("no cone"), "{err}");
        assert!(!at("wrong/report.json").exists());
    }
}
