//! Displays (§7): a device is a list of primaries; lowered once to flat emitters, so that no kernel knows a device.
//!
//! A primary is a set of rectangles inside the pixel, a spectrum, a waveform inside the frame, a spot and a misregistration offset.
//! Pixel units: x to the right, y down, 0 to 1 across a pixel.

mod emitter;
mod panel;
mod scan;
mod transfer;
mod waveform;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

pub use emitter::{Emitter, PhotonSample, emitters, photon_shares, pupil_share, pupil_share_at};
pub use panel::{Levels, Panel, Place, of_step, step, stepped};
pub use scan::Scan;
pub use transfer::{Curve, Transfer};
pub use waveform::{FORGOTTEN, MAX_HISTORY, Part, Timing, Waveform, light_until};

use crate::experiment::{RangeError, check_range};
use crate::optics::Screen;
use crate::spectrum::Spectrum;

/// A display and how it is looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Display {
    /// Columns, 1 to [`MOST_SIDE_PX`].
    pub width_px: u32,
    /// Rows, 1 to [`MOST_SIDE_PX`].
    pub height_px: u32,
    /// Distance between pixel centres, cm.
    pub pixel_pitch_cm: f64,
    /// Distance of the screen from the corneal apex when the eye looks straight ahead, or with
    /// [`Placement::Frontal`] along the line of sight, cm.
    pub distance_cm: f64,
    /// How the screen stands before the head.
    #[serde(default)]
    pub placement: Placement,
    /// How bright full white is.
    pub white: White,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// From pixel value to relative light.
    pub transfer: Transfer,
    /// Light of a black pixel over that of a white one, 0 to 1.
    pub black: f64,
    /// What stands between pixel values and light.
    pub panel: Panel,
    /// How light leaves the screen.
    pub emission_law: EmissionLaw,
    /// The colours.
    pub primaries: Vec<Primary>,
}

/// How the screen stands before the head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Placement {
    /// Flat, across the line of sight, whatever point is fixated.
    #[default]
    Frontal,
    /// In one place; the eye turns to look at another point.
    Fixed {
        /// The point straight ahead of the eye, pixels from the left and from the top.
        eye_at_px: [f64; 2],
        /// How far the top leans away from the viewer, degrees.
        tilt_deg: f64,
        /// How far the right edge is turned away from the viewer, degrees.
        turn_deg: f64,
        /// Radius of a screen that is curved about the viewer, cm; `None` is flat.
        curvature_radius_cm: Option<f64>,
    },
}

/// Most columns and most rows of a screen and of a picture.
pub const MOST_SIDE_PX: u32 = 8192;
/// Largest tilt and turn, degrees.
const MOST_TURNED_DEG: f64 = 75.0;
/// Largest angle of a curved screen's arc on either side of the point straight ahead, degrees.
const MOST_ARC_DEG: f64 = 85.0;

/// Brightness of full white.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum White {
    /// Luminance, mean over the full pixel pitch, cd/m².
    LuminanceCdM2(f64),
    /// Luminous flux of the whole screen, lm.
    Lumens(f64),
}

/// How light leaves the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EmissionLaw {
    /// The same radiance in all directions; intensity falls with the cosine; `Φ/π` on axis.
    Lambertian,
    /// The same intensity over the half space, `Φ/2π`: the arithmetic of §6.
    Uniform,
}

impl EmissionLaw {
    /// Irradiance at the corneal apex, across the light, from the point `t` of a screen over that from a
    /// point at the nominal distance that faces the eye: the law and the squared distance.
    pub fn irradiance(self, screen: &Screen, t: DVec2) -> f64 {
        screen.nearness(t) * self.towards(screen.emission_cosine(t))
    }

    /// The same at a corneal apex in another place, over the nominal distance in the view frame.
    pub fn irradiance_at(self, apex: DVec3, screen: &Screen, t: DVec2) -> f64 {
        let way = apex - screen.way(t);
        self.towards(way.normalize().dot(screen.normal(t))) / way.length_squared()
    }

    /// Intensity over that along the normal, by the cosine of the angle to it: none behind the screen.
    fn towards(self, cosine: f64) -> f64 {
        match self {
            _ if cosine <= 0.0 => 0.0,
            Self::Lambertian => cosine,
            Self::Uniform => 1.0,
        }
    }
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
    /// The least light of the three.
    Least,
    /// Nothing: light that the screen reflects, always on.
    Room,
}

impl Channel {
    /// What drives it, from the light of red (0), green (1) and blue (2).
    pub(crate) fn of(self, light: impl Fn(usize) -> f64) -> f64 {
        match self {
            Self::Red => light(0),
            Self::Green => light(1),
            Self::Blue => light(2),
            Self::White => (light(0) + light(1) + light(2)) / 3.0,
            Self::Least => light(0).min(light(1)).min(light(2)),
            Self::Room => 0.0,
        }
    }

    /// Its place in a pixel's red, green and blue, if it is one of them.
    fn index(self) -> Option<usize> {
        match self {
            Self::Red => Some(0),
            Self::Green => Some(1),
            Self::Blue => Some(2),
            Self::White | Self::Least | Self::Room => None,
        }
    }
}

/// One colour of a display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Primary {
    /// What drives it.
    pub channel: Channel,
    /// Radiant power against wavelength, relative between the primaries of a display.
    pub spectrum: Spectrum,
    /// Factor on the spectrum; of [`Channel::Room`] the luminance, mean over the pixel pitch, cd/m².
    pub power: f64,
    /// Light-emitting rectangles `[x0, y0, x1, y1]`.
    pub rects: Vec<[f64; 4]>,
    /// Misregistration, pixel pitches.
    pub offset_px: [f64; 2],
    /// Standard deviation of the Gaussian spot that the rectangles are blurred with, pixel pitches.
    pub spot_sd_px: f64,
    /// When in the frame it gives its light.
    pub waveform: Waveform,
}

impl Display {
    /// Checks every range.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        check_range("display.width_px", f64::from(self.width_px), 1.0, f64::from(MOST_SIDE_PX))?;
        check_range("display.height_px", f64::from(self.height_px), 1.0, f64::from(MOST_SIDE_PX))?;
        match self.transfer {
            Transfer::Gamma(exponent) => check_range("display.gamma", exponent, 0.5, 5.0)?,
            Transfer::Hlg(Some(gamma)) => check_range("display.hlg_system_gamma", gamma, 0.5, 3.0)?,
            _ => {}
        }
        check_range("display.pixel_pitch_cm", self.pixel_pitch_cm, 1e-6, 1e4)?;
        check_range("display.distance_cm", self.distance_cm, 10.0, 1e5)?;
        self.validate_placement()?;
        match self.white {
            White::LuminanceCdM2(value) => check_range("display.white_luminance_cd_m2", value, 0.0, 1e7)?,
            White::Lumens(value) => check_range("display.lumens", value, 0.0, 1e9)?,
        }
        check_range("display.frame_rate_hz", self.frame_rate_hz, 0.01, 1e6)?;
        if self.primaries.is_empty() || self.primaries.len() > 8 {
            return Err(RangeError::new("display.primaries", self.primaries.len(), "1 to 8 primaries"));
        }
        for (k, primary) in self.primaries.iter().enumerate() {
            primary.validate(&format!("display.primaries[{k}]"), self.frame_rate_hz)?;
        }
        if !(0.0..=1.0).contains(&self.black) {
            return Err(RangeError::new("display.contrast", 1.0 / self.black, "1 to 1e9"));
        }
        self.panel.validate()?;
        self.validate_time()
    }

    fn validate_placement(&self) -> Result<(), RangeError> {
        let Placement::Fixed { eye_at_px: [x, y], tilt_deg, turn_deg, curvature_radius_cm } = self.placement
        else {
            return Ok(());
        };
        check_range("display.eye_at_px[0]", x, -1e6, 1e6)?;
        check_range("display.eye_at_px[1]", y, -1e6, 1e6)?;
        check_range("display.tilt_deg", tilt_deg, -MOST_TURNED_DEG, MOST_TURNED_DEG)?;
        check_range("display.turn_deg", turn_deg, -MOST_TURNED_DEG, MOST_TURNED_DEG)?;
        let Some(radius_cm) = curvature_radius_cm else { return Ok(()) };
        let farther_px = x.abs().max((f64::from(self.width_px) - x).abs());
        let least_cm = farther_px * self.pixel_pitch_cm / MOST_ARC_DEG.to_radians();
        check_range("display.curvature_radius_cm", radius_cm, least_cm.max(1.0), 1e6)
    }

    /// A point of the display (pixels) from the point straight ahead, to the right and up on the screen, mm.
    pub fn offset_mm(&self, at_px: [f64; 2]) -> DVec2 {
        let Placement::Fixed { eye_at_px, .. } = self.placement else { return DVec2::ZERO };
        let [x, y] = [at_px[0] - eye_at_px[0], eye_at_px[1] - at_px[1]];
        10.0 * self.pixel_pitch_cm * DVec2::new(x, y)
    }

    /// Combinations of panel and waveforms that have no meaning, and memories that are too long.
    fn validate_time(&self) -> Result<(), RangeError> {
        let planes = matches!(self.panel.levels, Levels::Planes { .. });
        for (k, primary) in self.primaries.iter().enumerate() {
            let path = format!("display.primaries[{k}].waveform");
            let scanned = primary.waveform.scan().is_some();
            if scanned && (planes || self.panel.lag_ms > 0.0) {
                let allowed = "no scan before bit planes or pixels that settle slowly";
                return Err(RangeError::new(&format!("{path}.scan"), "given", allowed));
            }
            let phosphor = match &primary.waveform {
                Waveform::Scanned { pixel, .. } => matches!(**pixel, Waveform::Phosphor { .. }),
                other => matches!(other, Waveform::Phosphor { .. }),
            };
            if phosphor && (planes || self.panel.lag_ms > 0.0) {
                let allowed = "no phosphor behind bit planes or pixels that settle slowly";
                return Err(RangeError::new(&path, "phosphor", allowed));
            }
            let timing = primary.waveform.timing(0, 1.0 / self.frame_rate_hz, self.panel.lag_ms);
            if timing.history() > MAX_HISTORY {
                let field = if phosphor { path } else { "display.lag_ms".into() };
                let value = self.panel.lag_ms;
                let allowed = format!("a memory of at most {MAX_HISTORY} frames");
                return Err(RangeError::new(&field, value, &allowed));
            }
        }
        if planes && self.panel.lag_ms > 0.0 {
            return Err(RangeError::new("display.lag_ms", self.panel.lag_ms, "0 with bit planes"));
        }
        Ok(())
    }

    /// A small screen without primaries.
    #[cfg(test)]
    pub fn for_test() -> Self {
        Self {
            width_px: 7,
            height_px: 5,
            pixel_pitch_cm: 0.03,
            distance_cm: 100.0,
            placement: Placement::Frontal,
            white: White::LuminanceCdM2(100.0),
            frame_rate_hz: 60.0,
            transfer: Transfer::Srgb,
            black: 0.01,
            panel: Panel::default(),
            emission_law: EmissionLaw::Lambertian,
            primaries: Vec::new(),
        }
    }

    /// Light of a channel (0 to 1) that a pixel is told to give, in the panel's levels and above its black.
    pub fn light(&self, channel: Channel, rgb: &[f32], place: Place) -> f64 {
        if channel == Channel::Room {
            return 1.0;
        }
        self.black + (1.0 - self.black) * self.driven(channel, rgb, place)
    }

    /// The same for pixels of a row, `rgb[3·pixel + channel]`, the first of them at `place`.
    pub fn light_row(&self, channel: Channel, rgb: &[f32], place: Place, light: &mut [f64]) {
        let curve = self.curve();
        // What depends on a pixel's place or on all its colours is made pixel by pixel.
        let is_by_pixel = matches!(self.panel.levels, Levels::Planes { .. })
            || channel == Channel::Room
            || curve.joins_colours();
        if is_by_pixel {
            for ((light, rgb), column) in light.iter_mut().zip(rgb.chunks_exact(3)).zip(place.column..) {
                *light = self.light(channel, rgb, Place { column, ..place });
            }
            return;
        }
        let (black, white) = (self.black, 1.0 - self.black);
        let stepped_light = self.stepped_light(curve, light.len());
        let one = |i: usize, light: &mut [f64]| {
            let values = rgb.chunks_exact(3).map(|rgb| rgb[i]);
            match self.panel.levels {
                Levels::Values { bits, dither } => {
                    for ((light, value), column) in light.iter_mut().zip(values).zip(place.column..) {
                        let value = f64::from(value).clamp(0.0, 1.0);
                        let step = step(value, bits, dither, Place { column, ..place });
                        let known = stepped_light.get(step as usize).copied();
                        *light = known.unwrap_or_else(|| curve.light(of_step(step, bits)));
                    }
                }
                Levels::Continuous | Levels::Planes { .. } => {
                    let values: Vec<f32> = values.take(light.len()).collect();
                    curve.light_of_row(&values, light);
                }
            }
        };
        // Join the colours of a white primary.
        if let Some(i) = channel.index() {
            one(i, light);
        } else {
            let [mut green, mut blue] = [vec![0.0; light.len()], vec![0.0; light.len()]];
            one(0, light);
            one(1, &mut green);
            one(2, &mut blue);
            for ((light, green), blue) in light.iter_mut().zip(green).zip(blue) {
                *light = if channel == Channel::Least {
                    light.min(green).min(blue)
                } else {
                    (*light + green + blue) / 3.0
                };
            }
        }
        for light in light {
            *light = black + white * *light;
        }
    }

    /// Light of every step of a pixel value, where a row has more pixels than there are steps; else nothing.
    fn stepped_light(&self, curve: Curve, pixels: usize) -> Vec<f64> {
        match self.panel.levels {
            Levels::Values { bits, .. } if 1 << bits <= pixels => {
                (0..1 << bits).map(|step| curve.light(of_step(step, bits))).collect()
            }
            _ => Vec::new(),
        }
    }

    /// From pixel values to relative light.
    pub fn curve(&self) -> Curve {
        Curve::new(self.transfer, self.white_cd_m2(), self.black)
    }

    /// As [`Display::light`], above black.
    pub fn driven(&self, channel: Channel, rgb: &[f32], place: Place) -> f64 {
        let curve = self.curve();
        if curve.joins_colours() {
            let lights = self.driven_colours(curve, rgb, place);
            return channel.of(|i| lights[i]);
        }
        let light = |i: usize| {
            let value = f64::from(rgb[i]).clamp(0.0, 1.0);
            match self.panel.levels {
                Levels::Continuous => curve.light_of_pixel(rgb[i]),
                Levels::Values { bits, dither } => curve.light(stepped(value, bits, dither, place)),
                Levels::Planes { bits, dither } => stepped(curve.light(value), bits, dither, place),
            }
        };
        channel.of(light)
    }

    /// Light of red, green and blue above black, where it depends on all three values.
    fn driven_colours(&self, curve: Curve, rgb: &[f32], place: Place) -> [f64; 3] {
        let values: [f64; 3] = std::array::from_fn(|i| f64::from(rgb[i]).clamp(0.0, 1.0));
        match self.panel.levels {
            Levels::Continuous => curve.lights(values),
            Levels::Values { bits, dither } => {
                curve.lights(values.map(|value| stepped(value, bits, dither, place)))
            }
            Levels::Planes { bits, dither } => {
                curve.lights(values).map(|light| stepped(light, bits, dither, place))
            }
        }
    }

    /// Angle of one pixel pitch at the gaze centre, radians.
    pub fn pixel_radians(&self) -> f64 {
        (self.pixel_pitch_cm / self.distance_cm).atan()
    }
}

impl Primary {
    fn validate(&self, path: &str, frame_rate_hz: f64) -> Result<(), RangeError> {
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
        check_range(&format!("{path}.spot_sd_px"), self.spot_sd_px, 0.0, 10.0)?;
        self.waveform.validate(&format!("{path}.waveform"), frame_rate_hz)?;
        self.spectrum.validate(&format!("{path}.spectrum"))
    }
}
