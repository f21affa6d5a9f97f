//! What both doors, REST and gRPC, do: one function for each request.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use futures::Stream;
use photoneye_eye::display::Display;
use photoneye_eye::experiment::{Experiment, Video};
use photoneye_eye::plan::{Plan, PlanError};
use photoneye_eye::video::{Limits as PictureLimits, clip_info};
use photoneye_proto::{FieldError, v1};
use photoneye_store::{BlobDigest, Blobs};

use crate::error::{Error, Kind};
use crate::jobs::{Command, Job, Machine, NewArtifact, NewJob, Reply, State};
use crate::{spec, view};

/// What the service accepts.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Jobs that are not finished.
    pub active_jobs: usize,
    /// Predicted memory of a job, bytes.
    pub job_bytes: f64,
    /// Predicted work of a job, CPU seconds.
    pub job_seconds: f64,
    /// One uploaded blob, bytes.
    pub blob_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { active_jobs: 1000, job_bytes: 64e9, job_seconds: 30.0 * 86400.0, blob_bytes: 4 << 30 }
    }
}

/// Events of one watcher, at most so often.
const EVENT_PAUSE: Duration = Duration::from_millis(100);

/// The service behind both doors.
pub struct Service {
    /// Jobs and leases.
    pub machine: Machine,
    /// Bytes.
    pub blobs: Arc<dyn Blobs>,
    /// What is accepted.
    pub limits: Limits,
}

impl Service {
    /// Calls the blob store on a thread that may block.
    ///
    /// # Errors
    /// What the store says.
    pub async fn with_blobs<T: Send + 'static>(
        &self,
        call: impl FnOnce(&dyn Blobs) -> Result<T, photoneye_store::StoreError> + Send + 'static,
    ) -> Result<T, Error> {
        let blobs = Arc::clone(&self.blobs);
        Ok(tokio::task::spawn_blocking(move || call(blobs.as_ref())).await??)
    }

    /// Explains an experiment.
    ///
    /// # Errors
    /// The first field that does not fit.
    pub async fn plan(&self, message: &v1::Experiment) -> Result<v1::PlanReply, Error> {
        let (experiment, plan) = self.prepare(message).await?;
        Ok(v1::PlanReply {
            plan: Some(self.view_plan(&plan).await),
            experiment_json: Some(to_json(&experiment)?),
        })
    }

    /// Accepts an experiment; the reply says whether the job is new.
    ///
    /// # Errors
    /// The first field that does not fit; a limit; the request id with another experiment.
    pub async fn create(
        &self,
        message: &v1::Experiment,
        request_id: Option<String>,
    ) -> Result<(v1::Job, bool), Error> {
        let (experiment, plan) = self.prepare(message).await?;
        self.check_limits(&plan).await?;
        let digest = plan.experiment.to_string();
        let artifacts = plan.artifacts.iter().map(|artifact| {
            Ok(NewArtifact {
                key: artifact.key.to_string(),
                kind: artifact.spec.kind().to_owned(),
                spec_json: to_json(&artifact.spec)?,
                inputs: artifact.inputs.iter().map(ToString::to_string).collect(),
                predicted_us: micros(artifact.predicted_seconds),
            })
        });
        let tiles = plan.tile_artifacts.iter().map(|keys| keys.iter().map(ToString::to_string).collect());
        let built: f64 = plan.artifacts.iter().map(|artifact| artifact.predicted_seconds).sum();
        let job = NewJob {
            id: new_id(&digest),
            experiment_digest: digest.clone(),
            experiment_json: to_json(&experiment)?,
            plan_json: to_json(&self.view_plan(&plan).await)?,
            frames: experiment.frames,
            artifacts: artifacts.collect::<Result<_, Error>>()?,
            tiles: tiles.collect(),
            shards: plan
                .shards
                .iter()
                .map(|shard| (shard.first_frame, shard.frame_count, shard.tile))
                .collect(),
            shard_us: micros((plan.predicted_seconds - built) / (plan.shards.len() as f64).max(1.0)),
            request: request_id.map(|id| (id, digest)),
        };
        match self.machine.execute(Command::Create(Box::new(job))).await? {
            Reply::Created(id, new) => Ok((self.job(&id).await?, new)),
            Reply::OtherBody => {
                Err(Error::new(Kind::OtherBody, "this key came with another experiment before"))
            }
            other => Err(unexpected(&other)),
        }
    }

    /// One job with its plan.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn job(&self, id: &str) -> Result<v1::Job, Error> {
        let mut job = self.look(id, view::job).await?;
        let plan = self.machine.document(&format!("plan/{id}")).await?;
        job.plan = plan.and_then(|text| photoneye_proto::from_json(&text).ok());
        Ok(job)
    }

    /// Looks at one job.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn look<T>(&self, id: &str, look: impl FnOnce(&State, &Job) -> T) -> Result<T, Error> {
        let found = self.machine.read(|state| state.jobs.get(id).map(|job| look(state, job))).await;
        found.ok_or_else(|| no_job(id))
    }

    /// Jobs, newest first.
    ///
    /// # Errors
    /// When the page or its size does not fit.
    pub async fn list(&self, page: Option<&str>, size: Option<u32>) -> Result<v1::ListJobsReply, Error> {
        let size = size.unwrap_or(50);
        if !(1..=200).contains(&size) {
            let message = format!("{size} is out of range, allowed is 1 to 200");
            return Err(FieldError::new("page_size", message).into());
        }
        let before = match page.filter(|page| !page.is_empty()) {
            None => u64::MAX,
            Some(page) => {
                page.parse().map_err(|_| FieldError::new("page", "is not the `next_page` of a reply"))?
            }
        };
        let view = |state: &State| {
            let mut jobs: Vec<&Job> = state.jobs.values().filter(|job| job.number < before).collect();
            jobs.sort_unstable_by_key(|job| std::cmp::Reverse(job.number));
            let more = jobs.len() > size as usize;
            jobs.truncate(size as usize);
            v1::ListJobsReply {
                next_page: jobs.last().filter(|_| more).map(|job| job.number.to_string()),
                jobs: jobs.into_iter().map(|job| view::job(state, job)).collect(),
            }
        };
        Ok(self.machine.read(view).await)
    }

    /// Takes a job back; one that ended stays as it is.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn cancel(&self, id: &str) -> Result<v1::Job, Error> {
        match self.machine.execute(Command::Cancel(id.to_owned())).await? {
            Reply::NoSuchJob => Err(no_job(id)),
            _ => self.job(id).await,
        }
    }

    /// The job at each change after a version, until it ends; at most ten events a second, the last state always.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn watch(
        self: Arc<Self>,
        id: String,
        after: u64,
    ) -> Result<impl Stream<Item = v1::JobEvent> + use<>, Error> {
        self.look(&id, |_, _| ()).await?;
        Ok(async_stream::stream! {
            let mut changes = self.machine.changes();
            let mut last = after;
            loop {
                changes.mark_unchanged();
                let look = |state: &State, job: &Job| (job.version, job.state.active(), view::job(state, job));
                let Ok((version, active, job)) = self.look(&id, look).await else { return };
                // Whoever has seen the last change of an ended job gets it once more and the end.
                if version > last || !active {
                    last = version;
                    yield v1::JobEvent { seq: Some(version), job: Some(job) };
                }
                if !active || changes.changed().await.is_err() {
                    return;
                }
                tokio::time::sleep(EVENT_PAUSE).await;
            }
        })
    }

    async fn view_plan(&self, plan: &Plan) -> v1::Plan {
        self.machine.read(|state| view::plan(plan, |key| state.ready(key))).await
    }

    /// The one way from a message to an experiment and its plan.
    async fn prepare(&self, message: &v1::Experiment) -> Result<(Experiment, Plan), Error> {
        let mut experiment = spec::experiment(message)?;
        let film = self.check_pictures(&experiment.video, &experiment.display).await?;
        if let (Some(frames), None) = (film, message.frames.and_then(|frames| frames.count)) {
            experiment.frames = frames;
        }
        self.check_mosaic(&experiment.retina).await?;
        let task = tokio::task::spawn_blocking(move || {
            let plan = photoneye_eye::plan::plan(&experiment);
            (experiment, plan)
        });
        let (experiment, plan) = task.await?;
        match plan {
            Ok(plan) => Ok((experiment, plan)),
            Err(PlanError::Range(error)) => Err(spec::field_error(error).into()),
            Err(PlanError::Model(message)) => Err(Error::new(Kind::Invalid, message)),
        }
    }

    /// The clip's files are there and of the display's size; the number of frames of a film, `None` for pictures. Only headers are read.
    async fn check_pictures(&self, video: &Video, display: &Display) -> Result<Option<u32>, Error> {
        let Video::Clip(clip) = video else {
            return Ok(None);
        };
        let (width, height) = (display.width_px, display.height_px);
        let mut seen = std::collections::BTreeSet::new();
        let mut film = None;
        for (i, text) in clip.blobs.iter().enumerate() {
            if !seen.insert(text) {
                continue;
            }
            let path = format!("video.clip.blobs[{i}]");
            let digest: BlobDigest =
                text.parse().map_err(|_| FieldError::new(path.clone(), "is not a digest"))?;
            let bytes = match self.with_blobs(move |blobs| blobs.get(&digest)).await {
                Ok(bytes) => bytes,
                Err(error) if error.kind == Kind::NotFound => {
                    return Err(FieldError::new(path, format!("{}; upload it first", error.message)).into());
                }
                Err(error) => return Err(error),
            };
            let found = clip_info(&bytes, &clip.format, [width, height], PictureLimits::default());
            let info = found.map_err(|error| FieldError::new(path.clone(), error.to_string()))?;
            if (info.width, info.height) != (width, height) {
                let message = format!(
                    "the picture is {} x {} pixels, the display {width} x {height}",
                    info.width, info.height
                );
                return Err(FieldError::new(path, message).into());
            }
            if info.frames > 1 && clip.blobs.len() > 1 {
                let message = format!("a film of {} frames must be the only file", info.frames);
                return Err(FieldError::new(path, message).into());
            }
            film = (info.frames > 1).then_some(info.frames);
        }
        Ok(film)
    }

    async fn check_limits(&self, plan: &Plan) -> Result<(), Error> {
        let active = self.machine.read(|state| state.active.len()).await;
        if active >= self.limits.active_jobs {
            return Err(Error::new(Kind::Busy, format!("{active} jobs are waiting already")));
        }
        let over = |what: &str, value: f64, limit: f64| {
            (value > limit).then(|| {
                Error::new(Kind::TooLarge, format!("predicted {what} {value:.3e}, allowed is {limit:.3e}"))
            })
        };
        let error = over("bytes of memory", plan.predicted_bytes, self.limits.job_bytes)
            .or_else(|| over("CPU seconds", plan.predicted_seconds, self.limits.job_seconds));
        error.map_or(Ok(()), Err)
    }
}

/// There is no such job.
pub fn no_job(id: &str) -> Error {
    let id: String = id.chars().take(100).collect();
    Error::new(Kind::NotFound, format!("no job `{id}`"))
}

/// The machine gave an answer to another question.
pub fn unexpected(reply: &Reply) -> Error {
    Error::new(Kind::Internal, format!("unexpected answer of the job machine: {reply:?}"))
}

fn micros(seconds: f64) -> u64 {
    (seconds * 1e6).clamp(1.0, 1e18) as u64
}

fn to_json<T: serde::Serialize>(value: &T) -> Result<String, Error> {
    serde_json::to_string(value).map_err(|error| Error::new(Kind::Internal, error.to_string()))
}

/// A new job's name: unlike any other of this or another server.
fn new_id(digest: &str) -> String {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let now =
        std::time::SystemTime::now().duration_since(std::time::SystemTime::UNIX_EPOCH).unwrap_or_default();
    let seed = (now.as_nanos(), std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed));
    let hash = blake3::hash(format!("{seed:?} {digest}").as_bytes()).to_hex();
    format!("j{}", &hash[..16])
}
