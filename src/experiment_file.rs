//! An experiment as it stands in a file: read, changed by --set, its recorded path filled in, its pictures uploaded.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use photoneye_client::Client;
use photoneye_eye::movement::recording;
use photoneye_eye::video::{ClipFormat, Limits, clip_info};
use photoneye_proto::{experiment_from_json, v1};
use photoneye_store::BlobDigest;
use serde_json::Value;

use crate::failure::{Failure, plain};

/// Most bytes of an experiment; the server takes no more.
const MAX_SPEC_BYTES: u64 = 1 << 20;
/// Most bytes of one picture or film.
const MAX_PICTURE_BYTES: u64 = 1 << 30;

/// An experiment whose pictures are still files.
#[derive(Debug)]
pub struct ExperimentFile {
    /// The experiment.
    pub experiment: v1::Experiment,
    /// Name of the file without folder and ending.
    pub stem: String,
    pictures: Vec<Upload>,
    mosaic: Option<Upload>,
    /// A recorded gaze that is too long to be sent with the experiment.
    recording: Option<Upload>,
}

/// A file that was read.
#[derive(Debug)]
struct Upload {
    path: PathBuf,
    bytes: Bytes,
}

impl ExperimentFile {
    /// Reads the file, applies `PATH=VALUE` changes, and reads the pictures that it names.
    ///
    /// # Errors
    /// The file, field or picture that is wrong.
    pub fn read(path: &Path, changes: &[String]) -> Result<Self, Failure> {
        let name = path.display();
        let text = read_text(path)?;
        let mut value: Value = serde_json::from_str(&text)
            .map_err(|error| Failure::usage(format!("{name}: not JSON: {error}")))?;
        for change in changes {
            set(&mut value, change)?;
        }
        // Without changes the text itself is read, so that a field that is given twice is noticed.
        let text = if changes.is_empty() { text } else { value.to_string() };
        let mut experiment =
            experiment_from_json(&text).map_err(|error| Failure::usage(format!("{name}: {error}")))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let pictures = match experiment.video.as_ref().and_then(|video| video.kind.as_ref()) {
            Some(v1::video::Kind::Files(files)) => read_pictures(folder, &files.paths, files.raw.is_some())?,
            _ => Vec::new(),
        };
        let mosaic = read_mosaic(folder, experiment.retina.as_ref())?;
        let recording = fill_in_path(folder, &mut experiment)?;
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        Ok(Self {
            experiment,
            stem: stem.filter(|stem| stem != "-").unwrap_or_else(|| "experiment".into()),
            pictures,
            mosaic,
            recording,
        })
    }

    /// Uploads the pictures, the mosaic and a long recorded gaze and names them by digest in the experiment.
    ///
    /// # Errors
    /// When the server does not take them.
    pub async fn upload(&mut self, client: &Client) -> Result<(), Failure> {
        if let Some(table) = &self.mosaic {
            let blob = client.put_blob(table.bytes.clone()).await?;
            let kind = Some(v1::mosaic::Kind::Blob(blob));
            self.experiment.retina.get_or_insert_default().mosaic.get_or_insert_default().kind = kind;
        }
        if let Some(table) = &self.recording {
            let blob = client.put_blob(table.bytes.clone()).await?;
            if let Some(path) = recorded(&mut self.experiment) {
                path.blob = Some(blob);
            }
        }
        if self.pictures.is_empty() {
            return Ok(());
        }
        let mut blobs = Vec::with_capacity(self.pictures.len());
        for picture in &self.pictures {
            blobs.push(client.put_blob(picture.bytes.clone()).await?);
        }
        self.name_clip(blobs);
        Ok(())
    }

    /// Names the pictures by digest without uploading them and gives their bytes, for work without a server. A measured mosaic stays
    /// a file.
    pub fn keep(&mut self) -> Vec<Bytes> {
        let text = self.recording.as_ref().and_then(|table| std::str::from_utf8(&table.bytes).ok());
        // It was read once, so that it is a table.
        if let (Some(Ok(read)), Some(path)) = (text.map(recording::read), recorded(&mut self.experiment)) {
            (path.t_s, path.x_arcmin, path.y_arcmin) = (read.t_s, read.x_arcmin, read.y_arcmin);
        }
        let pictures: Vec<Bytes> = self.pictures.iter().map(|picture| picture.bytes.clone()).collect();
        if !pictures.is_empty() {
            let blobs = pictures.iter().map(|bytes| BlobDigest::of(bytes).to_string()).collect();
            self.name_clip(blobs);
        }
        pictures
    }

    /// Puts digests in the place of files.
    fn name_clip(&mut self, blobs: Vec<String>) {
        let (yuv, raw) = match self.experiment.video.as_ref().and_then(|video| video.kind.as_ref()) {
            Some(v1::video::Kind::Files(files)) => (files.yuv, files.raw),
            _ => (None, None),
        };
        let clip = v1::video::Clip { blobs, yuv, raw };
        self.experiment.video = Some(v1::Video { kind: Some(v1::video::Kind::Clip(clip)) });
    }

    /// Says which file is meant where the server names an upload.
    pub fn name_pictures(&self, failure: Failure) -> Failure {
        let name = |text: String| {
            let named = |(text, i): (String, usize), picture: &Upload| {
                let path = picture.path.display().to_string();
                (text.replace(&format!("video.clip.blobs[{i}]"), &path), i + 1)
            };
            let text = self.pictures.iter().fold((text, 0), named).0;
            let tables =
                [("retina.mosaic.blob", &self.mosaic), ("gaze.movement.recorded.blob", &self.recording)];
            tables.into_iter().fold(text, |text, (field, table)| match table {
                Some(table) => text.replace(field, &table.path.display().to_string()),
                None => text,
            })
        };
        match failure {
            Failure::Usage(text) => Failure::Usage(name(text)),
            Failure::Failed(text) => Failure::Failed(name(text)),
            Failure::BrokenPipe => Failure::BrokenPipe,
        }
    }
}

fn read_text(path: &Path) -> Result<String, Failure> {
    let wrong = |error: std::io::Error| Failure::usage(format!("{}: {}", path.display(), plain(&error)));
    let mut text = String::new();
    if path == Path::new("-") {
        std::io::stdin().take(MAX_SPEC_BYTES + 1).read_to_string(&mut text)
    } else {
        let file = std::fs::File::open(path).map_err(wrong)?;
        file.take(MAX_SPEC_BYTES + 1).read_to_string(&mut text)
    }
    .map_err(wrong)?;
    if text.len() as u64 > MAX_SPEC_BYTES {
        return Err(Failure::usage(format!("{}: larger than 1 MiB", path.display())));
    }
    // Editors of Windows put a byte order mark first.
    if let Some(rest) = text.strip_prefix('\u{feff}') {
        return Ok(rest.to_owned());
    }
    Ok(text)
}

/// The recorded path of an experiment, if it has one.
fn recorded(experiment: &mut v1::Experiment) -> Option<&mut v1::movement::Recorded> {
    match experiment.gaze.as_mut()?.movement.as_mut()?.kind.as_mut()? {
        v1::movement::Kind::Recorded(path) => Some(path),
        _ => None,
    }
}

/// Reads the CSV file of a recorded path, if the experiment names one: its samples are put into the
/// experiment, or the file is to be uploaded where it is long.
fn fill_in_path(folder: &Path, experiment: &mut v1::Experiment) -> Result<Option<Upload>, Failure> {
    let Some(path) = recorded(experiment) else { return Ok(None) };
    let Some(file) = path.file.take() else { return Ok(None) };
    let file = folder.join(file);
    let wrong =
        |why: String| Failure::usage(format!("gaze.movement.recorded.file: {}: {why}", file.display()));
    if !(path.t_s.is_empty() && path.x_arcmin.is_empty() && path.y_arcmin.is_empty()) {
        return Err(wrong("excludes t_s, x_arcmin and y_arcmin".into()));
    }
    let length = std::fs::metadata(&file).map_err(|e| wrong(plain(&e)))?.len();
    if length > MAX_PICTURE_BYTES {
        return Err(wrong(format!("{length} bytes, allowed are {MAX_PICTURE_BYTES}")));
    }
    let text = std::fs::read_to_string(&file).map_err(|e| wrong(plain(&e)))?;
    let read = recording::read(&text).map_err(wrong)?;
    if length > MAX_SPEC_BYTES {
        return Ok(Some(Upload { path: file, bytes: text.into() }));
    }
    (path.t_s, path.x_arcmin, path.y_arcmin) = (read.t_s, read.x_arcmin, read.y_arcmin);
    Ok(None)
}

fn read_pictures(folder: &Path, paths: &[String], raw: bool) -> Result<Vec<Upload>, Failure> {
    if paths.is_empty() {
        return Err(Failure::usage("video.files.paths: names no picture"));
    }
    let read = |(i, path): (usize, &String)| {
        let path = folder.join(path);
        read_picture(&path, raw)
            .map_err(|why| Failure::usage(format!("video.files.paths[{i}]: {}: {why}", path.display())))
    };
    paths.iter().enumerate().map(read).collect()
}

/// The table of a measured mosaic, if the experiment names a file.
fn read_mosaic(folder: &Path, retina: Option<&v1::Retina>) -> Result<Option<Upload>, Failure> {
    let kind = retina.and_then(|retina| retina.mosaic.as_ref()).and_then(|mosaic| mosaic.kind.as_ref());
    let Some(v1::mosaic::Kind::File(file)) = kind else {
        return Ok(None);
    };
    let path = folder.join(file);
    let wrong = |why: String| Failure::usage(format!("retina.mosaic.file: {}: {why}", path.display()));
    let length = std::fs::metadata(&path).map_err(|e| wrong(plain(&e)))?.len();
    if length > MAX_PICTURE_BYTES {
        return Err(wrong(format!("{length} bytes, allowed are {MAX_PICTURE_BYTES}")));
    }
    let bytes = Bytes::from(std::fs::read(&path).map_err(|e| wrong(plain(&e)))?);
    Ok(Some(Upload { path, bytes }))
}

fn read_picture(path: &Path, raw: bool) -> Result<Upload, String> {
    let length = std::fs::metadata(path).map_err(|e| plain(&e))?.len();
    if length > MAX_PICTURE_BYTES {
        return Err(format!("{length} bytes, allowed are {MAX_PICTURE_BYTES}"));
    }
    let bytes = Bytes::from(std::fs::read(path).map_err(|e| plain(&e))?);
    // What needs the display's size or the film's colours is checked by the server.
    if !raw && !bytes.starts_with(b"YUV4MPEG2") {
        let checked = clip_info(&bytes, &ClipFormat::default(), [0; 2], Limits::default());
        checked.map_err(|e| e.to_string())?;
    }
    Ok(Upload { path: path.to_owned(), bytes })
}

/// Applies one `a.b[0].c=value`; the value is JSON, or text when it is not.
///
/// # Errors
/// When the text has no such form or the place cannot be.
pub fn set(root: &mut Value, change: &str) -> Result<(), Failure> {
    let wrong = |why: &str| Failure::usage(format!("--set {change}: {why}"));
    let (path, text) =
        change.split_once('=').ok_or_else(|| wrong("expected PATH=VALUE, for example eye.pupil_mm=5"))?;
    let value = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
    let mut place = root;
    for step in path.replace('[', ".[").split('.') {
        let index = step.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        place = match (index, place) {
            (Some(index), Value::Array(items)) => {
                let length = items.len();
                let item = index.parse().ok().and_then(|i: usize| items.get_mut(i));
                item.ok_or_else(|| wrong(&format!("there is no `[{index}]`, the list has {length}")))?
            }
            (Some(_), _) => return Err(wrong(&format!("`{step}` is not in a list"))),
            (None, _) if step.is_empty() => return Err(wrong("a name is empty")),
            (None, place @ (Value::Null | Value::Object(_))) => {
                if place.is_null() {
                    *place = Value::Object(serde_json::Map::new());
                }
                place
                    .as_object_mut()
                    .ok_or_else(|| wrong("not an object"))?
                    .entry(step)
                    .or_insert(Value::Null)
            }
            (None, _) => return Err(wrong(&format!("what holds `{step}` has no fields"))),
        };
    }
    *place = value;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn changed(change: &str) -> Result<Value, String> {
        let mut value = json!({"eye": {"pupil_mm": 3}, "gaze": {"center_px": [15, 15]}});
        set(&mut value, change).map_err(|e| e.to_string())?;
        Ok(value)
    }

    #[test]
    fn changes_reach_fields_lists_and_new_places() {
        assert_eq!(changed("eye.pupil_mm=5.5").unwrap()["eye"]["pupil_mm"], 5.5);
        assert_eq!(changed("gaze.center_px[1]=3").unwrap()["gaze"]["center_px"], json!([15, 3]));
        assert_eq!(changed("counts.noise=NONE").unwrap()["counts"]["noise"], "NONE");
        assert_eq!(changed("counts.seed=18446744073709551615").unwrap()["counts"]["seed"], u64::MAX);
        assert_eq!(
            changed("gaze.movement={\"still\":{}}").unwrap()["gaze"]["movement"],
            json!({"still": {}})
        );
    }

    #[test]
    fn wrong_changes_are_named() {
        for (change, part) in [
            ("eye.pupil_mm", "PATH=VALUE"),
            ("eye.pupil_mm.x=1", "no fields"),
            ("gaze.center_px[7]=1", "the list has 2"),
            ("eye[0]=1", "not in a list"),
            ("eye..x=1", "empty"),
        ] {
            let error = changed(change).unwrap_err();
            assert!(error.contains(part) && error.contains(change), "{error}");
        }
    }
}
