//! Whole experiments at the ends of their ranges: every photon has one fate, every mean is a number, or the field is named.

use photoneye_eye::plan::plan;
use serde_json::{Value, json};

use super::super::scene::{Outcome, Runner, experiment, standard, with};
use super::{Cases, Found};

const GROUP: &str = "experiment";

fn square(half: f64) -> Value {
    json!({"x_min": -half, "x_max": half, "y_min": -half, "y_max": half})
}

/// A small patch, a small display in one wavelength: the optics of a wide pupil take minutes for a whole spectrum.
fn small() -> Value {
    let changes = [
        ("retina.region_deg", square(0.08)),
        ("accuracy.target", json!(0.02)),
        ("display.primaries", line(555.0)),
    ];
    with(standard(8, 2), &changes)
}

fn line(nm: f64) -> Value {
    json!([{"name": "white", "spectrum": {"line": {"nm": nm, "fwhm_nm": 0}}}])
}

/// Cases that must give numbers: name and changes.
fn right() -> Vec<(&'static str, Vec<(&'static str, Value)>)> {
    let drift = |speed: f64| json!({"drift": {"speed_arcmin_per_s": speed, "direction_deg": 30}});
    let black = json!({"pattern": {"uniform": {"rgb": [0, 0, 0]}}});
    let point = json!({"pattern": {"point": {"at_px": [4, 4], "rgb": [1, 1, 1]}}});
    vec![
        ("pupil 0.5 mm", vec![("eye.pupil_mm", json!(0.5))]),
        ("pupil 9 mm", vec![("eye.pupil_mm", json!(9))]),
        ("focus at 10 cm, display at 8 m", vec![("eye.focus.distance_cm", json!(10))]),
        ("focus at 10,000 km", vec![("eye.focus.distance_cm", json!(1e9))]),
        ("focus of 390 nm", vec![("eye.focus.wavelength_nm", json!(390))]),
        ("one line at 390 nm", vec![("display.primaries", line(390.0))]),
        ("one line at 830 nm", vec![("display.primaries", line(830.0))]),
        (
            "polyline dispersion at 390 nm",
            vec![("eye.dispersion", json!("POLYLINE")), ("display.primaries", line(390.0))],
        ),
        (
            "display of one pixel",
            vec![
                ("display.width_px", json!(1)),
                ("display.height_px", json!(1)),
                ("gaze.center_px", json!([0.5, 0.5])),
                ("video", json!({"pattern": {"uniform": {"rgb": [1, 1, 1]}}})),
            ],
        ),
        ("luminance 0", vec![("display.white_luminance_cd_m2", json!(0))]),
        ("luminance 1e-6 cd/m²", vec![("display.white_luminance_cd_m2", json!(1e-6))]),
        ("luminance 1e7 cd/m²", vec![("display.white_luminance_cd_m2", json!(1e7))]),
        ("frames of 1 µs", vec![("display.frame_rate_hz", json!(1e6))]),
        ("frames of 100 s", vec![("display.frame_rate_hz", json!(0.01))]),
        ("drift 0", vec![("gaze.movement", drift(0.0))]),
        ("drift 1e-12 arcmin/s", vec![("gaze.movement", drift(1e-12))]),
        (
            "drift 1000°/s, 10 kHz",
            vec![("gaze.movement", drift(60_000.0)), ("display.frame_rate_hz", json!(1e4))],
        ),
        ("a patch of 0.0004°: a cone or none", vec![("retina.region_deg", square(0.0002))]),
        ("a patch of 0.01°: about one cone", vec![("retina.region_deg", square(0.005))]),
        ("peak density 98,200", vec![("retina.peak_density_per_mm2", json!(98_200))]),
        ("peak density 324,100", vec![("retina.peak_density_per_mm2", json!(324_100))]),
        ("seeds 0", vec![("retina.seed", json!(0)), ("counts.seed", json!(0))]),
        ("seeds 2^64-1", vec![("retina.seed", json!(u64::MAX)), ("counts.seed", json!(u64::MAX))]),
        ("all black", vec![("video", black)]),
        (
            "one lit pixel of 1e7 cd/m² on black",
            vec![("video", point), ("display.white_luminance_cd_m2", json!(1e7))],
        ),
        (
            "one pixel 1e7 times as bright as the rest",
            vec![
                ("video", json!({"pattern": {"point": {"at_px": [4, 4], "rgb": [1, 1, 1]}}})),
                ("display.contrast", json!(1e7)),
            ],
        ),
        ("pixels of 0.004 arcmin", vec![("display.pixel_pitch_cm", json!(0.001))]),
        ("pixels of 260 arcmin", vec![("display.pixel_pitch_cm", json!(60))]),
        ("pixels of 600 arcmin", vec![("display.pixel_pitch_cm", json!(140))]),
        (
            "no drop of pigment",
            vec![
                ("eye.macular_peak_density", json!(0)),
                ("eye.lens_density_scale", json!(0)),
                ("eye.cornea_density_scale", json!(0)),
            ],
        ),
    ]
}

/// Cases that must be refused: name, change, what the error must name.
fn wrong() -> Vec<(&'static str, &'static str, Value)> {
    vec![
        ("pupil 0.4 mm", "eye.pupil_mm", json!(0.4)),
        ("pupil 9.1 mm", "eye.pupil_mm", json!(9.1)),
        ("luminance -1", "display.white_luminance_cd_m2", json!(-1)),
        ("luminance 1e8", "display.white_luminance_cd_m2", json!(1e8)),
        ("no pixel", "display.width_px", json!(0)),
        ("8,193 pixels", "display.width_px", json!(8193)),
        ("peak density 0", "retina.peak_density_per_mm2", json!(0)),
        ("peak density 1e9", "retina.peak_density_per_mm2", json!(1e9)),
        ("frames of 0 Hz", "display.frame_rate_hz", json!(0)),
        (
            "an empty patch",
            "retina.region_deg",
            json!({"x_min": 0.1, "x_max": 0.1, "y_min": 0, "y_max": 0.1}),
        ),
        ("accuracy 0", "accuracy.target", json!(0)),
    ]
}

fn large_display() -> Found {
    let changes = [
        ("display.width_px", json!(8192)),
        ("display.height_px", json!(8192)),
        ("gaze.center_px", json!([4096, 4096])),
    ];
    match experiment(&with(small(), &changes)).and_then(|e| plan(&e).map_err(|e| e.to_string())) {
        Ok(plan) => Found::new("seconds foreseen", plan.predicted_seconds, 3600.0),
        Err(why) => Found::new(why.clone(), if why.contains("retina.region_deg") { 0.0 } else { 1.0 }, 0.0),
    }
}

/// Adds the cases.
pub fn cases(cases: &mut Cases) {
    // Most cases have the same mosaic; it is made once.
    let mut kept = Runner::default();
    let runner = &mut kept;
    for (name, changes) in right() {
        cases.add(GROUP, name, || Ok(whole(&run(runner, &with(small(), &changes))?)));
    }
    if !cases.is_quick() {
        let ring = [("retina.generator", json!("RING"))];
        cases.add(GROUP, "ring generator", || Ok(whole(&run(runner, &with(small(), &ring))?)));
    }
    for (name, field, value) in wrong() {
        cases.add(GROUP, &format!("{name} is refused"), || refused(&with(small(), &[(field, value)]), field));
    }
    cases.add(GROUP, "a display of 8192 x 8192 is planned or refused by name", || Ok(large_display()));
    cases.add(GROUP, "drift 1000°/s at 60 Hz is computed or refused by name", || {
        let fast = json!({"drift": {"speed_arcmin_per_s": 60000, "direction_deg": 30}});
        match run(runner, &with(small(), &[("gaze.movement", fast)])) {
            Ok(outcome) => Ok(whole(&outcome)),
            Err(why) => {
                let named = ["gaze.", "retina.region_deg"].iter().any(|field| why.contains(field));
                Ok(Found::new(why, if named { 0.0 } else { 1.0 }, 0.0))
            }
        }
    });
    cases.add(GROUP, "no photon, no count", || dark(runner, &[("display.white_luminance_cd_m2", json!(0))]));
    cases.add(GROUP, "Poisson counts of 1e-6 cd/m² in 1 µs", || {
        dark(runner, &[("display.white_luminance_cd_m2", json!(1e-6)), ("display.frame_rate_hz", json!(1e6))])
    });
    cases.add(GROUP, "Poisson counts of 1e7 cd/m²: sum against means", || {
        sums(runner, &[("display.white_luminance_cd_m2", json!(1e7))])
    });
    cases.add(GROUP, "doubled light doubles the means", || doubled(runner));
    let point = json!({"pattern": {"point": {"at_px": [4, 4], "rgb": [1, 1, 1]}}});
    let drift = json!({"drift": {"speed_arcmin_per_s": 600, "direction_deg": 30}});
    let scenes: [(&str, Vec<(&str, Value)>); 4] = [
        ("squares", vec![]),
        ("one pixel 1e7 times as bright", vec![("video", point), ("display.contrast", json!(1e7))]),
        ("a moving eye", vec![("gaze.movement", drift)]),
        ("6 mm of pupil", vec![("eye.pupil_mm", json!(6))]),
    ];
    for (name, changes) in scenes {
        let name = format!("single against double precision: {name}");
        cases.add(GROUP, &name, || precision(runner, &changes));
    }
    cases.add(GROUP, "an accuracy of 1e-5 is computed or refused with the best there is", || {
        match run(runner, &with(small(), &[("accuracy.target", json!(1e-5))])) {
            Ok(outcome) => Ok(whole(&outcome)),
            Err(why) => {
                let named = why.contains("accuracy.target") && why.contains("to 0.2");
                Ok(Found::new(why, if named { 0.0 } else { 1.0 }, 0.0))
            }
        }
    });
    cases.add(GROUP, "pixels of 0.001 arcmin are computed or refused by name", || {
        match run(runner, &with(small(), &[("display.pixel_pitch_cm", json!(2.33e-4))])) {
            Ok(outcome) => Ok(whole(&outcome)),
            Err(why) => {
                let named = why.contains("display.pixel_pitch_cm") || why.contains("retina.region_deg");
                Ok(Found::new(why, if named { 0.0 } else { 1.0 }, 0.0))
            }
        }
    });
}

fn run(runner: &mut Runner, spec: &Value) -> Result<Outcome, String> {
    runner.run(&experiment(spec)?, &[])
}

/// Means that are no numbers or below 0 (each counts 1), and photons without a fate.
fn whole(outcome: &Outcome) -> Found {
    let wrong = outcome.counts.iter().filter(|c| !(c.is_finite() && **c >= 0.0)).count();
    let budget = &outcome.budget;
    let lost = if budget.emitted > 0.0 {
        (budget.fates() / budget.emitted - 1.0).abs()
    } else {
        budget.fates().abs()
    };
    let what = format!(
        "wrong means + photons without a fate; {} cones, {:.3e} emitted, {:.3e} counted",
        outcome.counts.len(),
        budget.emitted,
        outcome.counts.iter().fold(0.0, |sum, c| sum + c)
    );
    Found::new(what, wrong as f64 + lost, 1e-6)
}

fn refused(spec: &Value, field: &str) -> Result<Found, String> {
    match experiment(spec).and_then(|e| plan(&e).map_err(|e| e.to_string())) {
        Ok(_) => Err("it was accepted".into()),
        Err(why) => Ok(Found::new(why.clone(), if why.contains(field) { 0.0 } else { 1.0 }, 0.0)),
    }
}

/// Counts where hardly a photon comes: at most one in all.
fn dark(runner: &mut Runner, changes: &[(&str, Value)]) -> Result<Found, String> {
    let outcome = run(runner, &with(with(small(), changes), &[("counts.noise", json!("POISSON"))]))?;
    Ok(Found::new("counts in all cones", outcome.counts.iter().sum(), 1.0))
}

/// Sum of Poisson counts against the sum of the means, in standard deviations.
fn sums(runner: &mut Runner, changes: &[(&str, Value)]) -> Result<Found, String> {
    let means: f64 = run(runner, &with(small(), changes))?.counts.iter().sum();
    let counts: f64 = run(runner, &with(with(small(), changes), &[("counts.noise", json!("POISSON"))]))?
        .counts
        .iter()
        .sum();
    Ok(Found::new("standard deviations (alpha 6e-7)", (counts - means).abs() / means.sqrt(), 5.0))
}

/// The means are linear in the light.
fn doubled(runner: &mut Runner) -> Result<Found, String> {
    let mut at = |l: f64| run(runner, &with(small(), &[("display.white_luminance_cd_m2", json!(l))]));
    let (one, two) = (at(100.0)?, at(200.0)?);
    let most = one.counts.iter().copied().fold(0.0, f64::max);
    let off = one.counts.iter().zip(&two.counts).map(|(a, b)| (b - 2.0 * a).abs()).fold(0.0, f64::max);
    Ok(Found::new("largest difference / largest mean (f32 results)", off / most, 1e-6))
}

/// Images in single precision against double: L1 over cones, and the largest error against the brightest cone.
fn precision(runner: &mut Runner, changes: &[(&str, Value)]) -> Result<Found, String> {
    let of = |runner: &mut Runner, double: bool| {
        let double = [("counts.settings.double_precision", json!(double))];
        run(runner, &with(with(small(), changes), &double))
    };
    let (single, double) = (of(runner, false)?.counts, of(runner, true)?.counts);
    let brightest = double.iter().copied().fold(0.0, f64::max);
    let off = || single.iter().zip(&double).map(|(a, b)| (a - b).abs());
    let most = off().fold(0.0, f64::max) / brightest;
    let l1 = off().sum::<f64>() / double.iter().sum::<f64>();
    Ok(Found::new(format!("L1 error; against the brightest cone at most {most:.1e}"), l1.max(most), 1e-5))
}
