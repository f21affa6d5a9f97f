//! Directional sensitivity, the Stiles-Crawford effect of the first kind (§19).
//!
//! Equation (6) in the literature's units: `η(r) = 10^(-ρ r²)`, r = distance in the entrance pupil (mm) from the point at which
//! the cone aims. The part common to all cones (aim at the pupil's centre) acts inside the pupil as an apodization of the
//! amplitude. A cone that aims `r_c` beside the centre catches less: the factor here is the pupil's mean of
//! `10^(-ρ |r - r_c|²)` over its mean of `10^(-ρ r²)`.
//!
//! # As printed
//! The paper takes e^(-0.05 r²). 0.05 mm⁻² is the literature's base-10 coefficient; base e is an option of the schema.

/// Nodes of the radial sum.
const NODES: usize = 64;
/// Terms of the power series of I₀, whose arguments here stay below 20.
const TERMS: usize = 64;

/// The pointing factor of cones for one pupil.
#[derive(Clone, Debug)]
pub struct Pointing {
    /// κ = ρ ln 10, 1/mm².
    kappa: f64,
    /// Over r in the pupil the mean of e^(-κr²) times the k-th term of I₀(2κrc) over c^2k.
    moments: Vec<f64>,
    centred: f64,
    /// Distance in the entrance pupil per angle at the cone, mm/rad.
    mm_per_radian: f64,
}

impl Pointing {
    /// For a coefficient (1/mm², base 10), an entrance pupil (diameter, mm) and the eye's distance in the entrance pupil per
    /// angle at the cone (mm/rad).
    pub fn new(rho10_per_mm2: f64, pupil_mm: f64, mm_per_radian: f64) -> Self {
        let kappa = rho10_per_mm2 * std::f64::consts::LN_10;
        let mut moments = vec![0.0; TERMS];
        for i in 0..NODES {
            let share = (i as f64 + 0.5) / NODES as f64;
            let square = (0.5 * pupil_mm).powi(2) * share;
            let mut term = (-kappa * square).exp() / NODES as f64;
            for (k, moment) in moments.iter_mut().enumerate() {
                *moment += term;
                term *= kappa * kappa * square / ((k + 1) * (k + 1)) as f64;
            }
        }
        let centred = moments[0];
        Self { kappa, moments, centred, mm_per_radian }
    }

    /// Factor on the light caught by a cone whose axis is off by the angle (radians).
    pub fn factor(&self, radians: f64) -> f64 {
        self.mean(radians * self.mm_per_radian) / self.centred
    }

    /// Share that a cone aimed at the pupil's centre accepts: the pupil's mean of 10^(-ρ r²).
    pub fn centred_share(&self) -> f64 {
        self.centred
    }

    /// The pupil's mean of exp(-κ |r - c|²) = e^(-κc²) ∫ e^(-κr²) I₀(2κrc) 2r dr / a², midpoint rule in r², I₀(x) = Σ (x/2)^2k/k!².
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_form_of_the_centred_share() {
        // (1 - e^(-κa²)) / (κa²)
        let pointing = Pointing::new(0.05, 3.0, 22.0);
        let k = 0.05 * std::f64::consts::LN_10 * 2.25;
        assert!((pointing.centred_share() - (1.0 - (-k).exp()) / k).abs() < 1e-6);
        assert!((pointing.factor(0.0) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_tiny_pupil_sees_the_curve_itself() {
        let pointing = Pointing::new(0.05, 1e-3, 22.0);
        assert!((pointing.factor(0.1) - 10_f64.powf(-0.05 * 2.2 * 2.2)).abs() < 1e-6);
    }

    #[test]
    fn switched_off() {
        let pointing = Pointing::new(0.0, 6.0, 22.0);
        assert!((pointing.factor(0.2) - 1.0).abs() < 1e-15 && (pointing.centred_share() - 1.0).abs() < 1e-15);
    }
}
