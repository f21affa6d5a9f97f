//! The typed, validated experiment: every default filled in, every number finite, in range and with its unit in its name.
//!
//! Whoever makes one (the server from the schema, a test by hand) calls [`Experiment::validate`]; everything behind it relies
//! on the ranges. Its serde form travels from server to worker; its digest is the digest of the postcard encoding.

use serde::{Deserialize, Serialize};

use crate::digest::{Digest, digest_of};
use crate::display::Display;
use crate::optics::{Dispersion, Side};
use crate::retina::{
    CellWalls, DensityLaw, Dropout, Generator, OpticDisc, RetinaError, RetinaGeometry, RetinaParams,
};

/// Version of the counts that an experiment gives; rises whenever the same experiment gives other counts.
pub const COUNTS_VERSION: u32 = 3;

/// What a user asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// The optics.
    pub eye: Eye,
    /// The cone mosaic.
    pub retina: Retina,
    /// The screen.
    pub display: Display,
    /// What is shown.
    pub video: Video,
    /// Where the eye looks.
    pub gaze: Gaze,
    /// How counts are made.
    pub counts: Counts,
    /// Relative error of the mean per cone, L1 over cones.
    pub accuracy_target: f64,
    /// Number of frames, 1 to 100 000.
    pub frames: u32,
}

/// The optics of the eye.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Eye {
    /// Name of the prescription in data/eyes.
    pub preset: String,
    /// Which eye.
    pub side: Side,
    /// Entrance pupil diameter, mm.
    pub pupil_mm: f64,
    /// Decentre of the stop, mm.
    pub decentre_mm: f64,
    /// Distance in focus from the corneal apex, cm.
    pub focus_distance_cm: f64,
    /// Wavelength in focus, nm.
    pub focus_wavelength_nm: f64,
    /// Law of the refractive indices.
    pub dispersion: Dispersion,
    /// Peak density (log10) of the macular pigment in the foveal centre.
    pub macular_peak_density: f64,
    /// Factor on the density of cornea and lens.
    pub lens_density_scale: f64,
    /// Stiles-Crawford coefficient as a base-10 exponent, 1/mm² of entrance pupil; 0 is off.
    pub stiles_crawford_rho10_per_mm2: f64,
    /// Standard deviation of a cone's pointing error, degrees, per axis.
    pub pointing_sd_deg: f64,
    /// Whether reflections at the surfaces are computed instead of the cornea's flat density.
    pub reflection_losses: bool,
    /// Light scattered in the eye; `None` leaves it out.
    pub stray_light: Option<StrayLight>,
}

/// What decides the light scattered in the eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StrayLight {
    /// Age, years.
    pub age_years: f64,
    /// Pigmentation of the eye: 0 black, 0.5 brown, 1 green, 1.2 light blue.
    pub pigmentation: f64,
}

/// The cone mosaic.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Retina {
    /// Seed of positions, types and pointing errors.
    pub seed: u64,
    /// How the mosaic grows.
    pub generator: Generator,
    /// Peak density on Curcio's scale, 1/mm².
    pub peak_density_per_mm2: f64,
    /// The law of density.
    pub density: DensityLaw,
    /// Cones of the whole retina; `None`: what the law gives.
    pub total_cones: Option<f64>,
    /// Relaxation sub-cycles everywhere; `None`: as living mosaics ask for.
    pub cycles: Option<u32>,
    /// How cells are formed.
    pub cell_walls: CellWalls,
    /// Shares of L, M, S outside the S-free centre; they sum to 1.
    pub cone_ratio: [f64; 3],
    /// Hard core of S cones in their mean spacings.
    pub s_repulsion: f64,
    /// Where S cones begin and where they have their full share, visual degrees.
    pub s_ramp_deg: [f64; 2],
    /// Cones lost at random.
    pub dropout: Option<Dropout>,
    /// Whether the optic disc is a hole.
    pub optic_disc: bool,
    /// A fixed patch, visual degrees x_min, x_max, y_min, y_max; `None`: the scene decides.
    pub region_deg: Option<[f64; 4]>,
}

/// What is shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Video {
    /// Digests of PNG pictures of the display's size, a frame each; the last one stays.
    Clip(Vec<String>),
    /// A picture drawn on the spot.
    Pattern(Pattern),
}

/// Drawn pictures. Pixel values are display inputs 0 to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Pattern {
    /// One colour everywhere.
    Uniform {
        /// Red, green, blue.
        rgb: [f64; 3],
    },
    /// A sine grating in light around half of white.
    Grating {
        /// Cycles per visual degree at the gaze centre.
        cycles_per_degree: f64,
        /// Michelson contrast.
        contrast: f64,
        /// 0: vertical stripes; counter-clockwise.
        orientation_deg: f64,
        /// 0: a maximum at the gaze centre.
        phase_deg: f64,
    },
    /// Black and white squares, white at the top left.
    Checkerboard {
        /// Side of a square, pixels.
        square_px: u32,
    },
    /// One lit pixel on black.
    Point {
        /// Column and row.
        at_px: [u32; 2],
        /// Red, green, blue.
        rgb: [f64; 3],
    },
}

/// Where the eye looks and how it moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gaze {
    /// Point of the display on the foveal centre at time 0, pixels from the left and from the top.
    pub center_px: [f64; 2],
    /// Eye movement.
    pub movement: Movement,
}

/// Eye movement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Movement {
    /// None.
    Still,
    /// A steady drift of the line of sight.
    Drift {
        /// Speed in the visual field.
        speed_arcmin_per_s: f64,
        /// 0 right, 90 up.
        direction_deg: f64,
    },
}

/// Engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Engine {
    /// The exact mean per cone.
    Expected,
    /// The paper's §22, photon by photon.
    Paper,
}

/// How counts are made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// The engine.
    pub engine: Engine,
    /// Whether counts are drawn (Poisson) or means given.
    pub poisson: bool,
    /// Seed of the photon noise.
    pub seed: u64,
    /// Spacing of wavelengths fixed by hand, nm.
    pub wavelength_step_nm: Option<f64>,
    /// Settings of the `paper` engine.
    pub paper: PaperSettings,
}

/// Settings of the `paper` engine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperSettings {
    /// Rays per point spread.
    pub rays: u32,
    /// Samples across a point spread.
    pub samples: u32,
    /// Least width of the point spread's window, µm.
    pub window_um: f64,
    /// Spacing of the point spreads on the retina, µm.
    pub node_um: f64,
}

impl Default for PaperSettings {
    fn default() -> Self {
        Self { rays: 1024, samples: 128, window_um: 20.0, node_um: 300.0 }
    }
}

/// A value outside its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {value} is out of range, allowed is {allowed}")]
pub struct RangeError {
    /// Path of the field in the schema, for example `eye.pupil_mm`.
    pub field: String,
    /// The value.
    pub value: String,
    /// The allowed range, for people.
    pub allowed: String,
}

impl RangeError {
    /// An error for `field`.
    pub fn new(field: &str, value: impl ToString, allowed: &str) -> Self {
        Self { field: field.into(), value: value.to_string(), allowed: allowed.into() }
    }
}

/// Checks that a number is finite and in `min..=max`.
///
/// # Errors
/// [`RangeError`] with the field, the value and the range.
pub fn check_range(field: &str, value: f64, min: f64, max: f64) -> Result<(), RangeError> {
    if value.is_finite() && value >= min && value <= max {
        return Ok(());
    }
    Err(RangeError::new(field, value, &format!("{min} to {max}")))
}

impl Experiment {
    /// Checks every range. Field names are those of the schema.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), RangeError> {
        self.eye.validate()?;
        self.retina.validate()?;
        self.display.validate()?;
        self.validate_video()?;
        for (axis, value) in ["gaze.center_px[0]", "gaze.center_px[1]"].iter().zip(self.gaze.center_px) {
            check_range(axis, value, -4096.0, 8192.0)?;
        }
        if let Movement::Drift { speed_arcmin_per_s, direction_deg } = self.gaze.movement {
            check_range("gaze.movement.drift.speed_arcmin_per_s", speed_arcmin_per_s, 0.0, 60000.0)?;
            check_range("gaze.movement.drift.direction_deg", direction_deg, -360.0, 360.0)?;
        }
        if let Some(step) = self.counts.wavelength_step_nm {
            check_range("counts.settings.wavelength_step_nm", step, 1.0, 20.0)?;
        }
        check_range("counts.settings.paper_rays", f64::from(self.counts.paper.rays), 16.0, 65536.0)?;
        check_range("counts.settings.paper_samples", f64::from(self.counts.paper.samples), 16.0, 512.0)?;
        check_range("counts.settings.paper_window_um", self.counts.paper.window_um, 5.0, 2000.0)?;
        check_range("counts.settings.paper_node_um", self.counts.paper.node_um, 10.0, 5000.0)?;
        check_range("accuracy.target", self.accuracy_target, 1e-5, 0.2)?;
        check_range("frames.count", f64::from(self.frames), 1.0, 100_000.0)
    }

    fn validate_video(&self) -> Result<(), RangeError> {
        match &self.video {
            Video::Clip(blobs) => check_range("video.clip.blobs", blobs.len() as f64, 1.0, 100_000.0),
            Video::Pattern(Pattern::Uniform { rgb }) => check_rgb("video.pattern.uniform.rgb", *rgb),
            Video::Pattern(Pattern::Grating { cycles_per_degree, contrast, orientation_deg, phase_deg }) => {
                check_range("video.pattern.grating.cycles_per_degree", *cycles_per_degree, 0.0, 1000.0)?;
                check_range("video.pattern.grating.contrast", *contrast, 0.0, 1.0)?;
                check_range("video.pattern.grating.orientation_deg", *orientation_deg, -360.0, 360.0)?;
                check_range("video.pattern.grating.phase_deg", *phase_deg, -360.0, 360.0)
            }
            Video::Pattern(Pattern::Checkerboard { square_px }) => {
                check_range("video.pattern.checkerboard.square_px", f64::from(*square_px), 1.0, 4096.0)
            }
            Video::Pattern(Pattern::Point { at_px, rgb }) => {
                let last = [self.display.width_px - 1, self.display.height_px - 1];
                for axis in 0..2 {
                    let field = format!("video.pattern.point.at_px[{axis}]");
                    check_range(&field, f64::from(at_px[axis]), 0.0, f64::from(last[axis]))?;
                }
                check_rgb("video.pattern.point.rgb", *rgb)
            }
        }
    }

    /// Digest of everything that decides the counts.
    ///
    /// # Errors
    /// Never for an experiment that was validated.
    pub fn digest(&self) -> Result<Digest, postcard::Error> {
        digest_of("experiment", COUNTS_VERSION, self)
    }
}

fn check_rgb(field: &str, rgb: [f64; 3]) -> Result<(), RangeError> {
    (0..3).try_for_each(|i| check_range(&format!("{field}[{i}]"), rgb[i], 0.0, 1.0))
}

impl Eye {
    fn validate(&self) -> Result<(), RangeError> {
        check_range("eye.pupil_mm", self.pupil_mm, 0.5, 9.0)?;
        check_range("eye.pupil_decentre_mm", self.decentre_mm, 0.0, 1.0)?;
        check_range("eye.focus.distance_cm", self.focus_distance_cm, 10.0, 1e9)?;
        check_range("eye.focus.wavelength_nm", self.focus_wavelength_nm, 390.0, 830.0)?;
        check_range("eye.macular_peak_density", self.macular_peak_density, 0.0, 2.0)?;
        check_range("eye.lens_density_scale", self.lens_density_scale, 0.0, 5.0)?;
        check_range("eye.stiles_crawford.rho_per_mm2", self.stiles_crawford_rho10_per_mm2, 0.0, 0.2)?;
        if let Some(stray) = self.stray_light {
            check_range("eye.stray_light.age_years", stray.age_years, 1.0, 100.0)?;
            check_range("eye.stray_light.pigmentation", stray.pigmentation, 0.0, 1.2)?;
        }
        check_range("eye.stiles_crawford.perturbation_deg", self.pointing_sd_deg, 0.0, 5.0)
    }
}

impl Default for Retina {
    /// The mosaic of the defaults, its patch left to the scene.
    fn default() -> Self {
        let p = RetinaParams::default();
        Self {
            seed: p.seed,
            generator: p.generator,
            peak_density_per_mm2: p.peak_density_per_mm2,
            density: p.density,
            total_cones: p.total_cones,
            cycles: p.cycles,
            cell_walls: p.cell_walls,
            cone_ratio: p.cone_ratio,
            s_repulsion: p.s_repulsion,
            s_ramp_deg: p.s_ramp_deg,
            dropout: p.dropout,
            optic_disc: p.optic_disc.is_some(),
            region_deg: None,
        }
    }
}

impl Retina {
    /// The parameters of the mosaic in an eye of which the pointing error (degrees) and the geometry are given.
    pub fn params(&self, pointing_sd_deg: f64, geometry: RetinaGeometry) -> RetinaParams {
        RetinaParams {
            seed: self.seed,
            generator: self.generator,
            density: self.density,
            peak_density_per_mm2: self.peak_density_per_mm2,
            total_cones: self.total_cones,
            cycles: self.cycles,
            cell_walls: self.cell_walls,
            cone_ratio: self.cone_ratio,
            s_ramp_deg: self.s_ramp_deg,
            s_repulsion: self.s_repulsion,
            pointing_sd_deg,
            dropout: self.dropout,
            optic_disc: self.optic_disc.then(OpticDisc::default),
            geometry,
        }
    }

    fn validate(&self) -> Result<(), RangeError> {
        if let Err(RetinaError::Parameter { field, value, allowed }) =
            self.params(1.0, RetinaGeometry::default()).validate()
        {
            return Err(RangeError::new(&format!("retina.{field}"), value, allowed));
        }
        if let Some([x0, x1, y0, y1]) = self.region_deg {
            check_range("retina.region_deg.x_min", x0, -MAX_REGION_DEG, MAX_REGION_DEG)?;
            check_range("retina.region_deg.x_max", x1, x0 + 1e-4, MAX_REGION_DEG)?;
            check_range("retina.region_deg.y_min", y0, -MAX_REGION_DEG, MAX_REGION_DEG)?;
            check_range("retina.region_deg.y_max", y1, y0 + 1e-4, MAX_REGION_DEG)?;
        }
        Ok(())
    }
}

/// Widest field that is served now, visual degrees from the gaze centre.
pub const MAX_REGION_DEG: f64 = 30.0;
