//! Absorptance of the cone pigments, §20, equation (8): `J(λ, θ) = 1 - 10^(-D(θ)·A(λ))`.
//!
//! A = absorbance of Stockman & Sharpe 2000, peak 1. D falls linearly from the fovea: L, M 0.50 to 0.38 at 10 visual degrees;
//! S 0.40 to 0.30 at 13 degrees. In a steady light of I trolands the part `p = I₀/(I₀ + I)`, I₀ = 10^4.3 td, is not bleached (Rushton &
//! Henry 1968); the density is then p·D. The paper counts what unbleached pigments would (p = 1, the default).
//!
//! # As printed
//! The paper lets S fall to 0.2; the fundamentals that the data belong to support 0.30.

use crate::retina::ConeType;
use crate::spectrum::{Spline, Table};

/// Absorbance spectra of the three pigments.
#[derive(Clone, Debug)]
pub struct Pigments {
    log_absorbance: [Spline; 3],
    /// Part of the pigment that is not bleached, 0 to 1.
    unbleached: f64,
}

/// Half bleaching, trolands.
pub const HALF_BLEACH_TD: f64 = 19_952.623_149_688_8;

/// Part of the pigment that a steady light of a retinal illuminance (trolands) leaves unbleached.
pub fn unbleached(trolands: f64) -> f64 {
    HALF_BLEACH_TD / (HALF_BLEACH_TD + trolands)
}

impl Pigments {
    /// The standard observer's pigments.
    ///
    /// # Errors
    /// When the embedded table cannot be read.
    pub fn new() -> Result<Self, String> {
        let table = Table::load("cone-absorbance")?;
        let log_absorbance = [table.spline("l")?, table.spline("m")?, table.spline("s")?];
        Ok(Self { log_absorbance, unbleached: 1.0 })
    }

    /// The same with a part of the pigment bleached.
    #[must_use]
    pub fn with_unbleached(self, part: f64) -> Self {
        Self { unbleached: part, ..self }
    }

    /// Axial optical density (log10) at the peak, without what is bleached.
    pub fn density(&self, cone: ConeType, ecc_deg: f64) -> f64 {
        self.unbleached * axial_density(cone, ecc_deg)
    }

    /// Absorbance, peak 1.
    pub fn absorbance(&self, cone: ConeType, nm: f64) -> f64 {
        10_f64.powf(self.log_absorbance[cone as usize].at(nm))
    }

    /// Share of photons absorbed in the pigment at a visual eccentricity.
    pub fn absorptance(&self, cone: ConeType, nm: f64, ecc_deg: f64) -> f64 {
        -(-std::f64::consts::LN_10 * self.density(cone, ecc_deg) * self.absorbance(cone, nm)).exp_m1()
    }
}

/// Eccentricities from which on the density of the pigment stays what it is: of L and M, of S cones, visual
/// degrees.
pub const DENSITY_EDGES_DEG: [f64; 2] = [10.0, 13.0];

/// Axial optical density (log10) of the unbleached pigment at the peak.
pub fn axial_density(cone: ConeType, ecc_deg: f64) -> f64 {
    let (fovea, far, edge_deg) = match cone {
        ConeType::L | ConeType::M => (0.50, 0.38, DENSITY_EDGES_DEG[0]),
        ConeType::S => (0.40, 0.30, DENSITY_EDGES_DEG[1]),
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

    /// Half bleached, a thin pigment absorbs half; a dense one keeps more of its absorptance (self-screening).
    #[test]
    fn bleaching_thins_the_pigment() {
        let fresh = Pigments::new().unwrap();
        let half = fresh.clone().with_unbleached(unbleached(10_f64.powf(4.3)));
        let kept = |nm| half.absorptance(ConeType::L, nm, 0.0) / fresh.absorptance(ConeType::L, nm, 0.0);
        assert!((half.density(ConeType::L, 0.0) - 0.25).abs() < 1e-12);
        assert!((kept(780.0) - 0.5).abs() < 1e-3, "{}", kept(780.0));
        let peak = (1.0 - 10_f64.powf(-0.25)) / (1.0 - 10_f64.powf(-0.5));
        assert!((kept(557.0) - peak).abs() < 1e-3, "{}", kept(557.0));
        assert!((unbleached(0.0) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn density_falls_and_stays() {
        assert!((axial_density(ConeType::L, 5.0) - 0.44).abs() < 1e-12);
        assert!((axial_density(ConeType::S, 60.0) - 0.30).abs() < 1e-12);
    }
}
