//! A page to draw on: shapes at twice the final size, averaged at the end, letters and pictures at the final size.
//!
//! All places are pixels of the final picture, x to the right, y down; what lies outside is not drawn.

use photoneye_eye::picture::RgbImage;

use super::text::{self, Font};

/// Red, green, blue, sRGB.
pub type Colour = [u8; 3];

/// Samples along the side of a pixel.
const FINE: i32 = 2;
/// Largest side of a page, pixels.
const MAX_SIDE: i32 = 12_000;
const WHITE: Colour = [255; 3];

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rect {
    /// Left edge.
    pub x: i32,
    /// Upper edge.
    pub y: i32,
    /// Columns.
    pub width: i32,
    /// Rows.
    pub height: i32,
}

impl Rect {
    /// The edge after the last column.
    pub fn right(self) -> i32 {
        self.x + self.width
    }

    /// The edge after the last row.
    pub fn bottom(self) -> i32 {
        self.y + self.height
    }
}

/// A white page.
pub struct Canvas {
    width: i32,
    height: i32,
    /// `[FINE·height][FINE·width]`.
    fine: Vec<Colour>,
    letters: Vec<Letters>,
}

struct Letters {
    font: Font,
    text: String,
    x: i32,
    y: i32,
    upwards: bool,
    colour: Colour,
}

impl Canvas {
    /// Sides are cut to 1 to 12,000 pixels.
    pub fn new(width: i32, height: i32) -> Self {
        let [width, height] = [width, height].map(|side| side.clamp(1, MAX_SIDE));
        let fine = vec![WHITE; (FINE * width) as usize * (FINE * height) as usize];
        Self { width, height, fine, letters: Vec::new() }
    }

    /// The whole page.
    pub fn area(&self) -> Rect {
        Rect { x: 0, y: 0, width: self.width, height: self.height }
    }

    /// Mixes a colour into one fine sample.
    fn blend(&mut self, column: i32, row: i32, colour: Colour, share: f64) {
        let at = row as usize * (FINE * self.width) as usize + column as usize;
        if let Some(pixel) = self.fine.get_mut(at) {
            *pixel = mixed(*pixel, colour, share);
        }
    }

    /// The fine columns and rows between two points that lie in a rectangle and on the page.
    fn samples(&self, clip: Rect, low: [f64; 2], high: [f64; 2]) -> [std::ops::Range<i32>; 2] {
        let from = [clip.x, clip.y];
        let to = [clip.right().min(self.width), clip.bottom().min(self.height)];
        std::array::from_fn(|axis| {
            let first = (low[axis] * f64::from(FINE)).floor().max(f64::from(FINE * from[axis].max(0)));
            let last = (high[axis] * f64::from(FINE)).ceil().min(f64::from(FINE * to[axis]));
            first as i32..last as i32
        })
    }

    /// Mixes in a shape; `distance` is from its edge, negative inside, pixels.
    fn shape(
        &mut self,
        clip: Rect,
        low: [f64; 2],
        high: [f64; 2],
        colour: Colour,
        distance: impl Fn([f64; 2]) -> f64,
    ) {
        let [columns, rows] = self.samples(clip, low.map(|v| v - 1.0), high.map(|v| v + 1.0));
        for row in rows {
            for column in columns.clone() {
                let at = [column, row].map(|v| (f64::from(v) + 0.5) / f64::from(FINE));
                let share = (0.5 - distance(at) * f64::from(FINE)).clamp(0.0, 1.0);
                if share > 0.0 {
                    self.blend(column, row, colour, share);
                }
            }
        }
    }

    /// A filled rectangle with edges anywhere, to the nearest half pixel.
    pub fn fill(&mut self, clip: Rect, low: [f64; 2], high: [f64; 2], colour: Colour) {
        let [columns, rows] = self.samples(clip, low, high);
        for row in rows {
            for column in columns.clone() {
                self.blend(column, row, colour, 1.0);
            }
        }
    }

    /// A filled rectangle.
    pub fn rectangle(&mut self, area: Rect, colour: Colour) {
        let [x, y, right, bottom] = [area.x, area.y, area.right(), area.bottom()].map(f64::from);
        self.fill(area, [x, y], [right, bottom], colour);
    }

    /// A straight line with round ends.
    pub fn line(&mut self, clip: Rect, from: [f64; 2], to: [f64; 2], width: f64, colour: Colour) {
        let Some([a, b]) = visible(clip, width + 2.0, from, to) else {
            return;
        };
        let half = 0.5 * width;
        let low = std::array::from_fn(|i| a[i].min(b[i]) - half);
        let high = std::array::from_fn(|i| a[i].max(b[i]) + half);
        let along = [b[0] - a[0], b[1] - a[1]];
        let square = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        self.shape(clip, low, high, colour, |p| {
            let off = [p[0] - a[0], p[1] - a[1]];
            let t = ((off[0] * along[0] + off[1] * along[1]) / square).clamp(0.0, 1.0);
            (off[0] - t * along[0]).hypot(off[1] - t * along[1]) - half
        });
    }

    /// A filled circle.
    pub fn dot(&mut self, clip: Rect, centre: [f64; 2], radius: f64, colour: Colour) {
        let (low, high) = (centre.map(|v| v - radius), centre.map(|v| v + radius));
        self.shape(clip, low, high, colour, |p| (p[0] - centre[0]).hypot(p[1] - centre[1]) - radius);
    }

    /// A text from its upper left corner; letters lie above all shapes.
    pub fn text(&mut self, font: Font, text: &str, x: i32, y: i32, colour: Colour) {
        self.letters.push(Letters { font, text: text.into(), x, y, upwards: false, colour });
    }

    /// A text that runs upwards, from the lower end of its left side.
    pub fn text_upwards(&mut self, font: Font, text: &str, x: i32, y: i32, colour: Colour) {
        self.letters.push(Letters { font, text: text.into(), x, y, upwards: true, colour });
    }

    /// A picture, pixel by pixel, from its upper left corner.
    pub fn picture(&mut self, picture: &RgbImage, x: i32, y: i32) {
        let area = Rect { x, y, width: picture.width as i32, height: picture.height as i32 };
        let high = [f64::from(area.right()), f64::from(area.bottom())];
        let [columns, rows] = self.samples(area, [f64::from(x), f64::from(y)], high);
        for row in rows {
            for column in columns.clone() {
                let from = [column.div_euclid(FINE) - x, row.div_euclid(FINE) - y];
                if let Some(colour) = picture.pixel(from[0] as u32, from[1] as u32) {
                    self.blend(column, row, colour, 1.0);
                }
            }
        }
    }

    /// The picture.
    pub fn finish(self) -> RgbImage {
        let mut image = RgbImage::filled(self.width as u32, self.height as u32, WHITE);
        let (columns, fine) = (self.width as usize, FINE as usize);
        for (i, pixel) in image.rgb.chunks_exact_mut(3).enumerate() {
            let (row, column) = (i / columns, i % columns);
            for (channel, value) in pixel.iter_mut().enumerate() {
                let samples = (0..fine * fine).map(|k| {
                    let at = (fine * row + k / fine) * fine * columns + fine * column + k % fine;
                    u32::from(self.fine[at][channel])
                });
                *value = (f64::from(samples.sum::<u32>()) / f64::from(FINE * FINE)).round() as u8;
            }
        }
        for letters in &self.letters {
            write(&mut image, letters);
        }
        image
    }
}

/// Mixes letters into the finished picture.
fn write(image: &mut RgbImage, letters: &Letters) {
    let (width, height) = (image.width as i32, image.height as i32);
    for glyph in text::glyphs(letters.font, &letters.text) {
        for (i, grey) in glyph.grey.iter().enumerate().filter(|(_, grey)| **grey > 0) {
            let (across, down) = (glyph.x + (i % glyph.width) as i32, glyph.y + (i / glyph.width) as i32);
            let (x, y) = if letters.upwards {
                (letters.x + down, letters.y - across)
            } else {
                (letters.x + across, letters.y + down)
            };
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let at = 3 * (y as usize * width as usize + x as usize);
                let pixel = &mut image.rgb[at..at + 3];
                let old = [pixel[0], pixel[1], pixel[2]];
                pixel.copy_from_slice(&mixed(old, letters.colour, f64::from(*grey) / 255.0));
            }
        }
    }
}

fn mixed(old: Colour, new: Colour, share: f64) -> Colour {
    std::array::from_fn(|i| {
        (f64::from(old[i]) + share * (f64::from(new[i]) - f64::from(old[i]))).round() as u8
    })
}

/// The part of a line within a rectangle grown by a margin (Liang and Barsky 1984); `None` when there is none.
fn visible(clip: Rect, margin: f64, from: [f64; 2], to: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    let low = [f64::from(clip.x) - margin, f64::from(clip.y) - margin];
    let high = [f64::from(clip.right()) + margin, f64::from(clip.bottom()) + margin];
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        let along = to[axis] - from[axis];
        if !along.is_finite() {
            return None;
        }
        if along == 0.0 {
            if !(low[axis]..=high[axis]).contains(&from[axis]) {
                return None;
            }
            continue;
        }
        let (a, b) = ((low[axis] - from[axis]) / along, (high[axis] - from[axis]) / along);
        first = first.max(a.min(b));
        last = last.min(a.max(b));
    }
    let at = |t: f64| std::array::from_fn(|i| (from[i] + t * (to[i] - from[i])).clamp(low[i], high[i]));
    (first <= last).then(|| [at(first), at(last)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_line_is_cut_to_what_shows() {
        let clip = Rect { x: 0, y: 0, width: 10, height: 10 };
        let [a, b] = visible(clip, 0.0, [-1e6, 5.0], [1e6, 5.0]).unwrap();
        assert!(a[0].abs() < 1e-9 && (b[0] - 10.0).abs() < 1e-9);
        assert!(visible(clip, 0.0, [20.0, 0.0], [20.0, 9.0]).is_none());
        assert!(visible(clip, 0.0, [f64::NAN, 0.0], [20.0, 9.0]).is_none());
    }

    #[test]
    fn shapes_outside_the_page_do_no_harm() {
        let mut canvas = Canvas::new(8, 8);
        let all = Rect { x: -100, y: -100, width: 1_000, height: 1_000 };
        canvas.line(all, [-50.0, -50.0], [50.0, 50.0], 2.0, [0; 3]);
        canvas.dot(all, [8.0, 0.0], 3.0, [255, 0, 0]);
        canvas.rectangle(Rect { x: -5, y: 6, width: 8, height: 9 }, [0, 0, 255]);
        canvas.picture(&RgbImage::filled(4, 4, [0, 255, 0]), -2, -2);
        canvas.text(Font::Large, "far out", -20, 3, [0; 3]);
        canvas.text_upwards(Font::Small, "far out", 6, 100, [0; 3]);
        let image = canvas.finish();
        assert_eq!(image.pixel(0, 0), Some([0, 255, 0]));
        assert_eq!(image.pixel(3, 3), Some([0, 0, 0]));
        assert_eq!(image.pixel(7, 0), Some([255, 0, 0]));
    }

    #[test]
    fn half_covered_pixels_are_grey() {
        let mut canvas = Canvas::new(4, 4);
        let area = canvas.area();
        canvas.fill(area, [0.0, 0.0], [1.5, 4.0], [0; 3]);
        let image = canvas.finish();
        assert_eq!([0, 1, 2].map(|column| image.pixel(column, 1).unwrap()[0]), [0, 128, 255]);
    }
}
