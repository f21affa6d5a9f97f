//! An 8-bit RGB picture in memory, and sRGB's transfer curve.

use std::sync::LazyLock;

use super::{encode_png, encode_png_with};
use crate::display::Transfer;

/// 8-bit sRGB pixels, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue; `3·width·height` values.
    pub rgb: Vec<u8>,
}

impl RgbImage {
    /// One colour everywhere.
    pub fn filled(width: u32, height: u32, colour: [u8; 3]) -> Self {
        Self { width, height, rgb: colour.repeat(width as usize * height as usize) }
    }

    /// The colour of a pixel; `None` outside.
    pub fn pixel(&self, column: u32, row: u32) -> Option<[u8; 3]> {
        if column >= self.width || row >= self.height {
            return None;
        }
        let at = 3 * (row as usize * self.width as usize + column as usize);
        Some([*self.rgb.get(at)?, *self.rgb.get(at + 1)?, *self.rgb.get(at + 2)?])
    }

    /// As a PNG.
    ///
    /// # Errors
    /// When the encoder refuses, as for a picture without pixels.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        encode_png(self.width, self.height, &self.rgb)
    }

    /// As a PNG with a text `Warning` (iTXt) for each warning.
    ///
    /// # Errors
    /// As [`RgbImage::png`].
    pub fn png_with(&self, warnings: &[String]) -> Result<Vec<u8>, png::EncodingError> {
        encode_png_with(self.width, self.height, &self.rgb, warnings)
    }
}

/// Steps of linear light in the table of sRGB values: in the dark a value is 20 of them.
const STEPS: usize = 1 << 16;

static SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let value = |step: usize| Transfer::Srgb.value(step as f64 / (STEPS - 1) as f64);
    (0..STEPS).map(|step| (value(step) * 255.0 + 0.5) as u8).collect()
});

/// The 8-bit sRGB value of linear light, 0 to 1.
pub fn encode_srgb(light: f32) -> u8 {
    // Rounded; a negative number or none becomes 0.
    SRGB[((light * (STEPS - 1) as f32 + 0.5) as usize).min(STEPS - 1)]
}

/// Linear light of every 8-bit sRGB value.
pub fn srgb_light() -> [f64; 256] {
    std::array::from_fn(|value| Transfer::Srgb.light(value as f64 / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_comes_back() {
        for (value, light) in srgb_light().into_iter().enumerate() {
            assert_eq!(usize::from(encode_srgb(light as f32)), value);
        }
        assert_eq!([-1.0, f32::NAN, 2.0].map(encode_srgb), [0, 0, 255]);
    }
}
