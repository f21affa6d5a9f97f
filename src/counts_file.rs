//! Reads counts.npy frame by frame.

use std::fs::File;
use std::io::{BufReader, Read, Seek as _, SeekFrom};
use std::path::Path;

use crate::failure::{Failure, plain};

/// An open counts.npy: `[frame, cone]`, u32 counts or f32 means.
pub struct CountsFile {
    file: BufReader<File>,
    name: String,
    data: u64,
    means: bool,
    /// Number of frames.
    pub frames: usize,
    /// Number of cones.
    pub cones: usize,
}

impl CountsFile {
    /// Opens the file and reads its head.
    ///
    /// # Errors
    /// When it is missing or not such an array.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let mut file =
            BufReader::new(File::open(path).map_err(|e| Failure::usage(format!("{name}: {}", plain(&e))))?);
        let head = read_head(&mut file).and_then(|text| parse(&text));
        let (means, [frames, cones], data) =
            head.ok_or_else(|| Failure::usage(format!("{name}: not an array [frame, cone] of u32 or f32")))?;
        Ok(Self { file, name, data, means, frames, cones })
    }

    /// The values of one frame.
    ///
    /// # Errors
    /// When the file ends too early.
    pub fn frame(&mut self, index: usize) -> Result<Vec<f64>, Failure> {
        let start = self.data + 4 * (index as u64) * (self.cones as u64);
        let mut bytes = vec![0; 4 * self.cones];
        let read = self.file.seek(SeekFrom::Start(start)).and_then(|_| self.file.read_exact(&mut bytes));
        read.map_err(|e| Failure::failed(format!("{}: frame {index}: {}", self.name, plain(&e))))?;
        let words = bytes.chunks_exact(4).map(|b| [b[0], b[1], b[2], b[3]]);
        Ok(if self.means {
            words.map(|b| f64::from(f32::from_le_bytes(b))).collect()
        } else {
            words.map(|b| f64::from(u32::from_le_bytes(b))).collect()
        })
    }
}

/// The head's text; its total length is the offset of the data.
fn read_head(file: &mut impl Read) -> Option<(String, u64)> {
    let mut start = [0; 10];
    file.read_exact(&mut start).ok()?;
    if &start[..8] != b"\x93NUMPY\x01\x00" {
        return None;
    }
    let mut text = vec![0; usize::from(u16::from_le_bytes([start[8], start[9]]))];
    file.read_exact(&mut text).ok()?;
    let data = 10 + text.len() as u64;
    Some((String::from_utf8(text).ok()?, data))
}

/// Whether the values are means, the shape, and where the data begin.
fn parse((text, data): &(String, u64)) -> Option<(bool, [usize; 2], u64)> {
    let means = match text.split("'descr': '").nth(1)?.split('\'').next()? {
        "<u4" => false,
        "<f4" => true,
        _ => return None,
    };
    let shape = text.split("'shape': (").nth(1)?.split(')').next()?;
    let mut sides = shape.split(',').map(|side| side.trim().parse::<usize>());
    let (frames, cones) = (sides.next()?.ok()?, sides.next()?.ok()?);
    frames.checked_mul(cones)?.checked_mul(4)?;
    (!text.contains("'fortran_order': True")).then_some((means, [frames, cones], *data))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photoneye_store::npy;

    #[test]
    fn frames_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("counts.npy");
        std::fs::write(&path, npy::u32_array(&[2, 3], &[1, 2, 3, 4, 5, 6])).unwrap();
        let mut counts = CountsFile::open(&path).unwrap();
        assert_eq!((counts.frames, counts.cones), (2, 3));
        assert_eq!(counts.frame(1).unwrap(), vec![4.0, 5.0, 6.0]);
        assert!(counts.frame(2).is_err());
        std::fs::write(&path, npy::f32_array(&[1, 2], &[0.5, 1.5])).unwrap();
        assert_eq!(CountsFile::open(&path).unwrap().frame(0).unwrap(), vec![0.5, 1.5]);
        std::fs::write(&path, "hello").unwrap();
        assert!(CountsFile::open(&path).is_err());
    }
}
