//! From pixel values to light.
//!
//! sRGB, gamma, BT.1886 and linear values are relative to the display's white. BT.1886 lifts the value by the
//! display's black: `L = (V + β (1 − V))^2.4` with `β = black^(1/2.4)`.
//!
//! PQ codes are absolute (SMPTE ST 2084): a code stands for a luminance whatever the screen,
//! `Y = 10 000 cd/m² · (max(r − c₁, 0)/(c₂ − c₃ r))^(1/m₁)` with `r = V^(1/m₂)`,
//! c = 107/128, 2413/128, 2392/128, m = 2610/16384, 2523/32. What is brighter than the display's white is shown as
//! white, what is darker than its black as black.
//!
//! HLG (ITU-R BT.2100-2) joins the colours: with the light of the scene `E = OETF⁻¹(V + β (1 − V))` the
//! display shows `E Y^(γ − 1)`, `Y = 0.2627 R + 0.6780 G + 0.0593 B` of the scene, and `β =
//! OETF(black^(1/γ))`.

use std::sync::OnceLock;

use multiversion::multiversion;
use serde::{Deserialize, Serialize};

/// From pixel value (0 to 1) to light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Transfer {
    /// IEC 61966-2-1.
    Srgb,
    /// ITU-R BT.1886: the power 2.4 of a value that is lifted by the display's black.
    Bt1886,
    /// The value itself.
    Linear,
    /// SMPTE ST 2084, absolute.
    Pq,
    /// A power.
    Gamma(f64),
    /// Hybrid log-gamma of ITU-R BT.2100 with its system gamma; `None`: that of the display's white.
    Hlg(Option<f64>),
}

/// Luminance of the largest PQ code, cd/m².
const PQ_PEAK_CD_M2: f64 = 10_000.0;
/// Exponent of BT.1886.
const BT1886_GAMMA: f64 = 2.4;
/// Weights of red, green and blue in the luminance of BT.2100.
const BT2100_LUMA: [f64; 3] = [0.2627, 0.6780, 0.0593];
/// a, b, c of the logarithmic part of HLG (BT.2100-2, table 5).
const HLG: [f64; 3] = [0.178_832_77, 0.284_668_92, 0.559_910_73];

/// Pixels of a row from which a table of 256 values is made for it.
const OWN_TABLE_PIXELS: usize = 512;

/// Pixel values of 8-bit pictures with their light.
type Steps = [(f32, f64); 256];

/// A transfer on a display.
#[derive(Clone, Copy, Debug)]
pub struct Curve {
    transfer: Transfer,
    /// Light of the value 1 over the display's white.
    scale: f64,
    /// Light of the display's black over that of its white.
    black: f64,
    /// Pixel value of black that the display's black lifts to: β.
    lift: f64,
    /// System gamma of HLG.
    system_gamma: f64,
}

/// System gamma of HLG on a display whose white has a luminance (cd/m²): BT.2100-2, note 5f, and beyond 400
/// to 2000 cd/m² the extended form of BT.2390.
fn system_gamma(white_cd_m2: f64) -> f64 {
    if (400.0..=2000.0).contains(&white_cd_m2) {
        1.2 + 0.42 * (white_cd_m2 / 1000.0).log10()
    } else {
        1.2 * 1.111_f64.powf((white_cd_m2.clamp(1e-3, 1e7) / 1000.0).log2())
    }
}

/// Light of the scene for a value of HLG.
fn hlg_scene(value: f64) -> f64 {
    let [a, b, c] = HLG;
    if value <= 0.5 { value * value / 3.0 } else { (((value - c) / a).exp() + b) / 12.0 }
}

/// Value of HLG for a light of the scene.
fn hlg_value(scene: f64) -> f64 {
    let [a, b, c] = HLG;
    if scene <= 1.0 / 12.0 { (3.0 * scene).sqrt() } else { a * (12.0 * scene - b).ln() + c }
}

/// Luminance of red, green and blue light of BT.2100.
fn luma(rgb: [f64; 3]) -> f64 {
    BT2100_LUMA.iter().zip(rgb).map(|(weight, light)| weight * light).sum()
}

impl Curve {
    /// The curve of a display whose white has a luminance (cd/m²) and whose black a part of it.
    pub fn new(transfer: Transfer, white_cd_m2: f64, black: f64) -> Self {
        let system_gamma = match transfer {
            Transfer::Hlg(given) => given.unwrap_or_else(|| system_gamma(white_cd_m2)),
            _ => 1.0,
        };
        let scale = match transfer {
            Transfer::Pq => PQ_PEAK_CD_M2 / white_cd_m2.max(f64::MIN_POSITIVE),
            _ => 1.0,
        };
        let lift = match transfer {
            Transfer::Bt1886 if black > 0.0 => black.powf(1.0 / BT1886_GAMMA),
            Transfer::Hlg(_) => hlg_value(black.powf(1.0 / system_gamma)),
            _ => 0.0,
        };
        Self { transfer, scale, black, lift, system_gamma }
    }

    /// Whether the light of a colour depends on the values of the others.
    pub fn joins_colours(self) -> bool {
        matches!(self.transfer, Transfer::Hlg(_))
    }

    /// Light of a pixel value over the display's white, above its black, at most 1; with HLG that of a gray
    /// pixel.
    pub fn light(self, value: f64) -> f64 {
        self.shown(self.transfer.light(self.lifted(value)))
    }

    /// The same for the red, green and blue of a pixel.
    pub fn lights(self, values: [f64; 3]) -> [f64; 3] {
        if !self.joins_colours() {
            return values.map(|value| self.light(value));
        }
        let scene = values.map(|value| self.transfer.light(self.lifted(value)));
        let bright = luma(scene).powf(self.system_gamma - 1.0);
        scene.map(|light| self.above_black(if light > 0.0 { light * bright } else { 0.0 }))
    }

    /// Pixel value of a relative light: the inverse of [`Curve::light`].
    pub fn value(self, light: f64) -> f64 {
        let with_black = self.black + (1.0 - self.black) * light;
        match self.transfer {
            Transfer::Hlg(_) => self.unlifted(self.transfer.value(with_black.powf(1.0 / self.system_gamma))),
            Transfer::Bt1886 => self.unlifted(self.transfer.value(with_black)),
            Transfer::Pq => self.transfer.value(with_black / self.scale),
            Transfer::Srgb | Transfer::Linear | Transfer::Gamma(_) => self.transfer.value(light),
        }
        .clamp(0.0, 1.0)
    }

    /// Pixel values of red, green and blue light: the inverse of [`Curve::lights`].
    pub fn values(self, lights: [f64; 3]) -> [f64; 3] {
        if !self.joins_colours() {
            return lights.map(|light| self.value(light));
        }
        let lights = lights.map(|light| self.black + (1.0 - self.black) * light);
        // The luminance of the display is that of the scene to the power of the system gamma.
        let bright = luma(lights).powf((1.0 - self.system_gamma) / self.system_gamma);
        let scene = lights.map(|light| if light > 0.0 { light * bright } else { 0.0 });
        scene.map(|light| self.unlifted(self.transfer.value(light)).clamp(0.0, 1.0))
    }

    /// As [`Curve::light`] of a clamped value; values of 8-bit pictures are looked up where the curve has no
    /// parameter (the same numbers, ten times as fast).
    pub fn light_of_pixel(self, value: f32) -> f64 {
        match self.steps() {
            Some(steps) => self.shown(self.transfer.light_of_pixel(steps, value)),
            None => self.light(f64::from(value).clamp(0.0, 1.0)),
        }
    }

    /// The same for all pixels of a row.
    pub fn light_of_row(self, values: &[f32], light: &mut [f64]) {
        let is_scaled = match self.steps() {
            Some(steps) if look_up(steps, values, light) => true,
            // For a long row a table of its own is worth its making.
            None if values.len() >= OWN_TABLE_PIXELS && look_up(&self.own_steps(), values, light) => return,
            _ => false,
        };
        if !is_scaled {
            for (light, value) in light.iter_mut().zip(values) {
                *light = self.light_of_pixel(*value);
            }
        } else if self.transfer == Transfer::Pq {
            for light in light.iter_mut() {
                *light = self.shown(*light);
            }
        }
    }

    /// The values of 8-bit pictures with their light on this display.
    fn own_steps(self) -> Steps {
        std::array::from_fn(|i| {
            let value = i as f32 / 255.0;
            (value, self.light(f64::from(value)))
        })
    }

    /// Table of the curve, where it has no parameter of the display but its scale.
    fn steps(self) -> Option<&'static Steps> {
        if self.lift > 0.0 { None } else { self.transfer.steps() }
    }

    /// A value (0 to 1) that is lifted by the display's black.
    fn lifted(self, value: f64) -> f64 {
        if self.lift > 0.0 { value + self.lift * (1.0 - value) } else { value }
    }

    /// The inverse of [`Curve::lifted`].
    fn unlifted(self, value: f64) -> f64 {
        if self.lift < 1.0 { (value - self.lift) / (1.0 - self.lift) } else { 0.0 }
    }

    /// What the display shows of the transfer's own light, above its black.
    fn shown(self, light: f64) -> f64 {
        match self.transfer {
            Transfer::Pq => self.above_black((self.scale * light).min(1.0)),
            Transfer::Hlg(_) => self.above_black(light.powf(self.system_gamma)),
            Transfer::Bt1886 if self.lift > 0.0 => self.above_black(light),
            Transfer::Srgb | Transfer::Bt1886 | Transfer::Linear | Transfer::Gamma(_) => light,
        }
    }

    /// The part of a light (over white) that is above black, over what white is above it.
    fn above_black(self, light: f64) -> f64 {
        if self.black < 1.0 { ((light - self.black) / (1.0 - self.black)).clamp(0.0, 1.0) } else { 0.0 }
    }
}

impl Transfer {
    /// Its name in the schema.
    pub fn name(self) -> &'static str {
        match self {
            Self::Srgb => "SRGB",
            Self::Bt1886 => "BT1886",
            Self::Linear => "LINEAR",
            Self::Pq => "PQ",
            Self::Gamma(_) => "GAMMA",
            Self::Hlg(_) => "HLG",
        }
    }

    /// Light of a pixel value over that of the value 1, of a gray scene with HLG.
    pub(crate) fn light(self, value: f64) -> f64 {
        match self {
            Self::Srgb if value <= 0.04045 => value / 12.92,
            Self::Srgb => ((value + 0.055) / 1.055).powf(2.4),
            Self::Bt1886 => value.powf(BT1886_GAMMA),
            Self::Gamma(exponent) => value.powf(exponent),
            Self::Hlg(_) => hlg_scene(value),
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

    /// The values i/255 with their light, of transfers without a parameter.
    fn steps(self) -> Option<&'static Steps> {
        static TABLES: OnceLock<[Steps; 4]> = OnceLock::new();
        let tables = TABLES.get_or_init(|| {
            [Self::Srgb, Self::Bt1886, Self::Linear, Self::Pq].map(|transfer| {
                std::array::from_fn(|i| {
                    let value = i as f32 / 255.0;
                    (value, transfer.light(f64::from(value)))
                })
            })
        });
        let number = match self {
            Self::Srgb => 0,
            Self::Bt1886 => 1,
            Self::Linear => 2,
            Self::Pq => 3,
            Self::Gamma(_) | Self::Hlg(_) => return None,
        };
        Some(&tables[number])
    }

    /// Pixel value of a relative light: the inverse of [`Transfer::light`].
    pub(crate) fn value(self, light: f64) -> f64 {
        match self {
            Self::Srgb if light <= 0.04045 / 12.92 => light * 12.92,
            Self::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            Self::Bt1886 => light.powf(1.0 / BT1886_GAMMA),
            Self::Gamma(exponent) => light.powf(1.0 / exponent),
            Self::Hlg(_) => hlg_value(light),
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

    const ALL: [Transfer; 7] = [
        Transfer::Srgb,
        Transfer::Bt1886,
        Transfer::Linear,
        Transfer::Pq,
        Transfer::Gamma(2.2),
        Transfer::Hlg(None),
        Transfer::Hlg(Some(1.4)),
    ];

    #[test]
    fn values_of_8_bit_pictures_are_looked_up_exactly() {
        for (transfer, black) in ALL.into_iter().flat_map(|t| [(t, 0.0), (t, 0.002)]) {
            let curve = Curve::new(transfer, 500.0, black);
            let values: Vec<f32> = (0..=767).map(|i| (i & 255) as f32 / 255.0).collect();
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
        for (white_cd_m2, black) in [(250.0, 0.0), (1000.0, 0.0), (10_000.0, 0.0), (1000.0, 0.001)] {
            let curve = Curve::new(Transfer::Pq, white_cd_m2, black);
            for (code, cd_m2) in [(0.580_689, 203.0), (0.508_078, 100.0)] {
                let shown = white_cd_m2 * (black + (1.0 - black) * curve.light(code));
                assert!((shown / cd_m2 - 1.0).abs() < 1e-4, "{white_cd_m2}: {shown}");
            }
        }
        // A screen of 100 cd/m² shows what is brighter as white, one with a black of 1 cd/m² what is darker
        // as black.
        assert!((Curve::new(Transfer::Pq, 100.0, 0.0).light(0.7) - 1.0).abs() < 1e-15);
        assert!(Curve::new(Transfer::Pq, 1000.0, 0.001).light(0.1) <= 0.0);
    }

    /// BT.1886: L = a max(V + b, 0)^2.4 with a = d^2.4 and b = Lb^(1/2.4)/d, d = Lw^(1/2.4) − Lb^(1/2.4).
    #[test]
    fn black_lifts_bt1886() {
        let (white, black) = (100.0_f64, 0.1_f64);
        let root = 1.0 / 2.4;
        let difference = white.powf(root) - black.powf(root);
        let (a, b) = (difference.powf(2.4), black.powf(root) / difference);
        let curve = Curve::new(Transfer::Bt1886, white, black / white);
        for value in [0.0, 0.1, 0.3, 0.7, 1.0] {
            let shown = black + (white - black) * curve.light(value);
            let standard = a * (value + b).powf(2.4);
            assert!((shown / standard - 1.0).abs() < 1e-12, "{value}: {shown}, {standard}");
        }
    }

    /// BT.2100-2 and BT.2408: on 1000 cd/m² HLG 75 % is 203 cd/m², 38 % is 26 cd/m² and 50 % is 50.7; the
    /// system gamma on 400, 1000 and 2000 cd/m² is 1.03, 1.2 and 1.33.
    #[test]
    fn hlg_on_displays() {
        let curve = Curve::new(Transfer::Hlg(None), 1000.0, 0.0);
        // As rounded there.
        for (value, cd_m2, rounded) in
            [(0.75, 203.0, 0.5), (0.38, 26.0, 0.5), (0.5, 50.7, 0.05), (1.0, 1000.0, 0.5)]
        {
            let shown = 1000.0 * curve.light(value);
            assert!((shown - cd_m2).abs() < rounded, "{value}: {shown}");
        }
        for (white_cd_m2, gamma) in [(400.0, 1.0329), (1000.0, 1.2), (2000.0, 1.3264), (4000.0, 1.4812)] {
            assert!((system_gamma(white_cd_m2) - gamma).abs() < 1e-4, "{white_cd_m2}");
        }
        // A red pixel is darker than the red of a white one: 0.2627^0.2.
        let [red, green, blue] = curve.lights([1.0, 0.0, 0.0]);
        assert!((red - 0.2627_f64.powf(0.2)).abs() < 1e-6 && green <= 0.0 && blue <= 0.0, "{red}");
    }

    #[test]
    fn values_are_the_inverse_of_light() {
        for (transfer, black) in ALL.into_iter().flat_map(|t| [(t, 0.0), (t, 0.002)]) {
            let curve = Curve::new(transfer, 700.0, black);
            // The published constants of HLG join its two parts to 1e-8.
            let least = if curve.joins_colours() { 1e-8 } else { 1e-12 };
            for light in [0.0, 1e-4, 0.02, 0.5, 1.0] {
                let back = curve.light(curve.value(light));
                assert!((back - light).abs() < least, "{transfer:?} {light} {back}");
            }
            let colour = [0.4, 0.5, 0.3];
            for (back, light) in curve.lights(curve.values(colour)).into_iter().zip(colour) {
                assert!((back - light).abs() < least, "{transfer:?} {light} {back}");
            }
        }
    }

    /// A display that is black and white at once shows no light above its black.
    #[test]
    fn a_contrast_of_one() {
        for transfer in ALL {
            let curve = Curve::new(transfer, 700.0, 1.0);
            assert!(
                curve.lights([0.3, 1.0, 0.0]).iter().all(|light| (0.0..=1.0).contains(light)),
                "{transfer:?}"
            );
            assert!(
                curve.values([0.3, 1.0, 0.0]).iter().all(|value| (0.0..=1.0).contains(value)),
                "{transfer:?}"
            );
        }
    }
}
