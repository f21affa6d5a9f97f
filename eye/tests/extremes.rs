//! The ends of the ranges of model.md §11 that displays, videos, movements and mosaics have: a right number or an error that names the field.
//! Luminance, frame times, spectral ends and one pixel are in displays.rs; whole experiments more in `photoneye study stability`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::display::{Channel, White};
use photoneye_eye::experiment::{Engine, Experiment, Gaze, Movement, Pattern};
use photoneye_eye::exposure::{ExposureError, Frame, FrameCounts};
use photoneye_eye::plan::largest::largest_mean;
use photoneye_eye::plan::{plan, setup::setup};
use photoneye_eye::spectrum::Spectrum;
use photoneye_eye::video::{ClipFormat, Limits, Matrix, Picture, Range, Raw, Yuv, clip_info, decode_frame};
use support::{WHITE, cached_exposure as exposure, figure_12, primary};

fn small(pattern: Pattern) -> Experiment {
    let mut experiment = figure_12(pattern);
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 555.0, fwhm_nm: 0.0 })];
    (experiment.display.width_px, experiment.display.height_px) = (8, 8);
    experiment.gaze = Gaze::still([4.0, 4.0]);
    experiment.retina.region_deg = Some([-0.1, 0.1, -0.1, 0.1]);
    experiment.counts.poisson = false;
    experiment
}

/// The sum of a frame's counts, all of which are numbers; every photon has one fate.
fn whole(experiment: &Experiment) -> f64 {
    let frame: Frame = exposure(experiment).frame(0, None).unwrap();
    let budget = frame.budget;
    assert!((budget.fates() - budget.emitted).abs() <= 1e-9 * budget.emitted, "{budget:#?}");
    match frame.counts {
        FrameCounts::Means(means) => {
            assert!(means.iter().all(|m| m.is_finite() && *m >= 0.0));
            means.into_iter().map(f64::from).sum()
        }
        FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).sum(),
    }
}

/// One lit pixel beside others 1e7 times darker: the dark ones keep their light (they are not lost in rounding), to the bright one's blur.
#[test]
fn one_pixel_may_be_a_million_times_brighter() {
    let mut experiment = small(Pattern::Point { at_px: [4, 4], rgb: [1.0; 3] });
    experiment.display.white = White::LuminanceCdM2(1e7);
    let alone = whole(&experiment);
    experiment.display.black = 1e-7;
    let with = whole(&experiment);
    assert!(alone > 0.0 && with > alone, "{alone} {with}");
    // The black of 64 pixels adds 64e-7 of one pixel's light, spread evenly; f32 results round at 6e-8.
    let added = (with - alone) / alone;
    assert!(added > 1e-6 && added < 2e-5, "{added:e}");
}

/// Pixels from 0.001 to 600 arcmin: the same luminance gives the same light per area where the screen covers the patch.
#[test]
fn pixels_of_any_size() {
    let sized = |arcmin: f64, side: u32| {
        let mut experiment = small(WHITE);
        experiment.display.distance_cm = 100.0;
        experiment.eye.focus_distance_cm = 100.0;
        experiment.display.pixel_pitch_cm = 100.0 * (arcmin / 60.0).to_radians().tan();
        experiment.display.primaries[0].rects = vec![[0.0, 0.0, 1.0, 1.0]];
        (experiment.display.width_px, experiment.display.height_px) = (side, side);
        experiment.gaze = Gaze::still([0.5 * f64::from(side); 2]);
        experiment
    };
    let (ten, large) = (whole(&sized(10.0, 60)), whole(&sized(600.0, 2)));
    assert!((large / ten - 1.0).abs() < 2e-3, "{large} {ten}");
    // 8 pixels of 0.001 arcmin are a point: its light is that of its area.
    let (point, pixel) = (whole(&sized(0.001, 8)), whole(&sized(0.008, 1)));
    assert!(point > 0.0 && (point / pixel - 1.0).abs() < 1e-3, "{point} {pixel}");
}

/// 8192 x 8192 pixels: planned within a second and 4 GB when they are fine, refused by name when they are a
/// hemisphere, and a patch of them runs.
#[test]
fn the_largest_display_is_planned_or_refused() {
    let mut experiment = small(Pattern::Checkerboard { square_px: 64 });
    (experiment.display.width_px, experiment.display.height_px) = (8192, 8192);
    experiment.gaze = Gaze::still([4096.0, 4096.0]);
    let started = std::time::Instant::now();
    for (pitch_cm, whole_screen) in [(0.01, true), (0.58, false)] {
        experiment.display.pixel_pitch_cm = pitch_cm;
        let bytes = plan(&experiment).unwrap().predicted_bytes;
        assert!(bytes < 4e9, "a patch of it: {bytes:e}");
        let all = Experiment {
            retina: photoneye_eye::experiment::Retina { region_deg: None, ..experiment.retina.clone() },
            ..experiment.clone()
        };
        match plan(&all) {
            Ok(plan) => assert!(whole_screen && plan.predicted_bytes < 4e9),
            Err(error) => {
                assert!(!whole_screen && error.to_string().contains("retina.region_deg"), "{error}");
            }
        }
    }
    println!("four plans in {:.2} s", started.elapsed().as_secs_f64());
    assert!(started.elapsed().as_secs_f64() < 20.0);
    experiment.display.pixel_pitch_cm = 0.01;
    assert!(whole(&experiment) > 0.0);
}

/// Drift of 0, 1e-12 and 1000 °/s: the first two are rest; the third crosses the patch or is refused by name.
#[test]
fn drifts_of_any_speed() {
    let drifting = |speed_arcmin_per_s: f64, hz: f64| {
        let mut experiment = small(WHITE);
        experiment.display.frame_rate_hz = hz;
        experiment.gaze.movement = Movement::Drift { speed_arcmin_per_s, direction_deg: 30.0 };
        experiment
    };
    let rest = whole(&small(WHITE));
    for speed in [0.0, 1e-12 * 60.0] {
        assert!((whole(&drifting(speed, 60.0)) / rest - 1.0).abs() < 1e-6, "{speed}");
    }
    let swift = whole(&drifting(60_000.0, 1000.0));
    assert!(swift > 0.0 && swift < rest * 60.0 / 1000.0);
    let error = plan(&drifting(60_000.0, 10.0)).unwrap_err().to_string();
    assert!(error.contains("gaze.movement.drift.speed_arcmin_per_s"), "{error}");
}

/// Seeds 0 and 2^64-1 are seeds like others, in every engine; an all-black video gives zeros; a patch may hold one cone.
#[test]
fn seeds_black_and_a_single_cone() {
    for engine in [Engine::Expected, Engine::Events, Engine::Paper] {
        let mut lit = small(WHITE);
        lit.counts.engine = engine;
        lit.counts.poisson = true;
        let totals = [0, u64::MAX].map(|seed| {
            lit.counts.seed = seed;
            lit.retina.seed = 1;
            whole(&lit)
        });
        let sigma = totals[0].sqrt() * 2_f64.sqrt();
        assert!(totals[0] > 0.0 && (totals[0] - totals[1]).abs() < 5.0 * sigma, "{engine:?} {totals:?}");
        assert!(totals[0].to_bits() != totals[1].to_bits());
        let mut black = small(Pattern::Uniform { rgb: [0.0; 3] });
        black.counts.engine = engine;
        black.counts.poisson = true;
        assert!(whole(&black) == 0.0);
    }
    for seed in [0, u64::MAX] {
        let mut experiment = small(WHITE);
        experiment.retina.seed = seed;
        experiment.gaze.seed = seed;
        experiment.gaze.movement = Movement::Walk { unit_arcmin: 0.5 };
        assert!(whole(&experiment) > 0.0);
    }
    let single = (1..60).map(|i| 1e-4 * f64::from(i)).find_map(|half| {
        let mut experiment = small(WHITE);
        experiment.retina.region_deg = Some([-half, half, -half, half]);
        (exposure(&experiment).len() == 1).then_some(experiment)
    });
    let mut single = single.unwrap();
    assert!(whole(&single) > 0.0);
    for engine in [Engine::Events, Engine::Paper] {
        single.counts.engine = engine;
        single.counts.poisson = true;
        assert!(whole(&single) > 0.0, "{engine:?}");
    }
}

/// A picture of another size than the display is refused with both sizes.
#[test]
fn pictures_of_another_size_are_refused() {
    let picture =
        |width: u32, height: u32| Picture { width, height, rgb: vec![0.5; 3 * (width * height) as usize] };
    let (good, bad) = (picture(8, 8), picture(9, 8));
    let exposure = exposure(&small(WHITE));
    assert!(exposure.frame(0, Some(&good)).is_ok());
    for result in [exposure.frame(0, Some(&bad)), exposure.frame_after(0, Some(&good), &[&bad])] {
        let error = result.unwrap_err();
        assert!(matches!(error, ExposureError::PictureSize(9, 8, 8, 8)), "{error}");
        assert!(error.to_string().contains("9x8 pixels, the display 8x8"), "{error}");
    }
}

/// Files of every kind, cut anywhere, are refused or read as far as they are whole; never a panic.
#[test]
fn files_cut_anywhere_are_refused() {
    let grey: Vec<u8> = (0..48).collect();
    let film = [b"YUV4MPEG2 W4 H4 F60:1 C444\nFRAME\n".as_slice(), &grey].concat();
    let mut png = photoneye_eye::picture::encode_png(4, 4, &grey).unwrap();
    png.truncate(png.len() - 12);
    let text =
        b"P3 4 4 255\n".iter().copied().chain(grey.iter().flat_map(|v| format!("{v:03} ").into_bytes()));
    let yuv = Some(Yuv { matrix: Matrix::Bt709, range: Range::Full, chroma_siting: None });
    let plain = ClipFormat::default();
    for (name, bytes, format) in [
        ("P6", [b"P6 4 4 255\n".as_slice(), &grey].concat(), plain),
        ("P5", [b"P5 4 4 255\n".as_slice(), &grey[..16]].concat(), plain),
        ("P6 of 16 bit", [b"P6 4 4 65535\n".as_slice(), &grey, &grey].concat(), plain),
        ("P3", text.collect(), plain),
        ("PNG", png, plain),
        ("Y4M", film, ClipFormat { yuv, raw: None }),
        ("raw", grey.clone(), ClipFormat { yuv: None, raw: Some(Raw { bits: 8 }) }),
    ] {
        let decode = |end: usize| decode_frame(&bytes[..end], &format, [4, 4], 0, Limits::default());
        let info = |end: usize| clip_info(&bytes[..end], &format, [4, 4], Limits::default());
        if name != "PNG" {
            assert!(decode(bytes.len()).is_ok_and(|p| (p.width, p.height) == (4, 4)), "{name}");
        }
        // The last number of a text file may lose its last digit and the blank after it.
        let least = if name == "P3" { bytes.len() - 4 } else { bytes.len() };
        for end in 0..least {
            assert!(decode(end).is_err(), "{name} cut at {end}");
            let _ = info(end);
        }
    }
}

/// The bound on a cone's count in a frame lies above what a white screen gives, within a factor of 20, at the fovea and
/// at 20°.
#[test]
fn the_largest_count_is_bounded() {
    for ecc_px in [0.0, 500.0] {
        let mut experiment = figure_12(Pattern::Uniform { rgb: [1.0; 3] });
        experiment.gaze.center_px[0] += ecc_px;
        experiment.counts.poisson = false;
        experiment.accuracy_target = 0.02;
        let exposure = exposure(&experiment);
        let FrameCounts::Means(means) = exposure.frame(0, None).unwrap().counts else { panic!("means") };
        let most = means.into_iter().fold(0.0, f32::max);
        let bound = largest_mean(&experiment, &setup(&experiment).unwrap()).unwrap() / f64::from(most);
        println!("{ecc_px}: {bound}");
        assert!((1.0..20.0).contains(&bound), "{ecc_px}: {bound}");
    }
}
