//! Where the points of a screen are before the eye: across the line of sight, or in any place, flat or curved.
//!
//! # Frame
//! Origin at the corneal apex; x to the viewer's right, y up, z towards the viewer, against the line of sight:
//! the fixated point is at (0, 0, −r).
//!
//! # Coordinates
//! A point of the screen is named by `t`, its distance on the screen from the fixated point to the right and up,
//! over the nominal viewing distance D. Of a screen across the line of sight at the distance D `t` is the tangent
//! of the angle along each axis; D may be infinite there. On a curved screen x is the length of the arc.
//!
//! A curved screen is a part of a cylinder whose axis is parallel to the screen's columns, on the viewer's side.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::math;

/// A screen before the eye that fixates a point of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Screen {
    /// Nominal viewing distance D, mm.
    nominal_mm: f64,
    /// `None`: across the line of sight at that distance.
    oblique: Option<Oblique>,
}

/// A screen that is not across the line of sight, or curved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Oblique {
    /// Distance of the fixated point from the corneal apex, mm.
    pub fixated_mm: f64,
    /// Unit vector along the screen's rows at the fixated point, to the right.
    pub right: DVec3,
    /// Unit vector along the screen's columns, up.
    pub up: DVec3,
    /// 1/radius of the cylinder, 1/mm; 0 is flat.
    pub curvature_per_mm: f64,
}

impl Oblique {
    /// The normal at the fixated point, towards the viewer.
    fn normal(&self) -> DVec3 {
        self.right.cross(self.up)
    }
}

impl Screen {
    /// A flat screen across the line of sight, the fixated point at `distance_mm` (may be infinite).
    pub fn frontal(distance_mm: f64) -> Self {
        Self { nominal_mm: distance_mm, oblique: None }
    }

    /// A screen in any place; `nominal_mm` is the unit of its coordinates.
    pub fn oblique(nominal_mm: f64, oblique: Oblique) -> Self {
        Self { nominal_mm, oblique: Some(oblique) }
    }

    /// Whether it is flat and across the line of sight.
    pub fn is_frontal(&self) -> bool {
        self.oblique.is_none()
    }

    /// Nominal viewing distance D, mm.
    pub fn nominal_mm(&self) -> f64 {
        self.nominal_mm
    }

    /// Distance of the fixated point from the corneal apex, mm.
    pub fn fixated_mm(&self) -> f64 {
        self.oblique.map_or(self.nominal_mm, |oblique| oblique.fixated_mm)
    }

    /// The way from the corneal apex to the point `t`, over D.
    pub fn way(&self, t: DVec2) -> DVec3 {
        let Some(oblique) = self.oblique else { return DVec3::new(t.x, t.y, -1.0) };
        let origin = DVec3::new(0.0, 0.0, -oblique.fixated_mm / self.nominal_mm);
        // Chord along the rows and depth towards the viewer of an arc of length t.x.
        let curvature = oblique.curvature_per_mm * self.nominal_mm;
        let turn = curvature * t.x;
        let (along, depth) = if curvature > 0.0 {
            let half = math::sin_cos(0.5 * turn).0;
            (math::sin_cos(turn).0 / curvature, 2.0 * half * half / curvature)
        } else {
            (t.x, 0.0)
        };
        origin + along * oblique.right + t.y * oblique.up + depth * oblique.normal()
    }

    /// Unit vector in which light of the point `t` travels to the corneal apex, in a frame of which the view
    /// frame's axes are given, and its distance over D.
    pub(super) fn light_from(&self, t: DVec2, [right, up, forward]: [DVec3; 3]) -> (DVec3, f64) {
        let way = self.way(t);
        let length = if self.is_frontal() { 1.0_f64.hypot(t.length()) } else { way.length() };
        ((-way.z * forward - way.x * right - way.y * up) / length, length)
    }

    /// Distance of the point `t` from the corneal apex, mm.
    pub fn distance_mm(&self, t: DVec2) -> f64 {
        self.nominal_mm * self.way(t).length()
    }

    /// Cosine of the angle between the screen's normal and the way to the corneal apex at the point `t`; 0 where
    /// the screen is seen from behind.
    pub fn emission_cosine(&self, t: DVec2) -> f64 {
        if self.is_frontal() {
            return self.nearness(t).sqrt();
        }
        (-self.way(t).normalize().dot(self.normal(t))).max(0.0)
    }

    /// The normal at the point `t`, towards the viewer.
    pub fn normal(&self, t: DVec2) -> DVec3 {
        let Some(oblique) = self.oblique else { return DVec3::Z };
        let (sin, cos) = math::sin_cos(oblique.curvature_per_mm * self.nominal_mm * t.x);
        cos * oblique.normal() - sin * oblique.right
    }

    /// (D / distance of the point `t` from the corneal apex)².
    pub fn nearness(&self, t: DVec2) -> f64 {
        if self.is_frontal() {
            1.0 / (1.0 + t.length_squared())
        } else {
            self.way(t).length_squared().recip()
        }
    }

    /// Solid angle per unit of `t.x t.y`, sr, seen from the corneal apex.
    pub fn solid_angle(&self, t: DVec2) -> f64 {
        if self.is_frontal() {
            return 1.0 / (1.0 + t.length_squared()).powf(1.5);
        }
        self.emission_cosine(t) * self.nearness(t)
    }

    /// Visual angle of the point `t` from the line of sight, degrees right and up: the angle, along the direction.
    pub fn visual_deg(&self, t: DVec2) -> DVec2 {
        if self.is_frontal() {
            return t.normalize_or_zero() * t.length().atan().to_degrees();
        }
        let way = self.way(t);
        let across = way.truncate();
        across.normalize_or_zero() * across.length().atan2(-way.z).to_degrees()
    }

    /// Visual eccentricity of the point `t`, degrees.
    pub fn eccentricity_deg(&self, t: DVec2) -> f64 {
        if self.is_frontal() { t.length().atan().to_degrees() } else { self.visual_deg(t).length() }
    }

    /// The point seen at visual angles (degrees right and up) from the line of sight; `None` when no point is.
    pub fn at_visual_deg(&self, deg: DVec2) -> Option<DVec2> {
        let (sin, cos) = math::sin_cos(deg.length().to_radians());
        self.met_by(DVec3::ZERO, (deg.normalize_or_zero() * sin).extend(-cos))
    }

    /// The point that a ray from `from` (over D) along `along` meets first from the front; `None` when it meets none.
    pub fn met_by(&self, from: DVec3, along: DVec3) -> Option<DVec2> {
        let Some(oblique) = self.oblique else {
            let steps = -(1.0 + from.z) / along.z;
            return (steps > 0.0 && along.z < 0.0).then(|| (from + steps * along).truncate());
        };
        // Coordinates along the rows, the columns and the normal, from the fixated point.
        let axes = [oblique.right, oblique.up, oblique.normal()];
        let own = |v: DVec3| DVec3::from_array(axes.map(|axis| axis.dot(v)));
        let from = own(from + DVec3::new(0.0, 0.0, oblique.fixated_mm / self.nominal_mm));
        let along = own(along);
        let curvature = oblique.curvature_per_mm * self.nominal_mm;
        if curvature <= 0.0 {
            let steps = -from.z / along.z;
            return (steps > 0.0 && along.z < 0.0).then(|| (from + steps * along).truncate());
        }
        // Circle x² + (z − R)² = R², that is, κ (x² + z²) = 2 z; the far point is the one seen from the front.
        let a = curvature * (along.x * along.x + along.z * along.z);
        let b = curvature * (from.x * along.x + from.z * along.z) - along.z;
        let c = curvature * (from.x * from.x + from.z * from.z) - 2.0 * from.z;
        let root = (b * b - a * c).max(0.0).sqrt();
        let steps = if b > 0.0 { -c / (b + root) } else { (root - b) / a };
        let at = from + steps * along;
        let turn = (curvature * at.x).atan2(1.0 - curvature * at.z);
        let is_met = b * b >= a * c && steps > 0.0 && turn.abs() < FRAC_PI_2;
        is_met.then(|| DVec2::new(turn / curvature, at.y))
    }

    /// Whether a pixel can be seen: whether it faces the eye. `t` is the place of the pixel.
    pub fn faces_eye(&self, t: DVec2) -> bool {
        let turn = self.oblique.map_or(0.0, |oblique| oblique.curvature_per_mm * self.nominal_mm * t.x);
        turn.abs() < FRAC_PI_2 && self.emission_cosine(t) > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn turned(curvature_per_mm: f64) -> Screen {
        let turn = DQuat::from_rotation_y(0.3) * DQuat::from_rotation_x(-0.2);
        let (right, up) = (turn * DVec3::X, turn * DVec3::Y);
        Screen::oblique(600.0, Oblique { fixated_mm: 640.0, right, up, curvature_per_mm })
    }

    /// Way and ray are inverse to each other, from the apex and from beside it.
    #[test]
    fn rays_meet_the_points_that_they_go_to() {
        for screen in [Screen::frontal(600.0), turned(0.0), turned(1e-3), turned(2e-3)] {
            for t in [DVec2::ZERO, DVec2::new(0.4, -0.3), DVec2::new(-0.5, 0.2)] {
                let way = screen.way(t);
                for from in [DVec3::ZERO, DVec3::new(0.02, -0.01, 0.02)] {
                    let found = screen.met_by(from, 3.0 * (way - from)).unwrap();
                    assert!((found - t).length() < 1e-12, "{screen:?} {t} {found}");
                }
                let seen = screen.at_visual_deg(screen.visual_deg(t)).unwrap();
                assert!((seen - t).length() < 1e-12, "{screen:?} {t} {seen}");
            }
        }
        assert_eq!(turned(0.0).met_by(DVec3::ZERO, DVec3::Z), None);
        assert_eq!(Screen::frontal(600.0).at_visual_deg(DVec2::new(90.1, 0.0)), None);
    }

    /// The solid angle is that of the corners of a small square of the screen, and the area seen is the emission's.
    #[test]
    fn solid_angles_are_those_of_small_squares() {
        let h = 1e-4;
        for screen in [Screen::frontal(600.0), turned(0.0), turned(1e-3)] {
            for t in [DVec2::ZERO, DVec2::new(0.4, -0.3), DVec2::new(-0.5, 0.2)] {
                let at = |x: f64, y: f64| screen.way(t + h * DVec2::new(x, y)).normalize();
                let (x, y) = (at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5));
                let expected = x.cross(y).length() / (h * h);
                assert!((screen.solid_angle(t) / expected - 1.0).abs() < 1e-6, "{screen:?} {t}");
            }
        }
    }

    /// A cylinder about the eye: all points of a row are as far off and face the eye.
    #[test]
    fn a_cylinder_about_the_eye_is_equally_far() {
        let oblique =
            Oblique { fixated_mm: 500.0, right: DVec3::X, up: DVec3::Y, curvature_per_mm: 1.0 / 500.0 };
        let screen = Screen::oblique(500.0, oblique);
        for x in [-1.2, -0.3, 0.0, 0.7] {
            let t = DVec2::new(x, 0.0);
            assert!((screen.distance_mm(t) - 500.0).abs() < 1e-9);
            assert!((screen.emission_cosine(t) - 1.0).abs() < 1e-12);
            assert!((screen.visual_deg(t).x - x.to_degrees()).abs() < 1e-9);
        }
    }
}
