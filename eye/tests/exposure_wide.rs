//! Wide fields: a patch in several result tiles gives each cone the count that one tile gives it, and counts far from the fovea are
//! those of a uniform field.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use std::collections::BTreeMap;

use photoneye_eye::experiment::{Experiment, Pattern, StrayLight};
use photoneye_eye::exposure::{Exposure, FrameCounts};
use photoneye_eye::plan::plan;
use photoneye_eye::report::PhotonBudget;
use photoneye_eye::retina::Retina;
use support::{WHITE, build, figure_12};

/// A wide screen with large pixels, so that a test needs few cones: 160 x 12 pixels of 15 arcmin, 40° x 3°, at 60 cm.
fn wide(pattern: Pattern, region_deg: [f64; 4]) -> Experiment {
    let mut experiment = figure_12(pattern);
    experiment.display.width_px = 160;
    experiment.display.height_px = 12;
    experiment.display.distance_cm = 60.0;
    experiment.display.pixel_pitch_cm = 60.0 * (0.25_f64).to_radians();
    experiment.eye.focus_distance_cm = 60.0;
    experiment.gaze.center_px = [80.0, 6.0];
    experiment.counts.poisson = false;
    experiment.retina.region_deg = Some(region_deg);
    experiment
}

/// Mean of each cone by its number, and the photon fates, over all tiles.
fn means(experiment: &Experiment) -> (usize, BTreeMap<u64, f64>, PhotonBudget) {
    let plan = plan(experiment).unwrap();
    let built = build(&plan);
    let mut by_cone = BTreeMap::new();
    let mut budget = PhotonBudget::default();
    for keys in &plan.tile_artifacts {
        let artifacts: Vec<&Vec<u8>> = keys.iter().map(|k| &built[k]).collect();
        let retina = Retina::from_bytes(artifacts[0]).unwrap();
        let frame = Exposure::new(experiment, &artifacts).unwrap().frame(0, None).unwrap();
        let FrameCounts::Means(counts) = frame.counts else { panic!("means were asked for") };
        for (id, count) in retina.id.iter().zip(counts) {
            assert!(by_cone.insert(*id, f64::from(count)).is_none(), "cone {id} is in two tiles");
        }
        budget.add(&frame.budget);
    }
    (plan.tile_artifacts.len(), by_cone, budget)
}

/// The same cones in tiles that are cut elsewhere have the same means; every photon of the screen is accounted for once.
#[test]
fn seams_do_not_show() {
    let pattern = Pattern::Checkerboard { square_px: 1 };
    let (tiles, far, budget) = means(&wide(pattern.clone(), [8.0, 17.0, -0.2, 0.2]));
    assert!(tiles > 1);
    let (_, near, one) = means(&wide(pattern, [11.0, 14.5, -0.2, 0.2]));
    let (mut gap, mut total, mut shared) = (0.0, 0.0, 0);
    for (id, count) in &near {
        if let Some(other) = far.get(id) {
            gap += (count - other).abs();
            total += count;
            shared += 1;
        }
    }
    assert!(shared > near.len() * 9 / 10, "{shared} of {}", near.len());
    println!("{tiles} tiles, {shared} cones in both: L1 {:.1e}", gap / total);
    assert!(gap / total < 2e-3, "L1 {:.1e}", gap / total);
    assert!((budget.emitted / one.emitted - 1.0).abs() < 1e-12);
    assert!((budget.fates() / budget.emitted - 1.0).abs() < 1e-9);
}

/// Along a white screen 40° wide the counts per aperture follow the screen's slant and the media; they never jump.
#[test]
fn a_white_screen_is_even_across_forty_degrees() {
    let experiment = wide(WHITE, [-20.0, 20.0, -0.02, 0.02]);
    let (tiles, by_cone, _) = means(&experiment);
    println!("{tiles} tiles, {} cones", by_cone.len());
    assert!(tiles >= 10 && by_cone.len() > 1000);
    assert!(by_cone.values().all(|m| m.is_finite() && *m >= 0.0));
}

/// Under a veil every photon still has one fate. On a screen of 40° a cone of the fovea keeps its light less what is scattered
/// away, and gets back what the rest of the screen scatters on it; on black beside the light it gets a part of it.
#[test]
fn stray_light_is_a_veil() {
    let mut experiment = wide(WHITE, [-0.15, 0.15, -0.15, 0.15]);
    experiment.display.height_px = 160;
    experiment.gaze.center_px = [80.0, 80.0];
    let (_, without, _) = means(&experiment);
    experiment.eye.stray_light = Some(StrayLight { age_years: 70.0, pigmentation: 0.5 });
    let (_, with, budget) = means(&experiment);
    assert!((budget.fates() / budget.emitted - 1.0).abs() < 1e-9);
    let total = |of: &BTreeMap<u64, f64>| of.values().sum::<f64>();
    let ratio = total(&with) / total(&without);
    // Within 20° of 90° lie four fifths of what is scattered, a seventh of all light.
    println!("veil: {ratio}");
    assert!((0.93..1.0).contains(&ratio), "{ratio}");
}
