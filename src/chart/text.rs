//! Letters: Noto Sans Mono, ready-made as shades of grey, in three sizes. A part in `^{}` is raised and small.
//!
//! The font has Basic Latin and Latin-1 (so µ ² ³ ± ° · ×); another character becomes a question mark.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Size and weight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Font {
    /// Numbers, legends, axes: 16 pixels a line.
    Small,
    /// Title of a panel: bold, 16 pixels a line.
    Bold,
    /// Title of a page: bold, 24 pixels a line.
    Large,
}

impl Font {
    fn raster(self) -> (FontWeight, RasterHeight) {
        match self {
            Self::Small => (FontWeight::Regular, RasterHeight::Size16),
            Self::Bold => (FontWeight::Bold, RasterHeight::Size16),
            Self::Large => (FontWeight::Bold, RasterHeight::Size24),
        }
    }

    /// Height of a line, pixels.
    pub fn height(self) -> i32 {
        self.raster().1.val() as i32
    }

    /// Width of a character, pixels.
    fn advance(self) -> i32 {
        let (weight, size) = self.raster();
        get_raster_width(weight, size) as i32
    }
}

/// A character with its place from the beginning of the text: a grey of 0 to 255 at each of `height` x `width` pixels.
pub struct Glyph {
    /// From the beginning of the text to the left edge.
    pub x: i32,
    /// From the top of the line to the upper edge.
    pub y: i32,
    /// Columns.
    pub width: usize,
    /// Row by row.
    pub grey: Vec<u8>,
}

/// The characters of a text.
pub fn glyphs(font: Font, text: &str) -> Vec<Glyph> {
    let mut out = Vec::new();
    let mut x = 0;
    for (character, raised) in characters(text) {
        out.extend(if raised { small(character, x) } else { full(font, character, x) });
        x += if raised { SMALL_ADVANCE } else { font.advance() };
    }
    out
}

/// Width of a text, pixels.
pub fn width_of(font: Font, text: &str) -> i32 {
    characters(text).map(|(_, raised)| if raised { SMALL_ADVANCE } else { font.advance() }).sum()
}

/// Characters without the marks of raised parts, and whether each is raised.
fn characters(text: &str) -> impl Iterator<Item = (char, bool)> {
    let mut raised = false;
    let mut rest = text.chars().peekable();
    std::iter::from_fn(move || {
        loop {
            let character = rest.next()?;
            if character == '^' && rest.peek() == Some(&'{') {
                rest.next();
                raised = true;
            } else if character == '}' && raised {
                raised = false;
            } else {
                return Some((character, raised));
            }
        }
    })
}

fn full(font: Font, character: char, x: i32) -> Option<Glyph> {
    let (weight, size) = font.raster();
    let raster = get_raster(character, weight, size).or_else(|| get_raster('?', weight, size))?;
    Some(Glyph { x, y: 0, width: raster.width(), grey: raster.pixels().to_vec() })
}

/// The large font at half its size.
const SMALL_ADVANCE: i32 = get_raster_width(FontWeight::Regular, RasterHeight::Size24).div_ceil(2) as i32;

fn small(character: char, x: i32) -> Option<Glyph> {
    let raster = get_raster(character, FontWeight::Regular, RasterHeight::Size24)?;
    let (width, height) = (raster.width().div_ceil(2), raster.height() / 2);
    let grey = (0..width * height).map(|i| {
        let (row, column) = (i / width, i % width);
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)]
            .map(|(dx, dy)| u32::from(raster.pixel(2 * column + dx, 2 * row + dy).unwrap_or(0)));
        // A little darker than the mean, which is too thin at this size.
        (four.iter().sum::<u32>() * 5 / 16).min(255) as u8
    });
    Some(Glyph { x, y: -2, width, grey: grey.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raised_parts_and_widths() {
        let all: String =
            characters("10^{-3} a^b}").map(|(c, raised)| if raised { '^' } else { c }).collect();
        assert_eq!(all, "10^^ a^b}");
        assert_eq!(width_of(Font::Small, "abc"), 3 * Font::Small.advance());
        assert_eq!(width_of(Font::Small, "1^{2}"), Font::Small.advance() + SMALL_ADVANCE);
        assert_eq!(width_of(Font::Bold, ""), 0);
    }

    #[test]
    fn every_character_of_our_labels_is_there() {
        let question = glyphs(Font::Small, "?").remove(0).grey;
        for glyph in glyphs(Font::Small, "Aa09-µ²³±°·×/%") {
            assert_ne!(glyph.grey, question);
        }
        assert_eq!(glyphs(Font::Small, "\u{4e2d}")[0].grey, question);
    }
}
