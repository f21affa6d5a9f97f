//! What the light loses before the cones (§17, §18): cornea, lens, macular pigment. Densities are log10.
//!
//! cornea  `D = 0.016 + 21e8 nm⁴ / λ⁴` (van den Berg & Tan 1994, total transmittance), per axial thickness
//! lens    the Stockman, Sharpe & Fach 1999 density with that cornea shape taken out, per axial thickness
//! macula  unit shape x peak x profile; strongest in the foveal centre, linear to 0 at [`MACULA_EDGE_DEG`]
//!
//! The published "lens" density already holds the cornea's shape: adding a cornea on top would count it twice (15 % at 390 nm).
//! The flat 0.016 stands for reflection at the front surface among other losses; no Fresnel loss is applied beside it.

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
}

impl Media {
    /// Media with a factor on the density of cornea and lens and a peak density of the macula.
    ///
    /// # Errors
    /// When the embedded tables cannot be read.
    pub fn new(scale: f64, macular_peak: f64) -> Result<Self, String> {
        let table = Table::load("prereceptor-density")?;
        Ok(Self { lens: table.spline("lens")?, macula: table.spline("macula")?, scale, macular_peak })
    }

    /// Transmittance of the cornea; `path` = path length relative to the axial thickness.
    pub fn cornea(&self, nm: f64, path: f64) -> f64 {
        transmittance(self.scale * path * (0.016 + 21e8 / nm.powi(4)))
    }

    /// Transmittance of the lens; `path` = path length relative to the axial thickness.
    pub fn lens(&self, nm: f64, path: f64) -> f64 {
        transmittance(self.scale * path * self.lens.at(nm).max(0.0))
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
    fn the_macula_ends() {
        let media = Media::new(1.0, 0.404).unwrap();
        assert!((media.macula(460.0, 0.0).log10() + 0.404).abs() < 1e-3);
        assert!(
            (media.macula(460.0, 5.0) - 1.0).abs() < 1e-15 && (media.macula(460.0, 40.0) - 1.0).abs() < 1e-15
        );
    }
}
