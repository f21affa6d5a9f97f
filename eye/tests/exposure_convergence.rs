//! Convergence of the engine `expected`: default settings against a finer reference.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::experiment::{Experiment, Pattern};
use photoneye_eye::exposure::FrameCounts;
use photoneye_eye::plan::Knobs;
use support::{exposure, figure_12};

fn means(experiment: &Experiment) -> Vec<f64> {
    let (plan, exposure) = exposure(experiment);
    let started = std::time::Instant::now();
    let frame = exposure.frame(0, None).unwrap();
    println!(
        "grid {:?} frame {:.3} s nodes {} {:?}",
        plan.grid,
        started.elapsed().as_secs_f64(),
        plan.wavelengths_nm.len(),
        frame.diagnostics
    );
    match frame.counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(_) => panic!("means were asked for"),
    }
}

fn l1(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / b.iter().sum::<f64>()
}

/// Targets of 1 % and of 0.1 %, the default, are kept against finer settings, on pictures from flat to a single lit pixel.
#[test]
fn targets_are_kept() {
    for pattern in [
        Pattern::Checkerboard { square_px: 1 },
        Pattern::Point { at_px: [15, 15], rgb: [1.0; 3] },
        Pattern::Uniform { rgb: [1.0; 3] },
    ] {
        let mut experiment = figure_12(pattern.clone());
        experiment.counts.poisson = false;
        let mut finer = experiment.clone();
        support::finer(&mut finer);
        let reference = means(&finer);
        for target in [0.01, 0.001] {
            experiment.accuracy_target = target;
            let error = l1(&means(&experiment), &reference);
            println!("{pattern:?}: L1 {error:.2e} at {target}");
            assert!(error < target, "{pattern:?}: L1 {error:.2e} at {target}");
        }
    }
}

/// A target of 1e-5 against settings that are finer in everything but the wavelengths (5 nm; 2.5 nm moves the means by 1e-7).
#[test]
fn one_in_a_hundred_thousand_is_kept() {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 1 });
    (experiment.display.width_px, experiment.display.height_px) = (8, 8);
    experiment.gaze.center_px = [4.0, 4.0];
    experiment.counts.poisson = false;
    experiment.accuracy_target = 1e-5;
    let mut finer = experiment.clone();
    finer.counts.knobs = Knobs {
        basis_tolerance: Some(3e-7),
        band_loss: Some(3e-7),
        guard_um: Some(900.0),
        spread_width: Some(12),
        oversampling: Some(1.4),
        field_nodes: Some(6),
        ecc_nodes: Some(5),
        double_precision: Some(true),
    };
    let error = l1(&means(&experiment), &means(&finer));
    println!("L1 {error:.2e} at 1e-5");
    assert!(error < 1e-5, "L1 {error:.2e} at 1e-5");
}
