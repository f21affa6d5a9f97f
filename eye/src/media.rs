//! What the light loses before the cones (§17, §18): cornea, lens, macular pigment. Densities are log10.
//!
//! cornea  `D = 0.016 + 21e8 nm⁴ / λ⁴` (van den Berg & Tan 1994, total transmittance), per axial thickness
//! lens    the Stockman, Sharpe & Fach 1999 density with that cornea shape taken out, per axial thickness
//! macula  unit shape x peak x profile; strongest in the foveal centre, linear to 0 at [`MACULA_EDGE_DEG`]
//!
//! The published "lens" density already holds the cornea's shape: adding a cornea on top would count it twice (15 % at 390 nm).
//! The flat 0.016 (3.6 %) stands for reflection at the front surface among other losses; no Fresnel loss is applied beside it. With
//! [`Media::with_reflections`] Fresnel's losses at the four surfaces (2.7 %, most of it at the front of the cornea) take its place.

use crate::spectrum::{Spline, Table};

/// Eccentricity at which the macular pigment ends, visual degrees.
pub const MACULA_EDGE_DEG: f64 = 5.0;

/// Densities of the media in front of the cones.
#[derive(Clone, Debug)]
pub struct Media {
    lens: Spline,
    macula: Spline,
    /// Factor on cornea and lens.
    scale: f64,
    /// Peak density of the macula at 460 nm in the centre.
    macular_peak: f64,
    /// Share that passes the surfaces at [`REFLECTION_NM`], first and last, and steps between; empty: the flat density stands for them.
    surfaces: Vec<f64>,
}

/// Flat part of the cornea's density.
const FLAT: f64 = 0.016;
/// Range of the table of reflections, nm, and its steps.
const REFLECTION_NM: [f64; 2] = [380.0, 840.0];
const REFLECTION_STEPS: u32 = 46;

impl Media {
    /// Media with a factor on the density of cornea and lens and a peak density of the macula.
    ///
    /// # Errors
    /// When the embedded tables cannot be read.
    pub fn new(scale: f64, macular_peak: f64) -> Result<Self, String> {
        let table = Table::load("prereceptor-density")?;
        let (lens, macula) = (table.spline("lens")?, table.spline("macula")?);
        Ok(Self { lens, macula, scale, macular_peak, surfaces: Vec::new() })
    }

    /// The same with reflections at the surfaces between media of these refractive indices (by wavelength, nm) instead of the
    /// cornea's flat density: ((n − n')/(n + n'))² is lost at each, as at perpendicular incidence (up to 40° the mean over
    /// polarizations differs by less than a tenth of it).
    #[must_use]
    pub fn with_reflections(mut self, indices: impl Fn(f64) -> [f64; 5]) -> Self {
        let [from, to] = REFLECTION_NM;
        let passed = |i: u32| {
            let n = indices(from + (to - from) * f64::from(i) / f64::from(REFLECTION_STEPS));
            n.windows(2).map(|n| 1.0 - ((n[0] - n[1]) / (n[0] + n[1])).powi(2)).product()
        };
        self.surfaces = (0..=REFLECTION_STEPS).map(passed).collect();
        self
    }

    /// Share that all surfaces let through.
    fn surfaces(&self, nm: f64) -> f64 {
        let [from, to] = REFLECTION_NM;
        let at = ((nm - from) / (to - from)).clamp(0.0, 1.0) * f64::from(REFLECTION_STEPS);
        let below = (at as usize).min(self.surfaces.len().saturating_sub(2));
        match self.surfaces.get(below..below + 2) {
            Some([a, b]) => a + (at - below as f64) * (b - a),
            _ => 1.0,
        }
    }

    /// Share reflected at all surfaces; 0 where the flat density stands for it.
    pub fn reflected(&self, nm: f64) -> f64 {
        1.0 - self.surfaces(nm)
    }

    /// Transmittance of the cornea, with all that is reflected on the way; `path` = path length relative to the axial thickness.
    pub fn cornea(&self, nm: f64, path: f64) -> f64 {
        let flat = if self.surfaces.is_empty() { FLAT } else { 0.0 };
        self.surfaces(nm) * transmittance(self.scale * path * (flat + 21e8 / nm.powi(4)))
    }

    /// Transmittance of the lens; `path` = path length relative to the axial thickness.
    pub fn lens(&self, nm: f64, path: f64) -> f64 {
        transmittance(path * self.lens_density(nm))
    }

    /// Density of the lens along its axial thickness.
    pub fn lens_density(&self, nm: f64) -> f64 {
        self.scale * self.lens.at(nm).max(0.0)
    }

    /// Transmittance of the macula at a visual eccentricity.
    pub fn macula(&self, nm: f64, ecc_deg: f64) -> f64 {
        let profile = (1.0 - ecc_deg / MACULA_EDGE_DEG).max(0.0);
        transmittance(self.macular_peak * profile * self.macula.at(nm).max(0.0))
    }
}

/// 10^(-density).
fn transmittance(density: f64) -> f64 {
    (-std::f64::consts::LN_10 * density).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paths_through_cornea_and_lens_reproduce_the_combined_density() {
        let media = Media::new(1.0, 0.35).unwrap();
        // Stockman, Sharpe & Fach 1999, combined, plus the flat 0.016.
        for (nm, combined) in [(400.0, 1.7649), (450.0, 0.25926), (500.0, 0.15323)] {
            let both = -(media.cornea(nm, 1.0) * media.lens(nm, 1.0)).log10();
            assert!((both - combined - 0.016).abs() < 0.02, "{nm} nm: {both}");
        }
    }

    #[test]
    fn reflections_take_the_place_of_the_flat_density() {
        let media = Media::new(1.0, 0.35).unwrap();
        let reflecting = media.clone().with_reflections(|_| [1.0, 1.376, 1.3374, 1.42, 1.336]);
        // 2.504 % + 0.020 % + 0.090 % + 0.093 % are lost, in this order, and the flat density no more.
        for nm in [390.0, 555.5, 830.0] {
            let ratio = reflecting.cornea(nm, 1.0) / media.cornea(nm, 1.0) * 10_f64.powf(-0.016);
            assert!((ratio - 0.972_98).abs() < 2e-5, "{ratio}");
            assert!((reflecting.lens(nm, 1.0) - media.lens(nm, 1.0)).abs() < 1e-15);
        }
    }

    #[test]
    fn the_macula_ends() {
        let media = Media::new(1.0, 0.404).unwrap();
        assert!((media.macula(460.0, 0.0).log10() + 0.404).abs() < 1e-3);
        assert!(
            (media.macula(460.0, 5.0) - 1.0).abs() < 1e-15 && (media.macula(460.0, 40.0) - 1.0).abs() < 1e-15
        );
    }
}
