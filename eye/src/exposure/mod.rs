//! Counting (§22): from a scene's cones and kernels to counts per cone and frame.
//!
//! `expected` computes the exact mean of every cone and draws a Poisson number; `events` draws the photons that could count; `paper` follows every photon as §22 is written and
//! is the slow reference.

mod arriving;
pub mod audit;
mod basis;
mod budget;
mod codec;
mod cones;
mod density;
mod drive;
mod events;
mod expected;
pub(crate) mod field;
mod gather;
mod grid;
mod images;
pub(crate) mod inputs;
mod kernel;
mod light;
mod lowrank;
pub(crate) mod nodes;
pub(crate) mod padua;
mod paper;
mod picture_spectrum;
mod pixel_light;
mod poisson;
mod polar;
mod scan;
pub mod scene;
mod source;
pub mod spectral;
mod spread;
pub mod stray;
mod tail;
pub(crate) mod transfer;

use std::sync::OnceLock;

use glam::DVec2;
use rayon::prelude::*;

pub use audit::AuditSample;
pub use cones::{ConeColumns, cone_columns};
pub use kernel::{BLOCK as TRANSFER_BLOCK, KernelSpec, Kernels, TABLE_TOLERANCE};
pub use polar::PolarShape;
pub use scan::SCAN_BLUR;

use crate::experiment::{Engine, Experiment, Video};
use crate::optics::Projection;
use crate::plan::{Numerics, Rule};
use crate::report::PhotonBudget;
use crate::retina::Retina;
use crate::video::{Picture, draw};
use budget::Ledger;
use cones::ConeTable;
use events::Events;
use expected::{Expected, Means};
use inputs::Inputs;
use light::{Shown, history};
use paper::Paper;
use source::{Projector, Source};

/// Counts of one frame, in the order of the cones.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameCounts {
    /// Poisson draws.
    Counts(Vec<u32>),
    /// Means.
    Means(Vec<f32>),
}

/// One counted photon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photon {
    /// When it left the screen, s from the start of the recording.
    pub time_s: f64,
    /// Wavelength, nm: one of the samples of the primary's spectrum.
    pub wavelength_nm: f32,
    /// Its cone: place in the order of the cones.
    pub cone: u32,
}

/// One computed frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Counts by cone.
    pub counts: FrameCounts,
    /// Photon fates.
    pub budget: PhotonBudget,
    /// Rare events.
    pub diagnostics: Vec<(String, u64)>,
    /// The counted photons in order of time, when they are asked for.
    pub photons: Option<Vec<Photon>>,
}

/// Why a frame cannot be computed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ExposureError {
    /// An artifact is damaged.
    #[error("artifact {0} is damaged: {1}")]
    Artifact(&'static str, String),
    /// The model refuses.
    #[error("{0}")]
    Model(String),
    /// A picture does not fit the display.
    #[error("video: the picture is {0}x{1} pixels, the display {2}x{3}")]
    PictureSize(u32, u32, u32, u32),
}

/// An engine: how the photons of a prepared scene are counted.
trait Counter: Send + Sync {
    /// Counts one frame.
    fn frame(&self, exposure: &Exposure, shown: &Shown) -> Result<Frame, ExposureError>;

    /// The means by cone, light only, that the counts of a frame are drawn from; `None` where they are not known.
    fn means(&self, exposure: &Exposure, shown: &Shown) -> Option<Vec<f64>>;
}

impl Counter for Expected {
    fn frame(&self, exposure: &Exposure, shown: &Shown) -> Result<Frame, ExposureError> {
        let source = exposure.projector.frame(shown, &exposure.scene);
        let means = exposure.means(self, shown, &source);
        Ok(exposure.expected_frame((shown, Some(&source)), &means))
    }

    fn means(&self, exposure: &Exposure, shown: &Shown) -> Option<Vec<f64>> {
        let source = exposure.projector.frame(shown, &exposure.scene);
        Some(exposure.means(self, shown, &source).isomerized)
    }
}

impl Counter for Events {
    fn frame(&self, exposure: &Exposure, shown: &Shown) -> Result<Frame, ExposureError> {
        let drawn = Self::frame(self, shown, &exposure.projector).map_err(ExposureError::Model)?;
        let (ledger, cones) = (&exposure.ledger, &exposure.cones);
        let budget = ledger.budget(&exposure.projector, (shown, None), cones, &drawn.means);
        let diagnostics = vec![("photons drawn".to_owned(), drawn.photons)];
        let frame = exposure.drawn_frame(shown.index, drawn.counts, budget);
        Ok(Frame { diagnostics, photons: drawn.list, ..frame })
    }

    fn means(&self, _: &Exposure, _: &Shown) -> Option<Vec<f64>> {
        None
    }
}

impl Counter for Paper {
    fn frame(&self, exposure: &Exposure, shown: &Shown) -> Result<Frame, ExposureError> {
        let (counts, fates) = Self::frame(self, shown, &exposure.projector);
        Ok(exposure.drawn_frame(shown.index, counts, fates))
    }

    fn means(&self, _: &Exposure, _: &Shown) -> Option<Vec<f64>> {
        None
    }
}

/// A scene that is ready to be counted, frame by frame.
pub struct Exposure {
    experiment: Experiment,
    projector: Projector,
    scene: scene::Scene,
    cones: ConeTable,
    retina: Retina,
    projection: Projection,
    /// Number of the result tile, of how many.
    tile: [u32; 2],
    ledger: Ledger,
    counter: Box<dyn Counter>,
    tail: Option<tail::Tail>,
    veil: Option<stray::Veil>,
    pattern: Option<Picture>,
    /// Light and means of the frame that was computed first.
    first: OnceLock<(Source, Means)>,
}

impl Exposure {
    /// Prepares a scene: `artifacts` are the bytes of the cones and of the kernels of a result tile, in the order of
    /// `Plan::tile_artifacts`.
    ///
    /// # Errors
    /// When an artifact's bytes are damaged or do not belong to the experiment.
    pub fn new(experiment: &Experiment, artifacts: &[impl AsRef<[u8]>]) -> Result<Self, ExposureError> {
        let inputs = Inputs::read(experiment, artifacts)?;
        let model = ExposureError::Model;
        let cones = ConeTable::new(&inputs, experiment.display.emission_law).map_err(model)?;
        let ledger = Ledger::new(&inputs, experiment.gaze.center_px).map_err(model)?;
        let engine = experiment.counts.engine;
        let counter: Box<dyn Counter> = match engine {
            Engine::Expected => Box::new(Expected::new(&inputs, &cones, &Numerics::new(experiment))),
            Engine::Events => Box::new(Events::new(experiment, &inputs, &cones).map_err(model)?),
            Engine::Paper => Box::new(Paper::new(experiment, &inputs).map_err(model)?),
        };
        let veil = experiment.eye.stray_light.map(|light| stray::Veil::new(&inputs, &cones, light));
        let tail = (engine == Engine::Expected).then(|| tail::Tail::new(&inputs, &cones)).flatten();
        let Inputs { retina, projection, projector, scene, tile, .. } = inputs;
        let pattern = match &experiment.video {
            Video::Pattern(pattern) => Some(draw(pattern, &projector.display, &experiment.gaze)),
            Video::Clip(_) => None,
        };
        Ok(Self {
            experiment: experiment.clone(),
            projector,
            scene,
            cones,
            retina,
            projection,
            tile,
            ledger,
            counter,
            tail,
            veil,
            pattern,
            first: OnceLock::new(),
        })
    }

    /// Number of cones.
    pub fn len(&self) -> usize {
        self.retina.len()
    }

    /// Whether the patch has no cones.
    pub fn is_empty(&self) -> bool {
        self.retina.is_empty()
    }

    /// Stable number of each cone.
    pub fn cone_ids(&self) -> &[u64] {
        &self.retina.id
    }

    /// Type of each cone: 0 L, 1 M, 2 S.
    pub fn cone_types(&self) -> Vec<u8> {
        self.cones.cones.iter().map(|c| c.cone_type as u8).collect()
    }

    /// Computes frame `index`. `picture` is the frame's picture; a drawn pattern needs none.
    ///
    /// # Errors
    /// When the picture is missing or does not have the display's size.
    pub fn frame(&self, index: u32, picture: Option<&Picture>) -> Result<Frame, ExposureError> {
        self.frame_after(index, picture, &[])
    }

    /// Earlier pictures that change a frame, by lag or afterglow.
    pub fn history(&self) -> u32 {
        history(&self.projector.emitters, &self.projector.display)
    }

    /// As [`Exposure::frame`], after `earlier` pictures, the latest first ([`Exposure::history`] of them, or all there were);
    /// before the first picture of all the screen showed the same.
    ///
    /// # Errors
    /// When a picture is missing or does not have the display's size.
    pub fn frame_after(
        &self,
        index: u32,
        picture: Option<&Picture>,
        earlier: &[&Picture],
    ) -> Result<Frame, ExposureError> {
        let shown = self.shown(index, picture, earlier)?;
        self.counter.frame(self, &shown)
    }

    /// What is shown, every picture of the display's size.
    fn shown<'a>(
        &'a self,
        index: u32,
        picture: Option<&'a Picture>,
        earlier: &[&'a Picture],
    ) -> Result<Shown<'a>, ExposureError> {
        let picture = picture
            .or(self.pattern.as_ref())
            .ok_or_else(|| ExposureError::Model(format!("video: frame {index} has no picture")))?;
        let shown = Shown::new(index, picture, earlier);
        let (width, height) = (self.projector.display.width_px, self.projector.display.height_px);
        match shown.pictures.iter().find(|p| (p.width, p.height) != (width, height)) {
            Some(wrong) => Err(ExposureError::PictureSize(wrong.width, wrong.height, width, height)),
            None => Ok(shown),
        }
    }

    /// Means of a frame; none are computed for a dark window, nor twice for a window that shows the same as in the first frame.
    fn means(&self, expected: &Expected, shown: &Shown, source: &Source) -> Means {
        let mut means = self.image(expected, source);
        if let Some(tail) = &self.tail {
            tail.correct(&mut means, (shown, source), &self.projector);
        }
        if let Some(veil) = &self.veil {
            veil.add(&mut means, shown, &self.projector);
        }
        means
    }

    fn image(&self, expected: &Expected, source: &Source) -> Means {
        if Rule::DarkTiles.applies(&self.experiment) && source.is_dark() {
            return Means { isomerized: vec![0.0; self.len()], arrived: 0.0, guided: 0.0, clamped: 0 };
        }
        if !Rule::RepeatedFrames.applies(&self.experiment) {
            return expected.frame(source);
        }
        if let Some((shown, means)) = self.first.get()
            && shown == source
        {
            return means.clone();
        }
        let means = expected.frame(source);
        if self.experiment.frames > 1 || self.experiment.audit_cones > 0 {
            // Whichever frame comes first: means depend on the light alone.
            self.first.get_or_init(|| (source.clone(), means.clone()));
        }
        means
    }

    /// Whether cones of a frame are to be computed again.
    pub fn is_audited(&self, index: u32) -> bool {
        !self.is_empty() && !audit::samples(&self.experiment, self.tile, index).is_empty()
    }

    /// Computes the cones of a frame's audit again; `frame` is what [`Exposure::frame_after`] gave. Most frames have none.
    ///
    /// # Errors
    /// When the picture is missing or a cone cannot be traced.
    pub fn audit(
        &self,
        index: u32,
        picture: Option<&Picture>,
        earlier: &[&Picture],
        frame: &Frame,
    ) -> Result<Vec<AuditSample>, ExposureError> {
        if !self.is_audited(index) {
            return Ok(Vec::new());
        }
        let audited = audit::Audited {
            experiment: &self.experiment,
            projection: &self.projection,
            projector: &self.projector,
            retina: &self.retina,
            table: &self.cones,
            tile: self.tile,
        };
        let shown = self.shown(index, picture, earlier)?;
        let values = match (self.counter.means(self, &shown), &frame.counts) {
            // Means, not the numbers drawn from them.
            (Some(means), _) => means,
            (None, FrameCounts::Counts(counts)) => {
                counts.iter().map(|c| f64::from(*c) - self.dark()).collect()
            }
            (None, FrameCounts::Means(means)) => means.iter().map(|m| f64::from(*m) - self.dark()).collect(),
        };
        audited.run(&shown, &values).map_err(ExposureError::Model)
    }

    /// Isomerizations of a cone without light in a frame, mean.
    fn dark(&self) -> f64 {
        self.experiment.retina.dark_isomerizations_per_s / self.projector.display.frame_rate_hz
    }

    /// Counts of photons, and those without light drawn on top.
    fn drawn_frame(&self, index: u32, mut counts: Vec<u32>, mut budget: PhotonBudget) -> Frame {
        let dark = self.dark();
        if dark > 0.0 {
            let seed = self.experiment.counts.seed;
            for (count, id) in counts.iter_mut().zip(&self.retina.id) {
                *count = count.saturating_add(poisson::draw(seed, index, *id, dark));
            }
            budget.dark = dark * self.retina.len() as f64;
        }
        Frame { counts: FrameCounts::Counts(counts), budget, diagnostics: Vec::new(), photons: None }
    }

    fn expected_frame(&self, (shown, source): (&Shown, Option<&Source>), means: &Means) -> Frame {
        let mut budget = self.ledger.budget(&self.projector, (shown, source), &self.cones, means);
        let dark = self.dark();
        budget.dark = dark * self.retina.len() as f64;
        let counts = if self.experiment.counts.poisson {
            let seed = self.experiment.counts.seed;
            let draw = |(mean, id): (&f64, &u64)| poisson::draw(seed, shown.index, *id, *mean + dark);
            FrameCounts::Counts(
                means.isomerized.par_iter().zip(&self.retina.id).with_min_len(1024).map(draw).collect(),
            )
        } else {
            FrameCounts::Means(means.isomerized.iter().map(|m| (*m + dark) as f32).collect())
        };
        let diagnostics = vec![("means clamped at 0".to_owned(), means.clamped)];
        Frame { counts, budget, diagnostics, photons: None }
    }
}

/// The smallest rectangle around points.
fn bounds(points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    points.fold((DVec2::MAX, DVec2::MIN), |(min, max), p| (min.min(p), max.max(p)))
}
