//! Movement inside a frame: exact in `expected`, the same in `paper`, drawn from its own seed.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::display::{Channel, Waveform};
use photoneye_eye::experiment::{
    Engine, Experiment, Gaze, Microsaccades, Movement, PaperSettings, Pattern, Tremor,
};
use photoneye_eye::exposure::{FrameCounts, cone_columns};
use photoneye_eye::spectrum::Spectrum;
use support::{cached_exposure as exposure, cached_retina as retina, figure_12, primary};

/// A checkerboard in one line of light before an eye that moves in every way at once, frames of 50 ms.
fn moving(movement: Movement) -> Experiment {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 2 });
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 540.0, fwhm_nm: 0.0 })];
    experiment.display.width_px = 8;
    experiment.display.height_px = 8;
    experiment.display.frame_rate_hz = 20.0;
    experiment.retina.region_deg = Some([-0.25, 0.25, -0.25, 0.25]);
    experiment.counts.poisson = false;
    experiment.gaze = Gaze {
        movement,
        tremor: Some(Tremor { rms_arcmin: 0.5, from_hz: 30.0, to_hz: 100.0 }),
        microsaccades: Some(Microsaccades {
            rate_hz: 30.0,
            from_arcmin: 2.0,
            to_arcmin: 5.0,
            duration_ms: 25.0,
        }),
        seed: 4,
        ..Gaze::still([4.0, 4.0])
    };
    experiment.frames = 4;
    experiment
}

fn walk() -> Experiment {
    moving(Movement::Walk { unit_arcmin: 0.5 })
}

fn values(experiment: &Experiment, index: u32) -> Vec<f64> {
    match exposure(experiment).frame(index, None).unwrap().counts {
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
        FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).collect(),
    }
}

fn l1(a: &[f64], b: &[f64]) -> f64 {
    let total: f64 = a.iter().sum();
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / total
}

/// The mean of n frozen moments of a frame (flashes of a thousandth of their share) against the frame itself.
fn frozen(experiment: &Experiment, n: u32) -> Vec<f64> {
    let mut mean: Vec<f64> = Vec::new();
    for i in 0..n {
        let mut one = experiment.clone();
        let middle = (f64::from(i) + 0.5) / f64::from(n);
        let half = 5e-4 / f64::from(n);
        one.display.primaries[0].waveform = Waveform::Pulses(vec![[middle - half, middle + half]]);
        let flash = values(&one, 1);
        mean.resize(flash.len(), 0.0);
        mean.iter_mut().zip(&flash).for_each(|(m, f)| *m += f / f64::from(n));
    }
    mean
}

/// Motion blur of walk, tremor and microsaccades together: sums over moments converge to it.
#[test]
fn motion_blur_is_what_moments_converge_to() {
    let experiment = walk();
    let exact = values(&experiment, 1);
    let errors: Vec<f64> = [25, 50, 200].iter().map(|n| l1(&exact, &frozen(&experiment, *n))).collect();
    println!("error with 25, 50, 200 moments: {errors:?}");
    assert!(errors[1] < 0.5 * errors[0] && errors[2] < 0.25 * errors[1], "{errors:?}");
    // 0.25 ms a moment against the walk's steps of 1 ms.
    assert!(errors[2] < 2e-3, "{errors:?}");
}

/// Movement is drawn from its own seed: the seed of the counts does not move the eye, another movement seed does.
#[test]
fn movement_has_its_own_seed() {
    let first = values(&walk(), 0);
    let mut other = walk();
    other.counts.seed = 99;
    assert!(values(&other, 0) == first);
    other.gaze.seed = 5;
    assert!(l1(&first, &values(&other, 0)) > 0.05);
}

/// Many frames of a moving eye are one long frame: light is neither lost nor counted twice at the borders.
#[test]
fn frames_join() {
    let short = walk();
    let mut long = walk();
    long.display.frame_rate_hz = 5.0;
    long.frames = 1;
    let whole = values(&long, 0);
    let mut sum = vec![0.0; whole.len()];
    for index in 0..4 {
        sum.iter_mut().zip(values(&short, index)).for_each(|(s, v)| *s += v);
    }
    let error = l1(&whole, &sum);
    assert!(error < 1e-5, "{error}");
}

/// Centre (degrees) of where counts are seen, their spread (square degrees) within 0.15° of the display's middle, and their number. Without a
/// bound the spread is that of the diffraction's tail, which grows with the patch.
fn seen(experiment: &Experiment, index: u32) -> ([f64; 2], f64, f64) {
    let columns = cone_columns(experiment, &retina(experiment)).unwrap();
    let mut values = values(experiment, index);
    for (value, (x, y)) in values.iter_mut().zip(columns.x_deg.iter().zip(&columns.y_deg)) {
        if x.hypot(*y) > 0.15 {
            *value = 0.0;
        }
    }
    let total: f64 = values.iter().sum();
    let mean = |c: &[f64]| c.iter().zip(&values).map(|(x, v)| x * v).sum::<f64>() / total;
    let centre = [mean(&columns.x_deg), mean(&columns.y_deg)];
    let square: Vec<f64> = columns
        .x_deg
        .iter()
        .zip(&columns.y_deg)
        .map(|(x, y)| (x - centre[0]).powi(2) + (y - centre[1]).powi(2))
        .collect();
    (centre, mean(&square), total)
}

/// The photon-by-photon engine sees the same movement through the same waveform and spot: centre, spread and number agree.
#[test]
fn both_engines_move_alike() {
    let mut experiment = walk();
    experiment.video =
        photoneye_eye::experiment::Video::Pattern(Pattern::Point { at_px: [4, 4], rgb: [1.0; 3] });
    experiment.display.primaries[0].waveform = Waveform::Phosphor { decay_us: 20_000.0, start: 0.2 };
    experiment.display.primaries[0].spot_sd_px = 0.4;
    let (centre, spread, total) = seen(&experiment, 1);
    experiment.counts.engine = Engine::Paper;
    experiment.counts.poisson = true;
    experiment.counts.paper = PaperSettings { rays: 16384, samples: 256, window_um: 120.0, node_um: 150.0 };
    let (paper_centre, paper_spread, paper_total) = seen(&experiment, 1);
    println!("{centre:?} {spread:e} {total} paper {paper_centre:?} {paper_spread:e} {paper_total}");
    // Five standard deviations of chance (alpha 6e-7), and 1.5 % for the light that the paper's window cuts off and puts back.
    let chance = 5.0 * (spread / 2.0 / paper_total).sqrt();
    for axis in 0..2 {
        assert!(
            (centre[axis] - paper_centre[axis]).abs() < chance + 0.015 * spread.sqrt(),
            "{centre:?} {paper_centre:?}"
        );
    }
    assert!((paper_total / total - 1.0).abs() < 5.0 / total.sqrt() + 0.02, "{total} {paper_total}");
    assert!((paper_spread / spread - 1.0).abs() < 0.04, "{spread} {paper_spread}");
}
