//! Films and pictures of every kind through the whole service, and the displays that are offered.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{photoneye, read_npy, small_experiment, succeed, texts};

const SIDE: usize = 8;

/// Two frames of grey values: a ramp and its reverse.
fn frames() -> [Vec<u8>; 2] {
    let ramp: Vec<u8> = (0..SIDE * SIDE).map(|i| (4 * i) as u8).collect();
    let back = ramp.iter().rev().copied().collect();
    [ramp, back]
}

fn spec(video: &Value) -> Value {
    let mut spec = small_experiment(2);
    spec["video"] = video.clone();
    spec.as_object_mut().unwrap().remove("frames");
    spec["display"]["lag_ms"] = json!(4);
    spec
}

/// Runs a spec; gives shape and words of counts.npy.
fn counts(place: &Path, spec: &Value) -> (Vec<usize>, Vec<u32>) {
    fs::write(place.join("spec.json"), spec.to_string()).unwrap();
    succeed(photoneye(place).args(["run", "spec.json", "--out", "o"]));
    read_npy(&fs::read(place.join("o/counts.npy")).unwrap())
}

/// The same two frames as PGM, PPM, raw RGB and full-range mono Y4M give the same counts.
#[test]
fn every_kind_of_file_gives_the_same_counts() {
    let place = tempdir().unwrap();
    let place = place.path();
    let mut raw = Vec::new();
    let mut film = format!("YUV4MPEG2 W{SIDE} H{SIDE} F60:1 Ip A1:1 Cmono XCOLORRANGE=FULL\n").into_bytes();
    for (i, frame) in frames().iter().enumerate() {
        let rgb: Vec<u8> = frame.iter().flat_map(|v| [*v; 3]).collect();
        let head = |kind: &str| format!("{kind} {SIDE} {SIDE} 255\n").into_bytes();
        fs::write(place.join(format!("{i}.pgm")), [head("P5"), frame.clone()].concat()).unwrap();
        let text: Vec<String> = rgb.iter().map(u8::to_string).collect();
        fs::write(place.join(format!("{i}.ppm")), [head("P3"), text.join(" ").into_bytes()].concat())
            .unwrap();
        film.extend([b"FRAME\n".as_slice(), frame].concat());
        raw.extend(rgb);
    }
    fs::write(place.join("film.y4m"), &film).unwrap();
    fs::write(place.join("film.rgb"), &raw).unwrap();
    let yuv = json!({"matrix": "BT709", "range": "FULL"});
    let expected = counts(place, &spec(&json!({"files": {"paths": ["0.pgm", "1.pgm"]}})));
    assert_eq!(expected.0[0], 2, "a frame a picture");
    assert!(expected.1.iter().any(|count| *count > 0));
    for video in [
        json!({"paths": ["0.ppm", "1.ppm"]}),
        json!({"paths": ["film.rgb"], "raw": {"bits": 8}}),
        json!({"paths": ["film.y4m"], "yuv": yuv}),
    ] {
        assert!(counts(place, &spec(&json!({"files": video}))) == expected, "{video}");
    }

    // What is wrong with a film is said with its name.
    fs::write(place.join("cut.y4m"), &film[..film.len() - 1]).unwrap();
    for (video, words) in [
        (json!({"paths": ["film.y4m"]}), ["film.y4m", "needs `yuv`"]),
        (json!({"paths": ["cut.y4m"], "yuv": yuv}), ["cut.y4m", "frame 1 is cut off"]),
        (json!({"paths": ["film.rgb"], "raw": {"bits": 16}}), ["film.rgb", "128"]),
        (json!({"paths": ["film.rgb"], "raw": {"bits": 12}}), ["raw.bits", "8 or 16"]),
        (json!({"paths": ["film.y4m", "0.pgm"], "yuv": yuv}), ["film.y4m", "only file"]),
    ] {
        let mut spec = spec(&json!({"files": video}));
        if words[1] == "128" {
            // 384 bytes are one frame of 8 x 8 pixels of 16 bit; an odd width fits no more.
            spec["display"]["width_px"] = json!(7);
        }
        fs::write(place.join("spec.json"), spec.to_string()).unwrap();
        let output = photoneye(place).args(["run", "spec.json", "--out", "bad"]).output().unwrap();
        let (_, err) = texts(&output);
        assert_eq!(output.status.code(), Some(2), "{err}");
        let first = words[0];
        assert!(err.contains(first) && (words[1] == "128" || err.contains(words[1])), "{video}: {err}");
    }
}

/// A recorded path from a CSV file is the same as its numbers in the spec.
#[test]
fn a_recorded_path_comes_from_a_file_or_the_spec() {
    let place = tempdir().unwrap();
    let place = place.path();
    fs::write(place.join("path.csv"), "t_s,x_arcmin,y_arcmin\n0,0,0\n0.02,2,-1\n0.04,2,0\n").unwrap();
    let with = |recorded: Value| {
        let mut spec = small_experiment(2);
        spec["gaze"] = json!({"movement": {"recorded": recorded}});
        counts(place, &spec)
    };
    let given = with(json!({"t_s": [0, 0.02, 0.04], "x_arcmin": [0, 2, 2], "y_arcmin": [0, -1, 0]}));
    assert!(with(json!({"file": "path.csv"})) == given);
    fs::write(place.join("path.csv"), "t_s,x_arcmin,y_arcmin\n0,0\n").unwrap();
    let mut spec = small_experiment(1);
    spec["gaze"] = json!({"movement": {"recorded": {"file": "path.csv"}}});
    fs::write(place.join("spec.json"), spec.to_string()).unwrap();
    let output = photoneye(place).args(["run", "spec.json"]).output().unwrap();
    assert!(texts(&output).1.contains("line 2"));
}

/// Every display can be planned as it is, and says where it comes from.
#[test]
fn every_display_is_listed_and_can_be_planned() {
    let place = tempdir().unwrap();
    let place = place.path();
    let list = succeed(photoneye(place).args(["displays", "--json"]));
    let list: Value = serde_json::from_str(&list).unwrap();
    let displays = list["displays"].as_array().unwrap();
    for name in
        ["crt", "lcd-ccfl", "lcd-wled", "oled", "dlp", "lcos-3chip", "laser-projector", "printout-1200dpi"]
    {
        assert!(displays.iter().any(|d| d["name"] == name), "{name}");
    }
    for display in displays {
        let name = display["name"].as_str().unwrap();
        for part in ["description", "source", "licence"] {
            assert!(display["display"][part].as_str().is_some_and(|text| text.len() > 3), "{name} {part}");
        }
        let mut spec = small_experiment(1);
        spec["display"] = json!({"preset": name});
        fs::write(place.join("spec.json"), spec.to_string()).unwrap();
        succeed(photoneye(place).args(["plan", "spec.json", "--json"]));
    }
}
