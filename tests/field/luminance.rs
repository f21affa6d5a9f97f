//! Absolute quantities: a PQ code is a luminance.

use serde_json::json;
use tempfile::tempdir;

use crate::report;
use crate::support::small_experiment;

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
