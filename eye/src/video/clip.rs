//! Files of a clip: which kind they are, how many frames they hold, and one frame of them.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::decode::png_stated;
use super::y4m::Y4m;
use super::{DecodeError, Limits, Picture, StatedTransfer, decode_png, netpbm, png_size};
use crate::display::Curve;

/// What files mean where they do not say so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClipFormat {
    /// How luma and chroma become red, green and blue; Y4M files need it.
    pub yuv: Option<Yuv>,
    /// The files are raw RGB.
    pub raw: Option<Raw>,
}

/// Luma and chroma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Yuv {
    /// Weights of the colours in luma.
    pub matrix: Matrix,
    /// Range of the numbers.
    pub range: Range,
    /// Where chroma samples of 4:2:0 and 4:2:2 stand; `None`: as the film says.
    #[serde(default)]
    pub chroma_siting: Option<ChromaSiting>,
}

/// Where a chroma sample stands among the luma samples that it belongs to (ITU-T H.273, chroma sample
/// location types 0 to 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ChromaSiting {
    /// On the left column, between rows: MPEG-2, H.264 and most video.
    Left,
    /// Between columns and rows: JPEG, MPEG-1.
    Center,
    /// On the left column and the upper row: BT.2020 and BT.2100, DV of PAL.
    TopLeft,
}

/// Weights of the colours in luma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Matrix {
    /// ITU-R BT.601.
    Bt601,
    /// ITU-R BT.709.
    Bt709,
    /// ITU-R BT.2020, not constant luminance.
    Bt2020,
}

/// Range of the numbers in a luma and chroma picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Range {
    /// 8 bit: luma 16 to 235, chroma 16 to 240.
    Limited,
    /// All numbers.
    Full,
}

/// Raw RGB of the display's size: `[frame][row][column][channel]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Raw {
    /// 8, or 16 little-endian.
    pub bits: u32,
}

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipInfo {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames.
    pub frames: u32,
    /// Pictures a second of a film that says it.
    pub rate_hz: Option<f64>,
    /// What a picture says of its pixel values.
    pub stated: Option<StatedTransfer>,
}

/// What pictures of a film the frames of a display show whose rate is another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FromFilm {
    /// One picture a frame, whatever the film's rate.
    OneEach,
    /// Each frame the picture whose time it is, so that pictures are repeated or left out.
    Repeat,
    /// Each frame the mean light of the film over the frame's time.
    Resample,
}

impl FromFilm {
    /// The pictures of a frame, each with its part of the frame's time.
    pub fn pictures(self, frame: u32, film_hz: f64, display_hz: f64) -> Vec<(u32, f64)> {
        // Times in pictures; a millionth of one is rounding.
        let per_frame = film_hz / display_hz;
        let begin = f64::from(frame) * per_frame + 1e-6;
        match self {
            Self::OneEach => vec![(frame, 1.0)],
            Self::Repeat => vec![(begin as u32, 1.0)],
            Self::Resample => {
                let end = f64::from(frame + 1) * per_frame - 1e-6;
                let (first, last) = (begin as u32, end.max(begin) as u32);
                let part = |picture: u32| {
                    let [from, to] = [f64::from(picture), f64::from(picture) + 1.0];
                    (picture, (to.min(end) - from.max(begin)).max(0.0))
                };
                let parts: Vec<(u32, f64)> = (first..=last).map(part).collect();
                let all: f64 = parts.iter().map(|(_, part)| part).sum();
                if all > 0.0 {
                    parts.into_iter().map(|(picture, part)| (picture, part / all)).collect()
                } else {
                    vec![(first, 1.0)]
                }
            }
        }
    }

    /// Frames that show a film of so many pictures.
    pub fn frames(self, pictures: u32, film_hz: f64, display_hz: f64) -> u32 {
        match self {
            Self::OneEach => pictures,
            Self::Repeat | Self::Resample => {
                (f64::from(pictures) * display_hz / film_hz).round().max(1.0) as u32
            }
        }
    }
}

/// The picture whose light is the mean of others, each with its weight; all have one size, weights sum to 1.
pub fn mean_light(curve: Curve, parts: &[(&Picture, f64)]) -> Option<Picture> {
    let (first, _) = parts.first()?;
    let mut rgb = vec![0.0_f32; first.rgb.len()];
    rgb.par_chunks_exact_mut(3).enumerate().for_each(|(pixel, rgb)| {
        let mut sum = [0.0; 3];
        for (picture, weight) in parts {
            let values = std::array::from_fn(|i| f64::from(picture.rgb[3 * pixel + i]).clamp(0.0, 1.0));
            for (sum, light) in sum.iter_mut().zip(curve.lights(values)) {
                *sum += weight * light;
            }
        }
        rgb.copy_from_slice(&curve.values(sum).map(|value| value as f32));
    });
    Some(Picture { width: first.width, height: first.height, rgb })
}

/// Size and number of frames of a file, without decoding pixels. `display` is the size (columns, rows) of raw frames.
///
/// # Errors
/// When the file's kind is not known, it is damaged, or it exceeds the limits.
pub fn clip_info(
    bytes: &[u8],
    format: &ClipFormat,
    display: [u32; 2],
    limits: Limits,
) -> Result<ClipInfo, DecodeError> {
    if let Some(raw) = format.raw {
        let [width, height] = display;
        return Ok(ClipInfo {
            width,
            height,
            frames: raw_frames(bytes, raw, display)?,
            rate_hz: None,
            stated: None,
        });
    }
    let mut stated = None;
    let (width, height, frames, rate_hz) = match bytes {
        [b'P', b'2' | b'3' | b'5' | b'6', ..] => {
            let size = netpbm::size(bytes, limits)?;
            (size.0, size.1, 1, None)
        }
        _ if bytes.starts_with(b"YUV4MPEG2") => {
            let film = Y4m::read(bytes, format.yuv, limits)?;
            (film.width, film.height, film.frames.len() as u32, film.rate_hz)
        }
        _ => {
            let size = png_size(bytes, limits)?;
            stated = png_stated(bytes, limits)?;
            (size.0, size.1, 1, None)
        }
    };
    Ok(ClipInfo { width, height, frames, rate_hz, stated })
}

/// Pictures a second of a Y4M film that says it, from its first line.
pub fn film_rate_hz(bytes: &[u8]) -> Option<f64> {
    let head = bytes.strip_prefix(b"YUV4MPEG2")?;
    let end = head.iter().take(1024).position(|byte| *byte == b'\n')?;
    let words = std::str::from_utf8(&head[..end]).ok()?;
    super::y4m::rate_hz(words.split(' ').find_map(|word| word.strip_prefix('F'))?)
}

/// Decodes frame `frame` of a file; the last one stays.
///
/// # Errors
/// As [`clip_info`], and when pixels are damaged or missing.
pub fn decode_frame(
    bytes: &[u8],
    format: &ClipFormat,
    display: [u32; 2],
    frame: u32,
    limits: Limits,
) -> Result<Picture, DecodeError> {
    if let Some(raw) = format.raw {
        let last = raw_frames(bytes, raw, display)? - 1;
        return Ok(raw_picture(bytes, raw, display, frame.min(last)));
    }
    match bytes {
        [b'P', b'2' | b'3' | b'5' | b'6', ..] => netpbm::decode(bytes, limits),
        _ if bytes.starts_with(b"YUV4MPEG2") => Ok(Y4m::read(bytes, format.yuv, limits)?.picture(frame)),
        _ => decode_png(bytes, limits),
    }
}

fn raw_frame_bytes(raw: Raw, [width, height]: [u32; 2]) -> usize {
    3 * width as usize * height as usize * (raw.bits as usize / 8)
}

fn raw_frames(bytes: &[u8], raw: Raw, display: [u32; 2]) -> Result<u32, DecodeError> {
    let one = raw_frame_bytes(raw, display);
    let (whole, rest) = (bytes.len() / one, bytes.len() % one);
    if whole == 0 || rest != 0 {
        let why = format!(
            "{} bytes are no whole number of frames of {one} bytes ({} x {} pixels, 3 x {} bit)",
            bytes.len(),
            display[0],
            display[1],
            raw.bits
        );
        return Err(DecodeError::Format("raw RGB file", why));
    }
    u32::try_from(whole).map_err(|_| DecodeError::Format("raw RGB file", format!("{whole} frames")))
}

fn raw_picture(bytes: &[u8], raw: Raw, display: [u32; 2], frame: u32) -> Picture {
    let one = raw_frame_bytes(raw, display);
    let bytes = &bytes[frame as usize * one..][..one];
    let rgb = if raw.bits == 16 {
        bytes.chunks_exact(2).map(|b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0).collect()
    } else {
        bytes.iter().map(|b| f32::from(*b) / 255.0).collect()
    };
    Picture { width: display[0], height: display[1], rgb }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_frames_are_read_and_counted() {
        let bytes: Vec<u8> = (0..2 * 3 * 4).collect();
        let format = ClipFormat { raw: Some(Raw { bits: 8 }), yuv: None };
        let info = clip_info(&bytes, &format, [2, 2], Limits::default()).unwrap();
        assert_eq!(info, ClipInfo { width: 2, height: 2, frames: 2, rate_hz: None, stated: None });
        let second = decode_frame(&bytes, &format, [2, 2], 1, Limits::default()).unwrap();
        assert!((second.rgb[0] - 12.0 / 255.0).abs() < 1e-7);
        let wide = ClipFormat { raw: Some(Raw { bits: 16 }), yuv: None };
        let one = decode_frame(&bytes, &wide, [2, 2], 9, Limits::default()).unwrap();
        assert!((one.rgb[1] - f32::from(u16::from_le_bytes([2, 3])) / 65535.0).abs() < 1e-7);
        for cut in [0, 1, 23] {
            let error = clip_info(&bytes[..cut], &format, [2, 2], Limits::default()).unwrap_err();
            assert!(error.to_string().contains("whole number of frames of 12 bytes"), "{error}");
        }
    }

    /// 24 pictures a second on 60 Hz: frame 2 is half of picture 0 and half of 1; at 120 each frame is two
    /// pictures. No part of a film is lost.
    #[test]
    fn frames_hold_the_light_of_their_time() {
        let parts = |frame: u32, film_hz: f64| FromFilm::Resample.pictures(frame, film_hz, 60.0);
        let near = |found: &[(u32, f64)], right: &[(u32, f64)]| {
            found.len() == right.len()
                && found.iter().zip(right).all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-5)
        };
        assert!(near(&parts(1, 24.0), &[(0, 1.0)]));
        assert!(near(&parts(2, 24.0), &[(0, 0.5), (1, 0.5)]), "{:?}", parts(2, 24.0));
        assert!(near(&parts(3, 120.0), &[(6, 0.5), (7, 0.5)]), "{:?}", parts(3, 120.0));
        let mut shown = [0.0; 24];
        for (picture, part) in (0..60).flat_map(|frame| parts(frame, 24.0)) {
            shown[picture as usize] += part / 60.0;
        }
        assert!(shown.iter().all(|time| (time * 24.0 - 1.0).abs() < 1e-5), "{shown:?}");
    }

    #[test]
    fn an_unknown_file_is_refused() {
        for bytes in [&b""[..], b"GIF89a", b"P4 1 1 "] {
            assert!(clip_info(bytes, &ClipFormat::default(), [1, 1], Limits::default()).is_err());
        }
    }
}
