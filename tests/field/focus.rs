//! Accommodation: nothing makes an eye see sharply beyond its far point.

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{photoneye, small_experiment, texts};

/// The focus of a plan, and what it warns of.
fn planned(focus: &Value, wavefront_um: f64) -> (Value, String) {
    let place = tempdir().unwrap();
    let mut experiment = small_experiment(1);
    // Zernike defocus over a pupil of 6 mm.
    experiment["eye"]["wavefront"] = json!({"pupil_mm": 6, "coefficients_um": [0, 0, 0, 0, wavefront_um]});
    experiment["eye"]["focus"] = focus.clone();
    std::fs::write(place.path().join("spec.json"), experiment.to_string()).unwrap();
    let output = photoneye(place.path()).args(["--json", "plan", "spec.json"]).output().unwrap();
    let (out, err) = texts(&output);
    assert!(output.status.success(), "{err}");
    (serde_json::from_str::<Value>(&out).unwrap()["focus"].clone(), err)
}

/// A myope of 1.5 D who looks at 6 m has 1.33 D of blur: c4 = 1.9486 µm over 6 mm is 4√3·c4/r² = 1.5 D. He saw sharply
/// by an accommodation of −1.5 D.
#[test]
fn a_myope_does_not_accommodate_negatively() {
    let number = |focus: &Value, name: &str| focus[name].as_f64().unwrap_or(0.0);
    let myope = 1.948_557;
    let (far, err) = planned(&json!({"distance_cm": 600, "wavelength_nm": 555}), myope);
    assert!(number(&far, "accommodation_d").abs() < 0.02, "{far}");
    assert!((number(&far, "residual_d") - 1.33).abs() < 0.1, "{far}");
    assert!(err.contains("warning: eye.focus") && err.contains("far point"), "{err}");

    let (relaxed, err) = planned(&json!({"distance_cm": 600, "wavelength_nm": 555, "relaxed": true}), myope);
    assert!((number(&relaxed, "residual_d") - number(&far, "residual_d")).abs() < 1e-6, "{relaxed}");
    assert!(!err.contains("warning"), "{err}");

    // Nearer than the far point he sees sharply.
    let (near, err) = planned(&json!({"distance_cm": 33}), myope);
    assert!(number(&near, "residual_d").abs() < 0.02 && number(&near, "accommodation_d") > 1.2, "{near}");
    assert!(!err.contains("warning"), "{err}");
}

/// At 60 years 0.5 D are left: 40 cm are out of focus by 2 D.
#[test]
fn the_amplitude_falls_with_age() {
    let (focus, err) = planned(&json!({"distance_cm": 40, "age_years": 60}), 0.0);
    let number = |name: &str| focus[name].as_f64().unwrap_or(0.0);
    assert!((number("accommodation_d") - 0.5).abs() < 0.05, "{focus}");
    assert!((number("residual_d") + 2.5 - 0.5 - number("far_point_d")).abs() < 0.05, "{focus}");
    assert!(err.contains("it accommodates by 0.5"), "{err}");
}
