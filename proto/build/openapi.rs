//! Writes the OpenAPI 3.1 document: endpoints from the table below, schemas and their descriptions from the .proto files.

use std::collections::HashMap;

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto, FileDescriptorSet,
};
use serde_json::{Map, Value, json};

const ARROW_STREAM: &str = "application/vnd.apache.arrow.stream";
const ARROW_FILE: &str = "application/vnd.apache.arrow.file";
const BYTES: &str = "application/octet-stream";
const JSON: &str = "application/json";

/// Method, path, summary, request message, (media type, message) of the reply.
type Endpoint =
    (&'static str, &'static str, &'static str, Option<&'static str>, (&'static str, Option<&'static str>));

const ENDPOINTS: &[Endpoint] = &[
    ("post", "/v1/jobs", "Submit an experiment", Some("Experiment"), (JSON, Some("Job"))),
    ("get", "/v1/jobs", "List jobs, newest first", None, (JSON, Some("ListJobsReply"))),
    ("get", "/v1/jobs/{id}", "One job", None, (JSON, Some("Job"))),
    ("post", "/v1/jobs/{id}/cancel", "Cancel a job", None, (JSON, Some("Job"))),
    (
        "get",
        "/v1/jobs/{id}/events",
        "State and progress as server-sent events",
        None,
        ("text/event-stream", None),
    ),
    ("get", "/v1/jobs/{id}/results", "Result chunks as one Arrow stream", None, (ARROW_STREAM, None)),
    ("get", "/v1/jobs/{id}/counts.npy", "Counts [frame, cone] as a NumPy array", None, (BYTES, None)),
    (
        "get",
        "/v1/jobs/{id}/photons.arrow",
        "Counted photons (frame, time_s, wavelength_nm, cone) with `counts.photon_list`, as an Arrow stream",
        None,
        (ARROW_STREAM, None),
    ),
    ("get", "/v1/jobs/{id}/cones.arrow", "The cone table as an Arrow file", None, (ARROW_FILE, None)),
    ("get", "/v1/jobs/{id}/frames/{frame}", "A frame as a picture: `0.png`", None, ("image/png", None)),
    ("get", "/v1/jobs/{id}/report", "The report of a finished job", None, (JSON, None)),
    (
        "post",
        "/v1/plans",
        "Explain an experiment without running it",
        Some("Experiment"),
        (JSON, Some("PlanReply")),
    ),
    ("put", "/v1/blobs", "Upload bytes; the reply has their digest", None, (JSON, Some("PutBlobReply"))),
    ("get", "/v1/blobs/{digest}", "Download bytes (digest `b3:<hex>/<size>`)", None, (BYTES, None)),
    ("get", "/v1/displays", "Display presets", None, (JSON, None)),
    ("get", "/v1/eyes", "Eye presets", None, (JSON, None)),
    ("get", "/v1/spectra", "Named spectra, as `table/column`", None, (JSON, None)),
    (
        "get",
        "/v1/retinas",
        "Built retinas with parameters, figures and origin; generators",
        None,
        (JSON, None),
    ),
    ("get", "/v1/workers", "Workers heard lately, what they do and use", None, (JSON, None)),
    ("get", "/healthz", "The process lives", None, (JSON, None)),
    ("get", "/readyz", "The service takes work", None, (JSON, None)),
    ("get", "/metrics", "Metrics in Prometheus' text form", None, ("text/plain", None)),
];

/// Query and header parameters: path suffix, method, place, name, schema type, description.
const PARAMETERS: &[(&str, &str, &str, &str, &str, &str)] = &[
    ("/v1/jobs", "post", "header", "Idempotency-Key", "string", "The same key again gives the same job"),
    (
        "/v1/jobs",
        "post",
        "query",
        "priority",
        "integer",
        "0 to 9, default 5; inside a tenant the higher first",
    ),
    ("/v1/jobs/{id}/frames/{frame}", "get", "query", "side", "integer", "Longer side, pixels"),
    ("/v1/jobs", "get", "query", "page", "string", "`next_page` of the reply before"),
    ("/v1/jobs", "get", "query", "page_size", "integer", "1 to 200, default 50"),
    ("/v1/jobs/{id}/events", "get", "header", "Last-Event-ID", "integer", "Events after this one"),
    ("/v1/jobs/{id}/results", "get", "query", "from", "integer", "First sequence number; 1 is everything"),
];

/// The whole document as JSON text.
pub fn document(set: &FileDescriptorSet) -> String {
    let mut schemas = Map::new();
    for file in &set.file {
        let comments = comments(file);
        for (i, message) in file.message_type.iter().enumerate() {
            add_message(&mut schemas, "", message, &comments, &[4, i as i32]);
        }
    }
    schemas.insert("Problem".into(), problem());
    let mut paths = Map::new();
    for endpoint in ENDPOINTS {
        let item = paths.entry(endpoint.1).or_insert_with(|| json!({}));
        item[endpoint.0] = operation(endpoint);
    }
    let document = json!({
        "openapi": "3.1.0",
        "info": {"title": "photoneye", "version": env!("CARGO_PKG_VERSION"),
                 "description": "How many photons each cone of an eye isomerizes while it looks at a display."},
        "paths": paths,
        "components": {"schemas": schemas, "securitySchemes": {"key": {"type": "http", "scheme": "bearer",
            "description": "An API key made with `photoneye keys create`; none is asked for where none was made."}}},
        "security": [{}, {"key": []}],
    });
    document.to_string()
}

fn operation((method, path, summary, request, (media, reply)): &Endpoint) -> Value {
    let reference = |name: &str| json!({"$ref": format!("#/components/schemas/{name}")});
    let mut parameters: Vec<Value> = path
        .split('/')
        .filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
        .map(|name| json!({"name": name, "in": "path", "required": true, "schema": bounds(name, "string")}))
        .collect();
    for (_, _, place, name, kind, text) in PARAMETERS.iter().filter(|p| p.0 == *path && p.1 == *method) {
        parameters
            .push(json!({"name": name, "in": place, "description": text, "schema": bounds(name, kind)}));
    }
    let schema = reply.map_or_else(|| json!({}), reference);
    let done = json!({"description": "Done", "content": {*media: {"schema": schema}}});
    let error = json!({"description": "What is wrong, and with which field",
                       "content": {"application/problem+json": {"schema": reference("Problem")}}});
    let mut operation = json!({"summary": summary, "responses": {"200": done, "default": error},
        "operationId": format!("{method}{}", path.replace(['/', '{', '}', '.', '-'], "_"))});
    if *path == "/v1/jobs" && *method == "post" {
        operation["responses"]["201"] = done;
        operation["responses"]["201"]["description"] = json!("A new job");
    }
    if *path == "/v1/blobs" {
        // Always new: what was there already is written again.
        let done = operation["responses"]["200"].take();
        operation["responses"] = json!({"201": done, "default": operation["responses"]["default"]});
        operation["requestBody"] = json!({"required": true, "content": {BYTES: {"schema": {}}}});
    }
    if let Some(name) = request {
        let form = json!({"type": "object", "required": ["spec"],
                          "properties": {"spec": {"type": "string", "description": "The message as JSON text"}}});
        operation["requestBody"] = json!({"required": true, "content": {JSON: {"schema": reference(name)},
            "application/x-www-form-urlencoded": {"schema": form}}});
    }
    if !parameters.is_empty() {
        operation["parameters"] = Value::Array(parameters);
    }
    operation
}

/// What a parameter may be.
fn bounds(name: &str, kind: &str) -> Value {
    match name {
        "page_size" => json!({"type": kind, "minimum": 1, "maximum": 200}),
        "priority" => json!({"type": kind, "minimum": 0, "maximum": 9}),
        "from" => json!({"type": kind, "minimum": 1, "maximum": u64::MAX}),
        "Last-Event-ID" => json!({"type": kind, "minimum": 0, "maximum": u64::MAX}),
        "side" => json!({"type": kind, "minimum": 1, "maximum": 8192}),
        "page" => json!({"type": kind, "pattern": "^[0-9]{1,19}$"}),
        "Idempotency-Key" => json!({"type": kind, "pattern": "^[!-~]{1,255}$"}),
        "digest" => json!({"type": kind, "pattern": "^b3:[0-9a-f]{64}/[0-9]{1,18}$"}),
        _ => json!({"type": kind}),
    }
}

fn problem() -> Value {
    let text = |description: &str| json!({"type": "string", "description": description});
    json!({"type": "object", "description": "An error (RFC 9457).", "properties": {
        "type": text("about:blank"), "title": text("The kind of error"), "detail": text("What is wrong"),
        "status": {"type": "integer"}, "field": text("The field that is wrong, as `eye.pupil_mm`")}})
}

/// Leading comments by descriptor path.
fn comments(file: &prost_types::FileDescriptorProto) -> HashMap<Vec<i32>, String> {
    let locations = file.source_code_info.iter().flat_map(|info| &info.location);
    locations
        .filter(|location| !location.leading_comments().trim().is_empty())
        .map(|location| (location.path.clone(), location.leading_comments().trim().to_owned()))
        .collect()
}

fn add_message(
    schemas: &mut Map<String, Value>,
    outer: &str,
    message: &DescriptorProto,
    comments: &HashMap<Vec<i32>, String>,
    path: &[i32],
) {
    if message.field.iter().any(|field| field.r#type() == Type::Bytes) {
        return;
    }
    let at = |kind: i32, i: usize| [path, &[kind, i as i32]].concat();
    let name = format!("{outer}{}", message.name());
    let mut properties = Map::new();
    for (i, field) in message.field.iter().enumerate() {
        properties.insert(field.name().into(), field_schema(field, comments.get(&at(2, i))));
    }
    let mut schema = json!({"type": "object", "additionalProperties": false, "properties": properties});
    if let Some(text) = comments.get(path) {
        schema["description"] = json!(text);
    }
    if message.oneof_decl.iter().any(|oneof| !oneof.name().starts_with('_')) {
        schema["maxProperties"] = json!(message.field.len());
        schema["oneOf"] = one_of(message);
    }
    schemas.insert(name.clone(), schema);
    for (i, nested) in message.nested_type.iter().enumerate() {
        add_message(schemas, &format!("{name}."), nested, comments, &at(3, i));
    }
    for (i, values) in message.enum_type.iter().enumerate() {
        let text = comments.get(&at(4, i));
        schemas.insert(format!("{name}.{}", values.name()), enum_schema(values, text));
    }
}

/// Exactly one of the choices of the message's oneof.
fn one_of(message: &DescriptorProto) -> Value {
    let choices =
        message.field.iter().filter(|field| field.oneof_index.is_some() && !field.proto3_optional());
    choices.map(|field| json!({"required": [field.name()]})).collect()
}

fn enum_schema(values: &EnumDescriptorProto, text: Option<&String>) -> Value {
    let names: Vec<&str> = values.value.iter().map(EnumValueDescriptorProto::name).collect();
    let mut schema = json!({"type": "string", "enum": names});
    if let Some(text) = text {
        schema["description"] = json!(text);
    }
    schema
}

fn field_schema(field: &FieldDescriptorProto, text: Option<&String>) -> Value {
    let mut schema = match field.r#type() {
        Type::Double | Type::Float => json!({"type": "number"}),
        Type::Uint32 => json!({"type": "integer", "minimum": 0, "maximum": u32::MAX}),
        Type::Uint64 => json!({"type": ["string", "integer"], "pattern": "^[0-9]{1,20}$", "minimum": 0,
                               "maximum": u64::MAX}),
        Type::Bool => json!({"type": "boolean"}),
        Type::Message | Type::Enum => {
            let name = field.type_name().trim_start_matches(".photoneye.v1.");
            json!({"$ref": format!("#/components/schemas/{name}")})
        }
        _ => json!({"type": "string"}),
    };
    if field.label() == Label::Repeated {
        schema = json!({"type": "array", "items": schema});
    }
    if let Some(text) = text {
        schema["description"] = json!(text);
    }
    schema
}
