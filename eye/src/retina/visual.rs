//! Visual angles of places on the retina: a polynomial through the chief rays of a traced eye.
//!
//! (u, v) = Σ c_ij·X^i·Y^j, i + j from 1 to the degree. (u, v) are visual degrees in azimuthal equidistant
//! form: the angle from the line of sight along the direction of the visual field, with the signs of the retina (+u is what nasal
//! retina sees, +v what superior retina sees, which is down in the field).
//!
//! Without a rim, (X, Y) = (x_um, y_um)/25,000 µm. A traced eye has a rim: a circle of the chart, 112° about a point 4.7° nasal of the
//! fovea for the default eye, at which the chief rays end because they graze the cornea. The landing place turns back there,
//! so the visual angle goes like the square root of the distance to the rim, which no polynomial follows. The bent chart
//! W(p) = 2d/(1 + k), k = sqrt(1 - |d|²/ρ²), d = p - centre, ρ its radius, has that root in it: (X, Y) = (W(p) - W(0))/25,000 µm.
//!
//! From `EDGE` of the rim's radius on no ray or few arrive, yet temporal retina goes on for 20°. There the angle goes on with the slope of
//! the edge, ever slower: f_e + f'·L·ln(1 + (|d| - ρ_e)/L), L = `FADE`·ρ, along the rim's radius (some 120° at the temporal ora).

use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

use crate::math;

/// Unit of the chart coordinates, µm.
pub const UNIT_UM: f64 = 25_000.0;
/// Largest degree of the polynomial.
pub const MAX_DEGREE: usize = 11;
/// Share of the rim's radius inside of which the polynomial is used.
const EDGE: f64 = 0.99;
/// Share of the rim's radius over which the slope falls to a half outside.
const FADE: f64 = 0.03;

/// The circle of the chart at which the chief rays end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rim {
    /// Its centre, µm of the chart.
    pub centre_um: DVec2,
    /// Its radius, µm of the chart.
    pub radius_um: f64,
}

impl Rim {
    /// The bent chart's coordinates of a place, in units of `UNIT_UM`; a place outside of the rim is taken as on it.
    pub fn bent(&self, at_um: DVec2) -> DVec2 {
        self.bend(at_um - self.centre_um) - self.bend(-self.centre_um)
    }

    fn bend(&self, d: DVec2) -> DVec2 {
        2.0 * d / ((1.0 + self.root(d.length())) * UNIT_UM)
    }

    /// k of the module's doc at a distance from the centre.
    fn root(&self, distance_um: f64) -> f64 {
        let s = distance_um / self.radius_um;
        (1.0 - s * s).max(0.0).sqrt()
    }

    fn is_sound(&self) -> bool {
        self.radius_um.is_finite() && self.centre_um.length() < 0.9 * self.radius_um
    }
}

/// The map from the retina to the visual field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VisualMap {
    degree: usize,
    /// Degrees; by total degree n from 1 on, in each by falling power of X: (n, 0), (n - 1, 1), …
    coefficient: Vec<[f64; 2]>,
    rim: Option<Rim>,
}

impl VisualMap {
    /// One scale everywhere, degrees per µm.
    pub fn linear(deg_per_um: f64) -> Self {
        let scale = deg_per_um * UNIT_UM;
        Self { degree: 1, coefficient: vec![[scale, 0.0], [0.0, scale]], rim: None }
    }

    /// From coefficients in the order of the monomials; `None` when their number is not that of a degree from 1 to `MAX_DEGREE`,
    /// one is not a number, or the fovea is not well inside of the rim.
    pub fn new(coefficient: Vec<[f64; 2]>, rim: Option<Rim>) -> Option<Self> {
        let degree = (1..=MAX_DEGREE).find(|n| (n + 1) * (n + 2) / 2 - 1 == coefficient.len())?;
        let sound = coefficient.as_flattened().iter().all(|c| c.is_finite());
        (sound && rim.is_none_or(|r| r.is_sound())).then_some(Self { degree, coefficient, rim })
    }

    /// The exponents of X and Y of each monomial, in the order of the coefficients.
    pub fn exponents(degree: usize) -> impl Iterator<Item = (usize, usize)> {
        (1..=degree).flat_map(|n| (0..=n).map(move |j| (n - j, j)))
    }

    /// Visual degrees of a place.
    pub fn visual_deg(&self, at_um: DVec2) -> DVec2 {
        let Some(rim) = &self.rim else {
            return self.sum(at_um / UNIT_UM);
        };
        let d = at_um - rim.centre_um;
        let (distance, edge) = (d.length(), EDGE * rim.radius_um);
        if distance <= edge {
            return self.sum(rim.bent(at_um));
        }
        let out = d / distance;
        let k = rim.root(edge);
        let at_edge = rim.bent(rim.centre_um + edge * out);
        let slope = self.gradient(at_edge) * out * (2.0 / (k * (1.0 + k) * UNIT_UM));
        let fade = FADE * rim.radius_um;
        self.sum(at_edge) + slope * (fade * math::ln(1.0 + (distance - edge) / fade))
    }

    /// The polynomial at (X, Y).
    fn sum(&self, p: DVec2) -> DVec2 {
        let mut sum = DVec2::ZERO;
        let mut first = 0;
        let (power_x, power_y) = self.powers(p);
        for n in 1..=self.degree {
            for (j, c) in self.coefficient[first..=first + n].iter().enumerate() {
                sum += DVec2::from_array(*c) * (power_x[n - j] * power_y[j]);
            }
            first += n + 1;
        }
        sum
    }

    /// Its derivatives by X and Y (columns).
    fn gradient(&self, p: DVec2) -> DMat2 {
        let (power_x, power_y) = self.powers(p);
        let mut columns = [DVec2::ZERO; 2];
        for ((i, j), c) in Self::exponents(self.degree).zip(&self.coefficient) {
            let c = DVec2::from_array(*c);
            if i > 0 {
                columns[0] += c * (i as f64 * power_x[i - 1] * power_y[j]);
            }
            if j > 0 {
                columns[1] += c * (j as f64 * power_x[i] * power_y[j - 1]);
            }
        }
        DMat2::from_cols(columns[0], columns[1])
    }

    fn powers(&self, p: DVec2) -> ([f64; MAX_DEGREE + 1], [f64; MAX_DEGREE + 1]) {
        let (mut power_x, mut power_y) = ([1.0; MAX_DEGREE + 1], [1.0; MAX_DEGREE + 1]);
        for n in 1..=self.degree {
            power_x[n] = power_x[n - 1] * p.x;
            power_y[n] = power_y[n - 1] * p.y;
        }
        (power_x, power_y)
    }

    /// Eccentricity of a place, visual degrees.
    pub fn eccentricity_deg(&self, at_um: DVec2) -> f64 {
        self.visual_deg(at_um).length()
    }

    /// Visual degrees per µm at the fovea, the geometric mean over directions.
    pub fn deg_per_um(&self) -> f64 {
        let ([a, b], [c, d]) = (self.coefficient[0], self.coefficient[1]);
        // The bent chart is 2/(k·(1 + k)) wider along the rim's radius and 2/(1 + k) across it.
        let bend = self.rim.map_or(1.0, |rim| {
            let k = rim.root(rim.centre_um.length());
            2.0 / ((1.0 + k) * k.sqrt())
        });
        (a * d - b * c).abs().sqrt() * bend / UNIT_UM
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
        let map = VisualMap::new(coefficient.clone(), None).unwrap();
        let p = at / UNIT_UM;
        let terms = VisualMap::exponents(5).map(|(i, j)| p.x.powi(i as i32) * p.y.powi(j as i32));
        let want: DVec2 = coefficient.iter().zip(terms).map(|(c, m)| DVec2::from_array(*c) * m).sum();
        assert!((map.visual_deg(at) - want).length() < 1e-12);
        assert!(VisualMap::new(vec![[0.0; 2]; 3], None).is_none());
        assert!(VisualMap::new(vec![[f64::NAN; 2]; 2], None).is_none());
        let off = Rim { centre_um: DVec2::X, radius_um: 1.0 };
        assert!(VisualMap::new(vec![[1.0; 2]; 2], Some(off)).is_none());
    }

    /// At the fovea the map is 0 and has the stated scale; at the edge it goes on without a step or a kink.
    #[test]
    fn the_rim_bends_the_chart_smoothly() {
        let rim = Rim { centre_um: DVec2::new(1_000.0, -300.0), radius_um: 23_000.0 };
        let coefficient: Vec<[f64; 2]> =
            (0..9).map(|k| [90.0 / f64::from(k + 1), 30.0 * f64::from(k % 3)]).collect();
        let map = VisualMap::new(coefficient, Some(rim)).unwrap();
        assert_eq!(map.visual_deg(DVec2::ZERO), DVec2::ZERO);
        let slope =
            |at: DVec2, d: DVec2| (map.visual_deg(at + d) - map.visual_deg(at - d)) / (2.0 * d.length());
        let (x, y) = (slope(DVec2::ZERO, DVec2::X), slope(DVec2::ZERO, DVec2::Y));
        assert!((x.perp_dot(y).abs().sqrt() / map.deg_per_um() - 1.0).abs() < 1e-6);
        for turn in 0..12 {
            let out = DVec2::from_angle(f64::from(turn));
            let edge = rim.centre_um + out * (EDGE * rim.radius_um);
            let (inside, outside) = (slope(edge - out, 0.5 * out), slope(edge + out, 0.5 * out));
            assert!((inside - outside).length() < 0.01 * inside.length(), "{inside} {outside}");
            assert!((map.visual_deg(edge + 1e-6 * out) - map.visual_deg(edge - 1e-6 * out)).length() < 1e-6);
        }
    }
}
