//! What the light loses before the cones (§17, §18): cornea, lens, macular pigment. Densities are log10.
//!
//! cornea  `D_C = 0.016 + C(λ)`, `C(λ) = 21e8 nm⁴ / λ⁴` (van den Berg & Tan 1994, total transmittance), per axial thickness   (1)
//! lens    `D_L = D_SSF(λ) - C(λ) + D_0`, `D_0 = 0.0111`, per axial thickness                                              (2)
//! macula  unit shape x peak x profile; strongest in the foveal centre, linear to 0 at [`MACULA_EDGE_DEG`]
//!
//! `D_SSF` is the density of all media but the macula by Stockman, Sharpe & Fach 1999. It holds the cornea's shape: a cornea on top of it
//! would count twice (15 % at 390 nm). It is relative, 0 from 660 nm on by definition, so a constant is missing: `D_0` is the least with which
//! no density of the lens is negative (C(660 nm) = 0.01107). Hence at every wavelength `D_C + D_L = D_SSF + 0.0271`: the published shape and a
//! flat part of 0.016 + 0.0111 (6.0 % of the light).
//!
//! The flat 0.016 (3.6 %) stands for reflection at the front surface among other losses; no Fresnel loss is applied beside it. With
//! [`Media::with_reflections`] Fresnel's losses at the four surfaces (2.7 %, most of it at the front of the cornea) take its place.

use crate::spectrum::{Spline, Table};

/// Eccentricity at which the macular pigment ends, visual degrees.
pub const MACULA_EDGE_DEG: f64 = 5.0;

/// Densities of the media in front of the cones.
#[derive(Clone, Debug)]
pub struct Media {
    /// Density of all media but the macula, relative.
    combined: Spline,
    macula: Spline,
    /// Factor on the density of the lens.
    lens_scale: f64,
    /// Factor on the density of the cornea.
    cornea_scale: f64,
    /// Peak density of the macula at 460 nm in the centre.
    macular_peak: f64,
    /// Share that passes the surfaces at [`REFLECTION_NM`], first and last, and steps between; empty: the flat density stands for them.
    surfaces: Vec<f64>,
}

/// Flat part of the cornea's density.
const FLAT: f64 = 0.016;
/// C of equation (1), nm⁴.
const CORNEA_NM4: f64 = 21e8;
/// D_0 of equation (2).
const LENS_FLAT: f64 = 0.0111;
/// Range of the table of reflections, nm, and its steps.
const REFLECTION_NM: [f64; 2] = [380.0, 840.0];
const REFLECTION_STEPS: u32 = 46;

impl Media {
    /// Media with a factor on the density of the lens and a peak density of the macula.
    ///
    /// # Errors
    /// When the embedded tables cannot be read.
    pub fn new(lens_scale: f64, macular_peak: f64) -> Result<Self, String> {
        let table = Table::load("prereceptor-density")?;
        let (combined, macula) = (table.spline("media")?, table.spline("macula")?);
        Ok(Self { combined, macula, lens_scale, cornea_scale: 1.0, macular_peak, surfaces: Vec::new() })
    }

    /// The same with a factor on the density of the cornea.
    #[must_use]
    pub fn with_cornea_scale(self, cornea_scale: f64) -> Self {
        Self { cornea_scale, ..self }
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
        // (1)
        self.surfaces(nm) * transmittance(self.cornea_scale * path * (flat + CORNEA_NM4 / nm.powi(4)))
    }

    /// Transmittance of the lens; `path` = path length relative to the axial thickness.
    pub fn lens(&self, nm: f64, path: f64) -> f64 {
        transmittance(path * self.lens_density(nm))
    }

    /// Density of the lens along its axial thickness.
    pub fn lens_density(&self, nm: f64) -> f64 {
        // (2)
        self.lens_scale * (self.combined.at(nm) - CORNEA_NM4 / nm.powi(4) + LENS_FLAT).max(0.0)
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

    /// Cornea and lens along the axis have the published density and 0.0271 (Stockman, Sharpe & Fach 1999), also past 627 nm, where the cornea
    /// alone has more than the published density.
    #[test]
    fn cornea_and_lens_reproduce_the_combined_density() {
        let media = Media::new(1.0, 0.35).unwrap();
        for (nm, combined) in [
            (390.0, 2.5122),
            (400.0, 1.7649),
            (450.0, 0.26288),
            (500.0, 0.1537),
            (640.0, 0.0053),
            (700.0, 0.0),
        ] {
            let both = -(media.cornea(nm, 1.0) * media.lens(nm, 1.0)).log10();
            assert!((both - combined - 0.0271).abs() < 1e-9, "{nm} nm: {both}");
        }
        // Nowhere is the density of the lens cut off at 0.
        assert!((3900..=8300).all(|i| media.lens_density(0.1 * f64::from(i)) > 0.0));
    }

    /// Each scale changes its own medium only.
    #[test]
    fn lens_and_cornea_scale_apart() {
        let media = Media::new(1.0, 0.35).unwrap();
        let scaled = Media::new(2.0, 0.35).unwrap().with_cornea_scale(3.0);
        for nm in [400.0, 555.0, 700.0] {
            assert!((scaled.lens(nm, 1.0) / media.lens(nm, 1.0).powi(2) - 1.0).abs() < 1e-12);
            assert!((scaled.cornea(nm, 1.0) / media.cornea(nm, 1.0).powi(3) - 1.0).abs() < 1e-12);
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
