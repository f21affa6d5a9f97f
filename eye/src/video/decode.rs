//! PNG decoding with limits: the header is read and checked before a pixel is decoded.

use std::io::Cursor;

use super::{Picture, StatedTransfer};
use crate::display::MOST_SIDE_PX;

/// Bounds on a picture.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Most columns and most rows.
    pub side_px: u32,
    /// Most bytes of decoded picture.
    pub bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { side_px: MOST_SIDE_PX, bytes: 256 << 20 }
    }
}

/// Why a picture is refused.
#[derive(Clone, Debug, thiserror::Error)]
pub enum DecodeError {
    /// Not a file of this kind, or damaged.
    #[error("not a readable {0}: {1}")]
    Format(&'static str, String),
    /// The file's kind needs to be told something that it does not say itself, or contradicts what was said.
    #[error("{0}")]
    Unstated(String),
    /// Too large.
    #[error("the picture is {0}x{1} pixels, allowed are {2}x{2}")]
    TooLarge(u32, u32, u32),
}

fn png_error(why: String) -> DecodeError {
    DecodeError::Format("PNG", why)
}

fn reader(bytes: &[u8], limits: Limits) -> Result<png::Reader<Cursor<&[u8]>>, DecodeError> {
    if bytes.is_empty() {
        return Err(png_error("the file is empty".into()));
    }
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: limits.bytes });
    decoder.set_transformations(png::Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(|e| png_error(e.to_string()))?;
    if header.width > limits.side_px || header.height > limits.side_px {
        return Err(DecodeError::TooLarge(header.width, header.height, limits.side_px));
    }
    let reader = decoder.read_info().map_err(|e| png_error(e.to_string()))?;
    if let Some(animation) = reader.info().animation_control {
        let why =
            format!("it holds an animation of {} pictures; give each frame a file", animation.num_frames);
        return Err(DecodeError::Unstated(why));
    }
    if let Some(turned) =
        reader.info().exif_metadata.as_deref().and_then(orientation).filter(|turned| *turned != 1)
    {
        let why = format!("its EXIF orientation is {turned}, allowed is 1; turn the picture itself");
        return Err(DecodeError::Unstated(why));
    }
    Ok(reader)
}

/// The orientation tag (0x0112) of EXIF data, a TIFF structure.
fn orientation(exif: &[u8]) -> Option<u16> {
    let little = exif.starts_with(b"II");
    let number = |at: usize, bytes: usize| -> Option<usize> {
        let digits = exif.get(at..at + bytes)?;
        let value = |sum: usize, byte: &u8| sum << 8 | usize::from(*byte);
        Some(if little { digits.iter().rev().fold(0, value) } else { digits.iter().fold(0, value) })
    };
    let first = number(4, 4)?;
    let entries = number(first, 2)?;
    let mut tags = (0..entries.min(512)).map(|i| first + 2 + 12 * i);
    let tag = tags.find(|at| number(*at, 2) == Some(0x0112))?;
    number(tag + 8, 2).and_then(|value| u16::try_from(value).ok())
}

/// Width and height; of a file that may hold transparent pixels all of them are looked at, else the header alone.
///
/// # Errors
/// When the bytes are not a PNG file, it is larger than the limits, or as [`decode_png`].
pub fn png_size(bytes: &[u8], limits: Limits) -> Result<(u32, u32), DecodeError> {
    let reader = reader(bytes, limits)?;
    let size = (reader.info().width, reader.info().height);
    if matches!(reader.output_color_type().0, png::ColorType::GrayscaleAlpha | png::ColorType::Rgba) {
        decode_png(bytes, limits)?;
    }
    Ok(size)
}

/// What a PNG file says of its pixel values; of two chunks cICP counts.
pub(super) fn png_stated(bytes: &[u8], limits: Limits) -> Result<Option<StatedTransfer>, DecodeError> {
    let reader = reader(bytes, limits)?;
    let info = reader.info();
    if let Some(points) = info.coding_independent_code_points {
        return Ok(Some(StatedTransfer::CodePoint(points.transfer_function)));
    }
    // Descriptions are ASCII, or UTF-16 with a byte of 0 before each letter.
    let says_srgb = |profile: &[u8]| {
        profile.windows(4).any(|text| text == b"sRGB")
            || profile.windows(8).any(|text| text == b"\0s\0R\0G\0B")
    };
    Ok(info.icc_profile.as_deref().map(|profile| StatedTransfer::Profile { is_srgb: says_srgb(profile) }))
}

/// Decodes an 8 or 16 bit grey, colour or palette PNG. Nothing is guessed: one picture, upright and opaque.
///
/// # Errors
/// When the bytes are not a PNG file, are damaged, exceed the limits, or hold an animation, an EXIF orientation or
/// a pixel that is not opaque.
pub fn decode_png(bytes: &[u8], limits: Limits) -> Result<Picture, DecodeError> {
    let mut reader = reader(bytes, limits)?;
    let size = reader.output_buffer_size().ok_or_else(|| png_error("the size overflows".into()))?;
    if size > limits.bytes {
        return Err(png_error(format!("{size} bytes decoded, allowed are {}", limits.bytes)));
    }
    let mut buffer = vec![0; size];
    let info = reader.next_frame(&mut buffer).map_err(|e| png_error(e.to_string()))?;
    let channels = info.color_type.samples();
    let values: Vec<f32> = match info.bit_depth {
        png::BitDepth::Sixteen => {
            buffer.chunks_exact(2).map(|b| f32::from(u16::from_be_bytes([b[0], b[1]])) / 65535.0).collect()
        }
        png::BitDepth::Eight => buffer.iter().map(|b| f32::from(*b) / 255.0).collect(),
        depth => return Err(png_error(format!("unexpected depth {depth:?}"))),
    };
    let mut rgb = Vec::with_capacity(3 * info.width as usize * info.height as usize);
    for (number, pixel) in values.chunks_exact(channels).enumerate() {
        let (colour, alpha) = match channels {
            1 => ([pixel[0]; 3], 1.0),
            2 => ([pixel[0]; 3], pixel[1]),
            3 => ([pixel[0], pixel[1], pixel[2]], 1.0),
            _ => ([pixel[0], pixel[1], pixel[2]], pixel[3]),
        };
        if alpha < 1.0 {
            let [column, row] = [number as u32 % info.width, number as u32 / info.width];
            let why = format!(
                "pixel [{column}, {row}] is transparent (alpha {alpha:.3}), allowed are opaque pictures; flatten \
                 it over what is to be seen behind"
            );
            return Err(DecodeError::Unstated(why));
        }
        rgb.extend(colour);
    }
    Ok(Picture { width: info.width, height: info.height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey_png(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&vec![51; (width * height) as usize]).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn grey_becomes_equal_channels() {
        let picture = decode_png(&grey_png(3, 2), Limits::default()).unwrap();
        assert_eq!((picture.width, picture.height), (3, 2));
        assert!(picture.rgb.iter().all(|v| (v - 0.2).abs() < 1e-6));
    }

    #[test]
    fn bad_files_are_refused_by_what_is_wrong() {
        assert!(decode_png(&[], Limits::default()).is_err_and(|e| e.to_string().contains("empty")));
        assert!(decode_png(b"hello", Limits::default()).is_err());
        let whole = grey_png(40, 40);
        for end in 0..whole.len() - 12 {
            assert!(decode_png(&whole[..end], Limits::default()).is_err(), "cut at {end}");
        }
        let small = Limits { side_px: 8, ..Limits::default() };
        assert!(matches!(png_size(&whole, small), Err(DecodeError::TooLarge(40, 40, 8))));
    }
}
