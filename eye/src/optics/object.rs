//! An object point, near or at infinity, without a large number anywhere.
//!
//! With unit propagation direction d at the corneal apex and vergence V = 1/distance (1/mm, from the apex), the path
//! from the object to a point P, less the path to the apex, is the eikonal
//! φ(P) = (V P² + 2 P·d) / (1 + √(1 + 2 V P·d + V² P²)), and the ray through P runs along ∇φ = (d + V P)/√(…).
//! V = 0 is the plane wave. No digit is lost however far the object is.

use super::error::{OpticsError, in_range};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A point source in the eye's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Object {
    direction: DVec3,
    vergence_per_mm: f64,
}

impl Object {
    /// A plane wave that travels along `direction` (eye frame, any length).
    ///
    /// # Errors
    /// [`OpticsError::NoDirection`] when the direction has no length or is not finite.
    pub fn at_infinity(direction: DVec3) -> Result<Self, OpticsError> {
        Self::with_vergence(direction, 0.0)
    }

    /// A point source at `point` (mm, eye frame), at least 50 mm from the corneal apex.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] when it is nearer or not finite.
    pub fn point(point: DVec3) -> Result<Self, OpticsError> {
        let distance = in_range("object distance (mm)", point.length(), 50.0, f64::MAX)?;
        Self::with_vergence(-point, 1.0 / distance)
    }

    /// Light that passes the apex along `direction` with vergence `vergence_per_mm` = 1/(object distance in mm);
    /// negative for light converging to a point behind the cornea.
    ///
    /// # Errors
    /// [`OpticsError::NoDirection`], or [`OpticsError::OutOfRange`] beyond ±0.02/mm (20 D).
    pub fn with_vergence(direction: DVec3, vergence_per_mm: f64) -> Result<Self, OpticsError> {
        in_range("object vergence (1/mm)", vergence_per_mm, -0.0201, 0.0201)?;
        let direction =
            direction.try_normalize().ok_or(OpticsError::NoDirection { field: "object direction" })?;
        Ok(Self { direction, vergence_per_mm })
    }

    /// The object at `angle_deg` from the optical axis in the fovea's meridian, seen along (0, sin, cos); vergence in
    /// dioptres (0 infinity, 2 a point 500 mm away).
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] for more than 180° or 20 D.
    pub fn field(angle_deg: f64, vergence_d: f64) -> Result<Self, OpticsError> {
        let a = in_range("field angle (deg)", angle_deg, -180.0, 180.0)?.to_radians();
        Self::with_vergence(DVec3::new(0.0, a.sin(), a.cos()), vergence_d * 1e-3)
    }

    /// For callers that have checked both already: unit `direction`, vergence in 1/mm.
    pub(super) fn from_parts(direction: DVec3, vergence_per_mm: f64) -> Self {
        Self { direction, vergence_per_mm }
    }

    /// Unit direction in which the light passes the corneal apex.
    pub fn direction(&self) -> DVec3 {
        self.direction
    }

    /// 1/distance from the apex, 1/mm; 0 at infinity.
    pub fn vergence_per_mm(&self) -> f64 {
        self.vergence_per_mm
    }

    /// Angle from the optical axis, degrees, 0 to 180.
    pub fn angle_deg(&self) -> f64 {
        let d = self.direction;
        d.x.hypot(d.y).atan2(d.z).to_degrees()
    }

    /// Cosine of that angle.
    pub fn cos_angle(&self) -> f64 {
        self.direction.z
    }

    /// Path from the object to `p` less the path to the apex, mm, and the unit direction of the ray at `p`.
    pub fn eikonal(&self, p: DVec3) -> (f64, DVec3) {
        let v = self.vergence_per_mm;
        let along = p.dot(self.direction);
        let root = (1.0 + 2.0 * v * along + v * v * p.length_squared()).max(1e-6).sqrt();
        let path = (v * p.length_squared() + 2.0 * along) / (1.0 + root);
        (path, (self.direction + v * p) / root)
    }

    /// Flux per area of a plane across [`Object::direction`] at `p`, for unit irradiance at the apex.
    pub fn irradiance(&self, p: DVec3) -> f64 {
        let v = self.vergence_per_mm;
        let along = p.dot(self.direction);
        let root = (1.0 + 2.0 * v * along + v * v * p.length_squared()).max(1e-6).sqrt();
        (1.0 + v * along) / (root * root * root)
    }
}
