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
    assert_refused(
        place.path(),
        &output,
        &["frames.from_film", "24.000", "60.000", "REPEAT", "RESAMPLE", "ONE_EACH"],
    );

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

    // The mean light of a frame's time: of 24 pictures a second every third frame of 60 is half of two.
    let resampled = means(&experiment("24:1", Some("RESAMPLE")));
    let half = |a: usize, b: usize| 0.5 * (each[a] + each[b]);
    for (frame, right) in [(0, each[0]), (1, each[0]), (2, half(0, 1)), (3, each[1]), (7, half(2, 3))] {
        assert!((resampled[frame] / right - 1.0).abs() < 1e-5, "{frame}: {} {right}", resampled[frame]);
    }
    let averaged = means(&experiment("120:1", Some("RESAMPLE")));
    assert!(averaged.len() == 6 && (averaged[1] / half(2, 3) - 1.0).abs() < 1e-5, "{averaged:?}");

    // The same rate, and one that the file does not say, need no word.
    assert_eq!(means(&experiment("60:1", None)), each);
    assert_eq!(means(&experiment("0:0", None)), each);
}

/// Where chroma samples stand changes the colours beside an edge; a film that does not say it was taken as
/// JPEG's.
#[test]
fn chroma_stands_where_the_film_says_or_is_asked_for() {
    let place = tempdir().unwrap();
    let experiment = |space: &str, siting: Option<&str>| {
        // Gray, and red on the right of column 2.
        let mut bytes = format!("YUV4MPEG2 W8 H8 F60:1 Ip{space}\nFRAME\n").into_bytes();
        bytes.extend([120; 64]);
        bytes.extend([128; 16]);
        bytes.extend([128, 190, 190, 190].repeat(4));
        fs::write(place.path().join("film.y4m"), bytes).unwrap();
        let mut experiment: Value = small_experiment(1);
        let mut yuv = json!({"matrix": "BT709", "range": "LIMITED"});
        if let Some(siting) = siting {
            yuv["chroma_siting"] = json!(siting);
        }
        experiment["video"] = json!({"files": {"paths": ["film.y4m"], "yuv": yuv}});
        experiment["counts"] = json!({"engine": "EXPECTED", "noise": "NONE"});
        experiment
    };
    let mean = |space: &str, siting: Option<&str>| {
        report(place.path(), &experiment(space, siting))["frames"][0]["types"]["l"]["mean"].as_f64().unwrap()
    };
    let [jpeg, mpeg, dv] = [" C420jpeg", " C420mpeg2", " C420paldv"].map(|space| mean(space, None));
    // Chroma changes along columns only, so that rows do not matter.
    assert!((mpeg / jpeg - 1.0).abs() > 1e-3 && (dv / mpeg - 1.0).abs() < 1e-6, "{jpeg} {mpeg} {dv}");
    for (siting, of_header) in [("CENTER", jpeg), ("LEFT", mpeg), ("TOP_LEFT", dv)] {
        assert!((mean(" C420", Some(siting)) / of_header - 1.0).abs() < 1e-9);
    }
    // The format's own default.
    assert!((mean("", None) / jpeg - 1.0).abs() < 1e-9);
    for (space, siting, word) in [
        (" C420", None, "is missing"),
        (" C420jpeg", Some("LEFT"), "contradicts"),
        (" C444", Some("LEFT"), "no meaning"),
    ] {
        let output = run(place.path(), &experiment(space, siting));
        assert_refused(place.path(), &output, &["yuv.chroma_siting", word]);
    }
}
