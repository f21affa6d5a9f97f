//! What is shown, where the eye looks and how it moves.

use photoneye_eye::display::Display;
use photoneye_eye::experiment::{Gaze, Movement, Pattern, Video};
use photoneye_proto::FieldError;
use photoneye_proto::v1::{self, movement, pattern, video};
use photoneye_store::BlobDigest;

use super::read::{empty_choice, needed, number, numbers};

/// The picture or pictures.
///
/// # Errors
/// The first field that is missing or does not fit.
pub fn video(spec: Option<&v1::Video>, gaze: &Gaze, display: &Display) -> Result<Video, FieldError> {
    match &needed("video", spec)?.kind {
        Some(video::Kind::Files(_)) => Err(FieldError::new(
            "video.files",
            "the server reads no files: upload the pictures (PUT /v1/blobs) and send their digests as `clip`",
        )),
        Some(video::Kind::Clip(clip)) => {
            for (i, blob) in clip.blobs.iter().enumerate() {
                let wrong = |error: photoneye_store::digest::NotADigest| {
                    FieldError::new(format!("video.clip.blobs[{i}]"), error.to_string())
                };
                blob.parse::<BlobDigest>().map_err(wrong)?;
            }
            Ok(Video::Clip(clip.blobs.clone()))
        }
        Some(video::Kind::Pattern(pattern)) => Ok(Video::Pattern(pattern_of(pattern, gaze, display)?)),
        None => Err(empty_choice("video", &["files", "clip", "pattern"])),
    }
}

fn pattern_of(spec: &v1::Pattern, gaze: &Gaze, display: &Display) -> Result<Pattern, FieldError> {
    Ok(match &spec.kind {
        Some(pattern::Kind::Uniform(uniform)) => {
            Pattern::Uniform { rgb: numbers("video.pattern.uniform.rgb", &uniform.rgb)? }
        }
        Some(pattern::Kind::Grating(grating)) => Pattern::Grating {
            cycles_per_degree: needed("video.pattern.grating.cycles_per_degree", grating.cycles_per_degree)?
                + 0.0,
            contrast: number(grating.contrast, 1.0),
            orientation_deg: number(grating.orientation_deg, 0.0),
            phase_deg: number(grating.phase_deg, 0.0),
        },
        Some(pattern::Kind::Checkerboard(board)) => {
            Pattern::Checkerboard { square_px: board.square_px.unwrap_or(1) }
        }
        Some(pattern::Kind::Point(point)) => Pattern::Point {
            at_px: match point.at_px.as_slice() {
                [] => middle_pixel(gaze, display),
                &[x, y] => [x, y],
                other => {
                    let message = format!("{} values, expected 2", other.len());
                    return Err(FieldError::new("video.pattern.point.at_px", message));
                }
            },
            rgb: match point.rgb.as_slice() {
                [] => [1.0; 3],
                values => numbers("video.pattern.point.rgb", values)?,
            },
        },
        None => {
            return Err(empty_choice("video.pattern", &["uniform", "grating", "checkerboard", "point"]));
        }
    })
}

/// The pixel at the gaze centre, or the nearest one.
fn middle_pixel(gaze: &Gaze, display: &Display) -> [u32; 2] {
    let pixel = |center: f64, size: u32| (center.max(0.0) as u32).min(size.saturating_sub(1));
    [pixel(gaze.center_px[0], display.width_px), pixel(gaze.center_px[1], display.height_px)]
}

/// Where the eye looks.
///
/// # Errors
/// The first field that does not fit.
pub fn gaze(spec: Option<&v1::Gaze>, display: &Display) -> Result<Gaze, FieldError> {
    let center = spec.map_or(&[][..], |spec| &spec.center_px);
    let center_px = if center.is_empty() {
        [0.5 * f64::from(display.width_px), 0.5 * f64::from(display.height_px)]
    } else {
        numbers("gaze.center_px", center)?
    };
    let movement = match spec.and_then(|spec| spec.movement.as_ref()) {
        None => Movement::Still,
        Some(spec) => match &spec.kind {
            Some(movement::Kind::Still(_)) => Movement::Still,
            Some(movement::Kind::Drift(spec)) => drift(spec),
            None => return Err(empty_choice("gaze.movement", &["drift", "still"])),
        },
    };
    Ok(Gaze { center_px, movement })
}

/// A drift; what is not given is the paper's default of §11.
fn drift(spec: &movement::Drift) -> Movement {
    Movement::Drift {
        speed_arcmin_per_s: number(spec.speed_arcmin_per_s, 6.0),
        direction_deg: number(spec.direction_deg, 30.0),
    }
}
