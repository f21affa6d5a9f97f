//! From pixel values to relative light.
//!
//! sRGB, BT.1886 and linear values are relative to the display's white. PQ codes are absolute (SMPTE ST 2084): a code
//! stands for a luminance whatever the screen,
//! `Y = 10 000 cd/m² · (max(r − c₁, 0)/(c₂ − c₃ r))^(1/m₁)` with `r = V^(1/m₂)`,
//! c = 107/128, 2413/128, 2392/128, m = 2610/16384, 2523/32. What is brighter than the display's white is shown as
//! white.

use std::sync::OnceLock;

use multiversion::multiversion;
use serde::{Deserialize, Serialize};

/// From pixel value (0 to 1) to light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Transfer {
    /// IEC 61966-2-1.
    Srgb,
    /// ITU-R BT.1886 with black at 0: the power 2.4.
    Bt1886,
    /// The value itself.
    Linear,
    /// SMPTE ST 2084, absolute.
    Pq,
}

/// Luminance of the largest PQ code, cd/m².
const PQ_PEAK_CD_M2: f64 = 10_000.0;

/// Pixel values of 8-bit pictures with their light.
type Steps = [(f32, f64); 256];

/// A transfer on a display.
#[derive(Clone, Copy, Debug)]
pub struct Curve {
    transfer: Transfer,
    /// Light of the value 1 over the display's white.
    scale: f64,
}

impl Curve {
    /// The curve of a display whose white has a luminance (cd/m²).
    pub fn new(transfer: Transfer, white_cd_m2: f64) -> Self {
        let scale = match transfer {
            Transfer::Srgb | Transfer::Bt1886 | Transfer::Linear => 1.0,
            Transfer::Pq => PQ_PEAK_CD_M2 / white_cd_m2.max(f64::MIN_POSITIVE),
        };
        Self { transfer, scale }
    }

    /// Light of a pixel value over the display's white, at most 1.
    pub fn light(self, value: f64) -> f64 {
        self.shown(self.transfer.light(value))
    }

    /// Pixel value of a relative light: the inverse of [`Curve::light`].
    pub fn value(self, light: f64) -> f64 {
        self.transfer.value(light / self.scale).min(1.0)
    }

    /// As [`Curve::light`] of a clamped value; values of 8-bit pictures are looked up (the same numbers, ten times as
    /// fast).
    pub fn light_of_pixel(self, value: f32) -> f64 {
        self.shown(self.transfer.light_of_pixel(self.transfer.steps(), value))
    }

    /// The same for all pixels of a row.
    pub fn light_of_row(self, values: &[f32], light: &mut [f64]) {
        let steps = self.transfer.steps();
        if !look_up(steps, values, light) {
            for (light, value) in light.iter_mut().zip(values) {
                *light = self.transfer.light_of_pixel(steps, *value);
            }
        }
        if self.transfer == Transfer::Pq {
            for light in light.iter_mut() {
                *light = self.shown(*light);
            }
        }
    }

    /// What the display shows of the curve's own light.
    fn shown(self, light: f64) -> f64 {
        (self.scale * light).min(1.0)
    }
}

impl Transfer {
    /// Light of a pixel value over that of the value 1.
    pub(crate) fn light(self, value: f64) -> f64 {
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

    /// As [`Transfer::light`] of a clamped value; values of 8-bit pictures are looked up (the same numbers, ten
    /// times as fast).
    fn light_of_pixel(self, steps: &Steps, value: f32) -> f64 {
        // Rounded; a negative number or none becomes 0.
        let step = (value * 255.0 + 0.5) as usize;
        match steps.get(step) {
            Some((known, light)) if known.to_bits() == value.to_bits() => *light,
            Some(_) | None => self.light(f64::from(value).clamp(0.0, 1.0)),
        }
    }

    /// The values i/255 with their light.
    fn steps(self) -> &'static Steps {
        static TABLES: OnceLock<[Steps; 4]> = OnceLock::new();
        let tables = TABLES.get_or_init(|| {
            [Self::Srgb, Self::Bt1886, Self::Linear, Self::Pq].map(|transfer| {
                std::array::from_fn(|i| {
                    let value = i as f32 / 255.0;
                    (value, transfer.light(f64::from(value)))
                })
            })
        });
        &tables[match self {
            Self::Srgb => 0,
            Self::Bt1886 => 1,
            Self::Linear => 2,
            Self::Pq => 3,
        }]
    }

    /// Pixel value of a relative light: the inverse of [`Transfer::light`].
    pub(crate) fn value(self, light: f64) -> f64 {
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

/// Looks up the light of pixel values; `false` where some are not those of an 8-bit picture.
#[multiversion(targets("x86_64+avx2"))]
fn look_up(steps: &Steps, values: &[f32], light: &mut [f64]) -> bool {
    let mut others = 0;
    for (light, value) in light.iter_mut().zip(values) {
        // Rounded; never outside the table.
        let step = (*value * 255.0 + 0.5).clamp(0.0, 255.0) as u8;
        let (known, of_known) = steps[usize::from(step)];
        others |= known.to_bits() ^ value.to_bits();
        *light = of_known;
    }
    others == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Transfer; 4] = [Transfer::Srgb, Transfer::Bt1886, Transfer::Linear, Transfer::Pq];

    #[test]
    fn values_of_8_bit_pictures_are_looked_up_exactly() {
        for transfer in ALL {
            let curve = Curve::new(transfer, 500.0);
            let values: Vec<f32> = (0..=255).map(|i| i as f32 / 255.0).collect();
            let mut row = vec![0.0; values.len()];
            curve.light_of_row(&values, &mut row);
            for (value, in_row) in values.into_iter().zip(row) {
                let exact = curve.light(f64::from(value));
                assert_eq!(curve.light_of_pixel(value).to_bits(), exact.to_bits(), "{value}");
                assert_eq!(in_row.to_bits(), exact.to_bits(), "{value}");
            }
            for value in [0.3, -1.0, 2.0, f32::MIN_POSITIVE] {
                let exact = curve.light(f64::from(value).clamp(0.0, 1.0));
                assert_eq!(curve.light_of_pixel(value).to_bits(), exact.to_bits(), "{value}");
            }
        }
    }

    /// ST 2084: code 0.580689 is 203 cd/m² (ITU-R BT.2408), 0.508078 is 100 cd/m²; on every display that can show it.
    #[test]
    fn pq_codes_are_absolute() {
        for white_cd_m2 in [250.0, 1000.0, 10_000.0] {
            let curve = Curve::new(Transfer::Pq, white_cd_m2);
            for (code, cd_m2) in [(0.580_689, 203.0), (0.508_078, 100.0)] {
                let shown = white_cd_m2 * curve.light(code);
                assert!((shown / cd_m2 - 1.0).abs() < 1e-4, "{white_cd_m2}: {shown}");
            }
        }
        // A screen of 100 cd/m² shows what is brighter as white.
        assert!((Curve::new(Transfer::Pq, 100.0).light(0.7) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn values_are_the_inverse_of_light() {
        for transfer in ALL {
            let curve = Curve::new(transfer, 700.0);
            for light in [0.0, 1e-4, 0.02, 0.5, 1.0] {
                assert!((curve.light(curve.value(light)) - light).abs() < 1e-12, "{transfer:?} {light}");
            }
        }
    }
}
