//! Absolute quantities: a PQ code is a luminance.

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::small_experiment;
use crate::{assert_refused, report, run};

/// PQ code 0.580689 is 203 cd/m² on every screen. On one of 1000 cd/m² it was 20.3, without a word.
#[test]
fn a_pq_code_is_a_luminance() {
    let place = tempdir().unwrap();
    let mean = |transfer: &str, value: f64| {
        let mut experiment = small_experiment(1);
        experiment["display"]["white_luminance_cd_m2"] = json!(1000);
        experiment["display"]["transfer"] = json!(transfer);
        experiment["video"] = json!({"pattern": {"uniform": {"rgb": [value, value, value]}}});
        experiment["counts"]["noise"] = json!("NONE");
        report(place.path(), &experiment)["frames"][0]["types"]["l"]["mean"].as_f64().unwrap()
    };
    let ratio = mean("PQ", 0.580_689) / mean("LINEAR", 0.203);
    assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
}

/// What red, green and blue of a picture count on L cones over those of a linear picture.
fn ratio(transfer: &Value, values: [f64; 3], linear: [f64; 3]) -> f64 {
    let place = tempdir().unwrap();
    let mean = |transfer: &Value, rgb: [f64; 3]| {
        let mut experiment = small_experiment(1);
        experiment["display"]["white_luminance_cd_m2"] = json!(1000);
        for (field, value) in transfer.as_object().unwrap() {
            experiment["display"][field] = value.clone();
        }
        experiment["video"] = json!({"pattern": {"uniform": {"rgb": rgb}}});
        experiment["counts"]["noise"] = json!("NONE");
        report(place.path(), &experiment)["frames"][0]["types"]["l"]["mean"].as_f64().unwrap()
    };
    mean(transfer, values) / mean(&json!({"transfer": "LINEAR", "contrast": transfer["contrast"]}), linear)
}

/// HLG 75 % is 203 cd/m² on 1000 cd/m² (ITU-R BT.2408); red alone is darker than the red of white, by
/// 0.2627^0.2.
#[test]
fn hlg_has_its_system_gamma() {
    let hlg = json!({"transfer": "HLG"});
    let found = ratio(&hlg, [0.75; 3], [0.203; 3]);
    assert!((found - 1.0).abs() < 3e-3, "{found}");
    let found = ratio(&hlg, [1.0, 0.0, 0.0], [0.765_406, 0.0, 0.0]);
    assert!((found - 1.0).abs() < 1e-4, "{found}");
}

/// BT.1886 with a contrast of 1000: V = 0.3 is (V + β(1 − V))^2.4 of white, β = 0.001^(1/2.4); a plain power
/// adds black.
#[test]
fn black_lifts_bt1886_and_adds_to_a_power() {
    let lifted = (0.3 + 0.7 * 0.001_f64.powf(1.0 / 2.4)).powf(2.4);
    let above_black = |light: f64| (light - 0.001) / 0.999;
    for (transfer, light) in [
        (json!({"transfer": "BT1886", "contrast": 1000}), above_black(lifted)),
        (json!({"transfer": "GAMMA", "gamma": 2.2, "contrast": 1000}), 0.3_f64.powf(2.2)),
    ] {
        let found = ratio(&transfer, [0.3; 3], [light; 3]);
        assert!((found - 1.0).abs() < 1e-4, "{transfer}: {found}");
    }
}

/// Numbers of a transfer that the display does not have would do nothing.
#[test]
fn numbers_of_another_transfer_are_refused() {
    let place = tempdir().unwrap();
    for (field, transfer, words) in [
        ("gamma", "SRGB", ["display.gamma", "needs `transfer` `GAMMA`"]),
        ("hlg_system_gamma", "PQ", ["display.hlg_system_gamma", "needs `transfer` `HLG`"]),
        ("description", "GAMMA", ["display.gamma", "missing"]),
    ] {
        let mut experiment = small_experiment(1);
        experiment["display"]["transfer"] = json!(transfer);
        experiment["display"][field] = if field == "description" { json!("a display") } else { json!(1.3) };
        assert_refused(place.path(), &run(place.path(), &experiment), &words);
    }
}

/// A patch of a screen of 7680 x 4320 pixels.
#[test]
fn a_patch_of_an_8k_screen() {
    let place = tempdir().unwrap();
    let mut experiment = small_experiment(1);
    experiment["display"]["white_luminance_cd_m2"] = json!(100);
    let mean = |experiment: &Value| {
        report(place.path(), experiment)["frames"][0]["types"]["l"]["mean"].as_f64().unwrap()
    };
    experiment["video"] = json!({"pattern": {"uniform": {"rgb": [1, 1, 1]}}});
    experiment["display"]["width_px"] = json!(512);
    experiment["display"]["height_px"] = json!(512);
    let small = mean(&experiment);
    experiment["display"]["width_px"] = json!(7680);
    experiment["display"]["height_px"] = json!(4320);
    let large = mean(&experiment);
    assert!((large / small - 1.0).abs() < 1e-3, "{large} {small}");
}
