//! An 8-bit RGB picture in memory, and sRGB's transfer curve.

use super::encode_png;

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
}

/// The 8-bit sRGB value of linear light, 0 to 1.
pub(super) fn encode_srgb(light: f32) -> u8 {
    let light = light.clamp(0.0, 1.0);
    let value = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
    (value * 255.0 + 0.5) as u8
}
