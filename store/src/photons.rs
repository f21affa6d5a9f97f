//! Lists of counted photons: an Arrow IPC stream behind the counts of a chunk, and one long table over many chunks.
//!
//! In a chunk: columns `time_s` (from the start of the recording), `wavelength_nm` and `cone` (its id), a row a photon in order of time,
//! packed with zstd 1. The frame and the tile are those of the counts before.

use std::io::Cursor;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, UInt32Type, UInt64Type};
use arrow_array::{ArrayRef, Float32Array, Float64Array, RecordBatch, UInt32Array, UInt64Array};
use arrow_ipc::CompressionType;
use arrow_ipc::reader::StreamReader;
use arrow_ipc::writer::{IpcWriteOptions, StreamWriter};
use arrow_schema::{DataType, Field, Schema};

use crate::table::{TableError, column, guarded, wrong_type};

/// Photons of one chunk.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Photons {
    /// Seconds from the start of the recording.
    pub time_s: Vec<f64>,
    /// Wavelengths, nm.
    pub wavelength_nm: Vec<f32>,
    /// Ids of the cones.
    pub cone: Vec<u64>,
}

impl Photons {
    fn append(&mut self, batch: &RecordBatch) -> Result<(), TableError> {
        let time = column(batch, "time_s")?.as_primitive_opt::<Float64Type>();
        self.time_s.extend(time.ok_or_else(|| wrong_type("time_s"))?.values());
        let nm = column(batch, "wavelength_nm")?.as_primitive_opt::<Float32Type>();
        self.wavelength_nm.extend(nm.ok_or_else(|| wrong_type("wavelength_nm"))?.values());
        let cone = column(batch, "cone")?.as_primitive_opt::<UInt64Type>();
        self.cone.extend(cone.ok_or_else(|| wrong_type("cone"))?.values());
        Ok(())
    }
}

fn fields() -> Vec<Field> {
    vec![
        Field::new("time_s", DataType::Float64, false),
        Field::new("wavelength_nm", DataType::Float32, false),
        Field::new("cone", DataType::UInt64, false),
    ]
}

fn columns(photons: &Photons) -> Vec<ArrayRef> {
    vec![
        Arc::new(Float64Array::from(photons.time_s.clone())),
        Arc::new(Float32Array::from(photons.wavelength_nm.clone())),
        Arc::new(UInt64Array::from(photons.cone.clone())),
    ]
}

/// The photons of a chunk as an Arrow IPC stream.
///
/// # Errors
/// When the columns differ in length.
pub fn photons_stream(photons: &Photons) -> Result<Vec<u8>, TableError> {
    let schema = Arc::new(Schema::new(fields()));
    let batch = RecordBatch::try_new(Arc::clone(&schema), columns(photons))?;
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD))?;
    let mut writer = StreamWriter::try_new_with_options(Vec::new(), &schema, options)?;
    writer.write(&batch)?;
    Ok(writer.into_inner()?)
}

/// The last bytes of an Arrow IPC stream.
const END_OF_STREAM: [u8; 8] = [0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0];

/// The photons behind the counts of a chunk; `None` when none are listed.
///
/// # Errors
/// When the bytes are no such streams.
pub fn read_photons(chunk: &[u8]) -> Result<Option<Photons>, TableError> {
    guarded(|| {
        let mut counts = StreamReader::try_new(Cursor::new(chunk), None)?;
        for batch in counts.by_ref() {
            batch?;
        }
        let end = counts.get_ref().position() as usize;
        let rest = chunk.get(end..).unwrap_or_default();
        if rest.is_empty() {
            return Ok(None);
        }
        // A stream that is cut between two of its messages reads as a shorter one.
        if !rest.ends_with(&END_OF_STREAM) {
            return Err(TableError::Shape("the list of photons is cut".into()));
        }
        let mut photons = Photons::default();
        for batch in StreamReader::try_new(Cursor::new(rest), None)? {
            photons.append(&batch?)?;
        }
        Ok(Some(photons))
    })
}

/// Reads a long table: frames, and photons.
///
/// # Errors
/// When the bytes are no such stream.
pub fn read_photons_table(bytes: &[u8]) -> Result<(Vec<u32>, Photons), TableError> {
    guarded(|| {
        let (mut frames, mut photons) = (Vec::new(), Photons::default());
        for batch in StreamReader::try_new(Cursor::new(bytes), None)? {
            let batch = batch?;
            let frame = column(&batch, "frame")?.as_primitive_opt::<UInt32Type>();
            frames.extend(frame.ok_or_else(|| wrong_type("frame"))?.values());
            photons.append(&batch)?;
        }
        Ok((frames, photons))
    })
}

/// A long table of photons over many chunks: columns frame, time_s, wavelength_nm and cone, a batch a chunk. The pieces, put end to
/// end, are one Arrow IPC stream.
pub struct PhotonsTable {
    writer: StreamWriter<Vec<u8>>,
    schema: Arc<Schema>,
}

impl PhotonsTable {
    /// Begins a table.
    ///
    /// # Errors
    /// When Arrow cannot write.
    pub fn new() -> Result<Self, TableError> {
        let mut all = vec![Field::new("frame", DataType::UInt32, false)];
        all.extend(fields());
        let schema = Arc::new(Schema::new(all));
        Ok(Self { writer: StreamWriter::try_new(Vec::new(), &schema)?, schema })
    }

    /// The bytes that a chunk of a frame adds, with whatever was not taken yet.
    ///
    /// # Errors
    /// When the columns differ in length.
    pub fn push(&mut self, frame: u32, photons: &Photons) -> Result<Vec<u8>, TableError> {
        let mut all: Vec<ArrayRef> = vec![Arc::new(UInt32Array::from_value(frame, photons.time_s.len()))];
        all.extend(columns(photons));
        self.writer.write(&RecordBatch::try_new(Arc::clone(&self.schema), all)?)?;
        Ok(std::mem::take(self.writer.get_mut()))
    }

    /// The bytes that end the stream, with whatever was not taken yet.
    ///
    /// # Errors
    /// When Arrow cannot write.
    pub fn finish(mut self) -> Result<Vec<u8>, TableError> {
        self.writer.finish()?;
        Ok(std::mem::take(self.writer.get_mut()))
    }
}
