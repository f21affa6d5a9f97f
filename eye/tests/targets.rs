//! A target that cannot be met is refused with the best one, and that one is accepted.

#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::experiment::Pattern;
use photoneye_eye::plan::{PlanError, plan};
use support::figure_12;

/// Where a fine target is kept, so are all coarser ones.
#[test]
fn coarser_targets_are_kept_too() {
    for pattern in [Pattern::Checkerboard { square_px: 1 }, Pattern::Point { at_px: [15, 15], rgb: [1.0; 3] }]
    {
        let mut experiment = figure_12(pattern);
        for target in
            [2e-5, 4.9e-5, 5.1e-5, 2e-4, 4.9e-4, 5.1e-4, 6e-4, 7.9e-4, 8e-4, 1e-3, 5e-3, 9.9e-3, 0.01, 0.1]
        {
            experiment.accuracy_target = target;
            let estimate: f64 = plan(&experiment).unwrap().error_estimate.iter().map(|p| p.relative).sum();
            assert!(estimate <= target, "{estimate:e} {target:e}");
        }
    }
}

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
