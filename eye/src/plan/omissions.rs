//! What a scene does not need, with the reason and a bound on the relative error of the mean per cone.

use super::Omission;
use super::setup::Setup;
use super::wavelengths::Wavelengths;
use crate::cone::pigment::unbleached;
use crate::display::{FORGOTTEN, Primary, Waveform};
use crate::experiment::{Experiment, StrayLight};
use crate::exposure::stray::scattered_share;
use crate::media::MACULA_EDGE_DEG;

/// Energy of a diffraction-limited spread beyond a radius R is about λ/(π² NA R); λ in the vitreous over NA, µm, at 3 mm.
const TAIL_UM: f64 = 0.62;

/// The omissions of an experiment.
pub fn list(experiment: &Experiment, setup: &Setup, band: f64, wavelengths: &Wavelengths) -> Vec<Omission> {
    let mut list = vec![
        omission(
            "cones outside the patch",
            &format!(
                "the picture, its blur and its movement fall within x {:.0} to {:.0}, y {:.0} to {:.0} µm of the foveal centre",
                setup.region.min.x, setup.region.max.x, setup.region.min.y, setup.region.max.y
            ),
            0.0,
        ),
        omission(
            "wavelengths without light that a cone can catch",
            &format!(
                "{} of 390 to 830 nm is computed at {} wavelengths; light beyond is kept at the nearest",
                range(&wavelengths.nodes_nm),
                wavelengths.nodes_nm.len()
            ),
            wavelengths.outside,
        ),
        omission(
            "copies of the picture beyond the guard distance",
            &format!("the image is periodic; the nearest copy is {:.0} µm from any cone", setup.guard_um),
            0.5 * TAIL_UM * 3.0 / experiment.eye.pupil_mm / setup.guard_um,
        ),
    ];
    list.extend(unbleached_pigment(experiment));
    list.extend(lost_light(experiment));
    let cutoff = super::setup::cutoff(experiment);
    if band < cutoff {
        let kept = band * std::f64::consts::PI / 180.0;
        list.push(omission(
            "spatial frequencies that blur and apertures average away",
            &format!("frequencies up to {kept:.0} cycles per degree are kept, fewer where cones are wide"),
            0.15 * experiment.accuracy_target,
        ));
    }
    if setup.gaze.is_still() {
        list.push(omission("motion blur", "the eye does not move", 0.0));
        let steady = |p: &Primary| p.waveform == Waveform::Steady;
        if !experiment.display.primaries.iter().all(steady) || experiment.display.panel.lag_ms > 0.0 {
            let why = "to an eye that does not move the light of a frame is one sum";
            list.push(omission("the course of light inside a frame", why, 0.0));
        }
    }
    if !setup.gaze.is_still() && experiment.display.primaries.iter().any(|p| p.waveform.scan().is_some()) {
        let why = "the turns of pixels are cut into steps; of a frequency at a third of the band so much is blurred";
        list.push(omission("times between the steps of the scan", why, crate::exposure::SCAN_BLUR));
    }
    let frame_s = 1.0 / experiment.display.frame_rate_hz;
    let history = |p: &Primary| p.waveform.timing(0, frame_s, experiment.display.panel.lag_ms).history();
    let history = experiment.display.primaries.iter().map(history).max().unwrap_or(0);
    if history > 0 {
        let why = format!("{history} earlier frames are looked at");
        list.push(omission("ghosts of frames before those", &why, FORGOTTEN));
    }
    let nearest = glam::DVec2::ZERO.clamp(setup.region.min, setup.region.max).length();
    if nearest / super::setup::UM_PER_TANGENT > MACULA_EDGE_DEG.to_radians() {
        list.push(omission("macular pigment", "the patch lies beyond its edge", 0.0));
    }
    if experiment.eye.stiles_crawford_rho10_per_mm2 <= 0.0 {
        let lost = 0.05 * std::f64::consts::LN_10 * experiment.eye.pupil_mm.powi(2) / 8.0;
        list.push(omission(
            "directional sensitivity of the cones",
            "the experiment switches it off",
            lost.min(1.0),
        ));
    }
    list
}

/// Scattered and reflected light, where they are left out.
fn lost_light(experiment: &Experiment) -> Vec<Omission> {
    let mut list = Vec::new();
    if experiment.eye.stray_light.is_none() {
        let usual = StrayLight { age_years: 30.0, pigmentation: 0.5 };
        list.push(omission(
            "light scattered in the eye",
            "scattered light stays in the image; at 30 years so much of it would be spread as a veil over the whole field, see eye.stray_light",
            scattered_share(usual),
        ));
    }
    if !experiment.eye.reflection_losses {
        list.push(omission(
            "reflections at the surfaces of cornea and lens",
            "the flat 0.016 in the density of the cornea stands for them; computed, 1 % more light passes, see eye.reflection_losses",
            0.01,
        ));
    }
    list
}

fn omission(what: &str, why: &str, bound: f64) -> Omission {
    Omission { what: what.into(), why: why.into(), bound }
}

fn range(nm: &[f64]) -> String {
    match nm {
        [] => "nothing".into(),
        [only] => format!("{only:.1} nm"),
        [first, .., last] => format!("{first:.0} to {last:.0} nm"),
    }
}

/// Bleaching, where it is left out: a steady white screen would bleach I/(I + I₀) of the pigment.
fn unbleached_pigment(experiment: &Experiment) -> Option<Omission> {
    if experiment.retina.bleaching_td.is_some() {
        return None;
    }
    let trolands = experiment.display.white_trolands(experiment.eye.pupil_mm);
    let bound = 1.0 - unbleached(trolands);
    let mut why = format!("pigments are taken as unbleached, as in §20; a white screen has {trolands:.0} td");
    if bound > 0.01 {
        why += ": it matters here, see retina.bleaching";
    }
    Some(omission("bleaching", &why, bound))
}
