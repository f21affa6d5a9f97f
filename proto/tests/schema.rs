//! The schema's own rules, and what its errors say.

use photoneye_proto::{FILE_DESCRIPTOR_SET, OPENAPI_JSON, experiment_from_json, v1};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet};

fn error(text: &str) -> String {
    experiment_from_json(text).map_or_else(|error| error.to_string(), |_| "accepted".to_owned())
}

#[test]
fn errors_name_the_field() {
    let cases = [
        (
            r#"{"eye": {"pupill_mm": 3}}"#,
            "eye.pupill_mm: unknown field `pupill_mm`, expected one of `preset`, `side`, `pupil_mm`",
        ),
        (
            r#"{"display": {"primaries": [{}, {"spectrum": {"line": {"nm": "x"}}}]}}"#,
            "display.primaries[1].spectrum.line.nm: invalid value: string \"x\", expected a number",
        ),
        (
            r#"{"counts": {"engine": "FAST"}}"#,
            "counts.engine: unknown variant `FAST`, expected one of `AUTO`, `EXPECTED`, `EVENTS`, `PAPER`",
        ),
        (r#"{"eye": {"pupil_mm": "NaN"}}"#, "eye.pupil_mm: invalid value: string \"NaN\", expected a number"),
        (
            r#"{"display": {"width_px": 1.5}}"#,
            "display.width_px: invalid value: floating point `1.5`, expected a whole number",
        ),
        (
            r#"{"display": {"width_px": -1}}"#,
            "display.width_px: invalid value: integer `-1`, expected a whole number",
        ),
        (r#"{"retina": {"seed": "18446744073709551616"}}"#, "retina.seed: invalid value"),
        (r#"{"eye": 3}"#, "eye: invalid type: integer `3`, expected"),
        (r#"{"eye": {}"#, "not JSON: EOF"),
        (r"{} {}", "not JSON: trailing"),
        (r#"{"eye": {"pupil_mm": 1e999}}"#, "not JSON: number out of range"),
    ];
    for (text, expected) in cases {
        assert!(error(text).starts_with(expected), "{text} gave {}", error(text));
    }
    assert!(!error(r#"{"eye": {"pupill_mm": 3}}"#).contains("`pupil_mm`, `pupil_mm`"));
    let twice = error(r#"{"video": {"clip": {}, "pattern": {}}}"#);
    assert!(twice.contains("video"), "{twice}");
}

#[test]
fn large_seeds_survive() {
    for seed in [0, 1, (1 << 53) + 1, u64::MAX] {
        let read = experiment_from_json(&format!(r#"{{"retina": {{"seed": "{seed}"}}}}"#)).unwrap();
        assert_eq!(read.retina.as_ref().unwrap().seed, Some(seed));
        let again = serde_json::to_string(&read).unwrap();
        assert_eq!(experiment_from_json(&again).unwrap(), read);
        let number = experiment_from_json(&format!(r#"{{"retina": {{"seed": {seed}}}}}"#)).unwrap();
        assert_eq!(number, read);
    }
}

#[test]
fn names_in_json_are_the_names_of_the_schema() {
    let job = v1::Job {
        state: Some(v1::job::State::Queued as i32),
        experiment_digest: Some("d".into()),
        ..v1::Job::default()
    };
    let text = serde_json::to_string(&job).unwrap();
    assert_eq!(text, r#"{"state":"QUEUED","experiment_digest":"d"}"#);
}

/// Unset must differ from 0.
#[test]
fn every_scalar_is_optional_or_in_a_oneof() {
    fn check(message: &DescriptorProto) {
        for field in &message.field {
            let free = field.label() == Label::Repeated || field.r#type() == Type::Message;
            let present = field.oneof_index.is_some();
            assert!(free || present, "{}.{} has no presence", message.name(), field.name());
            assert_eq!(field.json_name(), field.name());
        }
        message.nested_type.iter().for_each(check);
    }
    let set = FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
    set.file.iter().flat_map(|file| &file.message_type).for_each(check);
}

#[test]
fn every_reference_of_the_openapi_document_resolves() {
    fn references(value: &serde_json::Value, found: &mut Vec<String>) {
        match value {
            serde_json::Value::Object(fields) => {
                for (name, value) in fields {
                    if let ("$ref", Some(text)) = (name.as_str(), value.as_str()) {
                        found.push(text.trim_start_matches("#/components/schemas/").to_owned());
                    }
                    references(value, found);
                }
            }
            serde_json::Value::Array(items) => items.iter().for_each(|item| references(item, found)),
            _ => {}
        }
    }
    let document: serde_json::Value = serde_json::from_str(OPENAPI_JSON).unwrap();
    let schemas = document["components"]["schemas"].as_object().unwrap();
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(found.len() > 20);
    for name in found {
        assert!(schemas.contains_key(&name), "{name}");
    }
    let pupil = &schemas["Eye"]["properties"]["pupil_mm"]["description"];
    assert!(pupil.as_str().unwrap().contains("0.5 to 9"));
}

/// A field or enum number that the schema does not know is refused in the binary form too, by path.
#[test]
fn binary_requests_are_held_against_the_schema() {
    use photoneye_proto::strict::check;
    let request = v1::PlanRequest {
        experiment: Some(v1::Experiment {
            eye: Some(Box::new(v1::Eye { pupil_mm: Some(3.0), ..v1::Eye::default() })),
            counts: Some(v1::Counts { engine: Some(1), ..v1::Counts::default() }),
            ..v1::Experiment::default()
        }),
    };
    assert_eq!(check("photoneye.v1.PlanRequest", &request.encode_to_vec()), Ok(()));
    let with = |experiment: &[u8]| {
        let bytes = [&[0x0a, experiment.len() as u8], experiment].concat();
        check("photoneye.v1.PlanRequest", &bytes).unwrap_err().to_string()
    };
    // Field 999 of the experiment, a number.
    let unknown = with(&[0xb8, 0x3e, 1]);
    assert!(
        unknown.starts_with("experiment.#999: unknown field number 999, expected one of `eye`"),
        "{unknown}"
    );
    // An engine of number 77.
    let mut wrong = request.clone();
    wrong.experiment.as_mut().unwrap().counts.as_mut().unwrap().engine = Some(77);
    let message = check("photoneye.v1.PlanRequest", &wrong.encode_to_vec()).unwrap_err().to_string();
    assert!(message.starts_with("experiment.counts.engine: unknown enum number 77"), "{message}");
    // Bytes that are no message.
    for broken in [&[0x0a, 0x7f][..], &[0x0a], &[0xff; 12]] {
        assert!(check("photoneye.v1.PlanRequest", broken).is_err());
    }
}
