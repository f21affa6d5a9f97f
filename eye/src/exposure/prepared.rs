//! What is made ready once for the frames of a scene: an engine with the ledger, the tail and the veil of the same primaries.

use std::sync::OnceLock;

use rayon::prelude::*;

use super::budget::Ledger;
use super::cones::ConeTable;
use super::events::Events;
use super::expected::{Expected, Means, Memo};
use super::inputs::Inputs;
use super::light::Shown;
use super::paper::Paper;
use super::source::{Projector, Source};
use super::stray::Veil;
use super::tail::{Looks, Tail};
use super::{Exposure, ExposureError, Frame, FrameCounts, poisson, primaries};
use crate::experiment::{Engine, Experiment};
use crate::plan::largest::LARGEST_COUNT;
use crate::plan::{Numerics, Rule};
use crate::report::PhotonBudget;

/// A frame that is asked for: its scene and what is shown.
type Asked<'a> = (&'a Exposure, &'a Shown<'a>);
/// A counted frame.
type Counted = Result<Frame, ExposureError>;

/// An engine: how the photons of a prepared scene are counted.
trait Counter: Send + Sync {
    /// Counts one frame.
    fn frame(&self, prepared: &Prepared, asked: Asked, memo: &mut Memo) -> Counted;

    /// The means by cone, light only, that the counts of a frame are drawn from; `None` where they are not known.
    fn means(&self, prepared: &Prepared, exposure: &Exposure, shown: &Shown) -> Option<Vec<f64>>;
}

impl Counter for Expected {
    fn frame(&self, prepared: &Prepared, (exposure, shown): Asked, memo: &mut Memo) -> Counted {
        let source = prepared.projector.frame(shown, &exposure.inputs.scene);
        let means = prepared.expected_means(exposure, self, (shown, &source), memo);
        if exposure.experiment.counts.poisson {
            fits(&means.isomerized, exposure.dark())?;
        }
        Ok(prepared.expected_frame(exposure, (shown, Some(&source)), &means))
    }

    fn means(&self, prepared: &Prepared, exposure: &Exposure, shown: &Shown) -> Option<Vec<f64>> {
        let source = prepared.projector.frame(shown, &exposure.inputs.scene);
        Some(prepared.expected_means(exposure, self, (shown, &source), &mut Memo::default()).isomerized)
    }
}

impl Counter for Events {
    fn frame(&self, prepared: &Prepared, (exposure, shown): Asked, _: &mut Memo) -> Counted {
        let drawn = Self::frame(self, shown, &prepared.projector).map_err(ExposureError::Model)?;
        let cones = &exposure.cones;
        let budget = prepared.ledger.budget(&prepared.projector, (shown, None), cones, &drawn.means);
        let diagnostics = vec![("photons drawn".to_owned(), drawn.photons)];
        let frame = drawn_frame(exposure, shown.index, drawn.counts, budget);
        Ok(Frame { diagnostics, photons: drawn.list, ..frame })
    }

    fn means(&self, _: &Prepared, _: &Exposure, _: &Shown) -> Option<Vec<f64>> {
        None
    }
}

impl Counter for Paper {
    fn frame(&self, prepared: &Prepared, (exposure, shown): Asked, _: &mut Memo) -> Counted {
        let (counts, fates) = Self::frame(self, shown, &prepared.projector);
        Ok(drawn_frame(exposure, shown.index, counts, fates))
    }

    fn means(&self, _: &Prepared, _: &Exposure, _: &Shown) -> Option<Vec<f64>> {
        None
    }
}

/// A scene's primaries, ready to be counted.
pub struct Prepared {
    projector: Projector,
    ledger: Ledger,
    counter: Box<dyn Counter>,
    tail: Option<Tail>,
    veil: Option<Veil>,
    /// Light and means of the frame that was computed first.
    first: OnceLock<(Source, Means)>,
}

impl Prepared {
    /// For pictures in colour, or for gray ones, before which some primaries are as good as one.
    ///
    /// # Errors
    /// When the embedded tables cannot be read or the engine refuses the scene.
    pub fn new(
        experiment: &Experiment,
        inputs: &Inputs,
        cones: &ConeTable,
        gray: bool,
    ) -> Result<Self, ExposureError> {
        let model = ExposureError::Model;
        let settings = Numerics::new(experiment);
        let tolerance = primaries::BASIS_SHARE * settings.basis_tolerance;
        let joined = if gray { inputs.primaries.together(tolerance) } else { None };
        let primaries = joined.as_ref().unwrap_or(&inputs.primaries);
        let scene = &inputs.scene;
        let ledger = Ledger::new(inputs, primaries, experiment.gaze.center_px).map_err(model)?;
        let engine = experiment.counts.engine;
        let counter: Box<dyn Counter> = match engine {
            Engine::Expected => {
                let turning = inputs.turning(experiment);
                Box::new(Expected::new(scene, primaries, (cones, turning), &settings))
            }
            Engine::Events => Box::new(Events::new(experiment, inputs, primaries, cones).map_err(model)?),
            Engine::Paper => Box::new(Paper::new(experiment, inputs, cones).map_err(model)?),
        };
        let stray = experiment.eye.stray_light.filter(|_| engine == Engine::Expected);
        let veil = stray.map(|light| Veil::new((experiment, inputs), primaries, cones, light));
        let veil = veil.transpose().map_err(model)?;
        let looks = if stray.is_some() { Looks::All } else { Looks::Few };
        let tail = || Tail::new(scene, primaries, cones, looks);
        let tail = (engine == Engine::Expected).then(tail).flatten();
        let projector = primaries.projector.clone();
        Ok(Self { projector, ledger, counter, tail, veil, first: OnceLock::new() })
    }

    /// Counts one frame.
    ///
    /// # Errors
    /// What the engine refuses.
    pub fn frame(&self, exposure: &Exposure, shown: &Shown, memo: &mut Memo) -> Result<Frame, ExposureError> {
        self.counter.frame(self, (exposure, shown), memo)
    }

    /// The means by cone, light only, that the counts of a frame are drawn from; `None` where they are not known.
    pub fn means(&self, exposure: &Exposure, shown: &Shown) -> Option<Vec<f64>> {
        self.counter.means(self, exposure, shown)
    }

    /// Means of a frame; none are computed for a dark window, nor twice for a window that shows the same as in the first frame.
    fn expected_means(
        &self,
        exposure: &Exposure,
        expected: &Expected,
        (shown, source): (&Shown, &Source),
        memo: &mut Memo,
    ) -> Means {
        let mut means = self.image(exposure, expected, (shown.index, source), memo);
        if let Some(tail) = &self.tail {
            tail.correct(&mut means, (shown, source), &self.projector);
        }
        if let Some(veil) = &self.veil {
            veil.add(&mut means, shown, &self.projector);
        }
        means.clamp();
        means
    }

    fn image(
        &self,
        exposure: &Exposure,
        expected: &Expected,
        (index, source): (u32, &Source),
        memo: &mut Memo,
    ) -> Means {
        if Rule::DarkTiles.applies(&exposure.experiment) && source.is_dark() {
            return Means { isomerized: vec![0.0; exposure.len()], arrived: 0.0, guided: 0.0, clamped: 0 };
        }
        if !Rule::RepeatedFrames.applies(&exposure.experiment) {
            return expected.frame(source, index, memo);
        }
        if let Some((shown, means)) = self.first.get()
            && shown == source
        {
            return means.clone();
        }
        let means = expected.frame(source, index, memo);
        if exposure.experiment.frames > 1 || exposure.experiment.audit_cones > 0 {
            // Whichever frame comes first: means depend on the light alone.
            self.first.get_or_init(|| (source.clone(), means.clone()));
        }
        means
    }

    fn expected_frame(
        &self,
        exposure: &Exposure,
        (shown, source): (&Shown, Option<&Source>),
        means: &Means,
    ) -> Frame {
        let mut budget = self.ledger.budget(&self.projector, (shown, source), &exposure.cones, means);
        let dark = exposure.dark();
        budget.dark = dark * exposure.inputs.retina.len() as f64;
        let counts = if exposure.experiment.counts.poisson {
            let seed = exposure.experiment.noise_seed();
            let draw = |(mean, id): (&f64, &u64)| poisson::draw(seed, shown.index, *id, *mean + dark);
            FrameCounts::Counts(
                means
                    .isomerized
                    .par_iter()
                    .zip(&exposure.inputs.retina.id)
                    .with_min_len(1024)
                    .map(draw)
                    .collect(),
            )
        } else {
            FrameCounts::Means(means.isomerized.iter().map(|m| (*m + dark) as f32).collect())
        };
        let diagnostics = vec![("means clamped at 0".to_owned(), means.clamped)];
        Frame { counts, budget, diagnostics, photons: None }
    }
}

/// Refuses means whose counts would not fit: ten standard deviations from the largest count.
fn fits(means: &[f64], dark: f64) -> Result<(), ExposureError> {
    let most = means.iter().copied().fold(0.0, f64::max) + dark;
    if most + 10.0 * most.sqrt() <= LARGEST_COUNT {
        return Ok(());
    }
    Err(ExposureError::Model(format!(
        "counts: a cone counts {most:.2e} photons in a frame, more than {LARGEST_COUNT}; take shorter frames, less \
         light or counts.noise NONE"
    )))
}

/// Counts of photons, and those without light drawn on top.
fn drawn_frame(exposure: &Exposure, index: u32, mut counts: Vec<u32>, mut budget: PhotonBudget) -> Frame {
    let dark = exposure.dark();
    if dark > 0.0 {
        let seed = exposure.experiment.noise_seed();
        for (count, id) in counts.iter_mut().zip(&exposure.inputs.retina.id) {
            *count = count.saturating_add(poisson::draw(seed, index, *id, dark));
        }
        budget.dark = dark * exposure.inputs.retina.len() as f64;
    }
    Frame { counts: FrameCounts::Counts(counts), budget, diagnostics: Vec::new(), photons: None }
}
