//! A target that cannot be met is refused with the best one, and that one is accepted.

#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::experiment::Pattern;
use photoneye_eye::plan::{PlanError, plan};
use support::figure_12;

#[test]
fn what_is_refused_comes_with_what_is_possible() {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 1 });
    // A wide pupil's wavefronts are not that good.
    experiment.eye.pupil_mm = 6.0;
    experiment.accuracy_target = 1e-5;
    let Err(PlanError::Range(error)) = plan(&experiment) else { unreachable!("1e-5 was planned") };
    assert_eq!((error.field.as_str(), error.value.as_str()), ("accuracy.target", "0.00001"));
    let best: f64 = error.allowed.split(' ').next().unwrap().parse().unwrap();
    assert!(best > 1e-5 && best < 1e-3, "{}", error.allowed);
    experiment.accuracy_target = best;
    let estimate: f64 = plan(&experiment).unwrap().error_estimate.iter().map(|p| p.relative).sum();
    assert!(estimate <= best, "{estimate} {best}");
}
