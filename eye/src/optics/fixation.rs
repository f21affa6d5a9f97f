//! An eye in a head before a screen: how it turns to fixate a point, and what it then sees where.
//!
//! The head is where the eye looks straight ahead at the display's point `eye_at_px`, along the screen's normal
//! unless the screen is tilted or turned, with the corneal apex at the viewing distance D. To fixate another point
//! the eye turns about its rotation centre, by Listing's law: from straight ahead about an axis in the plane
//! across the line of sight. The frame of the head is the view frame ([`super::screen`]) of an eye that looks
//! straight ahead.

use glam::{DQuat, DVec2, DVec3};

use super::SchematicEye;
use super::screen::{Oblique, Screen};

/// Where a screen stands before the head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenPose {
    /// Distance of the corneal apex from the point straight ahead, mm.
    pub distance_mm: f64,
    /// How far the top leans away from the viewer, degrees.
    pub tilt_deg: f64,
    /// How far the right edge is turned away from the viewer, degrees.
    pub turn_deg: f64,
    /// 1/radius of a curved screen, 1/mm; 0 is flat.
    pub curvature_per_mm: f64,
}

/// An eye that fixates a point of a screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fixation {
    /// The screen in the eye's view frame.
    pub screen: Screen,
    /// From the eye's view frame to the head's.
    pub turn: DQuat,
    /// Rotation centre in the eye's view frame, mm.
    pub rotation_centre_mm: DVec3,
}

/// Most steps of the search for the turn; it gains four digits a step.
const STEPS: u32 = 60;

/// Listing's law: the turn of an eye whose line of sight goes from straight ahead to a direction (unit vector).
pub fn listing(sight: DVec3) -> DQuat {
    // The axis is (0, 0, −1) × sight; the half angle by 1 + cos and sin, exact for the smallest turns.
    DQuat::from_xyzw(sight.y, -sight.x, 0.0, 1.0 - sight.z).normalize()
}

impl Fixation {
    /// A screen across the line of sight, whatever point of it is fixated.
    pub fn frontal(eye: &SchematicEye, distance_mm: f64) -> Self {
        let screen = Screen::frontal(distance_mm);
        Self { screen, turn: DQuat::IDENTITY, rotation_centre_mm: eye.in_view(eye.rotation_centre()) }
    }

    /// A screen that stands before the head; the fixated point is `offset_mm` to the right of and above the point
    /// straight ahead, measured on the screen. `None` when the eye does not see that point from the front.
    pub fn new(eye: &SchematicEye, pose: &ScreenPose, offset_mm: DVec2) -> Option<Self> {
        let ScreenPose { distance_mm, tilt_deg, turn_deg, curvature_per_mm } = *pose;
        let is_flat_across = [tilt_deg, turn_deg, curvature_per_mm].iter().all(|v| v.abs() <= 0.0);
        if is_flat_across && offset_mm == DVec2::ZERO {
            return Some(Self::frontal(eye, distance_mm));
        }

        // Oblique the screen before the head and find the fixated point.
        let stands =
            DQuat::from_rotation_y(turn_deg.to_radians()) * DQuat::from_rotation_x(-tilt_deg.to_radians());
        let (right, up) = (stands * DVec3::X, stands * DVec3::Y);
        let ahead =
            Screen::oblique(distance_mm, Oblique { fixated_mm: distance_mm, right, up, curvature_per_mm });
        let offset = offset_mm / distance_mm;
        if !ahead.faces_eye(offset) {
            return None;
        }
        let fixated_mm = distance_mm * ahead.way(offset);
        let along = DQuat::from_axis_angle(up, -curvature_per_mm * offset_mm.x);

        // Turn the eye: R (−C − r z) = F − C, with R by Listing's law and r the new distance.
        let centre_mm = eye.in_view(eye.rotation_centre());
        let from_centre = fixated_mm - centre_mm;
        let off_axis = centre_mm.truncate().length_squared();
        let distance = (from_centre.length_squared() - off_axis).max(0.0).sqrt() - centre_mm.z;
        let arm = -centre_mm - distance * DVec3::Z;
        let mut sight = from_centre.normalize();
        for _ in 0..STEPS {
            let missed = (from_centre - listing(sight) * arm) / distance;
            sight = (sight + missed).normalize();
            if missed.length() < 1e-15 {
                break;
            }
        }
        let turn = listing(sight);

        // See the screen from the turned eye.
        let back = turn.inverse();
        let oblique =
            Oblique { fixated_mm: distance, right: back * (along * right), up: back * up, curvature_per_mm };
        let screen = Screen::oblique(distance_mm, oblique);
        Some(Self { screen, turn, rotation_centre_mm: centre_mm })
    }

    /// How far the eye is turned from straight ahead, degrees.
    pub fn turned_deg(&self) -> f64 {
        let sight = self.turn * DVec3::NEG_Z;
        sight.truncate().length().atan2(-sight.z).to_degrees()
    }
}
