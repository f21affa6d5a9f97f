//! Where the display is seen, for people: its distance, its corners, its pixels per degree; and a warning when what it
//! shows falls beside the patch.

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::focus::Focused;
use super::setup::{Setup, fixation};
use super::{PlanError, PlannedTile, lit};
use crate::experiment::Experiment;
use crate::video::ScreenView;

/// Where the display is seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DisplaySeen {
    /// Distance of the fixated point from the corneal apex, cm.
    pub fixated_cm: f64,
    /// How far the eye is turned from straight ahead, degrees.
    pub turned_deg: f64,
    /// Visual angle of the corners from the line of sight, degrees right and up: top left, top right, bottom left,
    /// bottom right.
    pub corners_deg: [[f64; 2]; 4],
    /// Pixels per degree at the gaze centre, along rows and columns.
    pub px_per_deg: [f64; 2],
    /// Fewest and most pixels per degree, along rows or columns, at the corners and the middles of the edges.
    pub px_per_deg_at_edges: [f64; 2],
}

/// Where an experiment's display is seen.
///
/// # Errors
/// When the eye cannot look at the gaze centre.
pub fn display_seen(experiment: &Experiment) -> Result<DisplaySeen, PlanError> {
    let fixation = fixation(experiment)?;
    let view = ScreenView::of(experiment)?;
    let display = &experiment.display;
    let size = DVec2::new(f64::from(display.width_px), f64::from(display.height_px));
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|part| size * DVec2::from(part));
    let middles = [[0.5, 0.0], [0.0, 0.5], [1.0, 0.5], [0.5, 1.0]].map(|part| size * DVec2::from(part));
    let densities: Vec<f64> =
        corners.iter().chain(&middles).flat_map(|px| view.pixel_deg_at(*px)).map(f64::recip).collect();
    Ok(DisplaySeen {
        fixated_cm: 0.1 * fixation.screen.fixated_mm(),
        turned_deg: fixation.turned_deg(),
        corners_deg: corners.map(|px| view.visual_deg(px).to_array()),
        px_per_deg: view.pixel_deg_at(view.gaze_px).map(f64::recip),
        px_per_deg_at_edges: [
            densities.iter().copied().fold(f64::MAX, f64::min),
            densities.iter().copied().fold(0.0, f64::max),
        ],
    })
}

/// Blur in the foveal centre that is said, dioptres: about what a reader notices.
const NOTICED_D: f64 = 0.25;

/// The warning of an eye that is out of focus though it may accommodate.
pub(super) fn blur_warning(experiment: &Experiment, focus: &Focused) -> Option<String> {
    let is_seen = !experiment.eye.relaxed && focus.residual_d.abs() > NOTICED_D;
    let why = if focus.residual_d > 0.0 {
        format!("its far point is at {:.2} D", focus.far_point_d)
    } else {
        format!("it accommodates by {:.2} D at most", focus.accommodation_d)
    };
    is_seen.then(|| {
        format!(
            "eye.focus: the eye is {:.2} D out of focus for an object at {:.2} D: {why}",
            focus.residual_d.abs(),
            focus.wanted_d
        )
    })
}

/// What a plan warns of: a dark picture, or one that no cone of the patch sees.
pub(super) fn warnings(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> Vec<String> {
    let Some([lit_min, lit_max]) = lit::bounds_px(experiment) else {
        return vec!["video: the picture is dark, no pixel is lit".into()];
    };

    // Find the gap between the lit pixels and what the cones of any tile see while the eye moves.
    let gap = |tile: &PlannedTile| -> Option<DVec2> {
        let first = DVec2::new(f64::from(tile.scene.first_px[0]), f64::from(tile.scene.first_px[1]));
        let [low, high] = setup
            .gaze_of(&tile.region)
            .ok()?
            .bounds()
            .map(|at| DVec2::new(at.x, -at.y) / tile.scene.tangent_per_px);
        let (low, high) = (low.min(high), low.max(high));
        let [cones_min, cones_max] = tile.scene.cones_px.map(|px| px + first);
        let (seen_min, seen_max) = (cones_min + low, cones_max + high);
        Some((lit_min - seen_max).max(seen_min - lit_max).max(DVec2::ZERO))
    };
    let gaps: Option<Vec<DVec2>> = tiles.iter().map(gap).collect();
    let nearest = gaps.and_then(|gaps| gaps.into_iter().min_by(|a, b| a.length().total_cmp(&b.length())));
    let Some(away_px) = nearest.filter(|gap| gap.length() > 0.0) else { return Vec::new() };
    let Ok(view) = ScreenView::of(experiment) else { return Vec::new() };
    let [across, down] = view.pixel_deg();
    let away_deg = (away_px.x * across).hypot(away_px.y * down);
    vec![format!(
        "retina.region_deg: no cone of the patch looks at a lit pixel, the nearest is {away_deg:.2}° away; see \
         gaze.center_px, the signs of gaze.movement (x right, y up) and the patch"
    )]
}
