//! The display's light on a lattice of nodes: what a smooth function of the place, integrated over the light,
//! needs of it.
//!
//! The display is cut into leaves of equal sides with n Chebyshev nodes along each axis. Inside a leaf a
//! smooth function is `F(x) ≈ Σ_i F(x_i) l_i(x)`, with the Lagrange polynomials of the nodes, so its integral
//! over light L is `∫ L F ≈ Σ_i F(x_i) ∫ L l_i`. The integrals of l_i over a pixel's rectangles are exact for
//! pixels of any size, smaller or larger than a leaf; rectangles are products, so each axis is done by
//! itself.

use std::ops::Range;

use crate::display::Emitter;
use crate::psf::quadrature::gauss_legendre;

/// Gauss-Hermite rule with five points for a standard normal number: points and weights.
const SPOT: [(f64, f64); 5] = [
    (-2.856_970_013_872_806, 0.011_257_411_327_720_69),
    (-1.355_626_179_974_266, 0.222_075_922_005_612_6),
    (0.0, 0.533_333_333_333_333_3),
    (1.355_626_179_974_266, 0.222_075_922_005_612_6),
    (2.856_970_013_872_806, 0.011_257_411_327_720_69),
];

/// Nodes along one axis.
#[derive(Clone, Debug)]
pub struct Axis {
    first_px: f64,
    leaf_px: f64,
    leaves: usize,
    /// In a leaf, 0 to 1.
    nodes: Vec<f64>,
}

/// What light of one pixel adds to consecutive nodes.
struct Taps {
    first: usize,
    weights: Vec<f64>,
}

/// A rectangle of an emitter.
struct Rect {
    share: f64,
    /// By axis and pixel.
    taps: [Vec<Taps>; 2],
}

/// The nodes of a part of a display.
pub struct Lattice {
    /// Across and down.
    pub axes: [Axis; 2],
    /// Columns and rows of the display that are on it.
    pixels: [Range<u32>; 2],
    /// By emitter.
    rects: Vec<Vec<Rect>>,
}

/// The Lagrange polynomials of nodes.
pub fn lagrange(nodes: &[f64], at: f64, mut put: impl FnMut(usize, f64)) {
    for (i, own) in nodes.iter().enumerate() {
        let others = nodes.iter().enumerate().filter(|(j, _)| *j != i);
        put(i, others.map(|(_, other)| (at - other) / (own - other)).product());
    }
}

/// Chebyshev nodes of 0 to 1.
pub fn chebyshev(count: usize) -> Vec<f64> {
    let at = |i: usize| 0.5 - 0.5 * ((i as f64 + 0.5) * std::f64::consts::PI / count as f64).cos();
    (0..count).map(at).collect()
}

impl Axis {
    /// So many leaves with so many nodes each.
    pub fn new(first_px: f64, leaf_px: f64, leaves: usize, nodes: usize) -> Self {
        Self { first_px, leaf_px, leaves, nodes: chebyshev(nodes) }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.leaves * self.nodes.len()
    }

    /// Place of a node, pixels of the display.
    pub fn at(&self, node: usize) -> f64 {
        let (leaf, own) = (node / self.nodes.len(), node % self.nodes.len());
        self.first_px + self.leaf_px * (leaf as f64 + self.nodes[own])
    }

    /// Nodes of light 1 that is even between two places, a spot's standard deviation wide (pixels).
    fn taps(&self, [from, to]: [f64; 2], spot_sd_px: f64) -> Taps {
        let place = |px: f64| (px - self.first_px) / self.leaf_px;
        let leaf = |place: f64| (place.floor().max(0.0) as usize).min(self.leaves - 1);
        let reach = if spot_sd_px > 0.0 { 3.0 * spot_sd_px } else { 0.0 };
        let (first, last) = (leaf(place(from - reach)), leaf(place(to + reach)));
        let count = self.nodes.len();
        let mut weights = vec![0.0; (last + 1 - first) * count];
        let spots = if spot_sd_px > 0.0 { &SPOT[..] } else { &[(0.0, 1.0)] };
        let rule = gauss_legendre(count);
        for (shift, spot) in spots {
            let [a, b] = [from, to].map(|px| place(px + shift * spot_sd_px));
            let length = (b - a).max(1e-12);
            for own in leaf(a)..=leaf(b) {
                // The ends of the lattice reach on.
                let low = if own == 0 { a } else { a.max(own as f64) };
                let high = if own + 1 == self.leaves { b } else { b.min(own as f64 + 1.0) };
                for (u, w) in &rule {
                    let at = 0.5 * (low + high) + 0.5 * u * (high - low);
                    let weight = spot * 0.5 * w * (high - low).max(1e-12) / length;
                    let start = (own - first) * count;
                    lagrange(&self.nodes, at - own as f64, |i, l| weights[start + i] += weight * l);
                }
            }
        }
        Taps { first: first * count, weights }
    }
}

/// How far emitters' light lies from the corner of a pixel, pixels: least and most along an axis.
pub fn overhang(emitters: &[Emitter], axis: usize) -> [f64; 2] {
    let ends = emitters.iter().flat_map(|emitter| {
        let reach = 3.0 * emitter.spot_sd_px.max(0.0);
        emitter.rects.iter().map(move |(rect, _)| [rect[axis] - reach, rect[axis + 2] + reach])
    });
    ends.fold([0.0, 1.0], |[a, b], [from, to]| [f64::min(a, from), f64::max(b, to)])
}

impl Lattice {
    /// Of some columns and rows of a display.
    pub fn new(axes: [Axis; 2], pixels: [Range<u32>; 2], emitters: &[Emitter]) -> Self {
        let of_rect = |emitter: &Emitter, (rect, share): &([f64; 4], f64)| {
            let along = |axis: usize| {
                let of = |px: u32| {
                    let ends = [rect[axis], rect[axis + 2]].map(|at| f64::from(px) + at);
                    axes[axis].taps(ends, emitter.spot_sd_px)
                };
                pixels[axis].clone().map(of).collect()
            };
            Rect { share: *share, taps: [along(0), along(1)] }
        };
        let rects = emitters.iter().map(|e| e.rects.iter().map(|rect| of_rect(e, rect)).collect()).collect();
        Self { axes, pixels, rects }
    }

    /// Light of the nodes `[row][column]` of an emitter, from that of all pixels of a display
    /// `[row][column]`, `width` in a row.
    pub fn light(&self, emitter: usize, pixels: &[f64], width: usize) -> Vec<f64> {
        let columns = self.axes[0].len();
        let mut nodes = vec![0.0; columns * self.axes[1].len()];
        let mut line = vec![0.0; columns];
        let across = self.pixels[0].start as usize..self.pixels[0].end as usize;
        for Rect { share, taps: [by_column, by_row] } in &self.rects[emitter] {
            for (row, down) in self.pixels[1].clone().zip(by_row) {
                let row = &pixels[row as usize * width..][across.clone()];
                if row.iter().all(|light| *light <= 0.0) {
                    continue;
                }
                line.fill(0.0);
                for (light, taps) in row.iter().zip(by_column) {
                    let to = &mut line[taps.first..][..taps.weights.len()];
                    to.iter_mut().zip(&taps.weights).for_each(|(to, weight)| *to += light * weight);
                }
                for (weight, to) in down.weights.iter().zip(nodes[down.first * columns..].chunks_mut(columns))
                {
                    let weight = share * weight;
                    to.iter_mut().zip(&line).for_each(|(to, light)| *to += weight * light);
                }
            }
        }
        nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{Channel, Waveform};

    /// Cubic functions are integrated exactly over pixels smaller and larger than a leaf; a spot adds its
    /// variance.
    #[test]
    fn polynomials_are_integrated_over_pixels() {
        for (leaf, leaves, spot_sd_px) in [(7.3, 4, 0.0), (0.7, 40, 0.0), (0.7, 60, 0.4)] {
            let emitter = Emitter {
                channel: Channel::White,
                photons: Vec::new(),
                rects: vec![([0.1, 0.2, 0.5, 0.9], 0.4), ([0.6, 0.2, 0.9, 0.9], 0.6)],
                spot_sd_px,
                waveform: Waveform::Steady,
            };
            let axis = || Axis::new(-2.0, leaf, leaves, 4);
            let lattice = Lattice::new([axis(), axis()], [3..8, 2..9], &[emitter]);
            let mut pixels = vec![0.0; 20 * 20];
            pixels[5 * 20 + 6] = 2.0;
            let nodes = lattice.light(0, &pixels, 20);
            let columns = lattice.axes[0].len();
            let place = |i: usize| (lattice.axes[0].at(i % columns), lattice.axes[1].at(i / columns));
            let sum = |f: fn(f64, f64) -> f64| -> f64 {
                nodes.iter().enumerate().map(|(i, light)| light * f(place(i).0, place(i).1)).sum()
            };
            let x: [f64; 2] = [6.3, 6.75];
            assert!((sum(|_, _| 1.0) - 2.0).abs() < 1e-10);
            assert!((sum(|x, _| x) - 2.0 * (0.4 * x[0] + 0.6 * x[1])).abs() < 1e-9);
            let square = |at: f64, side: f64| at * at + side * side / 12.0 + spot_sd_px * spot_sd_px;
            let exact = 2.0 * (0.4 * square(x[0], 0.4) + 0.6 * square(x[1], 0.3)) * 5.55;
            assert!((sum(|x, y| x * x * y) - exact).abs() < 1e-7, "{} {exact}", sum(|x, y| x * x * y));
        }
    }
}
