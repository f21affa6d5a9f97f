//! Visual angles of places on the retina: a polynomial through the chief rays of a traced eye.
//!
//! (u, v) = Σ c_ij·X^i·Y^j, i + j from 1 to the degree, (X, Y) = (x_um, y_um)/25,000 µm. (u, v) are visual degrees in azimuthal equidistant
//! form: the angle from the line of sight along the direction of the visual field, with the signs of the retina (+u is what nasal
//! retina sees, +v what superior retina sees, which is down in the field).

use glam::DVec2;
use serde::{Deserialize, Serialize};

/// Unit of the chart coordinates, µm.
pub const UNIT_UM: f64 = 25_000.0;
/// Largest degree of the polynomial.
pub const MAX_DEGREE: usize = 11;

/// The map from the retina to the visual field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VisualMap {
    degree: usize,
    /// Degrees; by total degree n from 1 on, in each by falling power of X: (n, 0), (n - 1, 1), …
    coefficient: Vec<[f64; 2]>,
}

impl VisualMap {
    /// One scale everywhere, degrees per µm.
    pub fn linear(deg_per_um: f64) -> Self {
        let scale = deg_per_um * UNIT_UM;
        Self { degree: 1, coefficient: vec![[scale, 0.0], [0.0, scale]] }
    }

    /// From coefficients in the order of the monomials; `None` when their number is not that of a degree from 1 to `MAX_DEGREE` or
    /// one is not a number.
    pub fn new(coefficient: Vec<[f64; 2]>) -> Option<Self> {
        let degree = (1..=MAX_DEGREE).find(|n| (n + 1) * (n + 2) / 2 - 1 == coefficient.len())?;
        coefficient.as_flattened().iter().all(|c| c.is_finite()).then_some(Self { degree, coefficient })
    }

    /// The monomials of a degree at a point, in the order of the coefficients.
    pub fn monomials(degree: usize, at_um: DVec2) -> Vec<f64> {
        let p = at_um / UNIT_UM;
        (1..=degree)
            .flat_map(|n| (0..=n).map(move |j| p.x.powi((n - j) as i32) * p.y.powi(j as i32)))
            .collect()
    }

    /// Visual degrees of a place.
    pub fn visual_deg(&self, at_um: DVec2) -> DVec2 {
        let p = at_um / UNIT_UM;
        let mut sum = DVec2::ZERO;
        let mut first = 0;
        let mut power_x = [1.0; MAX_DEGREE + 1];
        let mut power_y = [1.0; MAX_DEGREE + 1];
        for n in 1..=self.degree {
            power_x[n] = power_x[n - 1] * p.x;
            power_y[n] = power_y[n - 1] * p.y;
            for (j, c) in self.coefficient[first..=first + n].iter().enumerate() {
                sum += DVec2::from_array(*c) * (power_x[n - j] * power_y[j]);
            }
            first += n + 1;
        }
        sum
    }

    /// Eccentricity of a place, visual degrees.
    pub fn eccentricity_deg(&self, at_um: DVec2) -> f64 {
        self.visual_deg(at_um).length()
    }

    /// Visual degrees per µm at the fovea.
    pub fn deg_per_um(&self) -> f64 {
        let ([a, b], [c, d]) = (self.coefficient[0], self.coefficient[1]);
        (a * d - b * c).abs().sqrt() / UNIT_UM
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_and_general_form_agree() {
        let linear = VisualMap::linear(1.0 / 287.0);
        let at = DVec2::new(300.0, -1_000.0);
        assert!((linear.visual_deg(at) - at / 287.0).length() < 1e-12);
        assert!((linear.deg_per_um() * 287.0 - 1.0).abs() < 1e-12);
        let coefficient: Vec<[f64; 2]> = (0..20).map(|k| [f64::from(k), 1.0 / f64::from(k + 1)]).collect();
        let map = VisualMap::new(coefficient.clone()).unwrap();
        let terms = VisualMap::monomials(5, at);
        let want: DVec2 = coefficient.iter().zip(terms).map(|(c, m)| DVec2::from_array(*c) * m).sum();
        assert!((map.visual_deg(at) - want).length() < 1e-12);
        assert!(VisualMap::new(vec![[0.0; 2]; 3]).is_none());
        assert!(VisualMap::new(vec![[f64::NAN; 2]; 2]).is_none());
    }
}
