//! Runs that nobody coupled are independent.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::run;
use crate::support::{read_npy, small_experiment, texts};

/// Counts of an even field of some luminance, all cones and frames, and the seeds in the report.
fn counts(folder: &Path, change: &dyn Fn(&mut Value)) -> (Vec<f64>, Value) {
    let mut experiment = small_experiment(4);
    experiment["video"] = json!({"pattern": {"uniform": {"rgb": [1, 1, 1]}}});
    experiment["counts"] = json!({"engine": "EXPECTED"});
    change(&mut experiment);
    let output = run(folder, &experiment);
    assert!(output.status.success(), "{}", texts(&output).1);
    let (_, counts) = read_npy(&fs::read(folder.join("out/counts.npy")).unwrap());
    let report: Value = serde_json::from_slice(&fs::read(folder.join("out/report.json")).unwrap()).unwrap();
    fs::remove_dir_all(folder.join("out")).unwrap();
    (counts.into_iter().map(f64::from).collect(), report["spec"]["counts"]["seed"].clone())
}

/// Correlation of two lists beyond their means over frames.
fn correlation(a: &[f64], b: &[f64], frames: usize) -> f64 {
    let noise = |counts: &[f64]| -> Vec<f64> {
        let cones = counts.len() / frames;
        let mean = |cone: usize| (0..frames).map(|f| counts[f * cones + cone]).sum::<f64>() / frames as f64;
        (0..counts.len()).map(|i| counts[i] - mean(i % cones)).collect()
    };
    let (a, b) = (noise(a), noise(b));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
}

/// Two experiments with default seeds had the same noise (correlation 0.99), and so had other mosaics of one seed. The
/// bound is five standard deviations of independent noise.
#[test]
fn experiments_that_differ_have_independent_noise() {
    let place = tempdir().unwrap();
    let luminance = |value: f64| move |e: &mut Value| e["display"]["white_luminance_cd_m2"] = json!(value);
    let (a, seed) = counts(place.path(), &luminance(20.0));
    let (b, other) = counts(place.path(), &luminance(21.0));
    let most = 5.0 / (0.75 * a.len() as f64).sqrt();
    assert_ne!(seed, other);
    assert!(correlation(&a, &b, 4).abs() < most, "{}", correlation(&a, &b, 4));

    // The same again is the same; a seed that is given is kept, and couples.
    let (again, same) = counts(place.path(), &luminance(20.0));
    assert_eq!((&a, &seed), (&again, &same));
    let given = |value: f64| {
        move |e: &mut Value| {
            luminance(value)(e);
            e["counts"]["seed"] = json!(5);
        }
    };
    let (a, seed) = counts(place.path(), &given(20.0));
    let (b, _) = counts(place.path(), &given(21.0));
    assert_eq!(seed, json!("5"));
    assert!(correlation(&a, &b, 4) > 0.9, "{}", correlation(&a, &b, 4));
}
