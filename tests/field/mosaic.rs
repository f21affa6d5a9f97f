//! Measured mosaics: cones at the rim and beside gaps are as large as the others.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use photoneye_store::table::{ConeColumns, read_cones_file};
use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{read_npy, small_experiment, texts};
use crate::{assert_refused, run};

/// A hexagonal lattice of equal cones 3 µm apart with a hole of seven, and what each row ends with.
fn lattice(header: &str, row_end: &str) -> String {
    let mut rows = header.to_owned();
    for (i, j) in (-12..=12).flat_map(|j| (-12..=12).map(move |i| (i, j))) {
        let (i, j) = (f64::from(i), f64::from(j));
        let (x, y) = (3.0 * (i + 0.5 * (j.abs() % 2.0)), 3.0 * 0.75_f64.sqrt() * j);
        if x.hypot(y) > 3.1 {
            rows.push_str(&[x.to_string(), y.to_string(), row_end.to_owned()].join(","));
        }
    }
    rows
}

/// An even field of red light, which the macula lets pass, on the cones of `lattice.csv`.
fn even_field() -> Value {
    let mut experiment: Value = small_experiment(1);
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
    experiment
}

/// Mean counts of an experiment in its folder, in the order of its cones; then `out` is gone.
fn means(folder: &Path, experiment: &Value) -> (Vec<f64>, ConeColumns, Value) {
    let output = run(folder, experiment);
    assert!(output.status.success(), "{}", texts(&output).1);
    let (_, bits) = read_npy(&fs::read(folder.join("out/counts.npy")).unwrap());
    let cones = read_cones_file(&fs::read(folder.join("out/cones.arrow")).unwrap()).unwrap();
    let report = serde_json::from_slice(&fs::read(folder.join("out/report.json")).unwrap()).unwrap();
    fs::remove_dir_all(folder.join("out")).unwrap();
    (bits.into_iter().map(|bits| f64::from(f32::from_bits(bits))).collect(), cones, report)
}

/// Equal cones in an even field count the same. Those at the rim counted up to 4.55 times as much. They are
/// marked, and left out of the report's means.
#[test]
fn cones_at_the_rim_count_as_those_inside() {
    let place = tempdir().unwrap();
    fs::write(place.path().join("lattice.csv"), lattice("x_um,y_um,type\n", "L\n")).unwrap();
    let (counts, cones, report) = means(place.path(), &even_field());
    let mean = counts.iter().sum::<f64>() / counts.len() as f64;
    let [least, most] = [f64::min, f64::max].map(|f| counts.iter().copied().reduce(f).unwrap() / mean);
    assert!(counts.len() == 618 && least > 0.99 && most < 1.01, "{} {least} {most}", counts.len());
    // 96 cones lie on the border of 25 x 25, 12 around the hole; rows are shifted, so that some of the second
    // column are open, too.
    let edge = cones.edge.iter().filter(|edge| **edge).count();
    assert!((96 + 12..=96 + 12 + 24).contains(&edge), "{edge}");
    let far = |i: usize| cones.x_um[i].abs() > 35.0 || cones.y_um[i].abs() > 30.0;
    assert!((0..counts.len()).filter(|i| far(*i)).all(|i| cones.edge[i]));
    assert_eq!(report["edge_cones"], json!(edge));
    assert_eq!(report["cones"]["l"], json!(618 - edge));
}

/// Diameters and ids of the table are taken: 2 µm are 3.14 µm², and count as such.
#[test]
fn apertures_and_ids_of_a_table_are_taken() {
    let place = tempdir().unwrap();
    let numbered = lattice("x_um,y_um,type,aperture_um,id\n", "L,2,");
    // One id a row, from 1000.
    let mut table = String::new();
    for (i, part) in numbered.split("L,2,").enumerate() {
        table.push_str(part);
        if i < 618 {
            table.push_str(&["L,2,".to_owned(), (1000 + i).to_string(), "\n".to_owned()].concat());
        }
    }
    fs::write(place.path().join("lattice.csv"), table).unwrap();
    let (of_discs, cones, _) = means(place.path(), &even_field());
    assert!(
        cones.aperture_um2.iter().all(|area| (f64::from(*area) / std::f64::consts::PI - 1.0).abs() < 1e-3)
    );
    assert_eq!(cones.id.iter().copied().collect::<BTreeSet<u64>>(), (1000..1618).collect());
    fs::write(place.path().join("lattice.csv"), lattice("x_um,y_um,type\n", "L\n")).unwrap();
    let (of_cells, ..) = means(place.path(), &even_field());
    let ratio = of_discs.iter().sum::<f64>() / of_cells.iter().sum::<f64>();
    let cell_um2 = 9.0 * 0.75_f64.sqrt();
    assert!((ratio * cell_um2 / std::f64::consts::PI - 1.0).abs() < 5e-3, "{ratio}");
}

/// Cones that were not classified are refused, or taken as what the experiment says.
#[test]
fn unclassified_cones_are_refused_or_named() {
    let place = tempdir().unwrap();
    fs::write(place.path().join("lattice.csv"), lattice("x_um,y_um,type\n", "U\n")).unwrap();
    let mut experiment = even_field();
    let output = run(place.path(), &experiment);
    assert_refused(
        place.path(),
        &output,
        &["retina.mosaic", "line 2", "\"U\"", "retina.mosaic.type_unknown"],
    );
    experiment["retina"]["mosaic"]["type_unknown"] = json!("M");
    let (_, cones, _) = means(place.path(), &experiment);
    assert!(cones.kind.iter().all(|kind| *kind == 1));
}

/// Cones beside lost ones count what they counted before.
#[test]
fn gaps_of_lost_cones_stay_gaps() {
    let place = tempdir().unwrap();
    let mut experiment = even_field();
    experiment["retina"].as_object_mut().unwrap().remove("mosaic");
    let (all, cones, _) = means(place.path(), &experiment);
    let before: BTreeMap<u64, f64> = cones.id.into_iter().zip(all).collect();
    experiment["retina"]["dropout"] = json!({"fraction": 0.3});
    let (left, cones, _) = means(place.path(), &experiment);
    assert!(left.len() < before.len() * 4 / 5 && left.len() > before.len() / 2);
    for (id, count) in cones.id.iter().zip(&left) {
        assert!((count / before[id] - 1.0).abs() < 2e-3, "{id}: {count}, {}", before[id]);
    }
}

/// Dichromats and blue-cone monochromats; a share of S cones above a half was refused.
#[test]
fn shares_of_types_may_be_anything() {
    let place = tempdir().unwrap();
    let shares = |ratio: Value| -> [f64; 3] {
        let mut experiment = even_field();
        experiment["retina"] = json!({
            "region_deg": {"x_min": 2.5, "x_max": 3, "y_min": -0.25, "y_max": 0.25}, "cone_ratio": ratio,
        });
        let cones = means(place.path(), &experiment).1;
        let mut shares = [0.0; 3];
        for kind in &cones.kind {
            shares[usize::from(*kind)] += 1.0 / cones.kind.len() as f64;
        }
        shares
    };
    let bcm = shares(json!({"l": 0, "m": 0, "s": 1}));
    assert!(bcm[2] > 1.0 - 1e-9, "{bcm:?}");
    let protanope = shares(json!({"l": 0}));
    assert!(protanope[0] <= 0.0 && protanope[1] > 0.7, "{protanope:?}");
    // Some 800 cones: five standard deviations.
    let many = shares(json!({"l": 0.2, "m": 0.1, "s": 0.7}));
    assert!((many[2] - 0.7).abs() < 5.0 * (0.7_f64 * 0.3 / 800.0).sqrt(), "{many:?}");
}
