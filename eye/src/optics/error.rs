//! What can go wrong in the optics, each with the field, the value and what is allowed.

/// An error of the optics.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OpticsError {
    /// No eye of this name is built in.
    #[error("eye.preset: unknown eye {name:?}; known: {known}")]
    UnknownPreset {
        /// The name asked for.
        name: String,
        /// The names that exist, comma separated.
        known: String,
    },
    /// An eye's data file cannot be read.
    #[error("eye {name:?}: {reason}")]
    BadData {
        /// The eye's name.
        name: String,
        /// What the reader said.
        reason: String,
    },
    /// A value outside its range (NaN is outside every range).
    #[error("{field}: {value} is outside {min} to {max}")]
    OutOfRange {
        /// The field, as the caller names it.
        field: &'static str,
        /// The value given.
        value: f64,
        /// Smallest value allowed.
        min: f64,
        /// Largest value allowed.
        max: f64,
    },
    /// A value that is wrong in another way than by its range.
    #[error("{field}: {why}")]
    Wrong {
        /// The field, as the caller names it.
        field: &'static str,
        /// What is wrong, and what is allowed.
        why: String,
    },
    /// The wanted focus is beyond what the eye can accommodate to.
    #[error(
        "eye.focus.distance_cm: {wanted_d:.3} D (1/m from the corneal apex) is beyond this eye: {why}; relaxed it is focused at \
         {relaxed_d:.3} D; with focus.relaxed it stays so"
    )]
    CannotFocus {
        /// Vergence of the wanted object, D; 0 at infinity, 2 at 500 mm.
        wanted_d: f64,
        /// Vergence in focus of the unaccommodated eye, D.
        relaxed_d: f64,
        /// What it can do.
        why: String,
    },
    /// A direction of no length, or not finite.
    #[error("{field}: a direction must be finite and longer than zero")]
    NoDirection {
        /// The field, as the caller names it.
        field: &'static str,
    },
    /// No ray from this object reaches the wanted point of the stop and then the retina.
    #[error(
        "no ray from the object at {angle_deg:.3}° from the optical axis passes the stop and reaches the retina"
    )]
    NoRay {
        /// Angle of the object from the optical axis, degrees.
        angle_deg: f64,
    },
    /// No point of the screen is imaged on this point of the retina.
    #[error("no point of the screen is imaged on the retina at ({x_um:.1}, {y_um:.1}) µm")]
    OutsideField {
        /// Retinal x, µm.
        x_um: f64,
        /// Retinal y, µm.
        y_um: f64,
    },
}

/// `value` when it lies in `min..=max`.
///
/// # Errors
/// [`OpticsError::OutOfRange`] when it does not, NaN included.
pub fn in_range(field: &'static str, value: f64, min: f64, max: f64) -> Result<f64, OpticsError> {
    if value >= min && value <= max {
        Ok(value)
    } else {
        Err(OpticsError::OutOfRange { field, value, min, max })
    }
}
