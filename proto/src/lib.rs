//! The one schema of everything on the wire.
//!
//! The .proto files beside this crate give the message types, the gRPC services (client and server), their JSON form (field
//! names as in the .proto files, unknown fields refused by name), the OpenAPI document and the descriptor set for reflection.

mod json;
mod key;
mod number;
pub mod strict;

pub use json::{FieldError, experiment_from_json, from_json};
pub use key::ApiKey;

/// Messages and services of `photoneye.v1`.
#[allow(missing_docs, clippy::all, clippy::pedantic, reason = "generated code")]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/photoneye.v1.rs"));
    include!(concat!(env!("OUT_DIR"), "/photoneye.v1.serde.rs"));
}

/// The files as an encoded `FileDescriptorSet`, for gRPC reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/photoneye.bin"));

/// The REST interface as an OpenAPI 3.1 document.
pub const OPENAPI_JSON: &str = include_str!(concat!(env!("OUT_DIR"), "/openapi.json"));
