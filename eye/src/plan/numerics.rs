//! The numerical settings of `expected`, and the wavelengths of `events`: what an accuracy target asks for, or what is fixed by hand. The only
//! place where they are chosen; docs/adr/0007 has the measurements.

use serde::{Deserialize, Serialize};

use super::Rule;
use crate::experiment::{Engine, Experiment, Pattern, RangeError, Video, check_range};

/// Settings fixed by hand; those that are not given follow from the accuracy target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Knobs {
    /// Error of the low-rank basis in its own norm.
    pub basis_tolerance: Option<f64>,
    /// Light above the highest frequency that is kept, L2, see `plan/band.rs`.
    pub band_loss: Option<f64>,
    /// Distance between a cone and the nearest copy of the blurred picture, µm.
    pub guard_um: Option<f64>,
    /// Width of the spreading kernel, samples.
    pub spread_width: Option<u32>,
    /// Samples per two cycles of the highest frequency.
    pub oversampling: Option<f64>,
    /// Points of the field along each side of a tile.
    pub field_nodes: Option<u32>,
    /// Points along eccentricity.
    pub ecc_nodes: Option<u32>,
    /// Whether images are transformed in double precision.
    pub double_precision: Option<bool>,
}

impl Knobs {
    /// Checks every range.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        let check = |name: &str, value: Option<f64>, min: f64, max: f64| {
            value.map_or(Ok(()), |v| check_range(&format!("counts.settings.{name}"), v, min, max))
        };
        check("basis_tolerance", self.basis_tolerance, 1e-9, 0.5)?;
        check("band_loss", self.band_loss, 0.0, 0.5)?;
        check("guard_um", self.guard_um, 10.0, 5000.0)?;
        check("spread_width", self.spread_width.map(f64::from), 2.0, 16.0)?;
        check("oversampling", self.oversampling, 1.02, 4.0)?;
        check("field_nodes", self.field_nodes.map(f64::from), 1.0, 12.0)?;
        check("ecc_nodes", self.ecc_nodes.map(f64::from), 1.0, 12.0)
    }
}

/// Every setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numerics {
    /// Spacing of wavelengths, nm.
    pub wavelength_step_nm: f64,
    /// Share of a cone type's catch that may lie beyond the wavelengths computed.
    pub wavelength_tail: f64,
    /// As in [`Knobs`].
    pub basis_tolerance: f64,
    /// As in [`Knobs`].
    pub band_loss: f64,
    /// As in [`Knobs`].
    pub guard_um: f64,
    /// As in [`Knobs`].
    pub spread_width: usize,
    /// As in [`Knobs`].
    pub oversampling: f64,
    /// Points of the field along each side more than the size of a tile asks for.
    pub finer_field: i32,
    /// As in [`Knobs`].
    pub ecc_nodes: u32,
    /// A type of cone that catches less than this share of what the best one does is not computed.
    pub blind_below: f64,
    /// Whether images are transformed in single precision (relative error about 1e-6 of the brightest).
    pub single: bool,
}

/// Share of the target that wavelengths left out may take.
const WAVELENGTH_TAIL: f64 = 0.01;
/// Error of the low-rank basis in its own norm, per accuracy target. At 1e-3 (squares of one pixel, one lit pixel): 0.1 leaves an L1 of
/// 1.0e-4 and 2.3e-4 with 16 images, 0.6 5.3e-4 and 3.9e-4 with 12, 1.0 6.1e-4 and 1.4e-3 with 10. With more points of the field 0.6 left up to 2e-3 of one lit pixel, 0.45 4e-4.
const BASIS_SHARE: f64 = 0.4;
/// The same for one lit pixel: the basis' error is a mean over places, and the light is at one of them. At 1e-3 on 6 x 6 to 60 x 60 pixels 0.45
/// leaves 1.0e-3 to 1.5e-3, 0.2 4e-4 to 7e-4 (60 x 60: 1.1e-3).
const BASIS_SHARE_OF_A_POINT: f64 = 0.2;
/// The same for patches farther than [`FAR_DEG`] from the fovea, where kernels differ more over a tile: 0.4 leaves
/// 1.6e-3 of squares of two pixels at 2 mm and 30°, 0.2 the figures of `targets_are_kept` (test `validity`).
const BASIS_SHARE_FAR: f64 = 0.2;
/// Visual eccentricity of the patch's middle from which on the basis is finer, degrees.
const FAR_DEG: f64 = 15.0;
/// Catch of a type of cone that is not computed, per accuracy target.
pub const BLIND: f64 = 1e-3;
/// Largest pupil up to which coarse targets take wavelengths every 20 nm and usual ones every 15 nm: at 3 mm 20 nm cost 2e-4 to 4e-4 in one lit
/// pixel, nothing in squares, 15 nm 3e-5 and nothing.
const COARSE_STEP_PUPIL_MM: f64 = 4.0;
/// Loss above the band per accuracy target.
const LOSS: f64 = 0.25;
/// The same for one lit pixel, in whose surroundings the light of the cut band rings: at 1e-3, 10° from the
/// fovea, 0.25 leaves an L1 of 1.5e-3 in cones that see only tails, 0.03 7e-4.
const LOSS_OF_A_POINT: f64 = 0.04;

/// Visual eccentricity of the middle of the patch, or of the screen where no patch is given, degrees.
fn middle_deg(experiment: &Experiment) -> f64 {
    if let Some([x_min, x_max, y_min, y_max]) = experiment.retina.region_deg {
        return f64::midpoint(x_min, x_max).hypot(f64::midpoint(y_min, y_max));
    }
    let display = &experiment.display;
    let [x, y] = experiment.gaze.center_px;
    let away_px = (0.5 * f64::from(display.width_px) - x).hypot(0.5 * f64::from(display.height_px) - y);
    (away_px * display.pixel_pitch_cm / display.distance_cm).atan().to_degrees()
}

impl Numerics {
    /// The settings of an experiment.
    pub fn new(experiment: &Experiment) -> Self {
        let (target, knobs) = (experiment.accuracy_target, &experiment.counts.knobs);
        // One of three values: coarse, usual, fine.
        // With the coarse ones alone one lit pixel is off by 6.7e-3.
        // The usual ones leave some 2.6e-4 whatever the target (spreading kernel, wavelengths): from 8e-4 on the rest fits beside it.
        let (coarse, usual) = (target >= 0.01, target >= 8e-4);
        let fine = target >= 5e-5;
        // As good as the paper's method: what one point of the field fewer costs is not seen at 0.05 (1.39e-2 in squares and 4.3e-2 in one lit pixel
        // either way).
        let rough = target >= 0.03;
        // Chromatic defocus changes the spread faster with wavelength behind a large pupil.
        let small = experiment.eye.pupil_mm <= COARSE_STEP_PUPIL_MM;
        // Photons are of one wavelength node or the next, which gains only the second power of the step.
        let drawn = experiment.counts.engine == Engine::Events;
        let point = matches!(experiment.video, Video::Pattern(Pattern::Point { .. }));
        let far = middle_deg(experiment) > FAR_DEG;
        let (basis_share, loss) = match (point, far) {
            (true, _) => (BASIS_SHARE_OF_A_POINT, LOSS_OF_A_POINT),
            (false, true) => (BASIS_SHARE_FAR, LOSS),
            (false, false) => (BASIS_SHARE, LOSS),
        };
        Self {
            wavelength_step_nm: experiment.counts.wavelength_step_nm.unwrap_or(if coarse && small {
                20.0
            } else if usual && small && !drawn {
                15.0
            } else if usual {
                10.0
            } else {
                5.0
            }),
            wavelength_tail: WAVELENGTH_TAIL * target,
            basis_tolerance: knobs.basis_tolerance.unwrap_or(basis_share * target),
            band_loss: knobs.band_loss.unwrap_or(loss * target),
            // Light of the copies that comes from farther is taken away by the law of the spread's tail.
            guard_um: knobs.guard_um.unwrap_or(if coarse {
                30.0
            } else if usual {
                50.0
            } else if fine {
                300.0
            } else {
                600.0
            }),
            spread_width: knobs.spread_width.map_or(
                if coarse {
                    3
                } else if usual {
                    4
                } else if fine {
                    8
                } else {
                    10
                },
                |w| w as usize,
            ),
            oversampling: knobs.oversampling.unwrap_or(if usual { 1.02 } else { 1.25 }),
            finer_field: if rough { -1 } else { 1 + i32::from(!usual) + i32::from(!fine) },
            ecc_nodes: knobs.ecc_nodes.unwrap_or(if usual { 3 } else { 4 }),
            blind_below: if Rule::BlindTypes.applies(experiment) { BLIND * target } else { 0.0 },
            single: !knobs.double_precision.unwrap_or(!usual),
        }
    }
}
