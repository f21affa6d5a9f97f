//! How the eye of an experiment is focused: its state, and what it is for people.

use serde::{Deserialize, Serialize};

use super::PlanError;
use crate::experiment::Experiment;
use crate::optics::{EyeState, OpticsError, Prescription, SchematicEye};

fn model(error: OpticsError) -> PlanError {
    PlanError::Model(error.to_string())
}

/// The prescription and the state in which it is focused as the experiment asks.
pub(super) fn focused_eye(experiment: &Experiment) -> Result<(Prescription, EyeState), PlanError> {
    let eye = &experiment.eye;
    let prescription = eye.prescription().map_err(model)?;
    let mut state = relaxed(experiment);
    if eye.relaxed {
        return Ok((prescription, state));
    }
    let distance_mm = eye.focus_distance_cm * 10.0;
    state.accommodation_a = SchematicEye::accommodated(
        &prescription,
        &state,
        (distance_mm, eye.focus_wavelength_nm),
        eye.amplitude_d,
    )
    .map_err(model)?;
    Ok((prescription, state))
}

/// How an eye is focused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Focused {
    /// Vergence of what the eye looks at, from the corneal apex, dioptres.
    pub wanted_d: f64,
    /// Vergence of the far point, which the unaccommodated eye has in focus; negative beyond infinity.
    pub far_point_d: f64,
    /// Accommodation: vergence in focus beyond that of the far point.
    pub accommodation_d: f64,
    /// Vergence in focus beyond what is wanted: positive in front of what the eye looks at, negative behind.
    pub residual_d: f64,
}

/// How the eye of an experiment is focused, at the fovea.
///
/// # Errors
/// When the optics refuse.
pub fn focused(experiment: &Experiment) -> Result<Focused, PlanError> {
    let (prescription, state) = focused_eye(experiment)?;
    let nm = experiment.eye.focus_wavelength_nm;
    let in_focus_d = |state: &EyeState| -> Result<f64, PlanError> {
        SchematicEye::new(&prescription, state).and_then(|eye| eye.focus_vergence_d(nm)).map_err(model)
    };
    let far_point_d = in_focus_d(&relaxed(experiment))?;
    let in_focus = in_focus_d(&state)?;
    let wanted_d = 100.0 / experiment.eye.focus_distance_cm;
    Ok(Focused {
        wanted_d,
        far_point_d,
        accommodation_d: in_focus - far_point_d,
        residual_d: in_focus - wanted_d,
    })
}

/// The state of the unaccommodated eye.
pub(super) fn relaxed(experiment: &Experiment) -> EyeState {
    let eye = &experiment.eye;
    EyeState {
        pupil_mm: eye.pupil_mm,
        decentre_mm: eye.decentre_mm,
        accommodation_a: 0.0,
        dispersion: eye.dispersion,
        side: eye.side,
    }
}
