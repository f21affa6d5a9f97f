//! The audit: the engine against a slow direct sum on cones chosen at random.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::artifact::ArtifactSpec;
use photoneye_eye::experiment::{Experiment, Movement, Pattern};
use photoneye_eye::exposure::Exposure;
use photoneye_eye::exposure::audit::{Verdict, verdict};
use photoneye_eye::plan::plan;
use support::{build, exposure, figure_12};

const POINT: Pattern = Pattern::Point { at_px: [15, 15], rgb: [1.0; 3] };

fn audited(experiment: &Experiment, exposure: &Exposure) -> Verdict {
    let started = std::time::Instant::now();
    let frame = exposure.frame(0, None).unwrap();
    let samples = exposure.audit(0, None, &[], &frame).unwrap();
    assert_eq!(samples.len(), experiment.audit_cones as usize);
    if std::env::var_os("PHOTONEYE_TEST_TIMES").is_some() {
        for s in &samples {
            println!("{} {:.6} {:.6} {:.2e}", s.cone, s.value, s.reference, s.value / s.reference - 1.0);
        }
    }
    let found = verdict(&samples, false).unwrap();
    println!("{found:?} {:.2} s", started.elapsed().as_secs_f64());
    found
}

fn scene(pattern: Pattern, target: f64) -> Experiment {
    Experiment { accuracy_target: target, audit_cones: 6, ..figure_12(pattern) }
}

/// The engine keeps its target by a path that it shares nothing with.
#[test]
fn engine_and_direct_sum_agree() {
    for pattern in [Pattern::Checkerboard { square_px: 1 }, POINT] {
        let experiment = scene(pattern.clone(), 0.001);
        print!("{pattern:?}: ");
        let found = audited(&experiment, &exposure(&experiment).1);
        assert!(found.relative_error < experiment.accuracy_target, "{found:?}");
    }
}

/// Optics that were made for too few wavelengths and too low frequencies are caught.
#[test]
fn damage_is_caught() {
    let experiment = scene(Pattern::Checkerboard { square_px: 1 }, 0.001);
    let plan = plan(&experiment).unwrap();
    let mut built = build(&plan);
    let keys = &plan.tile_artifacts[0];
    let spec = plan.artifacts.iter().find(|a| a.key == keys[1]).unwrap().spec.clone();
    let ArtifactSpec::Kernels(whole) = spec else { unreachable!() };
    let mut thin = whole.clone();
    thin.nodes_nm = whole.nodes_nm.iter().copied().step_by(6).collect();
    let mut low = whole.clone();
    low.band *= 0.5;
    let mut other = whole;
    other.state.pupil_mm *= 1.05;
    for (name, spec) in [("wavelengths", thin), ("band", low), ("pupil", other)] {
        let kernels = ArtifactSpec::Kernels(spec).build(&[]).unwrap().bytes;
        built.insert(keys[1], kernels);
        let artifacts: Vec<&Vec<u8>> = keys.iter().map(|k| &built[k]).collect();
        print!("damaged {name}: ");
        let found = audited(&experiment, &Exposure::new(&experiment, &artifacts).unwrap());
        assert!(found.relative_error > experiment.accuracy_target, "{name}: {found:?}");
    }
}

/// A moving eye before a line of light.
#[test]
fn a_moving_eye_agrees() {
    let mut experiment = scene(Pattern::Checkerboard { square_px: 2 }, 0.001);
    experiment.gaze.movement = Movement::Drift { speed_arcmin_per_s: 1200.0, direction_deg: 30.0 };
    let found = audited(&experiment, &exposure(&experiment).1);
    assert!(found.relative_error < 0.001, "{found:?}");
}
