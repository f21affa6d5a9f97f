//! A point spread as a table to draw from: cells of a window by the alias method (Walker 1977, Vose 1991), a photon evenly inside its
//! cell; beyond the window a tail of density 1/r³, that of a sharp pupil edge on average over rings.
//!
//! # Stability
//! Even jitter blurs by one cell: each cell's mass is sharpened by h²/24·∇² first, which leaves an error of fourth order. A mass that
//! becomes negative by that is 0.

use glam::DVec2;

use crate::psf::{GridAxes, PsfGrid, Wavefront, psf};

/// Samples of a window in the shortest period that the pupil passes.
const PER_PERIOD: f64 = 5.0;
/// Most samples along a side.
const MAX_SAMPLES: usize = 1024;
/// Least half side of a window, µm.
const LEAST_HALF_UM: f64 = 60.0;

/// The table.
pub(super) struct Spread {
    /// By cell: the other cell, and the share of draws that stay, of 2^32.
    alias: Vec<(u32, u32)>,
    samples: usize,
    pitch_um: f64,
    /// Share of the light outside the window.
    tail: f64,
    /// Share of the pupil's light that is accepted (Stiles-Crawford), the whole plane.
    pub(super) accepted: f64,
}

impl Spread {
    /// The table of a wavefront; `spot_um` is the largest distance at which rays land.
    pub(super) fn new(wavefront: &Wavefront, spot_um: f64) -> Self {
        let half_um = LEAST_HALF_UM.max(1.5 * spot_um);
        let widest = wavefront.axes.x_axis.length().max(wavefront.axes.y_axis.length());
        let period_um = wavefront.wavelength_um() / (2.0 * widest);
        let samples = ((2.0 * half_um * PER_PERIOD / period_um).ceil() as usize).clamp(64, MAX_SAMPLES);
        let grid = PsfGrid { axes: GridAxes::Retina, ..PsfGrid::new(samples, half_um) };
        let pitch_um = grid.pitch_um();
        let cell = wavefront.density_per_um2() * pitch_um * pitch_um;
        let values = psf(wavefront, &grid);
        let inside = values.iter().sum::<f64>() * cell;
        let accepted = wavefront.throughput();
        let tail = (1.0 - inside / accepted).clamp(0.0, 1.0);
        Self { alias: alias(&sharpened(&values, samples)), samples, pitch_um, tail, accepted }
    }

    /// Landing offset, µm along x_um and y_um, for 64 random bits and more of them in pairs.
    pub(super) fn draw(&self, bits: u64, mut pair: impl FnMut() -> DVec2) -> DVec2 {
        let uniform = pair();
        if uniform.x < self.tail {
            return self.beyond(pair);
        }
        let cells = self.alias.len() as u64;
        let cell = (((bits >> 32) * cells) >> 32) as usize;
        let (other, stay) = self.alias[cell];
        let cell = if (bits as u32) < stay { cell } else { other as usize };
        let corner = DVec2::new((cell / self.samples) as f64, (cell % self.samples) as f64);
        // The rest of the first number is as good as a new one.
        let jitter = DVec2::new((uniform.x - self.tail) / (1.0 - self.tail), uniform.y);
        (corner + jitter - 0.5 * self.samples as f64) * self.pitch_um
    }

    /// An offset outside the window: density 1/r³ outside the inscribed circle, drawn again while inside the square.
    fn beyond(&self, mut pair: impl FnMut() -> DVec2) -> DVec2 {
        let half = 0.5 * self.samples as f64 * self.pitch_um;
        loop {
            let p = pair();
            let radius = half / (1.0 - p.x);
            let offset = DVec2::from_angle(std::f64::consts::TAU * p.y) * radius;
            if offset.abs().max_element() >= half {
                return offset;
            }
        }
    }
}

/// Values minus h²/24 of their Laplacian (differences of neighbours), at least 0.
fn sharpened(values: &[f64], n: usize) -> Vec<f64> {
    (0..n * n)
        .map(|cell| {
            let (i, j) = (cell / n, cell % n);
            let at = |i: usize, j: usize| values[i.min(n - 1) * n + j.min(n - 1)];
            let around =
                at(i.saturating_sub(1), j) + at(i + 1, j) + at(i, j.saturating_sub(1)) + at(i, j + 1);
            (values[cell] - (around - 4.0 * values[cell]) / 24.0).max(0.0)
        })
        .collect()
}

/// Vose's alias table of masses.
fn alias(mass: &[f64]) -> Vec<(u32, u32)> {
    const WHOLE: f64 = 4_294_967_295.0;
    let total: f64 = mass.iter().sum();
    let scale = if total > 0.0 { mass.len() as f64 / total } else { 0.0 };
    let mut share: Vec<f64> = mass.iter().map(|m| m * scale).collect();
    let mut table: Vec<(u32, u32)> = (0..mass.len() as u32).map(|i| (i, u32::MAX)).collect();
    let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..mass.len()).partition(|&i| share[i] < 1.0);
    while let (Some(low), Some(&high)) = (small.pop(), large.last()) {
        table[low] = (high as u32, (share[low] * WHOLE) as u32);
        share[high] -= 1.0 - share[low];
        if share[high] < 1.0 {
            large.pop();
            small.push(high);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell's share of the draws, summed from the table, is its mass.
    #[test]
    fn the_alias_table_holds_the_masses() {
        let mass: Vec<f64> =
            (0..1000).map(|i| f64::from((i * 7919) % 31) * if i == 17 { 900.0 } else { 1.0 }).collect();
        let total: f64 = mass.iter().sum();
        let mut drawn = vec![0.0; mass.len()];
        for (i, (other, stay)) in alias(&mass).into_iter().enumerate() {
            let stays = f64::from(stay) / 4_294_967_296.0;
            drawn[i] += stays / mass.len() as f64;
            drawn[other as usize] += (1.0 - stays) / mass.len() as f64;
        }
        let worst = mass.iter().zip(&drawn).map(|(m, d)| (m / total - d).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-9, "{worst}");
    }
}
