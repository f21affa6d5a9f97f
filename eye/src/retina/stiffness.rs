//! How stiff the force iteration is: the size of its last step, for K3 below and above the limit of `force`.
//!
//! Random kicks have faded by the last sub-cycle, so a stable iteration ends with small steps. Above the limit the stiffest modes of
//! the lattice grow until the cut of steps at 0.2 r holds them.

use super::field::Field;
use super::params::{RetinaError, RetinaParams};
use super::relax::relax_with;
use super::tile::RegionUm;

/// Root mean square of the last step of the cones of a patch, in cone radii, when the domain generator runs with this K3.
///
/// # Errors
/// Parameters out of range, or K3 not within 0 to 1.
pub fn last_step_rms(p: &RetinaParams, patch: &RegionUm, k3: f64) -> Result<f64, RetinaError> {
    p.validate()?;
    if !(0.0..=1.0).contains(&k3) {
        return Err(RetinaError::Parameter { field: "K3", value: k3, allowed: "0 to 1" });
    }
    let (sum, count) = relax_with(&Field::new(p), patch, 0.0, 1.0, k3).last_steps;
    Ok((sum / f64::max(count, 1.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::super::force::{K3, K3_LIMIT};
    use super::*;

    /// The relaxation itself, as it runs, settles below the limit and trembles above it.
    #[test]
    fn steps_fade_below_the_limit_only() {
        let p = RetinaParams { cycles: Some(80), ..RetinaParams::default() };
        let patch = RegionUm { min: DVec2::splat(300.0), max: DVec2::splat(340.0) };
        let last = [0.5 * K3, K3, K3_LIMIT, 0.25, 0.3, 0.4].map(|k3| last_step_rms(&p, &patch, k3).unwrap());
        // Measured: 0.005, 0.0067, 0.0074 below and at the limit; 0.12, 0.18, 0.19 above.
        assert!(last[..3].iter().all(|s| *s < 0.01), "{last:?}");
        assert!(last[3..].iter().all(|s| *s > 0.1), "{last:?}");
        assert!(last_step_rms(&p, &patch, f64::NAN).is_err());
    }
}
