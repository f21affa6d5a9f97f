//! A measured wavefront error in the pupil, as Zernike coefficients in OSA/ANSI order (ANSI Z80.28; Thibos et al. 2002).
//!
//! W(ρ, θ) = Σ_j c_j Z_j, j = (n(n + 2) + m)/2, Z = √((2 − δ_m0)(n + 1)) R_n^|m|(ρ) cos mθ (m ≥ 0) or sin |m|θ (m < 0);
//! c in µm, ρ = 1 at the edge of the pupil of the measurement, θ counter-clockwise from the right as a clinician sees the eye.
//! Sign as in the standard: c_4 > 0 is a myopic eye, M = −4√3 c_4/r² (D; c in µm, r in mm). Light on its way into the eye then
//! has the path −W: the edge of a myopic eye's pupil is optically short.
//!
//! The error is added in the stop, the same for every field angle and wavelength (as an optical path in air, about the
//! centre of the pupil), on top of what the surfaces do.

use super::error::{OpticsError, in_range};
use super::prescription::Side;
use glam::DVec2;
use serde::{Deserialize, Serialize};

/// Most coefficients: all up to radial order 8.
const MOST: usize = 45;

/// The wavefront error of a measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExtraWavefront {
    /// Entrance pupil diameter of the measurement, mm; a larger pupil is refused.
    pub pupil_mm: f64,
    /// c_0, c_1, …, µm; those left out are 0.
    pub coefficients_um: Vec<f64>,
}

impl ExtraWavefront {
    pub(super) fn validate(&self) -> Result<(), OpticsError> {
        in_range("wavefront.pupil_mm", self.pupil_mm, 0.5, 12.0)?;
        let most = MOST as f64;
        in_range("wavefront.coefficients_um (how many)", self.coefficients_um.len() as f64, 0.0, most)?;
        for c in &self.coefficients_um {
            in_range("wavefront.coefficients_um", *c, -50.0, 50.0)?;
        }
        Ok(())
    }

    /// W at a place of the entrance pupil, µm in air; (x, y) of the eye frame in mm from the pupil's centre.
    pub fn error_um(&self, side: Side, place_mm: DVec2) -> f64 {
        let [right, up] = side.clinician_axes();
        let p = DVec2::new(place_mm.dot(right), place_mm.dot(up)) / (0.5 * self.pupil_mm);
        let terms = self.coefficients_um.iter().enumerate().filter(|(_, c)| **c != 0.0);
        terms.map(|(j, c)| c * zernike(j, p)).sum()
    }
}

/// Z_j in OSA/ANSI order at a point of the unit disc (x, y); unit variance over the disc but for j = 0.
pub fn zernike(j: usize, p: DVec2) -> f64 {
    // n is the row of the triangle of indices, m runs from −n to n in steps of 2.
    let mut n = 0;
    while (n + 1) * (n + 2) / 2 <= j {
        n += 1;
    }
    let m = 2 * (j - n * (n + 1) / 2) as i64 - n as i64;
    let order = m.unsigned_abs() as usize;
    // ρ^|m| (cos, sin)(|m|θ) as a power of x + iy.
    let (mut re, mut im) = (1.0, 0.0);
    for _ in 0..order {
        (re, im) = (re * p.x - im * p.y, re * p.y + im * p.x);
    }
    let radial = radial_over_power(n, order, p.length_squared());
    let norm = if m == 0 { (n as f64 + 1.0).sqrt() } else { (2.0 * (n as f64 + 1.0)).sqrt() };
    norm * radial * if m < 0 { im } else { re }
}

/// R_n^m(ρ)/ρ^m as a polynomial in ρ².
fn radial_over_power(n: usize, m: usize, square: f64) -> f64 {
    let factorial = |k: usize| (1..=k).map(|i| i as f64).product::<f64>();
    // Horner's rule from the highest power of ρ² on: s = 0 first.
    (0..=(n - m) / 2).fold(0.0, |sum, s| {
        let sign = if s % 2 == 0 { 1.0 } else { -1.0 };
        let c = factorial(n - s)
            / (factorial(s) * factorial(usize::midpoint(n, m) - s) * factorial((n - m) / 2 - s));
        sum * square + sign * c
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::PupilNodes;

    #[test]
    fn polynomials_of_the_standard() {
        let p = DVec2::new(0.3, -0.55);
        let (x, y, r2) = (p.x, p.y, p.length_squared());
        let cases = [
            (0, 1.0),
            (1, 2.0 * y),
            (2, 2.0 * x),
            (3, 6.0_f64.sqrt() * 2.0 * x * y),
            (4, 3.0_f64.sqrt() * (2.0 * r2 - 1.0)),
            (5, 6.0_f64.sqrt() * (x * x - y * y)),
            (7, 8.0_f64.sqrt() * (3.0 * r2 - 2.0) * y),
            (8, 8.0_f64.sqrt() * (3.0 * r2 - 2.0) * x),
            (12, 5.0_f64.sqrt() * (6.0 * r2 * r2 - 6.0 * r2 + 1.0)),
            (24, 7.0_f64.sqrt() * (20.0 * r2.powi(3) - 30.0 * r2 * r2 + 12.0 * r2 - 1.0)),
        ];
        for (j, wanted) in cases {
            assert!((zernike(j, p) - wanted).abs() < 1e-14, "{j}: {}", zernike(j, p));
        }
    }

    #[test]
    fn they_are_orthonormal_on_the_disc() {
        let points = PupilNodes { radial: 10, azimuth: 20, edge: 0 }.points();
        for j in 0..MOST {
            for k in 0..=j {
                let mean = points.iter().map(|(p, w)| w * zernike(j, *p) * zernike(k, *p)).sum::<f64>()
                    / std::f64::consts::PI;
                assert!((mean - f64::from(u8::from(j == k))).abs() < 1e-12, "{j} {k}: {mean}");
            }
        }
    }

    #[test]
    fn eyes_mirror_each_other_seen_by_the_clinician() {
        // Horizontal tilt: in a right eye the clinician's right is nasal (−y), in a left eye temporal (+y).
        let w = ExtraWavefront { pupil_mm: 4.0, coefficients_um: vec![0.0, 0.0, 1.0] };
        let nasal = DVec2::new(0.0, -2.0);
        assert!((w.error_um(Side::Right, nasal) - 2.0).abs() < 1e-14);
        assert!((w.error_um(Side::Left, nasal) + 2.0).abs() < 1e-14);
    }
}
