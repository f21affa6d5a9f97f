//! Refractive index against wavelength (λ the vacuum wavelength): three laws; an eye has tables for one or more.
//!
//! * `Polyline`: linear between tabulated wavelengths, end segments extended (the paper's choice, §12).
//! * `Herzberger`: n(λ) = Σ a_i(λ) n_i, a_i = A_i + B_i λ² + P_i L + R_i L², L = 1/(λ² − λ0²), λ in µm
//!   (Navarro, Santamaría & Bescós 1985).
//! * `Quadratic`: n(λ) = n_medium + a + b λ + c λ², λ in µm, one curve for all media (Liou & Brennan 1997).
//!
//! In a lens with a gradient its index is that at the front vertex.

use super::error::{OpticsError, in_range};
use serde::{Deserialize, Serialize};

/// How the indices between the tabulated wavelengths are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Dispersion {
    /// Navarro 1985; smooth; longitudinal chromatic aberration 2.47 D over 400–700 nm.
    Herzberger,
    /// Four points joined by straight lines, as the paper does; 2.00 D over 400–700 nm.
    Polyline,
    /// Liou & Brennan 1997; smooth.
    Quadratic,
}

impl Dispersion {
    /// Its name in an experiment.
    pub fn name(self) -> &'static str {
        match self {
            Self::Herzberger => "HERZBERGER",
            Self::Polyline => "POLYLINE",
            Self::Quadratic => "QUADRATIC",
        }
    }
}

/// Indices at tabulated wavelengths, joined by straight lines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolylineIndices {
    /// Vacuum wavelengths, nm, rising; 2 to 64 of them.
    pub wavelength_nm: Vec<f64>,
    /// Index of the cornea at each wavelength.
    pub cornea: Vec<f64>,
    /// Index of the aqueous humour.
    pub aqueous: Vec<f64>,
    /// Index of the unaccommodated lens.
    pub lens: Vec<f64>,
    /// Index of the vitreous humour.
    pub vitreous: Vec<f64>,
}

/// Indices at four wavelengths with Herzberger's interpolation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HerzbergerIndices {
    /// λ0, µm.
    pub pole_um: f64,
    /// The four defining wavelengths, nm.
    pub wavelength_nm: [f64; 4],
    /// A_i.
    pub constant: [f64; 4],
    /// B_i, µm⁻².
    pub square: [f64; 4],
    /// P_i, µm².
    pub pole: [f64; 4],
    /// R_i, µm⁴.
    pub pole_square: [f64; 4],
    /// Index of the cornea at the four wavelengths.
    pub cornea: [f64; 4],
    /// Index of the aqueous humour.
    pub aqueous: [f64; 4],
    /// Index of the unaccommodated lens.
    pub lens: [f64; 4],
    /// Index of the vitreous humour.
    pub vitreous: [f64; 4],
}

/// One parabola for all media.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuadraticIndices {
    /// Index of the cornea, to which the parabola is added.
    pub cornea: f64,
    /// Index of the aqueous humour.
    pub aqueous: f64,
    /// Index of the unaccommodated lens.
    pub lens: f64,
    /// Index of the vitreous humour.
    pub vitreous: f64,
    /// a.
    pub constant: f64,
    /// b, µm⁻¹.
    pub linear_per_um: f64,
    /// c, µm⁻².
    pub square_per_um2: f64,
}

impl PolylineIndices {
    pub(super) fn at(&self, nm: f64) -> [f64; 5] {
        let last = self.wavelength_nm.len() - 1;
        let k = (1..last).find(|&k| nm < self.wavelength_nm[k]).unwrap_or(last);
        let u = (nm - self.wavelength_nm[k - 1]) / (self.wavelength_nm[k] - self.wavelength_nm[k - 1]);
        let at = |n: &[f64]| n[k - 1] + u * (n[k] - n[k - 1]);
        [1.0, at(&self.cornea), at(&self.aqueous), at(&self.lens), at(&self.vitreous)]
    }

    pub(super) fn validate(&self) -> Result<(), OpticsError> {
        let points = self.wavelength_nm.len() as f64;
        in_range("polyline.wavelength_nm (how many)", points, 2.0, 64.0)?;
        in_range("polyline.wavelength_nm", self.wavelength_nm[0], 300.0, 2000.0)?;
        for pair in self.wavelength_nm.windows(2) {
            in_range("polyline.wavelength_nm", pair[1], pair[0] + 1.0, 2000.0)?;
        }
        for (name, index) in [
            ("polyline.cornea", &self.cornea),
            ("polyline.aqueous", &self.aqueous),
            ("polyline.lens", &self.lens),
            ("polyline.vitreous", &self.vitreous),
        ] {
            if index.len() != self.wavelength_nm.len() {
                return Err(OpticsError::Wrong {
                    field: name,
                    why: format!("{} values for {points} wavelengths", index.len()),
                });
            }
            index.iter().try_for_each(|&n| plausible(name, n))?;
        }
        Ok(())
    }
}

/// How well Herzberger's coefficients fit the wavelengths of the indices.
const FITS: f64 = 1e-3;

impl HerzbergerIndices {
    /// The coefficients a_i at a wavelength.
    fn coefficients(&self, nm: f64) -> [f64; 4] {
        let l2 = (nm * 1e-3) * (nm * 1e-3);
        let l = 1.0 / (l2 - self.pole_um * self.pole_um);
        std::array::from_fn(|i| {
            self.constant[i] + self.square[i] * l2 + self.pole[i] * l + self.pole_square[i] * l * l
        })
    }

    pub(super) fn at(&self, nm: f64) -> [f64; 5] {
        let a = self.coefficients(nm);
        let at = |n: &[f64; 4]| a[0] * n[0] + a[1] * n[1] + a[2] * n[2] + a[3] * n[3];
        [1.0, at(&self.cornea), at(&self.aqueous), at(&self.lens), at(&self.vitreous)]
    }

    pub(super) fn validate(&self) -> Result<(), OpticsError> {
        in_range("herzberger.pole_um", self.pole_um, 0.0, 0.25)?;
        for (name, index) in [
            ("herzberger.cornea", self.cornea),
            ("herzberger.aqueous", self.aqueous),
            ("herzberger.lens", self.lens),
            ("herzberger.vitreous", self.vitreous),
        ] {
            index.into_iter().try_for_each(|n| plausible(name, n))?;
        }
        // At the wavelength of an index its own coefficient is 1 and the others are 0.
        for (i, nm) in self.wavelength_nm.into_iter().enumerate() {
            for (k, a) in self.coefficients(nm).into_iter().enumerate() {
                let right = f64::from(u8::from(k == i));
                in_range("herzberger.wavelength_nm (coefficient there)", a, right - FITS, right + FITS)?;
            }
        }
        // Coefficients that are not Herzberger's give indices that are none.
        for nm in [390.0, 500.0, 600.0, 830.0] {
            self.at(nm)[1..].iter().try_for_each(|&n| plausible("herzberger (index between)", n))?;
        }
        Ok(())
    }
}

impl QuadraticIndices {
    pub(super) fn at(&self, nm: f64) -> [f64; 5] {
        let um = nm * 1e-3;
        let more = self.constant + um * (self.linear_per_um + um * self.square_per_um2);
        [1.0, self.cornea + more, self.aqueous + more, self.lens + more, self.vitreous + more]
    }

    pub(super) fn validate(&self) -> Result<(), OpticsError> {
        for nm in [390.0, 500.0, 600.0, 830.0] {
            self.at(nm)[1..].iter().try_for_each(|&n| plausible("quadratic (index)", n))?;
        }
        Ok(())
    }
}

fn plausible(name: &'static str, n: f64) -> Result<(), OpticsError> {
    in_range(name, n, 1.2, 1.7).map(drop)
}
