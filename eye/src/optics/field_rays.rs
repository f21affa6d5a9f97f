//! Chief rays from all over the visual field of one eye: what the maps of the whole retina are fitted to (`field_fit`).
//!
//! A direction of the field is named by (u, v), visual degrees in azimuthal equidistant form about the line of sight with the signs of
//! the retina: +u is what nasal retina sees, +v what superior retina sees. A right eye sees (u, v) at x_deg = u, y_deg = -v; a left one at
//! x_deg = -u, y_deg = -v. The eye is the mirror image of itself in the plane v = 0, so one half of the field is traced.
//!
//! Along a meridian the landing place runs outwards to the fold, some 105° from the line of sight, where the cornea is grazed; rays from
//! farther out land nearer to the fovea again. Rays are taken up to the fold.
//!
//! Places are rounded to 1 nm and directions to 1e-8: what is computed from them by IEEE operations alone has the same bits on
//! every machine.
//!
//! # Cost
//! 430 rays, 2 ms.

use glam::{DVec2, DVec3};

use super::error::OpticsError;
use super::object::Object;
use super::prescription::Side;
use super::schematic_eye::SchematicEye;
use crate::math;

/// Meridians traced, equally spaced from 0° to 180°.
const MERIDIANS: u32 = 13;
/// Angles from the line of sight, degrees: first these, then every `STEP_DEG` from `FROM_DEG` to the fold.
const ANGLES_DEG: [f64; 19] = [
    0.5, 1.0, 2.0, 3.5, 5.0, 7.5, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 55.0, 60.0, 65.0,
    70.0,
];
const FROM_DEG: f64 = 73.0;
const STEP_DEG: f64 = 1.5;
const TO_DEG: f64 = 130.0;
/// Fewest rays of a meridian.
const FEWEST: usize = 16;

/// One chief ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldRay {
    /// Angle from the line of sight, degrees.
    pub angle_deg: f64,
    /// Direction of the field (u, v), degrees.
    pub visual_deg: DVec2,
    /// Where it lands: chart of the retina, µm.
    pub place_um: DVec2,
    /// Retinal degrees per visual degree outwards, from the ray before it on its meridian; 0 at the fold.
    pub slope: f64,
    /// Unit vector from there back along the ray, in the foveal frame (nasal, superior, inward).
    pub towards: DVec3,
}

/// The light that comes from (`angle_deg` from the line of sight, `meridian` of (u, v) as a unit vector), at infinity.
fn object(eye: &SchematicEye, angle_deg: f64, meridian: DVec2) -> Object {
    let [right, up, forward] = eye.view_axes();
    let x = match eye.state().side {
        Side::Right => meridian.x,
        Side::Left => -meridian.x,
    };
    let (sin, cos) = math::sin_cos(angle_deg.to_radians());
    Object::from_parts(cos * forward - sin * (x * right - meridian.y * up), 0.0)
}

/// The chief ray from (`angle_deg` from the line of sight, `meridian` of (u, v) as a unit vector) at the reference wavelength;
/// its slope is left at 1.
///
/// # Errors
/// [`OpticsError::NoRay`] when none reaches the retina.
pub fn field_ray(eye: &SchematicEye, angle_deg: f64, meridian: DVec2) -> Result<FieldRay, OpticsError> {
    let object = object(eye, angle_deg, meridian);
    let traced = eye.chief_ray(object, eye.prescription().reference_wavelength_nm)?;
    let landing = traced.landing().ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })?;
    let fovea = eye.fovea();
    let back = [fovea.nasal, fovea.superior, -fovea.outward].map(|axis| -traced.direction.dot(axis));
    Ok(FieldRay {
        angle_deg,
        visual_deg: meridian * angle_deg,
        place_um: (fovea.um_from_point(landing) * 1e3).round() / 1e3,
        slope: 1.0,
        towards: (DVec3::from_array(back) * 1e8).round() / 1e8,
    })
}

/// The rays of the half field v >= 0, meridian by meridian (0° to 180° in 15° steps) from the line of sight out to the fold.
///
/// # Errors
/// [`OpticsError::NoRay`] when a meridian ends within some 60°: not an eye.
pub fn field_rays(eye: &SchematicEye) -> Result<Vec<Vec<FieldRay>>, OpticsError> {
    (0..MERIDIANS).map(|m| meridian_rays(eye, m)).collect()
}

fn meridian_rays(eye: &SchematicEye, m: u32) -> Result<Vec<FieldRay>, OpticsError> {
    let meridian = match m {
        0 => DVec2::X,
        k if k + 1 == MERIDIANS => DVec2::NEG_X,
        k => math::unit(std::f64::consts::PI * f64::from(k) / f64::from(MERIDIANS - 1)),
    };
    let steps = ((TO_DEG - FROM_DEG) / STEP_DEG) as u32;
    let outer = (0..=steps).map(|k| FROM_DEG + STEP_DEG * f64::from(k));
    let per_degree = 1e3 * eye.fovea().radius_mm * 1.0_f64.to_radians();
    let mut rays: Vec<FieldRay> = Vec::new();
    for angle_deg in ANGLES_DEG.into_iter().chain(outer) {
        let Ok(mut ray) = field_ray(eye, angle_deg, meridian) else { break };
        let (before, last) = rays.last().map_or((0.0, 0.0), |r| (r.place_um.length(), r.angle_deg));
        ray.slope = (ray.place_um.length() - before) / per_degree / (angle_deg - last);
        if ray.slope <= 0.0 {
            break;
        }
        rays.push(ray);
    }
    let angle_deg = rays.last().map_or(0.0, |ray| ray.angle_deg);
    if rays.len() < FEWEST { Err(OpticsError::NoRay { angle_deg }) } else { Ok(rays) }
}
