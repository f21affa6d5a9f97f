//! What the cones of a tile see as the eye turns: places of the screen that move apart, and another brightness.
//!
//! All cones of a tile share one movement of the picture, that of the tile's middle ([`crate::movement`]). As the eye
//! turns before a screen that stays, places beside the middle move by more or less: before a flat screen a place at
//! the angle θ by 1/cos²θ of the turn. [`Turn`] is the difference for a frame, taken at the middle of the frame: a
//! polynomial over the tile, by which `expected` displaces the apertures of cones on the screen, and the other engines
//! the pixels. The light of a place changes by the screen's emission law and its distance.
//!
//! What is left is that PSFs keep the size on the screen that they have at rest ([`Turning::stretch`]).

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::cones::{ConeTable, MappedCone, entering};
use super::nodes::{chebyshev, lagrange};
use super::scene::Scene;
use crate::display::EmissionLaw;
use crate::movement::Gaze;
use crate::optics::{BeamField, Projection};

/// Nodes along each side of a tile.
const NODES: usize = 5;
/// Part of a picture's light per cone that a displacement by the shortest period moves, about: squares of one or two
/// pixels.
const MOVED: f64 = 0.6;

/// Most frames at which the stretch is looked at.
const FRAMES: u32 = 64;

/// The places of a tile as the eye turns.
#[derive(Debug)]
pub struct Turning {
    law: EmissionLaw,
    middle: Gaze,
    /// Nodes along both axes of the tile, pixels of the window, and the movement as each sees it, `[y][x]`.
    axes: [Vec<f64>; 2],
    places: Vec<Gaze>,
    tangent_per_px: f64,
    frames: u32,
    frame_s: f64,
    /// Steps of the turn that are not told apart, radians.
    step: f64,
}

/// The places of a tile in one frame.
#[derive(Clone, Debug)]
pub struct Turn {
    axes: [Vec<f64>; 2],
    /// By node: displacement beyond the middle's, pixels, and light over that at rest.
    nodes: Vec<(DVec2, f64)>,
}

/// How a place of the window is seen in a frame.
#[derive(Clone, Copy, Debug)]
pub struct Displaced {
    /// From the place at rest that sees it, pixels.
    pub apart: DVec2,
    /// Its light over that at rest.
    pub light: f64,
    /// A step on the screen at rest from a step beside it on the screen.
    pub stretch: DMat2,
}

impl Displaced {
    /// Of an eye that rests.
    pub const AT_REST: Self = Self { apart: DVec2::ZERO, light: 1.0, stretch: DMat2::IDENTITY };
}

impl Turning {
    /// The places of a scene's cones; `None` where the eye rests.
    pub fn new(
        projection: &Projection,
        scene: &Scene,
        (middle, law): (&Gaze, EmissionLaw),
        [frames, frame_rate_hz]: [f64; 2],
    ) -> Option<Self> {
        if middle.is_still() {
            return None;
        }
        let [min, max] = scene.cones_px;
        let axes = [chebyshev(min.x, max.x, NODES), chebyshev(min.y, max.y, NODES)];
        let at = |x: f64, y: f64| middle.seen_along(projection.line_to(scene.tangent(DVec2::new(x, y))));
        let places = axes[1].iter().flat_map(|y| axes[0].iter().map(move |x| (*x, *y)));
        let places = places.map(|(x, y)| at(x, y)).collect();
        let tangent_per_px = scene.tangent_per_px;
        let (frames, frame_s) = (frames as u32, 1.0 / frame_rate_hz);
        Some(Self { law, middle: middle.clone(), axes, places, tangent_per_px, frames, frame_s, step: 0.0 })
    }

    /// The same only where it changes means by more than `tolerance`, of a picture that holds frequencies up to
    /// `band` (cycles per unit of the screen).
    pub fn if_noticeable(mut self, band: f64, tolerance: f64) -> Option<Self> {
        let effect = self.effect(band);
        let largest = self.middle.rectangle().iter().map(|turn| turn.length()).fold(0.0, f64::max);
        // What a turn changes is in proportion to it; half a step along both axes is the farthest.
        self.step = 2.0_f64.sqrt() * tolerance * largest / effect.max(f64::MIN_POSITIVE);
        (effect > tolerance).then_some(self)
    }

    /// How much means change at most where one movement stands for a whole tile, of a picture that holds frequencies
    /// up to `band` (cycles per unit of the screen).
    pub fn effect(&self, band: f64) -> f64 {
        let apart =
            self.places.iter().map(|place| place.largest_difference(&self.middle)).fold(0.0, f64::max);
        let light = |turn: &DVec2| {
            self.places.iter().map(|place| (place.light(self.law, *turn) - 1.0).abs()).fold(0.0, f64::max)
        };
        let light = self.middle.rectangle().iter().map(light).fold(0.0, f64::max);
        MOVED * band * apart + light
    }

    /// Largest relative change over the tile of the size that a place of the retina has on the screen, mean over the
    /// frames (some of them where there are many).
    pub fn stretch(&self) -> f64 {
        let looked_at = self.frames.clamp(1, FRAMES);
        let index = |k: u32| (u64::from(k) * u64::from(self.frames) / u64::from(looked_at)) as u32;
        let sum: f64 = (0..looked_at).map(|k| self.stretch_in(&self.in_frame(index(k)))).sum();
        sum / f64::from(looked_at)
    }

    fn stretch_in(&self, turn: &Turn) -> f64 {
        let step = |axis: usize, at: usize| self.axes[axis][at + 1] - self.axes[axis][at];
        let cells = (0..NODES - 1).flat_map(|row| (0..NODES - 1).map(move |column| (row, column)));
        let of_cell = |(row, column): (usize, usize)| {
            let at = |dx: usize, dy: usize| turn.nodes[(row + dy) * NODES + column + dx].0;
            let by_x = (at(1, 0) - at(0, 0)) / step(0, column);
            let by_y = (at(0, 1) - at(0, 0)) / step(1, row);
            by_x.length().max(by_y.length())
        };
        cells.map(of_cell).fold(0.0, f64::max)
    }

    /// The turn in a frame in whole steps that change means by less than the tolerance.
    pub fn steps_in_frame(&self, index: u32) -> [i64; 2] {
        let turn = self.middle.turn((f64::from(index) + 0.5) * self.frame_s);
        (turn / self.step).round().to_array().map(|steps| steps as i64)
    }

    /// The places after a turn in whole steps.
    pub fn after_steps(&self, steps: [i64; 2]) -> Turn {
        self.turned(self.step * DVec2::from_array(steps.map(|n| n as f64)))
    }

    /// The places in a frame.
    pub fn in_frame(&self, index: u32) -> Turn {
        self.turned(self.middle.turn((f64::from(index) + 0.5) * self.frame_s))
    }

    fn turned(&self, turn: DVec2) -> Turn {
        let all = self.middle.moved_by(turn);
        let node = |place: &Gaze| {
            let apart = (place.moved_by(turn) - all) / self.tangent_per_px;
            (DVec2::new(apart.x, -apart.y), place.light(self.law, turn))
        };
        Turn { axes: self.axes.clone(), nodes: self.places.iter().map(node).collect() }
    }
}

impl Turn {
    /// Displacement of a place of the window (pixels) beyond the middle's, and its light over that at rest.
    pub fn at(&self, px: DVec2) -> (DVec2, f64) {
        // Far from the tile the polynomials would run away; nothing there is seen.
        let [x, y] = [0, 1].map(|axis| {
            let (first, last) = (self.axes[axis][0], self.axes[axis][NODES - 1]);
            px[axis].clamp(first - 0.5 * (last - first), last + 0.5 * (last - first))
        });
        let (across, down) = (lagrange(&self.axes[0], x), lagrange(&self.axes[1], y));
        let weights = down.iter().flat_map(|v| across.iter().map(move |u| u * v));
        weights
            .zip(&self.nodes)
            .fold((DVec2::ZERO, 0.0), |(shift, light), (w, node)| (shift + w * node.0, light + w * node.1))
    }

    /// For a place of the window from which light comes (pixels, the middle's movement taken off): how it is seen.
    pub fn source(&self, px: DVec2) -> Displaced {
        let at = |px: DVec2| {
            let mut seen = self.at(px);
            // The displacement changes by some per cent of the distance: two steps are exact to 1e-5 of it.
            for _ in 0..2 {
                seen = self.at(px - seen.0);
            }
            seen
        };
        let (apart, light) = at(px);
        let by = |axis: DVec2| axis - (at(px + axis).0 - apart);
        Displaced { apart, light, stretch: DMat2::from_cols(by(DVec2::X), by(DVec2::Y)) }
    }

    /// The same for a pixel's middle, and the light that enters the pupil from there, relative to a point at
    /// the nominal distance that faces the eye.
    pub fn entering(
        &self,
        middle_px: DVec2,
        scene: &Scene,
        (law, beams): (EmissionLaw, &BeamField),
    ) -> (Displaced, f64) {
        let displaced = self.source(middle_px);
        // The pupil is that of the place at rest, the emission that of the turned eye.
        let at_rest = scene.tangent(middle_px - displaced.apart);
        (displaced, displaced.light * entering(law, beams, at_rest))
    }

    /// The cones as they see the screen, and the light of each over that at rest.
    pub fn cones(&self, table: &ConeTable) -> (ConeTable, Vec<f64>) {
        let moved = |cone: &MappedCone| {
            let corners = &cone.polygon_px;
            let centre = corners.iter().sum::<DVec2>() / corners.len().max(1) as f64;
            let (shift, light) = self.at(centre);
            // Inside a cone the displacement is straight.
            let by = |axis: DVec2| self.at(centre + axis).0 - shift;
            let slope = DMat2::from_cols(by(DVec2::X), by(DVec2::Y));
            let polygon_px = corners.iter().map(|c| *c + shift + slope * (*c - centre)).collect();
            (MappedCone { polygon_px, ..cone.clone() }, light)
        };
        let (cones, light) = table.cones.par_iter().map(moved).unzip();
        (ConeTable { cones }, light)
    }
}
