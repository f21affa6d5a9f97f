//! The scan of a screen (§7): a beam, or the rows' drivers, come to each pixel in its turn.
//!
//! Row r of H and column c of W have their turn `share·(r + line·(c + 1/2)/W)/H` of a frame after the frame's start: the beam spends
//! `share` of a frame on the rows (the rest it goes back up) and `line` of a row's time on its pixels.

use serde::{Deserialize, Serialize};

use super::{Display, Waveform};
use crate::experiment::{RangeError, check_range};

/// Turns of the pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// Part of a frame in which all rows have their turn.
    pub share: f64,
    /// Part of a row's time in which its pixels have their turn; 0: all at once.
    pub line: f64,
}

impl Scan {
    /// When a pixel's turn is, in frames after the frame's start.
    pub fn delay(&self, display: &Display, [column, row]: [u32; 2]) -> f64 {
        let along = self.line * (f64::from(column) + 0.5) / f64::from(display.width_px);
        self.share * (f64::from(row) + along) / f64::from(display.height_px)
    }

    pub(super) fn validate(&self, path: &str, pixel: &Waveform) -> Result<(), RangeError> {
        let last = match pixel {
            Waveform::Phosphor { start, .. } => 1.0 - 1e-6 - start,
            Waveform::Steady | Waveform::Pulses(_) => 1.0,
            Waveform::Pwm { .. } | Waveform::Scanned { .. } => {
                return Err(RangeError::new(
                    &format!("{path}.scan"),
                    "with pwm",
                    "no pwm, which knows no rows",
                ));
            }
        };
        check_range(&format!("{path}.scan.share"), self.share, 0.0, last)?;
        check_range(&format!("{path}.scan.line"), self.line, 0.0, 1.0)
    }
}
