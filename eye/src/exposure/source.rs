//! What the display sends in one frame, for the window of a scene.

use glam::DVec2;
use rustfft::num_complex::Complex64;

use super::scene::Scene;
use crate::display::{Channel, Display, Emitter};
use crate::movement::Gaze;
use crate::video::Picture;

/// One primary in one frame.
#[derive(Clone, Debug)]
pub struct SourcePrimary {
    /// Mean photons into the pupil from each pixel of the window during the frame (as if all were at the gaze centre),
    /// `[row][column]`.
    pub light: Vec<f64>,
    /// Where the line of sight is when the light goes on and off, pixels (x right, y down) from the gaze centre.
    pub sight: [DVec2; 2],
}

/// One frame.
#[derive(Clone, Debug)]
pub struct Source {
    /// The primaries.
    pub primaries: Vec<SourcePrimary>,
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
}

/// Relative light (0 to 1) of a pixel in a channel.
pub fn relative_light(display: &Display, channel: Channel, rgb: &[f32]) -> f64 {
    let light = |i: usize| display.transfer.light(f64::from(rgb[i]).clamp(0.0, 1.0));
    match channel {
        Channel::Red => light(0),
        Channel::Green => light(1),
        Channel::Blue => light(2),
        Channel::White => (light(0) + light(1) + light(2)) / 3.0,
    }
}

impl Projector {
    /// Relative light `[row][column]` of one emitter over the window.
    pub fn drive(&self, emitter: &Emitter, picture: &Picture, scene: &Scene) -> Vec<f64> {
        let [width, height] = scene.size_px;
        let mut light = Vec::with_capacity((width * height) as usize);
        for row in 0..height {
            for column in 0..width {
                let at =
                    3 * ((scene.first_px[1] + row) * picture.width + scene.first_px[0] + column) as usize;
                light.push(relative_light(&self.display, emitter.channel, &picture.rgb[at..at + 3]));
            }
        }
        light
    }

    /// The light of frame `index`.
    pub fn frame(&self, index: u32, picture: &Picture, scene: &Scene) -> Source {
        let seconds = 1.0 / self.display.frame_rate_hz;
        let primaries = self
            .emitters
            .iter()
            .map(|emitter| {
                let photons = emitter.emitted() * self.pupil_share;
                let sight = emitter.lit.map(|part| {
                    let at =
                        self.gaze.screen_tangent((f64::from(index) + part) * seconds) / scene.tangent_per_px;
                    DVec2::new(at.x, -at.y)
                });
                let light = self.drive(emitter, picture, scene).into_iter().map(|v| v * photons).collect();
                SourcePrimary { light, sight }
            })
            .collect();
        Source { primaries }
    }
}

impl SourcePrimary {
    /// Transform of the movement at cycles per pixel (y down): 1 at 0. A pixel at p is seen at p - sight, evenly between the two
    /// positions.
    pub fn movement(&self, cycles: DVec2) -> Complex64 {
        let [from, to] = self.sight;
        if from == DVec2::ZERO && to == DVec2::ZERO {
            return Complex64::ONE;
        }
        let middle = std::f64::consts::TAU * cycles.dot(0.5 * (from + to));
        Complex64::from_polar(sinc(cycles.dot(to - from)), middle)
    }
}

/// Transform of a pixel's rectangles at cycles per pixel (y down): 1 at 0.
pub fn pixel_transform(rects: &[([f64; 4], f64)], cycles: DVec2) -> Complex64 {
    let mut pixel = Complex64::ZERO;
    for ([x0, y0, x1, y1], share) in rects {
        let centre = DVec2::new(0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let size = sinc(cycles.x * (x1 - x0)) * sinc(cycles.y * (y1 - y0));
        pixel += Complex64::from_polar(share * size, -std::f64::consts::TAU * cycles.dot(centre));
    }
    pixel
}

/// sin(πx)/(πx), an even function; its sign is kept by `from_polar` as a turn of π.
fn sinc(x: f64) -> f64 {
    let y = std::f64::consts::PI * x;
    if y.abs() < 1e-4 { 1.0 - y * y / 6.0 } else { y.sin() / y }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The transform against a direct sum over the rectangle and the movement.
    #[test]
    fn transform_matches_the_integral() {
        let primary =
            SourcePrimary { light: Vec::new(), sight: [DVec2::new(0.3, -0.1), DVec2::new(1.1, 0.4)] };
        let cycles = DVec2::new(0.7, -1.3);
        let n = 60;
        let mut sum = Complex64::ZERO;
        for i in 0..n {
            for j in 0..n {
                for k in 0..n {
                    let unit = |v: usize| (v as f64 + 0.5) / f64::from(n as u32);
                    let point = DVec2::new(0.1 + 0.5 * unit(i), 0.2 + 0.7 * unit(j));
                    let seen = point - primary.sight[0].lerp(primary.sight[1], unit(k));
                    sum += Complex64::cis(-std::f64::consts::TAU * cycles.dot(seen));
                }
            }
        }
        assert!(
            (sum / (n * n * n) as f64
                - pixel_transform(&[([0.1, 0.2, 0.6, 0.9], 1.0)], cycles) * primary.movement(cycles))
            .norm()
                < 2e-3
        );
    }
}
