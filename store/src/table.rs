//! The stored form of cones and counts: Apache Arrow IPC, which Python, MATLAB, R and Julia read as it is.
//!
//! Cones: one file, a row a cone. Counts: one stream per chunk (one tile of one frame), a single column `count`, with frame,
//! tile and the first cone's row in the schema's metadata, packed with zstd 1.

use std::collections::HashMap;
use std::io::{Cursor, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, UInt8Type, UInt32Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float32Array, Float64Array, ListArray, RecordBatch, UInt8Array,
    UInt32Array, UInt64Array,
};
use arrow_buffer::{OffsetBuffer, ScalarBuffer};
use arrow_ipc::CompressionType;
use arrow_ipc::reader::{FileReader, StreamReader};
use arrow_ipc::writer::{FileWriter, IpcWriteOptions, StreamWriter};
use arrow_schema::{ArrowError, DataType, Field, Schema};

/// Why bytes are not a table, or a table cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// Not Arrow, or damaged.
    #[error("not a readable Arrow table: {0}")]
    Arrow(#[from] ArrowError),
    /// Arrow, but not the table that was expected.
    #[error("not the expected table: {0}")]
    Shape(String),
}

/// The cone table, a vector per column, a value per cone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConeColumns {
    /// Identity of the cone inside its retina.
    pub id: Vec<u64>,
    /// Arc from the foveal centre, µm.
    pub x_um: Vec<f64>,
    /// Arc from the foveal centre, µm.
    pub y_um: Vec<f64>,
    /// Visual field, degrees, right positive.
    pub x_deg: Vec<f64>,
    /// Visual field, degrees, up positive.
    pub y_deg: Vec<f64>,
    /// Visual eccentricity, degrees.
    pub ecc_deg: Vec<f64>,
    /// Meridian on the retina, degrees.
    pub meridian_deg: Vec<f64>,
    /// 0 L, 1 M, 2 S.
    pub kind: Vec<u8>,
    /// Light-collecting area, µm².
    pub aperture_um2: Vec<f32>,
    /// Whether it lies at the rim of a measured mosaic or beside a gap; such cones are left out of
    /// statistics.
    pub edge: Vec<bool>,
    /// Where each polygon begins in `polygon`, and its end: one more value than there are cones.
    pub polygon_start: Vec<u32>,
    /// Corners x0, y0, x1, y1, … of all polygons, µm, in the frame of `x_um` and `y_um`.
    pub polygon: Vec<f32>,
}

impl ConeColumns {
    /// Number of cones.
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// Whether there are no cones.
    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }

    /// The corners of one cone's polygon; empty when there is no such cone.
    pub fn polygon_of(&self, cone: usize) -> &[f32] {
        let ends = self.polygon_start.get(cone).zip(self.polygon_start.get(cone + 1));
        ends.and_then(|(&a, &b)| self.polygon.get(a as usize..b as usize)).unwrap_or(&[])
    }

    /// Adds the rows of another table below.
    pub fn append(&mut self, other: &Self) {
        self.id.extend(&other.id);
        self.x_um.extend(&other.x_um);
        self.y_um.extend(&other.y_um);
        self.x_deg.extend(&other.x_deg);
        self.y_deg.extend(&other.y_deg);
        self.ecc_deg.extend(&other.ecc_deg);
        self.meridian_deg.extend(&other.meridian_deg);
        self.kind.extend(&other.kind);
        self.aperture_um2.extend(&other.aperture_um2);
        self.edge.extend(&other.edge);
        if self.polygon_start.is_empty() {
            self.polygon_start.push(0);
        }
        let base = self.polygon.len() as u32;
        self.polygon_start.extend(other.polygon_start.iter().skip(1).map(|start| base + start));
        self.polygon.extend(&other.polygon);
    }
}

/// Counts of one chunk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Counts<'a> {
    /// Isomerizations.
    U32(&'a [u32]),
    /// Means.
    F32(&'a [f32]),
}

/// Counts of one chunk, as read.
#[derive(Clone, Debug, PartialEq)]
pub enum CountsVec {
    /// Isomerizations.
    U32(Vec<u32>),
    /// Means.
    F32(Vec<f32>),
}

impl CountsVec {
    /// Number of cones.
    pub fn len(&self) -> usize {
        match self {
            Self::U32(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }

    /// Whether there are no cones.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// One tile of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// Frame number, from 0.
    pub frame: u32,
    /// Tile number, from 0.
    pub tile: u32,
    /// Row of the cone table at which the tile begins.
    pub first_cone: u64,
    /// A value per cone of the tile.
    pub counts: CountsVec,
}

/// The cone table as an Arrow IPC file.
///
/// # Errors
/// When the columns differ in length.
pub fn cones_file(cones: &ConeColumns) -> Result<Vec<u8>, TableError> {
    let mut writer = ConesWriter::new(Vec::new())?;
    writer.push(cones)?;
    writer.finish()
}

/// Writes a cone table piece by piece, a record batch each.
pub struct ConesWriter<W: Write>(FileWriter<W>);

impl<W: Write> ConesWriter<W> {
    /// Begins a table.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(out: W) -> Result<Self, TableError> {
        let schema = cones_batch(&ConeColumns::default())?.schema();
        Ok(Self(FileWriter::try_new(out, &schema)?))
    }

    /// Adds rows.
    ///
    /// # Errors
    /// When the columns differ in length or the table cannot be written.
    pub fn push(&mut self, cones: &ConeColumns) -> Result<(), TableError> {
        Ok(self.0.write(&cones_batch(cones)?)?)
    }

    /// Ends the table and gives back what it was written to.
    ///
    /// # Errors
    /// When the table cannot be written.
    pub fn finish(self) -> Result<W, TableError> {
        Ok(self.0.into_inner()?)
    }
}

/// Rows as a record batch.
fn cones_batch(cones: &ConeColumns) -> Result<RecordBatch, TableError> {
    let starts = if cones.polygon_start.is_empty() { &[0][..] } else { &cones.polygon_start };
    let ordered = starts.is_sorted() && starts.first() == Some(&0);
    if !ordered
        || starts.last().is_some_and(|&end| end as usize > cones.polygon.len() || end > i32::MAX as u32)
    {
        return Err(TableError::Shape("polygon_start does not fit polygon".into()));
    }
    let offsets = OffsetBuffer::new(starts.iter().map(|&start| start as i32).collect::<ScalarBuffer<i32>>());
    let corner = Arc::new(Field::new("item", DataType::Float32, false));
    let corners = Arc::new(Float32Array::from(cones.polygon.clone()));
    let f64s = |values: &[f64]| -> ArrayRef { Arc::new(Float64Array::from(values.to_vec())) };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("id", Arc::new(UInt64Array::from(cones.id.clone()))),
        ("x_um", f64s(&cones.x_um)),
        ("y_um", f64s(&cones.y_um)),
        ("x_deg", f64s(&cones.x_deg)),
        ("y_deg", f64s(&cones.y_deg)),
        ("ecc_deg", f64s(&cones.ecc_deg)),
        ("meridian_deg", f64s(&cones.meridian_deg)),
        ("type", Arc::new(UInt8Array::from(cones.kind.clone()))),
        ("aperture_um2", Arc::new(Float32Array::from(cones.aperture_um2.clone()))),
        ("edge", Arc::new(BooleanArray::from(cones.edge.clone()))),
        ("polygon", Arc::new(ListArray::try_new(corner, offsets, corners, None)?)),
    ];
    let batch =
        RecordBatch::try_from_iter_with_nullable(columns.into_iter().map(|(name, a)| (name, a, false)))?;
    Ok(batch)
}

/// Reads a cone table.
///
/// # Errors
/// When the bytes are not such a file.
pub fn read_cones_file(bytes: &[u8]) -> Result<ConeColumns, TableError> {
    guarded(|| {
        let mut cones = ConeColumns::default();
        for batch in FileReader::try_new(Cursor::new(bytes), None)? {
            cones.append(&cones_of_batch(&batch?)?);
        }
        Ok(cones)
    })
}

fn cones_of_batch(batch: &RecordBatch) -> Result<ConeColumns, TableError> {
    let f64s = |name: &'static str| -> Result<Vec<f64>, TableError> {
        let column = column(batch, name)?.as_primitive_opt::<Float64Type>();
        Ok(column.ok_or_else(|| wrong_type(name))?.values().to_vec())
    };
    let list = column(batch, "polygon")?.as_list_opt::<i32>().ok_or_else(|| wrong_type("polygon"))?;
    let values = list.values().as_primitive_opt::<Float32Type>().ok_or_else(|| wrong_type("polygon"))?;
    let (first, last) = (list.value_offsets()[0], list.value_offsets()[list.len()]);
    Ok(ConeColumns {
        id: column(batch, "id")?
            .as_primitive_opt::<UInt64Type>()
            .ok_or_else(|| wrong_type("id"))?
            .values()
            .to_vec(),
        x_um: f64s("x_um")?,
        y_um: f64s("y_um")?,
        x_deg: f64s("x_deg")?,
        y_deg: f64s("y_deg")?,
        ecc_deg: f64s("ecc_deg")?,
        meridian_deg: f64s("meridian_deg")?,
        kind: column(batch, "type")?
            .as_primitive_opt::<UInt8Type>()
            .ok_or_else(|| wrong_type("type"))?
            .values()
            .to_vec(),
        aperture_um2: column(batch, "aperture_um2")?
            .as_primitive_opt::<Float32Type>()
            .ok_or_else(|| wrong_type("aperture_um2"))?
            .values()
            .to_vec(),
        edge: match batch.column_by_name("edge") {
            // Files of earlier versions.
            None => vec![false; batch.num_rows()],
            Some(edge) => edge
                .as_boolean_opt()
                .ok_or_else(|| wrong_type("edge"))?
                .iter()
                .map(|edge| edge == Some(true))
                .collect(),
        },
        polygon_start: list.value_offsets().iter().map(|&start| (start - first) as u32).collect(),
        polygon: values.values()[first as usize..last as usize].to_vec(),
    })
}

/// One chunk of counts as an Arrow IPC stream.
///
/// # Errors
/// When Arrow cannot write it.
pub fn counts_stream(frame: u32, tile: u32, first_cone: u64, counts: Counts) -> Result<Vec<u8>, TableError> {
    let column: ArrayRef = match counts {
        Counts::U32(values) => Arc::new(UInt32Array::from(values.to_vec())),
        Counts::F32(values) => Arc::new(Float32Array::from(values.to_vec())),
    };
    let metadata = HashMap::from([
        ("frame".to_owned(), frame.to_string()),
        ("tile".to_owned(), tile.to_string()),
        ("first_cone".to_owned(), first_cone.to_string()),
    ]);
    let field = Field::new("count", column.data_type().clone(), false);
    let schema = Arc::new(Schema::new_with_metadata(vec![field], metadata));
    let batch = RecordBatch::try_new(Arc::clone(&schema), vec![column])?;
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD))?;
    let mut writer = StreamWriter::try_new_with_options(Vec::new(), &schema, options)?;
    writer.write(&batch)?;
    Ok(writer.into_inner()?)
}

/// Reads one chunk of counts.
///
/// # Errors
/// When the bytes are not such a stream.
pub fn read_counts(bytes: &[u8]) -> Result<Chunk, TableError> {
    guarded(|| {
        let reader = StreamReader::try_new(Cursor::new(bytes), None)?;
        let schema = reader.schema();
        let mut counts = match schema.field_with_name("count")?.data_type() {
            DataType::UInt32 => CountsVec::U32(Vec::new()),
            DataType::Float32 => CountsVec::F32(Vec::new()),
            other => return Err(TableError::Shape(format!("column `count` is {other}"))),
        };
        let mut batches = 0;
        for batch in reader {
            batches += 1;
            let batch = batch?;
            let column = column(&batch, "count")?;
            match &mut counts {
                CountsVec::U32(all) => {
                    let values =
                        column.as_primitive_opt::<UInt32Type>().ok_or_else(|| wrong_type("count"))?;
                    all.extend(values.values());
                }
                CountsVec::F32(all) => {
                    let values =
                        column.as_primitive_opt::<Float32Type>().ok_or_else(|| wrong_type("count"))?;
                    all.extend(values.values());
                }
            }
        }
        if batches != 1 {
            return Err(TableError::Shape(format!("{batches} batches instead of one")));
        }
        Ok(Chunk {
            frame: metadata(&schema, "frame")?,
            tile: metadata(&schema, "tile")?,
            first_cone: metadata(&schema, "first_cone")?,
            counts,
        })
    })
}

/// The counts of one chunk as the little-endian bytes of their type, without the rest; where the machine is little-endian,
/// nothing is copied.
///
/// # Errors
/// As [`read_counts`].
pub fn read_counts_le(bytes: &[u8]) -> Result<arrow_buffer::Buffer, TableError> {
    guarded(|| {
        let mut batches = StreamReader::try_new(Cursor::new(bytes), None)?;
        let batch = batches.next().ok_or_else(|| TableError::Shape("no batch".into()))??;
        if batches.next().is_some() {
            return Err(TableError::Shape("several batches instead of one".into()));
        }
        let column = column(&batch, "count")?;
        let counts = column.as_primitive_opt::<UInt32Type>().map(|counts| counts.values().inner().clone());
        let means = || Some(column.as_primitive_opt::<Float32Type>()?.values().inner().clone());
        let values = counts.or_else(means).ok_or_else(|| wrong_type("count"))?;
        if cfg!(target_endian = "big") {
            // Both types have four bytes.
            let turned = values.as_slice().chunks_exact(4).flat_map(|value| value.iter().rev().copied());
            return Ok(turned.collect::<Vec<u8>>().into());
        }
        Ok(values)
    })
}

/// A long table of counts over many chunks, for readers that want one stream: columns frame, tile, cone (row of the cone
/// table) and count, in batches of at most [`CountsTable::ROWS`]. The pieces, put end to end, are the stream.
pub struct CountsTable {
    writer: StreamWriter<Vec<u8>>,
    schema: Arc<Schema>,
}

impl CountsTable {
    /// Rows of one batch, at most: a reader that stalls holds one of them (160 KB), and making it keeps nobody waiting.
    pub const ROWS: usize = 1 << 13;

    /// Begins a table; `means` says whether counts are f32 means.
    ///
    /// # Errors
    /// When Arrow cannot write.
    pub fn new(means: bool) -> Result<Self, TableError> {
        let count = if means { DataType::Float32 } else { DataType::UInt32 };
        let schema = Arc::new(Schema::new(vec![
            Field::new("frame", DataType::UInt32, false),
            Field::new("tile", DataType::UInt32, false),
            Field::new("cone", DataType::UInt64, false),
            Field::new("count", count, false),
        ]));
        let writer = StreamWriter::try_new(Vec::new(), &schema)?;
        Ok(Self { writer, schema })
    }

    /// The bytes that the rows of a chunk from one on add, with whatever was not taken yet.
    ///
    /// # Errors
    /// When the chunk's counts are of the other type.
    pub fn push(&mut self, chunk: &Chunk, from: usize) -> Result<Vec<u8>, TableError> {
        let part = from..chunk.counts.len().min(from + Self::ROWS);
        let n = part.len();
        let first = chunk.first_cone + from as u64;
        let rows = UInt64Array::from_iter_values(first..first + n as u64);
        let counts: ArrayRef = match &chunk.counts {
            CountsVec::U32(values) => Arc::new(UInt32Array::from_iter_values(values[part].iter().copied())),
            CountsVec::F32(values) => Arc::new(Float32Array::from_iter_values(values[part].iter().copied())),
        };
        // Twenty bytes a row, and the batch's head.
        self.writer.get_mut().reserve_exact(20 * n + 1024);
        let columns: Vec<ArrayRef> = vec![
            Arc::new(UInt32Array::from_value(chunk.frame, n)),
            Arc::new(UInt32Array::from_value(chunk.tile, n)),
            Arc::new(rows),
            counts,
        ];
        self.writer.write(&RecordBatch::try_new(Arc::clone(&self.schema), columns)?)?;
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

pub(crate) fn column<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a ArrayRef, TableError> {
    let column =
        batch.column_by_name(name).ok_or_else(|| TableError::Shape(format!("no column `{name}`")))?;
    if column.null_count() > 0 {
        return Err(TableError::Shape(format!("column `{name}` has missing values")));
    }
    Ok(column)
}

pub(crate) fn wrong_type(name: &str) -> TableError {
    TableError::Shape(format!("column `{name}` has another type"))
}

fn metadata<T: std::str::FromStr>(schema: &Schema, name: &str) -> Result<T, TableError> {
    let text = schema.metadata().get(name);
    text.and_then(|text| text.parse().ok())
        .ok_or_else(|| TableError::Shape(format!("no {name} in the metadata")))
}

/// Arrow's readers trust some of the offsets in a file; here damaged bytes are an error like any other.
pub(crate) fn guarded<T>(read: impl FnOnce() -> Result<T, TableError>) -> Result<T, TableError> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err(TableError::Shape("damaged".into())))
}
