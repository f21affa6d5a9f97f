//! The largest count that a cone can reach in a frame, and the refusal of exposures whose counts do not fit in 32
//! bits.

use glam::DVec2;

use super::PlanError;
use super::setup::Setup;
use crate::display::{Emitter, White, emitters, pupil_share};
use crate::experiment::{Experiment, RangeError};
use crate::retina::Density;

/// The largest count: results are unsigned numbers of 32 bits.
pub const LARGEST_COUNT: f64 = u32::MAX as f64;

/// Most isomerizations per photon that enters the pupil: 2/3 of what the densest foveal pigment absorbs at its
/// peak behind the clearest lens.
const MOST_CAUGHT: f64 = 0.45;
/// Area of the largest cell over the mean one, about.
const LARGEST_CELL: f64 = 2.0;
/// Points along each side of the patch at which cells are looked at.
const STEPS: u32 = 8;

/// A bound on the mean count of any cone in a frame: a white screen, the largest aperture, the best wavelength.
///
/// # Errors
/// When the display gives no light that is seen or the patch sees no screen.
pub fn largest_mean(experiment: &Experiment, setup: &Setup) -> Result<f64, PlanError> {
    let display = &experiment.display;

    // Take the photons that enter the pupil, per unit of area on the screen (unit tangents).
    let emitters = emitters(display).map_err(PlanError::Model)?;
    let emitted: f64 = emitters.iter().map(Emitter::emitted).sum();
    let per_px = display.pixel_pitch_cm / display.distance_cm;
    let density = emitted * pupil_share(display, experiment.eye.pupil_mm) / (per_px * per_px);

    // Look for the aperture with the largest area on the screen.
    let law = Density::new(&setup.retina);
    let side = setup.region.max - setup.region.min;
    let places = (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |j| DVec2::new(f64::from(i), f64::from(j))));
    let mut largest = 0.0_f64;
    for place in places {
        let um = setup.region.min + side * place / f64::from(STEPS);
        let Ok(tangent) = setup.projection.screen_tangent(um) else { continue };
        let slope = setup.projection.jacobian_um_per_tangent(tangent);
        let per_tangent = slope.map_err(|e| PlanError::Model(e.to_string()))?.determinant().abs();
        let aperture_um2 = 1e6 * law.coverage(um) / law.per_mm2(um).max(1.0);
        // Nearer parts of a tilted screen send more than a point at the nominal distance.
        let nearer = setup.projection.screen().nearness(tangent).max(1.0);
        largest = largest.max(nearer * aperture_um2 / per_tangent);
    }
    Ok(density * LARGEST_CELL * largest * MOST_CAUGHT
        + experiment.retina.dark_isomerizations_per_s / display.frame_rate_hz)
}

/// Refuses an experiment whose counts might not fit.
///
/// # Errors
/// The field of the display's light, with the largest value; or those of [`largest_mean`].
pub fn check(experiment: &Experiment, setup: &Setup) -> Result<(), PlanError> {
    if !experiment.counts.poisson {
        return Ok(());
    }
    let most = largest_mean(experiment, setup)?;
    if most <= LARGEST_COUNT {
        return Ok(());
    }
    let (field, value) = match experiment.display.white {
        White::LuminanceCdM2(luminance) => ("display.white_luminance_cd_m2", luminance),
        White::Lumens(lumens) => ("display.lumens", lumens),
    };
    let allowed = format!(
        "at most {:.2e} in frames of {:.3e} s, since a cone could count {most:.1e} photons and the largest count is \
         {LARGEST_COUNT}; counts.noise NONE gives means, which have no upper limit",
        value * LARGEST_COUNT / most,
        1.0 / experiment.display.frame_rate_hz,
    );
    Err(RangeError::new(field, value, &allowed).into())
}
