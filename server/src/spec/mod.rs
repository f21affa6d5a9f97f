//! From the schema's experiment, as it came in through either door, to the model's: defaults filled in, every field checked.

pub mod display;
mod eye;
mod read;
mod scene;

use photoneye_eye::experiment::{Counts, Engine, Experiment, PaperSettings, Retina, Video};
use photoneye_eye::plan::engine::automatic;
use photoneye_eye::plan::setup::fixation;
use photoneye_eye::plan::{Knobs, Rule};
use photoneye_eye::retina::{Aperture, CellWalls, ConeType, DensityLaw, Dropout, Generator};
use photoneye_proto::{FieldError, v1};

pub use eye::DEFAULT_EYE;
pub use read::field_error;
use read::{choice, in_range, needed, number};
pub use scene::recording_covers;

/// Cones that are computed again when nothing is said.
const AUDIT_CONES: u32 = 6;

/// The model's experiment.
///
/// # Errors
/// The first field that is missing, unknown or out of range.
pub fn experiment(spec: &v1::Experiment) -> Result<Experiment, FieldError> {
    let display = display::display(spec.display.as_ref())?;
    let gaze = scene::gaze(spec.gaze.as_ref(), &display)?;
    let shown = (spec.video.as_ref(), spec.frames.as_ref());
    let video = scene::video(shown, &gaze, &display)?;
    let frames = spec.frames.as_ref().and_then(|frames| frames.count);
    let frames = frames.unwrap_or_else(|| match &video {
        Video::Clip(clip) => (clip.blobs.len() as u32).max(1),
        Video::Pattern(_) => 1,
    });
    let eye = eye::eye(spec.eye.as_deref(), display.distance_cm)?;
    let white_td = display.white_trolands(eye.pupil_mm);
    let mut experiment = Experiment {
        eye,
        retina: retina(spec.retina.as_ref(), white_td)?,
        display,
        video,
        gaze,
        counts: counts(spec.counts.as_ref())?,
        accuracy_target: number(spec.accuracy.as_ref().and_then(|accuracy| accuracy.target), 0.001),
        audit_cones: spec.accuracy.as_ref().and_then(|a| a.audit_cones).unwrap_or(AUDIT_CONES),
        computed_anyway: computed_anyway(spec.accuracy.as_ref())?,
        frames,
    };
    experiment.validate().map_err(field_error)?;
    let is_focus_given = spec.eye.as_ref().is_some_and(|e| e.focus.is_some_and(|f| f.distance_cm.is_some()));
    if !is_focus_given {
        // The eye accommodates to the point that it fixates.
        let fixation = fixation(&experiment).map_err(read::plan_error)?;
        if !fixation.screen.is_frontal() {
            experiment.eye.focus_distance_cm = 0.1 * fixation.screen.fixated_mm();
            experiment.validate().map_err(field_error)?;
        }
    }
    recording_covers(spec.gaze.as_ref(), &experiment)?;
    if is_auto(spec.counts.as_ref()) {
        // What cannot be planned is refused by the plan, which says why.
        experiment.counts.engine = automatic(&experiment).unwrap_or(Engine::Expected);
    }
    default_seeds(spec, &mut experiment)?;
    Ok(experiment)
}

/// Gives the seeds that were not given: others for other experiments, so that their noise is independent.
fn default_seeds(spec: &v1::Experiment, experiment: &mut Experiment) -> Result<(), FieldError> {
    let movement = spec.gaze.as_ref().and_then(|gaze| gaze.movement.as_ref());
    let is_given = [
        spec.counts.as_ref().is_some_and(|counts| counts.seed.is_some()),
        movement.is_some_and(|movement| movement.seed.is_some()),
    ];
    if is_given == [true; 2] {
        return Ok(());
    }
    let of_content = experiment.seed_of_content();
    let seed = of_content.map_err(|error| FieldError::new("counts.seed", error.to_string()))?;
    if !is_given[0] {
        experiment.counts.seed = seed;
    }
    if !is_given[1] {
        experiment.gaze.seed = seed ^ 1;
    }
    Ok(())
}

/// `white_td` is the retinal illuminance by the display's white, trolands.
fn retina(spec: Option<&v1::Retina>, white_td: f64) -> Result<Retina, FieldError> {
    use v1::retina::{Aperture as A, CellWalls as W, Density as D, Generator as G};
    let spec = spec.cloned().unwrap_or_default();
    let default = Retina::default();
    let region_deg = match spec.region_deg {
        None => None,
        Some(region) => Some([
            needed("retina.region_deg.x_min", region.x_min)? + 0.0,
            needed("retina.region_deg.x_max", region.x_max)? + 0.0,
            needed("retina.region_deg.y_min", region.y_min)? + 0.0,
            needed("retina.region_deg.y_max", region.y_max)? + 0.0,
        ]),
    };
    Ok(Retina {
        seed: spec.seed.unwrap_or(default.seed),
        generator: match choice("retina.generator", spec.generator, G::Domain, G::as_str_name)? {
            G::Domain => Generator::Domain,
            G::Ring => Generator::Ring,
        },
        density: match choice("retina.density", spec.density, D::Curcio, D::as_str_name)? {
            D::Curcio => DensityLaw::Curcio,
            D::Tyler => DensityLaw::Tyler,
        },
        cell_walls: match choice("retina.cell_walls", spec.cell_walls, W::Power, W::as_str_name)? {
            W::Power => CellWalls::Power,
            W::Averaging => CellWalls::Averaging,
        },
        aperture: match choice("retina.aperture", spec.aperture, A::Cell, A::as_str_name)? {
            A::Cell => Aperture::Cell,
            A::InnerSegment => Aperture::InnerSegment,
        },
        peak_density_per_mm2: number(spec.peak_density_per_mm2, default.peak_density_per_mm2),
        total_cones: spec.total_cones.map(|total| total + 0.0),
        cycles: spec.cycles,
        cone_ratio: cone_ratio(spec.cone_ratio.unwrap_or_default())?,
        s_repulsion: number(spec.s_repulsion, default.s_repulsion),
        s_ramp_deg: [
            number(spec.s_free_deg, default.s_ramp_deg[0]),
            number(spec.s_full_deg, default.s_ramp_deg[1]),
        ],
        dropout: spec
            .dropout
            .map(|d| Dropout { fraction: number(d.fraction, 0.0), seed: d.seed.unwrap_or(1) }),
        optic_disc: spec.optic_disc.unwrap_or(default.optic_disc),
        region_deg,
        mosaic_type_unknown: spec.mosaic.as_ref().map(type_unknown).transpose()?.flatten(),
        mosaic: mosaic(spec.mosaic)?,
        dark_isomerizations_per_s: number(spec.dark_isomerizations_per_s, default.dark_isomerizations_per_s),
        bleaching_td: spec.bleaching.map(|bleaching| number(bleaching.adaptation_td, white_td)),
    })
}

/// Type of the measured cones that were not classified.
fn type_unknown(spec: &v1::Mosaic) -> Result<Option<ConeType>, FieldError> {
    use v1::mosaic::TypeUnknown as T;
    let Some(given) = spec.type_unknown else { return Ok(None) };
    Ok(Some(match choice("retina.mosaic.type_unknown", Some(given), T::L, T::as_str_name)? {
        T::L => ConeType::L,
        T::M => ConeType::M,
        T::S => ConeType::S,
    }))
}

/// Digest of the table of a measured mosaic.
fn mosaic(spec: Option<v1::Mosaic>) -> Result<Option<String>, FieldError> {
    use v1::mosaic::Kind as K;
    match spec.map(|spec| spec.kind) {
        None => Ok(None),
        Some(None) => Err(read::empty_choice("retina.mosaic", &["file", "blob"])),
        Some(Some(K::File(_))) => Err(FieldError::new(
            "retina.mosaic.file",
            "the server reads no files: upload the table (PUT /v1/blobs) and send its digest as `blob`",
        )),
        Some(Some(K::Blob(blob))) => {
            let wrong = |error: photoneye_store::digest::NotADigest| {
                FieldError::new("retina.mosaic.blob", error.to_string())
            };
            let digest: photoneye_store::BlobDigest = blob.parse().map_err(wrong)?;
            Ok(Some(digest.to_string()))
        }
    }
}

/// Shares that sum to 1.
fn cone_ratio(spec: v1::ConeRatio) -> Result<[f64; 3], FieldError> {
    let share = |name: &str, value, default| {
        in_range(&format!("retina.cone_ratio.{name}"), number(value, default), 0.0, 1e6)
    };
    let shares = [share("l", spec.l, 0.62)?, share("m", spec.m, 0.30)?, share("s", spec.s, 0.08)?];
    let sum: f64 = shares.iter().sum();
    if sum < 1e-9 {
        return Err(FieldError::new("retina.cone_ratio", "the shares are all 0"));
    }
    // Shares that sum to 1 but for rounding stay as they are written.
    let scale = if (sum - 1.0).abs() < 1e-12 { 1.0 } else { sum };
    Ok(shares.map(|share| share / scale))
}

/// Omissions that are not made, in the order of the rules.
fn computed_anyway(spec: Option<&v1::Accuracy>) -> Result<Vec<Rule>, FieldError> {
    let Some(spec) = spec else { return Ok(Vec::new()) };
    if spec.omissions == Some(false) {
        return Ok(Rule::ALL.to_vec());
    }
    let mut rules = Vec::new();
    for (i, number) in spec.computed_anyway.iter().enumerate() {
        let rule = usize::try_from(*number).ok().and_then(|number| Rule::ALL.get(number));
        rules.push(*rule.ok_or_else(|| {
            let field = format!("accuracy.computed_anyway[{i}]");
            FieldError::new(&field, format!("{number} is unknown, allowed is 0 to {}", Rule::ALL.len() - 1))
        })?);
    }
    rules.sort_unstable();
    rules.dedup();
    Ok(rules)
}

/// Whether the engine is to be chosen: not where settings of `EXPECTED` are given.
fn is_auto(spec: Option<&v1::Counts>) -> bool {
    spec.is_none_or(|counts| {
        let knob = counts.settings.and_then(|settings| given(&knobs_of(&settings)));
        counts.engine() == v1::counts::Engine::Auto && knob.is_none()
    })
}

/// Settings of one engine and whether they are given.
type Given = (&'static str, bool);

/// The settings that `EXPECTED` alone has.
fn knobs_of(settings: &v1::Settings) -> [Given; 8] {
    [
        ("basis_tolerance", settings.basis_tolerance.is_some()),
        ("band_loss", settings.band_loss.is_some()),
        ("guard_um", settings.guard_um.is_some()),
        ("spread_width", settings.spread_width.is_some()),
        ("oversampling", settings.oversampling.is_some()),
        ("field_nodes", settings.field_nodes.is_some()),
        ("ecc_nodes", settings.ecc_nodes.is_some()),
        ("double_precision", settings.double_precision.is_some()),
    ]
}

/// The settings that `PAPER` alone has.
fn paper_settings_of(settings: &v1::Settings) -> [Given; 4] {
    [
        ("paper_rays", settings.paper_rays.is_some()),
        ("paper_samples", settings.paper_samples.is_some()),
        ("paper_window_um", settings.paper_window_um.is_some()),
        ("paper_node_um", settings.paper_node_um.is_some()),
    ]
}

fn given(settings: &[Given]) -> Option<&'static str> {
    settings.iter().find(|(_, is_given)| *is_given).map(|(name, _)| *name)
}

/// Refuses settings that the engine does not have.
fn settings_fit(engine: Engine, settings: &v1::Settings) -> Result<(), FieldError> {
    let refused = |name: &str, owner: &str| {
        Err(FieldError::new(format!("counts.settings.{name}"), format!("needs `counts.engine` `{owner}`")))
    };
    match (engine, given(&paper_settings_of(settings)), given(&knobs_of(settings))) {
        (Engine::Expected | Engine::Events, Some(name), _) => refused(name, "PAPER"),
        (Engine::Events | Engine::Paper, _, Some(name)) => refused(name, "EXPECTED"),
        _ => Ok(()),
    }
}

fn counts(spec: Option<&v1::Counts>) -> Result<Counts, FieldError> {
    use v1::counts::{Engine as E, Noise as N};
    let spec = spec.copied().unwrap_or_default();
    let settings = spec.settings.unwrap_or_default();
    let paper = PaperSettings::default();
    let engine = match choice("counts.engine", spec.engine, E::Auto, E::as_str_name)? {
        // AUTO is decided when all else is known.
        E::Auto | E::Expected => Engine::Expected,
        E::Events => Engine::Events,
        E::Paper => Engine::Paper,
    };
    settings_fit(engine, &settings)?;
    let poisson = choice("counts.noise", spec.noise, N::Poisson, N::as_str_name)? == N::Poisson;
    if !poisson && engine != Engine::Expected {
        let message = "`NONE` (means) needs `counts.engine` `EXPECTED`: photons counted one by one are noisy";
        return Err(FieldError::new("counts.noise", message));
    }
    Ok(Counts {
        engine,
        poisson,
        seed: spec.seed.unwrap_or(0),
        photon_list: spec.photon_list.unwrap_or(false),
        wavelength_step_nm: settings.wavelength_step_nm,
        knobs: Knobs {
            basis_tolerance: settings.basis_tolerance,
            band_loss: settings.band_loss,
            guard_um: settings.guard_um,
            spread_width: settings.spread_width,
            oversampling: settings.oversampling,
            field_nodes: settings.field_nodes,
            ecc_nodes: settings.ecc_nodes,
            double_precision: settings.double_precision,
        },
        paper: PaperSettings {
            rays: settings.paper_rays.unwrap_or(paper.rays),
            samples: settings.paper_samples.unwrap_or(paper.samples),
            window_um: number(settings.paper_window_um, paper.window_um),
            node_um: number(settings.paper_node_um, paper.node_um),
        },
    })
}
