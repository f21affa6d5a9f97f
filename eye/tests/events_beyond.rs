//! The engine `events` and the light of the screen beyond its window: as in `expected`.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::display::White;
use photoneye_eye::experiment::{Engine, Experiment, Pattern};
use photoneye_eye::exposure::{Frame, FrameCounts};
use support::{cached_exposure, figure_12};

/// A dark square of a checkerboard that is larger than the window: all its light comes from beyond.
fn dark() -> Experiment {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 80 });
    experiment.retina.region_deg = Some([-0.25, 0.25, -0.25, 0.25]);
    (experiment.display.width_px, experiment.display.height_px) = (320, 240);
    experiment.gaze.center_px = [120.0, 40.0];
    experiment
}

fn means(experiment: &Experiment) -> Vec<f64> {
    let mut experiment = experiment.clone();
    experiment.counts.poisson = false;
    match cached_exposure(&experiment).frame(0, None).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(_) => panic!("means were asked for"),
    }
}

fn counts(frame: &Frame) -> Vec<u32> {
    let FrameCounts::Counts(counts) = &frame.counts else { panic!("no counts") };
    counts.clone()
}

/// The total and 16 groups of cones within five standard deviations (alpha 6e-7 each).
#[test]
fn light_from_beyond_the_window_is_counted() {
    let mut experiment = dark();
    let means = means(&experiment);
    experiment.counts.engine = Engine::Events;
    let exposure = cached_exposure(&experiment);
    let mut groups = [[0.0; 2]; 16];
    for index in 0..40 {
        for (i, (count, mean)) in
            counts(&exposure.frame(index, None).unwrap()).into_iter().zip(&means).enumerate()
        {
            let group = &mut groups[i * 16 / means.len()];
            *group = [group[0] + f64::from(count), group[1] + mean];
        }
    }
    let [counted, mean] = groups.iter().fold([0.0; 2], |sum, g| [sum[0] + g[0], sum[1] + g[1]]);
    println!("{counted} counted, mean {mean:.1}");
    assert!(mean > 500.0 && (counted - mean).abs() < 5.0 * mean.sqrt(), "{counted} {mean}");
    for [counted, mean] in groups {
        assert!((counted - mean).abs() < 5.0 * mean.sqrt() + 5.0, "{counted} {mean}");
    }
}

/// With a list the same counts, each in the list.
#[test]
fn photons_from_beyond_the_window_are_listed() {
    let mut experiment = dark();
    experiment.display.white = White::LuminanceCdM2(3.0);
    experiment.counts.engine = Engine::Events;
    let exposure = cached_exposure(&experiment);
    experiment.counts.photon_list = true;
    let listing = cached_exposure(&experiment);
    let mut photons = 0;
    for index in 0..40 {
        let frame = listing.frame(index, None).unwrap();
        assert_eq!(counts(&frame), counts(&exposure.frame(index, None).unwrap()));
        let mut again = vec![0; counts(&frame).len()];
        for photon in frame.photons.as_ref().unwrap() {
            again[photon.cone as usize] += 1;
            let part = photon.time_s * 60.0 - f64::from(index);
            assert!((0.0..1.0).contains(&part) && (390.0..830.0).contains(&photon.wavelength_nm));
        }
        assert_eq!(again, counts(&frame));
        photons += again.iter().sum::<u32>();
    }
    println!("{photons} listed");
    assert!(photons > 10);
}
