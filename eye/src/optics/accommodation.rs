//! Accommodation (Navarro, Santamaría & Bescós 1985, table 4) and its inverse.
//!
//! Each quantity gains c·ln(A + 1), the lens index c1·A + c2·A²; the axial length is kept. A is nominal: A = 1 focuses
//! 1.23 D. The eye is focused by choosing A so that the tilt-removed wavefront error at the foveal centre is smallest.
//!
//! # As printed
//! ln(A + 1) ends at A = −1. Below A = −1/2 its tangent is used, so that a slightly hyperopic far focus stays smooth.

use super::bundle::{PupilBundle, PupilNodes};
use super::error::{OpticsError, in_range};
use super::object::Object;
use super::prescription::Prescription;
use super::schematic_eye::{EyeState, SchematicEye};
use serde::{Deserialize, Serialize};

/// Smallest nominal A that a law is taken for; no eye accommodates below 0, but what it would need is looked
/// for there.
pub(super) const LEAST_A: f64 = -2.0;

/// Navarro's accommodation law: what is added to each quantity, times ln(A + 1) or A.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
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
    /// Largest nominal A that the law is taken for.
    pub most_a: f64,
}

impl Default for AccommodationLaw {
    /// No change at all, over Navarro's range of A.
    fn default() -> Self {
        Self {
            lens_front_radius_mm: 0.0,
            lens_back_radius_mm: 0.0,
            aqueous_depth_mm: 0.0,
            lens_thickness_mm: 0.0,
            lens_front_conic: 0.0,
            lens_back_conic: 0.0,
            lens_index_per_a: 0.0,
            lens_index_per_a2: 0.0,
            most_a: 12.0,
        }
    }
}

impl AccommodationLaw {
    pub(super) fn validate(&self) -> Result<(), OpticsError> {
        for (name, value, limit) in [
            ("accommodation.lens_front_radius_mm", self.lens_front_radius_mm, 10.0),
            ("accommodation.lens_back_radius_mm", self.lens_back_radius_mm, 10.0),
            ("accommodation.aqueous_depth_mm", self.aqueous_depth_mm, 1.0),
            ("accommodation.lens_thickness_mm", self.lens_thickness_mm, 1.0),
            ("accommodation.lens_front_conic", self.lens_front_conic, 5.0),
            ("accommodation.lens_back_conic", self.lens_back_conic, 5.0),
            ("accommodation.lens_index_per_a", self.lens_index_per_a, 0.01),
            ("accommodation.lens_index_per_a2", self.lens_index_per_a2, 0.001),
        ] {
            in_range(name, value, -limit, limit)?;
        }
        in_range("accommodation.most_a", self.most_a, 0.0, 20.0)?;
        Ok(())
    }

    fn changes_nothing(&self) -> bool {
        *self == Self { most_a: self.most_a, ..Self::default() }
    }
}

impl Prescription {
    /// (radius, conic) of the lens front and back, aqueous depth, lens thickness (mm), lens index shift at nominal A.
    pub(super) fn accommodated(&self, a: f64) -> ((f64, f64), (f64, f64), f64, f64, f64) {
        let law = self.accommodation.unwrap_or_default();
        let ln = if a < -0.5 { 0.5_f64.ln() + (a + 0.5) / 0.5 } else { a.ln_1p() };
        (
            (
                self.lens_front.radius_mm + law.lens_front_radius_mm * ln,
                self.lens_front.conic + law.lens_front_conic * ln,
            ),
            (
                self.lens_back.radius_mm + law.lens_back_radius_mm * ln,
                self.lens_back.conic + law.lens_back_conic * ln,
            ),
            self.cornea_back.thickness_mm + law.aqueous_depth_mm * ln,
            self.lens_front.thickness_mm + law.lens_thickness_mm * ln,
            law.lens_index_per_a * a + law.lens_index_per_a2 * a * a,
        )
    }
}

/// An eye that does not accommodate is taken as it is when its own focus is this near to the wanted one, D: about half of
/// the depth of focus that people do not notice.
pub const FOCUS_FITS_D: f64 = 0.25;
/// Rays of a focusing step.
const NODES: PupilNodes = PupilNodes { radial: 6, azimuth: 16, edge: 0 };

impl SchematicEye {
    /// The nominal A with which light of `wavelength_nm` from `object_distance_mm` (from the corneal apex, ∞ allowed) is
    /// in best focus on the foveal centre: least tilt-removed wavefront error over the pupil. `accommodation_a` of the
    /// state is ignored. An eye that does not accommodate gives 0 when its own focus is within [`FOCUS_FITS_D`].
    ///
    /// # Errors
    /// [`OpticsError`] for values out of range, a distance nearer than the law's largest A can focus or farther than its
    /// smallest can, or [`OpticsError::CannotFocus`].
    pub fn accommodation_for(
        p: &Prescription,
        state_without_a: &EyeState,
        object_distance_mm: f64,
        wavelength_nm: f64,
    ) -> Result<f64, OpticsError> {
        in_range("focus.distance (mm)", object_distance_mm, 50.0, f64::INFINITY)?;
        in_range("focus.wavelength_nm", wavelength_nm, 365.0, 1014.0)?;
        let vergence_d = 1e3 / object_distance_mm;
        let Some(law) = p.accommodation.filter(|law| !law.changes_nothing()) else {
            let relaxed = SchematicEye::new(p, &EyeState { accommodation_a: 0.0, ..*state_without_a })?;
            let relaxed_d = relaxed.focus_vergence_d(wavelength_nm)?;
            if (relaxed_d - vergence_d).abs() <= FOCUS_FITS_D {
                return Ok(0.0);
            }
            let why =
                format!("it has no accommodation law and is taken as it is only within {FOCUS_FITS_D} D");
            return Err(OpticsError::CannotFocus { wanted_d: vergence_d, relaxed_d, why });
        };
        let variance = |a: f64| -> Result<f64, OpticsError> {
            let eye = SchematicEye::new(p, &EyeState { accommodation_a: a, ..*state_without_a })?;
            let object = Object::field(p.fovea_angle_deg, vergence_d)?;
            Ok(PupilBundle::trace(&eye, object, wavelength_nm, NODES)?.variance_mm2())
        };
        // Walk to a bracket of the minimum, then parabolic steps.
        let step = 0.25;
        let (least, most) = (LEAST_A + step, (law.most_a - step).max(LEAST_A + step));
        let mut middle = (vergence_d * 0.85).clamp(least, most);
        let mut at = variance(middle)?;
        for _ in 0..64 {
            let (low, high) = (variance(middle - step)?, variance(middle + step)?);
            if low >= at && high >= at {
                return minimum(&variance, middle, step);
            }
            middle += if low < high { -step } else { step };
            at = low.min(high);
            in_range("eye.focus.distance_cm (nominal accommodation that it needs)", middle, least, most)?;
        }
        Err(OpticsError::OutOfRange {
            field: "eye.focus.distance_cm (nominal accommodation that it needs)",
            value: middle,
            min: LEAST_A,
            max: law.most_a,
        })
    }

    /// The nominal accommodation of an eye that looks at an object at a distance (mm) and a wavelength (nm):
    /// between none and its amplitude (D; `None`: what its law allows). Nothing lets an eye see sharply
    /// beyond its far point.
    ///
    /// # Errors
    /// As [`SchematicEye::accommodation_for`]; an object nearer than the law reaches.
    pub fn accommodated(
        p: &Prescription,
        state_without_a: &EyeState,
        (distance_mm, wavelength_nm): (f64, f64),
        amplitude_d: Option<f64>,
    ) -> Result<f64, OpticsError> {
        let needed = Self::accommodation_for(p, state_without_a, distance_mm, wavelength_nm);
        if amplitude_d.is_none()
            && let Ok(a) = needed
        {
            return Ok(a.max(0.0));
        }
        if matches!(needed, Err(OpticsError::CannotFocus { .. })) {
            return needed;
        }
        // Beyond the far point the eye rests; nearer than the amplitude allows it does what it can.
        let relaxed = Self::new(p, &EyeState { accommodation_a: 0.0, ..*state_without_a })?;
        let far_point_d = relaxed.focus_vergence_d(wavelength_nm)?;
        let wanted_d = 1e3 / distance_mm;
        if wanted_d <= far_point_d {
            return Ok(0.0);
        }
        let Some(amplitude_d) = amplitude_d else { return needed };
        let reached_d = (far_point_d + amplitude_d).min(wanted_d);
        if reached_d <= 0.0 {
            return Ok(0.0);
        }
        Ok(Self::accommodation_for(p, state_without_a, 1e3 / reached_d, wavelength_nm)?.max(0.0))
    }

    /// Vergence (D; 0 infinity, 2 an object 500 mm from the corneal apex, negative beyond infinity) of the foveal object
    /// that this eye, as it is accommodated, has in best focus at a vacuum wavelength: least tilt-removed wavefront error.
    ///
    /// # Errors
    /// [`OpticsError`] when there is none within ±19 D.
    pub fn focus_vergence_d(&self, wavelength_nm: f64) -> Result<f64, OpticsError> {
        let variance = |vergence_d: f64| -> Result<f64, OpticsError> {
            let object = Object::field(self.prescription.fovea_angle_deg, vergence_d)?;
            Ok(PupilBundle::trace(self, object, wavelength_nm, NODES)?.variance_mm2())
        };
        let step = 0.5;
        let (mut middle, mut at) = (0.0, variance(0.0)?);
        for _ in 0..40 {
            let (low, high) = (variance(middle - step)?, variance(middle + step)?);
            if low >= at && high >= at {
                return minimum(&variance, middle, step);
            }
            middle += if low < high { -step } else { step };
            at = low.min(high);
            in_range("focus of the eye (D)", middle, -19.0, 19.0)?;
        }
        Err(OpticsError::OutOfRange { field: "focus of the eye (D)", value: middle, min: -19.0, max: 19.0 })
    }
}

/// Minimum near `x` by parabolas through three points of falling spacing; the variance is close to a parabola in A.
fn minimum(f: &impl Fn(f64) -> Result<f64, OpticsError>, x: f64, step: f64) -> Result<f64, OpticsError> {
    let (mut x, mut h) = (x, step);
    for _ in 0..6 {
        let (low, middle, high) = (f(x - h)?, f(x)?, f(x + h)?);
        let curvature = low - 2.0 * middle + high;
        if curvature <= 0.0 {
            break;
        }
        x += (0.5 * h * (low - high) / curvature).clamp(-h, h);
        h = (h * 0.3).max(1e-3);
    }
    Ok(x)
}
