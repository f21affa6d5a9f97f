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

/// Smallest and largest nominal A that focusing tries.
const RANGE: (f64, f64) = (-2.0, 12.0);

impl Prescription {
    /// (radius, conic) of the lens front and back, aqueous depth, lens thickness (mm), lens index shift at nominal A.
    pub(super) fn accommodated(&self, a: f64) -> ((f64, f64), (f64, f64), f64, f64, f64) {
        let law = &self.accommodation;
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

impl SchematicEye {
    /// The nominal A with which light of `wavelength_nm` from `object_distance_mm` (from the corneal apex, ∞ allowed) is
    /// in best focus on the foveal centre: least tilt-removed wavefront error over the pupil. `accommodation_a` of the
    /// state is ignored.
    ///
    /// # Errors
    /// [`OpticsError`] for values out of range, or a distance nearer than A = 12 can focus.
    pub fn accommodation_for(
        p: &Prescription,
        state_without_a: &EyeState,
        object_distance_mm: f64,
        wavelength_nm: f64,
    ) -> Result<f64, OpticsError> {
        in_range("focus.distance (mm)", object_distance_mm, 50.0, f64::INFINITY)?;
        in_range("focus.wavelength_nm", wavelength_nm, 365.0, 1014.0)?;
        let vergence_d = 1e3 / object_distance_mm;
        let variance = |a: f64| -> Result<f64, OpticsError> {
            let eye = SchematicEye::new(p, &EyeState { accommodation_a: a, ..*state_without_a })?;
            let object = Object::field(p.fovea_angle_deg, vergence_d)?;
            let nodes = PupilNodes { radial: 6, azimuth: 16, edge: 0 };
            Ok(PupilBundle::trace(&eye, object, wavelength_nm, nodes)?.variance_mm2())
        };
        // Walk to a bracket of the minimum, then golden section with parabolic steps.
        let step = 0.25;
        let mut middle = (vergence_d * 0.85).clamp(RANGE.0 + step, RANGE.1 - step);
        let mut at = variance(middle)?;
        for _ in 0..64 {
            let (low, high) = (variance(middle - step)?, variance(middle + step)?);
            if low >= at && high >= at {
                return minimum(&variance, middle, step);
            }
            middle += if low < high { -step } else { step };
            at = low.min(high);
            in_range("accommodation needed (nominal A)", middle, RANGE.0 + step, RANGE.1 - step)?;
        }
        Err(OpticsError::OutOfRange {
            field: "accommodation needed (nominal A)",
            value: middle,
            min: RANGE.0,
            max: RANGE.1,
        })
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
