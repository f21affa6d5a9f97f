//! Positions on the retina: a sphere, measured from the foveal centre (model conventions).
//!
//! (x_um, y_um) is azimuthal equidistant: arc length from the foveal centre times (cos, sin) of the meridian; meridian
//! 0 is nasal retina (towards −y of the eye frame), 90° superior retina (up in either eye).

use super::prescription::Side;
use glam::{DVec2, DVec3};

/// The foveal centre and the frame of retinal positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fovea {
    /// The foveal centre, mm, eye frame.
    pub position: DVec3,
    /// Unit tangent towards nasal retina (+x_um) at the foveal centre.
    pub nasal: DVec3,
    /// Unit tangent towards superior retina (+y_um) at the foveal centre.
    pub superior: DVec3,
    /// Unit normal out of the eye at the foveal centre (from the centre of the retinal sphere).
    pub outward: DVec3,
    /// Centre of the retinal sphere, mm.
    pub centre: DVec3,
    /// Radius of the retinal sphere, mm, positive.
    pub radius_mm: f64,
}

impl Fovea {
    /// The frame of a fovea at `position` (mm) on the sphere about `centre`. It lies in the plane x = 0, unless the surfaces are
    /// toric at an oblique axis; then superior is the tangent nearest to that of the plane.
    pub fn new(position: DVec3, centre: DVec3, side: Side) -> Self {
        let arm = position - centre;
        let radius_mm = arm.length();
        let outward = arm / radius_mm;
        let superior = match side {
            Side::Right => DVec3::NEG_X,
            Side::Left => DVec3::X,
        };
        if outward.x.abs() > 1e-9 {
            let superior = superior - superior.dot(outward) * outward;
            let superior = superior / superior.length().max(1e-300);
            let nasal = if side == Side::Right { outward.cross(superior) } else { superior.cross(outward) };
            return Self { position, nasal, superior, outward, centre, radius_mm };
        }
        // Nasal completes the frame: towards −y whichever side.
        let nasal = DVec3::new(0.0, -outward.z, outward.y);
        Self { position, nasal, superior, outward, centre, radius_mm }
    }

    /// Eccentricity (radians of retinal arc) and meridian (radians) of a point of the retina.
    pub fn polar(&self, point: DVec3) -> (f64, f64) {
        let arm = point - self.centre;
        let (x, y) = (arm.dot(self.nasal), arm.dot(self.superior));
        (x.hypot(y).atan2(arm.dot(self.outward)), y.atan2(x))
    }

    /// (x_um, y_um) of a point of the retina (mm, eye frame).
    pub fn um_from_point(&self, point: DVec3) -> DVec2 {
        let (ecc, meridian) = self.polar(point);
        DVec2::from_angle(meridian) * (ecc * self.radius_mm * 1e3)
    }

    /// The point (mm, eye frame) at (x_um, y_um).
    pub fn point_from_um(&self, um: DVec2) -> DVec3 {
        let length = um.length();
        let ecc = length / (self.radius_mm * 1e3);
        let way = if length > 0.0 { um / length } else { DVec2::X };
        let across = way.x * self.nasal + way.y * self.superior;
        self.centre + self.radius_mm * (ecc.sin() * across + ecc.cos() * self.outward)
    }

    /// Local frame at a point of the retina: unit tangents along x_um and y_um (the foveal ones carried along the great
    /// circle, so they stay at right angles), and the normal into the eye.
    pub fn local_frame(&self, point: DVec3) -> [DVec3; 3] {
        let (ecc, meridian) = self.polar(point);
        let (sin, cos) = meridian.sin_cos();
        let across = cos * self.nasal + sin * self.superior;
        let radial = ecc.cos() * across - ecc.sin() * self.outward;
        let around = cos * self.superior - sin * self.nasal;
        let normal = -(ecc.sin() * across + ecc.cos() * self.outward);
        [cos * radial - sin * around, sin * radial + cos * around, normal]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frame of a fovea off the plane of symmetry goes over into that of one in it.
    #[test]
    fn frames_off_the_plane_of_symmetry() {
        for side in [Side::Right, Side::Left] {
            let frame = |x: f64| Fovea::new(DVec3::new(x, 1.4, 23.8), DVec3::new(0.0, 0.0, 11.9), side);
            let (on, off) = (frame(0.0), frame(1e-6));
            assert!(
                (on.nasal - off.nasal).length() + (on.superior - off.superior).length() < 1e-6,
                "{side:?}"
            );
            let f = frame(0.3);
            assert!(f.nasal.dot(f.superior).abs() + f.nasal.dot(f.outward).abs() < 1e-15);
            assert!(
                f.um_from_point(f.point_from_um(DVec2::new(500.0, -300.0)))
                    .distance(DVec2::new(500.0, -300.0))
                    < 1e-8
            );
        }
    }
}
