//! A point spread as a table to draw from: cells of a window by the alias method (Walker 1977, Vose 1991), a photon evenly inside its
//! cell; beyond the window a tail of density 1/r³, that of a sharp pupil edge on average over rings.
//!
//! The cells are in two tables: a small square core with nearly all light, which stays in the cache, and the rest of the window. The core's
//! first cell stands for all that is outside the core; its own light is in the rest.
//!
//! # Stability
//! Even jitter blurs by one cell: each cell's mass is sharpened by h²/24·∇² first, which leaves an error of fourth order. A mass that
//! becomes negative by that is 0. Core shares are kept in 16 bits: together they are off by less than 1e-5 of the light.

use glam::DVec2;

use super::dice::{Dice, above};
use crate::math;
use crate::psf::{GridAxes, PsfGrid, Wavefront, psf};

/// Samples of a window in the shortest period that the pupil passes.
const PER_PERIOD: f64 = 3.5;
/// Most samples along a side.
const MAX_SAMPLES: usize = 1024;
/// Least half side of a window, µm.
const LEAST_HALF_UM: f64 = 60.0;

/// Sides of the core, cells; the smallest that holds this share of the window's light, or the last.
const CORE_BITS: [u32; 3] = [5, 6, 7];
const CORE_SHARE: f64 = 0.95;

/// The cell of a core that stands for all light outside it.
pub(super) const OUTSIDE: u32 = 0;

/// In place of a cell's number: outside the window.
const BEYOND: u32 = u32::MAX;

/// A photon outside the core.
pub(super) struct Outside {
    /// The cell of the window.
    cell: u32,
    /// What is left of its random bits.
    dice: Dice,
}

/// The table.
pub(super) struct Spread {
    /// By cell of the core: below, the other cell; above, the share of draws that stay, of 2^16.
    core: Vec<u32>,
    /// Binary logarithm of the core's side.
    pub(super) bits: u32,
    /// First row and column of the core in the window.
    first: [usize; 2],
    /// By cell of the window without its core but its first cell: the other cell, and the share of draws that stay, of 2^32.
    rest: Vec<(u32, u32)>,
    samples: usize,
    /// Centre of the light in the window, cells from its middle.
    pub(super) centre: DVec2,
    /// Side of a cell, µm.
    pub(super) pitch_um: f64,
    /// Of the draws outside the core, the share outside the window.
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
        // As the kernels of the other engines: the same spread at any distance.
        let grid = PsfGrid { axes: GridAxes::Retina, fraunhofer: true, ..PsfGrid::new(samples, half_um) };
        let pitch_um = grid.pitch_um();
        let cell = wavefront.density_per_um2() * pitch_um * pitch_um;
        let values = psf(wavefront, &grid);
        let inside = values.iter().sum::<f64>() * cell;
        let accepted = wavefront.throughput();
        let tail = (1.0 - inside / accepted).clamp(0.0, 1.0);
        Self::of_masses(sharpened(&values, samples), samples, pitch_um, tail, accepted)
    }

    /// The table of a window's masses (in any unit) with a share of the light outside it.
    fn of_masses(mut mass: Vec<f64>, samples: usize, pitch_um: f64, tail: f64, accepted: f64) -> Self {
        let total = mass.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let places = |axis: usize| {
            mass.iter().enumerate().map(move |(cell, m)| m * [cell / samples, cell % samples][axis] as f64)
        };
        let centre = [places(0).sum::<f64>() / total, places(1).sum::<f64>() / total];
        let place = |bits: u32| {
            let side = 1_usize << bits;
            (side, centre.map(|c| ((c + 0.5).max(0.0) as usize).saturating_sub(side / 2).min(samples - side)))
        };
        let cells = |bits: u32| {
            let (side, first) = place(bits);
            (0..side * side).map(move |c| (first[0] + c / side) * samples + first[1] + c % side)
        };
        let holds = |bits: u32| cells(bits).map(|cell| mass[cell]).sum::<f64>() / total;
        let fit: Vec<u32> = CORE_BITS.into_iter().filter(|bits| 1 << bits <= samples).collect();
        let enough = fit.iter().find(|bits| holds(**bits) >= CORE_SHARE).or(fit.last());
        let bits = enough.copied().unwrap_or(CORE_BITS[0]);
        let core_cells: Vec<usize> = cells(bits).skip(1).collect();
        // As shares of all light, that outside the core first.
        let mut core = vec![0.0];
        core.extend(core_cells.iter().map(|cell| mass[*cell] * (1.0 - tail) / total));
        let outside = (1.0 - core.iter().sum::<f64>()).max(0.0);
        core[OUTSIDE as usize] = outside;
        for cell in core_cells {
            mass[cell] = 0.0;
        }
        let packed = |(other, stay): (u32, u32)| other | (stay.saturating_add(0x8000) & 0xFFFF_0000);
        Self {
            core: alias(&core).into_iter().map(packed).collect(),
            bits,
            first: place(bits).1,
            tail: if outside > 0.0 { (tail / outside).min(1.0) } else { 0.0 },
            rest: alias(&mass),
            samples,
            centre: DVec2::from_array(centre) + 0.5 - 0.5 * samples as f64,
            pitch_um,
            accepted,
        }
    }

    /// Offset of the core's first corner, in cells.
    pub(super) fn corner(&self) -> DVec2 {
        DVec2::new(self.first[0] as f64, self.first[1] as f64) - 0.5 * self.samples as f64
    }

    /// The table of the core, which is no longer in this one then.
    pub(super) fn take_core(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.core)
    }

    /// Looks up where a photon outside the core may land: a short step, so that many wait for memory at a time.
    #[inline]
    pub(super) fn look_outside(&self, mut dice: Dice) -> Outside {
        let (bits, tail) = (dice.bits(), above(dice.bits()));
        let cell = ((bits >> 32) * self.rest.len() as u64) >> 32;
        let (other, stay) = self.rest[cell as usize];
        let cell = if (bits as u32) < stay { cell as u32 } else { other };
        Outside { cell: if tail < self.tail { BEYOND } else { cell }, dice }
    }

    /// Where it lands, in cells from the core's first corner.
    #[inline]
    pub(super) fn place_outside(&self, Outside { cell, mut dice }: Outside) -> DVec2 {
        let offset = if cell == BEYOND {
            self.beyond(&mut dice)
        } else {
            let samples = self.samples as u32;
            let corner = DVec2::new(f64::from(cell / samples), f64::from(cell % samples));
            corner + dice.pair() - 0.5 * self.samples as f64
        };
        offset - self.corner()
    }

    /// An offset outside the window, in cells: density 1/r³ outside the inscribed circle, drawn again while inside the square.
    fn beyond(&self, dice: &mut Dice) -> DVec2 {
        let half = 0.5 * self.samples as f64;
        loop {
            let p = dice.pair();
            let offset = math::unit(std::f64::consts::TAU * p.y) * (half / (1.0 - p.x));
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

    /// Every cell's share of the draws, summed from the tables, is its mass.
    #[test]
    fn the_alias_tables_hold_the_masses() {
        const N: usize = 80;
        let mass: Vec<f64> = (0..N * N)
            .map(|i| {
                let (x, y) = ((i / N) as f64 - 50.0, (i % N) as f64 - 30.0);
                (-(x * x + y * y) / 60.0).exp() + 1e-4 * f64::from((i as u32 * 7919) % 31)
            })
            .collect();
        let total: f64 = mass.iter().sum();
        let spread = Spread::of_masses(mass.clone(), N, 1.0, 0.125, 1.0);
        let mut drawn = vec![0.0; N * N];
        let mut outside = 0.0;
        let (side, cells) = (1 << spread.bits, spread.core.len() as f64);
        let place = |cell: usize| (spread.first[0] + cell / side) * N + spread.first[1] + cell % side;
        for (i, entry) in spread.core.iter().enumerate() {
            let stays = f64::from(entry >> 16) / 65_536.0;
            for (cell, share) in [(i, stays), ((entry & 0xFFFF) as usize, 1.0 - stays)] {
                *(if cell == OUTSIDE as usize { &mut outside } else { &mut drawn[place(cell)] }) +=
                    share / cells;
            }
        }
        let rest = outside * (1.0 - spread.tail) / mass.len() as f64;
        for (i, &(other, stay)) in spread.rest.iter().enumerate() {
            let stays = f64::from(stay) / 4_294_967_296.0;
            drawn[i] += rest * stays;
            drawn[other as usize] += rest * (1.0 - stays);
        }
        let errors = mass.iter().zip(&drawn).map(|(m, d)| (0.875 * m / total - d).abs());
        assert!((outside * spread.tail - 0.125).abs() < 1e-6);
        let (worst, sum) = errors.fold((0.0, 0.0), |(worst, sum): (f64, f64), e| (worst.max(e), sum + e));
        assert!(side == 32 && worst < 1e-7 && sum < 1.6e-5, "{side} {worst} {sum}");
    }
}
