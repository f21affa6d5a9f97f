//! Light of the pixels of a window, with what is made of it: of a picture that stays on the screen each is made once, however the eye moves.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use rustfft::num_complex::Complex;

use super::grid::Real;
use super::light::Shown;
use crate::display::{Display, Levels};
use crate::video::Picture;

/// Pixel values that are compared together.
const CHUNK: usize = 1024;

/// Relative light of each pixel, `[row][column]`. What is kept with it belongs to one primary of one prepared scene.
#[derive(Debug, Default)]
pub struct PixelLight {
    values: Vec<f64>,
    /// Of the ledger.
    sums: OnceLock<[f64; 3]>,
    /// Sums over blocks of pixels.
    blocks: OnceLock<Vec<f64>>,
    single: OnceLock<Vec<Complex<f32>>>,
    double: OnceLock<Vec<Complex<f64>>>,
}

impl PixelLight {
    /// Of values.
    pub fn new(values: Vec<f64>) -> Arc<Self> {
        Arc::new(Self { values, ..Self::default() })
    }

    /// The ledger's sums.
    pub fn sums(&self, make: impl FnOnce(&[f64]) -> [f64; 3]) -> [f64; 3] {
        *self.sums.get_or_init(|| make(&self.values))
    }

    /// Sums over blocks.
    pub fn blocks(&self, make: impl FnOnce(&[f64]) -> Vec<f64>) -> &[f64] {
        self.blocks.get_or_init(|| make(&self.values))
    }

    /// The spectrum at the kept frequencies.
    pub fn spectrum<T: Real>(&self, make: impl FnOnce(&[f64]) -> Vec<Complex<T>>) -> &[Complex<T>] {
        T::kept(&self.single, &self.double).get_or_init(|| make(&self.values))
    }
}

impl Deref for PixelLight {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.values
    }
}

impl PartialEq for PixelLight {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other) || self.values == other.values
    }
}

/// Whether two pictures are the same to the bit.
fn same_picture(a: &Picture, b: &Picture) -> bool {
    let same = |(a, b): (&[f32], &[f32])| {
        a.iter().zip(b).fold(0, |apart, (a, b)| apart | (a.to_bits() ^ b.to_bits())) == 0
    };
    [a.width, a.height] == [b.width, b.height] && a.rgb.chunks(CHUNK).zip(b.rgb.chunks(CHUNK)).all(same)
}

/// By primary: light of the pictures that are on the screen.
pub type Lights = Arc<Vec<OnceLock<Arc<PixelLight>>>>;

/// The pictures that were shown first, and their light.
#[derive(Clone, Debug, Default)]
pub struct FirstShown(Arc<OnceLock<(Vec<Picture>, Lights)>>);

impl FirstShown {
    /// The light of the pictures that are shown: what is known of it when they are the first ones again.
    pub fn lights(&self, shown: &Shown, display: &Display, primaries: usize) -> Lights {
        let none = || Arc::new((0..primaries).map(|_| OnceLock::new()).collect());
        let dithered = match display.panel.levels {
            Levels::Continuous => false,
            Levels::Values { dither, .. } | Levels::Planes { dither, .. } => dither,
        };
        // The same picture gives other light in the next frame then.
        if dithered {
            return none();
        }
        let keep = || (shown.pictures.iter().map(|picture| (*picture).clone()).collect(), none());
        let (pictures, lights) = self.0.get_or_init(keep);
        let same = pictures.len() == shown.pictures.len()
            && pictures.iter().zip(&shown.pictures).all(|(a, b)| same_picture(a, b));
        if same { Arc::clone(lights) } else { none() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::Panel;

    fn picture(value: f32) -> Picture {
        Picture { width: 2, height: 1, rgb: vec![value; 6] }
    }

    #[test]
    fn light_of_the_first_picture_is_kept() {
        let (white, black) = (picture(1.0), picture(0.0));
        let mut display = Display::for_test();
        let first = FirstShown::default();
        let lights =
            |picture: &Picture, display: &Display| first.lights(&Shown::new(0, picture, &[]), display, 2);
        let kept = lights(&white, &display);
        assert_eq!(kept.len(), 2);
        assert!(Arc::ptr_eq(&kept, &lights(&white.clone(), &display)));
        assert!(!Arc::ptr_eq(&kept, &lights(&black, &display)));
        display.panel = Panel { lag_ms: 0.0, levels: Levels::Values { bits: 6, dither: true } };
        assert!(!Arc::ptr_eq(&kept, &lights(&white, &display)));
    }

    #[test]
    fn what_is_made_of_light_is_made_once() {
        let light = PixelLight::new(vec![1.0, 2.0]);
        let made = |sums: [f64; 3]| sums.map(f64::to_bits) == [1.0, 2.0, 0.0].map(f64::to_bits);
        assert!(made(light.sums(|light| [light[0], light[1], 0.0])));
        assert!(made(light.sums(|_| [9.0; 3])));
        assert!(*light == *PixelLight::new(vec![1.0, 2.0]) && *light != *PixelLight::new(vec![1.0]));
    }
}
