//! The far tail of the spread in the engine `expected`: what copies of the periodic image add and what lies beyond the window.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::experiment::{Experiment, Pattern};
use photoneye_eye::exposure::FrameCounts;
use support::{exposure, figure_12};

fn means(experiment: &Experiment) -> Vec<f64> {
    match exposure(experiment).1.frame(0, None).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(_) => panic!("means were asked for"),
    }
}

/// The middle of a screen that ends far beyond the window, and of one that ends inside of it.
fn middle(width_px: u32) -> Experiment {
    let mut experiment = figure_12(Pattern::Uniform { rgb: [1.0; 3] });
    experiment.counts.poisson = false;
    experiment.retina.region_deg = Some([-0.3, 0.3, -0.3, 0.3]);
    (experiment.display.width_px, experiment.display.height_px) = (width_px, width_px);
    experiment.gaze.center_px = [0.5 * f64::from(width_px); 2];
    experiment
}

/// An even screen without end gives every cone what the whole spread catches; of a smaller one the tail beyond it is missing:
/// s/(2πR)·(2√2/π·…) of the light for a square, some 1e-3 for a half side of 300 µm and 3 mm of pupil.
#[test]
fn a_larger_screen_adds_the_tail() {
    let mut last: Option<(f64, f64)> = None;
    // Half sides in pixels; the tail beyond a square of half side a is as 1/a.
    for width_px in [60_u32, 120, 240, 480] {
        let total: f64 = means(&middle(width_px)).iter().sum();
        println!("{width_px} pixels: {total:.1}");
        if let Some((before, step)) = last {
            let now = total - before;
            println!("  adds {:.2e}", now / total);
            assert!(now > 0.0, "a larger screen gives more light");
            if step > 0.0 {
                // Half as much with each doubling.
                assert!((now / step - 0.5).abs() < 0.12, "{}", now / step);
            }
            last = Some((total, now));
        } else {
            last = Some((total, 0.0));
        }
    }
}

/// Out of focus the blur is as wide as a picture's copies would be far: they keep away from it. The blur alone reaches 120 µm here.
#[test]
fn copies_keep_away_from_the_blur() {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 3 });
    experiment.counts.poisson = false;
    (experiment.display.width_px, experiment.display.height_px) = (12, 12);
    experiment.gaze.center_px = [6.0; 2];
    experiment.eye.focus_distance_cm = 20.0;
    experiment.accuracy_target = 0.001;
    let near = means(&experiment);
    experiment.counts.knobs.guard_um = Some(600.0);
    let far = means(&experiment);
    let off: f64 = near.iter().zip(&far).map(|(a, b)| (a - b).abs()).sum();
    let relative = off / far.iter().sum::<f64>();
    println!("copies at 600 µm change the means by {relative:.1e}");
    assert!(relative < experiment.accuracy_target, "{relative:e}");
}
