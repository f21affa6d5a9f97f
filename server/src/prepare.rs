//! From a message to a validated experiment and its plan. Both take milliseconds, so they are made on threads that may block,
//! once for all who ask for the same; the seed of the counts changes neither and is put in afterwards.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use photoneye_eye::experiment::{Experiment, Movement};
use photoneye_eye::plan::{Machine, Plan, PlanError};
use photoneye_proto::v1;
use prost::Message as _;
use tokio::sync::OnceCell;

use crate::access::Caller;
use crate::admit::to_json;
use crate::error::{Error, Kind};
use crate::jobs::NewArtifact;
use crate::service::Service;
use crate::spec;

/// Experiments and plans kept.
const KEPT: usize = 64;

/// A validated experiment with its plan.
pub struct Prepared {
    /// The plan of this experiment, whatever its seed.
    pub planned: Arc<Planned>,
    /// Digest of the experiment.
    pub digest: String,
    /// The experiment, the model's own JSON.
    pub experiment_json: String,
    /// The experiment as it was asked for, with the seeds that it takes.
    pub spec: v1::Experiment,
    /// What the uploads are warned of.
    pub warnings: Vec<String>,
    /// `accuracy.target`.
    pub accuracy_target: f64,
}

/// What is to be done for an experiment.
pub struct Planned {
    /// The plan.
    pub plan: Plan,
    /// Number of frames.
    pub frames: u32,
    /// What is built for it.
    pub artifacts: Vec<NewArtifact>,
    /// Predicted work of one shard, microseconds.
    pub shard_us: u64,
}

type Slot<T> = Arc<OnceCell<Arc<T>>>;

/// What was made last, by the hash of what it was made from; who asks while it is being made waits for it.
struct Recent<T> {
    kept: Mutex<VecDeque<(blake3::Hash, Slot<T>)>>,
}

impl<T> Default for Recent<T> {
    fn default() -> Self {
        Self { kept: Mutex::default() }
    }
}

impl<T: Send + Sync + 'static> Recent<T> {
    /// Takes it, or makes it on a thread that may block. An error is not kept.
    async fn get(
        &self,
        key: blake3::Hash,
        make: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<Arc<T>, Error> {
        let cell = {
            let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
            let place = kept.iter().position(|(name, _)| *name == key);
            let entry = place.and_then(|place| kept.remove(place)).unwrap_or_else(|| (key, Arc::default()));
            let cell = Arc::clone(&entry.1);
            kept.push_back(entry);
            if kept.len() > KEPT {
                kept.pop_front();
            }
            cell
        };
        let made = cell.get_or_try_init(|| async { Ok(Arc::new(tokio::task::spawn_blocking(make).await??)) });
        made.await.cloned()
    }
}

/// The last experiments by their message, and their plans.
#[derive(Default)]
pub struct Plans {
    read: Recent<Experiment>,
    planned: Recent<Planned>,
}

impl Service {
    /// The one way from a message to an experiment and its plan.
    ///
    /// # Errors
    /// The first field that does not fit.
    pub(crate) async fn prepare(&self, caller: &Caller, message: &v1::Experiment) -> Result<Prepared, Error> {
        let mut bare = message.clone();
        let seed = bare.counts.as_mut().and_then(|counts| counts.seed.take());
        let key = blake3::hash(&bare.encode_to_vec());
        let frames_said = bare.frames.is_some_and(|frames| frames.count.is_some());
        let recording = self.read_recording(caller, &mut bare).await?;
        let read = self.plans.read.get(key, move || Ok(spec::experiment(&bare)?)).await?;
        let (film, warnings) = self.check_pictures(caller, &read.video, &read.display).await?;
        self.check_mosaic(caller, &read.retina).await?;
        let mut experiment = Experiment::clone(&read);
        if let Some(frames) = film.filter(|_| !frames_said) {
            experiment.frames = frames;
            spec::recording_covers(message.gaze.as_ref(), &experiment)?;
        }
        let key = blake3::hash(&[&key.as_bytes()[..], &experiment.frames.to_le_bytes()].concat());
        let bare = experiment.clone();
        let speed = self.speed;
        let planned = self.plans.planned.get(key, move || planned(&bare, &speed)).await?;
        experiment.counts.seed = seed.unwrap_or(experiment.counts.seed);
        let digest = experiment.digest().map_err(|error| Error::new(Kind::Internal, error.to_string()))?;
        let accuracy_target = experiment.accuracy_target;
        let spec = with_seeds(message.clone(), &experiment);
        if let Some(table) = recording {
            // What is stored and sent to workers names the table; they read it.
            experiment.gaze.movement = Movement::Recording(table);
        }
        Ok(Prepared {
            planned,
            digest: digest.to_string(),
            experiment_json: to_json(&experiment)?,
            warnings,
            spec,
            accuracy_target,
        })
    }
}

/// The message with the seeds of the experiment that was read from it.
fn with_seeds(mut message: v1::Experiment, experiment: &Experiment) -> v1::Experiment {
    message.counts.get_or_insert_default().seed = Some(experiment.counts.seed);
    if let Some(movement) = message.gaze.as_mut().and_then(|gaze| gaze.movement.as_mut()) {
        movement.seed = Some(experiment.gaze.seed);
    }
    message
}

/// Plans an experiment; takes milliseconds.
fn planned(experiment: &Experiment, speed: &Machine) -> Result<Planned, Error> {
    let plan = photoneye_eye::plan::plan_on(experiment, speed).map_err(|error| match error {
        PlanError::Range(error) => Error::from(spec::field_error(error)),
        PlanError::Model(message) => Error::new(Kind::Invalid, message),
    })?;
    let artifacts = plan.artifacts.iter().map(|artifact| {
        Ok(NewArtifact {
            key: artifact.key.to_string(),
            kind: artifact.spec.kind().to_owned(),
            spec_json: to_json(&artifact.spec)?.into(),
            inputs: artifact.inputs.iter().map(ToString::to_string).collect(),
            predicted_us: micros(artifact.predicted_seconds),
        })
    });
    let artifacts = artifacts.collect::<Result<_, Error>>()?;
    let built: f64 = plan.artifacts.iter().map(|artifact| artifact.predicted_seconds).sum();
    Ok(Planned {
        frames: experiment.frames,
        shard_us: micros((plan.predicted_seconds - built) / (plan.shards.len() as f64).max(1.0)),
        artifacts,
        plan,
    })
}

fn micros(seconds: f64) -> u64 {
    (seconds * 1e6).clamp(1.0, 1e18) as u64
}
