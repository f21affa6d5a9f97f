//! Sums over points that lie between the points of a lattice (non-uniform Fourier transforms, types 1 and 2).
//!
//! φ(z) = exp(β(√(1 − z²) − 1)), |z| ≤ 1, spread over [`WIDTH`] lattice steps (Barnett, Magland & af Klinteberg 2019). A point at
//! x (in steps) counts at lattice point g with φ((x − g)/half width); what is transformed is divided by φ's own transform. Error
//! about 1e-5 over the middle of the part of the other domain that is used, 2e-4 at its edge, where little is.

use super::sincos::sin_cos_turns;
use std::f64::consts::{FRAC_PI_2, PI};

/// Lattice points that one point spreads over, in one dimension.
pub const WIDTH: usize = 6;
/// Period over the part of it that is used.
pub const OVERSAMPLING: f64 = 1.6;

/// Steps of the table for one lattice step; linear between them (error 3e-8).
const STEPS: usize = 2048;

/// φ as a table: entry k·WIDTH + j is its value for the j-th lattice point when the first lies k/STEPS before the edge.
#[derive(Clone, Debug)]
pub struct Gridding {
    table: Vec<[f64; WIDTH]>,
    beta: f64,
}

impl Default for Gridding {
    fn default() -> Self {
        let beta = 0.98 * PI * WIDTH as f64 * (1.0 - 0.5 / OVERSAMPLING);
        let half = 0.5 * WIDTH as f64;
        let value = |steps: f64| {
            let z = steps / half;
            let inside = 1.0 - z * z;
            if inside <= 0.0 { 0.0 } else { (beta * (inside.sqrt() - 1.0)).exp() }
        };
        let row = |k: usize| std::array::from_fn(|j| value(k as f64 / STEPS as f64 + j as f64 - half));
        Self { table: (0..=STEPS).map(row).collect(), beta }
    }
}

impl Gridding {
    /// The first of the [`WIDTH`] lattice points next to x and φ at each.
    pub fn at(&self, x: f64) -> (i64, [f64; WIDTH]) {
        // The first point is the first one not before x − half.
        let edge = x - 0.5 * WIDTH as f64;
        let first = edge.ceil();
        let at = (first - edge) * STEPS as f64;
        let k = (at as usize).min(STEPS - 1);
        let t = at - k as f64;
        let (low, high) = (&self.table[k], &self.table[k + 1]);
        (first as i64, std::array::from_fn(|j| low[j] + t * (high[j] - low[j])))
    }

    /// φ's transform at a frequency in cycles per step: the midpoint rule in the arc sine of z.
    pub fn transform(&self, cycles_per_step: f64) -> f64 {
        const NODES: usize = 64;
        let half = 0.5 * WIDTH as f64;
        let step = PI / NODES as f64;
        (0..NODES)
            .map(|i| {
                let (z, root) = ((i as f64 + 0.5) * step - FRAC_PI_2).sin_cos();
                let (_, cos) = sin_cos_turns(cycles_per_step * half * z);
                (self.beta * (root - 1.0)).exp() * cos * root * half * step
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves summed from the lattice at points between.
    #[test]
    fn waves_are_interpolated() {
        let g = Gridding::default();
        for cycles in [0.0, 0.11, 0.2, 0.25] {
            let correction = g.transform(cycles);
            for i in 0..200 {
                let x = f64::from(i) * 0.0377 + 3.0;
                let (first, weights) = g.at(x);
                let sum: f64 = weights
                    .iter()
                    .enumerate()
                    .map(|(j, w)| w * sin_cos_turns(cycles * (first + j as i64) as f64).1)
                    .sum();
                let error = (sum / correction - sin_cos_turns(cycles * x).1).abs();
                assert!(error < 3e-5, "{cycles} {x}: {error:.1e}");
            }
        }
    }
}
