//! What is shown, where the eye looks and how it moves.

use photoneye_eye::display::Display;
use photoneye_eye::experiment::{
    ChartRow, Clip, Experiment, Gaze, Microsaccades, Movement, Pattern, SizesHold, SloanChart, Tremor, Video,
};
use photoneye_eye::video::{
    ChromaSiting, ClipFormat, FromFilm, Matrix, Range, Raw, Yuv, logmar_rows, paper_rows,
};
use photoneye_proto::FieldError;
use photoneye_proto::v1::{self, movement, pattern, video};
use photoneye_store::BlobDigest;

use crate::uploads::no_film;

use super::read::{choice, empty_choice, needed, number, numbers};

/// The picture or pictures.
///
/// # Errors
/// The first field that is missing or does not fit.
pub fn video(
    (spec, frames): (Option<&v1::Video>, Option<&v1::Frames>),
    gaze: &Gaze,
    display: &Display,
) -> Result<Video, FieldError> {
    match &needed("video", spec)?.kind {
        Some(video::Kind::Files(_)) => Err(FieldError::new(
            "video.files",
            "the server reads no files: upload the pictures (PUT /v1/blobs) and send their digests as `clip`",
        )),
        Some(video::Kind::Clip(clip)) => {
            Ok(Video::Clip(Clip { from_film: from_film(frames)?, ..clip_of(clip)? }))
        }
        Some(video::Kind::Pattern(_)) if from_film(frames)?.is_some() => Err(no_film()),
        Some(video::Kind::Pattern(pattern)) => Ok(Video::Pattern(pattern_of(pattern, gaze, display)?)),
        None => Err(empty_choice("video", &["files", "clip", "pattern"])),
    }
}

fn clip_of(clip: &video::Clip) -> Result<Clip, FieldError> {
    for (i, blob) in clip.blobs.iter().enumerate() {
        let wrong = |error: photoneye_store::digest::NotADigest| {
            FieldError::new(format!("video.clip.blobs[{i}]"), error.to_string())
        };
        blob.parse::<BlobDigest>().map_err(wrong)?;
    }
    Ok(Clip {
        blobs: clip.blobs.clone(),
        format: format("video.clip", clip.yuv.as_ref(), clip.raw.as_ref())?,
        from_film: None,
    })
}

/// What frames show of a film whose rate is not the display's.
fn from_film(spec: Option<&v1::Frames>) -> Result<Option<FromFilm>, FieldError> {
    use v1::frames::FromFilm as F;
    let Some(said) = spec.and_then(|frames| frames.from_film) else { return Ok(None) };
    Ok(Some(match choice("frames.from_film", Some(said), F::OneEach, F::as_str_name)? {
        F::OneEach => FromFilm::OneEach,
        F::Repeat => FromFilm::Repeat,
        F::Resample => FromFilm::Resample,
    }))
}

/// What a clip's files mean.
///
/// # Errors
/// The first field that is missing or does not fit.
pub fn format(path: &str, yuv: Option<&v1::Yuv>, raw: Option<&v1::Raw>) -> Result<ClipFormat, FieldError> {
    use v1::yuv::{ChromaSiting as S, Matrix as M, Range as R};
    let yuv = match yuv {
        None => None,
        Some(yuv) => {
            needed(&format!("{path}.yuv.matrix"), yuv.matrix)?;
            needed(&format!("{path}.yuv.range"), yuv.range)?;
            let matrix = match choice(&format!("{path}.yuv.matrix"), yuv.matrix, M::Bt709, M::as_str_name)? {
                M::Bt601 => Matrix::Bt601,
                M::Bt709 => Matrix::Bt709,
                M::Bt2020 => Matrix::Bt2020,
            };
            let range = match choice(&format!("{path}.yuv.range"), yuv.range, R::Limited, R::as_str_name)? {
                R::Limited => Range::Limited,
                R::Full => Range::Full,
            };
            let siting = |given| {
                Ok(
                    match choice(&format!("{path}.yuv.chroma_siting"), Some(given), S::Left, S::as_str_name)?
                    {
                        S::Left => ChromaSiting::Left,
                        S::Center => ChromaSiting::Center,
                        S::TopLeft => ChromaSiting::TopLeft,
                    },
                )
            };
            Some(Yuv { matrix, range, chroma_siting: yuv.chroma_siting.map(siting).transpose()? })
        }
    };
    let raw = match raw.map(|raw| raw.bits.unwrap_or(8)) {
        None => None,
        Some(bits @ (8 | 16)) => Some(Raw { bits }),
        Some(bits) => {
            let message = format!("{bits} is out of range, allowed is 8 or 16");
            return Err(FieldError::new(format!("{path}.raw.bits"), message));
        }
    };
    Ok(ClipFormat { yuv, raw })
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
            sizes_hold: sizes_hold("video.pattern.grating.sizes_hold", grating.sizes_hold)?,
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
            rgb: colour("video.pattern.point.rgb", &point.rgb, 1.0)?,
        },
        Some(pattern::Kind::Sweep(sweep)) => {
            let path = |name: &str| format!("video.pattern.sweep.{name}_cycles_per_degree");
            Pattern::Sweep {
                from_cycles_per_degree: needed(&path("from"), sweep.from_cycles_per_degree)? + 0.0,
                to_cycles_per_degree: needed(&path("to"), sweep.to_cycles_per_degree)? + 0.0,
                contrast: number(sweep.contrast, 1.0),
                rgb: colour("video.pattern.sweep.rgb", &sweep.rgb, 1.0)?,
                sizes_hold: sizes_hold("video.pattern.sweep.sizes_hold", sweep.sizes_hold)?,
            }
        }
        Some(pattern::Kind::SloanChart(chart)) => Pattern::SloanChart(chart_of(chart)?),
        None => {
            let names = ["uniform", "grating", "checkerboard", "point", "sweep", "sloan_chart"];
            return Err(empty_choice("video.pattern", &names));
        }
    })
}

fn sizes_hold(field: &str, given: Option<i32>) -> Result<SizesHold, FieldError> {
    use pattern::grating::SizesHold as S;
    Ok(match choice(field, given, S::AtGaze, S::as_str_name)? {
        S::AtGaze => SizesHold::AtGaze,
        S::Everywhere => SizesHold::Everywhere,
    })
}

/// Red, green, blue, or the same value thrice.
fn colour(path: &str, values: &[f64], default: f64) -> Result<[f64; 3], FieldError> {
    if values.is_empty() { Ok([default; 3]) } else { numbers(path, values) }
}

fn chart_of(spec: &pattern::SloanChart) -> Result<SloanChart, FieldError> {
    use pattern::sloan_chart::Layout as L;
    let path = "video.pattern.sloan_chart";
    if spec.layout.is_some() && !spec.rows.is_empty() {
        return Err(FieldError::new(format!("{path}.layout"), "excludes `rows`"));
    }
    let rows = if spec.rows.is_empty() {
        match choice(&format!("{path}.layout"), spec.layout, L::Logmar, L::as_str_name)? {
            L::Logmar => logmar_rows(),
            L::Paper => paper_rows(),
        }
    } else {
        let row = |(i, row): (usize, &pattern::Row)| {
            Ok(ChartRow {
                letters: needed(&format!("{path}.rows[{i}].letters"), row.letters.clone())?,
                stroke_arcmin: needed(&format!("{path}.rows[{i}].stroke_arcmin"), row.stroke_arcmin)?,
            })
        };
        spec.rows.iter().enumerate().map(row).collect::<Result<_, FieldError>>()?
    };
    let lower = format!("{path}.lower_paper_rgb");
    let lower =
        (!spec.lower_paper_rgb.is_empty()).then(|| numbers(&lower, &spec.lower_paper_rgb)).transpose()?;
    Ok(SloanChart {
        rows,
        paper_rgb: colour(&format!("{path}.paper_rgb"), &spec.paper_rgb, 1.0)?,
        ink_rgb: colour(&format!("{path}.ink_rgb"), &spec.ink_rgb, 0.0)?,
        lower_paper_rgb: lower,
        sizes_hold: sizes_hold(&format!("{path}.sizes_hold"), spec.sizes_hold)?,
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
    let movement = spec.and_then(|spec| spec.movement.as_ref());
    Ok(Gaze {
        center_px,
        movement: movement.map_or(Ok(Movement::Still), base)?,
        tremor: movement.and_then(|m| m.tremor.as_ref()).map(tremor),
        microsaccades: movement.and_then(|m| m.microsaccades.as_ref()).map(microsaccades),
        seed: movement.and_then(|m| m.seed).unwrap_or(0),
    })
}

fn base(spec: &v1::Movement) -> Result<Movement, FieldError> {
    Ok(match &spec.kind {
        Some(movement::Kind::Still(_)) => Movement::Still,
        Some(movement::Kind::Drift(spec)) => drift(spec),
        Some(movement::Kind::Walk(walk)) => Movement::Walk { unit_arcmin: number(walk.unit_arcmin, 0.5) },
        Some(movement::Kind::Recorded(path)) => recorded(path)?,
        None if spec.tremor.is_some() || spec.microsaccades.is_some() => Movement::Still,
        None => return Err(empty_choice("gaze.movement", &["drift", "walk", "recorded", "still"])),
    })
}

fn recorded(spec: &movement::Recorded) -> Result<Movement, FieldError> {
    if spec.file.is_some() {
        let message = "the server reads no files: upload the table (PUT /v1/blobs) and send its digest as `blob`, or send \
                       t_s, x_arcmin and y_arcmin";
        return Err(FieldError::new("gaze.movement.recorded.file", message));
    }
    let count = spec.t_s.len();
    for (name, list) in [("x_arcmin", &spec.x_arcmin), ("y_arcmin", &spec.y_arcmin)] {
        if list.len() != count {
            let message = format!("{} values, expected {count} as in t_s", list.len());
            return Err(FieldError::new(format!("gaze.movement.recorded.{name}"), message));
        }
    }
    let sample = |i: usize| [spec.t_s[i] + 0.0, spec.x_arcmin[i] + 0.0, spec.y_arcmin[i] + 0.0];
    Ok(Movement::Recorded((0..count).map(sample).collect()))
}

/// Refuses a recorded gaze whose samples do not cover the frames, unless it says that the eye holds.
///
/// # Errors
/// The times of recording and frames, and what is possible.
pub fn recording_covers(spec: Option<&v1::Gaze>, experiment: &Experiment) -> Result<(), FieldError> {
    use movement::recorded::Extend;
    let movement = spec.and_then(|gaze| gaze.movement.as_ref());
    let Some(movement::Kind::Recorded(recorded)) = movement.and_then(|movement| movement.kind.as_ref())
    else {
        return Ok(());
    };
    let extend =
        choice("gaze.movement.recorded.extend", recorded.extend, Extend::Refuse, Extend::as_str_name)?;
    let Movement::Recorded(samples) = &experiment.gaze.movement else { return Ok(()) };
    let ([first, ..], [last, ..]) = (samples[0], samples[samples.len() - 1]);
    let end = f64::from(experiment.frames) / experiment.display.frame_rate_hz;
    // The last sample holds for an interval, and so may the first.
    let interval = (last - first) / (samples.len().max(2) - 1) as f64;
    let slack = interval + 1e-9;
    if extend == Extend::Hold || (first <= slack && last + slack >= end) {
        return Ok(());
    }
    let message = format!(
        "the samples are from {first} to {last} s, the frames from 0 to {end:.6} s; allowed are samples that cover the \
         frames, or `extend: HOLD`"
    );
    Err(FieldError::new("gaze.movement.recorded.t_s", message))
}

fn tremor(spec: &movement::Tremor) -> Tremor {
    let default = Tremor::default();
    Tremor {
        rms_arcmin: number(spec.rms_arcmin, default.rms_arcmin),
        from_hz: number(spec.from_hz, default.from_hz),
        to_hz: number(spec.to_hz, default.to_hz),
    }
}

fn microsaccades(spec: &movement::Microsaccades) -> Microsaccades {
    let default = Microsaccades::default();
    Microsaccades {
        rate_hz: number(spec.rate_hz, default.rate_hz),
        from_arcmin: number(spec.from_arcmin, default.from_arcmin),
        to_arcmin: number(spec.to_arcmin, default.to_arcmin),
        duration_ms: number(spec.duration_ms, default.duration_ms),
    }
}

/// A drift; what is not given is the paper's default of §11.
fn drift(spec: &movement::Drift) -> Movement {
    Movement::Drift {
        speed_arcmin_per_s: number(spec.speed_arcmin_per_s, 6.0),
        direction_deg: number(spec.direction_deg, 30.0),
    }
}
