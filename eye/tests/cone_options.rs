//! Options of the cones and of the ledger: isomerizations without light, bleaching, apertures, reflections as
//! a line of their own; in every engine.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use photoneye_eye::cone::pigment::{Pigments, unbleached};
use photoneye_eye::display::Channel;
use photoneye_eye::experiment::{Engine, Experiment, Gaze, Pattern};
use photoneye_eye::exposure::{Frame, FrameCounts};
use photoneye_eye::plan::plan;
use photoneye_eye::retina::{Aperture, ConeType};
use photoneye_eye::spectrum::Spectrum;
use support::{WHITE, cached_exposure as exposure, figure_12, primary};

fn small(pattern: Pattern) -> Experiment {
    let mut experiment = figure_12(pattern);
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: 560.0, fwhm_nm: 0.0 })];
    (experiment.display.width_px, experiment.display.height_px) = (8, 8);
    experiment.gaze = Gaze::still([4.0, 4.0]);
    experiment.counts.poisson = false;
    experiment
}

fn values(frame: &Frame) -> Vec<f64> {
    match &frame.counts {
        FrameCounts::Means(means) => means.iter().map(|m| f64::from(*m)).collect(),
        FrameCounts::Counts(counts) => counts.iter().map(|c| f64::from(*c)).collect(),
    }
}

fn with_engine(experiment: &Experiment, engine: Engine) -> Experiment {
    let mut other = experiment.clone();
    other.counts.engine = engine;
    other.counts.poisson = true;
    other
}

const ENGINES: [Engine; 3] = [Engine::Expected, Engine::Events, Engine::Paper];

/// 600/s are 10 a frame of 1/60 s in every cone: alone on a black screen with mean and variance of a Poisson number (five standard deviations),
/// and no photon's fate.
#[test]
fn cones_isomerize_without_light() {
    let mut dark = small(Pattern::Uniform { rgb: [0.0; 3] });
    dark.retina.dark_isomerizations_per_s = 600.0;
    assert!(values(&exposure(&dark).frame(0, None).unwrap()).iter().all(|m| (m - 10.0).abs() < 1e-6));
    for engine in ENGINES {
        let frame = exposure(&with_engine(&dark, engine)).frame(3, None).unwrap();
        let counts = values(&frame);
        let n = counts.len() as f64;
        let mean = counts.iter().sum::<f64>() / n;
        let variance = counts.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / (n - 1.0);
        println!("{engine:?}: mean {mean:.3}, variance {variance:.3} over {n} cones");
        assert!((mean - 10.0).abs() < 5.0 * (10.0 / n).sqrt(), "{engine:?} {mean}");
        assert!((variance - 10.0).abs() < 5.0 * (210.0 / n).sqrt(), "{engine:?} {variance}");
        assert!((frame.budget.dark - 10.0 * n).abs() < 1e-6 * n && frame.budget.fates() == 0.0);
    }
    // On top of light it adds its mean and changes no fate.
    let lit = small(WHITE);
    let mut both = lit.clone();
    both.retina.dark_isomerizations_per_s = 600.0;
    let (a, b) = (exposure(&lit).frame(0, None).unwrap(), exposure(&both).frame(0, None).unwrap());
    assert!(values(&a).iter().zip(values(&b)).all(|(x, y)| (y - x - 10.0).abs() < 1e-4 * (1.0 + x)));
    assert!((a.budget.fates() - b.budget.fates()).abs() < 1e-9 * a.budget.fates());
}

/// Cones as wide as inner segments count less, in every engine as the plan foretells: 25 % less at the
/// centre, in the whole patch no more than the bound; the plan says which apertures are used, both ways.
#[test]
fn inner_segments_catch_less_than_cells() {
    let cell = small(WHITE);
    let mut inner = cell.clone();
    inner.retina.aperture = Aperture::InnerSegment;
    let listed = |experiment: &Experiment, what: &str| {
        let omissions = plan(experiment).unwrap().omissions;
        omissions.into_iter().find(|omission| omission.what == what)
    };
    let (less, more) = ("the measured size of inner segments", "apertures that fill their cells");
    assert!(listed(&cell, more).is_none() && listed(&inner, less).is_none());
    let (less, more) = (listed(&cell, less).unwrap(), listed(&inner, more).unwrap());
    println!("{}\n{}", less.why, more.why);
    assert!(less.why.contains("lower counts by 25.") && less.why.contains("at 0.0°"), "{}", less.why);
    assert!(more.why.contains("raise counts by 34.") && more.why.contains("CELL"), "{}", more.why);
    for engine in ENGINES {
        let [before, after] =
            [&cell, &inner].map(|e| exposure(&with_engine(e, engine)).frame(0, None).unwrap());
        let (before, after) = (values(&before).iter().sum::<f64>(), values(&after).iter().sum::<f64>());
        let change = after / before - 1.0;
        println!("{engine:?}: {change:.4}, bound {:.4}, back {:.4}", less.bound, more.bound);
        let noise = 5.0 * (1.0 / after + 1.0 / before).sqrt();
        // The patch: 25 % at the centre, more round it.
        assert!(change < -0.25 + noise && -change < less.bound + noise, "{engine:?}: {change}");
        assert!(before / after - 1.0 < more.bound + noise, "{engine:?}");
    }
}

/// At 10^4.3 td half the pigment is bleached: L cones of the fovea count (1 - 10^(-D A/2)) / (1 - 10^(-D A)) of what they did, in every engine;
/// the plan's list of omissions loses the line.
#[test]
fn bleached_pigment_counts_less() {
    let fresh = small(WHITE);
    let mut bleached = fresh.clone();
    bleached.retina.bleaching_td = Some(10_f64.powf(4.3));
    let total = |experiment: &Experiment| exposure(experiment).frame(0, None).unwrap().budget.isomerized[0];
    let half = Pigments::new().unwrap().with_unbleached(unbleached(10_f64.powf(4.3)));
    let expected = half.absorptance(ConeType::L, 560.0, 0.15)
        / Pigments::new().unwrap().absorptance(ConeType::L, 560.0, 0.15);
    for engine in ENGINES {
        let (before, after) = (with_engine(&fresh, engine), with_engine(&bleached, engine));
        let (before, after) = (total(&before), total(&after));
        let ratio = after / before;
        println!("{engine:?}: {ratio:.4}, pigment alone {expected:.4}, {before:.0} counts");
        assert!(
            (ratio - expected).abs() < 0.002 + 5.0 * ratio * (1.0 / after + 1.0 / before).sqrt(),
            "{engine:?}"
        );
    }
    let listed = |experiment: &Experiment| {
        plan(experiment).unwrap().omissions.into_iter().find(|omission| omission.what == "bleaching")
    };
    let omission = listed(&fresh).unwrap();
    // 250 cd/m² through 3 mm are 1767 td, which bleach 8 %.
    assert!(
        (omission.bound - 0.0814).abs() < 2e-3 && omission.why.contains("it matters here"),
        "{omission:?}"
    );
    assert!(listed(&bleached).is_none());
    let mut dim = fresh;
    dim.display.white = photoneye_eye::display::White::LuminanceCdM2(1.0);
    assert!(!listed(&dim).unwrap().why.contains("it matters"));
}

/// With reflections computed 2.7 % of what enters the pupil is reflected, a line of its own; every photon keeps one fate, in `PAPER` whole photons.
#[test]
fn reflected_photons_are_a_fate_of_their_own() {
    let mut experiment = small(WHITE);
    for reflects in [false, true] {
        experiment.eye.reflection_losses = reflects;
        for engine in ENGINES {
            let budget = exposure(&with_engine(&experiment, engine)).frame(0, None).unwrap().budget;
            assert!(
                (budget.fates() - budget.emitted).abs() <= 1e-12 * budget.emitted,
                "{engine:?} {budget:#?}"
            );
            let share = budget.reflected / budget.into_pupil();
            if !reflects {
                assert!(budget.reflected == 0.0);
                continue;
            }
            let chance = 5.0 * (0.027 / budget.into_pupil()).sqrt();
            assert!((share - 0.027).abs() < 5e-4 + chance, "{engine:?} {share}");
            if engine == Engine::Paper {
                let whole = [
                    budget.reflected,
                    budget.cornea,
                    budget.lens,
                    budget.macula,
                    budget.between_cones,
                    budget.stiles_crawford,
                    budget.not_absorbed,
                    budget.not_isomerized,
                ];
                assert!(whole.iter().chain(&budget.isomerized).all(|n| n.fract() == 0.0), "{budget:#?}");
            }
        }
    }
}
