//! photons.arrow of a result folder: chunks come in the order of their commits and are put in order of frame and tile.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;

use photoneye_store::photons::{PhotonsTable, read_photons};
use photoneye_store::table::read_counts;

use crate::failure::Failure;

/// Chunks that list photons, put aside in a temporary file.
#[derive(Default)]
pub struct PhotonList {
    aside: Option<File>,
    end: u64,
    /// By frame and tile: place and length in the file.
    places: BTreeMap<(u32, u32), (u64, usize)>,
}

impl PhotonList {
    /// Puts a chunk aside, if it lists photons.
    ///
    /// # Errors
    /// When the chunk is damaged or there is no room.
    pub fn keep(&mut self, chunk: &[u8]) -> Result<(), Failure> {
        if read_photons(chunk).map_err(Failure::failed)?.is_none() {
            return Ok(());
        }
        let counts = read_counts(chunk).map_err(Failure::failed)?;
        let file = match &mut self.aside {
            Some(file) => file,
            None => self.aside.insert(tempfile::tempfile().map_err(Failure::failed)?),
        };
        file.write_all(chunk).map_err(Failure::failed)?;
        self.places.insert((counts.frame, counts.tile), (self.end, chunk.len()));
        self.end += chunk.len() as u64;
        Ok(())
    }

    /// Writes the table, if any chunk listed photons.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(self, path: &Path) -> Result<(), Failure> {
        let failed = |e: std::io::Error| Failure::file("write", path, &e);
        let Some(mut aside) = self.aside else {
            return Ok(());
        };
        let mut file = File::create(path).map_err(failed)?;
        let mut table = PhotonsTable::new().map_err(Failure::failed)?;
        for ((frame, _), (from, length)) in self.places {
            let mut chunk = vec![0; length];
            aside.seek(SeekFrom::Start(from)).map_err(failed)?;
            aside.read_exact(&mut chunk).map_err(failed)?;
            let photons = read_photons(&chunk).map_err(Failure::failed)?.unwrap_or_default();
            file.write_all(&table.push(frame, &photons).map_err(Failure::failed)?).map_err(failed)?;
        }
        file.write_all(&table.finish().map_err(Failure::failed)?).map_err(failed)
    }
}
