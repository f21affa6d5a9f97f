//! PGM and PPM pictures (P2, P3 as text, P5, P6 as bytes; 8 or 16 bit, big-endian), read within limits. One picture a file.

use super::{DecodeError, Limits, Picture};

fn wrong(why: impl Into<String>) -> DecodeError {
    DecodeError::Format("PGM or PPM", why.into())
}

struct Header {
    text: bool,
    channels: usize,
    width: u32,
    height: u32,
    most: u32,
}

/// Numbers between white space and comments.
struct Words<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Words<'_> {
    fn skip(&mut self) {
        while let Some(byte) = self.bytes.get(self.at) {
            match byte {
                b'#' => {
                    let rest = &self.bytes[self.at..];
                    self.at += rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
                }
                b if b.is_ascii_whitespace() => self.at += 1,
                _ => return,
            }
        }
    }

    fn number(&mut self, what: &str) -> Result<u32, DecodeError> {
        self.skip();
        let digits = self.bytes[self.at..].iter().take_while(|b| b.is_ascii_digit()).count();
        if digits == 0 || digits > 9 {
            let end = if self.at >= self.bytes.len() { "the file ends" } else { "no number stands" };
            return Err(wrong(format!("{end} where {what} should be")));
        }
        let mut value = 0;
        for digit in &self.bytes[self.at..self.at + digits] {
            value = 10 * value + u32::from(digit - b'0');
        }
        self.at += digits;
        Ok(value)
    }
}

fn header(bytes: &[u8], limits: Limits) -> Result<(Header, Words<'_>), DecodeError> {
    let mut words = Words { bytes, at: 2 };
    let kind = bytes.get(1).copied().unwrap_or_default();
    let (text, channels) = (matches!(kind, b'2' | b'3'), if matches!(kind, b'3' | b'6') { 3 } else { 1 });
    let (width, height) = (words.number("the width")?, words.number("the height")?);
    let most = words.number("the largest value")?;
    if width > limits.side_px || height > limits.side_px {
        return Err(DecodeError::TooLarge(width, height, limits.side_px));
    }
    if width == 0 || height == 0 || !(1..=65535).contains(&most) {
        return Err(wrong(format!("{width} x {height} pixels with values to {most}")));
    }
    Ok((Header { text, channels, width, height, most }, words))
}

/// Width and height from the header; of a binary file also whether its pixels are all there.
pub fn size(bytes: &[u8], limits: Limits) -> Result<(u32, u32), DecodeError> {
    let (header, words) = header(bytes, limits)?;
    if !header.text {
        body(&header, &words)?;
    }
    Ok((header.width, header.height))
}

/// The bytes of the pixels.
fn body<'a>(header: &Header, words: &Words<'a>) -> Result<&'a [u8], DecodeError> {
    let wide = if header.most > 255 { 2 } else { 1 };
    let needed = header.width as usize * header.height as usize * header.channels * wide;
    // One white space stands between header and pixels.
    let rest = words.bytes.get(words.at + 1..).unwrap_or_default();
    if rest.len() < needed {
        return Err(wrong(format!("{} bytes of pixels, {needed} are needed", rest.len())));
    }
    if rest.len() > needed && !rest[needed..].iter().all(u8::is_ascii_whitespace) {
        return Err(wrong("more follows after the picture"));
    }
    Ok(&rest[..needed])
}

/// Decodes a picture.
pub fn decode(bytes: &[u8], limits: Limits) -> Result<Picture, DecodeError> {
    let (header, mut words) = header(bytes, limits)?;
    let count = header.width as usize * header.height as usize * header.channels;
    let values: Vec<u32> = if header.text {
        let mut values = Vec::with_capacity(count.min(bytes.len()));
        for i in 0..count {
            values.push(words.number(&format!("value {i} of {count}"))?);
        }
        values
    } else if header.most > 255 {
        body(&header, &words)?.chunks_exact(2).map(|b| u32::from(u16::from_be_bytes([b[0], b[1]]))).collect()
    } else {
        body(&header, &words)?.iter().map(|b| u32::from(*b)).collect()
    };
    if let Some(value) = values.iter().find(|v| **v > header.most) {
        return Err(wrong(format!("a value of {value} is above the largest, {}", header.most)));
    }
    let scaled = |v: &u32| (f64::from(*v) / f64::from(header.most)) as f32;
    let rgb = if header.channels == 1 {
        values.iter().flat_map(|v| [scaled(v); 3]).collect()
    } else {
        values.iter().map(scaled).collect()
    };
    Ok(Picture { width: header.width, height: header.height, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Picture, DecodeError> {
        let whole = size(bytes, Limits::default()).and_then(|_| decode(bytes, Limits::default()));
        if let Ok(picture) = &whole {
            assert_eq!(size(bytes, Limits::default()).unwrap(), (picture.width, picture.height));
        }
        whole
    }

    #[test]
    fn all_kinds_read_the_same_picture() {
        let grey = [0, 51, 255, 102, 153, 204];
        let wide: Vec<u8> = grey.iter().flat_map(|v: &u8| [*v, *v]).collect();
        let binary = |head: &str, body: &[u8]| [head.as_bytes(), body].concat();
        let pictures = [
            binary("P5\n# a comment\n3 2\n255\n", &grey),
            binary("P5 3 2 65535\n", &wide),
            b"P2 3 2 255 0 51 255\n102 153 # end of row\n204\n".to_vec(),
            b"P2 3 2 5 0 1 5 2 3 4".to_vec(),
            binary("P6 3 2 255\n", &grey.iter().flat_map(|v| [*v; 3]).collect::<Vec<u8>>()),
            b"P3 3 2 5 0 0 0 1 1 1 5 5 5 2 2 2 3 3 3 4 4 4".to_vec(),
        ];
        for bytes in pictures {
            let picture = read(&bytes).unwrap();
            assert_eq!((picture.width, picture.height), (3, 2));
            for (value, expected) in picture.rgb.chunks_exact(3).zip([0.0, 0.2, 1.0, 0.4, 0.6, 0.8]) {
                assert!(value.iter().all(|v| (v - expected).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn bad_files_are_refused() {
        for (bytes, why) in [
            (&b"P5 3 2 255\n12345"[..], "5 bytes of pixels, 6 are needed"),
            (b"P5 3 2 255\n123456P5", "more follows"),
            (b"P2 3 2 255 1 2 3", "value 3 of 6"),
            (b"P2 1 1 255 256", "256 is above the largest"),
            (b"P6 0 2 255\n", "0 x 2 pixels"),
            (b"P6 1 1 70000\n", "values to 70000"),
            (b"P6 9000 1 255\n", "allowed are 8192x8192"),
            (b"P6 x", "the width"),
            (b"P6 99999999999 1 255\n", "the width"),
            (b"P5", "the file ends"),
        ] {
            let error = read(bytes).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}
