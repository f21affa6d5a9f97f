//! Where the pixels of a display are seen, for patterns whose sizes are visual angles.
//!
//! Sizes hold at the gaze centre: a pixel is as large everywhere as it is there. Across the line of sight that is
//! `atan(pitch/distance)`; on a screen in another place it is what the pixel at the gaze centre subtends along its
//! rows and columns. [`ScreenView::visual_deg`] is where a pixel really is.

use glam::{DMat2, DVec2};

use crate::display::Display;
use crate::experiment::{Experiment, Gaze, SizesHold};
use crate::optics::Screen;
use crate::plan::PlanError;
use crate::plan::setup::fixation;

/// Step of the derivatives, units of the screen.
const STEP: f64 = 1e-4;

/// A display as an eye sees it that fixates a point of it.
#[derive(Clone, Copy, Debug)]
pub struct ScreenView<'a> {
    /// The display.
    pub display: &'a Display,
    /// The fixated point, pixels from the left and from the top.
    pub gaze_px: DVec2,
    /// The display's place before the eye.
    screen: Screen,
    /// Degrees right and up per pixel to the right and up at the gaze centre.
    deg_per_px: DMat2,
}

impl<'a> ScreenView<'a> {
    /// A display across the line of sight.
    pub fn frontal(display: &'a Display, gaze: &Gaze) -> Self {
        let deg_per_px = DMat2::from_diagonal(DVec2::splat(display.pixel_radians().to_degrees()));
        let screen = Screen::frontal(10.0 * display.distance_cm);
        Self { display, gaze_px: DVec2::from_array(gaze.center_px), screen, deg_per_px }
    }

    /// The display of an experiment.
    ///
    /// # Errors
    /// When the eye cannot look at the gaze centre.
    pub fn of(experiment: &'a Experiment) -> Result<Self, PlanError> {
        let Experiment { display, gaze, .. } = experiment;
        let screen = fixation(experiment)?.screen;
        let frontal = Self::frontal(display, gaze);
        if screen.is_frontal() {
            return Ok(frontal);
        }
        let per_px = display.pixel_pitch_cm / display.distance_cm;
        let by = |axis: DVec2| {
            (screen.visual_deg(STEP * axis) - screen.visual_deg(-STEP * axis)) * (0.5 / STEP * per_px)
        };
        Ok(Self { screen, deg_per_px: DMat2::from_cols(by(DVec2::X), by(DVec2::Y)), ..frontal })
    }

    /// Degrees that a pixel subtends along its row and its column at the gaze centre.
    pub fn pixel_deg(&self) -> [f64; 2] {
        [self.deg_per_px.x_axis, self.deg_per_px.y_axis].map(DVec2::length)
    }

    /// Degrees that a pixel at a place (pixels) subtends along its row and its column.
    pub fn pixel_deg_at(&self, px: DVec2) -> [f64; 2] {
        let per_px = self.display.pixel_pitch_cm / self.display.distance_cm;
        let from_gaze = px - self.gaze_px;
        let way =
            |step: DVec2| self.screen.way(per_px * DVec2::new(from_gaze.x + step.x, -(from_gaze.y + step.y)));
        [DVec2::X, DVec2::Y].map(|axis| {
            let (a, b) = (way(-0.5 * axis), way(0.5 * axis));
            a.cross(b).length().atan2(a.dot(b)).to_degrees()
        })
    }

    /// Pixels along a column that an arcminute is high at the gaze centre.
    pub fn px_per_arcmin(&self) -> f64 {
        if self.screen.is_frontal() {
            let arcmin = (1.0_f64 / 60.0).to_radians().tan();
            return arcmin * self.display.distance_cm / self.display.pixel_pitch_cm;
        }
        1.0 / (60.0 * self.pixel_deg()[1])
    }

    /// Degrees right and up from the gaze centre of a point (pixels), as if pixels were everywhere as they are there.
    pub fn linear_deg(&self, px: DVec2) -> DVec2 {
        let from_gaze = px - self.gaze_px;
        self.deg_per_px * DVec2::new(from_gaze.x, -from_gaze.y)
    }

    /// How far a point (pixels) is to the right of the gaze, degrees: by the pixels' size at the gaze, or by
    /// its visual angle.
    pub fn across_deg(&self, px: DVec2, sizes_hold: SizesHold) -> f64 {
        match sizes_hold {
            SizesHold::AtGaze => (px.x - self.gaze_px.x) * self.pixel_deg()[0],
            SizesHold::Everywhere => self.visual_deg(px).x,
        }
    }

    /// The left edge of the screen in the row of the gaze and its width, degrees as in
    /// [`ScreenView::across_deg`].
    pub fn edge_and_width_deg(&self, sizes_hold: SizesHold) -> [f64; 2] {
        let edge = |x: f64| self.across_deg(DVec2::new(x, self.gaze_px.y), sizes_hold);
        let left = edge(0.0);
        [left, edge(f64::from(self.display.width_px)) - left]
    }

    /// Visual angle of a point (pixels) from the line of sight, degrees right and up.
    pub fn visual_deg(&self, px: DVec2) -> DVec2 {
        let per_px = self.display.pixel_pitch_cm / self.display.distance_cm;
        let from_gaze = px - self.gaze_px;
        self.screen.visual_deg(per_px * DVec2::new(from_gaze.x, -from_gaze.y))
    }

    /// The point (pixels) seen at a visual angle, degrees right and up; `None` when no point of the screen is.
    pub fn px_at(&self, visual_deg: DVec2) -> Option<DVec2> {
        let per_px = self.display.pixel_pitch_cm / self.display.distance_cm;
        let from_gaze = self.screen.at_visual_deg(visual_deg)? / per_px;
        Some(self.gaze_px + DVec2::new(from_gaze.x, -from_gaze.y))
    }
}
