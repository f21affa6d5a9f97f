//! The error estimate: relative error of the mean per cone (L1 over cones) by its parts, for the settings that were chosen.
//!
//! Every constant is here; they were fitted to audits (`photoneye study prediction`). Parts add up: they have no common cause.

use std::f64::consts::PI;

use glam::DVec2;

use super::lit::sparsity;
use super::setup::{Setup, UM_PER_TANGENT};
use super::wavelengths::Wavelengths;
use super::{ErrorPart, Knobs, Numerics, PlanError, PlannedTile};
use crate::experiment::{Engine, Experiment, Movement, Pattern, RangeError, Video};
use crate::exposure::paper::{snapped_nm, spread::beyond_window};
use crate::exposure::scene::Scene;
use crate::exposure::spectral::{Kind, Paths, Share};
use crate::exposure::turned::Turning;
use crate::psf::{StilesCrawfordApodization, WavefrontOptions};
use crate::retina::ConeType;

/// Energy of a diffraction-limited spread beyond a radius R is about λ/(π² NA R); λ in the vitreous over NA, µm, at 3 mm.
const TAIL_UM: f64 = 0.62;
/// Error of fitted wavefronts and of their quadrature, at 3 mm; it grows with the cube of the pupil. Not in it: a transfer function takes
/// distances across the spread to first order (L1 of the spread at 3 mm: 1.2e-5 in focus, 1.3e-4 one dioptre off; `photoneye study optics`).
const OPTICS: f64 = 2e-6;
/// Error of wavelength steps of 10 nm; interpolation between six gains the sixth power of the step: 20 nm cost 3.6e-4 in one lit pixel, 15 nm 3e-5.
const STEP_10_NM: f64 = 5e-6;
/// Error of a field of one point a degree along each side, with one, two or more points: squares of one pixel on patches of 0.9, 1.5 and 2.0°
/// half their side: two points 2e-3, 5.6e-3 and 8.7e-3, three of 0.9° 3e-5, four of 1.5 and 2.0° 4e-5.
const FIELD: [f64; 3] = [6e-3, 1.5e-2, 2e-3];
/// Error of wide blurs beside the fovea over the power 5/2 of the phase that the map's bend turns, of an even
/// picture. One line of light, `BY_HAND=1` in `targets_are_kept` of the test `validity`: 6 mm at 20 and 30°
/// (x = 1.6 and 4.2) 3.4e-4 and 7e-4 to 1.6e-3 in all; 8 mm at 20° (x = 5.4) 1.2e-2 to 2.3e-2, of which one cone
/// in sixteen is the most, and 8e-3 to 9e-3 over all cones against `EVENTS`.
const BEND: f64 = 1.4e-4;
/// What it adds per sparsity of the picture above 1, over the bend in a blur: one lit pixel of one line, 3 mm at
/// 20° 1.2e-3 in all, 6 mm at 20 and 30° 2.2e-3 and 1.1e-2, 8 mm at 20° 7.6e-3.
const BEND_OF_A_POINT: f64 = 0.4;
/// Error of means over the relative change of the size on the screen of what a place of the retina sees as
/// the eye turns, of pictures and of an even one (`eyes_that_turn` of the test `validity`). Squares of one
/// pixel of 2.9 arcmin, 3 mm, a turn of 63 arcmin, in all: gaze 24° aside 3.7e-3 of a change of 1.7e-2 at the
/// fovea and of 1.1e-2 at 8°; an even field at most 6e-4.
const TURN: f64 = 0.3;
const TURN_OF_UNIFORM: f64 = 0.02;
/// Part of the copies' light that is left in the means after the tail's law is subtracted.
const COPIES: f64 = 0.05;
/// How much means move per tolerance of the low-rank basis, whatever the picture: 0.4 to 0.9, ranks are whole numbers.
const BASIS: f64 = 0.7;
/// How much means of an evenly lit picture move per loss above the band.
const BAND: f64 = 0.3;
/// How much more they move per sparsity of the picture above 1, and at most: the loss is of the energy, errors of the light.
const SPARSE: f64 = 0.1;
const MOST_SPARSE: f64 = 2.5;
/// Points of a window and of a patch along a side in the sum over copies.
const GRID: u32 = 8;
const PLACES: u32 = 3;
/// Targets that are tried when one is refused, and the coarsest.
const TRIES: u32 = 12;
const MOST: f64 = 0.2;
/// Error of the spreading kernel over a power of ten for each sample of its width: one lit pixel of 30 x 30 with 4 samples and 1.02-fold
/// oversampling 2.7e-4, squares 1.5e-4.
const SPREAD: f64 = 2.0;
/// Error of sums in single precision.
const SINGLE: f64 = 2e-6;

/// Error of the means of `events`: of tables to draw from, blended between nodes, which is taken to grow with the cube of the pupil, and of
/// wavelengths 10 nm apart of which each photon has one, which gains the square of the step. The squares of Figure 12, an eye at rest, 3 mm, against
/// `expected` at 1e-4, chance taken off: 1.5e-3, 1.8e-3 and 3.4e-3 at 5, 10 and 15 nm.
const TABLES: f64 = 1.3e-3;
const DRAWN_STEP_10_NM: f64 = 9e-4;

/// Part of a spread's light farther from its middle than a distance (µm).
pub fn tail_beyond(experiment: &Experiment, um: f64) -> f64 {
    0.5 * TAIL_UM * 3.0 / experiment.eye.pupil_mm / um
}

/// Light of the copies of an evenly lit window on its cones, relative to its own: `Σ ∫ T/(4π r³) dA` over the eight nearest copies, where
/// T/(2R) is the part of a spread beyond R; the mean over places of the patch.
fn copies(experiment: &Experiment, scene: &Scene) -> f64 {
    let tail_um = TAIL_UM * 3.0 / experiment.eye.pupil_mm;
    let px_um = scene.tangent_per_px * UM_PER_TANGENT;
    let size = DVec2::new(f64::from(scene.size_px[0]), f64::from(scene.size_px[1]));
    let period = DVec2::new(scene.period_px[0] as f64, scene.period_px[1] as f64);
    let part = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n);
    let cells = |n: u32| (0..n).flat_map(move |i| (0..n).map(move |j| DVec2::new(part(i, n), part(j, n))));
    let area_um2 = size.x * size.y * px_um * px_um / f64::from(GRID * GRID);
    let [min, max] = scene.cones_px;
    let mut sum = 0.0;
    for place in cells(PLACES) {
        let cone = min + (max - min) * place;
        for (x, y) in (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))).filter(|copy| *copy != (0, 0)) {
            let corner = period * DVec2::new(f64::from(x), f64::from(y)) - cone;
            // A copy is never nearer than a pixel.
            let light = |p: DVec2| ((corner + size * p).length().max(1.0) * px_um).powi(-3);
            sum += cells(GRID).map(light).sum::<f64>();
        }
    }
    tail_um / (4.0 * PI) * area_um2 * sum / f64::from(PLACES * PLACES)
}

/// Error of interpolation over the field: over n points it gains the n-th power of the step per point in degrees.
pub fn field_part(tiles: &[PlannedTile], pupil_mm: f64) -> f64 {
    let pupil = (pupil_mm / 3.0).max(1.0);
    let field = |tile: &PlannedTile| {
        let nodes = tile.kernels.field_nodes.max(1);
        let step = super::half_side_deg(&tile.region) / f64::from(nodes);
        FIELD[nodes.min(3) as usize - 1] * step.powi(nodes as i32).min(1.0)
    };
    // Aberrations grow faster than the pupil.
    pupil * pupil * tiles.iter().map(field).fold(0.0, f64::max)
}

/// Error of the bend of the map from screen to retina within a wide blur. Kernels take it to first order: it
/// turns the phase of the highest frequency by up to `x = 2π B b blur²`, of which x²/2 is left out, at the
/// blur's edge. It grows with the place as what polynomials over the field leave does, where the edges of wide
/// blurs move: both are in it.
fn bend_part(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> f64 {
    let sparse = sparse(experiment);
    let of_tile = |tile: &PlannedTile| {
        let seen = setup.seen(experiment, &tile.region).unwrap_or_default();
        let turned = 2.0 * PI * tile.scene.band * seen.bend * seen.blur.powi(2);
        let few = BEND_OF_A_POINT * (sparse - 1.0) * seen.bend * seen.blur;
        (BEND * turned.powf(2.5) + few).min(1.0)
    };
    tiles.iter().map(of_tile).fold(0.0, f64::max)
}

/// The eye's turn before the screen: PSFs keep the size that they have on the screen at rest.
fn turn_part(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> f64 {
    let law = experiment.display.emission_law;
    let uniform = matches!(experiment.video, Video::Pattern(Pattern::Uniform { .. }));
    let of_tile = |tile: &PlannedTile| {
        let Ok(gaze) = setup.gaze_of(&tile.region) else { return 1.0 };
        let frames = [f64::from(experiment.frames), experiment.display.frame_rate_hz];
        let Some(turning) = Turning::new(&setup.projection, &tile.scene, (&gaze, law), frames) else {
            return 0.0;
        };
        if uniform { TURN_OF_UNIFORM * turning.stretch() } else { TURN * turning.stretch() }
    };
    tiles.iter().map(of_tile).fold(0.0, f64::max).min(1.0)
}

/// What the frequencies that are left out may change at most; on an evenly lit picture it is a part of it.
pub fn band_bound(experiment: &Experiment) -> f64 {
    sparse(experiment) * Numerics::new(experiment).band_loss
}

fn sparse(experiment: &Experiment) -> f64 {
    (1.0 + SPARSE * (sparsity(experiment) - 1.0)).clamp(1.0, MOST_SPARSE)
}

/// Error of the low-rank basis.
pub fn basis_part(experiment: &Experiment) -> f64 {
    BASIS * Numerics::new(experiment).basis_tolerance
}

/// Error of the copies of the picture, after the tail's law.
pub fn copies_part(experiment: &Experiment, tiles: &[PlannedTile]) -> f64 {
    let sum: f64 = tiles.iter().map(|t| copies(experiment, &t.scene)).sum();
    COPIES * sum / tiles.len().max(1) as f64
}

/// The parts of the estimate.
pub fn estimate(
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    wavelengths: &Wavelengths,
) -> Vec<ErrorPart> {
    let mut parts = match experiment.counts.engine {
        Engine::Expected => expected(experiment, setup, tiles, wavelengths),
        Engine::Events => drawn(experiment, wavelengths),
        Engine::Paper => paper(experiment, tiles, wavelengths),
    };
    let turned = turn_part(experiment, setup, tiles);
    parts.push(ErrorPart { part: "turn of the eye before the screen".into(), relative: turned });
    parts
}

/// The parts of the estimate of `expected`.
fn expected(
    experiment: &Experiment,
    setup: &Setup,
    tiles: &[PlannedTile],
    wavelengths: &Wavelengths,
) -> Vec<ErrorPart> {
    let part = |part: &str, relative: f64| ErrorPart { part: part.into(), relative };
    let numerics = Numerics::new(experiment);
    let limited = tiles.iter().any(|t| t.scene.band < setup.cutoff(experiment));
    let pupil = (experiment.eye.pupil_mm / 3.0).max(1.0);
    // A line needs no steps.
    let steps = if wavelengths.nodes_nm.len() > 1 { (wavelengths.step_nm / 10.0).powi(6) } else { 0.0 };
    let grid =
        if numerics.single { SINGLE } else { 1e-9 } + SPREAD * 0.1_f64.powi(numerics.spread_width as i32);
    let scanned = experiment.display.primaries.iter().any(|p| p.waveform.scan().is_some());
    let turns = scanned && !matches!(experiment.gaze.movement, Movement::Still);
    vec![
        part("optics quadrature", OPTICS * pupil.powi(3)),
        part("wavelength steps", STEP_10_NM * steps * pupil),
        part("wavelengths left out", wavelengths.outside),
        part("field interpolation", field_part(tiles, experiment.eye.pupil_mm)),
        part("bend of the map within the blur", bend_part(experiment, setup, tiles)),
        part("low-rank kernels", basis_part(experiment)),
        part("period", copies_part(experiment, tiles)),
        part("band limit", if limited { BAND * band_bound(experiment) } else { 1e-7 }),
        part("grid", sparse(experiment) * grid),
        part("time segments", if turns { 0.1 * crate::exposure::SCAN_BLUR } else { 0.0 }),
        part("Poisson draws", 0.0),
    ]
}

/// The parts of the estimate of the means from which `events` draws.
fn drawn(experiment: &Experiment, wavelengths: &Wavelengths) -> Vec<ErrorPart> {
    let part = |part: &str, relative: f64| ErrorPart { part: part.into(), relative };
    let pupil = (experiment.eye.pupil_mm / 3.0).max(1.0);
    let steps = if wavelengths.nodes_nm.len() > 1 { (wavelengths.step_nm / 10.0).powi(2) } else { 0.0 };
    vec![
        part("optics quadrature", OPTICS * pupil.powi(3)),
        part("wavelength steps", DRAWN_STEP_10_NM * steps * pupil),
        part("wavelengths left out", wavelengths.outside),
        part("tables of spreads", TABLES * pupil.powi(3)),
        part("Poisson draws", 0.0),
    ]
}

/// What the paper's method leaves, computed for the middle of the picture: how much light its window holds too much, and how much the counts of
/// all cones change when each photon is given the nearest of its wavelengths.
fn paper(experiment: &Experiment, tiles: &[PlannedTile], wavelengths: &Wavelengths) -> Vec<ErrorPart> {
    let part = |part: &str, relative: f64| ErrorPart { part: part.into(), relative };
    let settings = experiment.counts.paper;
    let nm = wavelengths.nodes_nm.get(wavelengths.nodes_nm.len() / 2).copied().unwrap_or(555.0);
    let rho_base10_per_mm2 = experiment.eye.stiles_crawford_rho10_per_mm2;
    let stiles_crawford =
        (rho_base10_per_mm2 > 0.0).then_some(StilesCrawfordApodization { rho_base10_per_mm2 });
    let options = WavefrontOptions { stiles_crawford, ..WavefrontOptions::default() };
    let beyond = tiles.first().and_then(|tile| {
        let projection = tile.kernels.projection().ok()?;
        let object = projection.object(DVec2::ZERO);
        beyond_window(&projection, object, nm, settings.window_um, &options).ok()
    });
    vec![
        part("light beyond the window, put back into it", beyond.unwrap_or(1.0)),
        part("wavelengths snapped", tiles.first().and_then(|tile| snapped(tile).ok()).unwrap_or(1.0)),
        part("wavelengths left out", wavelengths.outside),
        part("Poisson draws", 0.0),
    ]
}

/// Largest relative change, over primaries, of what L and M cones of the foveal centre count when wavelengths are snapped.
fn snapped(tile: &PlannedTile) -> Result<f64, String> {
    let absorbers = tile.kernels.absorbers()?;
    let paths = Paths { cornea: 1.0, lens: 1.0 };
    let caught = |nm: f64| -> f64 {
        [ConeType::L, ConeType::M]
            .map(|cone| absorbers.caught_at(Kind::Isomerized(cone), nm, 0.0, paths))
            .iter()
            .sum()
    };
    let change = |shares: &Vec<Share>| {
        let [exact, near] = [0, 1].map(|k| {
            shares
                .iter()
                .map(|(nm, share)| share * caught(if k == 0 { *nm } else { snapped_nm(*nm) }))
                .sum::<f64>()
        });
        if exact > 0.0 { (near / exact - 1.0).abs() } else { 0.0 }
    };
    Ok(tile.kernels.shares().iter().map(change).fold(0.0, f64::max))
}

/// Whether a target is met by the settings that were chosen for it. Settings by hand and engines that draw photons are not judged.
pub fn is_met(experiment: &Experiment, parts: &[ErrorPart]) -> bool {
    let by_hand =
        experiment.counts.knobs != Knobs::default() || experiment.counts.wavelength_step_nm.is_some();
    by_hand || experiment.counts.engine != Engine::Expected || total(parts) <= experiment.accuracy_target
}

/// The whole estimate.
pub fn total(parts: &[ErrorPart]) -> f64 {
    parts.iter().map(|p| p.relative).sum()
}

/// Refuses a target, with the best one that `estimate` says is met. Coarser targets choose coarser settings, so it is looked for.
///
/// # Errors
/// The target, with the least that is allowed here.
pub fn refuse(
    experiment: &Experiment,
    parts: &[ErrorPart],
    estimate: impl Fn(&Experiment) -> Result<Vec<ErrorPart>, PlanError>,
) -> Result<(), PlanError> {
    let mut tried = experiment.clone();
    let mut needed = total(parts);
    for _ in 0..TRIES {
        // Rounded up to two figures.
        let unit = 10_f64.powf(needed.log10().floor() - 1.0);
        tried.accuracy_target = (needed / unit).ceil() * unit;
        if tried.accuracy_target > MOST {
            break;
        }
        let parts = estimate(&tried)?;
        if is_met(&tried, &parts) {
            break;
        }
        needed = total(&parts);
    }
    let least = tried.accuracy_target;
    let largest = parts.iter().max_by(|a, b| a.relative.total_cmp(&b.relative));
    let why = largest.map_or_else(String::new, |part| format!(", where most of the error is: {}", part.part));
    let allowed = if least > MOST {
        format!(
            "none with counts.engine EXPECTED for this scene{why}; take EVENTS, a smaller eye.pupil_mm or less movement"
        )
    } else {
        format!("{least:.1e} to {MOST} for this scene{why}")
    };
    Err(RangeError::new("accuracy.target", experiment.accuracy_target, &allowed).into())
}
