//! Displays (§7): a device is a list of primaries; lowered once to flat emitters, so that no kernel knows a device.
//!
//! A primary is a set of rectangles inside the pixel, a spectrum, a waveform inside the frame and a misregistration offset.
//! Pixel units: x to the right, y down, 0 to 1 across a pixel.

mod emitter;

use serde::{Deserialize, Serialize};

pub use emitter::{Emitter, PhotonSample, emitters, photon_shares, pupil_share, pupil_share_at};

use crate::experiment::{RangeError, check_range};
use crate::spectrum::Spectrum;

/// A display and how it is looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Display {
    /// Columns, 1 to 4096.
    pub width_px: u32,
    /// Rows, 1 to 4096.
    pub height_px: u32,
    /// Distance between pixel centres, cm.
    pub pixel_pitch_cm: f64,
    /// Distance of the screen from the corneal apex along the line of sight, cm.
    pub distance_cm: f64,
    /// How bright full white is.
    pub white: White,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// From pixel value to relative light.
    pub transfer: Transfer,
    /// How light leaves the screen.
    pub emission_law: EmissionLaw,
    /// The colours.
    pub primaries: Vec<Primary>,
}

/// Brightness of full white.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum White {
    /// Luminance, mean over the full pixel pitch, cd/m².
    LuminanceCdM2(f64),
    /// Luminous flux of the whole screen, lm.
    Lumens(f64),
}

/// From pixel value (0 to 1) to relative light (0 to 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Transfer {
    /// IEC 61966-2-1.
    Srgb,
    /// ITU-R BT.1886 with black at 0: the power 2.4.
    Bt1886,
    /// The value itself.
    Linear,
    /// SMPTE ST 2084, full scale (10 000 cd/m²) at the display's white.
    Pq,
}

impl Transfer {
    /// Relative light of a pixel value.
    pub fn light(self, value: f64) -> f64 {
        match self {
            Self::Srgb if value <= 0.04045 => value / 12.92,
            Self::Srgb => ((value + 0.055) / 1.055).powf(2.4),
            Self::Bt1886 => value.powf(2.4),
            Self::Linear => value,
            Self::Pq => {
                let root = value.powf(32.0 / 2523.0);
                ((root - 0.8359375).max(0.0) / (18.8515625 - 18.6875 * root)).powf(16384.0 / 2610.0)
            }
        }
    }

    /// Pixel value of a relative light: the inverse of [`Transfer::light`].
    pub fn value(self, light: f64) -> f64 {
        match self {
            Self::Srgb if light <= 0.04045 / 12.92 => light * 12.92,
            Self::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            Self::Bt1886 => light.powf(1.0 / 2.4),
            Self::Linear => light,
            Self::Pq => {
                let root = light.powf(2610.0 / 16384.0);
                ((0.8359375 + 18.8515625 * root) / (1.0 + 18.6875 * root)).powf(2523.0 / 32.0)
            }
        }
    }
}

/// How light leaves the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EmissionLaw {
    /// The same radiance in all directions; intensity falls with the cosine; `Φ/π` on axis.
    Lambertian,
    /// The same intensity over the half space, `Φ/2π`: the arithmetic of §6.
    Uniform,
}

/// Which picture channel drives a primary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Channel {
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// The mean light of the three.
    White,
}

/// One colour of a display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Primary {
    /// What drives it.
    pub channel: Channel,
    /// Radiant power against wavelength, relative between the primaries of a display.
    pub spectrum: Spectrum,
    /// Factor on the spectrum.
    pub power: f64,
    /// Light-emitting rectangles `[x0, y0, x1, y1]`.
    pub rects: Vec<[f64; 4]>,
    /// Misregistration, pixel pitches.
    pub offset_px: [f64; 2],
    /// Part of the frame `[start, end]` during which it is lit.
    pub lit: [f64; 2],
}

impl Display {
    /// Checks every range.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        check_range("display.width_px", f64::from(self.width_px), 1.0, 4096.0)?;
        check_range("display.height_px", f64::from(self.height_px), 1.0, 4096.0)?;
        check_range("display.pixel_pitch_cm", self.pixel_pitch_cm, 1e-6, 1e4)?;
        check_range("display.distance_cm", self.distance_cm, 10.0, 1e5)?;
        match self.white {
            White::LuminanceCdM2(value) => check_range("display.white_luminance_cd_m2", value, 0.0, 1e7)?,
            White::Lumens(value) => check_range("display.lumens", value, 0.0, 1e9)?,
        }
        check_range("display.frame_rate_hz", self.frame_rate_hz, 0.01, 1e6)?;
        if self.primaries.is_empty() || self.primaries.len() > 8 {
            return Err(RangeError::new("display.primaries", self.primaries.len(), "1 to 8 primaries"));
        }
        for (k, primary) in self.primaries.iter().enumerate() {
            primary.validate(&format!("display.primaries[{k}]"))?;
        }
        Ok(())
    }

    /// Angle of one pixel pitch at the gaze centre, radians.
    pub fn pixel_radians(&self) -> f64 {
        (self.pixel_pitch_cm / self.distance_cm).atan()
    }
}

impl Primary {
    fn validate(&self, path: &str) -> Result<(), RangeError> {
        check_range(&format!("{path}.power"), self.power, 0.0, 1e9)?;
        if self.rects.is_empty() || self.rects.len() > 16 {
            return Err(RangeError::new(&format!("{path}.rects"), self.rects.len(), "1 to 16 rectangles"));
        }
        for (i, [x0, y0, x1, y1]) in self.rects.iter().copied().enumerate() {
            check_range(&format!("{path}.rects[{i}].x0"), x0, 0.0, 1.0)?;
            check_range(&format!("{path}.rects[{i}].y0"), y0, 0.0, 1.0)?;
            check_range(&format!("{path}.rects[{i}].x1"), x1, x0 + 1e-6, 1.0)?;
            check_range(&format!("{path}.rects[{i}].y1"), y1, y0 + 1e-6, 1.0)?;
        }
        check_range(&format!("{path}.offset_px.x"), self.offset_px[0], -10.0, 10.0)?;
        check_range(&format!("{path}.offset_px.y"), self.offset_px[1], -10.0, 10.0)?;
        check_range(&format!("{path}.waveform.pulse.start"), self.lit[0], 0.0, 1.0)?;
        check_range(&format!("{path}.waveform.pulse.end"), self.lit[1], self.lit[0] + 1e-6, 1.0)?;
        self.spectrum.validate(&format!("{path}.spectrum"))
    }
}
