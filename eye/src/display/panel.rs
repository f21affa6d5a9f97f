//! What a panel does to pixel values before they become light: settling, few levels, dither (§7).
//!
//! Ordered dither over 2x2 pixels and 4 frames (frame rate control): a value u of n = 2^bits - 1 steps is shown as
//! `floor(u·n + t)/n` with thresholds t = 1/8, 3/8, 5/8, 7/8 that change places from frame to frame, so four frames gain two bits.

use serde::{Deserialize, Serialize};

use crate::experiment::{RangeError, check_range};

/// What stands between pixel values and light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Panel {
    /// Time in which pixels settle to 1/e, ms; 0: at once.
    pub lag_ms: f64,
    /// Levels of a pixel.
    pub levels: Levels,
}

/// Levels of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Levels {
    /// Every value as it is.
    #[default]
    Continuous,
    /// Pixel values in 2^bits steps.
    Values {
        /// 1 to 16.
        bits: u32,
        /// Whether values between are dithered over pixels and frames.
        dither: bool,
    },
    /// Light in 2^bits steps, made of on and off times: each lit part of the frame is a round of all bits, the least first.
    Planes {
        /// 1 to 16.
        bits: u32,
        /// Whether values between are dithered over pixels and frames.
        dither: bool,
    },
}

impl Panel {
    /// Checks ranges.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        check_range("display.lag_ms", self.lag_ms, 0.0, 10_000.0)?;
        match self.levels {
            Levels::Continuous => Ok(()),
            Levels::Values { bits, .. } | Levels::Planes { bits, .. } => {
                check_range("display.levels.bits", f64::from(bits), 1.0, 16.0)
            }
        }
    }
}

/// Where a pixel is: column, row, frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Column.
    pub column: u32,
    /// Row.
    pub row: u32,
    /// Frame.
    pub frame: u32,
}

/// The step (0 to 2^bits - 1) that shows a value (0 to 1).
pub fn step(value: f64, bits: u32, dither: bool, place: Place) -> u32 {
    let steps = f64::from((1_u32 << bits) - 1);
    let threshold = if dither {
        let order = [[0, 2], [3, 1]][(place.row & 1) as usize][(place.column & 1) as usize];
        (f64::from((order + place.frame) & 3) + 0.5) / 4.0
    } else {
        0.5
    };
    (value * steps + threshold).floor().clamp(0.0, steps) as u32
}

/// A value in steps.
pub fn stepped(value: f64, bits: u32, dither: bool, place: Place) -> f64 {
    of_step(step(value, bits, dither, place), bits)
}

/// The value (0 to 1) of a step.
pub fn of_step(step: u32, bits: u32) -> f64 {
    f64::from(step) / f64::from((1_u32 << bits) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_frames_and_four_pixels_gain_two_bits() {
        for k in 0..=255 * 4 {
            let value = f64::from(k) / (255.0 * 4.0);
            let mean = |places: &mut dyn Iterator<Item = Place>| {
                places.map(|p| stepped(value, 8, true, p)).sum::<f64>() / 4.0
            };
            let frames = mean(&mut (0..4).map(|frame| Place { column: 3, row: 2, frame }));
            let pixels = mean(&mut (0..4).map(|i| Place { column: i % 2, row: i / 2, frame: 5 }));
            assert!((frames - value).abs() < 1e-9 && (pixels - value).abs() < 1e-9, "{value}");
        }
    }

    #[test]
    fn without_dither_the_nearest_step_is_shown() {
        let place = Place { column: 0, row: 0, frame: 0 };
        assert!((stepped(0.26, 2, false, place) - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!([0.0, 0.49, 0.51, 1.0].map(|v| step(v, 1, false, place)), [0, 0, 1, 1]);
    }
}
