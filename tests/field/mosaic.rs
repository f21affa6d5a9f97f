//! Measured mosaics: cones at the rim and beside gaps are as large as the others.

use std::fs;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::run;
use crate::support::{read_npy, small_experiment, texts};

/// A hexagonal lattice of 625 equal cones 3 µm apart with a hole of seven, an even field: every cone counts the same.
/// Those at the rim counted up to 4.55 times as much.
#[test]
fn cones_at_the_rim_count_as_those_inside() {
    let place = tempdir().unwrap();
    let mut rows = String::from("x_um,y_um,type\n");
    for (i, j) in (-12..=12).flat_map(|j| (-12..=12).map(move |i| (i, j))) {
        let (i, j) = (f64::from(i), f64::from(j));
        let (x, y) = (3.0 * (i + 0.5 * (j.abs() % 2.0)), 3.0 * 0.75_f64.sqrt() * j);
        if x.hypot(y) > 3.1 {
            rows.push_str(&[x.to_string(), y.to_string(), "L\n".into()].join(","));
        }
    }
    fs::write(place.path().join("lattice.csv"), rows).unwrap();
    let mut experiment: Value = small_experiment(1);
    // Red light, which the macula lets pass.
    experiment["display"] = json!({
        "preset": "lcos-3chip", "width_px": 32, "height_px": 32, "pixel_pitch_cm": 0.58,
        "primaries": [{"name": "white", "spectrum": {"line": {"nm": 620, "fwhm_nm": 0}}}],
    });
    experiment["eye"] = json!({"stiles_crawford": {"perturbation_deg": 0}});
    experiment["retina"] = json!({
        "region_deg": {"x_min": -0.3, "x_max": 0.3, "y_min": -0.3, "y_max": 0.3}, "mosaic": {"file": "lattice.csv"},
    });
    experiment["video"] = json!({"pattern": {"uniform": {"rgb": [1, 1, 1]}}});
    experiment["counts"] = json!({"engine": "EXPECTED", "noise": "NONE"});
    experiment["accuracy"] = json!({"target": 0.001, "audit_cones": 0});
    let output = run(place.path(), &experiment);
    assert!(output.status.success(), "{}", texts(&output).1);
    let (_, bits) = read_npy(&fs::read(place.path().join("out/counts.npy")).unwrap());
    let counts: Vec<f64> = bits.into_iter().map(|bits| f64::from(f32::from_bits(bits))).collect();
    let mean = counts.iter().sum::<f64>() / counts.len() as f64;
    let [least, most] = [f64::min, f64::max].map(|f| counts.iter().copied().reduce(f).unwrap() / mean);
    assert!(counts.len() == 618 && least > 0.99 && most < 1.01, "{} {least} {most}", counts.len());
}
