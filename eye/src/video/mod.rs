//! Pictures: bounded decoding of PNG files and the drawn patterns.

mod decode;
mod pattern;

pub use decode::{DecodeError, Limits, decode_png, png_size};
pub use pattern::draw;

/// A picture: pixel values 0 to 1, row-major from the top left, red green blue.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pixel values, `[row][column][channel]`, length 3·width·height.
    pub rgb: Vec<f32>,
}
