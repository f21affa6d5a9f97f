//! Directional sensitivity, the Stiles-Crawford effect of the first kind (§19).
//!
//! The photometric law of a population of cones, equation (6) in the literature's units, r = distance in the entrance pupil (mm):
//! `η(r) = 10^(-ρ r²) = e^(-κ r²)`, κ = ρ ln 10                                                                   (1)
//! It acts inside the pupil as an apodization of the amplitude. Each cone aims at a point c of the pupil, two independent normal numbers of
//! standard deviation σ (mm). Law [`PointingLaw::Population`]: a cone accepts
//! `η_c(r) = (κ_c/κ) e^(-κ_c |r - c|²)`, `1/κ = 1/κ_c + 2σ²`                                                    (2)
//! whose mean over c is exactly (1), the convolution of two Gaussians, at every r and so in every pupil. The factor of a cone is
//! `f(c) = ∫ η_c dA / ∫ η dA` over the pupil of radius a, with mean 1 over c; `∫ η dA = π (1 - e^(-κa²))/κ`   (3)
//! A cone narrower than its population is brighter at its peak (κ_c/κ > 1): (1) is 1 for the population, not for each cone.
//!
//! # As printed
//! The paper takes e^(-0.05 r²) for each cone, which loses what the pointing errors take: [`PointingLaw::Paper`], κ_c = κ without the factor.
//!
//! # Source
//! ρ: the value with which (1) gives the effective area of Moon & Spencer 1944 (Le Grand 1957), π/4 d² (1 - 0.0106 d² + 0.0000417 d⁴), from 2 to
//! 7 mm by least squares over the areas: 0.0415, off by -1.2 to +1.5 %. 0.05 mm⁻² (Applegate & Lakshminarayanan 1993) is off by -7.7 %.

use serde::{Deserialize, Serialize};

use crate::psf::quadrature::gauss_legendre;

/// ρ in (1), 1/mm² of entrance pupil.
pub const DEFAULT_RHO10_PER_MM2: f64 = 0.0415;
/// Largest 2σ²κ: how much of the population's curve may be pointing errors.
const MOST_SCATTER: f64 = 0.9;
/// Nodes of the radial sum.
const NODES: usize = 64;
/// Most terms of the power series of I₀, whose arguments here stay below 300.
const TERMS: usize = 512;

/// Whose law the Stiles-Crawford coefficient is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PointingLaw {
    /// The population's: each cone is narrower, and the mean over cones is the law.
    #[default]
    Population,
    /// Each cone's, as in the paper: the population catches less than the law.
    Paper,
}

/// The pointing factor of cones for one pupil.
#[derive(Clone, Debug)]
pub struct Pointing {
    /// κ of one cone, 1/mm².
    kappa: f64,
    /// Peak of one cone over the pupil's mean of (1).
    scale: f64,
    /// Over r in the pupil the mean of e^(-κr²) times the k-th term of I₀(2κrc) over c^2k.
    moments: Vec<f64>,
    /// Distance in the entrance pupil per angle at the cone, mm/rad.
    mm_per_radian: f64,
}

/// What the pointing factor depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointingSpec {
    /// ρ in (1), 1/mm².
    pub rho10_per_mm2: f64,
    /// Standard deviation of the pointing error, radians of tilt at the cone, on each of two axes.
    pub sd_rad: f64,
    /// Whose law ρ is.
    pub law: PointingLaw,
    /// Diameter of the entrance pupil, mm.
    pub pupil_mm: f64,
    /// Distance in the entrance pupil per angle at the cone, mm/rad.
    pub mm_per_radian: f64,
}

impl Pointing {
    /// The factor.
    ///
    /// # Errors
    /// The largest standard deviation (radians) with which a cone is not too narrow: pointing errors alone would make a population's curve
    /// almost as wide as, or wider than, the law.
    pub fn new(spec: &PointingSpec) -> Result<Self, f64> {
        let PointingSpec { rho10_per_mm2, sd_rad, law, pupil_mm, mm_per_radian } = *spec;
        let population = rho10_per_mm2 * std::f64::consts::LN_10;
        // (2)
        let scatter = 2.0 * population * (sd_rad * mm_per_radian).powi(2);
        let peak = match law {
            PointingLaw::Paper => 1.0,
            PointingLaw::Population if scatter <= MOST_SCATTER => 1.0 / (1.0 - scatter),
            PointingLaw::Population => return Err(sd_rad * (MOST_SCATTER / scatter).sqrt()),
        };
        let kappa = population * peak;
        let mut moments = vec![0.0; TERMS];
        let area = (0.5 * pupil_mm).powi(2);
        for (node, weight) in gauss_legendre(NODES) {
            let square = area * 0.5 * (1.0 + node);
            let mut term = (-kappa * square).exp() * 0.5 * weight;
            for (k, moment) in moments.iter_mut().enumerate() {
                *moment += term;
                term *= kappa * kappa * square / ((k + 1) * (k + 1)) as f64;
            }
        }
        Ok(Self { kappa, scale: peak / mean_of_law(population * area), moments, mm_per_radian })
    }

    /// Factor on the light caught by a cone whose axis is off by the angle (radians), equation (3).
    pub fn factor(&self, radians: f64) -> f64 {
        self.scale * self.mean(radians * self.mm_per_radian)
    }

    /// The pupil's mean of exp(-κ |r - c|²) = e^(-κc²) ∫ e^(-κr²) I₀(2κrc) 2r dr / a², Gauss-Legendre in r², I₀(x) = Σ (x/2)^2k/k!².
    fn mean(&self, aim_mm: f64) -> f64 {
        let square = aim_mm * aim_mm;
        let (mut power, mut sum) = (1.0, 0.0);
        for moment in &self.moments {
            sum += moment * power;
            power *= square;
            if moment * power < 1e-17 * sum {
                break;
            }
        }
        (-self.kappa * square).exp() * sum
    }
}

/// Mean of (1) over the pupil, (3) over πa², at κa².
fn mean_of_law(exponent: f64) -> f64 {
    if exponent > 0.0 { -(-exponent).exp_m1() / exponent } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pointing(rho10_per_mm2: f64, pupil_mm: f64, sd_rad: f64, law: PointingLaw) -> Pointing {
        Pointing::new(&PointingSpec { rho10_per_mm2, sd_rad, law, pupil_mm, mm_per_radian: 22.0 }).unwrap()
    }

    #[test]
    fn a_cone_aimed_at_the_centre_has_its_own_peak() {
        // The paper's cone is the law; one of a population with 2σ²κ = 0.2 has κ_c = κ/0.8 = 1.25 κ.
        let paper = pointing(0.05, 3.0, 0.02, PointingLaw::Paper);
        assert!((paper.factor(0.0) - 1.0).abs() < 1e-12);
        let kappa = 0.05 * std::f64::consts::LN_10;
        let own = pointing(0.05, 3.0, (0.1 / kappa).sqrt() / 22.0, PointingLaw::Population);
        let k = kappa * 2.25;
        // (1 - e^(-1.25 κa²)) / (1 - e^(-κa²)), from (3).
        let expected = (1.0 - (-1.25 * k).exp()) / (1.0 - (-k).exp());
        assert!((own.factor(0.0) - expected).abs() < 1e-12, "{}", own.factor(0.0));
    }

    #[test]
    fn a_tiny_pupil_sees_the_curve_itself() {
        let paper = pointing(0.05, 1e-3, 0.0175, PointingLaw::Paper);
        assert!((paper.factor(0.1) - 10_f64.powf(-0.05 * 2.2 * 2.2)).abs() < 1e-6);
    }

    #[test]
    fn switched_off() {
        for law in [PointingLaw::Population, PointingLaw::Paper] {
            assert!((pointing(0.0, 6.0, 0.02, law).factor(0.2) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn errors_wider_than_the_law_are_refused_with_the_most() {
        let spec = PointingSpec {
            rho10_per_mm2: 0.2,
            sd_rad: 0.08,
            law: PointingLaw::Population,
            pupil_mm: 3.0,
            mm_per_radian: 22.0,
        };
        let most = Pointing::new(&spec).unwrap_err();
        assert!(Pointing::new(&PointingSpec { sd_rad: 0.999 * most, ..spec }).is_ok());
        assert!(Pointing::new(&PointingSpec { sd_rad: 1.001 * most, ..spec }).is_err());
        assert!(Pointing::new(&PointingSpec { law: PointingLaw::Paper, ..spec }).is_ok());
    }
}
