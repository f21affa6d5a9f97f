//! A job that misses its accuracy target says so wherever its user looks, and still ends well.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment, texts};

/// Standard output, and the lines on standard error that begin with `warning:`.
fn said(command: &mut Command) -> (String, Vec<String>) {
    let output = command.output().unwrap();
    let (out, err) = texts(&output);
    assert_eq!(output.status.code(), Some(0), "{command:?}\n{out}\n{err}");
    let warnings = err.lines().filter(|line| line.starts_with("warning:")).map(str::to_owned);
    (out, warnings.collect())
}

/// The texts `Warning` of a PNG.
fn texts_of(path: &Path) -> Vec<String> {
    let reader =
        png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap())).read_info().unwrap();
    let texts = reader.info().utf8_text.iter().filter(|text| text.keyword == "Warning");
    texts.map(|text| text.get_text().unwrap()).collect()
}

fn report(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap()
}

/// Numbers by hand that are much too coarse are not judged by the planner; the audit finds it.
#[test]
fn a_missed_target_is_said_wherever_one_looks() {
    let place = tempdir().unwrap();
    let run = |spec: &str, out: &str| {
        said(photoneye(place.path()).args(["run", spec, "--out", out, "--data", "data"]))
    };
    let mut experiment = small_experiment(2);
    fs::write(place.path().join("plain.json"), experiment.to_string()).unwrap();
    experiment["accuracy"] = json!({"target": 1e-4, "audit_cones": 12});
    experiment["counts"]["settings"] = json!({"band_loss": 0.5, "basis_tolerance": 0.5, "field_nodes": 1});
    fs::write(place.path().join("coarse.json"), experiment.to_string()).unwrap();

    // The run that made it: standard error, report, summary and pictures.
    let (summary, warnings) = run("coarse.json", "coarse");
    let out = place.path().join("coarse");
    let found = report(&out);
    let text = found["warnings"][0].as_str().unwrap_or_else(|| panic!("{}", found["audit"]));
    assert!(
        text.starts_with("accuracy: 12 cones computed again") && text.ends_with("accuracy.target 0.0001"),
        "{text}"
    );
    assert!(found["audit"]["lower_bound_95"].as_f64().unwrap() > 1e-4, "{}", found["audit"]);
    let line = format!("warning: {text}");
    assert_eq!(warnings, std::slice::from_ref(&line));
    assert!(summary.contains(&format!("Warning       {text}")), "{summary}");
    for name in ["0000.png", "0001.png", "mean.png"] {
        assert_eq!(texts_of(&out.join("frames").join(name)), [text], "{name}");
    }

    // A job without audit warns of nothing.
    assert!(run("plain.json", "plain").1.is_empty());
    assert_eq!(report(&place.path().join("plain"))["warnings"], json!([]));
    assert!(texts_of(&place.path().join("plain/frames/0000.png")).is_empty());

    // Later, from a server over the same folder.
    let server = Server::start(place.path(), 0);
    let ask = |args: &[&str]| said(photoneye(place.path()).args(args).args(["--server", &server.url]));
    let (listed, _) = ask(&["jobs"]);
    let (plain, coarse) = listed.trim_end().split_once('\n').unwrap();
    assert!(coarse.contains("succeeded!") && coarse.ends_with(&line), "{coarse}");
    assert!(plain.contains("succeeded  ") && !plain.contains("warning"), "{plain}");
    let id = coarse.split(' ').next().unwrap();
    assert_eq!(ask(&["watch", id]).1, std::slice::from_ref(&line));
    let (events, warnings) = ask(&["watch", id, "--json"]);
    assert!(events.contains(text), "{events}");
    assert_eq!(warnings, std::slice::from_ref(&line));
    assert_eq!(ask(&["results", id, "--out", "fetched"]).1, [line]);
    assert_eq!(texts_of(&place.path().join("fetched/frames/0000.png")), [text]);
}
