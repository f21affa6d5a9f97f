//! Patches that see no light: the plan says so, with the distance between picture and patch.

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{photoneye, small_experiment, texts};
use crate::{report, run};

/// A patch 3° right of a picture 0.6° wide gave zeros and no warning; so did a gaze with the wrong sign.
#[test]
fn a_patch_beside_the_picture_is_warned_of() {
    let place = tempdir().unwrap();
    let mut experiment = small_experiment(1);
    experiment["retina"]["region_deg"] = json!({"x_min": 3, "x_max": 3.3, "y_min": -0.1, "y_max": 0.1});
    std::fs::write(place.path().join("spec.json"), experiment.to_string()).unwrap();
    let planned = photoneye(place.path()).args(["plan", "spec.json"]).output().unwrap();
    let (out, err) = texts(&planned);
    assert!(planned.status.success(), "{err}");
    assert!(err.contains("warning: retina.region_deg: no cone of the patch looks at a lit pixel"), "{err}");
    assert!(err.contains("° away") && err.contains("gaze.center_px"), "{err}");
    assert!(out.contains("pixels per degree"), "{out}");

    // The result carries it.
    let done = run(place.path(), &experiment);
    let (_, err) = texts(&done);
    assert!(done.status.success() && err.contains("no cone of the patch looks at a lit pixel"), "{err}");
    std::fs::remove_dir_all(place.path().join("out")).unwrap();
    let warnings = report(place.path(), &experiment)["warnings"].clone();
    assert_eq!(warnings.as_array().map(Vec::len), Some(1), "{warnings}");
}

/// A black picture is one, and a lit one beside which the eye moves onto the patch is none.
#[test]
fn a_dark_picture_is_warned_of_and_a_movement_onto_the_patch_is_not() {
    let place = tempdir().unwrap();
    let warnings = |change: &dyn Fn(&mut Value)| {
        let mut experiment = small_experiment(1);
        change(&mut experiment);
        report(place.path(), &experiment)["warnings"].clone()
    };
    let dark = warnings(&|e| e["video"] = json!({"pattern": {"uniform": {"rgb": [0, 0, 0]}}}));
    assert!(dark.to_string().contains("the picture is dark"), "{dark}");

    let moved = |x_arcmin: f64| {
        move |e: &mut Value| {
            e["retina"]["region_deg"] = json!({"x_min": 1, "x_max": 1.2, "y_min": -0.1, "y_max": 0.1});
            e["gaze"]["movement"] =
                json!({"recorded": {"t_s": [0, 1], "x_arcmin": [x_arcmin, x_arcmin], "y_arcmin": [0, 0]}});
        }
    };
    assert_eq!(warnings(&moved(-66.0)), json!([]));
    let wrong_sign = warnings(&moved(66.0));
    assert!(wrong_sign.to_string().contains("no cone of the patch"), "{wrong_sign}");
}
