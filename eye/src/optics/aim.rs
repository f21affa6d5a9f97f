//! Real aiming: the ray from an object that crosses the stop at a wanted point, by Newton's and Broyden's methods on
//! the traced cornea. (Paraxial aiming is 14–18 % wrong in spot size at 40°.)
//!
//! A ray is named by where it crosses a plane through the centre of the entrance pupil, across the object's direction.

use super::error::{OpticsError, in_range};
use super::object::Object;
use super::schematic_eye::SchematicEye;
use super::trace::{Ray, RayFate, Traced};
use super::zernike::ExtraWavefront;
use glam::{DMat2, DVec2, DVec3};

/// Rays start this far before the entrance pupil, mm: outside of every eye.
const BACK_MM: f64 = 25.0;
/// A ray is aimed when it meets the stop this close to the wanted point, mm.
const TOLERANCE_MM: f64 = 1e-11;
/// By how much a step of Broyden's method shrinks a miss, about, once its slope is known.
const GAIN: f64 = 1e3;
/// Step of the finite differences, mm.
const STEP_MM: f64 = 1e-5;

/// A launch point, mm, and the inverse slope d(launch)/d(stop) there, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Launch {
    pub uv: DVec2,
    pub inverse: DMat2,
}

/// An aimed ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aimed {
    pub launch: Launch,
    /// Where it crosses the stop, mm from its centre.
    pub stop: DVec2,
    /// Path from the object to its start less that to the apex, mm.
    pub path_before: f64,
    pub traced: Traced,
}

/// Rays of one object at one wavelength, to be aimed at the stop.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aimer<'a> {
    eye: &'a SchematicEye,
    object: Object,
    pub(super) indices: [f64; 5],
    e1: DVec3,
    e2: DVec3,
}

impl<'a> Aimer<'a> {
    pub(super) fn new(
        eye: &'a SchematicEye,
        object: Object,
        wavelength_nm: f64,
    ) -> Result<Self, OpticsError> {
        in_range("wavelength_nm", wavelength_nm, 365.0, 1014.0)?;
        Ok(Self::with_indices(eye, object, eye.indices(wavelength_nm)))
    }

    fn with_indices(eye: &'a SchematicEye, object: Object, indices: [f64; 5]) -> Self {
        let d = object.direction();
        let e1 = DVec3::new(-d.y, d.x, 0.0).try_normalize().unwrap_or(DVec3::X);
        Self { eye, object, indices, e1, e2: d.cross(e1) }
    }

    /// The ray through `uv` of the launch plane and its path from the object less that to the apex, mm.
    pub(super) fn launch(&self, uv: DVec2) -> (Ray, f64) {
        let p = self.on_plane(uv);
        let (path, direction) = self.object.eikonal(p);
        (Ray::from_unit(p - BACK_MM * direction, direction), path - BACK_MM)
    }

    pub(super) fn trace(&self, ray: &Ray) -> Traced {
        self.eye.trace_with(ray, &self.indices)
    }

    /// The eye and its measured wavefront, if it has one.
    pub(super) fn extra(&self) -> Option<(&SchematicEye, &ExtraWavefront)> {
        self.eye.prescription().wavefront.as_ref().map(|wavefront| (self.eye, wavefront))
    }

    pub(super) fn stop_radius_mm(&self) -> f64 {
        self.eye.stop_radius_mm
    }

    /// Flux per launch-plane area at `uv`, for unit irradiance at the apex.
    pub(super) fn irradiance(&self, uv: DVec2) -> f64 {
        self.object.irradiance(self.on_plane(uv))
    }

    fn on_plane(&self, uv: DVec2) -> DVec3 {
        self.eye.entrance_pupil + uv.x * self.e1 + uv.y * self.e2
    }

    fn stop(&self, uv: DVec2) -> Option<DVec2> {
        self.eye.stop_point(&self.launch(uv).0, &self.indices)
    }

    /// d(stop)/d(uv) by central differences.
    pub(super) fn slope(&self, uv: DVec2) -> Option<DMat2> {
        let column = |e: DVec2| Some((self.stop(uv + e)? - self.stop(uv - e)?) / (2.0 * STEP_MM));
        Some(DMat2::from_cols(column(DVec2::new(STEP_MM, 0.0))?, column(DVec2::new(0.0, STEP_MM))?))
    }

    /// Damped Newton from `start`: the launch point of the ray through `target` of the stop.
    fn newton(&self, target: DVec2, start: DVec2) -> Option<DVec2> {
        let mut uv = start;
        let mut miss = self.stop(uv)? - target;
        for _ in 0..40 {
            if miss.length() <= TOLERANCE_MM {
                return Some(uv);
            }
            let step = solve(self.slope(uv)?, miss)?;
            let mut part = 1.0;
            let better = loop {
                let next = uv - part * step;
                match self.stop(next).map(|s| (next, s - target)) {
                    Some((next, m)) if m.length() < miss.length() => break Some((next, m)),
                    Some(_) | None => part *= 0.5,
                }
                if part < 1e-6 {
                    break None;
                }
            };
            let Some((next, m)) = better else {
                // No better point: as close as rounding lets it come, or lost.
                return (miss.length() <= 1e3 * TOLERANCE_MM).then_some(uv);
            };
            (uv, miss) = (next, m);
        }
        None
    }

    /// Launch point of the ray through the stop's centre. Far from the axis the angle is approached in steps.
    pub(super) fn chief(&self) -> Option<DVec2> {
        if let Some(uv) = self.newton(DVec2::ZERO, DVec2::ZERO) {
            return Some(uv);
        }
        let angle = self.object.angle_deg().to_radians();
        let d = self.object.direction();
        let across = DVec3::new(d.x, d.y, 0.0).try_normalize()?;
        let mut uv = DVec2::ZERO;
        for k in 1..=32 {
            let (sin, cos) = (angle * f64::from(k) / 32.0).sin_cos();
            let object = Object::from_parts(sin * across + cos * DVec3::Z, self.object.vergence_per_mm());
            let nearer = Self::with_indices(self.eye, object, self.indices);
            uv = nearer.newton(DVec2::ZERO, uv)?;
        }
        Some(uv)
    }

    /// Launch point of the ray through `target` of the stop, from a nearby one.
    pub(super) fn through(&self, target: DVec2, start: DVec2) -> Option<DVec2> {
        self.newton(target, start)
    }

    /// The ray that meets the stop at `target`, by Broyden's method from a nearby launch point with its inverse
    /// slope, which is improved on the way; by Newton's when that does not settle.
    pub(super) fn near(&self, target: DVec2, start: Launch) -> Option<Aimed> {
        let mut launch = start;
        let mut miss = self.stop(launch.uv)? - target;
        for _ in 0..12 {
            if miss.length() <= TOLERANCE_MM {
                return self.aimed(launch);
            }
            let step = -(launch.inverse * miss);
            launch.uv += step;
            // A miss shrinks by some thousand a step: the trace itself is the last check.
            let traced = (miss.length() <= GAIN * TOLERANCE_MM).then(|| self.aimed(launch)).flatten();
            let Some(s) = traced.map(|aimed| aimed.stop).or_else(|| self.stop(launch.uv)) else { break };
            let change = (s - target) - miss;
            miss = s - target;
            let moved = launch.inverse * change;
            let scale = step.dot(moved);
            if scale.abs() > 1e-300 {
                let error = (step - moved) / scale;
                let row = launch.inverse.transpose() * step;
                launch.inverse += DMat2::from_cols(error * row.x, error * row.y);
            }
            if let Some(aimed) = traced
                && miss.length() <= TOLERANCE_MM
            {
                return Some(Aimed { launch, ..aimed });
            }
        }
        self.aimed(Launch { uv: self.newton(target, start.uv)?, ..start })
    }

    /// The ray of a launch point, and where it crosses the stop.
    fn aimed(&self, launch: Launch) -> Option<Aimed> {
        let (ray, path_before) = self.launch(launch.uv);
        let traced = self.trace(&ray);
        let crossing = traced.stop?;
        let stop = DVec2::new(crossing.x, crossing.y + self.eye.state.decentre_mm);
        Some(Aimed { launch, stop, path_before, traced })
    }
}

fn solve(m: DMat2, v: DVec2) -> Option<DVec2> {
    let det = m.determinant();
    (det.abs() > 1e-12).then(|| m.inverse() * v)
}

impl SchematicEye {
    /// The chief ray of an object: through the centre of the real stop, traced at a vacuum wavelength (nm). Path lengths
    /// count from 25 mm before the entrance pupil.
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when none gets to the retina; [`OpticsError::OutOfRange`] for the wavelength.
    pub fn chief_ray(&self, object: Object, wavelength_nm: f64) -> Result<Traced, OpticsError> {
        let lost = OpticsError::NoRay { angle_deg: object.angle_deg() };
        let aimer = Aimer::new(self, object, wavelength_nm)?;
        let Some(uv) = aimer.chief() else { return Err(lost) };
        let traced = self.trace_with(&aimer.launch(uv).0, &aimer.indices);
        if traced.fate == RayFate::Arrived { Ok(traced) } else { Err(lost) }
    }

    /// Radius (mm) of the entrance pupil as the light of the foveal centre meets it, without its aberration: stop radius times √det of
    /// d(launch)/d(stop) at the foveal chief ray, at the reference wavelength.
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when that ray does not reach the stop.
    pub fn entrance_radius_mm(&self) -> Result<f64, OpticsError> {
        let p = self.prescription();
        let object = Object::field(p.fovea_angle_deg, 1e3 / self.object_distance_mm())?;
        let aimer = Aimer::new(self, object, p.reference_wavelength_nm)?;
        let slope = aimer.chief().and_then(|uv| aimer.slope(uv));
        let slope = slope.ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })?;
        Ok(self.stop_radius_mm() / slope.determinant().abs().sqrt())
    }
}
