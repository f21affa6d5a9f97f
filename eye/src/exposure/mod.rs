//! Counting (§22): from a scene's cones and kernels to counts per cone and frame.
//!
//! `expected` computes the exact mean of every cone and draws a Poisson number; `events` draws the photons that could count; `paper` follows every photon as §22 is written and
//! is the slow reference.

mod around;
mod arriving;
pub mod audit;
mod basis;
mod budget;
mod codec;
mod cones;
mod drive;
mod events;
mod expected;
pub(crate) mod field;
mod gather;
mod grid;
mod images;
pub(crate) mod inputs;
mod kernel;
mod kernel_build;
mod light;
mod lowrank;
pub(crate) mod nodes;
pub(crate) mod padua;
pub(crate) mod paper;
mod picture_spectrum;
mod pixel_light;
mod poisson;
mod polar;
mod prepared;
pub(crate) mod primaries;
mod scan;
pub mod scene;
mod source;
pub mod spectral;
mod spread;
pub mod stray;
mod tail;
pub(crate) mod transfer;
pub(crate) mod turned;

use std::sync::OnceLock;

use glam::DVec2;

pub use audit::AuditSample;
pub use cones::{ConeColumns, cone_columns};
pub(crate) use events::NODE_UM as EVENTS_NODE_UM;
pub use expected::Memo;
pub use kernel::{KernelSpec, Kernels, TABLE_TOLERANCE};
pub use kernel_build::BLOCK as TRANSFER_BLOCK;
pub use polar::PolarShape;
pub use scan::SCAN_BLUR;

use crate::display::Emitter;
use crate::experiment::{Engine, Experiment, Video};
use crate::plan::Rule;
use crate::report::PhotonBudget;
use crate::video::{Picture, ScreenView, draw};
use cones::ConeTable;
use inputs::Inputs;
use light::Shown;
pub(crate) use light::history;
use prepared::Prepared;
use source::Projector;

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

/// A scene that is ready to be counted, frame by frame.
pub struct Exposure {
    experiment: Experiment,
    inputs: Inputs,
    cones: ConeTable,
    pattern: Option<Picture>,
    /// Whether some primaries are as good as one while the pictures are gray.
    joins: bool,
    /// For pictures in colour, or where no primaries join; and for gray ones.
    prepared: [OnceLock<Prepared>; 2],
}

/// Whether gray pictures have some primaries computed as one.
pub(crate) fn joins(experiment: &Experiment, emitters: &[Emitter]) -> bool {
    experiment.counts.engine != Engine::Paper
        && Rule::JoinedPrimaries.applies(experiment)
        && primaries::groups(emitters).len() < emitters.len()
}

impl Exposure {
    /// Prepares a scene: `artifacts` are the bytes of the cones and of the kernels of a result tile, in the order of
    /// `Plan::tile_artifacts`. What hangs on uploaded pictures being gray is prepared with the first ones, see
    /// [`Exposure::make_ready`].
    ///
    /// # Errors
    /// When an artifact's bytes are damaged or do not belong to the experiment.
    pub fn new(experiment: &Experiment, artifacts: &[impl AsRef<[u8]>]) -> Result<Self, ExposureError> {
        let inputs = Inputs::read(experiment, artifacts)?;
        let cones = ConeTable::new(&inputs).map_err(ExposureError::Model)?;
        let Projector { emitters, .. } = &inputs.primaries.projector;
        let pattern = match &experiment.video {
            Video::Pattern(pattern) => {
                let view = ScreenView::of(experiment).map_err(|e| ExposureError::Model(e.to_string()))?;
                Some(draw(pattern, &view))
            }
            Video::Clip(_) => None,
        };
        let joins = joins(experiment, emitters);
        let prepared = [OnceLock::new(), OnceLock::new()];
        let made = Self { experiment: experiment.clone(), inputs, cones, pattern, joins, prepared };
        if made.pattern.is_some() || !joins {
            made.prepared(&Shown { index: 0, pictures: Vec::new() })?;
        }
        Ok(made)
    }

    /// What counts the frames that show such pictures, all of them gray or some in colour.
    fn prepared(&self, shown: &Shown) -> Result<&Prepared, ExposureError> {
        let gray = || match &self.experiment.video {
            Video::Pattern(pattern) => pattern.is_gray(),
            Video::Clip(_) => shown.pictures.iter().all(|picture| picture.is_gray()),
        };
        let gray = self.joins && gray();
        let place = &self.prepared[usize::from(gray)];
        if let Some(made) = place.get() {
            return Ok(made);
        }
        // Not inside the lock's closure: it computes on all threads, and one of them may come here again.
        let made = Prepared::new(&self.experiment, &self.inputs, &self.cones, gray)?;
        Ok(place.get_or_init(|| made))
    }

    /// Prepares what [`Exposure::frame_after`] of the same pictures needs and would prepare itself, maybe on several threads at once. A drawn
    /// pattern is ready from the start.
    ///
    /// # Errors
    /// As [`Exposure::frame_after`].
    pub fn make_ready(
        &self,
        index: u32,
        picture: Option<&Picture>,
        earlier: &[&Picture],
    ) -> Result<(), ExposureError> {
        self.prepared(&self.shown(index, picture, earlier)?).map(|_| ())
    }

    /// Number of cones.
    pub fn len(&self) -> usize {
        self.inputs.retina.len()
    }

    /// Whether the patch has no cones.
    pub fn is_empty(&self) -> bool {
        self.inputs.retina.is_empty()
    }

    /// Stable number of each cone.
    pub fn cone_ids(&self) -> &[u64] {
        &self.inputs.retina.id
    }

    /// Type of each cone: 0 L, 1 M, 2 S; `None` of those at the rim of a measured mosaic or beside a gap.
    pub fn cone_types_inside(&self) -> Vec<Option<u8>> {
        self.cones.cones.iter().map(|cone| (!cone.edge).then_some(cone.cone_type as u8)).collect()
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
        let Projector { emitters, display, .. } = &self.inputs.primaries.projector;
        history(emitters, display)
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
        self.frame_going_on(index, (picture, earlier), &mut Memo::default())
    }

    /// As [`Exposure::frame_after`], with what was kept from the frame before: faster where the eye moves.
    ///
    /// # Errors
    /// As [`Exposure::frame_after`].
    pub fn frame_going_on(
        &self,
        index: u32,
        (picture, earlier): (Option<&Picture>, &[&Picture]),
        memo: &mut Memo,
    ) -> Result<Frame, ExposureError> {
        let shown = self.shown(index, picture, earlier)?;
        self.prepared(&shown)?.frame(self, &shown, memo)
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
        let (width, height) = (self.experiment.display.width_px, self.experiment.display.height_px);
        match shown.pictures.iter().find(|p| (p.width, p.height) != (width, height)) {
            Some(wrong) => Err(ExposureError::PictureSize(wrong.width, wrong.height, width, height)),
            None => Ok(shown),
        }
    }

    /// Whether cones of a frame are to be computed again.
    pub fn is_audited(&self, index: u32) -> bool {
        !self.is_empty() && !audit::samples(&self.experiment, self.inputs.tile, index).is_empty()
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
            projection: &self.inputs.projection,
            beams: &self.inputs.beams,
            projector: &self.inputs.primaries.projector,
            retina: &self.inputs.retina,
            table: &self.cones,
            tile: self.inputs.tile,
        };
        let shown = self.shown(index, picture, earlier)?;
        let values = match (self.prepared(&shown)?.means(self, &shown), &frame.counts) {
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
        self.experiment.retina.dark_isomerizations_per_s / self.experiment.display.frame_rate_hz
    }
}

/// The smallest rectangle around points.
fn bounds(points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    points.fold((DVec2::MAX, DVec2::MIN), |(min, max), p| (min.min(p), max.max(p)))
}
