//! The typed, validated experiment: every default filled in, every number finite, in range and with its unit in its name.
//!
//! Whoever makes one (the server from the schema, a test by hand) calls [`Experiment::validate`]; everything behind it relies
//! on the ranges. Its serde form travels from server to worker; its digest is the digest of the postcard encoding.

use serde::{Deserialize, Serialize};

use crate::cone::directional::PointingLaw;
use crate::digest::{Digest, digest_of};
use crate::display::Display;
use crate::optics::{Dispersion, OpticsError, Prescription, Side};
use crate::plan::{Knobs, Rule};
use crate::retina::{
    Aperture, CellWalls, ConeType, DensityLaw, Dropout, Generator, OpticDisc, RetinaError, RetinaGeometry,
    RetinaParams,
};
use crate::video::{ClipFormat, FromFilm};

/// Version of the counts that an experiment gives; rises whenever the same experiment gives other counts.
pub const COUNTS_VERSION: u32 = 15;

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
    /// Cones of the result that are computed again by a slow direct sum.
    #[serde(default)]
    pub audit_cones: u32,
    /// Omissions that are not made.
    #[serde(default)]
    pub computed_anyway: Vec<Rule>,
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
    /// Factor on the density of the lens.
    pub lens_density_scale: f64,
    /// Factor on the density of the cornea.
    pub cornea_density_scale: f64,
    /// Stiles-Crawford coefficient as a base-10 exponent, 1/mm² of entrance pupil; 0 is off.
    pub stiles_crawford_rho10_per_mm2: f64,
    /// Standard deviation of a cone's pointing error, degrees, per axis.
    pub pointing_sd_deg: f64,
    /// Whose law the coefficient is: the population's or each cone's.
    pub pointing_law: PointingLaw,
    /// The eye's data when they are not those of the preset as they stand.
    pub prescription: Option<Box<Prescription>>,
    /// Whether the eye stays unaccommodated, whatever it looks at.
    pub relaxed: bool,
    /// Most that it accommodates, dioptres; `None`: what its law allows.
    #[serde(default)]
    pub amplitude_d: Option<f64>,
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
    /// Which part of a cell collects light.
    pub aperture: Aperture,
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
    /// Digest of an uploaded table of measured cones that takes the place of a grown mosaic.
    pub mosaic: Option<String>,
    /// Type of its cones that were not classified; `None`: they are refused.
    #[serde(default)]
    pub mosaic_type_unknown: Option<ConeType>,
    /// Isomerizations of a cone without light, 1/s.
    pub dark_isomerizations_per_s: f64,
    /// Retinal illuminance that the cones are adapted to, trolands; `None`: no pigment is bleached.
    pub bleaching_td: Option<f64>,
}

/// What is shown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Video {
    /// Uploaded pictures.
    Clip(Clip),
    /// A picture drawn on the spot.
    Pattern(Pattern),
}

/// Uploaded pictures: one picture a frame, or one film; the last picture stays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clip {
    /// Digests of the files.
    pub blobs: Vec<String>,
    /// What the files' bytes mean where they do not say so.
    pub format: ClipFormat,
    /// What the frames show of a film whose rate is not the display's; `None`: not said.
    #[serde(default)]
    pub from_film: Option<FromFilm>,
}

/// Where a size in visual degrees holds on the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SizesHold {
    /// At the gaze centre; everywhere else the pattern has the same size in pixels.
    #[default]
    AtGaze,
    /// Everywhere: coordinates are visual angles from the line of sight, along their directions.
    Everywhere,
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
        /// Where the frequency holds.
        #[serde(default)]
        sizes_hold: SizesHold,
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
    /// Vertical stripes whose frequency grows evenly from the left edge to the right one.
    Sweep {
        /// Cycles per visual degree at the left edge.
        from_cycles_per_degree: f64,
        /// Cycles per visual degree at the right edge.
        to_cycles_per_degree: f64,
        /// Michelson contrast.
        contrast: f64,
        /// Colour of the maxima: red, green, blue.
        rgb: [f64; 3],
        /// Where the frequencies hold.
        #[serde(default)]
        sizes_hold: SizesHold,
    },
    /// Rows of Sloan letters.
    SloanChart(SloanChart),
}

/// Rows of Sloan letters around the gaze centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SloanChart {
    /// Rows from the top.
    pub rows: Vec<ChartRow>,
    /// Colour of the paper: red, green, blue.
    pub paper_rgb: [f64; 3],
    /// Colour of the letters.
    pub ink_rgb: [f64; 3],
    /// When given, the chart is drawn twice: in the upper half of the screen, and in the lower half on this paper.
    pub lower_paper_rgb: Option<[f64; 3]>,
    /// Where the letters have their size.
    #[serde(default)]
    pub sizes_hold: SizesHold,
}

/// One row of letters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChartRow {
    /// Letters of CDHKNORSVZ and E.
    pub letters: String,
    /// Width of a stroke, a fifth of a letter's height, visual minutes.
    pub stroke_arcmin: f64,
}

/// Where the eye looks and how it moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gaze {
    /// Point of the display on the foveal centre at time 0, pixels from the left and from the top.
    pub center_px: [f64; 2],
    /// Eye movement.
    pub movement: Movement,
    /// Tremor on top of it.
    pub tremor: Option<Tremor>,
    /// Microsaccades on top of it.
    pub microsaccades: Option<Microsaccades>,
    /// Seed of everything random in the movement.
    pub seed: u64,
}

impl Gaze {
    /// An eye that rests on a point of the display (pixels).
    pub fn still(center_px: [f64; 2]) -> Self {
        Self { center_px, movement: Movement::Still, tremor: None, microsaccades: None, seed: 1 }
    }
}

/// Small fast trembling.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tremor {
    /// Root mean square per axis.
    pub rms_arcmin: f64,
    /// Lowest frequency.
    pub from_hz: f64,
    /// Highest frequency.
    pub to_hz: f64,
}

impl Default for Tremor {
    /// 0.3 arcmin between 30 and 100 Hz (§11).
    fn default() -> Self {
        Self { rms_arcmin: 0.3, from_hz: 30.0, to_hz: 100.0 }
    }
}

/// Small jumps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Microsaccades {
    /// Jumps per second.
    pub rate_hz: f64,
    /// Smallest jump.
    pub from_arcmin: f64,
    /// Largest jump.
    pub to_arcmin: f64,
    /// How long a jump takes.
    pub duration_ms: f64,
}

impl Default for Microsaccades {
    /// 10 arcmin to 1° in 25 ms (§11), 1.5 a second.
    fn default() -> Self {
        Self { rate_hz: 1.5, from_arcmin: 10.0, to_arcmin: 60.0, duration_ms: 25.0 }
    }
}

/// Eye movement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// A random walk after Mergenthaler & Engbert 2007.
    Walk {
        /// Visual angle of the walk's unit.
        unit_arcmin: f64,
    },
    /// A recorded path: time (s), x right and y up (arcmin), times increasing; linear between, constant outside.
    Recorded(Vec<[f64; 3]>),
    /// The same as the digest of an uploaded table, whose samples are to be read before anything is computed.
    Recording(String),
}

/// Engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Engine {
    /// The exact mean per cone.
    Expected,
    /// The paper's §22, photon by photon.
    Paper,
    /// Photon by photon, those that could count.
    Events,
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
    /// Whether the counted photons are listed.
    pub photon_list: bool,
    /// Spacing of wavelengths fixed by hand, nm.
    pub wavelength_step_nm: Option<f64>,
    /// Numerical settings fixed by hand.
    #[serde(default)]
    pub knobs: Knobs,
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
        self.gaze.validate()?;
        if let Some(step) = self.counts.wavelength_step_nm {
            check_range("counts.settings.wavelength_step_nm", step, 1.0, 20.0)?;
        }
        if self.counts.photon_list && self.counts.engine != Engine::Events {
            return Err(RangeError::new(
                "counts.photon_list",
                true,
                "false, or true with counts.engine EVENTS",
            ));
        }
        check_range("counts.settings.paper_rays", f64::from(self.counts.paper.rays), 16.0, 65536.0)?;
        check_range("counts.settings.paper_samples", f64::from(self.counts.paper.samples), 16.0, 512.0)?;
        check_range("counts.settings.paper_window_um", self.counts.paper.window_um, 5.0, 2000.0)?;
        check_range("counts.settings.paper_node_um", self.counts.paper.node_um, 10.0, 5000.0)?;
        self.counts.knobs.validate()?;
        check_range("accuracy.target", self.accuracy_target, 1e-5, 0.2)?;
        check_range("accuracy.audit_cones", f64::from(self.audit_cones), 0.0, 10_000.0)?;
        check_range("frames.count", f64::from(self.frames), 1.0, 100_000.0)
    }

    fn validate_video(&self) -> Result<(), RangeError> {
        match &self.video {
            Video::Clip(clip) => check_range("video.clip.blobs", clip.blobs.len() as f64, 1.0, 100_000.0),
            Video::Pattern(pattern) => pattern.validate([self.display.width_px, self.display.height_px]),
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

impl Eye {
    /// The data of the eye.
    ///
    /// # Errors
    /// [`OpticsError`] when there is no such preset.
    pub fn prescription(&self) -> Result<Prescription, OpticsError> {
        self.prescription.as_deref().map_or_else(|| Prescription::preset(&self.preset), |p| Ok(p.clone()))
    }

    fn validate(&self) -> Result<(), RangeError> {
        check_range("eye.pupil_mm", self.pupil_mm, 0.5, 9.0)?;
        check_range("eye.pupil_decentre_mm", self.decentre_mm, 0.0, 1.0)?;
        check_range("eye.focus.distance_cm", self.focus_distance_cm, 10.0, 1e9)?;
        check_range("eye.focus.wavelength_nm", self.focus_wavelength_nm, 390.0, 830.0)?;
        if let Some(amplitude_d) = self.amplitude_d {
            check_range("eye.focus.amplitude_d", amplitude_d, 0.0, 20.0)?;
        }
        check_range("eye.macular_peak_density", self.macular_peak_density, 0.0, 2.0)?;
        check_range("eye.lens_density_scale", self.lens_density_scale, 0.0, 5.0)?;
        check_range("eye.cornea_density_scale", self.cornea_density_scale, 0.0, 5.0)?;
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
            aperture: p.aperture,
            cone_ratio: p.cone_ratio,
            s_repulsion: p.s_repulsion,
            s_ramp_deg: p.s_ramp_deg,
            dropout: p.dropout,
            optic_disc: p.optic_disc.is_some(),
            region_deg: None,
            mosaic: None,
            mosaic_type_unknown: None,
            dark_isomerizations_per_s: 0.0,
            bleaching_td: None,
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
            aperture: self.aperture,
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
        let dark = self.dark_isomerizations_per_s;
        check_range("retina.dark_isomerizations_per_s", dark, 0.0, 1e6)?;
        if let Some(trolands) = self.bleaching_td {
            check_range("retina.bleaching.adaptation_td", trolands, 0.0, 1e10)?;
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
pub const MAX_REGION_DEG: f64 = 45.0;
