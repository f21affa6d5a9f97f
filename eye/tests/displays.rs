//! Displays: lowering, extremes, time inside a frame. Closed forms and conservation.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use glam::DVec2;
use photoneye_eye::display::{Channel, Display, EmissionLaw, Levels, Panel, Waveform, White, emitters};
use photoneye_eye::experiment::{Experiment, Gaze, Movement, Pattern};
use photoneye_eye::exposure::{FrameCounts, cone_columns};
use photoneye_eye::optics::{Dispersion, EyeState, Prescription, Projection, SchematicEye, Side};
use photoneye_eye::plan::plan;
use photoneye_eye::spectrum::Spectrum;
use photoneye_eye::video::{Picture, ScreenView, draw};
use support::{WHITE, cached_exposure as exposure, cached_retina as retina, figure_12, primary};

/// One line of light, few pixels, means: a test takes little time.
fn small(pattern: Pattern) -> Experiment {
    let mut experiment = figure_12(pattern);
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 555.0, fwhm_nm: 0.0 })];
    experiment.display.width_px = 8;
    experiment.display.height_px = 8;
    experiment.gaze = Gaze::still([4.0, 4.0]);
    experiment.counts.poisson = false;
    experiment
}

fn means(experiment: &Experiment, index: u32) -> Vec<f64> {
    means_of(experiment, index, None, &[])
}

fn means_of(
    experiment: &Experiment,
    index: u32,
    picture: Option<&Picture>,
    earlier: &[&Picture],
) -> Vec<f64> {
    match exposure(experiment).frame_after(index, picture, earlier).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(_) => panic!("means were asked for"),
    }
}

fn l1(a: &[f64], b: &[f64]) -> f64 {
    let total: f64 = a.iter().sum();
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / total
}

fn drift(experiment: &mut Experiment, speed_arcmin_per_s: f64) {
    experiment.gaze.movement = Movement::Drift { speed_arcmin_per_s, direction_deg: 20.0 };
}

/// To a still eye a still picture is the same whatever its waveform and lag.
#[test]
fn a_still_eye_sees_no_waveform() {
    let steady = means(&small(Pattern::Checkerboard { square_px: 2 }), 0);
    for (waveform, lag_ms) in [
        (Waveform::Pulses(vec![[0.1, 0.3]]), 0.0),
        (Waveform::Steady, 9.0),
        (Waveform::Pwm { hz: 240.0, duty: 0.2 }, 0.0),
        (Waveform::Phosphor { decay_us: 200.0, start: 0.0 }, 0.0),
    ] {
        let mut experiment = small(Pattern::Checkerboard { square_px: 2 });
        experiment.display.primaries[0].waveform = waveform.clone();
        experiment.display.panel.lag_ms = lag_ms;
        assert!(l1(&steady, &means(&experiment, 3)) < 1e-6, "{waveform:?}");
    }
}

/// A flash during 1/1000 of the frame freezes a moving eye: the picture is that of an eye at rest, moved.
#[test]
fn a_flash_freezes_movement_and_a_steady_light_smears_it() {
    let frame = |start: Option<f64>| {
        let mut experiment = small(Pattern::Point { at_px: [4, 4], rgb: [1.0; 3] });
        experiment.retina.region_deg = Some([-0.25, 0.25, -0.25, 0.25]);
        drift(&mut experiment, 300.0);
        if let Some(start) = start {
            experiment.display.primaries[0].waveform = Waveform::Pulses(vec![[start, start + 1e-3]]);
        }
        means(&experiment, 0)
    };
    // 300 arcmin/s move 5 arcmin in a frame: the mean of flashes over the frame is the steady light.
    let n = 40;
    let mut mean = vec![0.0; frame(None).len()];
    for i in 0..n {
        let flash = frame(Some((f64::from(i) + 0.5) / f64::from(n) - 0.5e-3));
        mean.iter_mut().zip(&flash).for_each(|(m, f)| *m += f / f64::from(n));
    }
    let error = l1(&frame(None), &mean);
    assert!(error < 2e-3, "{error}");
    let peak = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    assert!(peak(&frame(Some(0.0))) > 1.5 * peak(&frame(None)));
}

/// Lag: after a change from black to white the frame holds the closed form's share of the light, and a later black frame the ghost.
#[test]
fn ghosts_have_the_closed_forms_light() {
    let mut experiment = small(WHITE);
    experiment.display.panel = Panel { lag_ms: 10.0, levels: Levels::Continuous };
    let white = draw(&WHITE, &ScreenView::frontal(&experiment.display, &experiment.gaze));
    let black = Picture { rgb: vec![0.0; white.rgb.len()], ..white };
    let full: f64 = means_of(&experiment, 0, Some(&white), &[]).iter().sum();
    let folds = (1.0 / 60.0) / 10e-3;
    let left = (1.0 - f64::exp(-folds)) / folds;
    let rise: f64 = means_of(&experiment, 1, Some(&white), &[&black]).iter().sum();
    assert!((rise / full - (1.0 - left)).abs() < 1e-6, "{}", rise / full);
    let ghost: f64 = means_of(&experiment, 2, Some(&black), &[&white, &black]).iter().sum();
    let expected = left * (1.0 - f64::exp(-folds));
    assert!((ghost / full - expected).abs() < 1e-6, "{} {expected}", ghost / full);
}

/// Bit planes, moving: the sum of planes is the light, and planes at other times fall on other places.
#[test]
fn bit_planes_keep_the_light_and_smear_apart() {
    let mut experiment = small(Pattern::Uniform { rgb: [0.5; 3] });
    experiment.retina.region_deg = Some([-0.3, 0.3, -0.3, 0.3]);
    drift(&mut experiment, 300.0);
    let frame = |levels: Levels| {
        let mut experiment = experiment.clone();
        experiment.display.panel.levels = levels;
        let emitted = exposure(&experiment).frame(0, None).unwrap().budget.emitted;
        (means(&experiment, 0), emitted)
    };
    let (smooth, all) = frame(Levels::Continuous);
    let (planes, emitted) = frame(Levels::Planes { bits: 8, dither: false });
    let light = (0.5_f64 + 0.055) / 1.055;
    let steps = 255.0 * light.powf(2.4);
    assert!((emitted / all * steps / steps.round() - 1.0).abs() < 1e-6, "{}", emitted / all);
    assert!(l1(&smooth, &planes) > 0.02, "the highest bits light the end of the frame only");
    // The mean place of the light: planes at their times against the middle of the frame.
    let columns = cone_columns(&experiment, &retina(&experiment)).unwrap();
    let place = |values: &[f64]| {
        let total: f64 = values.iter().sum();
        columns.x_deg.iter().zip(values).map(|(x, v)| x * v).sum::<f64>() / total
    };
    let bits = steps.round() as u32;
    let middle: f64 = (0..8)
        .filter(|bit| bits >> bit & 1 == 1)
        .map(|bit| f64::from(1_u32 << bit) * (1.5 * f64::from(1_u32 << bit) - 1.0) / 255.0)
        .sum::<f64>()
        / f64::from(bits);
    let moved_arcmin = 60.0 * (place(&planes) - place(&smooth));
    let expected = -(middle - 0.5) * 300.0 / 60.0 * 20_f64.to_radians().cos();
    assert!((moved_arcmin / expected - 1.0).abs() < 0.05, "{moved_arcmin} {expected}");
}

/// Black level and room light add what they should.
#[test]
fn contrast_and_room_light_add_up() {
    let black = Pattern::Uniform { rgb: [0.0; 3] };
    let total = |experiment: &Experiment| means(experiment, 0).iter().sum::<f64>();
    let white = total(&small(WHITE));
    let mut dim = small(black.clone());
    assert!(total(&dim) == 0.0);
    dim.display.black = 0.01;
    assert!((total(&dim) / white - 0.01).abs() < 1e-9);
    let mut bright = small(WHITE);
    bright.display.black = 0.01;
    assert!((total(&bright) / white - 1.0).abs() < 1e-9, "white stays white");
    // Room light of the same spectrum and a tenth of the luminance.
    let mut lit = small(black);
    let mut room = lit.display.primaries[0].clone();
    room.channel = Channel::Room;
    room.power = 25.0;
    lit.display.primaries.push(room);
    assert!((total(&lit) / white - 0.1).abs() < 1e-6, "{}", total(&lit) / white);
}

/// A spot blurs: variance of the landing places grows by that of the spot.
#[test]
fn a_spot_adds_its_variance() {
    let spread = |spot_sd_px: f64| {
        let mut experiment = small(Pattern::Point { at_px: [4, 4], rgb: [1.0; 3] });
        experiment.display.primaries[0].spot_sd_px = spot_sd_px;
        let columns = cone_columns(&experiment, &retina(&experiment)).unwrap();
        let means = means(&experiment, 0);
        let weight = |i: usize| means[i];
        let total: f64 = (0..means.len()).map(weight).sum();
        let mean = (0..means.len()).map(|i| weight(i) * columns.x_deg[i]).sum::<f64>() / total;
        (0..means.len()).map(|i| weight(i) * (columns.x_deg[i] - mean).powi(2)).sum::<f64>() / total
    };
    let pixel_deg = 0.58_f64.atan2(800.0).to_degrees();
    let grown = (spread(0.6) - spread(0.0)) / pixel_deg.powi(2);
    // Sampled by cones 0.2 pixels apart, and with the tail that the patch cuts off.
    assert!((grown / 0.36 - 1.0).abs() < 0.05, "{grown}");
}

/// Photons into the pupil from one pixel of a large flat screen, against the beam that passes the real stop from the pixel's middle.
#[test]
fn flat_screens_are_seen_by_ray_geometry() {
    let pupil = |at_px: [u32; 2], emission_law: EmissionLaw| {
        let mut experiment = small(Pattern::Point { at_px, rgb: [1.0; 3] });
        experiment.display = Display {
            width_px: 401,
            height_px: 401,
            pixel_pitch_cm: 10.0,
            distance_cm: 1000.0,
            emission_law,
            ..experiment.display
        };
        experiment.gaze = Gaze::still([200.5; 2]);
        experiment.retina.region_deg = Some([-0.1, 0.1, -0.1, 0.1]);
        let budget = exposure(&experiment).frame(0, None).unwrap().budget;
        budget.into_pupil() / budget.emitted
    };
    // Light of a point of the screen (cm from its middle) into the beam that passes the real stop.
    let preset = Prescription::preset("escudero-sanz-navarro").unwrap();
    let state = EyeState {
        pupil_mm: 3.0,
        decentre_mm: 0.4,
        accommodation_a: 0.0,
        dispersion: Dispersion::Herzberger,
        side: Side::Right,
    };
    let eye = SchematicEye::new(&preset, &state).unwrap();
    let projection = Projection::new(&eye, 10_000.0).unwrap();
    let by_rays = |[x, y]: [f64; 2], law: EmissionLaw| {
        let tangent = DVec2::new(x, y) / 1000.0;
        let beam = eye.beam_mm2(projection.object(tangent), 543.0).unwrap();
        let cos = 1.0 / 1.0_f64.hypot(tangent.length());
        let radiated = match law {
            EmissionLaw::Lambertian => cos / std::f64::consts::PI,
            EmissionLaw::Uniform => 1.0 / std::f64::consts::TAU,
        };
        radiated * beam * (cos / 10_000.0).powi(2)
    };
    for law in [EmissionLaw::Lambertian, EmissionLaw::Uniform] {
        // The middle is exact by definition: the pupil's area is that seen along the line of sight.
        let (middle, rays) = (pupil([200, 200], law), by_rays([0.0, 0.0], law));
        for at_px in [[400, 200], [0, 200], [200, 0], [300, 100], [150, 390]] {
            let at = [f64::from(at_px[0]) - 200.0, 200.0 - f64::from(at_px[1])].map(|v| 10.0 * v);
            let (share, expected) = (pupil(at_px, law) / middle, by_rays(at, law) / rays);
            assert!((share / expected - 1.0).abs() < 0.003, "{at_px:?} {law:?} {share} {expected}");
        }
    }
}

fn finite(experiment: &Experiment) -> f64 {
    let values = means(experiment, 0);
    assert!(values.iter().all(|v| v.is_finite() && *v >= 0.0));
    values.iter().sum()
}

/// From no light to 1e7 cd/m², from 1 µs to 100 s, one pixel, the ends of the spectrum: finite, and in proportion.
#[test]
fn extremes_are_served() {
    let normal = finite(&small(WHITE));
    let with = |change: &dyn Fn(&mut Experiment)| {
        let mut experiment = small(WHITE);
        change(&mut experiment);
        finite(&experiment)
    };
    assert!(with(&|e| e.display.white = White::LuminanceCdM2(0.0)) == 0.0);
    assert!((with(&|e| e.display.white = White::LuminanceCdM2(1e7)) / normal / 4e4 - 1.0).abs() < 1e-5);
    assert!((with(&|e| e.display.white = White::LuminanceCdM2(1e-6)) / normal * 2.5e8 - 1.0).abs() < 1e-5);
    assert!((with(&|e| e.display.frame_rate_hz = 1e6) / normal * (1e6 / 60.0) - 1.0).abs() < 1e-5);
    assert!((with(&|e| e.display.frame_rate_hz = 0.01) / normal * (0.01 / 60.0) - 1.0).abs() < 1e-5);
    for nm in [390.0, 830.0] {
        assert!(with(&|e| e.display.primaries[0].spectrum = Spectrum::Line { nm, fwhm_nm: 0.0 }) > 0.0);
    }
    let one = with(&|e| {
        e.display.width_px = 1;
        e.display.height_px = 1;
        e.gaze.center_px = [0.5, 0.5];
    });
    assert!((one * 64.0 / normal - 1.0).abs() < 0.05, "{}", one * 64.0 / normal);
    // 1000°/s: 3.3° in 1/300 s sweep over the patch.
    let swept = with(&|e| {
        e.display.frame_rate_hz = 300.0;
        e.retina.region_deg = Some([-0.3, 0.3, -0.3, 0.3]);
        drift(e, 60000.0);
    });
    assert!(swept > 0.0 && swept < normal);
    // The brightest light for the longest time gives more than a count holds.
    let mut bright = small(WHITE);
    bright.display.white = White::LuminanceCdM2(1e7);
    bright.display.frame_rate_hz = 0.01;
    bright.counts.poisson = true;
    let refused = plan(&bright).unwrap_err().to_string();
    assert!(refused.contains("display.white_luminance_cd_m2") && refused.contains("at most"), "{refused}");
}

#[test]
fn what_has_no_meaning_is_refused() {
    let refused = |change: &dyn Fn(&mut Experiment), field: &str| {
        let mut experiment = small(WHITE);
        change(&mut experiment);
        let error = experiment.validate().unwrap_err();
        assert!(error.field.contains(field), "{error}");
    };
    refused(&|e| e.display.primaries[0].waveform = Waveform::Pulses(vec![[0.5, 0.4]]), "waveform.pulse.end");
    refused(
        &|e| e.display.primaries[0].waveform = Waveform::Pulses(vec![[0.0, 0.5], [0.4, 0.6]]),
        "parts[1].start",
    );
    refused(&|e| e.display.primaries[0].waveform = Waveform::Pwm { hz: 1e6, duty: 0.5 }, "pwm.hz");
    refused(&|e| e.display.panel.lag_ms = 9000.0, "display.lag_ms");
    refused(&|e| e.display.panel.levels = Levels::Values { bits: 17, dither: false }, "levels.bits");
    refused(
        &|e| {
            e.display.panel.levels = Levels::Planes { bits: 8, dither: false };
            e.display.panel.lag_ms = 5.0;
        },
        "display.lag_ms",
    );
    refused(&|e| e.display.primaries[0].spot_sd_px = f64::NAN, "spot_sd_px");
    let mut unseen = small(WHITE);
    unseen.display.primaries[0].power = 0.0;
    assert!(emitters(&unseen.display).is_err());
}
