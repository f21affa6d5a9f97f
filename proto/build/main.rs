//! Turns the .proto files into Rust types, gRPC code, JSON code, a descriptor set for reflection and an OpenAPI document.
//!
//! Every field's JSON name is its own name, so that JSON, protobuf and Rust say the same word.
#![allow(clippy::print_stdout, reason = "how a build script talks to cargo")]

mod openapi;

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use prost::Message as _;
use prost_types::field_descriptor_proto::Type;
use prost_types::{DescriptorProto, FileDescriptorSet};

const PACKAGE: &str = ".photoneye.v1";
const FILES: [&str; 4] = [
    "photoneye/v1/experiment.proto",
    "photoneye/v1/jobs.proto",
    "photoneye/v1/blobs.proto",
    "photoneye/v1/workers.proto",
];

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=photoneye");
    println!("cargo::rerun-if-changed=build");
    let out = PathBuf::from(env::var("OUT_DIR").map_err(io::Error::other)?);
    let set = descriptors()?;
    let bytes = set.encode_to_vec();
    fs::write(out.join("photoneye.bin"), &bytes)?;
    fs::write(out.join("openapi.json"), openapi::document(&set))?;
    json_code(&out, &set, &bytes)?;
    let mut names = tonic_prost_build::Config::new();
    names.enable_type_names();
    tonic_prost_build::configure()
        .bytes(PACKAGE)
        // The eye is large; without a box every future that holds an experiment is.
        .boxed(format!("{PACKAGE}.Experiment.eye"))
        .codec_path("crate::strict::StrictCodec")
        .compile_fds_with_config(set, names)
}

/// The parsed files with comments and imports, JSON names set.
fn descriptors() -> io::Result<FileDescriptorSet> {
    let mut compiler = protox::Compiler::new(["."]).map_err(io::Error::other)?;
    compiler.include_source_info(true).include_imports(true);
    compiler.open_files(FILES).map_err(io::Error::other)?;
    let mut set = compiler.file_descriptor_set();
    for message in set.file.iter_mut().flat_map(|file| &mut file.message_type) {
        name_fields(message);
    }
    Ok(set)
}

fn name_fields(message: &mut DescriptorProto) {
    for field in &mut message.field {
        field.json_name.clone_from(&field.name);
    }
    for nested in &mut message.nested_type {
        name_fields(nested);
    }
}

/// Writes serde code for every message without raw bytes; numbers are read by the crate's own parser.
fn json_code(out: &Path, set: &FileDescriptorSet, bytes: &[u8]) -> io::Result<()> {
    let raw = set
        .file
        .iter()
        .flat_map(|file| &file.message_type)
        .filter(|message| message.field.iter().any(|field| field.r#type() == Type::Bytes))
        .map(|message| format!("{PACKAGE}.{}", message.name()));
    pbjson_build::Builder::new()
        .register_descriptors(bytes)?
        .preserve_proto_field_names()
        .exclude(raw)
        .build(&[PACKAGE])?;
    let path = out.join("photoneye.v1.serde.rs");
    let code = fs::read_to_string(&path)?;
    fs::write(&path, code.replace("::pbjson::private::", "crate::number::"))
}
