//! The uploads of an experiment, looked at before the job is taken: they are there and theirs who asks, pictures have the display's
//! size, and a measured mosaic's rows are cones.

use photoneye_eye::display::Display;
use photoneye_eye::experiment::{Clip, Retina, Video};
use photoneye_eye::movement::recording;
use photoneye_eye::retina::{RetinaGeometry, check_mosaic};
use photoneye_eye::video::{ClipInfo, FromFilm, Limits as PictureLimits, clip_info};
use photoneye_proto::{FieldError, v1};
use photoneye_store::BlobDigest;

use crate::access::Caller;
use crate::error::{Error, Kind};
use crate::service::Service;

/// The mosaic's field, for errors.
const FIELD: &str = "retina.mosaic.blob";

/// The recorded gaze's field, for errors.
const RECORDING: &str = "gaze.movement.recorded.blob";

/// Relative difference of rates that are taken as the same: 23.976 and 24 pictures a second are not.
const SAME_RATE: f64 = 5e-4;

/// Frames of a display that show a film once.
fn frames_of_film(clip: &Clip, info: &ClipInfo, display_hz: f64) -> Result<u32, FieldError> {
    let Some(film_hz) = info.rate_hz else {
        return match clip.from_film {
            None | Some(FromFilm::OneEach) => Ok(info.frames),
            Some(FromFilm::Repeat | FromFilm::Resample) => {
                let message = "the film does not say its rate; allowed is `ONE_EACH`, a picture a frame";
                Err(FieldError::new("frames.from_film", message))
            }
        };
    };
    let is_same = (film_hz / display_hz - 1.0).abs() < SAME_RATE;
    let Some(from_film) = clip.from_film.or(is_same.then_some(FromFilm::OneEach)) else {
        let message = format!(
            "is missing: the film has {film_hz:.3} pictures a second, the display {display_hz:.3} frames; `REPEAT` shows in \
             each frame the picture whose time it is, `RESAMPLE` the mean light of its time, `ONE_EACH` a picture a frame"
        );
        return Err(FieldError::new("frames.from_film", message));
    };
    Ok(from_film.frames(info.frames, film_hz, display_hz))
}

/// Says what `frames.from_film` is for.
pub(crate) fn no_film() -> FieldError {
    FieldError::new("frames.from_film", "needs a Y4M film of several pictures")
}

impl Service {
    /// The clip's files are there and of the display's size, and a film of another rate says what frames show
    /// of it; the number of frames that show a film once, `None` for pictures; and what to warn of. Only
    /// headers are read, and pictures with alpha.
    pub(crate) async fn check_pictures(
        &self,
        caller: &Caller,
        video: &Video,
        display: &Display,
    ) -> Result<(Option<u32>, Vec<String>), Error> {
        let Video::Clip(clip) = video else {
            return Ok((None, Vec::new()));
        };
        let (width, height) = (display.width_px, display.height_px);
        let mut seen = std::collections::BTreeSet::new();
        let mut film = None;
        let mut warnings = Vec::new();
        for (i, text) in clip.blobs.iter().enumerate() {
            if !seen.insert(text) {
                continue;
            }
            let path = format!("video.clip.blobs[{i}]");
            let bytes = self.upload(caller, &path, text).await?;
            let found = clip_info(&bytes, &clip.format, [width, height], PictureLimits::default());
            let info = found.map_err(|error| FieldError::new(path.clone(), error.to_string()))?;
            if (info.width, info.height) != (width, height) {
                let message = format!(
                    "the picture is {} x {} pixels, the display {width} x {height}",
                    info.width, info.height
                );
                return Err(FieldError::new(path, message).into());
            }
            if info.frames > 1 && clip.blobs.len() > 1 {
                let message = format!("a film of {} frames must be the only file", info.frames);
                return Err(FieldError::new(path, message).into());
            }
            let against = info.stated.and_then(|stated| stated.against(display.transfer));
            warnings.extend(against.map(|why| {
                format!(
                    "{path}: {why}; its pixel values are shown by display.transfer {}",
                    display.transfer.name()
                )
            }));
            film =
                (info.frames > 1).then(|| frames_of_film(clip, &info, display.frame_rate_hz)).transpose()?;
        }
        if film.is_none() && clip.from_film.is_some() {
            return Err(no_film().into());
        }
        Ok((film, warnings))
    }

    /// Puts the samples of an uploaded recording into the message; gives its digest.
    pub(crate) async fn read_recording(
        &self,
        caller: &Caller,
        message: &mut v1::Experiment,
    ) -> Result<Option<String>, Error> {
        let movement = message.gaze.as_mut().and_then(|gaze| gaze.movement.as_mut());
        let Some(v1::movement::Kind::Recorded(path)) = movement.and_then(|movement| movement.kind.as_mut())
        else {
            return Ok(None);
        };
        let Some(text) = path.blob.take() else { return Ok(None) };
        if !(path.t_s.is_empty() && path.x_arcmin.is_empty() && path.y_arcmin.is_empty()) {
            return Err(FieldError::new(RECORDING, "excludes t_s, x_arcmin and y_arcmin").into());
        }
        let bytes = self.upload(caller, RECORDING, &text).await?;
        let read = move || {
            let table = std::str::from_utf8(&bytes).map_err(|error| error.to_string())?;
            recording::read(table)
        };
        let read = tokio::task::spawn_blocking(read).await?.map_err(|why| FieldError::new(RECORDING, why))?;
        (path.t_s, path.x_arcmin, path.y_arcmin) = (read.t_s, read.x_arcmin, read.y_arcmin);
        Ok(Some(text))
    }

    /// Refuses a mosaic that no artifact can be built from, with the line and value that are wrong.
    pub(crate) async fn check_mosaic(&self, caller: &Caller, retina: &Retina) -> Result<(), Error> {
        let Some(text) = &retina.mosaic else {
            return Ok(());
        };
        let bytes = self.upload(caller, FIELD, text).await?;
        let params = retina.params(0.0, RetinaGeometry::default());
        let type_unknown = retina.mosaic_type_unknown;
        let check = move || {
            let csv = std::str::from_utf8(&bytes).map_err(|error| error.to_string())?;
            check_mosaic(csv, &params, type_unknown).map_err(|error| error.to_string())
        };
        let checked = tokio::task::spawn_blocking(check).await?;
        checked.map_err(|why| FieldError::new(FIELD, why))?;
        Ok(())
    }

    /// The bytes of an upload that a field names.
    async fn upload(&self, caller: &Caller, field: &str, text: &str) -> Result<Vec<u8>, Error> {
        let digest: BlobDigest = text.parse().map_err(|_| FieldError::new(field, "is not a digest"))?;
        let found = match self.readable(caller, &digest).await {
            Ok(()) => self.with_blobs(move |blobs| blobs.get(&digest)).await,
            Err(error) => Err(error),
        };
        found.map_err(|error| match error.kind {
            Kind::NotFound => FieldError::new(field, format!("{}; upload it first", error.message)).into(),
            _ => error,
        })
    }
}
