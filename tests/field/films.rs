//! Films whose rate is not the display's.

use std::fs;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::small_experiment;
use crate::{assert_refused, report, run};

/// Twelve gray pictures, each brighter than the one before, marked as 24 a second.
fn film(rate: &str) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 W8 H8 F{rate} Ip Cmono\n").into_bytes();
    for picture in 0..12_u8 {
        bytes.extend(b"FRAME\n");
        bytes.extend([30 + 15 * picture; 64]);
    }
    bytes
}

/// Half a second of film is 30 refreshes of a display of 60 Hz. It was shown in 12, 2.5 times too fast, silently.
#[test]
fn a_film_of_another_rate_is_shown_in_its_time_or_refused() {
    let place = tempdir().unwrap();
    let experiment = |rate: &str, from_film: Option<&str>| {
        fs::write(place.path().join("film.y4m"), film(rate)).unwrap();
        let mut experiment: Value = small_experiment(1);
        experiment["display"]["frame_rate_hz"] = json!(60);
        experiment["video"] =
            json!({"files": {"paths": ["film.y4m"], "yuv": {"matrix": "BT709", "range": "LIMITED"}}});
        experiment["counts"] = json!({"engine": "EXPECTED", "noise": "NONE"});
        experiment["frames"] = from_film.map_or(json!({}), |how| json!({"from_film": how}));
        experiment
    };
    let output = run(place.path(), &experiment("24:1", None));
    assert_refused(place.path(), &output, &["frames.from_film", "24.000", "60.000", "REPEAT", "ONE_EACH"]);

    // Light of the pictures, one a frame; then each frame shows the picture whose time it is.
    let means = |experiment: &Value| -> Vec<f64> {
        let report = report(place.path(), experiment);
        let frames = report["frames"].as_array().unwrap();
        frames.iter().map(|frame| frame["types"]["l"]["mean"].as_f64().unwrap()).collect()
    };
    let each = means(&experiment("24:1", Some("ONE_EACH")));
    assert!(each.len() == 12 && each.windows(2).all(|pair| pair[1] > 1.05 * pair[0]), "{each:?}");
    let repeated = means(&experiment("24:1", Some("REPEAT")));
    let right: Vec<f64> = (0..30).map(|frame| each[frame * 2 / 5]).collect();
    assert_eq!(repeated, right);
    let left_out = means(&experiment("120:1", Some("REPEAT")));
    assert_eq!(left_out, each.iter().step_by(2).copied().collect::<Vec<f64>>());

    // The same rate, and one that the file does not say, need no word.
    assert_eq!(means(&experiment("60:1", None)), each);
    assert_eq!(means(&experiment("0:0", None)), each);
}
