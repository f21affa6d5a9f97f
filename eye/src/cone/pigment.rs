//! Absorptance of the cone pigments, §20, equation (8): `J(λ, θ) = 1 - 10^(-D(θ)·A(λ))`.
//!
//! A = absorbance of Stockman & Sharpe 2000, peak 1. D falls linearly from the fovea: L, M 0.50 to 0.38 at 10 visual degrees;
//! S 0.40 to 0.30 at 13 degrees.
//!
//! # As printed
//! The paper lets S fall to 0.2; the fundamentals that the data belong to support 0.30.

use crate::retina::ConeType;
use crate::spectrum::{Spline, Table};

/// Absorbance spectra of the three pigments.
#[derive(Clone, Debug)]
pub struct Pigments {
    log_absorbance: [Spline; 3],
}

impl Pigments {
    /// The standard observer's pigments.
    ///
    /// # Errors
    /// When the embedded table cannot be read.
    pub fn new() -> Result<Self, String> {
        let table = Table::load("cone-absorbance")?;
        Ok(Self { log_absorbance: [table.spline("l")?, table.spline("m")?, table.spline("s")?] })
    }

    /// Absorbance, peak 1.
    pub fn absorbance(&self, cone: ConeType, nm: f64) -> f64 {
        10_f64.powf(self.log_absorbance[cone as usize].at(nm))
    }

    /// Share of photons absorbed in the pigment at a visual eccentricity.
    pub fn absorptance(&self, cone: ConeType, nm: f64, ecc_deg: f64) -> f64 {
        -(-std::f64::consts::LN_10 * axial_density(cone, ecc_deg) * self.absorbance(cone, nm)).exp_m1()
    }
}

/// Axial optical density (log10) at the peak.
pub fn axial_density(cone: ConeType, ecc_deg: f64) -> f64 {
    let (fovea, far, edge_deg) = match cone {
        ConeType::L | ConeType::M => (0.50, 0.38, 10.0),
        ConeType::S => (0.40, 0.30, 13.0),
    };
    fovea + (far - fovea) * (ecc_deg / edge_deg).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Absorbance and densities must give the 2° cone fundamentals of CIE 170-1:2006 (quantal, peak 1), from which the data come:
    /// log10 L, M, S at some wavelengths, with a macular peak of 0.35 and the combined lens density.
    #[test]
    fn absorptance_at_the_peaks() {
        let pigments = Pigments::new().unwrap();
        assert!((pigments.absorptance(ConeType::L, 555.5, 0.0) - 0.6825).abs() < 2e-4);
        assert!((pigments.absorptance(ConeType::M, 555.5, 0.0) - 0.5914).abs() < 2e-4);
        assert!(pigments.absorptance(ConeType::S, 555.5, 0.0) < 2e-4);
    }

    #[test]
    fn density_falls_and_stays() {
        assert!((axial_density(ConeType::L, 5.0) - 0.44).abs() < 1e-12);
        assert!((axial_density(ConeType::S, 60.0) - 0.30).abs() < 1e-12);
    }
}
