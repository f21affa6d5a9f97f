//! The engines `paper` (photon by photon) and `expected` (exact means) agree on a benign scene.
//!
//! With the paper's own settings they differ by that method's errors: the 20 µm window, renormalized, and 1024 perturbed rays. With a
//! wide window and many rays what remains is chance, which a chi-square test measures.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests fail by panicking and print what they measured"
)]

mod support;

use photoneye_eye::display::Channel;
use photoneye_eye::experiment::{Engine, Experiment, PaperSettings, Pattern};
use photoneye_eye::exposure::FrameCounts;
use photoneye_eye::report::PhotonBudget;
use photoneye_eye::spectrum::Spectrum;
use support::{exposure, figure_12, primary};

/// A checkerboard of 12 x 12 pixels in one wavelength that is one of the paper's channels.
fn benign() -> Experiment {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 4 });
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 540.0, fwhm_nm: 0.0 })];
    experiment.display.width_px = 12;
    experiment.display.height_px = 12;
    experiment.gaze.center_px = [6.0, 6.0];
    experiment.accuracy_target = 1e-3;
    experiment
}

/// Sums of counts or means over frames, and of the budgets.
fn sums(experiment: &Experiment, frames: u32) -> (Vec<f64>, PhotonBudget) {
    let (_, exposure) = exposure(experiment);
    let mut counts = vec![0.0; exposure.len()];
    let mut budget = PhotonBudget::default();
    for index in 0..frames {
        let frame = exposure.frame(index, None).unwrap();
        match frame.counts {
            FrameCounts::Counts(values) => {
                counts.iter_mut().zip(values).for_each(|(s, v)| *s += f64::from(v));
            }
            FrameCounts::Means(values) => counts.iter_mut().zip(values).for_each(|(s, v)| *s += f64::from(v)),
        }
        budget.add(&frame.budget);
    }
    (counts, budget)
}

const FRAMES: u32 = 2;

fn both(settings: PaperSettings) -> (Vec<f64>, Vec<f64>, PhotonBudget, PhotonBudget) {
    let mut experiment = benign();
    experiment.counts.poisson = false;
    let (means, expected) = sums(&experiment, FRAMES);
    experiment.counts.engine = Engine::Paper;
    experiment.counts.poisson = true;
    experiment.counts.paper = settings;
    let (counts, paper) = sums(&experiment, FRAMES);
    (means, counts, expected, paper)
}

#[test]
fn with_a_wide_window_only_chance_remains() {
    let settings = PaperSettings { rays: 16384, samples: 256, window_um: 120.0, node_um: 150.0 };
    let (means, counts, expected, paper) = both(settings);
    // Cones with enough photons for a normal approximation.
    let terms: Vec<f64> =
        means.iter().zip(&counts).filter(|(m, _)| **m > 50.0).map(|(m, c)| (c - m) * (c - m) / m).collect();
    let n = terms.len() as f64;
    let chi2 = terms.iter().sum::<f64>() / n;
    println!("chi²/n {chi2:.4} over {n} cones");
    // Five standard deviations of chi²/n (alpha 6e-7), and 0.02 for the errors that both have left.
    assert!(n > 1000.0 && (chi2 - 1.0).abs() < 5.0 * (2.0 / n).sqrt() + 0.02, "chi²/n {chi2} over {n} cones");
    let (all_means, all_counts): (f64, f64) = (means.iter().sum(), counts.iter().sum());
    println!("total {:.6}", all_counts / all_means);
    assert!((all_counts - all_means).abs() < 5.0 * all_means.sqrt() + 2e-3 * all_means);
    for (name, a, b) in [
        ("pupil", expected.into_pupil(), paper.into_pupil()),
        ("cornea", expected.cornea, paper.cornea),
        ("lens", expected.lens, paper.lens),
        ("macula", expected.macula, paper.macula),
        ("Stiles-Crawford", expected.stiles_crawford, paper.stiles_crawford),
        ("not absorbed", expected.not_absorbed, paper.not_absorbed),
        ("not isomerized", expected.not_isomerized, paper.not_isomerized),
    ] {
        println!("{name}: {a:.0} {b:.0}");
        assert!((a - b).abs() < 5.0 * a.sqrt() + 5e-3 * a, "{name}: {a} {b}");
    }
    assert!((paper.fates() / paper.emitted - 1.0).abs() < 1e-12);
}

#[test]
fn with_the_papers_settings_the_difference_is_its_own_error() {
    let (means, counts, ..) = both(PaperSettings::default());
    let total: f64 = means.iter().sum();
    let l1 = means.iter().zip(&counts).map(|(m, c)| (m - c).abs()).sum::<f64>() / total;
    // What chance alone gives: the mean absolute deviation of a Poisson number, √(2m/π).
    let chance = means.iter().map(|m| (m * std::f64::consts::FRAC_2_PI).sqrt()).sum::<f64>() / total;
    println!("L1 {l1:.4}, of which chance {chance:.4}");
    assert!(l1 < chance + 0.12, "L1 {l1}, chance {chance}");
}
