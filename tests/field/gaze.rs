//! Recorded gazes from files: columns by name and unit, clocks that do not cover the frames; specs of Windows' editors.

use std::fs;
use std::io::{BufWriter, Write as _};

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{photoneye, small_experiment, succeed};
use crate::{assert_refused, report, run};

/// Three frames at 60 Hz with a recorded gaze.
fn with(recorded: Value) -> Value {
    let mut experiment = small_experiment(3);
    experiment["display"]["frame_rate_hz"] = json!(60);
    experiment["gaze"] = json!({"movement": {"recorded": recorded}});
    experiment
}

/// Columns in another order, degrees and milliseconds gave other places, or none, without a word.
#[test]
fn columns_of_a_file_have_names_and_units() {
    let place = tempdir().unwrap();
    let folder = place.path();
    let wanted = report(folder, &with(json!({"t_s": [0, 0.05], "x_arcmin": [3, 1.5], "y_arcmin": [1.5, 0]})));
    for text in [
        "t_s,y_arcmin,x_arcmin\n0,1.5,3\n0.05,0,1.5\n",
        "t_ms;x_deg;y_deg\r\n0;0.05;0.025\r\n50;0.025;0\r\n",
        "\u{feff}t_s,x_arcmin,y_arcmin\n0,3,1.5\n0.05,1.5,0\n",
    ] {
        fs::write(folder.join("gaze.csv"), text).unwrap();
        let found = report(folder, &with(json!({"file": "gaze.csv"})));
        assert_eq!(found["digests"]["result"], wanted["digests"]["result"], "{text}");
    }
    for (text, words) in [
        ("0,3,1.5\n0.05,1.5,0\n", ["line 1", "t_s or t_ms", "x_arcmin or x_deg"]),
        ("t_s,x_px,y_px\n0,3,1.5\n", ["line 1", "x_px", "y_arcmin or y_deg"]),
        ("t_s,x_deg,y_deg\n0,3\n", ["line 2", "0,3", "three numbers"]),
    ] {
        fs::write(folder.join("gaze.csv"), text).unwrap();
        assert_refused(folder, &run(folder, &with(json!({"file": "gaze.csv"}))), &words);
    }
}

/// A clock that runs since yesterday, or a recording that ends early: the eye stood still, without a word.
#[test]
fn recordings_cover_the_frames_or_hold() {
    let place = tempdir().unwrap();
    let folder = place.path();
    for (t_s, words) in [
        ([2000.0, 2000.1], ["gaze.movement.recorded.t_s", "2000 to 2000.1 s", "0 to 0.050000 s"]),
        ([0.0, 0.01], ["gaze.movement.recorded.t_s", "0 to 0.01 s", "extend: HOLD"]),
    ] {
        let mut recorded = json!({"t_s": t_s, "x_arcmin": [0, 3], "y_arcmin": [0, 0]});
        assert_refused(folder, &run(folder, &with(recorded.clone())), &words);
        recorded["extend"] = json!("HOLD");
        report(folder, &with(recorded));
    }
}

/// An hour at 1 kHz, 3.6 million samples, is uploaded and read by server and worker; its first frames are
/// those of its first samples. It was refused as larger than 1 MiB.
#[test]
fn an_hour_of_recording_is_read() {
    let place = tempdir().unwrap();
    let folder = place.path();
    let sample = |i: u32| {
        let t_s = 1e-3 * f64::from(i);
        [t_s, 30.0 * (3.0 * t_s).sin(), 20.0 * (5.0 * t_s).sin()]
    };
    let mut file = BufWriter::new(fs::File::create(folder.join("hour.csv")).unwrap());
    writeln!(file, "t_s,x_arcmin,y_arcmin").unwrap();
    for [t_s, x, y] in (0..3_600_000).map(sample) {
        writeln!(file, "{t_s},{x},{y}").unwrap();
    }
    file.flush().unwrap();
    let hour = report(folder, &with(json!({"file": "hour.csv"})));
    let first: Vec<[f64; 3]> = (0..100).map(sample).collect();
    let column = |k: usize| -> Vec<f64> { first.iter().map(|sample| sample[k]).collect() };
    let inline = json!({"t_s": column(0), "x_arcmin": column(1), "y_arcmin": column(2)});
    assert_eq!(hour["digests"]["result"], report(folder, &with(inline))["digests"]["result"]);
    assert!(hour["spec"]["gaze"]["movement"]["recorded"]["blob"].is_string(), "{}", hour["spec"]);
}

/// The frames of a film are known when its file was read: a recording that covers the first alone was taken
/// for all.
#[test]
fn recordings_cover_the_frames_of_a_film() {
    let place = tempdir().unwrap();
    let folder = place.path();
    let mut film = b"YUV4MPEG2 W8 H8 F60:1 Ip Cmono\n".to_vec();
    for _ in 0..5 {
        film.extend(b"FRAME\n");
        film.extend([100; 64]);
    }
    fs::write(folder.join("film.y4m"), film).unwrap();
    let mut experiment = with(json!({"t_s": [0, 0.02], "x_arcmin": [0, 3], "y_arcmin": [0, 0]}));
    experiment["frames"] = json!({});
    experiment["video"] =
        json!({"files": {"paths": ["film.y4m"], "yuv": {"matrix": "BT709", "range": "LIMITED"}}});
    let words = ["gaze.movement.recorded.t_s", "0 to 0.02 s", "0 to 0.083333 s"];
    assert_refused(folder, &run(folder, &experiment), &words);
}

/// A byte order mark before a spec does no harm.
#[test]
fn a_spec_with_a_byte_order_mark_is_read() {
    let place = tempdir().unwrap();
    let folder = place.path();
    fs::write(folder.join("spec.json"), format!("\u{feff}{}", small_experiment(1))).unwrap();
    succeed(photoneye(folder).args(["plan", "spec.json"]));
}
