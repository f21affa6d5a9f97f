//! What must hold in the tree: who may know whom, every file says what it is, the pages name what is there.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Every file below a folder with an ending, by path from the root.
fn files(folder: &str, ending: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_string_lossy().ends_with(ending) {
                found.push(path.strip_prefix(root()).unwrap().to_string_lossy().into_owned());
            }
        }
    }
    found.sort();
    found
}

/// Code without comments, up to the tests of the file.
fn code(path: &str) -> String {
    let text = read(path);
    let text = text.split("#[cfg(test)]").next().unwrap_or_default();
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

const CRATES: [&str; 6] = ["proto", "eye", "store", "server", "worker", "client"];

/// The crates that a crate names under [dependencies].
fn dependencies(crate_folder: &str) -> BTreeSet<String> {
    let text = read(format!("{crate_folder}/Cargo.toml"));
    let section = text.split("\n[dependencies]").nth(1).unwrap_or_default();
    let section = section.split("\n[").next().unwrap_or_default();
    let names = section.lines().filter_map(|line| line.split(['.', ' ', '=']).next());
    names.filter(|name| !name.is_empty() && !name.starts_with('#')).map(str::to_owned).collect()
}

#[test]
fn crates_know_only_whom_they_may() {
    let allowed: [(&str, &[&str]); 6] = [
        ("eye", &[]),
        ("proto", &[]),
        ("store", &[]),
        ("worker", &["eye", "proto", "store"]),
        ("server", &["eye", "proto", "store"]),
        ("client", &["proto"]),
    ];
    for (name, may) in allowed {
        let dependencies = dependencies(name);
        for other in CRATES {
            let known = dependencies.contains(&format!("photoneye-{other}"));
            assert!(!known || may.contains(&other), "{name} must not know {other}");
            for file in files(&format!("{name}/src"), ".rs") {
                let used = code(&file).contains(&format!("photoneye_{other}::"));
                assert!(!used || may.contains(&other), "{file} must not use {other}");
            }
        }
    }
}

#[test]
fn heavy_crates_stay_in_their_place() {
    let homes: [(&str, &[&str]); 4] =
        [("sqlx", &["server"]), ("axum", &["server"]), ("rayon", &["eye"]), ("rustfft", &["eye"])];
    for (heavy, may) in homes {
        for name in CRATES.into_iter().chain(["."]) {
            assert!(
                !dependencies(name).contains(heavy) || may.contains(&name),
                "{name} must not depend on {heavy}"
            );
        }
    }
    for asynchronous in ["tokio", "tonic", "prost", "futures", "tracing"] {
        assert!(!dependencies("eye").contains(asynchronous), "eye must not depend on {asynchronous}");
    }
}

#[test]
fn the_model_does_no_input_or_output_and_reads_no_clock() {
    let forbidden = [
        "std::fs",
        "std::net",
        "std::time",
        "std::env::",
        "std::process",
        "std::thread",
        "std::io::stdin",
        "SystemTime",
        "Instant::",
        "static mut",
        "Mutex",
        "async fn",
    ];
    for file in files("eye/src", ".rs") {
        let code = code(&file);
        for word in forbidden {
            assert!(!code.contains(word), "{file} names {word}");
        }
    }
}

#[test]
fn no_code_behind_the_lowering_names_a_device_or_an_eye() {
    let names = files("data/displays", ".json").into_iter().chain(files("data/eyes", ".json"));
    let names: Vec<String> =
        names.filter_map(|path| Some(Path::new(&path).file_stem()?.to_string_lossy().into_owned())).collect();
    assert!(!names.is_empty());
    for folder in ["exposure", "optics", "psf", "retina", "cone", "movement", "picture"] {
        for file in files(&format!("eye/src/{folder}"), ".rs") {
            for name in &names {
                assert!(!code(&file).contains(name.as_str()), "{file} names {name}");
            }
        }
    }
}

#[test]
fn every_source_file_opens_by_saying_what_it_is() {
    for folder in CRATES.into_iter().chain(["src", "tests", "examples", "benches"]) {
        for file in files(folder, ".rs") {
            assert!(read(&file).starts_with("//!"), "{file} does not open with //!");
        }
    }
}

#[test]
fn the_code_map_names_every_crate_and_every_module_of_the_model() {
    let page = read("ARCHITECTURE.md");
    let manifest = read("Cargo.toml");
    let members = manifest.split("members = [").nth(1).unwrap().split(']').next().unwrap().to_owned();
    for member in members.split(',').map(|name| name.trim().trim_matches('"')) {
        assert!(page.contains(&format!("`{member}/`")), "the code map does not name {member}/");
    }
    let modules = read("eye/src/lib.rs");
    let modules = modules.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'));
    for module in modules {
        let named = [format!("`{module}.rs`"), format!("`{module}/`")];
        assert!(named.iter().any(|name| page.contains(name)), "the code map does not name eye's {module}");
    }
}

#[test]
fn every_invariant_names_a_test_that_is_there() {
    let page = read("ARCHITECTURE.md");
    let section = page.split("\n## Invariants").nth(1).unwrap().split("\n## ").next().unwrap();
    let invariants: Vec<&str> =
        section.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())).collect();
    assert_eq!(invariants.len(), 11);
    for invariant in invariants {
        let named: Vec<&str> = invariant.split('`').filter(|word| word.contains("::")).collect();
        assert!(!named.is_empty(), "no test is named: {invariant}");
        for name in named {
            let (file, test) = name.split_once("::").unwrap();
            assert!(read(file).contains(&format!("fn {test}(")), "{file} has no test {test}");
        }
    }
}

#[test]
fn every_data_file_has_its_source() {
    let sources = read("data/SOURCES.md");
    for folder in ["spectra", "eyes", "displays", "experiments"] {
        for file in files(&format!("data/{folder}"), "") {
            let name = file.strip_prefix("data/").unwrap();
            let hidden = name.contains("/.");
            assert!(hidden || sources.contains(name), "data/SOURCES.md does not name {name}");
        }
    }
}
