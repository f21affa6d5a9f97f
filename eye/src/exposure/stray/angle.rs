//! The light scattered in an eye by the angle from its source.
//!
//! Glare function of the CIE (report 135/1:1999; Vos & van den Berg 1999), 1/sr, θ in degrees, a = (age/70)⁴,
//! pigmentation p: `f = N + W`,
//! `N = (1 − 0.08 a) (9.2e6/(1 + (θ/0.0046)²)^1.5 + 1.5e5/(1 + (θ/0.045)²)^1.5)`,
//! `W = (1 + 1.6 a) (400/(1 + (θ/0.1)²) + 3e-8 θ² + p (1300/(1 + (θ/0.1)²)^1.5 + 0.8/(1 + (θ/0.1)²)^0.5)) +
//! 2.5e-3 p` (1).
//! It is taken as the same at all wavelengths.
//!
//! The kernels hold diffraction and the aberrations of the traced eye. Far from the image their spread is
//! that of the pupil's edge: with light of wavelength λ through a pupil of diameter d the transfer falls as
//! `1 − 4λν/(πd)` from frequency 0, and the spread ends as `k(θ) = λ e/(π³ d θ³)`, θ in radians (2); e is the
//! transmittance of the apodized pupil at its edge over its mean, `x/(eˣ − 1)`, `x = ln 10 ρ d²/4` (3).
//!
//! Scattered is what the CIE's function has beyond that: from [`WHOLE_DEG`] on `S = W + D`, `D = N − (1 − s)
//! k` (4), so that the light that stays in the image and what is scattered are f together. s is the fraction
//! scattered, `s = ∫ S dΩ` over the half space (5). W is scatter at all angles. D below [`WHOLE_DEG`] cannot
//! be told from the aberrations that the kernels hold: it goes on as the parabola in θ that has its value and
//! slope there and no slope at 0 (6). So D is smooth, falls everywhere, ends at 2.5 times its value at
//! [`WHOLE_DEG`], and fades out against N as θ³. All terms are positive.

use std::f64::consts::{LN_10, PI, TAU};

use crate::display::emitters;
use crate::experiment::{Experiment, StrayLight};
use crate::psf::quadrature::gauss_legendre;
use crate::spectrum::Table;

/// From this angle on the light is the CIE's, degrees.
pub const WHOLE_DEG: f64 = 0.5;
/// Where integrals over the angle are cut, degrees, and Gauss nodes between.
const CUTS_DEG: [f64; 14] =
    [0.0, 0.05, 0.1, 0.2, 0.35, WHOLE_DEG, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 90.0];
const NODES: usize = 12;
/// Steps of the equation for s, which gains two digits a step.
const STEPS: usize = 8;
/// Wavelength of a display without visible light, nm.
const USUAL_NM: f64 = 555.0;

/// The glare function's narrow terms N, 1/sr.
fn narrow(stray: StrayLight, theta_deg: f64) -> f64 {
    let term = |peak: f64, width: f64| {
        let fall = 1.0 + (theta_deg / width).powi(2);
        peak / (fall * fall.sqrt())
    };
    (1.0 - 0.08 * (stray.age_years / 70.0).powi(4)) * (term(9.2e6, 0.0046) + term(1.5e5, 0.045))
}

/// The glare function's wide terms W, 1/sr.
fn wide(stray: StrayLight, theta_deg: f64) -> f64 {
    let age = 1.0 + 1.6 * (stray.age_years / 70.0).powi(4);
    let fall = 1.0 + (theta_deg / 0.1).powi(2);
    let root = fall.sqrt();
    let wall = stray.pigmentation * (1300.0 / (fall * root) + 0.8 / root);
    age * (400.0 / fall + 3e-8 * theta_deg * theta_deg + wall) + 2.5e-3 * stray.pigmentation
}

/// The light scattered in an eye.
#[derive(Clone, Copy, Debug)]
pub struct Scatter {
    stray: StrayLight,
    /// (1 − s) k θ³, degrees³/sr.
    skirt: f64,
    /// D at [`WHOLE_DEG`], 1/sr, and its slope there, 1/sr per degree.
    edge: [f64; 2],
    fraction: f64,
}

impl Scatter {
    /// Of an eye before the display of an experiment.
    ///
    /// # Errors
    /// When the embedded tables or the display's spectra cannot be read.
    pub fn new(experiment: &Experiment, stray: StrayLight) -> Result<Self, String> {
        let eye = &experiment.eye;
        Ok(Self::beside(
            stray,
            edge_spread(mean_nm(experiment)?, eye.pupil_mm, eye.stiles_crawford_rho10_per_mm2),
        ))
    }

    /// Beside kernels that spread `k_rad3/θ³` of their light far away, θ in radians.
    pub fn beside(stray: StrayLight, k_rad3: f64) -> Self {
        let own = k_rad3 * 1_f64.to_degrees().powi(3);
        let mut made = Self { stray, skirt: own, edge: [0.0; 2], fraction: 0.0 };
        for _ in 0..STEPS {
            made.skirt = (1.0 - made.fraction) * own;
            let beyond = |theta: f64| made.beyond(theta);
            let step = 1e-4;
            let slope = (beyond(WHOLE_DEG + 2.0 * step) - beyond(WHOLE_DEG)) / (2.0 * step);
            made.edge = [beyond(WHOLE_DEG), slope];
            made.fraction = half_space(|theta| made.per_sr(theta)); // (5)
        }
        made
    }

    /// D from [`WHOLE_DEG`] on.
    fn beyond(&self, theta_deg: f64) -> f64 {
        (narrow(self.stray, theta_deg) - self.skirt / theta_deg.powi(3)).max(0.0) // (4)
    }

    /// S at an angle, 1/sr; none from behind.
    pub fn per_sr(&self, theta_deg: f64) -> f64 {
        if theta_deg > 90.0 {
            return 0.0;
        }
        let [value, slope] = self.edge;
        let difference = if theta_deg < WHOLE_DEG {
            value + slope * (theta_deg * theta_deg - WHOLE_DEG * WHOLE_DEG) / (2.0 * WHOLE_DEG) // (6)
        } else {
            self.beyond(theta_deg)
        };
        wide(self.stray, theta_deg) + difference
    }

    /// Fraction s of the light in the pupil that is scattered.
    pub fn fraction(&self) -> f64 {
        self.fraction
    }
}

/// Integral over the half space of a function of the angle (degrees).
fn half_space(f: impl Fn(f64) -> f64) -> f64 {
    let rule = gauss_legendre(NODES);
    let between = |[from, to]: [f64; 2]| -> f64 {
        let half = 0.5 * (to - from);
        let at = |(u, weight): &(f64, f64)| {
            let theta = from + half * (1.0 + u);
            weight * f(theta) * theta.to_radians().sin()
        };
        half.to_radians() * rule.iter().map(at).sum::<f64>()
    };
    TAU * CUTS_DEG.windows(2).map(|cut| between([cut[0], cut[1]])).sum::<f64>()
}

/// k θ³ of a round pupil, radian³/sr.
fn edge_spread(nm: f64, pupil_mm: f64, rho10_per_mm2: f64) -> f64 {
    let x = LN_10 * rho10_per_mm2 * 0.25 * pupil_mm * pupil_mm;
    let edge = if x > 1e-6 { x / x.exp_m1() } else { 1.0 }; // (3)
    nm * 1e-6 / (PI.powi(3) * pupil_mm) * edge // (2)
}

/// Mean wavelength of a display's white light by its luminance, nm.
fn mean_nm(experiment: &Experiment) -> Result<f64, String> {
    let efficiency = Table::load("luminous-efficiency")?.spline("v")?;
    let (mut sum, mut weights) = (0.0, 0.0);
    for photon in emitters(&experiment.display)?.iter().flat_map(|emitter| &emitter.photons) {
        let luminous = photon.emitted * efficiency.at(photon.nm).max(0.0);
        sum += luminous;
        weights += luminous / photon.nm;
    }
    Ok(if weights > 0.0 { sum / weights } else { USUAL_NM })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(age_years: f64) -> (StrayLight, Scatter) {
        let stray = StrayLight { age_years, pigmentation: 0.5 };
        (stray, Scatter::beside(stray, edge_spread(555.0, 3.0, 0.05)))
    }

    /// All light of the glare function of a black eye is 1 within 2 % at any age (of a brown one 1.03).
    #[test]
    fn the_glare_function_is_a_distribution() {
        for stray in [20.0, 70.0].map(|age_years| StrayLight { age_years, pigmentation: 0.0 }) {
            let whole: f64 = (0..20_000)
                .map(|i| {
                    // Midpoints in ln(θ + 0.001°).
                    let (from, to) = (0.001_f64.ln(), 90.001_f64.ln());
                    let step = (to - from) / 20_000.0;
                    let at = (from + (f64::from(i) + 0.5) * step).exp();
                    let theta = at - 0.001;
                    let f = narrow(stray, theta) + wide(stray, theta);
                    TAU * f * theta.to_radians().sin() * at.to_radians() * step
                })
                .sum();
            assert!((whole - 1.0).abs() < 0.02, "{whole}");
        }
    }

    /// What stays in the image and what is scattered are the glare function; the latter is positive, falls
    /// and has no step.
    #[test]
    fn both_together_are_the_glare_function() {
        for age in [1.0, 20.0, 70.0, 100.0] {
            let (stray, scatter) = of(age);
            let kept = 1.0 - scatter.fraction();
            for theta in [0.5_f64, 0.7, 1.0, 3.0, 10.0, 30.0, 60.0] {
                let skirt = kept * edge_spread(555.0, 3.0, 0.05) / theta.to_radians().powi(3);
                let whole = narrow(stray, theta) + wide(stray, theta);
                assert!(((skirt + scatter.per_sr(theta)) / whole - 1.0).abs() < 1e-9, "{theta}");
            }
            let values: Vec<f64> = (0..400).map(|i| scatter.per_sr(0.005 * f64::from(i))).collect();
            assert!(values.windows(2).all(|v| v[1] < v[0] && v[1] > 0.9 * v[0]));
        }
    }

    /// The integral by another rule; the fraction of an old eye is the larger one.
    #[test]
    fn fractions() {
        let (_, young) = of(20.0);
        let (_, old) = of(70.0);
        for scatter in [young, old] {
            let sum: f64 = (0..900_000)
                .map(|i| {
                    let theta = (f64::from(i) + 0.5) * 1e-4;
                    TAU * scatter.per_sr(theta) * theta.to_radians().sin() * 1e-4_f64.to_radians()
                })
                .sum();
            assert!((sum / scatter.fraction() - 1.0).abs() < 1e-5, "{sum} {}", scatter.fraction());
        }
        println!("{} {}", young.fraction(), old.fraction());
        assert!((0.12..0.2).contains(&young.fraction()) && (0.2..0.3).contains(&old.fraction()));
    }
}
