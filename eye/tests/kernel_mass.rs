//! Kernels that lose 0.1 % of their mass are found out: total of Poisson counts from production kernels against the mean of a reference whose
//! settings are finer than those of any accuracy target.
//!
//! With N counts the total's standard deviation is √N. The test takes 5 of them (alpha 6e-7) as its limit and N >= 1.1e8, of which 0.1 % are 10.5
//! standard deviations: the power is 1 - 2e-8. `EVENTS` as the reference would take minutes and has an error of its own of some 4e-4.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::artifact::ArtifactSpec;
use photoneye_eye::display::{Channel, White};
use photoneye_eye::experiment::{Experiment, Gaze};
use photoneye_eye::exposure::{Exposure, FrameCounts};
use photoneye_eye::plan::plan;
use photoneye_eye::spectrum::Spectrum;
use support::{WHITE, build, figure_12, primary};

/// A bright square amid a patch that catches its blur to 0.6 % of the tail, so that most photons are counted.
fn bright() -> Experiment {
    let mut experiment = figure_12(WHITE);
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 555.0, fwhm_nm: 0.0 })];
    experiment.display.primaries[0].rects = vec![[0.0, 0.0, 1.0, 1.0]];
    (experiment.display.width_px, experiment.display.height_px) = (4, 4);
    experiment.gaze = Gaze::still([2.0, 2.0]);
    experiment.retina.region_deg = Some([-0.25, 0.25, -0.25, 0.25]);
    experiment.display.white = White::LuminanceCdM2(250_000.0);
    experiment.accuracy_target = 1e-3;
    experiment.counts.poisson = false;
    experiment
}

/// Total of one frame with kernels whose lens is denser by a factor.
fn total(experiment: &Experiment, lens: f64) -> f64 {
    let plan = plan(experiment).unwrap();
    let built = build(&plan);
    let mut artifacts: Vec<Vec<u8>> = plan.tile_artifacts[0].iter().map(|key| built[key].clone()).collect();
    let kernels = plan.artifacts.iter().find_map(|artifact| match &artifact.spec {
        ArtifactSpec::Kernels(spec) => Some(spec.clone()),
        _ => None,
    });
    let mut kernels = kernels.unwrap();
    kernels.lens_density_scale *= lens;
    if lens > 1.0 {
        let inputs: Vec<_> = built.iter().map(|(key, bytes)| (*key, bytes.as_slice())).collect();
        artifacts[1] = ArtifactSpec::Kernels(kernels).build(&inputs).unwrap().bytes;
    }
    match Exposure::new(experiment, &artifacts).unwrap().frame(0, None).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).sum(),
        FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).sum(),
    }
}

#[test]
fn a_thousandth_of_the_kernels_is_missed() {
    let experiment = bright();
    let whole = total(&experiment, 1.0);
    // The density of cornea and lens that takes away 0.1 % more: found from a larger step.
    let slope = (whole / total(&experiment, 1.02)).ln() / 0.02;
    let dropped = total(&experiment, 1.0 + 1e-3 / slope);
    assert!((dropped / whole - 0.999).abs() < 2e-5, "{}", dropped / whole);
    let mut reference = experiment.clone();
    support::finer(&mut reference);
    let mean = total(&reference, 1.0);
    let mut drawn = experiment.clone();
    drawn.counts.poisson = true;
    let lost = 1.0 + 1e-3 / slope;
    let (whole_counts, dropped_counts) = (total(&drawn, 1.0), total(&drawn, lost));
    let deviations = |counted: f64| (counted - mean) / mean.sqrt();
    let (kept, missed) = (deviations(whole_counts), deviations(dropped_counts));
    println!(
        "{mean:.3e} counts: {kept:.2} standard deviations with whole kernels, {missed:.2} without a thousandth"
    );
    assert!(mean > 1.1e8, "{mean}");
    assert!(kept.abs() < 5.0 && missed < -5.0);
}
