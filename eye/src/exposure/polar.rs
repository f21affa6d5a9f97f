//! Tables of a kernel's Fourier transform over polar frequencies, and their interpolation.
//!
//! A kernel is real, so its transform at -ν is the conjugate of that at ν: half a circle is stored. Radius 0 to `radius` in
//! cycles per radian of visual angle (as tangent), azimuth 0 to π. Interpolation is six-point Lagrange in both; in radius it
//! never crosses 0, where the modulus has a cusp.

use glam::DVec2;
use multiversion::multiversion;
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Points of the interpolation in each direction.
const POINTS: usize = 6;

/// Shape of a polar table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolarShape {
    /// Largest frequency, cycles per unit tangent; the transform is 0 beyond.
    pub radius: f64,
    /// Samples from 0 to `radius`, both included; at least six.
    pub radial: usize,
    /// Samples over [0, π).
    pub azimuthal: usize,
}

/// Where to read a table for one frequency: 36 samples with weights.
#[derive(Clone, Copy, Debug)]
pub struct Stencil {
    first_row: usize,
    row_weights: [f64; POINTS],
    /// Column and sign of the imaginary part.
    columns: [(usize, f64); POINTS],
    column_weights: [f64; POINTS],
}

/// Samples along and around for a transfer that does not oscillate, at a tolerance of 0.005.
const FLAT: [f64; 2] = [80.0, 40.0];
/// Samples more per cycle of blur: its transfer oscillates the less the faster.
const PER_BLUR_CYCLE: [f64; 2] = [4.0, 2.0];
/// Samples more per cycle of shift, which keeps its full strength.
const PER_SHIFT_CYCLE: [f64; 2] = [7.0, 22.0];

impl PolarShape {
    /// The shape for transfers that go through so many cycles from 0 to `radius` because of their [blur, shift], finer for a smaller
    /// `tolerance` of the kernels: the interpolation's error falls with the sixth power of the step, at the end of the transfer with
    /// its power 3/2.
    pub fn for_cycles(radius: f64, [blur, shift]: [f64; 2], tolerance: f64) -> Self {
        let finer = (0.005 / tolerance.max(1e-6)).powf(0.25).clamp(0.7, 4.0);
        let samples = |i: usize| {
            let more = PER_BLUR_CYCLE[i] * blur.min(1000.0) + PER_SHIFT_CYCLE[i] * shift.min(100.0);
            (finer * (FLAT[i] + more)).ceil() as usize
        };
        Self { radius, radial: samples(0), azimuthal: samples(1) }
    }

    /// Number of samples, `[azimuth][radius]`.
    pub fn len(&self) -> usize {
        self.radial * self.azimuthal
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Frequency of a sample.
    pub fn frequency(&self, azimuth: usize, radius: usize) -> DVec2 {
        let angle = std::f64::consts::PI * azimuth as f64 / self.azimuthal as f64;
        DVec2::from_angle(angle) * (self.radius * radius as f64 / (self.radial - 1) as f64)
    }

    /// The stencil for a frequency; `None` beyond the radius.
    pub fn stencil(&self, nu: DVec2) -> Option<Stencil> {
        let radius = nu.length();
        if radius > self.radius {
            return None;
        }
        let at = radius / self.radius * (self.radial - 1) as f64;
        let first_row = (at as usize).saturating_sub(2).min(self.radial - POINTS);
        // Azimuth in [0, 2π) in samples.
        let turn = nu.y.atan2(nu.x) / std::f64::consts::PI * self.azimuthal as f64;
        let below = turn.floor();
        let mut columns = [(0, 1.0); POINTS];
        for (i, column) in columns.iter_mut().enumerate() {
            let index = (below as i64 + i as i64 - 2).rem_euclid(2 * self.azimuthal as i64) as usize;
            *column = if index < self.azimuthal { (index, 1.0) } else { (index - self.azimuthal, -1.0) };
        }
        Some(Stencil {
            first_row,
            row_weights: lagrange(at - first_row as f64),
            columns,
            column_weights: lagrange(turn - below + 2.0),
        })
    }

    /// The values of a table at stencils; 0 beyond the radius.
    pub fn read_all(&self, table: &[Complex64], stencils: &[Option<Stencil>]) -> Vec<Complex64> {
        let mut values = vec![Complex64::ZERO; stencils.len()];
        read_all(self, table, stencils, &mut values);
        values
    }

    /// The value of a table at a stencil.
    #[inline(always)]
    #[allow(clippy::inline_always)] // in the caller's vector code only when inlined
    pub fn read(&self, table: &[Complex64], stencil: &Stencil) -> Complex64 {
        let mut sum = Complex64::ZERO;
        for ((column, sign), weight) in stencil.columns.iter().zip(stencil.column_weights) {
            let start = column * self.radial + stencil.first_row;
            let line = &table[start..start + POINTS];
            let mut inner = Complex64::ZERO;
            for (z, weight) in line.iter().zip(&stencil.row_weights) {
                inner += z * weight;
            }
            sum += weight * Complex64::new(inner.re, sign * inner.im);
        }
        sum
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn read_all(shape: &PolarShape, table: &[Complex64], stencils: &[Option<Stencil>], values: &mut [Complex64]) {
    for (value, stencil) in values.iter_mut().zip(stencils) {
        if let Some(stencil) = stencil {
            *value = shape.read(table, stencil);
        }
    }
}

/// Lagrange weights on the nodes 0, 1, … 5.
fn lagrange(t: f64) -> [f64; POINTS] {
    const FACTORS: [f64; POINTS] = [-120.0, 24.0, -12.0, 12.0, -24.0, 120.0];
    std::array::from_fn(|i| {
        let others = (0..POINTS).filter(|&j| j != i).map(|j| t - j as f64);
        others.product::<f64>() / FACTORS[i]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error over the disc for a shifted Gaussian.
    fn worst(azimuthal: usize, radial: usize) -> f64 {
        let shape = PolarShape { radius: 100.0, radial, azimuthal };
        let exact = |nu: DVec2| {
            let phase = std::f64::consts::TAU * (0.02 * nu.x - 0.01 * nu.y);
            Complex64::from_polar((-nu.length_squared() / 3000.0).exp(), phase)
        };
        let mut table = Vec::with_capacity(shape.len());
        for j in 0..shape.azimuthal {
            table.extend((0..shape.radial).map(|i| exact(shape.frequency(j, i))));
        }
        let error = |i: u32| {
            let nu = DVec2::from_angle(f64::from(i) * 2.399) * (f64::from(i) * 0.0499);
            (shape.read(&table, &shape.stencil(nu).unwrap()) - exact(nu)).norm()
        };
        (0..2000).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn interpolation_converges_with_the_sixth_power() {
        let (coarse, fine) = (worst(64, 64), worst(128, 128));
        assert!(coarse < 2e-4, "{coarse}");
        assert!(fine < coarse / 48.0, "{coarse} {fine}");
    }

    #[test]
    fn beyond_the_radius_there_is_nothing() {
        let shape = PolarShape { radius: 100.0, radial: 16, azimuthal: 16 };
        assert!(shape.stencil(DVec2::new(71.0, 71.0)).is_none());
    }
}
