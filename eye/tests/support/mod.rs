//! Scenes for the tests of the whole model, and a runner that builds a plan's artifacts.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "each test file uses a part; tests fail by panicking"
)]

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use photoneye_eye::artifact::Input;
use photoneye_eye::cone::directional::{DEFAULT_RHO10_PER_MM2, PointingLaw};
use photoneye_eye::digest::Digest;
use photoneye_eye::display::{
    Channel, Display, EmissionLaw, Panel, Placement, Primary, Transfer, Waveform, White,
};
use photoneye_eye::experiment::{
    Counts, Engine, Experiment, Eye, Gaze, Movement, PaperSettings, Pattern, Retina, Video,
};
use photoneye_eye::exposure::Exposure;
use photoneye_eye::optics::{Dispersion, Side};
use photoneye_eye::plan::{Plan, plan};
use photoneye_eye::retina::Retina as Cones;
use photoneye_eye::spectrum::Spectrum;

/// A primary that fills 80 % of the pixel.
pub fn primary(channel: Channel, spectrum: Spectrum) -> Primary {
    let edge = 0.5 * (1.0 - 0.8_f64.sqrt());
    Primary {
        channel,
        spectrum,
        power: 1.0,
        rects: vec![[edge, edge, 1.0 - edge, 1.0 - edge]],
        offset_px: [0.0; 2],
        spot_sd_px: 0.0,
        waveform: Waveform::Steady,
    }
}

/// The scene of Figure 12 with a drawn pattern.
pub fn figure_12(pattern: Pattern) -> Experiment {
    let named = |name: &str| Spectrum::named(name).unwrap();
    Experiment {
        eye: Eye {
            preset: "escudero-sanz-navarro".into(),
            side: Side::Right,
            pupil_mm: 3.0,
            decentre_mm: 0.4,
            focus_distance_cm: 800.0,
            focus_wavelength_nm: 543.0,
            dispersion: Dispersion::Herzberger,
            macular_peak_density: 0.404,
            lens_density_scale: 1.0,
            cornea_density_scale: 1.0,
            stiles_crawford_rho10_per_mm2: DEFAULT_RHO10_PER_MM2,
            pointing_sd_deg: 1.0,
            pointing_law: PointingLaw::Population,
            prescription: None,
            relaxed: false,
            amplitude_d: None,
            reflection_losses: false,
            stray_light: None,
        },
        retina: Retina::default(),
        display: Display {
            width_px: 30,
            height_px: 30,
            pixel_pitch_cm: 0.58,
            distance_cm: 800.0,
            placement: Placement::Frontal,
            white: White::LuminanceCdM2(250.0),
            frame_rate_hz: 60.0,
            transfer: Transfer::Srgb,
            black: 0.0,
            panel: Panel::default(),
            emission_law: EmissionLaw::Lambertian,
            primaries: vec![
                primary(Channel::Red, named("projector-uhp/red")),
                primary(Channel::Green, named("projector-uhp/green")),
                primary(Channel::Blue, named("projector-uhp/blue")),
            ],
        },
        video: Video::Pattern(pattern),
        gaze: Gaze {
            movement: Movement::Drift { speed_arcmin_per_s: 6.0, direction_deg: 30.0 },
            ..Gaze::still([15.0, 15.0])
        },
        counts: Counts {
            engine: Engine::Expected,
            poisson: true,
            seed: 7,
            photon_list: false,
            wavelength_step_nm: None,
            knobs: photoneye_eye::plan::Knobs::default(),
            paper: PaperSettings::default(),
        },
        accuracy_target: 0.01,
        audit_cones: 0,
        computed_anyway: Vec::new(),
        frames: 1,
    }
}

/// Settings finer than what a target asks for.
pub fn finer(experiment: &mut Experiment) {
    experiment.counts.wavelength_step_nm = Some(5.0);
    experiment.counts.knobs = photoneye_eye::plan::Knobs {
        basis_tolerance: Some(1e-5),
        band_loss: Some(3e-5),
        guard_um: Some(600.0),
        spread_width: Some(10),
        oversampling: Some(1.25),
        field_nodes: Some(4),
        ecc_nodes: Some(4),
        double_precision: Some(true),
    };
}

/// White everywhere.
pub const WHITE: Pattern = Pattern::Uniform { rgb: [1.0; 3] };

/// Builds every artifact of a plan.
pub fn build(plan: &Plan) -> BTreeMap<Digest, Vec<u8>> {
    let mut built: BTreeMap<Digest, Vec<u8>> = BTreeMap::new();
    for artifact in &plan.artifacts {
        let started = std::time::Instant::now();
        let inputs: Vec<Input> = artifact.inputs.iter().map(|k| (*k, built[k].as_slice())).collect();
        let bytes = artifact.spec.build(&inputs).unwrap().bytes;
        if std::env::var_os("PHOTONEYE_TEST_TIMES").is_some() {
            println!(
                "{:12} {:8.3} s {:10} bytes",
                artifact.spec.kind(),
                started.elapsed().as_secs_f64(),
                bytes.len()
            );
        }
        built.insert(artifact.key, bytes);
    }
    built
}

/// Plans, builds and prepares an experiment.
pub fn exposure(experiment: &Experiment) -> (Plan, Exposure) {
    let plan = plan(experiment).unwrap();
    let built = build(&plan);
    let artifacts: Vec<&Vec<u8>> = plan.tile_artifacts[0].iter().map(|k| &built[k]).collect();
    let exposure = Exposure::new(experiment, &artifacts).unwrap();
    (plan, exposure)
}

/// Artifacts that were built once: waveforms, panels and brightness need no new ones.
static BUILT: Mutex<BTreeMap<Digest, Vec<u8>>> = Mutex::new(BTreeMap::new());

/// As [`exposure`], with what another test of the file has built.
pub fn cached_exposure(experiment: &Experiment) -> Exposure {
    let plan = plan(experiment).unwrap();
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    for artifact in &plan.artifacts {
        if !built.contains_key(&artifact.key) {
            let inputs: Vec<_> = artifact.inputs.iter().map(|key| (*key, built[key].as_slice())).collect();
            let bytes = artifact.spec.build(&inputs).unwrap().bytes;
            built.insert(artifact.key, bytes);
        }
    }
    let artifacts: Vec<&Vec<u8>> = plan.tile_artifacts[0].iter().map(|key| &built[key]).collect();
    Exposure::new(experiment, &artifacts).unwrap()
}

/// The cones of an experiment.
pub fn cached_retina(experiment: &Experiment) -> Cones {
    let key = plan(experiment).unwrap().tile_artifacts[0][0];
    cached_exposure(experiment);
    Cones::from_bytes(&BUILT.lock().unwrap()[&key]).unwrap()
}
