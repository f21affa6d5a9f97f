//! The result folder: filled beside its place and put there whole, so that nobody finds half a result.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use futures::StreamExt as _;
use photoneye_client::Client;
use photoneye_proto::v1;
use photoneye_store::BlobDigest;
use photoneye_store::npy::{self, Scalar};
use photoneye_store::table::{Chunk, CountsVec, read_counts};
use tempfile::TempDir;

use crate::failure::Failure;
use crate::photon_list::PhotonList;

/// What a result folder holds; whatever else lies in an existing one is left alone.
const KNOWN: [&str; 5] = ["frames", "cones.arrow", "counts.npy", "photons.arrow", "report.json"];

/// A result on its way into its folder. Dropped before [`Draft::publish`], it leaves nothing.
pub struct Draft {
    folder: TempDir,
    out: PathBuf,
}

impl Draft {
    /// Makes the folder beside `out` in which the result is gathered.
    ///
    /// # Errors
    /// When `out` is a file or the place cannot be written.
    pub fn new(out: &Path) -> Result<Self, Failure> {
        if out.exists() && !out.is_dir() {
            return Err(Failure::usage(format!("{} is not a folder", out.display())));
        }
        let name = out.file_name().map_or_else(|| "result".into(), |name| name.to_string_lossy());
        let parent = match out.parent() {
            Some(parent) if parent != Path::new("") => parent,
            _ => Path::new("."),
        };
        fs::create_dir_all(parent).map_err(|e| Failure::file("make", parent, &e))?;
        let folder = tempfile::Builder::new()
            .prefix(&format!(".{name}-"))
            .suffix(".tmp")
            .tempdir_in(parent)
            .map_err(|e| Failure::file("write to", parent, &e))?;
        Ok(Self { folder, out: out.to_owned() })
    }

    /// The folder that is being filled.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes one file.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        let path = self.path().join(name);
        fs::write(&path, bytes).map_err(|e| Failure::file("write", &path, &e))
    }

    /// Puts the result in its place: the whole folder, or its files one by one when the folder exists.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn publish(self) -> Result<PathBuf, Failure> {
        let out = self.out.clone();
        set_readable(self.path());
        if !out.exists() {
            fs::rename(self.path(), &out).map_err(|e| Failure::file("write", &out, &e))?;
            return Ok(out);
        }
        for name in KNOWN {
            let (from, to) = (self.path().join(name), out.join(name));
            let removed = if to.is_dir() { fs::remove_dir_all(&to) } else { fs::remove_file(&to) };
            match removed {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Failure::file("replace", &to, &e));
                }
                _ if from.exists() => fs::rename(&from, &to).map_err(|e| Failure::file("write", &to, &e))?,
                _ => {}
            }
        }
        Ok(out)
    }
}

/// Writes one file whole: beside its place, then renamed.
///
/// # Errors
/// When the place cannot be written.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_with(path, |file| file.write_all(bytes).map_err(|e| Failure::file("write", path, &e)))
}

/// Writes a file by `write`, whole or not at all.
///
/// # Errors
/// When the place cannot be written, or `write` fails.
pub fn write_with(
    path: &Path,
    write: impl FnOnce(&mut fs::File) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let parent = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let failed = |e: std::io::Error| Failure::file("write", path, &e);
    fs::create_dir_all(parent).map_err(failed)?;
    let mut draft = tempfile::NamedTempFile::new_in(parent).map_err(failed)?;
    write(draft.as_file_mut())?;
    draft.persist(path).map_err(|e| failed(e.error))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::set_permissions(path, fs::Permissions::from_mode(0o644)).map_err(failed)?;
    }
    Ok(())
}

/// Temporary folders are private; a result is as readable as other folders.
fn set_readable(path: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        if let Err(error) = fs::set_permissions(path, fs::Permissions::from_mode(0o755)) {
            tracing::debug!(%error, "the result folder stays private");
        }
    }
}

/// Fetches report, cones and counts of a job that succeeded.
///
/// # Errors
/// When the server cannot be reached, a chunk is missing or damaged, or the disk refuses.
pub async fn fetch(client: &Client, job: &v1::Job, draft: &Draft) -> Result<String, Failure> {
    draft.write("cones.arrow", &client.cones(job.id()).await?)?;
    let frames = job.plan.as_ref().map_or(0, v1::Plan::frames) as usize;
    fetch_counts(client, job.id(), frames, job.cones() as usize, draft.path()).await?;
    let report = client.report(job.id()).await?;
    draft.write("report.json", report.as_bytes())?;
    Ok(report)
}

/// Writes each chunk to its place in counts.npy, and photons.arrow when photons are listed; memory holds one chunk.
async fn fetch_counts(
    client: &Client,
    id: &str,
    frames: usize,
    cones: usize,
    folder: &Path,
) -> Result<(), Failure> {
    let path = folder.join("counts.npy");
    let failed = |e: std::io::Error| Failure::file("write", &path, &e);
    let mut file = File::create(&path).map_err(failed)?;
    let mut photons = PhotonList::default();
    let mut layout: Option<Layout> = None;
    let mut seen = HashSet::new();
    let mut filled = 0;
    let mut chunks = std::pin::pin!(client.results(id, 1));
    while let Some(message) = chunks.next().await {
        let message = message?;
        let chunk = decode(&message)?;
        if layout.is_none() {
            let fresh = Layout::new(&chunk.counts, frames, cones);
            file.write_all(&fresh.header).map_err(failed)?;
            layout = Some(fresh);
        }
        let Some(layout) = &layout else { continue };
        let offset = layout.offset(&chunk)?;
        if seen.insert((chunk.frame, chunk.tile)) {
            filled += chunk.counts.len();
            file.seek(SeekFrom::Start(offset)).map_err(failed)?;
            file.write_all(&layout.bytes(&chunk.counts)?).map_err(failed)?;
            photons.keep(message.bytes())?;
        }
    }
    if layout.is_none() {
        file.write_all(&npy::header(Scalar::U32, &[frames, cones])).map_err(failed)?;
    }
    if filled == frames * cones {
        photons.write(&folder.join("photons.arrow"))
    } else {
        Err(Failure::failed(format!(
            "the result is incomplete: {filled} of {} counts arrived",
            frames * cones
        )))
    }
}

/// Verifies and reads one chunk.
fn decode(message: &v1::ResultChunk) -> Result<Chunk, Failure> {
    let bytes = message.bytes.as_deref().unwrap_or_default();
    if BlobDigest::of(bytes).to_string() != message.digest() {
        return Err(Failure::failed(format!("result chunk {} arrived damaged", message.seq())));
    }
    read_counts(bytes).map_err(|error| Failure::failed(format!("result chunk {}: {error}", message.seq())))
}

/// Where a chunk goes in counts.npy.
struct Layout {
    header: Vec<u8>,
    frames: usize,
    cones: usize,
    means: bool,
}

impl Layout {
    fn new(counts: &CountsVec, frames: usize, cones: usize) -> Self {
        let means = matches!(counts, CountsVec::F32(_));
        let scalar = if means { Scalar::F32 } else { Scalar::U32 };
        Self { header: npy::header(scalar, &[frames, cones]), frames, cones, means }
    }

    fn offset(&self, chunk: &Chunk) -> Result<u64, Failure> {
        let first = chunk.first_cone as usize;
        if chunk.frame as usize >= self.frames || first + chunk.counts.len() > self.cones {
            return Err(Failure::failed("a result chunk does not fit the job"));
        }
        Ok((self.header.len() + 4 * (chunk.frame as usize * self.cones + first)) as u64)
    }

    fn bytes(&self, counts: &CountsVec) -> Result<Vec<u8>, Failure> {
        match counts {
            CountsVec::U32(values) if !self.means => {
                Ok(values.iter().flat_map(|v| v.to_le_bytes()).collect())
            }
            CountsVec::F32(values) if self.means => Ok(values.iter().flat_map(|v| v.to_le_bytes()).collect()),
            CountsVec::U32(_) | CountsVec::F32(_) => Err(Failure::failed("result chunks differ in type")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_draft_leaves_nothing_and_a_published_one_keeps_strangers() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("face");
        drop(Draft::new(&out).unwrap());
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);

        let first = Draft::new(&out).unwrap();
        first.write("report.json", b"1").unwrap();
        first.publish().unwrap();
        fs::write(out.join("notes.txt"), "mine").unwrap();
        let second = Draft::new(&out).unwrap();
        second.write("report.json", b"2").unwrap();
        second.publish().unwrap();
        assert_eq!(fs::read(out.join("report.json")).unwrap(), b"2");
        assert!(out.join("notes.txt").exists());
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_is_no_result_folder() {
        let place = tempfile::tempdir().unwrap();
        let out = place.path().join("face");
        fs::write(&out, "").unwrap();
        assert!(matches!(Draft::new(&out), Err(Failure::Usage(_))));
    }
}
