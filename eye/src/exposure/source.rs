//! What the display sends in one frame, for the window of a scene.

use std::sync::Arc;

use glam::DVec2;
use rustfft::num_complex::Complex64;

use super::light::{Course, Segment, Shown, Shows, Window, courses, share_of_now};
use super::pixel_light::{FirstShown, PixelLight};
use super::scene::Scene;
use crate::display::{Display, Emitter};
use crate::movement::Gaze;

/// One primary in one frame: layers of light.
#[derive(Clone, Debug, PartialEq)]
pub struct SourcePrimary {
    /// The layers.
    pub layers: Vec<Layer>,
}

/// Light with a common course in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Relative light of each pixel of the window, `[row][column]`.
    pub light: Arc<PixelLight>,
    /// Mean photons into the pupil from a pixel whose light is 1, as if it were at the gaze centre.
    pub photons: f64,
    /// Where the line of sight is meanwhile.
    pub segments: Vec<Segment>,
    /// When its photons leave; `None` for light of several courses together.
    pub course: Option<Course>,
}

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// The primaries.
    pub primaries: Vec<SourcePrimary>,
    /// Whether the window is the whole display.
    pub covers_display: bool,
}

/// What does not change between frames.
#[derive(Clone, Debug)]
pub struct Projector {
    /// The display.
    pub display: Display,
    /// Its emitters.
    pub emitters: Vec<Emitter>,
    /// Share of a pixel's photons that meets the pupil at the gaze centre.
    pub pupil_share: f64,
    /// Eye movement.
    pub gaze: Gaze,
    /// Whether the course of light inside a frame is left out: the eye does not move.
    pub timeless: bool,
    /// Pictures that stay need not be looked up again.
    pub first_shown: FirstShown,
}

impl Projector {
    fn is_whole(&self, scene: &Scene) -> bool {
        scene.size_px == [self.display.width_px, self.display.height_px]
    }

    /// The light of a frame.
    pub fn frame(&self, shown: &Shown, scene: &Scene) -> Source {
        self.layers(shown, scene, self.timeless)
    }

    /// The light of a frame, each course in a layer of its own even when the eye rests.
    pub fn frame_in_time(&self, shown: &Shown, scene: &Scene) -> Source {
        self.layers(shown, scene, false)
    }

    fn layers(&self, shown: &Shown, scene: &Scene, together: bool) -> Source {
        let seconds = 1.0 / self.display.frame_rate_hz;
        let window = Window { first: scene.first_px, size: scene.size_px };
        let lights = self.first_shown.lights(shown, &self.display, self.emitters.len());
        let primary = |(number, emitter): (usize, &Emitter)| {
            let now = || {
                let make = || PixelLight::new(window.light(&self.display, emitter, Shows::Now, shown));
                Arc::clone(lights[number].get_or_init(make))
            };
            let courses = courses(emitter, &self.display, shown.index);
            let photons = emitter.emitted() * self.pupil_share;
            if together {
                // The order of light does not matter: one layer.
                let (share, light) = match share_of_now(&courses) {
                    Some(share) => (share, now()),
                    None => {
                        (1.0, PixelLight::new(window.frame_light(&self.display, emitter, &courses, shown)))
                    }
                };
                let photons = share * photons;
                let rest = Segment { share: 1.0, decay: 0.0, sight: [DVec2::ZERO; 2] };
                let layer = Layer { light, photons, segments: vec![rest], course: None };
                return SourcePrimary { layers: vec![layer] };
            }
            if let Some(scan) = emitter.waveform.scan() {
                let layers = super::scan::layers(self, (emitter, scan), shown, scene, photons);
                return SourcePrimary { layers };
            }
            let layer = |course: &Course| {
                let light = match course.shows {
                    Shows::Now => now(),
                    shows => PixelLight::new(window.light(&self.display, emitter, shows, shown)),
                };
                let segments = course.segments(&self.gaze, shown.index, seconds, scene.tangent_per_px);
                Layer { light, photons, segments, course: Some(course.clone()) }
            };
            SourcePrimary { layers: courses.iter().map(layer).filter(Layer::is_lit).collect() }
        };
        Source {
            primaries: self.emitters.iter().enumerate().map(primary).collect(),
            covers_display: self.is_whole(scene),
        }
    }
}

impl Source {
    /// Whether the window has no light.
    pub fn is_dark(&self) -> bool {
        self.primaries.iter().flat_map(|p| &p.layers).all(|layer| !layer.is_lit())
    }
}

impl Layer {
    /// Whether it has any light.
    pub fn is_lit(&self) -> bool {
        self.photons > 0.0 && !self.segments.is_empty() && self.light.iter().any(|l| *l > 0.0)
    }

    /// Mean photons of the whole frame for a light of 1.
    pub fn sent(&self) -> f64 {
        self.photons * self.segments.iter().map(|segment| segment.share).sum::<f64>()
    }

    /// Whether the line of sight stays where it is at rest.
    pub fn is_at_rest(&self) -> bool {
        matches!(self.segments.as_slice(), [one] if one.share.to_bits() == 1.0_f64.to_bits() && one.sight == [DVec2::ZERO; 2])
    }
}

/// Transform of a pixel's rectangles, blurred by its spot, at cycles per pixel (y down): 1 at 0.
pub fn pixel_transform(emitter: &Emitter, cycles: DVec2) -> Complex64 {
    let mut pixel = rects_transform(&emitter.rects, cycles);
    if emitter.spot_sd_px > 0.0 {
        pixel *=
            (-0.5 * (std::f64::consts::TAU * emitter.spot_sd_px).powi(2) * cycles.length_squared()).exp();
    }
    pixel
}

fn rects_transform(rects: &[([f64; 4], f64)], cycles: DVec2) -> Complex64 {
    let mut pixel = Complex64::ZERO;
    for ([x0, y0, x1, y1], share) in rects {
        let centre = DVec2::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let size = sinc(cycles.x * (x1 - x0)) * sinc(cycles.y * (y1 - y0));
        pixel += Complex64::from_polar(share * size, -std::f64::consts::TAU * cycles.dot(centre));
    }
    pixel
}

/// sin(πx)/(πx), an even function; its sign is kept by `from_polar` as a turn of π.
pub fn sinc(x: f64) -> f64 {
    let y = std::f64::consts::PI * x;
    if y.abs() < 1e-4 { 1.0 - y * y / 6.0 } else { y.sin() / y }
}

#[cfg(test)]
mod tests {
    use super::super::light::movement;
    use super::*;

    /// The transform against a direct sum over the rectangle and the movement.
    #[test]
    fn transform_matches_the_integral() {
        let segment =
            Segment { share: 1.0, decay: 0.0, sight: [DVec2::new(0.3, -0.1), DVec2::new(1.1, 0.4)] };
        let cycles = DVec2::new(0.7, -1.3);
        let n = 60;
        let mut sum = Complex64::ZERO;
        for i in 0..n {
            for j in 0..n {
                for k in 0..n {
                    let unit = |v: usize| (v as f64 + 0.5) / f64::from(n as u32);
                    let point = DVec2::new(0.1 + 0.5 * unit(i), 0.2 + 0.7 * unit(j));
                    let seen = point - segment.sight[0].lerp(segment.sight[1], unit(k));
                    sum += Complex64::cis(-std::f64::consts::TAU * cycles.dot(seen));
                }
            }
        }
        assert!(
            (sum / (n * n * n) as f64
                - rects_transform(&[([0.1, 0.2, 0.6, 0.9], 1.0)], cycles) * movement(&[segment], cycles))
            .norm()
                < 2e-3
        );
    }
}
