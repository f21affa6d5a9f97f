//! Y4M films: 4:2:0, 4:2:2, 4:4:4 and mono, 8 to 16 bit, progressive; luma and chroma to red, green and blue (ITU-R BT.601, 709, 2020).
//!
//! Chroma is interpolated linearly between its samples. Where they stand the film says: 420jpeg between
//! columns and rows (and so does a film that names no colour space), 420mpeg2 on every other column and
//! between rows, 420paldv on every other column and row. 420 and 420 of more bits do not say it and need to
//! be told; 422 stands on every other column.

use super::{ChromaSiting, DecodeError, Limits, Matrix, Picture, Range, Yuv};

/// Longest line of the stream or of a frame.
const MAX_LINE: usize = 1024;

fn wrong(why: impl Into<String>) -> DecodeError {
    DecodeError::Format("Y4M film", why.into())
}

/// Layout of the planes.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Luma columns and rows per chroma sample; `None`: no chroma.
    chroma: Option<[usize; 2]>,
    /// Where chroma samples stand; `None`: not said.
    siting: Option<ChromaSiting>,
    bits: u32,
}

impl Layout {
    fn new(name: &str) -> Result<Self, DecodeError> {
        let unknown = || {
            wrong(format!(
                "colour space `{name}`, read are 420, 420jpeg, 420mpeg2, 420paldv, 422, 444 and mono, with p10, p12, p14, p16 (mono10 to mono16) for more bits"
            ))
        };
        let (chroma, rest) = if let Some(rest) = name.strip_prefix("420") {
            (Some([2, 2]), rest)
        } else if let Some(rest) = name.strip_prefix("422") {
            (Some([2, 1]), rest)
        } else if let Some(rest) = name.strip_prefix("444") {
            (Some([1, 1]), rest)
        } else if let Some(rest) = name.strip_prefix("mono") {
            (None, rest)
        } else {
            return Err(unknown());
        };
        let bits = match (rest, chroma) {
            ("", _) | ("jpeg" | "mpeg2" | "paldv", Some([2, 2])) => 8,
            (_, None) => rest.parse().map_err(|_| unknown())?,
            _ => rest.strip_prefix('p').and_then(|bits| bits.parse().ok()).ok_or_else(unknown)?,
        };
        if !(8..=16).contains(&bits) {
            return Err(unknown());
        }
        let siting = match name {
            "420jpeg" => Some(ChromaSiting::Center),
            "420mpeg2" => Some(ChromaSiting::Left),
            "420paldv" => Some(ChromaSiting::TopLeft),
            _ if chroma == Some([2, 1]) => Some(ChromaSiting::Left),
            _ => None,
        };
        Ok(Self { chroma, siting, bits })
    }

    /// The layout with what the experiment says of the chroma.
    fn sited(mut self, name: &str, given: Option<ChromaSiting>) -> Result<Self, DecodeError> {
        let is_halved = self.chroma.is_some_and(|step| step != [1, 1]);
        let refused = |why: &str| Err(DecodeError::Unstated(format!("`yuv.chroma_siting` {why}")));
        match (self.siting, given) {
            (None, None) if is_halved => {
                return refused(&format!(
                    "is missing: the film's colour space `{name}` does not say where chroma samples stand; LEFT (MPEG-2, \
                     H.264), CENTER (JPEG, MPEG-1) or TOP_LEFT (BT.2020)"
                ));
            }
            (None, Some(_)) if !is_halved => {
                return refused(&format!("has no meaning for the colour space `{name}`"));
            }
            (Some(said), Some(given)) if said != given => {
                return refused(&format!("contradicts the film, whose colour space is `{name}`"));
            }
            (said, given) => self.siting = said.or(given),
        }
        Ok(self)
    }
}

/// A film whose frames have been found.
pub struct Y4m<'a> {
    pub width: u32,
    pub height: u32,
    /// The planes of each frame.
    pub frames: Vec<&'a [u8]>,
    /// Pictures a second, where the file says it.
    pub rate_hz: Option<f64>,
    layout: Layout,
    yuv: Yuv,
}

fn line<'a>(bytes: &'a [u8], what: &str) -> Result<&'a str, DecodeError> {
    let end = bytes.iter().take(MAX_LINE).position(|b| *b == b'\n');
    let end = end.ok_or_else(|| wrong(format!("{what} does not end")))?;
    std::str::from_utf8(&bytes[..end]).map_err(|_| wrong(format!("{what} is not text")))
}

/// A rate as two whole numbers, n:d a second; 0:0 is unknown.
pub fn rate_hz(text: &str) -> Option<f64> {
    let (n, d) = text.split_once(':')?;
    let hz = n.parse::<f64>().ok()? / d.parse::<f64>().ok()?;
    (hz.is_finite() && hz > 0.0).then_some(hz)
}

impl<'a> Y4m<'a> {
    /// Reads the header and finds the frames.
    pub fn read(bytes: &'a [u8], yuv: Option<Yuv>, limits: Limits) -> Result<Self, DecodeError> {
        let head = line(bytes, "its first line")?;
        let [mut width, mut height, mut layout, mut said] = [None, None, Some("420jpeg"), None];
        let mut rate = "";
        for word in head.split(' ').skip(1).filter(|w| !w.is_empty()) {
            let (key, value) = word.split_at_checked(1).unwrap_or((word, ""));
            match key {
                "W" => width = Some(value),
                "H" => height = Some(value),
                "C" => layout = Some(value),
                "I" if !matches!(value, "p" | "?") => {
                    return Err(wrong(format!("interlaced ({word}), only progressive films are read")));
                }
                "F" => rate = value,
                "X" => said = value.strip_prefix("COLORRANGE=").or(said),
                _ => {}
            }
        }
        let side = |what: &str, value: Option<&str>| {
            let value = value.and_then(|v| v.parse::<u32>().ok()).filter(|v| *v > 0);
            value.ok_or_else(|| wrong(format!("no {what} in its first line")))
        };
        let (width, height) = (side("width", width)?, side("height", height)?);
        if width > limits.side_px || height > limits.side_px {
            return Err(DecodeError::TooLarge(width, height, limits.side_px));
        }
        let name = layout.unwrap_or_default();
        let yuv = stated(yuv, said)?;
        let layout = Layout::new(name)?.sited(name, yuv.chroma_siting)?;
        let rate_hz = rate_hz(rate);
        let mut film = Self { width, height, frames: Vec::new(), rate_hz, layout, yuv };
        film.find_frames(bytes, head.len() + 1)?;
        Ok(film)
    }

    fn find_frames(&mut self, bytes: &'a [u8], mut at: usize) -> Result<(), DecodeError> {
        let size = self.planes().iter().map(|p| p[0] * p[1]).sum::<usize>() * self.wide();
        while at < bytes.len() {
            let frame = self.frames.len();
            let head = line(&bytes[at..], &format!("the line of frame {frame}"))?;
            if head != "FRAME" && !head.starts_with("FRAME ") {
                return Err(wrong(format!("`FRAME` is missing before frame {frame}")));
            }
            at += head.len() + 1;
            let there = bytes.len() - at;
            let planes = bytes.get(at..at + size);
            let short = || wrong(format!("frame {frame} is cut off: {there} bytes of {size}"));
            self.frames.push(planes.ok_or_else(short)?);
            at += size;
        }
        if self.frames.is_empty() { Err(wrong("no frame follows its first line")) } else { Ok(()) }
    }

    fn wide(&self) -> usize {
        if self.layout.bits > 8 { 2 } else { 1 }
    }

    /// Columns and rows of the planes.
    fn planes(&self) -> Vec<[usize; 2]> {
        let (width, height) = (self.width as usize, self.height as usize);
        let mut planes = vec![[width, height]];
        if let Some([x, y]) = self.layout.chroma {
            planes.extend([[width.div_ceil(x), height.div_ceil(y)]; 2]);
        }
        planes
    }

    /// One frame; the last one stays.
    pub fn picture(&self, frame: u32) -> Picture {
        let bytes = self.frames[(frame as usize).min(self.frames.len() - 1)];
        let wide = self.wide();
        let mut start = 0;
        let mut planes: Vec<(Vec<f32>, [usize; 2])> = Vec::new();
        for size in self.planes() {
            let end = start + size[0] * size[1] * wide;
            planes.push((self.numbers(&bytes[start..end], planes.is_empty()), size));
            start = end;
        }
        let (width, height) = (self.width as usize, self.height as usize);
        let [red, blue] = match self.yuv.matrix {
            Matrix::Bt601 => [0.299, 0.114],
            Matrix::Bt709 => [0.2126, 0.0722],
            Matrix::Bt2020 => [0.2627, 0.0593],
        };
        let green = 1.0 - red - blue;
        let mut rgb = Vec::with_capacity(3 * width * height);
        for row in 0..height {
            for column in 0..width {
                let y = planes[0].0[row * width + column];
                let [cb, cr] = if planes.len() == 3 {
                    [1, 2].map(|k| self.chroma(&planes[k].0, planes[k].1, [column, row]))
                } else {
                    [0.0; 2]
                };
                let r = y + 2.0 * (1.0 - red) * cr;
                let b = y + 2.0 * (1.0 - blue) * cb;
                let g = (y - red * r - blue * b) / green;
                rgb.extend([r, g, b].map(|v| v.clamp(0.0, 1.0)));
            }
        }
        Picture { width: self.width, height: self.height, rgb }
    }

    /// A plane as numbers: luma 0 to 1, chroma -0.5 to 0.5.
    fn numbers(&self, bytes: &[u8], luma: bool) -> Vec<f32> {
        let unit = f64::from(1_u32 << (self.layout.bits - 8));
        let (zero, full) = match (self.yuv.range, luma) {
            (Range::Limited, true) => (16.0 * unit, 219.0 * unit),
            (Range::Limited, false) => (128.0 * unit, 224.0 * unit),
            (Range::Full, true) => (0.0, 256.0 * unit - 1.0),
            (Range::Full, false) => (128.0 * unit, 256.0 * unit - 1.0),
        };
        let scaled = |v: f64| ((v - zero) / full) as f32;
        if self.layout.bits > 8 {
            bytes.chunks_exact(2).map(|b| scaled(f64::from(u16::from_le_bytes([b[0], b[1]])))).collect()
        } else {
            bytes.iter().map(|b| scaled(f64::from(*b))).collect()
        }
    }

    /// Chroma at a luma sample.
    fn chroma(&self, plane: &[f32], [columns, rows]: [usize; 2], at: [usize; 2]) -> f32 {
        let [step_x, step_y] = self.layout.chroma.unwrap_or([1, 1]);
        let siting = self.layout.siting.unwrap_or(ChromaSiting::Left);
        let axis = |at: usize, step: usize, between: bool, count: usize| {
            let place = match (step, between) {
                (1, _) => at as f32,
                (_, true) => (at as f32 - 0.5) / 2.0,
                (_, false) => at as f32 / 2.0,
            };
            let place = place.clamp(0.0, (count - 1) as f32);
            let low = place as usize;
            (low, (low + 1).min(count - 1), place - low as f32)
        };
        let (x0, x1, u) = axis(at[0], step_x, siting == ChromaSiting::Center, columns);
        let (y0, y1, v) = axis(at[1], step_y, siting != ChromaSiting::TopLeft, rows);
        let row = |y: usize| plane[y * columns + x0] * (1.0 - u) + plane[y * columns + x1] * u;
        row(y0) * (1.0 - v) + row(y1) * v
    }
}

/// What was said about the numbers, against what the film says.
fn stated(yuv: Option<Yuv>, said: Option<&str>) -> Result<Yuv, DecodeError> {
    let Some(yuv) = yuv else {
        return Err(DecodeError::Unstated(
            "a Y4M film needs `yuv`: its matrix (BT601, BT709 or BT2020) and range (LIMITED or FULL); they are not guessed".into(),
        ));
    };
    let contradicts = match said {
        Some("FULL") => yuv.range == Range::Limited,
        Some("LIMITED") => yuv.range == Range::Full,
        _ => false,
    };
    if contradicts {
        let said = said.unwrap_or_default();
        return Err(DecodeError::Unstated(format!(
            "the film says that its range is {said}, `yuv.range` does not"
        )));
    }
    Ok(yuv)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITED: Yuv = Yuv { matrix: Matrix::Bt709, range: Range::Limited, chroma_siting: None };

    fn film(head: &str, planes: &[u8]) -> Vec<u8> {
        [format!("YUV4MPEG2 {head}\nFRAME\n").as_bytes(), planes].concat()
    }

    fn read(bytes: &[u8], yuv: Yuv) -> Picture {
        Y4m::read(bytes, Some(yuv), Limits::default()).unwrap().picture(0)
    }

    /// Colour bars in every layout come back as the colours they were made from.
    #[test]
    fn flat_colours_come_back() {
        for (matrix, kr, kb) in
            [(Matrix::Bt601, 0.299, 0.114), (Matrix::Bt709, 0.2126, 0.0722), (Matrix::Bt2020, 0.2627, 0.0593)]
        {
            for range in [Range::Limited, Range::Full] {
                for (name, samples, bits) in [
                    ("420jpeg", [4 * 2, 2, 2], 8),
                    ("420mpeg2", [8, 2, 2], 8),
                    ("422", [8, 4, 4], 8),
                    ("444", [8, 8, 8], 8),
                    ("420p10", [8, 2, 2], 10),
                    ("444p12", [8, 8, 8], 12),
                ] {
                    // Make the planes of one colour.
                    let rgb = [0.9, 0.2, 0.6];
                    let y = kr * rgb[0] + (1.0 - kr - kb) * rgb[1] + kb * rgb[2];
                    let ycc: [f64; 3] = [y, 0.5 * (rgb[2] - y) / (1.0 - kb), 0.5 * (rgb[0] - y) / (1.0 - kr)];
                    let unit = f64::from(1_u32 << (bits - 8));
                    let code = |k: usize| match (range, k) {
                        (Range::Limited, 0) => unit * (16.0 + 219.0 * ycc[0]),
                        (Range::Limited, k) => unit * (128.0 + 224.0 * ycc[k]),
                        (Range::Full, 0) => (256.0 * unit - 1.0) * ycc[0],
                        (Range::Full, k) => 128.0 * unit + (256.0 * unit - 1.0) * ycc[k],
                    };
                    let mut planes = Vec::new();
                    for (k, n) in samples.into_iter().enumerate() {
                        for _ in 0..n {
                            let value = code(k).round() as u16;
                            if bits > 8 {
                                planes.extend(value.to_le_bytes());
                            } else {
                                planes.push(value as u8);
                            }
                        }
                    }
                    // Read them back.
                    let chroma_siting = name.starts_with("420p1").then_some(ChromaSiting::Left);
                    let film = film(&format!("W4 H2 F60:1 Ip A1:1 C{name}"), &planes);
                    let picture = read(&film, Yuv { matrix, range, chroma_siting });
                    assert_eq!((picture.width, picture.height), (4, 2));
                    for pixel in picture.rgb.chunks_exact(3) {
                        for (value, expected) in pixel.iter().zip(rgb) {
                            assert!((f64::from(*value) - expected).abs() < 2.5 / 219.0, "{name} {pixel:?}");
                        }
                    }
                }
            }
        }
    }

    /// 4:2:0 of odd size, and where its chroma stands: a step in chroma between columns 1 and 2 of 4.
    #[test]
    fn chroma_stands_where_the_layout_says() {
        let planes = [[128; 8].as_slice(), &[128, 228], &[128, 128]].concat();
        let yuv = Yuv { matrix: Matrix::Bt709, range: Range::Full, chroma_siting: None };
        let blue = |name: &str| -> Vec<f32> {
            let picture = read(&film(&format!("W4 H2 C{name}"), &planes), yuv);
            picture
                .rgb
                .chunks_exact(3)
                .take(4)
                .map(|p| (p[2] - 128.0 / 255.0) / (1.8556 * 100.0 / 255.0))
                .collect()
        };
        for (name, expected) in [("420jpeg", [0.0, 0.25, 0.75, 1.0]), ("420mpeg2", [0.0, 0.5, 1.0, 1.0])] {
            // The brightest blues are cut off at 1, which is 0.684 of the step.
            for (value, expected) in blue(name).into_iter().zip(expected) {
                assert!(
                    (f64::from(value) - f64::min(expected, 0.684)).abs() < 2e-3,
                    "{name} {value} {expected}"
                );
            }
        }
        let odd = film("W3 H3 C420jpeg", &[100; 9 + 4 + 4]);
        assert_eq!(Y4m::read(&odd, Some(LIMITED), Limits::default()).unwrap().frames.len(), 1);
    }

    #[test]
    fn frames_are_counted_and_the_last_one_stays() {
        let mut bytes = film("W2 H1 Cmono", &[16, 235]);
        bytes.extend(b"FRAME Ip\n\xEB\x10");
        let film = Y4m::read(&bytes, Some(LIMITED), Limits::default()).unwrap();
        assert_eq!(film.frames.len(), 2);
        assert!(film.picture(0).rgb == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        assert!(film.picture(1).rgb == film.picture(7).rgb && film.picture(1).rgb[0] > 0.99);
    }

    #[test]
    fn bad_films_are_refused_by_what_is_wrong() {
        let good = film("W2 H2 C444", &[0; 12]);
        for (bytes, yuv, why) in [
            (good.clone(), None, "needs `yuv`"),
            (good[..good.len() - 1].to_vec(), Some(LIMITED), "frame 0 is cut off: 11 bytes of 12"),
            ([&good[..], b"FRAM"].concat(), Some(LIMITED), "the line of frame 1 does not end"),
            ([&good[..], b"junk\n"].concat(), Some(LIMITED), "`FRAME` is missing before frame 1"),
            (film("W2 H2 It C444", &[0; 12]), Some(LIMITED), "interlaced"),
            (film("W2 H2 C444alpha", &[0; 16]), Some(LIMITED), "`444alpha`"),
            (film("W2 H2 C420p99", &[0; 16]), Some(LIMITED), "`420p99`"),
            (film("W2 C444", &[0; 12]), Some(LIMITED), "no height"),
            (film("W2 H9999 C444", &[0; 12]), Some(LIMITED), "allowed are 8192x8192"),
            (film("W2 H2 C444 XCOLORRANGE=FULL", &[0; 12]), Some(LIMITED), "says that its range is FULL"),
            (b"YUV4MPEG2 W2 H2 C444\n".to_vec(), Some(LIMITED), "no frame"),
            (b"YUV4MPEG2 W2".to_vec(), Some(LIMITED), "first line does not end"),
        ] {
            let error = Y4m::read(&bytes, yuv, Limits::default()).err().unwrap().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}
