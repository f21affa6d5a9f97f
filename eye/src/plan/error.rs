//! The error estimate: relative error of the mean per cone (L1 over cones) by its parts, for the settings that were chosen.

use super::setup::Setup;
use super::wavelengths::Wavelengths;
use super::{ErrorPart, PlannedTile};
use crate::experiment::Experiment;

/// The parts of the estimate.
pub fn estimate(
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    wavelengths: &Wavelengths,
) -> Vec<ErrorPart> {
    let target = experiment.accuracy_target;
    let part = |part: &str, relative: f64| ErrorPart { part: part.into(), relative };
    // Measured at 3 mm: snapping the spread by half a degree costs 8e-3; interpolation over n nodes gains the n-th power of the
    // step per node in degrees.
    let field = |tile: &PlannedTile| {
        let nodes = f64::from(tile.kernels.field_nodes[0]);
        8e-3 * (super::half_side_deg(&tile.region) / nodes).powf(nodes).min(1.0)
    };
    let field = tiles.iter().map(field).fold(0.0, f64::max);
    let limited = tiles.iter().any(|t| t.scene.band < super::setup::cutoff(experiment));
    let guard = 0.5 * 0.62 * 3.0 / experiment.eye.pupil_mm / setup.guard_um;
    vec![
        part("wavelength steps", 2e-4 * (wavelengths.step_nm / 10.0).powi(2)),
        part("wavelengths left out", wavelengths.outside),
        part("field interpolation", field),
        part("low-rank kernels", 0.02 * super::BASIS_SHARE * target),
        part("period", guard),
        part("band limit", if limited { 0.15 * target } else { 1e-6 }),
    ]
}
