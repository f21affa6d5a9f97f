//! Light from near by: a convolution on the tile's chart.
//!
//! `V(w) = Σ L(w') S(|w − w'|) χ(|w − w'|)`, χ from 1 to 0 between [`FROM_DEG`] and [`TO_DEG`]
//! ([`near_part`]). The lattice's light is spread on even points by the transpose of cubic interpolation,
//! convolved by Fourier transforms and read by cubics. S is smooth over 0.1°: with points of [`STEP_DEG`]
//! cubics leave 0.3 % of its peak at most (f'''' = 45/(0.1°)⁴, 3/128 f'''' h⁴ an axis and step).

use std::ops::Range;
use std::sync::Arc;

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::angle::Scatter;
use super::chart::{Chart, Points, Screen};
use super::lattice::{Axis, Lattice, overhang};
use crate::display::Emitter;
use crate::exposure::scene::good_size;

/// Where the near part begins to fade, and where it ends, degrees.
pub const FROM_DEG: f64 = 0.75;
pub const TO_DEG: f64 = 2.0;
/// Distance of the points.
const STEP_DEG: f64 = 0.02;
/// Side of the lattice's leaves, and their nodes along a side.
const LEAF_DEG: f64 = 0.06;
const NODES: usize = 4;
/// Most leaves along a side.
const MOST_LEAVES: f64 = 2048.0;

/// χ: the part of the light at an angle that counts as near; smooth to the second degree.
pub fn near_part(theta_deg: f64) -> f64 {
    let t = ((theta_deg - FROM_DEG) / (TO_DEG - FROM_DEG)).clamp(0.0, 1.0);
    1.0 - t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// A node of the lattice on the points.
struct Node {
    /// In the lattice.
    number: u32,
    /// Counted in points.
    at: [f32; 2],
    /// Light that enters the pupil, and the chart's scale.
    factor: f32,
}

/// Convolution of images.
struct Transform {
    size: [usize; 2],
    /// Along rows and columns, forth and back.
    forth: [Arc<dyn Fft<f64>>; 2],
    back: [Arc<dyn Fft<f64>>; 2],
    /// Of the kernel over the number of points, `[column][row]`.
    kernel: Vec<f64>,
}

/// The near light of a tile.
pub struct Near {
    points: Points,
    lattice: Lattice,
    nodes: Vec<Node>,
    transform: Transform,
}

impl Near {
    /// Over receivers in a rectangle of places; `None` where the display is not near.
    pub fn new(
        screen: &Screen,
        (chart, [min, max]): (&Chart, [DVec2; 2]),
        emitters: &[Emitter],
        scatter: &Scatter,
    ) -> Option<Self> {
        let reach = [min - TO_DEG, max + TO_DEG];
        let [from, to] = chart.pixels(screen, reach);
        let hang = [overhang(emitters, 0), overhang(emitters, 1)];
        let pixels = [0, 1].map(|axis| {
            let first = (from[axis] - hang[axis][1]).floor().max(0.0) as u32;
            first..((to[axis] - hang[axis][0]).ceil() as u32).min(screen.size[axis])
        });
        if pixels.iter().any(Range::is_empty) {
            return None;
        }
        let axes = [0, 1].map(|axis| {
            let (a, b) = (f64::from(pixels[axis].start), f64::from(pixels[axis].end - 1));
            let (a, b) = (a + hang[axis][0], b + hang[axis][1]);
            let leaves = ((b - a) / (LEAF_DEG * screen.px_per_deg())).ceil().clamp(1.0, MOST_LEAVES);
            Axis::new(a, (b - a) / leaves, leaves as usize, NODES)
        });
        let lattice = Lattice::new(axes, pixels, emitters);
        // A period as long as the places and the kernel's reach: no copy comes near.
        let points = Points::new(reach, STEP_DEG, good_size);
        let columns = lattice.axes[0].len();
        let node = |i: usize| {
            let px = DVec2::new(lattice.axes[0].at(i % columns), lattice.axes[1].at(i / columns));
            let place = chart.at(screen.way(px));
            points.holds(place).then(|| Node {
                number: i as u32,
                at: points.place(place).as_vec2().to_array(),
                factor: (screen.entering(px) * Chart::scale(place)) as f32,
            })
        };
        let nodes = (0..columns * lattice.axes[1].len()).into_par_iter().filter_map(node).collect();
        let transform = Transform::new(points.size, |distance| {
            let theta = 2.0 * (0.5 * (STEP_DEG * distance).to_radians()).asin().to_degrees();
            if theta < TO_DEG { scatter.per_sr(theta) * near_part(theta) } else { 0.0 }
        });
        Some(Self { points, lattice, nodes, transform })
    }

    /// V of up to two emitters, from the light of all pixels of the display, `width` in a row: as real and
    /// imaginary parts at the points.
    pub fn light(&self, emitters: &[(usize, &[f64])], width: usize) -> Vec<Complex64> {
        let mut image = vec![Complex64::ZERO; self.points.size[0] * self.points.size[1]];
        for (part, (emitter, pixels)) in emitters.iter().enumerate() {
            let light = self.lattice.light(*emitter, pixels, width);
            for node in &self.nodes {
                let light = light[node.number as usize] * f64::from(node.factor);
                if light.abs() <= 0.0 {
                    continue;
                }
                let stencil = self.points.stencil_at(DVec2::from(node.at.map(f64::from)));
                if part == 0 {
                    self.points.spread(&stencil, |at, weight| image[at].re += light * weight);
                } else {
                    self.points.spread(&stencil, |at, weight| image[at].im += light * weight);
                }
            }
        }
        if image.iter().all(|light| light.norm_sqr() <= 0.0) {
            return image;
        }
        self.transform.convolved(image)
    }

    /// V at a place; of the first emitter or of the second.
    pub fn read(&self, image: &[Complex64], place_deg: DVec2, part: usize) -> f64 {
        let stencil = self.points.stencil(place_deg);
        let value = if part == 0 {
            self.points.read(|at| image[at].re, &stencil)
        } else {
            self.points.read(|at| image[at].im, &stencil)
        };
        value * Chart::scale(place_deg)
    }
}

impl Transform {
    /// Of a kernel by the distance in points.
    fn new(size: [usize; 2], kernel: impl Fn(f64) -> f64) -> Self {
        let mut planner = FftPlanner::new();
        let forth = size.map(|n| planner.plan_fft_forward(n));
        let back = size.map(|n| planner.plan_fft_inverse(n));
        let mut made = Self { size, forth, back, kernel: Vec::new() };
        let count = (size[0] * size[1]) as f64;
        let away = |i: usize, n: usize| i.min(n - i) as f64;
        let at = |i: usize| {
            let (x, y) = (away(i % size[0], size[0]), away(i / size[0], size[1]));
            Complex64::new(kernel(x.hypot(y)), 0.0)
        };
        let image = (0..size[0] * size[1]).map(at).collect();
        // An even kernel: its transform is real.
        made.kernel = made.forward(image).into_iter().map(|value| value.re / count).collect();
        made
    }

    /// The transform, `[column][row]`.
    fn forward(&self, mut image: Vec<Complex64>) -> Vec<Complex64> {
        rows(&mut image, self.size[0], &self.forth[0]);
        let mut turned = transposed(&image, self.size[0]);
        rows(&mut turned, self.size[1], &self.forth[1]);
        turned
    }

    /// An image convolved with the kernel; its two parts do not mix, the kernel is real.
    fn convolved(&self, image: Vec<Complex64>) -> Vec<Complex64> {
        let mut turned = self.forward(image);
        turned.iter_mut().zip(&self.kernel).for_each(|(value, kernel)| *value *= kernel);
        rows(&mut turned, self.size[1], &self.back[1]);
        let mut image = transposed(&turned, self.size[1]);
        rows(&mut image, self.size[0], &self.back[0]);
        image
    }
}

/// Transforms all rows.
fn rows(image: &mut [Complex64], width: usize, fft: &Arc<dyn Fft<f64>>) {
    let scratch = || vec![Complex64::ZERO; fft.get_inplace_scratch_len()];
    image.par_chunks_mut(width).for_each_init(scratch, |scratch, row| fft.process_with_scratch(row, scratch));
}

fn transposed(image: &[Complex64], width: usize) -> Vec<Complex64> {
    /// Side of a block that stays at hand.
    const SIDE: usize = 16;
    let height = image.len() / width;
    let mut turned = vec![Complex64::ZERO; image.len()];
    turned.par_chunks_mut(SIDE * height).enumerate().for_each(|(block, turned)| {
        let first = block * SIDE;
        for row in (0..height).step_by(SIDE) {
            for column in first..(first + SIDE).min(width) {
                for row in row..(row + SIDE).min(height) {
                    turned[(column - first) * height + row] = image[row * width + column];
                }
            }
        }
    });
    turned
}
