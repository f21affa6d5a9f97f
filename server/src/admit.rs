//! From a message to a job: validation, plan, limits, and the place in the queue.

use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use photoneye_eye::experiment::Experiment;
use photoneye_eye::plan::{Machine, Plan, PlanError};
use photoneye_proto::{FieldError, v1};

use crate::access::Caller;
use crate::error::{Error, Kind};
use crate::jobs::{Command, NewArtifact, NewJob, Reply};
use crate::service::{Service, unexpected};
use crate::{spec, view};

/// Plans kept.
const KEPT: usize = 32;

/// A validated experiment with its plan.
pub struct Prepared {
    /// The experiment, the model's own JSON.
    experiment_json: String,
    frames: u32,
    plan: Plan,
    artifacts: Vec<NewArtifact>,
    shard_us: u64,
}

/// The last plans by the experiment's digest: the same experiment again costs no planning.
#[derive(Default)]
pub struct Plans {
    kept: Mutex<VecDeque<(String, Arc<Prepared>)>>,
}

impl Plans {
    fn get(&self, digest: &str) -> Option<Arc<Prepared>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let place = kept.iter().position(|(name, _)| name == digest)?;
        let entry = kept.remove(place)?;
        let prepared = Arc::clone(&entry.1);
        kept.push_back(entry);
        Some(prepared)
    }

    fn keep(&self, digest: String, prepared: &Arc<Prepared>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push_back((digest, Arc::clone(prepared)));
        while kept.len() > KEPT {
            kept.pop_front();
        }
    }
}

/// How a job is asked for.
#[derive(Clone, Debug, Default)]
pub struct Wish {
    /// The same again gives the same job.
    pub request_id: Option<String>,
    /// 0 to 9; 5 when nothing is said.
    pub priority: Option<u32>,
}

impl Service {
    /// Explains an experiment.
    ///
    /// # Errors
    /// The first field that does not fit.
    pub async fn plan(&self, caller: &Caller, message: &v1::Experiment) -> Result<v1::PlanReply, Error> {
        let prepared = self.prepare(caller, message).await?;
        Ok(v1::PlanReply {
            plan: Some(self.view_plan(&prepared).await?),
            experiment_json: Some(prepared.experiment_json.clone()),
        })
    }

    /// Accepts an experiment; the reply says whether the job is new.
    ///
    /// # Errors
    /// The first field that does not fit; a limit; the request id with another experiment.
    pub async fn create(
        &self,
        caller: &Caller,
        message: &v1::Experiment,
        wish: Wish,
    ) -> Result<(v1::Job, bool), Error> {
        let priority = wish.priority.unwrap_or(5);
        if priority > 9 {
            let message = format!("{priority} is out of range, allowed is 0 to 9");
            return Err(FieldError::new("priority", message).into());
        }
        let prepared = self.prepare(caller, message).await?;
        // A repetition is answered also when the queue is full.
        if let Some(id) = &wish.request_id {
            let request = request_name(caller, id);
            if let Some((job, body)) = self.machine.documents().request(&request).await? {
                let same = body == prepared.plan.experiment.to_string();
                return if same { Ok((self.job(&job).await?, false)) } else { Err(other_body()) };
            }
        }
        let plan = self.view_plan(&prepared).await?;
        let built = plan.artifacts.iter().filter(|artifact| artifact.cached()).count() as u64;
        self.check_size(&prepared).inspect_err(|_| self.refused())?;
        self.check_load(caller, &prepared.plan).await.inspect_err(|_| self.refused())?;
        let job = new_job(caller, &prepared, to_json(&plan)?, wish.request_id, priority as u8);
        match self.machine.execute(Command::Create(Box::new(job))).await? {
            Reply::Created(id, new) => {
                if new {
                    let misses = prepared.artifacts.len() as u64 - built;
                    self.metrics.artifact_hits.fetch_add(built, Ordering::Relaxed);
                    self.metrics.artifact_misses.fetch_add(misses, Ordering::Relaxed);
                    tracing::info!(job = id, tenant = caller.tenant, "accepted");
                }
                let mut job = self.look(&id, view::job).await?;
                job.plan = Some(plan);
                Ok((job, new))
            }
            Reply::OtherBody => Err(other_body()),
            other => Err(unexpected(&other)),
        }
    }

    fn refused(&self) {
        self.metrics.refused.fetch_add(1, Ordering::Relaxed);
    }

    async fn view_plan(&self, prepared: &Prepared) -> Result<v1::Plan, Error> {
        let keys: Vec<String> = prepared.artifacts.iter().map(|artifact| artifact.key.clone()).collect();
        let look = |state: &crate::jobs::State| -> BTreeSet<String> {
            keys.iter().filter(|key| state.ready(key)).cloned().collect()
        };
        let mut built = self.machine.read(look).await;
        if built.len() < keys.len() {
            built.extend(self.machine.documents().built(&keys).await?);
        }
        Ok(view::plan(&prepared.plan, |key| built.contains(key)))
    }

    /// The one way from a message to an experiment and its plan.
    async fn prepare(&self, caller: &Caller, message: &v1::Experiment) -> Result<Arc<Prepared>, Error> {
        let mut experiment = spec::experiment(message)?;
        let film = self.check_pictures(caller, &experiment.video, &experiment.display).await?;
        if let (Some(frames), None) = (film, message.frames.and_then(|frames| frames.count)) {
            experiment.frames = frames;
        }
        self.check_mosaic(caller, &experiment.retina).await?;
        let digest = experiment.digest().map_err(|error| Error::new(Kind::Internal, error.to_string()))?;
        let digest = digest.to_string();
        if let Some(prepared) = self.plans.get(&digest) {
            return Ok(prepared);
        }
        let speed = self.speed;
        let prepared = Arc::new(tokio::task::spawn_blocking(move || prepared(&experiment, &speed)).await??);
        self.plans.keep(digest, &prepared);
        Ok(prepared)
    }

    /// Bounds on one job; the error says the number.
    fn check_size(&self, prepared: &Prepared) -> Result<(), Error> {
        let (plan, limits) = (&prepared.plan, &self.limits);
        let chunks = u64::from(prepared.frames) * plan.tile_artifacts.len() as u64;
        for (what, value, limit) in [
            ("bytes of memory", plan.predicted_bytes, limits.job_bytes),
            ("CPU seconds", plan.predicted_seconds, limits.job_seconds),
            ("cones", plan.predicted_cones, limits.job_cones),
            ("result chunks (frames times tiles)", chunks as f64, limits.job_chunks as f64),
        ] {
            if value > limit {
                let message = format!("predicted {what}: {value:.3e}, allowed are {limit:.3e}");
                return Err(Error::new(Kind::TooLarge, message));
            }
        }
        Ok(())
    }

    /// Bounds on all jobs and on a tenant's.
    async fn check_load(&self, caller: &Caller, plan: &Plan) -> Result<(), Error> {
        let count = |state: &crate::jobs::State| {
            (state.active.len(), state.queues.get(&caller.tenant).map_or(0, BTreeSet::len))
        };
        let (all, mine) = self.machine.read(count).await;
        let busy = |message: String| Error::new(Kind::Busy, message);
        if all >= self.limits.active_jobs {
            return Err(busy(format!(
                "{all} jobs are waiting already, at most {} may",
                self.limits.active_jobs
            )));
        }
        if mine >= self.limits.tenant_jobs {
            let most = self.limits.tenant_jobs;
            return Err(busy(format!(
                "{mine} jobs of `{}` are waiting already, at most {most} may",
                caller.tenant
            )));
        }
        let cost = plan.predicted_seconds;
        self.quota.take(&caller.tenant, cost, Instant::now()).map_err(|retry_after_s| Error {
            retry_after_s,
            ..busy(format!(
                "`{}` has asked for more than {} CPU seconds; come back in {retry_after_s} s",
                caller.tenant, self.limits.burst_seconds
            ))
        })
    }
}

/// Plans an experiment; takes milliseconds.
fn prepared(experiment: &Experiment, speed: &Machine) -> Result<Prepared, Error> {
    let plan = photoneye_eye::plan::plan_on(experiment, speed).map_err(|error| match error {
        PlanError::Range(error) => Error::from(spec::field_error(error)),
        PlanError::Model(message) => Error::new(Kind::Invalid, message),
    })?;
    let artifacts = plan.artifacts.iter().map(|artifact| {
        Ok(NewArtifact {
            key: artifact.key.to_string(),
            kind: artifact.spec.kind().to_owned(),
            spec_json: to_json(&artifact.spec)?,
            inputs: artifact.inputs.iter().map(ToString::to_string).collect(),
            predicted_us: micros(artifact.predicted_seconds),
        })
    });
    let artifacts = artifacts.collect::<Result<_, Error>>()?;
    let built: f64 = plan.artifacts.iter().map(|artifact| artifact.predicted_seconds).sum();
    Ok(Prepared {
        experiment_json: to_json(experiment)?,
        frames: experiment.frames,
        shard_us: micros((plan.predicted_seconds - built) / (plan.shards.len() as f64).max(1.0)),
        artifacts,
        plan,
    })
}

fn new_job(
    caller: &Caller,
    prepared: &Prepared,
    plan_json: String,
    request_id: Option<String>,
    priority: u8,
) -> NewJob {
    let plan = &prepared.plan;
    let digest = plan.experiment.to_string();
    let tiles = plan.tile_artifacts.iter().map(|keys| keys.iter().map(ToString::to_string).collect());
    let shards = plan.shards.iter().map(|shard| (shard.first_frame, shard.frame_count, shard.tile));
    NewJob {
        id: new_id(&digest),
        experiment_json: prepared.experiment_json.clone(),
        plan_json,
        frames: prepared.frames,
        artifacts: prepared.artifacts.clone(),
        tiles: tiles.collect(),
        shards: shards.collect(),
        shard_us: prepared.shard_us,
        request: request_id.map(|id| (request_name(caller, &id), digest.clone())),
        experiment_digest: digest,
        tenant: caller.tenant.clone(),
        priority,
        by: caller.who.clone(),
    }
}

/// Request ids of one tenant mean nothing to another.
fn request_name(caller: &Caller, id: &str) -> String {
    format!("{}/{id}", caller.tenant)
}

fn other_body() -> Error {
    Error::new(Kind::OtherBody, "this key came with another experiment before")
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
