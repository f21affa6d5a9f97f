//! What every engine starts from: the artifacts read back, and the scene's geometry, light and movement.

use super::ExposureError;
use super::kernel::Kernels;
use super::pixel_light::FirstShown;
use super::primaries::Primaries;
use super::scene::Scene;
use super::source::Projector;
use super::turned::Turning;
use crate::cone::directional::{Pointing, PointingSpec};
use crate::display::{emitters, pupil_share};
use crate::experiment::{Experiment, RangeError};
use crate::optics::{BeamField, Prescription, Projection};
use crate::plan::Rule;
use crate::plan::setup::{Setup, setup};
use crate::retina::{RegionUm, Retina};

/// Share of the accuracy target below which pointing errors are left out.
pub const POINTING_SHARE: f64 = 0.01;

/// The inputs of an engine.
pub struct Inputs {
    /// The cones.
    pub retina: Retina,
    /// Screen and retina.
    pub projection: Projection,
    /// Light that enters the pupil from each point of the screen.
    pub beams: BeamField,
    /// Window and grid.
    pub scene: Scene,
    /// Whether this is the first result tile: it accounts for the light of the whole screen.
    pub first_tile: bool,
    /// Number of the result tile, of how many.
    pub tile: [u32; 2],
    /// Pointing factors of cones; none where they are left out.
    pub pointing: Option<Pointing>,
    /// Kernels and light.
    pub primaries: Primaries,
}

impl Inputs {
    /// Reads cones and kernels and prepares the rest from the experiment.
    ///
    /// # Errors
    /// When an artifact is damaged or the experiment cannot be served.
    pub fn read(experiment: &Experiment, artifacts: &[impl AsRef<[u8]>]) -> Result<Self, ExposureError> {
        let model = ExposureError::Model;
        let [cones, kernels] = artifacts else {
            let given = artifacts.len();
            return Err(model(format!("a shard needs its cones and kernels, not {given} artifacts")));
        };
        // Read the artifacts.
        let retina = Retina::from_bytes(cones.as_ref())
            .map_err(|e| ExposureError::Artifact("cones", e.to_string()))?;
        let kernels =
            Kernels::from_bytes(kernels.as_ref()).map_err(|e| ExposureError::Artifact("kernels", e))?;
        // Lay out the scene of the tile.
        let setup = setup(experiment).map_err(|e| model(e.to_string()))?;
        let [min, max] = kernels.spec().field_um;
        let tile = RegionUm { min, max };
        let scene = setup.scene(experiment, &tile).map_err(|e| model(e.to_string()))?;
        let number = setup.tiles.iter().position(|one| *one == tile).unwrap_or(0);
        let (first_tile, tiles) = (setup.tiles.first() == Some(&tile), [number, setup.tiles.len()]);
        let pointing = pointing_of(experiment, &setup).map_err(|e| model(e.to_string()))?;
        let gaze = setup.gaze_of(&tile).map_err(|e| model(e.to_string()))?;
        let Setup { projection, .. } = setup;
        let eye = &experiment.eye;
        let beams = BeamField::new(&projection).map_err(|e| model(e.to_string()))?;
        let pointing = (!small_pointing(experiment, &pointing)).then_some(pointing);
        // Prepare the light.
        let display = experiment.display.clone();
        let projector = Projector {
            emitters: emitters(&display).map_err(model)?,
            pupil_share: pupil_share(&display, eye.pupil_mm),
            first_shown: FirstShown::default(),
            timeless: gaze.is_still() && Rule::StillEye.applies(experiment),
            gaze,
            display,
        };
        Ok(Self {
            retina,
            projection,
            beams,
            scene,
            first_tile,
            tile: tiles.map(|n| n as u32),
            pointing,
            primaries: Primaries { kernels, projector },
        })
    }
}

/// Share of the accuracy target below which what the eye's turn changes inside a tile is left out. It is the most that
/// fine squares at the tile's corner change in any frame; the mean over the tile and the frames is less.
const TURNING_SHARE: f64 = 0.5;

impl Inputs {
    /// How the tile's cones see the screen as the eye turns; `None` where that changes nothing that counts.
    pub fn turning(&self, experiment: &Experiment) -> Option<Turning> {
        let Projector { display, gaze, .. } = &self.primaries.projector;
        let of_tile = (gaze, display.emission_law);
        let frames = [f64::from(experiment.frames), display.frame_rate_hz];
        let turning = Turning::new(&self.projection, &self.scene, of_tile, frames)?;
        turning.if_noticeable(self.scene.band, TURNING_SHARE * experiment.accuracy_target)
    }
}

/// Largest effect of pointing errors on a mean: that of a cone three standard deviations off, or of one without error.
pub fn pointing_effect(experiment: &Experiment, pointing: &Pointing) -> f64 {
    let far = 3.0 * experiment.eye.pointing_sd_deg.to_radians();
    [0.0, far].map(|radians| (pointing.factor(radians) - 1.0).abs()).into_iter().fold(0.0, f64::max)
}

/// Whether pointing errors change less than a hundredth of the target.
fn small_pointing(experiment: &Experiment, pointing: &Pointing) -> bool {
    Rule::Pointing.applies(experiment)
        && pointing_effect(experiment, pointing) < POINTING_SHARE * experiment.accuracy_target
}

/// The factor of an experiment's cones.
///
/// # Errors
/// A pointing error that is wider than the population's law.
pub fn pointing_of(experiment: &Experiment, setup: &Setup) -> Result<Pointing, RangeError> {
    let eye = &experiment.eye;
    let spec = PointingSpec {
        rho10_per_mm2: eye.stiles_crawford_rho10_per_mm2,
        sd_rad: eye.pointing_sd_deg.to_radians(),
        law: eye.pointing_law,
        pupil_mm: eye.pupil_mm,
        mm_per_radian: mm_per_radian(&setup.projection, &setup.prescription),
    };
    Pointing::new(&spec).map_err(|most| {
        let allowed = format!(
            "0 to {:.2}: the law with this rho is of a population, pointing errors included",
            (100.0 * most.to_degrees()).floor() / 100.0
        );
        RangeError::new("eye.stiles_crawford.perturbation_deg", eye.pointing_sd_deg, &allowed)
    })
}

/// Distance in the entrance pupil per angle at the cone, mm/rad: the posterior focal length n'/P, paraxially.
fn mm_per_radian(projection: &Projection, prescription: &Prescription) -> f64 {
    let nm = prescription.reference_wavelength_nm;
    let eye = projection.eye();
    1e3 * eye.indices(nm)[4] / eye.cardinal(nm).power_d
}
