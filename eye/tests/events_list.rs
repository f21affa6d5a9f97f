//! The list of counted photons: the counts again, at times and wavelengths that follow the light.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::display::{Channel, Waveform, White};
use photoneye_eye::experiment::{Engine, Experiment, Movement, Pattern};
use photoneye_eye::exposure::{FrameCounts, Photon};
use photoneye_eye::plan::plan;
use photoneye_eye::spectrum::Spectrum;
use support::{exposure, figure_12, primary};

const FRAME_S: f64 = 1.0 / 60.0;

/// A dim white screen of 12 x 12 pixels whose light comes in two pulses of 1/8 and 3/8 of the frame.
fn listed() -> Experiment {
    let mut experiment = figure_12(Pattern::Uniform { rgb: [1.0; 3] });
    let mut line = primary(Channel::Red, Spectrum::Line { nm: 600.0, fwhm_nm: 0.0 });
    line.waveform = Waveform::Pulses(vec![[0.25, 0.375], [0.5, 0.875]]);
    let mut band = primary(Channel::Green, Spectrum::Line { nm: 530.0, fwhm_nm: 30.0 });
    band.waveform = line.waveform.clone();
    experiment.display.primaries = vec![line, band];
    (experiment.display.width_px, experiment.display.height_px) = (12, 12);
    experiment.display.white = White::LuminanceCdM2(4.0);
    experiment.gaze.center_px = [6.0, 6.0];
    experiment.counts.engine = Engine::Events;
    experiment.counts.photon_list = true;
    experiment.frames = 3;
    experiment
}

fn run(experiment: &Experiment, threads: usize, index: u32) -> (Vec<u32>, Vec<Photon>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let frame = exposure(experiment).1.frame(index, None).unwrap();
        let FrameCounts::Counts(counts) = frame.counts else { panic!("no counts") };
        (counts, frame.photons.unwrap())
    })
}

#[test]
fn the_list_holds_the_counts_at_the_times_of_the_light() {
    let mut still = listed();
    still.gaze.movement = Movement::Still;
    for experiment in [&listed(), &still] {
        let (counts, list) = run(experiment, 1, 2);
        assert!((counts.clone(), list.clone()) == run(experiment, 2, 2), "other threads, other photons");
        let mut again = vec![0; counts.len()];
        for photon in &list {
            again[photon.cone as usize] += 1;
        }
        assert!(again == counts && list.len() > 10_000, "{} photons", list.len());
        assert!(list.is_sorted_by(|a, b| a.time_s <= b.time_s));

        // Eight bins of equal chance; chi-square of 7 degrees, alpha 1e-6: 42.
        let mut bins = [0.0; 8];
        for photon in &list {
            let part = photon.time_s / FRAME_S - 2.0;
            let lit = match part {
                p if (0.25..=0.375).contains(&p) => p - 0.25,
                p if (0.5..=0.875).contains(&p) => p - 0.375,
                p => panic!("a photon at {p} of the frame"),
            };
            bins[((lit * 16.0) as usize).min(7)] += 1.0;
        }
        let mean = list.len() as f64 / 8.0;
        let chi2: f64 = bins.iter().map(|bin| (bin - mean) * (bin - mean) / mean).sum();
        println!("{} photons, chi² of times {chi2:.1} of 7 degrees", list.len());
        assert!(chi2 < 42.0, "{bins:?}");

        // Red is a line; green a band about 530 nm.
        let line = list.iter().filter(|photon| photon.wavelength_nm > 599.0).count();
        let band: Vec<f64> =
            list.iter().map(|p| f64::from(p.wavelength_nm)).filter(|nm| *nm <= 599.0).collect();
        assert!(line > 500 && band.len() > 500, "{line} {}", band.len());
        let mean = band.iter().sum::<f64>() / band.len() as f64;
        assert!((mean - 530.0).abs() < 5.0 && band.iter().all(|nm| (nm - 530.0).abs() < 80.0), "{mean}");
    }
}

/// Counts do not change because they are listed.
#[test]
fn a_list_changes_no_count() {
    let mut without = listed();
    without.counts.photon_list = false;
    let frame = exposure(&without).1.frame(1, None).unwrap();
    assert!(frame.photons.is_none());
    let FrameCounts::Counts(counts) = frame.counts else { panic!("no counts") };
    assert!(run(&listed(), 2, 1).0 == counts);
}

#[test]
fn a_list_is_refused_where_it_cannot_be() {
    let mut other = listed();
    other.counts.engine = Engine::Expected;
    let refused = |experiment: &Experiment| plan(experiment).unwrap_err().to_string();
    assert!(refused(&other).contains("counts.photon_list") && refused(&other).contains("EVENTS"));
    let mut bright = listed();
    bright.display.white = White::LuminanceCdM2(1e5);
    assert!(refused(&bright).contains("counts.photon_list"), "{}", refused(&bright));
    let mut long = listed();
    long.frames = 5_000;
    assert!(refused(&long).contains("50000000"), "{}", refused(&long));
}
