//! Pictures: bounded decoding of files and the drawn patterns.
//!
//! A clip is PNG, PGM or PPM pictures, a frame each, or one film: Y4M, or raw RGB of the display's size. Pixel values are inputs of the
//! display, 0 to 1; what light they mean is the display's transfer. Gamma or colour chunks inside files are not read.

mod chart;
mod clip;
mod decode;
mod netpbm;
mod pattern;
pub mod reader;
mod screen_view;
mod sloan;
mod stated;
pub mod sweep;
mod y4m;

pub use chart::{PlacedLetter, logmar_rows, paper_rows, placed_letters};
pub use clip::{
    ChromaSiting, ClipFormat, ClipInfo, FromFilm, Matrix, Range, Raw, Yuv, clip_info, decode_frame,
    film_rate_hz, mean_light,
};
pub use decode::{DecodeError, Limits, decode_png, png_size};
pub use pattern::draw;
pub use screen_view::ScreenView;
pub use stated::StatedTransfer;

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

/// Pixels that are looked at together.
const CHUNK: usize = 1024;

impl Picture {
    /// Whether red, green and blue are the same everywhere.
    pub fn is_gray(&self) -> bool {
        // Without a branch for each pixel.
        let gray = |pixels: &[f32]| {
            let apart = |rgb: &[f32; 3]| {
                (rgb[0].to_bits() ^ rgb[1].to_bits()) | (rgb[0].to_bits() ^ rgb[2].to_bits())
            };
            pixels.as_chunks().0.iter().fold(0, |sum, rgb| sum | apart(rgb)) == 0
        };
        self.rgb.chunks(3 * CHUNK).all(gray)
    }
}
