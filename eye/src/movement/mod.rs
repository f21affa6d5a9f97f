//! Eye movement during viewing (§11): where the line of sight meets the screen at a time.
//!
//! A drift turns the eye at a steady rate from a start at rest on the fixated point; the axis lies in Listing's plane, so there is
//! no torsion. Orientations are quaternions, interpolated between rest and the end of the drift; the line of sight turns about
//! the rotation centre, 13.5 mm behind the corneal apex. Within a frame the movement is affine on the screen; its linear part
//! differs from 1 by the angle squared (1e-10 for the default drift in a frame), so a frame has one shift at its start and one
//! at its end.
//!
//! # Stability
//! The usual slerp through acos is NaN or 0/0 below 1e-8 rad; here the angle is known, so no arc cosine is taken.

use glam::{DQuat, DVec2, DVec3};

use crate::experiment::{Movement, RangeError};

/// Rotation centre behind the corneal apex, cm.
const ROTATION_CENTRE_CM: f64 = 1.35;
/// Largest turn that is served, degrees.
const MAX_TURN_DEG: f64 = 45.0;

/// Movement in front of a screen.
#[derive(Clone, Copy, Debug)]
pub struct Gaze {
    radians_per_s: f64,
    /// Unit direction in the visual field, x right, y up.
    direction: DVec2,
    /// Distance of the screen from the rotation centre over its distance from the apex.
    lever: f64,
}

impl Gaze {
    /// A movement in front of a screen at a distance (cm) for a duration (s).
    ///
    /// # Errors
    /// When the eye would turn by more than 45°.
    pub fn new(movement: Movement, distance_cm: f64, duration_s: f64) -> Result<Self, RangeError> {
        let (speed, direction_deg) = match movement {
            Movement::Still => (0.0, 0.0),
            Movement::Drift { speed_arcmin_per_s, direction_deg } => (speed_arcmin_per_s, direction_deg),
        };
        let turn_deg = speed / 60.0 * duration_s;
        if turn_deg > MAX_TURN_DEG {
            let allowed =
                format!("at most {MAX_TURN_DEG}° over all frames ({duration_s} s), here it is {turn_deg}°");
            return Err(RangeError::new("gaze.movement.drift.speed_arcmin_per_s", speed, &allowed));
        }
        Ok(Self {
            radians_per_s: (speed / 60.0).to_radians(),
            direction: DVec2::from_angle(direction_deg.to_radians()),
            lever: 1.0 + ROTATION_CENTRE_CM / distance_cm,
        })
    }

    /// Orientation of the eye relative to rest at time `t_s`; axes x right, y up, z towards the viewer.
    pub fn orientation(&self, t_s: f64) -> DQuat {
        // The eye looks along -z; a turn about (y, -x) carries -z towards (x, y).
        let axis = DVec3::new(self.direction.y, -self.direction.x, 0.0);
        DQuat::from_axis_angle(axis, self.radians_per_s * t_s)
    }

    /// Where the line of sight meets the screen: (X, Y)/distance from the fixated point, X right, Y up.
    pub fn screen_tangent(&self, t_s: f64) -> DVec2 {
        let sight = self.orientation(t_s) * DVec3::NEG_Z;
        DVec2::new(sight.x, sight.y) / -sight.z * self.lever
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_drift_goes_right_and_up() {
        let drift = Movement::Drift { speed_arcmin_per_s: 6.0, direction_deg: 30.0 };
        let gaze = Gaze::new(drift, 1e12, 1.0).unwrap();
        let shift = gaze.screen_tangent(1.0);
        let angle = (0.1_f64).to_radians();
        assert!((shift - angle.tan() * DVec2::new(3_f64.sqrt() / 2.0, 0.5)).length() < 1e-12);
        // A frame: 1.7e-5 rad/s x 1/60 s keeps all its digits.
        let frame = gaze.screen_tangent(1.0 / 60.0).length();
        assert!((frame / (angle / 60.0) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn still_is_still_and_too_far_is_refused() {
        let still = Gaze::new(Movement::Still, 100.0, 1e5).unwrap();
        assert_eq!(still.screen_tangent(77.0), DVec2::ZERO);
        let wild = Movement::Drift { speed_arcmin_per_s: 60000.0, direction_deg: 0.0 };
        assert!(Gaze::new(wild, 100.0, 1.0).is_err());
        assert!(Gaze::new(wild, 100.0, 0.01).is_ok());
    }
}
