//! Photometry (§6): lumens, candelas and trolands to photons.
//!
//! Φ_v = K_m Σ P(λ) V(λ), K_m = 683.002 lm/W; a joule at λ holds λ/(hc) photons.
//!
//! # The numbers of §6
//! 2000 lm, 1280x1024 pixels, 60 Hz, a screen 240 cm wide seen from 240 cm, an entrance pupil of 40 mm²:
//! ```
//! use photoneye_eye::display::{EmissionLaw, pupil_share_at};
//! use photoneye_eye::photometry::photons_per_lumen;
//! let per_pixel = 2000.0 * photons_per_lumen(555.5) / 60.0 / (1280.0 * 1024.0);
//! assert_eq!(format!("{per_pixel:.2e}"), "1.04e11");
//! // The paper spreads the light evenly over 2π steradian and rounds a lumen to 4.09e15 photons/s.
//! let into_pupil = 1.04e11 * pupil_share_at(EmissionLaw::Uniform, 0.40, 240.0);
//! assert!((into_pupil - 114_960.0).abs() < 15.0);
//! let isomerized = into_pupil * 0.215;
//! assert!((isomerized - 24_716.0).abs() < 5.0);
//! // A pixel covers 2.4905 arcmin (53.13°/1280), a cone 0.5 arcmin.
//! let per_cone = isomerized / (2.4905_f64 / 0.5).powi(2);
//! assert_eq!(per_cone.round(), 996.0);
//! // A screen of gain 1 is Lambertian and sends exactly twice as much on axis.
//! let lambertian = 1.04e11 * pupil_share_at(EmissionLaw::Lambertian, 0.40, 240.0);
//! assert!((lambertian / into_pupil - 2.0).abs() < 1e-12);
//! ```

use crate::spectrum::{Sample, Table};

/// Planck's constant times the speed of light, J m (both exact in the SI).
const PLANCK_LIGHT_J_M: f64 = 6.626_070_15e-34 * 299_792_458.0;
/// Luminous efficacy, lm/W.
pub const LUMENS_PER_WATT: f64 = 683.002;

/// Photons in a joule of light of this wavelength.
pub fn photons_per_joule(nm: f64) -> f64 {
    nm * 1e-9 / PLANCK_LIGHT_J_M
}

/// Photons per second in a lumen at the peak of the luminous efficiency, taken at this wavelength.
pub fn photons_per_lumen(nm: f64) -> f64 {
    photons_per_joule(nm) / LUMENS_PER_WATT
}

/// Lumens of a spectrum, per watt of its `power` units.
///
/// # Errors
/// When the embedded table of the luminous efficiency cannot be read.
pub fn luminous_flux_per_power(samples: &[Sample]) -> Result<f64, String> {
    let efficiency = Table::load("luminous-efficiency")?.spline("v")?;
    Ok(LUMENS_PER_WATT * samples.iter().map(|s| s.power * efficiency.at(s.nm).max(0.0)).sum::<f64>())
}
