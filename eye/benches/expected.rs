//! CPU time of a warm frame of the engine `expected` by scene, and its error against a converged reference:
//! `cargo bench -p photoneye-eye --bench expected [-- NAME]`. CPU seconds of one core (Linux); nothing is asserted. The reference takes a
//! minute a scene: `NO_REFERENCE=1` leaves it out; `TARGETS="0.01 0.001"` and `RUNS=50` choose what is timed.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark prints and stops at the first error"
)]

#[path = "clock/mod.rs"]
mod clock;
#[path = "../tests/support/mod.rs"]
mod support;

use clock::cpu_seconds;
use photoneye_eye::display::Channel;
use photoneye_eye::experiment::{Experiment, Pattern, Video};
use photoneye_eye::exposure::{Exposure, FrameCounts};
use photoneye_eye::spectrum::Spectrum;
use photoneye_eye::video::{Picture, ScreenView, draw};
use support::{figure_12, primary};

/// Scenes of Figures 12 and 13 and some that are hard.
fn scenes() -> Vec<(&'static str, Experiment)> {
    let checks = |square_px| figure_12(Pattern::Checkerboard { square_px });
    let point = figure_12(Pattern::Point { at_px: [15, 15], rgb: [1.0; 3] });
    let mut fine = checks(24);
    fine.display.width_px = 720;
    fine.display.height_px = 720;
    fine.display.pixel_pitch_cm = 0.58 / 24.0;
    fine.gaze.center_px = [360.0, 360.0];
    let mut line = checks(2);
    line.eye.pupil_mm = 6.0;
    line.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 555.0, fwhm_nm: 0.0 })];
    let mut wide = checks(1);
    wide.eye.pupil_mm = 5.0;
    vec![
        ("30x30, squares of 3", checks(3)),
        ("30x30, squares of 1", checks(1)),
        ("30x30, one lit pixel", point),
        ("30x30, even", figure_12(Pattern::Uniform { rgb: [1.0; 3] })),
        ("720x720", fine),
        ("6 mm, 555 nm", line),
        ("5 mm, ones", wide),
    ]
}

fn means(exposure: &Exposure) -> Vec<f64> {
    match exposure.frame(0, None).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).collect(),
    }
}

fn l1(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / b.iter().sum::<f64>()
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let targets: Vec<f64> = std::env::var("TARGETS")
        .unwrap_or_else(|_| "0.01 0.001 0.0001".into())
        .split_whitespace()
        .map(|t| t.parse().unwrap())
        .collect();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for (name, mut experiment) in scenes() {
        if !wanted.is_empty() && !wanted.iter().any(|w| name.contains(w.as_str())) {
            continue;
        }
        experiment.counts.poisson = false;
        let Video::Pattern(pattern) = &experiment.video else { continue };
        let picture = draw(pattern, &ScreenView::frontal(&experiment.display, &experiment.gaze));
        let rgb = picture.rgb.iter().map(|value| 1.0 - value).collect();
        let film: &[Picture; 2] = Box::leak(Box::new([Picture { rgb, ..picture.clone() }, picture]));
        let mut reference = experiment.clone();
        reference.accuracy_target = 2e-4;
        reference.counts.wavelength_step_nm = Some(2.5);
        let reference =
            std::env::var_os("NO_REFERENCE").is_none().then(|| means(&support::exposure(&reference).1));
        for &target in &targets {
            experiment.accuracy_target = target;
            one.install(|| {
                let started = cpu_seconds();
                let (plan, exposure) = support::exposure(&experiment);
                let cold = cpu_seconds() - started;
                let error = reference.as_ref().map_or(0.0, |r| l1(&means(&exposure), r));
                let runs: usize = std::env::var("RUNS").map_or(50, |r| r.parse().unwrap());
                // The clock ticks every few ms: all runs together.
                let milliseconds = |picture: &dyn Fn(usize) -> Option<&'static Picture>| {
                    let started = cpu_seconds();
                    (0..runs).for_each(|i| drop(exposure.frame(0, picture(i)).unwrap()));
                    1e3 * (cpu_seconds() - started) / runs as f64
                };
                let (still, film) = (milliseconds(&|_| None), milliseconds(&|i| Some(&film[i % 2])));
                println!(
                    "{name:22} target {target:7.0e}: L1 {error:.1e}, a picture that stays {still:6.2} ms a frame, {:.2} µs a cone; a film {film:6.2} ms, {:.2} µs ({} cones, grid {:?}, {} wavelengths), cold {cold:.2} s",
                    1e3 * still / exposure.len() as f64,
                    1e3 * film / exposure.len() as f64,
                    exposure.len(),
                    plan.grid,
                    plan.wavelengths_nm.len(),
                );
            });
        }
    }
}
