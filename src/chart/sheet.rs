//! A sheet of square pictures, each under its title and above a line of words, with a bar of known length.

use photoneye_eye::picture::RgbImage;

use super::canvas::{Canvas, Colour, Rect};
use super::text::{Font, width_of};
use super::{DARK, MARGIN, TITLE};

/// Side of a picture, pixels.
const SIDE: i32 = 300;
/// Between pictures, pixels.
const GAP: i32 = 22;
/// Lines of words around a picture, pixels.
const LINE: i32 = 20;

/// One picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Above it.
    pub title: String,
    /// Below it.
    pub note: String,
    /// What is in it.
    pub content: Content,
    /// Length of the bar as a part of the side, and what it means.
    pub bar: (f64, String),
}

/// What a picture shows.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Square array of values 0 (black) to 1 (white): `[column][row from the bottom]`.
    Values(Vec<f64>),
    /// Groups of points in -1 to 1, the origin in the middle, y up.
    Points(Vec<(Colour, Vec<[f64; 2]>)>),
}

/// Draws pictures row by row in so many columns under a title.
pub fn sheet(title: &str, tiles: &[Tile], columns: usize) -> RgbImage {
    let columns = columns.clamp(1, tiles.len().max(1)) as i32;
    let rows = (tiles.len() as i32 + columns - 1) / columns;
    let step = [SIDE + GAP, SIDE + GAP + 3 * LINE];
    let width = (2 * MARGIN + columns * step[0]).max(2 * MARGIN + width_of(Font::Large, title));
    let mut canvas = Canvas::new(width, MARGIN + TITLE + rows * step[1]);
    canvas.text(Font::Large, title, MARGIN, MARGIN, DARK);
    for (i, tile) in tiles.iter().enumerate() {
        let (column, row) = (i as i32 % columns, i as i32 / columns);
        let (x, y) = (MARGIN + column * step[0], MARGIN + TITLE + row * step[1]);
        canvas.text(Font::Bold, &tile.title, x, y, DARK);
        let area = Rect { x, y: y + LINE, width: SIDE, height: SIDE };
        match &tile.content {
            Content::Values(values) => canvas.picture(&grey(values), area.x, area.y),
            Content::Points(groups) => draw_points(&mut canvas, groups, area),
        }
        let end = f64::from(x) + tile.bar.0 * f64::from(SIDE);
        let height = f64::from(area.bottom() + 5);
        canvas.fill(canvas.area(), [f64::from(x), height], [end, height + 3.0], DARK);
        canvas.text(Font::Small, &tile.bar.1, end as i32 + 6, area.bottom() + 1, DARK);
        canvas.text(Font::Small, &tile.note, x, area.bottom() + LINE, DARK);
    }
    canvas.finish()
}

fn grey(values: &[f64]) -> RgbImage {
    let n = values.len().isqrt().max(1);
    let mut image = RgbImage::filled(SIDE as u32, SIDE as u32, [0; 3]);
    for (i, pixel) in image.rgb.chunks_exact_mut(3).enumerate() {
        let (row, column) = (i / SIDE as usize, i % SIDE as usize);
        let at = |k: usize| k * n / SIDE as usize;
        let value = values.get(at(column) * n + n - 1 - at(row)).copied().unwrap_or(0.0);
        pixel.fill((255.0 * value.clamp(0.0, 1.0)).round() as u8);
    }
    image
}

fn draw_points(canvas: &mut Canvas, groups: &[(Colour, Vec<[f64; 2]>)], area: Rect) {
    canvas.rectangle(area, [246; 3]);
    let half = 0.5 * f64::from(SIDE);
    let (x, y) = (f64::from(area.x) + half, f64::from(area.y) + half);
    let (left, top) = (f64::from(area.x), f64::from(area.y));
    canvas.fill(area, [left, y - 0.5], [left + 2.0 * half, y + 0.5], [215; 3]);
    canvas.fill(area, [x - 0.5, top], [x + 0.5, top + 2.0 * half], [215; 3]);
    for (colour, points) in groups {
        for [u, v] in points {
            canvas.dot(area, [x + u * half, y - v * half], 1.3, *colour);
        }
    }
}
