//! What `AUTO` takes.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::display::{Channel, White};
use photoneye_eye::experiment::{Engine, Experiment, Pattern, StrayLight};
use photoneye_eye::plan::engine::automatic;
use photoneye_eye::plan::plan;
use photoneye_eye::spectrum::Spectrum;
use support::{figure_12, primary};

/// Many frames in one colour.
fn scene(luminance: f64) -> Experiment {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 3 });
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 555.0, fwhm_nm: 0.0 })];
    experiment.display.white = White::LuminanceCdM2(luminance);
    experiment.frames = 600;
    experiment
}

#[test]
fn auto_takes_what_is_clearly_faster() {
    assert_eq!(automatic(&scene(0.001)).unwrap(), Engine::Events);
    assert_eq!(automatic(&scene(250.0)).unwrap(), Engine::Expected);
    let mut means = scene(0.001);
    means.counts.poisson = false;
    assert_eq!(automatic(&means).unwrap(), Engine::Expected);
    let mut one = scene(0.001);
    one.frames = 1;
    one.display.primaries = figure_12(Pattern::Checkerboard { square_px: 3 }).display.primaries;
    assert_eq!(automatic(&one).unwrap(), Engine::Expected, "tables of many wavelengths for one frame");
}

/// All engines scatter light, at the same price, and each may be asked for; `AUTO` takes what is clearly faster with it.
#[test]
fn scattered_light_forbids_no_engine() {
    let mut hazy = scene(0.001);
    hazy.eye.stray_light = Some(StrayLight { age_years: 70.0, pigmentation: 0.5 });
    assert_eq!(automatic(&hazy).unwrap(), Engine::Events);
    for (engine, name) in
        [(Engine::Expected, "EXPECTED"), (Engine::Events, "EVENTS"), (Engine::Paper, "PAPER")]
    {
        hazy.counts.engine = engine;
        let made = plan(&hazy).unwrap();
        assert_eq!(made.engine, name);
        assert!(made.omissions.iter().all(|omission| !omission.what.contains("scattered")));
    }
}

#[test]
fn the_plan_says_why() {
    let mut dim = scene(0.001);
    dim.counts.engine = automatic(&dim).unwrap();
    let made = plan(&dim).unwrap();
    assert_eq!(made.engine, "EVENTS");
    assert!(made.engine_reason.starts_with("clearly faster; predicted seconds"), "{}", made.engine_reason);
    // What is asked for and what AUTO takes is one experiment.
    assert_eq!(made.experiment, plan(&dim).unwrap().experiment);
    let bright = plan(&scene(250.0)).unwrap();
    assert!(bright.engine_reason.contains("EVENTS is not clearly faster"), "{}", bright.engine_reason);
}
