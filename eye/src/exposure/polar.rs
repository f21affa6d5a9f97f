//! Tables of a kernel's Fourier transform over polar frequencies, and their interpolation.
//!
//! A kernel is real, so its transform at -ν is the conjugate of that at ν: half a circle is stored. Radius 0 to `radius` in
//! cycles per radian of visual angle (as tangent), azimuth 0 to π. Interpolation is four-point Lagrange in both; in radius it
//! never crosses 0, where the modulus has a cusp.

use glam::DVec2;
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Shape of a polar table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolarShape {
    /// Largest frequency, cycles per unit tangent; the transform is 0 beyond.
    pub radius: f64,
    /// Samples from 0 to `radius`, both included.
    pub radial: usize,
    /// Samples over [0, π).
    pub azimuthal: usize,
}

/// Where to read a table for one frequency: sixteen samples with weights.
#[derive(Clone, Copy, Debug)]
pub struct Stencil {
    rows: [usize; 4],
    row_weights: [f64; 4],
    /// Column and sign of the imaginary part.
    columns: [(usize, f64); 4],
    column_weights: [f64; 4],
}

impl PolarShape {
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
        let first = (at as usize).saturating_sub(1).min(self.radial - 4);
        let rows = [first, first + 1, first + 2, first + 3];
        // Azimuth in [0, 2π) in samples.
        let turn = nu.y.atan2(nu.x) / std::f64::consts::PI * self.azimuthal as f64;
        let below = turn.floor();
        let mut columns = [(0, 1.0); 4];
        for (i, column) in columns.iter_mut().enumerate() {
            let index = (below as i64 + i as i64 - 1).rem_euclid(2 * self.azimuthal as i64) as usize;
            *column = if index < self.azimuthal { (index, 1.0) } else { (index - self.azimuthal, -1.0) };
        }
        Some(Stencil {
            rows,
            row_weights: lagrange4(at - first as f64),
            columns,
            column_weights: lagrange4(turn - below + 1.0),
        })
    }

    /// The value of a table at a stencil.
    pub fn read(&self, table: &[Complex64], stencil: &Stencil) -> Complex64 {
        let mut sum = Complex64::ZERO;
        for ((column, sign), weight) in stencil.columns.iter().zip(stencil.column_weights) {
            let line = &table[column * self.radial..(column + 1) * self.radial];
            let mut inner = Complex64::ZERO;
            for (row, w) in stencil.rows.iter().zip(stencil.row_weights) {
                inner += w * line[*row];
            }
            sum += weight * Complex64::new(inner.re, sign * inner.im);
        }
        sum
    }
}

/// Lagrange weights on the nodes 0, 1, 2, 3.
fn lagrange4(t: f64) -> [f64; 4] {
    let (a, b, c, d) = (t, t - 1.0, t - 2.0, t - 3.0);
    [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]
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
    fn interpolation_converges_with_the_fourth_power() {
        let (coarse, fine) = (worst(96, 256), worst(192, 512));
        assert!(coarse < 2e-4, "{coarse}");
        assert!(fine < coarse / 12.0, "{coarse} {fine}");
    }

    #[test]
    fn beyond_the_radius_there_is_nothing() {
        let shape = PolarShape { radius: 100.0, radial: 16, azimuthal: 16 };
        assert!(shape.stencil(DVec2::new(71.0, 71.0)).is_none());
    }
}
