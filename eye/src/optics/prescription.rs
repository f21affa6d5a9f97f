//! The data of an eye (§8, §9): surfaces, media, accommodation law, pupil, fovea. An eye is a file in `data/eyes`.
//!
//! Indices, λ the vacuum wavelength:
//! * `Polyline`: linear between the tabulated wavelengths, end segments extended (the paper's choice).
//! * `Herzberger`: n(λ) = Σ a_i(λ) n_i, a_i = A_i + B_i λ² + P_i L + R_i L², L = 1/(λ² − λ0²), λ in µm
//!   (Navarro, Santamaría & Bescós 1985).
//!
//! Units: mm, nm, degrees. A radius is positive when the centre of curvature lies towards the retina.

use super::error::{OpticsError, in_range};
use serde::{Deserialize, Serialize};

/// How the indices between the tabulated wavelengths are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Dispersion {
    /// Navarro 1985; smooth; longitudinal chromatic aberration 2.47 D over 400–700 nm.
    Herzberger,
    /// Four points joined by straight lines, as the paper does; 2.00 D over 400–700 nm.
    Polyline,
}

/// Which eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The right eye: temporal is the subject's right.
    Right,
    /// The left eye, the mirror image.
    Left,
}

/// One refracting surface and the distance to the next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceData {
    /// Vertex radius, mm.
    pub radius_mm: f64,
    /// Conic constant: 0 sphere, −1 paraboloid.
    pub conic: f64,
    /// Axial distance to the next surface, mm.
    pub thickness_mm: f64,
}

/// Indices at tabulated wavelengths, joined by straight lines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolylineIndices {
    /// Vacuum wavelengths, nm, rising.
    pub wavelength_nm: [f64; 4],
    /// Index of the cornea at each wavelength.
    pub cornea: [f64; 4],
    /// Index of the aqueous humour.
    pub aqueous: [f64; 4],
    /// Index of the unaccommodated lens.
    pub lens: [f64; 4],
    /// Index of the vitreous humour.
    pub vitreous: [f64; 4],
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

/// Navarro's accommodation law: what is added to each quantity, times ln(A + 1) or A.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccommodationLaw {
    /// Lens front radius, mm per unit of ln(A + 1).
    pub lens_front_radius_mm: f64,
    /// Lens back radius, mm per unit of ln(A + 1).
    pub lens_back_radius_mm: f64,
    /// Aqueous depth, mm per unit of ln(A + 1).
    pub aqueous_depth_mm: f64,
    /// Lens thickness, mm per unit of ln(A + 1).
    pub lens_thickness_mm: f64,
    /// Lens front conic constant per unit of ln(A + 1).
    pub lens_front_conic: f64,
    /// Lens back conic constant per unit of ln(A + 1).
    pub lens_back_conic: f64,
    /// Lens index per nominal dioptre.
    pub lens_index_per_a: f64,
    /// Lens index per squared nominal dioptre.
    pub lens_index_per_a2: f64,
}

/// The data of an eye.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prescription {
    /// What this eye is.
    pub description: String,
    /// Where its numbers come from.
    pub source: String,
    /// Front of the cornea.
    pub cornea_front: SurfaceData,
    /// Back of the cornea; its thickness is the aqueous depth to the lens and the iris.
    pub cornea_back: SurfaceData,
    /// Front of the lens; the stop lies at its vertex.
    pub lens_front: SurfaceData,
    /// Back of the lens; its thickness is the vitreous length.
    pub lens_back: SurfaceData,
    /// Retina, a sphere; mm, negative (centre towards the cornea).
    pub retina_radius_mm: f64,
    /// Indices for [`Dispersion::Polyline`].
    pub polyline: PolylineIndices,
    /// Indices for [`Dispersion::Herzberger`].
    pub herzberger: HerzbergerIndices,
    /// How the lens changes with accommodation.
    pub accommodation: AccommodationLaw,
    /// Wavelength at which the fovea and the stop magnification are defined, nm.
    pub reference_wavelength_nm: f64,
    /// Default decentre of the stop towards −y, mm.
    pub stop_decentre_mm: f64,
    /// Field angle whose chief ray lands on the foveal centre, degrees.
    pub fovea_angle_deg: f64,
    /// Centre of rotation behind the corneal apex, mm.
    pub rotation_centre_behind_apex_mm: f64,
    /// Centre of rotation towards the nose, mm.
    pub rotation_centre_nasal_mm: f64,
}

impl Prescription {
    /// The built-in eye of this name.
    ///
    /// # Errors
    /// [`OpticsError::UnknownPreset`] lists the known names; [`OpticsError::BadData`] when the file does not parse.
    pub fn preset(name: &str) -> Result<Self, OpticsError> {
        let text = crate::catalog::text("eyes", name).ok_or_else(|| OpticsError::UnknownPreset {
            name: name.to_owned(),
            known: crate::catalog::names("eyes").join(", "),
        })?;
        let eye: Self = serde_json::from_str(text)
            .map_err(|e| OpticsError::BadData { name: name.to_owned(), reason: e.to_string() })?;
        eye.validate()?;
        Ok(eye)
    }

    /// Checks every length, conic and index.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] naming the first field that is not plausible for an eye.
    pub fn validate(&self) -> Result<(), OpticsError> {
        in_range("cornea_front.radius_mm", self.cornea_front.radius_mm, 3.0, 30.0)?;
        in_range("cornea_back.radius_mm", self.cornea_back.radius_mm, 3.0, 30.0)?;
        in_range("lens_front.radius_mm", self.lens_front.radius_mm, 3.0, 60.0)?;
        in_range("lens_back.radius_mm", self.lens_back.radius_mm, -60.0, -3.0)?;
        in_range("retina_radius_mm", self.retina_radius_mm, -20.0, -8.0)?;
        for s in [self.cornea_front, self.cornea_back, self.lens_front, self.lens_back] {
            in_range("conic", s.conic, -20.0, 20.0)?;
        }
        in_range("cornea_front.thickness_mm", self.cornea_front.thickness_mm, 0.1, 2.0)?;
        in_range("cornea_back.thickness_mm", self.cornea_back.thickness_mm, 1.0, 6.0)?;
        in_range("lens_front.thickness_mm", self.lens_front.thickness_mm, 1.0, 8.0)?;
        in_range("lens_back.thickness_mm", self.lens_back.thickness_mm, 8.0, 30.0)?;
        let p = &self.polyline;
        let h = &self.herzberger;
        for index in [p.cornea, p.aqueous, p.lens, p.vitreous, h.cornea, h.aqueous, h.lens, h.vitreous] {
            for n in index {
                in_range("index", n, 1.2, 1.7)?;
            }
        }
        for pair in p.wavelength_nm.windows(2) {
            in_range("polyline.wavelength_nm", pair[1], pair[0] + 1.0, 2000.0)?;
        }
        in_range("herzberger.pole_um", h.pole_um, 0.0, 0.25)?;
        in_range("reference_wavelength_nm", self.reference_wavelength_nm, 390.0, 830.0)?;
        in_range("stop_decentre_mm", self.stop_decentre_mm, 0.0, 1.0)?;
        in_range("fovea_angle_deg", self.fovea_angle_deg, 0.0, 15.0)?;
        in_range("rotation_centre_behind_apex_mm", self.rotation_centre_behind_apex_mm, 5.0, 20.0)?;
        in_range("rotation_centre_nasal_mm", self.rotation_centre_nasal_mm, -3.0, 3.0)?;
        Ok(())
    }

    /// Distance from the corneal apex to the retina, mm; accommodation keeps it.
    pub fn axial_length_mm(&self) -> f64 {
        self.cornea_front.thickness_mm
            + self.cornea_back.thickness_mm
            + self.lens_front.thickness_mm
            + self.lens_back.thickness_mm
    }

    /// Indices of air, cornea, aqueous, unaccommodated lens and vitreous. The wavelength is held to 300–1200 nm,
    /// outside of which neither law has a meaning.
    pub fn indices(&self, dispersion: Dispersion, wavelength_nm: f64) -> [f64; 5] {
        let nm = wavelength_nm.clamp(300.0, 1200.0);
        let nm = if nm.is_nan() { self.reference_wavelength_nm } else { nm };
        match dispersion {
            Dispersion::Polyline => {
                let p = &self.polyline;
                let k = (1..3).find(|&k| nm < p.wavelength_nm[k]).unwrap_or(3);
                let u = (nm - p.wavelength_nm[k - 1]) / (p.wavelength_nm[k] - p.wavelength_nm[k - 1]);
                let at = |n: &[f64; 4]| n[k - 1] + u * (n[k] - n[k - 1]);
                [1.0, at(&p.cornea), at(&p.aqueous), at(&p.lens), at(&p.vitreous)]
            }
            Dispersion::Herzberger => {
                let h = &self.herzberger;
                let l2 = (nm * 1e-3) * (nm * 1e-3);
                let l = 1.0 / (l2 - h.pole_um * h.pole_um);
                let a: [f64; 4] = std::array::from_fn(|i| {
                    h.constant[i] + h.square[i] * l2 + h.pole[i] * l + h.pole_square[i] * l * l
                });
                let at = |n: &[f64; 4]| a[0] * n[0] + a[1] * n[1] + a[2] * n[2] + a[3] * n[3];
                [1.0, at(&h.cornea), at(&h.aqueous), at(&h.lens), at(&h.vitreous)]
            }
        }
    }
}
