//! Ranges of the gaze and its movement.

use super::unread;
use crate::display::MOST_SIDE_PX;
use crate::experiment::{Gaze, Movement, RangeError, check_range};

/// Most samples of a recorded path: an hour at 1 kHz.
const MAX_SAMPLES: usize = 4_000_000;

impl Gaze {
    /// Checks ranges. Field names are those of the schema.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        for (axis, value) in ["gaze.center_px[0]", "gaze.center_px[1]"].iter().zip(self.center_px) {
            check_range(axis, value, -f64::from(MOST_SIDE_PX), 2.0 * f64::from(MOST_SIDE_PX))?;
        }
        match &self.movement {
            Movement::Still => {}
            Movement::Drift { speed_arcmin_per_s, direction_deg } => {
                check_range("gaze.movement.drift.speed_arcmin_per_s", *speed_arcmin_per_s, 0.0, 60000.0)?;
                check_range("gaze.movement.drift.direction_deg", *direction_deg, -360.0, 360.0)?;
            }
            Movement::Walk { unit_arcmin } => {
                check_range("gaze.movement.walk.unit_arcmin", *unit_arcmin, 0.0, 60.0)?;
            }
            Movement::Recorded(samples) => recorded(samples)?,
            Movement::Recording(table) => return Err(unread(table)),
        }
        if let Some(tremor) = &self.tremor {
            check_range("gaze.movement.tremor.rms_arcmin", tremor.rms_arcmin, 0.0, 60.0)?;
            check_range("gaze.movement.tremor.from_hz", tremor.from_hz, 0.0, 1000.0)?;
            check_range("gaze.movement.tremor.to_hz", tremor.to_hz, tremor.from_hz.max(1e-3), 1000.0)?;
        }
        if let Some(jumps) = &self.microsaccades {
            check_range("gaze.movement.microsaccades.rate_hz", jumps.rate_hz, 0.0, 100.0)?;
            check_range("gaze.movement.microsaccades.from_arcmin", jumps.from_arcmin, 1e-3, 600.0)?;
            let least = jumps.from_arcmin;
            check_range("gaze.movement.microsaccades.to_arcmin", jumps.to_arcmin, least, 600.0)?;
            check_range("gaze.movement.microsaccades.duration_ms", jumps.duration_ms, 1.0, 1000.0)?;
        }
        Ok(())
    }
}

fn recorded(samples: &[[f64; 3]]) -> Result<(), RangeError> {
    let path = "gaze.movement.recorded";
    if samples.is_empty() || samples.len() > MAX_SAMPLES {
        let allowed = format!("1 to {MAX_SAMPLES} samples");
        return Err(RangeError::new(&format!("{path}.t_s"), samples.len(), &allowed));
    }
    let mut least = -1e6;
    for (i, [t, x, y]) in samples.iter().enumerate() {
        // Names of fields take longer than the checks: only where something is wrong.
        let fits = |value: f64, min: f64, max: f64| (min..=max).contains(&value);
        if fits(*t, least, 1e6) && fits(*x, -2700.0, 2700.0) && fits(*y, -2700.0, 2700.0) {
            least = t + 1e-9;
            continue;
        }
        check_range(&format!("{path}.t_s[{i}]"), *t, least, 1e6)?;
        check_range(&format!("{path}.x_arcmin[{i}]"), *x, -2700.0, 2700.0)?;
        check_range(&format!("{path}.y_arcmin[{i}]"), *y, -2700.0, 2700.0)?;
        least = t + 1e-9;
    }
    Ok(())
}
