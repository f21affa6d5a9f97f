//! PNG decoding with limits: the header is read and checked before a pixel is decoded.

use std::io::Cursor;

use super::Picture;

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
        Self { side_px: 4096, bytes: 256 << 20 }
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
    decoder.read_info().map_err(|e| png_error(e.to_string()))
}

/// Width and height from the header alone.
///
/// # Errors
/// When the bytes are not a PNG file or it is larger than the limits.
pub fn png_size(bytes: &[u8], limits: Limits) -> Result<(u32, u32), DecodeError> {
    let reader = reader(bytes, limits)?;
    Ok((reader.info().width, reader.info().height))
}

/// Decodes an 8 or 16 bit grey, colour or palette PNG; transparency is laid over black.
///
/// # Errors
/// When the bytes are not a PNG file, are damaged, or exceed the limits.
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
    for pixel in values.chunks_exact(channels) {
        let (colour, alpha) = match channels {
            1 => ([pixel[0]; 3], 1.0),
            2 => ([pixel[0]; 3], pixel[1]),
            3 => ([pixel[0], pixel[1], pixel[2]], 1.0),
            _ => ([pixel[0], pixel[1], pixel[2]], pixel[3]),
        };
        rgb.extend(colour.map(|v| v * alpha));
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
