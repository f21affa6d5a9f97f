//! Counts that do not fit in 32 bits.

use serde_json::json;
use tempfile::tempdir;

use crate::support::small_experiment;
use crate::{assert_refused, report, run};

/// 10⁶ cd/m² for 100 s through 9 mm: 10¹¹ photons a cone. Every count was silently 4,294,967,295.
#[test]
fn counts_beyond_32_bits_are_refused_and_means_are_not() {
    let place = tempdir().unwrap();
    let mut experiment = small_experiment(1);
    experiment["eye"] = json!({"pupil_mm": 9});
    experiment["display"]["white_luminance_cd_m2"] = json!(1e6);
    experiment["display"]["frame_rate_hz"] = json!(0.01);
    experiment["accuracy"]["target"] = json!(0.05);
    let refused = run(place.path(), &experiment);
    assert_refused(
        place.path(),
        &refused,
        &["display.white_luminance_cd_m2", "1000000", "at most", "noise NONE"],
    );

    // Means have no upper limit.
    experiment["counts"]["noise"] = json!("NONE");
    let report = report(place.path(), &experiment);
    let mean = report["frames"][0]["types"]["l"]["mean"].as_f64().unwrap();
    assert!(mean > 1e10, "{mean}");
}
