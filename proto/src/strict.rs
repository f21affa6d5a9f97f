//! Requests in the binary form are held against the schema: a field or an enum number that it does not know is refused by
//! path, as in JSON, instead of being dropped silently.

use std::collections::{BTreeMap, BTreeSet};
use std::marker::PhantomData;
use std::sync::OnceLock;

use bytes::Buf;
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};
use prost::{Message, Name};
use prost_types::field_descriptor_proto::Type;
use prost_types::{DescriptorProto, FileDescriptorSet};
use tonic::Status;
use tonic::codec::{Codec, DecodeBuf, Decoder};
use tonic_prost::ProstCodec;

use crate::FieldError;

/// Deepest nesting of messages.
const DEEPEST: usize = 64;

/// What is known about a message.
#[derive(Default)]
struct Fields(BTreeMap<u32, Field>);

struct Field {
    name: String,
    kind: Kind,
}

enum Kind {
    Message(String),
    Enum(BTreeSet<i32>),
    Other,
}

type Schema = BTreeMap<String, Fields>;

fn schema() -> &'static Schema {
    static SCHEMA: OnceLock<Schema> = OnceLock::new();
    SCHEMA.get_or_init(|| {
        let set = FileDescriptorSet::decode(crate::FILE_DESCRIPTOR_SET).unwrap_or_default();
        let mut enums = BTreeMap::new();
        for file in &set.file {
            let package = format!(".{}", file.package());
            file.message_type.iter().for_each(|message| add_enums(&mut enums, &package, message));
        }
        let mut schema = Schema::new();
        for file in &set.file {
            let package = format!(".{}", file.package());
            file.message_type.iter().for_each(|message| add(&mut schema, &enums, &package, message));
        }
        schema
    })
}

fn add_enums(enums: &mut BTreeMap<String, BTreeSet<i32>>, outer: &str, message: &DescriptorProto) {
    let name = format!("{outer}.{}", message.name());
    for values in &message.enum_type {
        let numbers = values.value.iter().map(prost_types::EnumValueDescriptorProto::number).collect();
        enums.insert(format!("{name}.{}", values.name()), numbers);
    }
    message.nested_type.iter().for_each(|nested| add_enums(enums, &name, nested));
}

fn add(schema: &mut Schema, enums: &BTreeMap<String, BTreeSet<i32>>, outer: &str, message: &DescriptorProto) {
    let name = format!("{outer}.{}", message.name());
    let fields = message.field.iter().map(|field| {
        let kind = match field.r#type() {
            Type::Message => Kind::Message(field.type_name().to_owned()),
            Type::Enum => Kind::Enum(enums.get(field.type_name()).cloned().unwrap_or_default()),
            _ => Kind::Other,
        };
        (field.number() as u32, Field { name: field.name().to_owned(), kind })
    });
    schema.insert(name.clone(), Fields(fields.collect()));
    message.nested_type.iter().for_each(|nested| add(schema, enums, &name, nested));
}

/// Holds bytes against a message of the schema, named as `photoneye.v1.Experiment`.
///
/// # Errors
/// The first field that the schema does not know, an enum number that it does not know, or bytes that are no message.
pub fn check(message: &str, bytes: &[u8]) -> Result<(), FieldError> {
    walk(&format!(".{message}"), bytes, "", DEEPEST)
}

fn walk(message: &str, mut bytes: &[u8], path: &str, depth: usize) -> Result<(), FieldError> {
    let broken = || FieldError::new(path, "not a protobuf message");
    let Some(fields) = schema().get(message).filter(|_| depth > 0) else {
        return Err(FieldError::new(path, "nested too deep"));
    };
    while bytes.has_remaining() {
        let (number, wire) = decode_key(&mut bytes).map_err(|_| broken())?;
        let Some(field) = fields.0.get(&number) else {
            let names: Vec<String> = fields.0.values().map(|field| format!("`{}`", field.name)).collect();
            let place = if path.is_empty() { format!("#{number}") } else { format!("{path}.#{number}") };
            let message = format!("unknown field number {number}, expected one of {}", names.join(", "));
            return Err(FieldError::new(place, message));
        };
        let place = if path.is_empty() { field.name.clone() } else { format!("{path}.{}", field.name) };
        match (&field.kind, wire) {
            (Kind::Message(inner), WireType::LengthDelimited) => {
                walk(inner, take(&mut bytes).ok_or_else(broken)?, &place, depth - 1)?;
            }
            (Kind::Enum(numbers), WireType::LengthDelimited) => {
                let mut packed = take(&mut bytes).ok_or_else(broken)?;
                while packed.has_remaining() {
                    known(numbers, decode_varint(&mut packed).map_err(|_| broken())?, &place)?;
                }
            }
            (Kind::Enum(numbers), WireType::Varint) => {
                known(numbers, decode_varint(&mut bytes).map_err(|_| broken())?, &place)?;
            }
            _ => skip_field(wire, number, &mut bytes, DecodeContext::default()).map_err(|_| broken())?,
        }
    }
    Ok(())
}

fn known(numbers: &BTreeSet<i32>, value: u64, path: &str) -> Result<(), FieldError> {
    if i32::try_from(value as i64).is_ok_and(|number| numbers.contains(&number)) {
        return Ok(());
    }
    let all: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    Err(FieldError::new(
        path,
        format!("unknown enum number {}, expected one of {}", value as i64, all.join(", ")),
    ))
}

/// The bytes of a length-delimited field.
fn take<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = usize::try_from(decode_varint(bytes).ok()?).ok()?;
    let (inner, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    Some(inner)
}

/// The codec of the generated code: as tonic's, but messages named `…Request` are checked when they come in.
#[derive(Clone, Copy, Debug)]
pub struct StrictCodec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for StrictCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> Codec for StrictCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Name + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = <ProstCodec<T, U> as Codec>::Encoder;
    type Decoder = StrictDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<T, U>::default().encoder()
    }

    fn decoder(&mut self) -> Self::Decoder {
        StrictDecoder(PhantomData)
    }
}

/// Reads one message.
#[derive(Debug)]
pub struct StrictDecoder<U>(PhantomData<U>);

impl<U: Message + Name + Default> Decoder for StrictDecoder<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, bytes: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        let bytes = bytes.copy_to_bytes(bytes.remaining());
        if U::NAME.ends_with("Request") {
            check(&U::full_name(), &bytes).map_err(|error| {
                // The experiment inside a request is what people know; JSON has no such step.
                let text = error.to_string();
                Status::invalid_argument(text.strip_prefix("experiment.").unwrap_or(&text).to_owned())
            })?;
        }
        U::decode(bytes).map(Some).map_err(|error| Status::invalid_argument(error.to_string()))
    }
}
