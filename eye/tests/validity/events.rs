//! `EVENTS` draws photons along paths of their own. Its counts against the means of `EXPECTED`: edges, squares of 10
//! pixels and a Sloan K, behind pupils of 3 to 8 mm, at the fovea and beside it.

use photoneye_eye::display::White;
use photoneye_eye::experiment::{Engine, Experiment, Pattern};
use photoneye_eye::exposure::FrameCounts;
use photoneye_eye::plan::plan;

use crate::source::{letter, number, scene};
use crate::support::exposure;

/// Luminance of white, cd/m²: some thousand photons a cone.
const WHITE_CD_M2: f64 = 2000.0;

/// Deviation of counts from means over all light, what chance gives of it, its standard deviation, and what both
/// engines estimate as their error; `None` when the plan refuses.
fn deviation(experiment: &Experiment) -> Option<[f64; 4]> {
    let mut experiment = experiment.clone();
    experiment.display.white = White::LuminanceCdM2(WHITE_CD_M2);
    experiment.audit_cones = 0;
    let estimate = |experiment: &Experiment| -> Option<f64> {
        Some(plan(experiment).ok()?.error_estimate.iter().map(|part| part.relative).sum())
    };

    // Compute the means, then draw.
    let expected = estimate(&experiment)?;
    let FrameCounts::Means(means) = exposure(&experiment).1.frame(0, None).unwrap().counts else {
        panic!("means")
    };
    (experiment.counts.engine, experiment.counts.poisson) = (Engine::Events, true);
    let drawn = estimate(&experiment)?;
    let FrameCounts::Counts(counts) = exposure(&experiment).1.frame(0, None).unwrap().counts else {
        panic!("counts")
    };

    // A Poisson number of mean m deviates by √(2m/π), with a variance of m(1 − 2/π).
    let total: f64 = means.iter().map(|m| f64::from(*m)).sum();
    let off = counts.iter().zip(&means).map(|(n, m)| (f64::from(*n) - f64::from(*m)).abs()).sum::<f64>();
    let chance = means.iter().map(|m| (f64::from(*m) * std::f64::consts::FRAC_2_PI).sqrt()).sum::<f64>();
    let variance = total * (1.0 - std::f64::consts::FRAC_2_PI);
    Some([off / total, chance / total, variance.sqrt() / total, expected + drawn])
}

/// PUPIL and ECC in the environment take one pupil and eccentricity.
fn agree(pupils_mm: &[f64], eccentricities_deg: &[f64]) {
    let pictures = [
        ("edges", Pattern::Checkerboard { square_px: 15 }),
        ("checks", Pattern::Checkerboard { square_px: 10 }),
        ("letter", letter()),
    ];
    for pupil_mm in pupils_mm {
        for ecc_deg in eccentricities_deg {
            for (name, picture) in pictures.clone() {
                let Some([off, chance, sd, estimate]) = deviation(&scene(picture, *pupil_mm, *ecc_deg, 5e-3))
                else {
                    println!("{pupil_mm} mm, {ecc_deg:2}°, {name:6}: refused");
                    continue;
                };
                let excess = (off * off - chance * chance).max(0.0).sqrt();
                println!(
                    "{pupil_mm} mm, {ecc_deg:2}°, {name:6}: {off:.2e}, chance {chance:.2e}, excess {excess:.1e}"
                );
                // Five standard deviations: a false alarm in 3.5 million.
                let most = chance.hypot(estimate) + 5.0 * sd;
                assert!(off < most, "{pupil_mm} mm, {ecc_deg}°, {name}: {off} over {most}");
            }
        }
    }
}

#[test]
fn drawn_photons_land_where_means_say() {
    agree(&[3.0], &[0.0, 10.0]);
}

#[test]
#[ignore = "some minutes"]
fn drawn_photons_land_where_means_say_behind_all_pupils() {
    agree(&[number("PUPIL", 8.0)], &[number("ECC", 0.0)]);
}
