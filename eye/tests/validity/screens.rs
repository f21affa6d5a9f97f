//! Screens off the middle, tilted and curved, and eyes that turn before them: the engines against the audit,
//! which traces source points of its own and turns each cone's own line of sight.

use photoneye_eye::display::{EmissionLaw, Placement, White};
use photoneye_eye::experiment::{Engine, Experiment, Gaze, Movement, Pattern};
use photoneye_eye::exposure::Memo;
use photoneye_eye::exposure::audit::{Verdict, verdict};

use crate::source::{Prepared, scene};

/// A flat screen of half-millimetre pixels 60 cm away, the point straight ahead in its middle.
const FLAT: Placement =
    Placement::Fixed { eye_at_px: [600.5, 300.5], tilt_deg: 0.0, turn_deg: 0.0, curvature_radius_cm: None };
const ONE_PIXEL: Pattern = Pattern::Checkerboard { square_px: 1 };
const EVEN: Pattern = Pattern::Uniform { rgb: [1.0; 3] };

fn tilted(tilt_deg: f64, turn_deg: f64) -> Placement {
    Placement::Fixed { eye_at_px: [600.5, 300.5], tilt_deg, turn_deg, curvature_radius_cm: None }
}

/// A patch of 2 x 1.2° whose middle is `ecc_deg` to the left of the gaze.
fn before(placement: Placement, (gaze_px, ecc_deg): ([f64; 2], f64), pattern: Pattern) -> Experiment {
    let mut experiment = scene(pattern, 3.0, 0.0, 1e-3);
    let display = &mut experiment.display;
    (display.width_px, display.height_px) = (1201, 601);
    (display.pixel_pitch_cm, display.distance_cm) = (0.05, 60.0);
    (display.placement, display.emission_law) = (placement, EmissionLaw::Lambertian);
    experiment.eye.focus_distance_cm = 60.0;
    experiment.gaze = Gaze::still(gaze_px);
    experiment.retina.region_deg = Some([-1.0 - ecc_deg, 1.0 - ecc_deg, -0.6, 0.6]);
    experiment.audit_cones = 16;
    experiment
}

fn turned(mut experiment: Experiment, [x, y]: [f64; 2]) -> Experiment {
    experiment.gaze.movement = Movement::Recorded(vec![[0.0, x, y], [1.0, x, y]]);
    experiment
}

fn audit(experiment: &Experiment) -> (Verdict, f64) {
    let prepared = Prepared::new(experiment);
    let frame = prepared.exposure.frame(0, None).unwrap();
    let samples = prepared.exposure.audit(0, None, &[], &frame).unwrap();
    let estimate = prepared.plan.error_estimate.iter().map(|part| part.relative).sum();
    (verdict(&samples, experiment.counts.engine != Engine::Expected).unwrap(), estimate)
}

/// Eyes at rest. The audit followed pixels that are seen foreshortened too coarsely: a near screen tilted by
/// 50° was 3e-3 off, even fields too.
#[test]
fn screens_in_every_place() {
    let curved = Placement::Fixed {
        eye_at_px: [600.5, 300.5],
        tilt_deg: 0.0,
        turn_deg: 0.0,
        curvature_radius_cm: Some(60.0),
    };
    for (name, placement, gaze, distance_cm) in [
        ("gaze 24° aside", FLAT, ([1140.5, 300.5], 0.0), 60.0),
        ("the same, 8° beside the fovea", FLAT, ([1140.5, 300.5], 8.0), 60.0),
        ("tilted and turned", tilted(30.0, -20.0), ([700.0, 200.0], 0.0), 60.0),
        ("curved about the eye", curved, ([1140.5, 300.5], 0.0), 60.0),
        ("near, tilted by 50°", tilted(-50.0, 0.0), ([600.0, 350.0], 0.0), 20.0),
    ] {
        for pattern in [Pattern::Checkerboard { square_px: 4 }, EVEN] {
            let mut experiment = before(placement, gaze, pattern);
            experiment.display.distance_cm = distance_cm;
            experiment.eye.focus_distance_cm = distance_cm;
            let (found, estimate) = audit(&experiment);
            println!("{name}: audit {:.1e}, estimate {estimate:.1e}", found.relative_error);
            assert!(found.relative_error < experiment.accuracy_target, "{name}");
        }
    }
}

/// Eyes that turn by 15 and 63 arcmin, squares of one pixel (2.9 arcmin) and even fields: `TURN` of
/// `plan/error.rs`. One setting is made by hand, so that the plan does not refuse what the target does not
/// allow.
#[test]
fn eyes_that_turn() {
    for (name, placement, gaze) in [
        ("gaze 24° aside", FLAT, ([1140.5, 300.5], 0.0)),
        ("the same, 8° beside the fovea", FLAT, ([1140.5, 300.5], 8.0)),
        ("across the line of sight, 8°", Placement::Frontal, ([1140.5, 300.5], 8.0)),
        ("tilted and turned", tilted(40.0, -20.0), ([700.0, 200.0], 0.0)),
    ] {
        for turn in [[15.0, 0.0], [60.0, 20.0]] {
            for (pattern, what) in [(ONE_PIXEL, "squares"), (EVEN, "even")] {
                let mut experiment = turned(before(placement, gaze, pattern), turn);
                experiment.counts.knobs.double_precision = Some(true);
                let (found, estimate) = audit(&experiment);
                let error = found.relative_error;
                println!("{name}, {turn:?} arcmin, {what}: audit {error:.1e}, estimate {estimate:.1e}");
                assert!(error < estimate && (what == "squares" || error < 1e-3), "{name}");
            }
        }
    }
}

/// Photons of an eye that turns land where its cones see them. With one movement for a whole tile, and the
/// light of the places at rest, squares of four pixels were 2.4e-2 off.
#[test]
fn photons_of_an_eye_that_turns() {
    let pattern = Pattern::Checkerboard { square_px: 4 };
    let mut experiment = turned(before(FLAT, ([1140.5, 300.5], 0.0), pattern), [60.0, 20.0]);
    experiment.counts.engine = Engine::Events;
    experiment.counts.poisson = true;
    experiment.display.white = White::LuminanceCdM2(3000.0);
    experiment.audit_cones = 60;
    let (found, _) = audit(&experiment);
    let lower = found.lower_bound_95.unwrap();
    println!("EVENTS: audit {:.1e}, at least {lower:.1e}", found.relative_error);
    assert!(lower < 3e-3, "{lower}");
}

/// What is kept from one frame to the next changes no bit of it.
#[test]
fn frames_do_not_depend_on_those_before() {
    let mut experiment = before(FLAT, ([1140.5, 300.5], 0.0), ONE_PIXEL);
    experiment.gaze.movement = Movement::Drift { speed_arcmin_per_s: 600.0, direction_deg: 30.0 };
    experiment.counts.knobs.double_precision = Some(true);
    experiment.frames = 4;
    let prepared = Prepared::new(&experiment);
    let mut memo = Memo::default();
    // Forth, twice the same and back.
    for index in [0, 1, 1, 2, 3, 0] {
        let going_on = prepared.exposure.frame_going_on(index, (None, &[]), &mut memo).unwrap().counts;
        let alone = prepared.exposure.frame(index, None).unwrap().counts;
        assert_eq!(going_on, alone, "{index}");
    }
}
