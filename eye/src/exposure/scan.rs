//! Layers of a scanned screen before a moving eye: each pixel shines in its turn, so the picture is sheared and stretched.
//!
//! The turns of the window's pixels are cut into equal steps; a pixel between two of them is shared between both, by linear weights, so that
//! the middle of its light is exact and what is added is a blur of at most half a step of movement. Steps are so short that a frequency ν at
//! the end of the band turns by at most [`TURN`] = 2πν·step: it then loses up to TURN²/8, a frequency of a third of it 0.35 %. No more
//! steps are taken than the window has rows (or pixels, when those of a row have turns of their own), nor than fit in [`MAX_VALUES`] numbers.

use glam::DVec2;

use super::light::{Segment, Shown, courses_at, light};
use super::pixel_light::PixelLight;
use super::scene::Scene;
use super::source::{Layer, Projector};
use crate::display::{Emitter, Scan};

/// Largest turn in a step, radians.
const TURN: f64 = 0.5;
/// What a frequency of a third of the band loses.
pub const SCAN_BLUR: f64 = TURN * TURN / 8.0 / 9.0;
/// Most steps.
const MAX_STEPS: usize = 256;
/// Most numbers that the layers of one primary may hold.
const MAX_VALUES: usize = 16_000_000;

/// The layers of a primary; `photons` is what a pixel at full drive sends into the pupil.
pub fn layers(
    projector: &Projector,
    (emitter, scan): (&Emitter, &Scan),
    shown: &Shown,
    scene: &Scene,
    photons: f64,
) -> Vec<Layer> {
    let display = &projector.display;
    let [width, height] = scene.size_px;
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let [first, top] = scene.first_px;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| [first + column, top + row]));
    let turns: Vec<([u32; 2], f64)> = pixels.map(|at| (at, scan.delay(display, at))).collect();
    let (from, to) =
        turns.iter().fold((f64::MAX, f64::MIN), |(from, to), (_, turn)| (from.min(*turn), to.max(*turn)));
    let frame_s = 1.0 / display.frame_rate_hz;
    let turns_apart = if scan.line > 0.0 { width * height } else { height };
    let steps = steps(projector, shown.index, scene, to - from).min(turns_apart as usize - 1).max(1);
    let step = ((to - from) / steps as f64).max(1e-12);
    let mut layers = Vec::new();
    for k in 0..=steps {
        let turn = from + step * k as f64;
        for course in courses_at(emitter, display, shown.index, turn) {
            let of_pixel = |(at, own): &([u32; 2], f64)| {
                let weight = 1.0 - ((own - turn) / step).abs();
                if weight <= 0.0 {
                    return 0.0;
                }
                weight * light(display, emitter, course.shows, shown, *at)
            };
            let segments: Vec<Segment> =
                course.segments(&projector.gaze, shown.index, frame_s, scene.tangent_per_px);
            let light = PixelLight::new(turns.iter().map(of_pixel).collect());
            layers.push(Layer { light, photons, segments, course: Some(course) });
        }
    }
    layers.retain(Layer::is_lit);
    layers
}

/// Number of steps for turns over a part of the frame.
fn steps(projector: &Projector, index: u32, scene: &Scene, span: f64) -> usize {
    let seconds = 1.0 / projector.display.frame_rate_hz;
    let start_s = f64::from(index) * seconds;
    let path = projector.gaze.path(start_s, start_s + seconds);
    let speed = |pair: &[(f64, DVec2)]| {
        (pair[1].1 - pair[0].1).length() / (pair[1].0 - pair[0].0).max(f64::MIN_POSITIVE)
    };
    let moved = path.windows(2).map(speed).fold(0.0, f64::max) * seconds * span;
    let needed = (std::f64::consts::TAU * scene.band * moved / TURN).ceil();
    let pixels = scene.size_px.map(|s| s as usize);
    (needed as usize).clamp(1, MAX_STEPS.min(MAX_VALUES / (pixels[0] * pixels[1])).max(1))
}
