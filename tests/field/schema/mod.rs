//! Every field of an experiment does something: in a scene where it matters it changes the counts or the
//! plan, or it is refused. `fields.json` has the scenes; a field of the schema that is in none of them fails
//! the test.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet};
use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::Server;

/// Longest time for all jobs.
const PATIENCE: Duration = Duration::from_mins(10);

/// A small scene that the others change.
fn base() -> Value {
    json!({
        "display": {"preset": "lcos-3chip", "width_px": 8, "height_px": 8},
        "video": {"pattern": {"checkerboard": {"square_px": 2}}},
        "retina": {"region_deg": {"x_min": -0.05, "x_max": 0.05, "y_min": -0.05, "y_max": 0.05}},
        "counts": {"seed": 5, "noise": "NONE", "engine": "EXPECTED"},
        "accuracy": {"target": 0.05, "audit_cones": 0},
        "frames": {"count": 1}
    })
}

/// Puts the fields of an object into another, object by object.
fn merge(into: &mut Value, from: &Value) {
    match (into, from) {
        (Value::Object(into), Value::Object(from)) => {
            for (name, value) in from {
                merge(into.entry(name).or_insert(Value::Null), value);
            }
        }
        (into, from) => *into = from.clone(),
    }
}

/// Sets `a.b[0].c`.
fn set(root: &mut Value, path: &str, value: &Value) {
    let mut place = root;
    for step in path.replace('[', ".[").split('.') {
        if let Some(index) = step.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            place = &mut place[index.parse::<usize>().unwrap()];
            continue;
        }
        if place.is_null() {
            *place = json!({});
        }
        place = place.as_object_mut().unwrap().entry(step).or_insert(Value::Null);
    }
    *place = value.clone();
}

type Messages = BTreeMap<String, DescriptorProto>;

/// Adds a message and those inside it, by full name.
fn gather(prefix: &str, message: &DescriptorProto, messages: &mut Messages) {
    let name = format!("{prefix}.{}", message.name());
    for nested in &message.nested_type {
        gather(&name, nested, messages);
    }
    messages.insert(name, message.clone());
}

/// Adds the fields of a message that hold no others, below a path.
fn walk(name: &str, path: &str, messages: &Messages, found: &mut BTreeSet<String>) {
    for field in &messages[name].field {
        let dot = if path.is_empty() { "" } else { "." };
        let list = if field.label() == Label::Repeated { "[]" } else { "" };
        let path = format!("{path}{dot}{}{list}", field.name());
        if field.r#type() == Type::Message && !messages[field.type_name()].field.is_empty() {
            walk(field.type_name(), &path, messages, found);
        } else {
            found.insert(path);
        }
    }
}

/// Paths of all fields that hold no others; lists end with `[]`.
fn all_fields() -> BTreeSet<String> {
    let set = FileDescriptorSet::decode(photoneye_proto::FILE_DESCRIPTOR_SET).unwrap();
    let mut messages = Messages::new();
    for file in &set.file {
        for message in &file.message_type {
            gather(&format!(".{}", file.package()), message, &mut messages);
        }
    }
    let mut found = BTreeSet::new();
    walk(".photoneye.v1.Experiment", "", &messages, &mut found);
    found
}

/// Adds the fields that a change sets, in the form of [`all_fields`].
fn fields_of(path: &str, value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) if !fields.is_empty() => {
            for (name, value) in fields {
                fields_of(&format!("{path}.{name}"), value, found);
            }
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            for item in items {
                fields_of(&format!("{path}[]"), item, found);
            }
        }
        other => {
            let list = if other.is_array() { "[]" } else { "" };
            let parts: Vec<&str> = path.split('[').collect();
            let after = |part: &&str| ["[]", part.split_once(']').unwrap().1].concat();
            let plain = parts[0].to_owned() + &parts[1..].iter().map(after).collect::<String>();
            found.insert(plain + list);
        }
    }
}

/// A film of two pictures, 4:2:0, rows of chroma alike.
fn film(rate: &str, luma: u8) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 W8 H8 F{rate} Ip C420\n").into_bytes();
    for picture in 0..2_u8 {
        bytes.extend(b"FRAME\n");
        bytes.extend((0..64).map(|i| luma + 5 * (i % 8) + 40 * picture));
        bytes.extend([128, 150, 140, 120].repeat(4));
        bytes.extend([128, 190, 170, 130].repeat(4));
    }
    bytes
}

/// A hexagonal lattice that is not classified.
fn mosaic(spacing: f64) -> Vec<u8> {
    let mut rows = String::from("x_um,y_um,type\n");
    for (i, j) in (-8..=8).flat_map(|j| (-8..=8).map(move |i| (i, j))) {
        let (i, j) = (f64::from(i), f64::from(j));
        let (x, y) = (spacing * (i + 0.5 * (j.abs() % 2.0)), spacing * 0.75_f64.sqrt() * j);
        writeln!(rows, "{x},{y},U").unwrap();
    }
    rows.into_bytes()
}

/// The uploads of the scenes, by the word that stands for each.
fn uploads(server: &Server) -> BTreeMap<&'static str, String> {
    // 60 pictures a second are a frame each.
    let raw: Vec<u8> = (0..8 * 8 * 3 * 2).map(|i| (i * 37 % 251) as u8).collect();
    let files = [
        ("$film24", film("24:1", 60)),
        ("$film", film("60:1", 60)),
        ("$other_film", film("60:1", 90)),
        ("$raw", raw),
        ("$gaze", b"t_s,x_arcmin,y_arcmin\n0,1,2\n1,2,3\n".to_vec()),
        ("$other_gaze", b"t_s,x_arcmin,y_arcmin\n0,1,2\n1,20,30\n".to_vec()),
        ("$mosaic", mosaic(3.0)),
        ("$other_mosaic", mosaic(4.0)),
    ];
    files
        .into_iter()
        .map(|(name, bytes)| {
            let (status, reply) = server.put_blob(&bytes);
            assert_eq!(status, 201, "{reply}");
            (name, reply["digest"].as_str().unwrap().to_owned())
        })
        .collect()
}

/// What a job is compared by.
#[derive(Clone, PartialEq)]
struct Outcome {
    counts: Vec<u8>,
    /// The plan without the experiment itself, and the number of cones that were audited.
    plan: String,
}

/// Waits for a job and gives its outcome.
fn outcome(server: &Server, id: &str, started: Instant) -> Result<Outcome, String> {
    let path = ["/v1/jobs/", id].concat();
    loop {
        let job = server.get_json(&path);
        match job["state"].as_str() {
            Some("SUCCEEDED") => break,
            Some("FAILED" | "CANCELLED") => return Err(job["error"].to_string()),
            _ => assert!(started.elapsed() < PATIENCE, "jobs take too long"),
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let report = server.get_json(&[&path, "/report"].concat());
    let mut plan = report["plan"].clone();
    for of_the_experiment in ["experiment_digest", "spec", "artifacts"] {
        plan.as_object_mut().unwrap().remove(of_the_experiment);
    }
    // What was built before is no matter of the experiment.
    let omissions = plan["omissions"].as_array_mut().unwrap();
    omissions.retain(|omission| omission["what"] != json!("artifacts that are there already"));
    let (status, counts) = server.get(&[&path, "/counts.npy"].concat());
    assert_eq!(status, 200);
    let (photons, _) = server.get(&[&path, "/photons.arrow"].concat());
    Ok(Outcome { counts, plan: format!("{plan} {} {photons}", report["audit"]["cones"]) })
}

/// What a change is to do.
const CLASSES: [&str; 4] = ["counts_change", "plan_changes", "nothing_changes", "refused"];

/// A job of a changed scene.
struct Changed {
    path: String,
    class: &'static str,
    /// Job of the scene as it is, and of the changed one.
    jobs: [String; 2],
}

/// What was asked for.
#[derive(Default)]
struct Asked {
    changed: Vec<Changed>,
    /// Fields that were changed.
    fields: BTreeSet<String>,
    wrong: Vec<String>,
}

impl Asked {
    /// Asks for a scene and all changes of it.
    fn scene(&mut self, server: &Server, uploads: &BTreeMap<&str, String>, scene: &Value) {
        let create = |experiment: &Value| -> (u16, Value) {
            // The longest word first: one is the beginning of another.
            let text = uploads.iter().rev().fold(experiment.to_string(), |text, (word, digest)| {
                text.replace(&format!("\"{word}\""), &json!(digest).to_string())
            });
            server.post("/v1/jobs", None, &text)
        };
        let mut experiment = base();
        // A picture of the scene takes the place of the base's.
        if scene["scene"]["video"].is_object() {
            experiment["video"] = json!({});
        }
        merge(&mut experiment, &scene["scene"]);
        let (status, job) = create(&experiment);
        if status != 201 {
            self.wrong.push(format!("{}: {job}", scene["scene"]));
            return;
        }
        let of_scene = job["id"].as_str().unwrap();
        for class in CLASSES {
            for (path, value) in scene[class].as_object().into_iter().flatten() {
                fields_of(path, value, &mut self.fields);
                let mut changed = experiment.clone();
                set(&mut changed, path, value);
                let (status, reply) = create(&changed);
                let said: String = reply.to_string().chars().take(300).collect();
                match (class, status) {
                    ("refused", 400..=499) => {}
                    ("refused", _) => self.wrong.push(format!("{path} is not refused: {said}")),
                    (_, 200 | 201) => {
                        let jobs = [of_scene.to_owned(), reply["id"].as_str().unwrap().to_owned()];
                        self.changed.push(Changed { path: path.clone(), class, jobs });
                    }
                    _ => self.wrong.push(format!("{path} {value}: {said}")),
                }
            }
        }
    }
}

#[test]
fn every_field_does_something() {
    let scenes: Vec<Value> = serde_json::from_str(include_str!("fields.json")).unwrap();
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 2);
    let uploads = uploads(&server);
    let started = Instant::now();
    let mut asked = Asked::default();
    for scene in &scenes {
        asked.scene(&server, &uploads, scene);
    }
    let mut of_scenes: BTreeMap<String, Outcome> = BTreeMap::new();
    for Changed { path, class, jobs: [scene, job] } in &asked.changed {
        if !of_scenes.contains_key(scene) {
            let found =
                outcome(&server, scene, started).unwrap_or_else(|why| panic!("scene of {path}: {why}"));
            of_scenes.insert(scene.clone(), found);
        }
        let before = &of_scenes[scene];
        let found = match outcome(&server, job, started) {
            Ok(found) => found,
            Err(why) => {
                asked.wrong.push(format!("{path} fails: {why}"));
                continue;
            }
        };
        let same = [found.counts == before.counts, found.plan == before.plan];
        let is_right = match *class {
            "counts_change" => !same[0],
            "plan_changes" => !same[1],
            _ => same[0] && same[1],
        };
        if !is_right {
            asked.wrong.push(format!("{path}: not {class} (counts the same {}, plan {})", same[0], same[1]));
        }
    }
    println!("{} changes in {:.0} s", asked.changed.len(), started.elapsed().as_secs_f64());
    let missing: Vec<String> = all_fields().difference(&asked.fields).cloned().collect();
    assert!(asked.wrong.is_empty(), "{}", asked.wrong.join("\n"));
    assert!(missing.is_empty(), "in no scene: {missing:?}");
}
