//! What a scene does not need, with the reason and a bound on the relative error of the mean per cone: one function a rule.

#![allow(
    clippy::unnecessary_wraps,
    reason = "all rules have one form, also those that always leave something out"
)]

use super::apertures;
use super::rules::Rule;
use super::setup::{MARGIN_UM, Setup, UM_PER_TANGENT};
use super::wavelengths::Wavelengths;
use super::{Numerics, Omission, PlannedTile, error, lit};
use crate::cone::directional::DEFAULT_RHO10_PER_MM2;
use crate::cone::pigment::unbleached;
use crate::display::{FORGOTTEN, Levels, Primary, Waveform};
use crate::experiment::{Engine, Experiment, StrayLight};
use crate::exposure::inputs::{POINTING_SHARE, pointing_effect, pointing_of};
use crate::exposure::primaries;
use crate::exposure::stray::angle::Scatter;
use crate::media::MACULA_EDGE_DEG;
use crate::psf::{Wavefront, WavefrontOptions};
use crate::retina::Aperture;

/// Fraction of the light that is scattered, where it cannot be computed.
const USUAL_SCATTER: f64 = 0.18;
/// Visual eccentricity beyond which neither macula nor pigments change, degrees.
const GRADIENTS_END_DEG: f64 = 13.0;

/// What the rules look at.
struct Look<'a> {
    experiment: &'a Experiment,
    setup: &'a Setup,
    tiles: &'a [PlannedTile],
    wavelengths: &'a Wavelengths,
}

/// Says what is left out, if anything.
type Tell = fn(&Look) -> Option<Omission>;

/// The omissions of an experiment.
pub fn list(
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    wavelengths: &Wavelengths,
) -> Vec<Omission> {
    let look = Look { experiment, setup, tiles, wavelengths };
    let rules: [(Option<Rule>, Tell); 21] = [
        (Some(Rule::ConesOutside), cones_outside),
        (Some(Rule::Wavelengths), dark_wavelengths),
        (Some(Rule::FieldNodes), field_nodes),
        (Some(Rule::CoarseGrids), coarse_grids),
        (Some(Rule::StillEye), motion),
        (Some(Rule::StillEye), course),
        (Some(Rule::Eccentricities), eccentricities),
        (None, macula),
        (Some(Rule::UnlitPrimaries), unlit_primaries),
        (Some(Rule::JoinedPrimaries), joined_primaries),
        (Some(Rule::RepeatedFrames), repeated_frames),
        (Some(Rule::DarkTiles), dark_tiles),
        (Some(Rule::BlindTypes), blind_types),
        (Some(Rule::Pointing), pointing),
        (None, copies),
        (None, scan_steps),
        (None, ghosts),
        (None, directional),
        (None, absorption),
        (None, bleaching),
        (None, aperture),
    ];
    let made = |(rule, of): &(Option<Rule>, Tell)| {
        if rule.is_none_or(|rule| rule.applies(experiment)) { of(&look) } else { None }
    };
    rules.iter().filter_map(made).chain(stray_light(&look)).chain(reflections(&look)).collect()
}

fn omission(what: &str, why: &str, bound: f64) -> Omission {
    Omission { what: what.into(), why: why.into(), bound }
}

/// The bound is the share of the light that falls on them.
fn cones_outside(look: &Look) -> Option<Omission> {
    let region = look.setup.region;
    let why = format!(
        "the picture, its blur and its movement fall within x {:.0} to {:.0}, y {:.0} to {:.0} µm of the foveal centre",
        region.min.x, region.max.x, region.min.y, region.max.y
    );
    let beyond = if look.experiment.retina.region_deg.is_none() {
        // Out of focus the blur of the picture's edge goes on: at most half of it outwards.
        let blur_um =
            look.setup.seen(look.experiment, &region).map_or(0.0, |seen| seen.blur * UM_PER_TANGENT);
        let picture = region.max - region.min - 2.0 * MARGIN_UM;
        let edge = (blur_um - MARGIN_UM).max(0.0) * (1.0 / picture.x + 1.0 / picture.y);
        error::tail_beyond(look.experiment, MARGIN_UM) + edge.min(1.0)
    } else {
        0.0
    };
    Some(omission("cones outside the patch", &why, beyond))
}

fn dark_wavelengths(look: &Look) -> Option<Omission> {
    let nodes = &look.wavelengths.nodes_nm;
    let range = match nodes.as_slice() {
        [] => "nothing".into(),
        [only] => format!("{only:.1} nm"),
        [first, .., last] => format!("{first:.0} to {last:.0} nm"),
    };
    let count = nodes.len();
    let why = format!(
        "{range} of 390 to 830 nm is computed at {count} wavelengths; light beyond is kept at the nearest"
    );
    Some(omission("wavelengths without light that a cone can catch", &why, look.wavelengths.outside))
}

fn field_nodes(look: &Look) -> Option<Omission> {
    let most = look.tiles.iter().map(|t| t.kernels.field_nodes).max()?;
    let why = format!("over a tile the optics change little: {most} points along each side");
    Some(omission("points of the field", &why, error::field_part(look.tiles, look.experiment.eye.pupil_mm)))
}

fn coarse_grids(look: &Look) -> Option<Omission> {
    let band = look.tiles.iter().map(|t| t.scene.band).fold(0.0, f64::max);
    let kept = band * std::f64::consts::PI / 180.0;
    let why = format!("frequencies up to {kept:.0} cycles per degree are kept, fewer where cones are wide");
    let what = "spatial frequencies that blur and apertures average away";
    (band < look.setup.cutoff(look.experiment))
        .then(|| omission(what, &why, error::band_bound(look.experiment)))
}

fn motion(look: &Look) -> Option<Omission> {
    look.setup.gaze.is_still().then(|| omission("motion blur", "the eye does not move", 0.0))
}

fn course(look: &Look) -> Option<Omission> {
    let display = &look.experiment.display;
    let steady = |p: &Primary| p.waveform == Waveform::Steady;
    let varies = !display.primaries.iter().all(steady) || display.panel.lag_ms > 0.0;
    let why = "to an eye that does not move the light of a frame is one sum";
    (look.setup.gaze.is_still() && varies).then(|| omission("the course of light inside a frame", why, 0.0))
}

/// Visual eccentricity nearest to the fovea, degrees.
fn nearest_deg(look: &Look) -> f64 {
    let region = look.setup.region;
    (glam::DVec2::ZERO.clamp(region.min, region.max).length() / UM_PER_TANGENT).to_degrees()
}

/// Whether nothing changes with eccentricity from there on.
pub fn beyond_gradients(experiment: &Experiment, ecc_deg: f64) -> bool {
    Rule::Eccentricities.applies(experiment) && ecc_deg > GRADIENTS_END_DEG
}

fn eccentricities(look: &Look) -> Option<Omission> {
    let flat = look.tiles.iter().filter(|t| t.kernels.ecc_nodes == 1).count();
    let why = format!("{flat} tile(s) lie beyond {GRADIENTS_END_DEG}°: macula and pigments change no more");
    (flat > 0).then(|| omission("changes of pigments with eccentricity", &why, 0.0))
}

fn macula(look: &Look) -> Option<Omission> {
    let beyond = nearest_deg(look) > MACULA_EDGE_DEG;
    beyond.then(|| omission("macular pigment", "the patch lies beyond its edge", 0.0))
}

fn unlit_primaries(look: &Look) -> Option<Omission> {
    let dark = lit::primaries(look.experiment).iter().filter(|lit| !**lit).count();
    let why =
        format!("{dark} primaries are dark in the whole video; the low-rank basis is chosen without them");
    let bound = error::basis_part(look.experiment);
    (dark > 0).then(|| omission("optics of primaries that nothing lights", &why, bound))
}

fn joined_primaries(look: &Look) -> Option<Omission> {
    let (computed, all) = (lit::computed_primaries(look.experiment), look.experiment.display.primaries.len());
    let why = format!(
        "the video is gray and they shine at the same places and times: {all} are computed as {computed}, with a basis of images of its own"
    );
    let bound = primaries::BASIS_SHARE * error::basis_part(look.experiment);
    (computed < all).then(|| omission("what gray pictures do not show of single primaries", &why, bound))
}

fn repeated_frames(look: &Look) -> Option<Omission> {
    let Experiment { frames, counts, display, .. } = look.experiment;
    let dithered = match display.panel.levels {
        Levels::Continuous => false,
        Levels::Values { dither, .. } | Levels::Planes { dither, .. } => dither,
    };
    let may = *frames > 1 && counts.engine == Engine::Expected && look.setup.gaze.is_still() && !dithered;
    let why = "means of a frame that shows the same as the first one are those of that one";
    may.then(|| omission("frames that repeat", why, 0.0))
}

fn dark_tiles(look: &Look) -> Option<Omission> {
    let may = look.experiment.display.black <= 0.0 && look.experiment.counts.engine == Engine::Expected;
    let why = "a frame of a tile that sees no lit pixel is 0 without being computed";
    may.then(|| omission("frames and tiles without light", why, 0.0))
}

fn blind_types(look: &Look) -> Option<Omission> {
    let why =
        "a type of cone that there is none of, or that catches less than this of what the best one does";
    (look.experiment.counts.engine == Engine::Expected).then(|| {
        omission("images for types of cone without light", why, Numerics::new(look.experiment).blind_below)
    })
}

fn pointing(look: &Look) -> Option<Omission> {
    let effect = pointing_effect(look.experiment, &pointing_of(look.experiment, look.setup).ok()?);
    let small = effect < POINTING_SHARE * look.experiment.accuracy_target;
    small.then(|| omission("pointing errors of cones", "they change less than the target asks", effect))
}

fn copies(look: &Look) -> Option<Omission> {
    let guard_um = look.setup.guard_um;
    let why = format!(
        "the image is periodic, the nearest copy some {guard_um:.0} µm and twice the blur from any cone; what a copy adds is taken away by the law of the spread's tail"
    );
    let bound = error::copies_part(look.experiment, look.tiles);
    Some(omission("what the law of the tail does not tell of the picture's copies", &why, bound))
}

fn scan_steps(look: &Look) -> Option<Omission> {
    let scanned = look.experiment.display.primaries.iter().any(|p| p.waveform.scan().is_some());
    let why =
        "the turns of pixels are cut into steps; of a frequency at a third of the band so much is blurred";
    (scanned && !look.setup.gaze.is_still())
        .then(|| omission("times between the steps of the scan", why, crate::exposure::SCAN_BLUR))
}

fn ghosts(look: &Look) -> Option<Omission> {
    let display = &look.experiment.display;
    let frame_s = 1.0 / display.frame_rate_hz;
    let history = |p: &Primary| p.waveform.timing(0, frame_s, display.panel.lag_ms).history();
    let history = display.primaries.iter().map(history).max().unwrap_or(0);
    let why = format!("{history} earlier frames are looked at");
    (history > 0).then(|| omission("ghosts of frames before those", &why, FORGOTTEN))
}

fn directional(look: &Look) -> Option<Omission> {
    let eye = &look.experiment.eye;
    let lost = DEFAULT_RHO10_PER_MM2 * std::f64::consts::LN_10 * eye.pupil_mm.powi(2) / 8.0;
    (eye.stiles_crawford_rho10_per_mm2 <= 0.0).then(|| {
        omission("directional sensitivity of the cones", "the experiment switches it off", lost.min(1.0))
    })
}

/// Rays through the edge of the pupil have a shorter way in the lens and lose less. Their light is right in sum, its share of the spread's
/// shape is not: by up to 1.5 times the spread of transmissions over the pupil (`photoneye study optics` has both).
fn absorption(look: &Look) -> Option<Omission> {
    let eye = look.setup.projection.eye();
    let object = look.setup.projection.object(glam::DVec2::ZERO);
    let nm = look.experiment.eye.focus_wavelength_nm;
    let wavefront = Wavefront::new(eye, object, nm, &WavefrontOptions::default()).ok()?;
    let spread = wavefront.path_lens_variance.sqrt();
    let bound = 1.5 * std::f64::consts::LN_10 * look.wavelengths.lens_density * spread;
    let why = format!(
        "the lens is thinner away from its axis: paths differ by {:.1} % (rms), the transmission is that of their mean",
        100.0 * spread
    );
    Some(omission("the shape that absorption over the pupil gives the spread", &why, bound))
}

/// A steady white screen would bleach I/(I + I₀) of the pigment.
fn bleaching(look: &Look) -> Option<Omission> {
    let experiment = look.experiment;
    let trolands = experiment.display.white_trolands(experiment.eye.pupil_mm);
    let bound = 1.0 - unbleached(trolands);
    let mut why = format!("pigments are taken as unbleached, as in §20; a white screen has {trolands:.0} td");
    if bound > 0.01 {
        why += ": it matters here, see retina.bleaching";
    }
    experiment.retina.bleaching_td.is_none().then(|| omission("bleaching", &why, bound))
}

/// Information: which apertures are used, and what the other ones would change. The bound is the largest
/// change in the patch.
fn aperture(look: &Look) -> Option<Omission> {
    let retina = &look.setup.retina;
    let change = apertures::change(retina, &look.setup.region);
    let told = |(deg, change): (f64, f64)| {
        let verb = if change < 0.0 { "lower" } else { "raise" };
        format!("{verb} counts by {:.1} % at {deg:.1}°", 100.0 * change.abs())
    };
    let (what, why) = match retina.aperture {
        Aperture::Cell => (
            "the measured size of inner segments",
            "apertures fill the cells where there are no rods, as in the paper (CELL); retina.aperture INNER_SEGMENT would",
        ),
        Aperture::InnerSegment => (
            "apertures that fill their cells",
            "apertures are as wide as measured inner segments (INNER_SEGMENT); the paper's, retina.aperture CELL, would",
        ),
    };
    let of = if look.setup.mosaic.is_some() { ", in cells of the density law" } else { "" };
    let why = format!("{why} {} and {}{of}", told(change.nearest), told(change.farthest));
    Some(omission(what, &why, change.largest))
}

/// What the eye of a person of 30 years would take out of the image.
fn stray_light(look: &Look) -> Option<Omission> {
    let usual = StrayLight { age_years: 30.0, pigmentation: 0.5 };
    let why = "scattered light stays in the image; at 30 years so much of every pixel's light would leave its image and be spread over the field: with the image's own skirt 136 /sr at 0.5°, 19 /sr at 1°, 1.0 /sr at 3°, 0.06 /sr at 10° (CIE 135/1), so that what is dark beside light would not be dark, see eye.stray_light";
    let none = look.experiment.eye.stray_light.is_none();
    let fraction = || Scatter::new(look.experiment, usual).map_or(USUAL_SCATTER, |s| s.fraction());
    none.then(|| omission("light scattered in the eye", why, fraction()))
}

fn reflections(look: &Look) -> Option<Omission> {
    let why = "the flat 0.016 in the density of the cornea stands for them; computed, 1 % more light passes, see eye.reflection_losses";
    (!look.experiment.eye.reflection_losses)
        .then(|| omission("reflections at the surfaces of cornea and lens", why, 0.01))
}
