//! The data of an eye (§8, §9): surfaces, media, accommodation law, pupil, fovea, measured wavefront. An eye is a file in
//! `data/eyes`, or what an experiment says.
//!
//! Units: mm, nm, degrees. A radius is positive when the centre of curvature lies towards the retina. Angles across the
//! axis are the clinician's: seen from in front of the eye, counter-clockwise from the right.
//!
//! The retina is a sphere, whatever the source of an eye says: cones live on one.

use super::accommodation::AccommodationLaw;
use super::dispersion::{Dispersion, HerzbergerIndices, PolylineIndices, QuadraticIndices};
use super::error::{OpticsError, in_range};
use super::gradient::LensGradient;
use super::zernike::ExtraWavefront;
use glam::DVec2;
use serde::{Deserialize, Serialize};

/// Which eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The right eye: temporal is the subject's right.
    Right,
    /// The left eye, the mirror image.
    Left,
}

impl Side {
    /// Right and up as a clinician sees them from in front of the eye, as (x, y) of the eye frame.
    pub fn clinician_axes(self) -> [DVec2; 2] {
        match self {
            Self::Right => [DVec2::NEG_Y, DVec2::NEG_X],
            Self::Left => [DVec2::Y, DVec2::X],
        }
    }
}

/// The second meridian of a toric surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToricData {
    /// Vertex radius across the axis, mm; the surface's `radius_mm` is along it.
    pub radius_mm: f64,
    /// Conic constant across the axis.
    pub conic: f64,
    /// The meridian along which `radius_mm` of the surface is, degrees, clinician's, 0 to 180.
    pub axis_deg: f64,
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
    /// The other meridian, when the surface is toric.
    #[serde(default)]
    pub toric: Option<ToricData>,
}

/// Radii of either face of the cornea, mm.
const CORNEA_RADII_MM: (f64, f64) = (3.0, 30.0);

impl SurfaceData {
    /// `names`: of radius, conic and thickness.
    fn validate(
        &self,
        names: [&'static str; 3],
        radii_mm: (f64, f64),
        thicknesses_mm: (f64, f64),
    ) -> Result<(), OpticsError> {
        in_range(names[0], self.radius_mm, radii_mm.0, radii_mm.1)?;
        in_range(names[1], self.conic, -20.0, 20.0)?;
        in_range(names[2], self.thickness_mm, thicknesses_mm.0, thicknesses_mm.1)?;
        if let Some(toric) = self.toric {
            in_range("toric.radius_mm", toric.radius_mm, radii_mm.0, radii_mm.1)?;
            in_range("toric.conic", toric.conic, -20.0, 20.0)?;
            in_range("toric.axis_deg", toric.axis_deg, 0.0, 180.0)?;
        }
        Ok(())
    }
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
    /// Indices for [`Dispersion::Polyline`], if known.
    #[serde(default)]
    pub polyline: Option<PolylineIndices>,
    /// Indices for [`Dispersion::Herzberger`], if known.
    #[serde(default)]
    pub herzberger: Option<HerzbergerIndices>,
    /// Indices for [`Dispersion::Quadratic`], if known.
    #[serde(default)]
    pub quadratic: Option<QuadraticIndices>,
    /// How the index changes inside the lens, if it does.
    #[serde(default)]
    pub lens_gradient: Option<LensGradient>,
    /// How the lens changes with accommodation; without it, or with zeros, it does not.
    #[serde(default)]
    pub accommodation: Option<AccommodationLaw>,
    /// A measured wavefront error in the pupil on top of that of the surfaces, if any.
    #[serde(default)]
    pub wavefront: Option<ExtraWavefront>,
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
    /// Wavelengths at which the indices have kinks under a dispersion law, nm.
    pub fn kinks_nm(&self, dispersion: Dispersion) -> Vec<f64> {
        let table = self.polyline.as_ref().filter(|_| dispersion == Dispersion::Polyline);
        let inner = table.and_then(|table| table.wavelength_nm.get(1..table.wavelength_nm.len().max(2) - 1));
        inner.map(<[f64]>::to_vec).unwrap_or_default()
    }

    /// The built-in eye of this name.
    ///
    /// # Errors
    /// [`OpticsError::UnknownPreset`] lists the known names; [`OpticsError::BadData`] when the file does not parse.
    pub fn preset(name: &str) -> Result<Self, OpticsError> {
        let text = crate::catalog::text("eyes", name).ok_or_else(|| OpticsError::UnknownPreset {
            name: name.to_owned(),
            known: crate::catalog::names("eyes").join(", "),
        })?;
        Self::from_json(name, text)
    }

    /// An eye from the text of a data file (JSON, field for field as here).
    ///
    /// # Errors
    /// [`OpticsError::BadData`] when the text does not parse; otherwise as [`Prescription::validate`].
    pub fn from_json(name: &str, text: &str) -> Result<Self, OpticsError> {
        let eye: Self = serde_json::from_str(text)
            .map_err(|e| OpticsError::BadData { name: name.to_owned(), reason: e.to_string() })?;
        eye.validate()?;
        Ok(eye)
    }

    /// Checks every length, conic and index.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] naming the first field that is not plausible for an eye; [`OpticsError::Wrong`] when
    /// fields do not fit together.
    pub fn validate(&self) -> Result<(), OpticsError> {
        self.cornea_front.validate(
            ["cornea_front.radius_mm", "cornea_front.conic", "cornea_front.thickness_mm"],
            CORNEA_RADII_MM,
            (0.1, 2.0),
        )?;
        self.cornea_back.validate(
            ["cornea_back.radius_mm", "cornea_back.conic", "cornea_back.thickness_mm"],
            CORNEA_RADII_MM,
            (1.0, 6.0),
        )?;
        self.lens_front.validate(
            ["lens_front.radius_mm", "lens_front.conic", "lens_front.thickness_mm"],
            (3.0, 60.0),
            // Intraocular lenses are thinner than the eye's own.
            (0.2, 8.0),
        )?;
        self.lens_back.validate(
            ["lens_back.radius_mm", "lens_back.conic", "lens_back.thickness_mm"],
            (-60.0, -3.0),
            (8.0, 30.0),
        )?;
        in_range("retina_radius_mm", self.retina_radius_mm, -20.0, -8.0)?;
        if self.dispersions().is_empty() {
            let why = "an eye needs one of `polyline`, `herzberger`, `quadratic`".into();
            return Err(OpticsError::Wrong { field: "indices", why });
        }
        self.polyline.as_ref().map_or(Ok(()), PolylineIndices::validate)?;
        self.herzberger.as_ref().map_or(Ok(()), HerzbergerIndices::validate)?;
        self.quadratic.as_ref().map_or(Ok(()), QuadraticIndices::validate)?;
        self.lens_gradient.as_ref().map_or(Ok(()), |g| g.validate(self.lens_front.thickness_mm))?;
        self.accommodation.as_ref().map_or(Ok(()), AccommodationLaw::validate)?;
        self.wavefront.as_ref().map_or(Ok(()), ExtraWavefront::validate)?;
        in_range("reference_wavelength_nm", self.reference_wavelength_nm, 390.0, 830.0)?;
        in_range("stop_decentre_mm", self.stop_decentre_mm, 0.0, 1.0)?;
        in_range("fovea_angle_deg", self.fovea_angle_deg, 0.0, 15.0)?;
        in_range("rotation_centre_behind_apex_mm", self.rotation_centre_behind_apex_mm, 5.0, 20.0)?;
        in_range("rotation_centre_nasal_mm", self.rotation_centre_nasal_mm, -3.0, 3.0)?;
        Ok(())
    }

    /// The same eye with every toric surface replaced by its mean conic.
    pub fn without_astigmatism(&self) -> Self {
        let round = |s: SurfaceData| match s.toric {
            None => s,
            Some(t) => SurfaceData {
                radius_mm: 2.0 / (1.0 / s.radius_mm + 1.0 / t.radius_mm),
                conic: 0.5 * (s.conic + t.conic),
                toric: None,
                ..s
            },
        };
        Self {
            cornea_front: round(self.cornea_front),
            cornea_back: round(self.cornea_back),
            lens_front: round(self.lens_front),
            lens_back: round(self.lens_back),
            ..self.clone()
        }
    }

    /// Whether a surface is toric.
    pub fn is_astigmatic(&self) -> bool {
        [self.cornea_front, self.cornea_back, self.lens_front, self.lens_back]
            .iter()
            .any(|s| s.toric.is_some())
    }

    /// Whether the eye is its own mirror image in the plane of the optical axis and the fovea.
    pub fn is_mirror_image(&self) -> bool {
        !self.is_astigmatic() && self.wavefront.is_none()
    }

    /// Distance from the corneal apex to the retina, mm; accommodation keeps it.
    pub fn axial_length_mm(&self) -> f64 {
        self.cornea_front.thickness_mm
            + self.cornea_back.thickness_mm
            + self.lens_front.thickness_mm
            + self.lens_back.thickness_mm
    }

    /// The dispersion laws that it has tables for.
    pub fn dispersions(&self) -> Vec<Dispersion> {
        let laws = [
            (self.herzberger.is_some(), Dispersion::Herzberger),
            (self.quadratic.is_some(), Dispersion::Quadratic),
            (self.polyline.is_some(), Dispersion::Polyline),
        ];
        laws.into_iter().filter(|(there, _)| *there).map(|(_, law)| law).collect()
    }

    /// The law to take when none is asked for: Herzberger's where the eye has it.
    pub fn default_dispersion(&self) -> Dispersion {
        self.dispersions().first().copied().unwrap_or(Dispersion::Herzberger)
    }

    /// Checks that it has tables for a dispersion law.
    ///
    /// # Errors
    /// [`OpticsError::Wrong`] naming the laws that it has.
    pub fn check_dispersion(&self, dispersion: Dispersion) -> Result<(), OpticsError> {
        let have = self.dispersions();
        if have.contains(&dispersion) {
            return Ok(());
        }
        let names: Vec<String> = have.iter().map(|law| format!("`{}`", law.name())).collect();
        Err(OpticsError::Wrong {
            field: "dispersion",
            why: format!(
                "this eye has no table for `{}`, expected one of {}",
                dispersion.name(),
                names.join(", ")
            ),
        })
    }

    /// Indices of air, cornea, aqueous, unaccommodated lens (at its front vertex) and vitreous. The wavelength is held to
    /// 300–1200 nm, outside of which no law has a meaning; a law without a table gives those of the eye's first one.
    pub fn indices(&self, dispersion: Dispersion, wavelength_nm: f64) -> [f64; 5] {
        let nm = wavelength_nm.clamp(300.0, 1200.0);
        let nm = if nm.is_nan() { self.reference_wavelength_nm } else { nm };
        let wanted = match dispersion {
            Dispersion::Polyline => self.polyline.as_ref().map(|p| p.at(nm)),
            Dispersion::Herzberger => self.herzberger.as_ref().map(|h| h.at(nm)),
            Dispersion::Quadratic => self.quadratic.as_ref().map(|q| q.at(nm)),
        };
        let other = || self.herzberger.as_ref().map(|h| h.at(nm));
        let other = || other().or_else(|| self.quadratic.as_ref().map(|q| q.at(nm)));
        let other = || other().or_else(|| self.polyline.as_ref().map(|p| p.at(nm)));
        wanted.or_else(other).unwrap_or([1.0; 5])
    }
}
