//! Bad input: one clear line that names what is wrong, the right exit code, no panic, no half-written result.

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment, texts};

/// Asserts one line `photoneye: …` with the words, and the exit code.
fn assert_refused(output: &Output, code: i32, words: &[&str]) {
    let (_, err) = texts(output);
    let line = err.lines().last().unwrap_or_default();
    assert_eq!(output.status.code(), Some(code), "{err}");
    assert!(line.starts_with("photoneye: "), "{err}");
    assert!(!err.contains("panicked"), "{err}");
    for word in words {
        assert!(line.contains(word), "`{word}` is not in `{line}`");
    }
}

fn with_picture(name: &str) -> Value {
    let mut experiment = small_experiment(1);
    experiment["video"] = json!({"files": {"paths": [name]}});
    experiment
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![90; 3 * (width * height) as usize]).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A picture whose header promises 20000 x 20000 pixels.
fn huge_png() -> Vec<u8> {
    let mut bytes = png(1, 1);
    bytes[16..20].copy_from_slice(&20_000_u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&20_000_u32.to_be_bytes());
    let mut crc = !0_u32;
    for byte in &bytes[12..29] {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    bytes
}

#[test]
fn wrong_experiments_are_refused_by_name() {
    let place = tempdir().unwrap();
    let run = |args: &[&str]| {
        let output = photoneye(place.path()).args(["run", "spec.json", "--out", "o"]).args(args).output();
        assert!(!place.path().join("o").exists());
        output.unwrap()
    };
    assert_refused(&run(&[]), 2, &["spec.json", "no such file"]);
    fs::write(place.path().join("spec.json"), "{").unwrap();
    assert_refused(&run(&[]), 2, &["spec.json", "not JSON"]);
    fs::write(place.path().join("spec.json"), small_experiment(1).to_string()).unwrap();
    for (change, words) in [
        ("eye.pupill_mm=3", ["eye.pupill_mm", "unknown field"]),
        ("eye.pupil_mm=big", ["eye.pupil_mm", "number"]),
        ("eye.pupil_mm=99", ["eye.pupil_mm", "0.5"]),
        ("eye.preset=mine", ["eye.preset", "mine"]),
        ("counts.engine=FAST", ["counts.engine", "EXPECTED"]),
        ("frames.count=-1", ["frames.count", "-1"]),
        ("video.files.paths=[\"x.png\"]", ["video", ""]),
        ("eye", ["--set eye", "PATH=VALUE"]),
    ] {
        assert_refused(&run(&["--set", change]), 2, &words);
    }
    let unknown = format!("video={{\"clip\": {{\"blobs\": [\"b3:{}/9\"]}}}}", "0".repeat(64));
    assert_refused(&run(&["--set", &unknown]), 2, &["video.clip.blobs"]);
}

#[test]
fn wrong_pictures_are_refused_by_name() {
    let place = tempdir().unwrap();
    let files: [(&str, Option<Vec<u8>>, &str); 5] = [
        ("missing.png", None, "no such file"),
        ("empty.png", Some(Vec::new()), "empty"),
        ("text.png", Some(b"hello".to_vec()), "PNG"),
        ("huge.png", Some(huge_png()), "20000x20000"),
        ("small.png", Some(png(5, 4)), "5 x 4"),
    ];
    for (name, bytes, word) in files {
        if let Some(bytes) = bytes {
            fs::write(place.path().join(name), bytes).unwrap();
        }
        fs::write(place.path().join("spec.json"), with_picture(name).to_string()).unwrap();
        let output = photoneye(place.path()).args(["run", "spec.json", "--out", "o"]).output().unwrap();
        assert_refused(&output, 2, &[name, word]);
        assert!(!place.path().join("o").exists());
    }
}

#[test]
fn wrong_places_are_refused_by_name() {
    let place = tempdir().unwrap();
    fs::write(place.path().join("spec.json"), small_experiment(1).to_string()).unwrap();
    fs::write(place.path().join("file"), "").unwrap();
    let call = |args: &[&str]| photoneye(place.path()).args(args).output().unwrap();

    // A file where a folder should be is not writable for anybody, root included.
    assert_refused(&call(&["run", "spec.json", "--data", "file/data"]), 1, &["file/data"]);
    assert_refused(&call(&["serve", "--listen", "127.0.0.1:0", "--data", "file/data"]), 1, &["file/data"]);
    assert_refused(&call(&["run", "spec.json", "--out", "file"]), 2, &["file", "not a folder"]);
    assert_refused(&call(&["run", "spec.json", "--server", "nonsense"]), 2, &["nonsense"]);
    assert_refused(&call(&["render", "nowhere"]), 2, &["nowhere/cones.arrow"]);
    assert_refused(&call(&["serve", "--listen", "0.0.0.0:0"]), 2, &["--insecure"]);
    assert_refused(&call(&["serve", "--listen", "here"]), 2, &["here"]);
    fs::write(place.path().join("photoneye.toml"), "wrokers = 1").unwrap();
    assert_refused(&call(&["jobs"]), 2, &["photoneye.toml", "wrokers"]);
    fs::remove_file(place.path().join("photoneye.toml")).unwrap();

    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    assert_refused(&call(&["serve", "--listen", &address]), 1, &[&address, "in use"]);
    assert_eq!(call(&["frobnicate"]).status.code(), Some(2));
    assert_eq!(call(&["--help"]).status.code(), Some(0));
}

#[test]
fn wrong_requests_are_answered_and_the_server_lives_on() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 1);
    let bodies = [
        String::new(),
        "[]".into(),
        "{\"eye\": null, \"eye\": {}}".into(),
        "{\"video\": {}}".into(),
        "\u{0}".into(),
        "[".repeat(100_000),
        format!("{{\"eye\": {{\"preset\": \"{}\"}}}}", "x".repeat(1000)),
    ];
    for body in bodies {
        let (status, problem) = server.post("/v1/jobs", None, &body);
        let shown: String = body.chars().take(60).collect();
        assert!((400..500).contains(&status), "`{shown}` gave {status} {problem}");
    }
    // A body over the limit may be answered before it is read; then the connection is closed.
    let large = format!("{{\"eye\": {{\"preset\": \"{}\"}}}}", "x".repeat(2 << 20));
    if let Ok(reply) = server.try_post("/v1/jobs", None, &large) {
        assert_eq!(reply.status().as_u16(), 413);
    }
    // Pictures are judged when a job names them.
    for bytes in [Vec::new(), b"hello".to_vec(), huge_png(), png(5, 4)] {
        let (status, blob) = server.put_blob(&bytes);
        assert!((200..300).contains(&status), "{status} {blob}");
        let mut experiment = small_experiment(1);
        experiment["video"] = json!({"clip": {"blobs": [blob["digest"]]}});
        let (status, problem) = server.post("/v1/jobs", None, &experiment.to_string());
        assert!((400..500).contains(&status), "{status} {problem}");
        assert!(problem.to_string().contains("video.clip.blobs"), "{problem}");
    }
    server.success(&server.submit(&small_experiment(1)));
    assert!(Path::new(place.path()).join("data").is_dir());
}
