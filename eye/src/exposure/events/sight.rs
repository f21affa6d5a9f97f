//! Where the line of sight is when a photon leaves, and from which point of its pixel.

use glam::DVec2;

use super::dice::{Words, halves};
use crate::display::Emitter;
use crate::exposure::light::{Course, Segment};
use crate::exposure::source::Layer;
use crate::math;

/// e-folds of the light over a segment below which it is even.
const EVEN: f64 = 1e-9;

/// A layer's segments with their cumulative shares.
pub(super) struct Sight<'a> {
    segments: &'a [Segment],
    until: Vec<f64>,
    /// For parts of time that overlap or take light from each other, which segments cannot be drawn from: the course, and the line of sight
    /// (pixels) at a part of the frame.
    overlapping: Option<(&'a Course, &'a (dyn Fn(f64) -> DVec2 + Sync))>,
}

impl<'a> Sight<'a> {
    /// Of a layer; `sight` gives the line of sight at a part of the frame.
    pub(super) fn new(layer: &'a Layer, sight: &'a (dyn Fn(f64) -> DVec2 + Sync)) -> Self {
        let segments = layer.segments.as_slice();
        let mut sum = 0.0;
        let tangled = |course: &&Course| {
            course.parts.iter().any(|part| part.share < 0.0)
                || course.parts.windows(2).any(|pair| pair[1].start < pair[0].end - 1e-12)
        };
        let overlapping = layer.course.as_ref().filter(tangled).map(|course| (course, sight));
        let until = segments.iter().map(|segment| {
            sum += segment.share;
            sum
        });
        Self { until: until.collect(), segments, overlapping }
    }

    /// Light of the layer over the frame.
    pub(super) fn share(&self) -> f64 {
        self.until.last().copied().unwrap_or(0.0)
    }

    /// Least and most of the line of sight, pixels from the gaze centre.
    pub(super) fn bounds(&self) -> [DVec2; 2] {
        let (low, high) = crate::exposure::bounds(self.segments.iter().flat_map(|s| s.sight));
        [low, high]
    }

    /// Where the line of sight goes evenly from and to while the light is even, if it does.
    pub(super) fn line(&self) -> Option<[DVec2; 2]> {
        let [low, high] = self.bounds();
        match self.segments {
            _ if low == high => Some([low, low]),
            [one] if one.decay < EVEN && self.overlapping.is_none() => Some(one.sight),
            _ => None,
        }
    }

    /// The line of sight for a uniform number: the inverse of the light's distribution in time.
    pub(super) fn at(&self, uniform: f64) -> DVec2 {
        if let Some((course, sight)) = self.overlapping {
            return sight(course.time(uniform));
        }
        let wanted = uniform * self.share();
        let number = match self.segments.len() {
            1 => 0,
            many => self.until[..many - 1].partition_point(|until| *until <= wanted),
        };
        let Segment { share, decay, sight } = self.segments[number];
        let from = self.until[number] - share;
        let u = if share > 0.0 { ((wanted - from) / share).clamp(0.0, 1.0) } else { 0.5 };
        // The light falls as e^{-decay x}.
        let x = if decay < EVEN { u } else { -math::ln(1.0 + u * (math::exp(-decay) - 1.0)) / decay };
        sight[0] + (sight[1] - sight[0]) * x
    }
}

/// A point of the emitter's rectangles and spot, pixel units, for the bits of a photon's place.
pub(super) fn place(emitter: &Emitter, bits: u32, words: Words, photon: u64) -> DVec2 {
    let within = DVec2::from_array(halves(bits).map(|half| (f64::from(half) + 0.5) / 65_536.0));
    let [x0, y0, x1, y1] = match emitter.rects.as_slice() {
        [(rect, _)] => *rect,
        _ => emitter.rect(words.more(photon, 1).pair().x),
    };
    let place = DVec2::new(x0, y0) + DVec2::new(x1 - x0, y1 - y0) * within;
    if emitter.spot_sd_px <= 0.0 {
        return place;
    }
    let pair = words.more(photon, 2).pair();
    let radius = emitter.spot_sd_px * (-2.0 * math::ln(1.0 - pair.x)).sqrt();
    place + math::unit(std::f64::consts::TAU * pair.y) * radius
}
