//! From a message to a job: validation, plan, limits, and the place in the queue.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use photoneye_eye::plan::Plan;
use photoneye_proto::{FieldError, v1};

use crate::access::Caller;
use crate::error::{Error, Kind};
use crate::jobs::state::Goal;
use crate::jobs::{Command, NewJob, Reply, Text};
use crate::prepare::Prepared;
use crate::service::{Service, unexpected};
use crate::view;

/// Priority of a job when nothing is said.
const PRIORITY: u32 = 5;

/// How a job is asked for.
#[derive(Clone, Debug, Default)]
pub struct Wish {
    /// The same again gives the same job.
    pub request_id: Option<String>,
    /// 0 to 9; 5 when nothing is said.
    pub priority: Option<u32>,
    /// Whoever asks lives in this process; the job dies with it.
    pub local: bool,
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
            experiment_json: Some(prepared.experiment_json),
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
        let priority = wish.priority.unwrap_or(PRIORITY);
        if priority > 9 {
            let message = format!("{priority} is out of range, allowed is 0 to 9");
            return Err(FieldError::new("priority", message).into());
        }
        let prepared = self.prepare(caller, message).await?;
        // A repetition is answered also when the queue is full.
        if let Some(id) = &wish.request_id {
            let request = request_name(caller, id);
            if let Some((job, body)) = self.machine.documents().request(&request).await? {
                let same = body == prepared.digest;
                return if same { Ok((self.job(&job).await?, false)) } else { Err(other_body()) };
            }
        }
        let plan = self.view_plan(&prepared).await?;
        let built = plan.artifacts.iter().filter(|artifact| artifact.cached()).count() as u64;
        self.check_size(&prepared).inspect_err(|_| self.refused())?;
        self.check_load(caller, &prepared.planned.plan).inspect_err(|_| self.refused())?;
        let artifacts = prepared.planned.artifacts.len() as u64;
        let job = new_job(caller, prepared, to_json(&plan)?, wish);
        match self.machine.execute(Command::Create(Box::new(job))).await? {
            Reply::Created(id, new) => {
                if new {
                    let misses = artifacts - built;
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
        let keys: Vec<String> =
            prepared.planned.artifacts.iter().map(|artifact| artifact.key.clone()).collect();
        let look = |state: &crate::jobs::State| -> BTreeSet<String> {
            keys.iter().filter(|key| state.ready(key)).cloned().collect()
        };
        let mut built = self.machine.read(look);
        if built.len() < keys.len() {
            built.extend(self.machine.documents().built(&keys).await?);
        }
        let experiment = (prepared.digest.as_str(), prepared.spec.clone());
        let mut plan = view::plan(&prepared.planned.plan, experiment, |key| built.contains(key));
        plan.warnings.extend(prepared.warnings.iter().cloned());
        Ok(plan)
    }

    /// Bounds on one job; the error says the number.
    fn check_size(&self, prepared: &Prepared) -> Result<(), Error> {
        let (plan, limits) = (&prepared.planned.plan, &self.limits);
        let chunks = u64::from(prepared.planned.frames) * plan.tile_artifacts.len() as u64;
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
    fn check_load(&self, caller: &Caller, plan: &Plan) -> Result<(), Error> {
        let count = |state: &crate::jobs::State| {
            (state.active.len(), state.queues.get(&caller.tenant).map_or(0, BTreeSet::len))
        };
        let (all, mine) = self.machine.read(count);
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

fn new_job(caller: &Caller, prepared: Prepared, plan_json: String, wish: Wish) -> NewJob {
    let Prepared { planned, digest, experiment_json, accuracy_target, warnings, .. } = prepared;
    let plan = &planned.plan;
    let tiles = plan.tile_artifacts.iter().map(|keys| keys.iter().map(ToString::to_string).collect());
    let shards = plan.shards.iter().map(|shard| (shard.first_frame, shard.frame_count, shard.tile));
    NewJob {
        id: new_id(&digest),
        experiment: Text::of(experiment_json),
        plan: Text::of(plan_json),
        frames: planned.frames,
        artifacts: planned.artifacts.clone(),
        tiles: tiles.collect(),
        shards: shards.collect(),
        shard_us: planned.shard_us,
        goal: Some(Goal {
            target: accuracy_target,
            drawn: plan.engine != "EXPECTED",
            warnings: plan.warnings.iter().cloned().chain(warnings).collect(),
        }),
        request: wish.request_id.map(|id| (request_name(caller, &id), digest.clone())),
        experiment_digest: digest,
        tenant: caller.tenant.clone(),
        priority: wish.priority.unwrap_or(PRIORITY) as u8,
        by: caller.who.clone(),
        local: wish.local,
    }
}

/// Request ids of one tenant mean nothing to another.
fn request_name(caller: &Caller, id: &str) -> String {
    format!("{}/{id}", caller.tenant)
}

fn other_body() -> Error {
    Error::new(Kind::OtherBody, "this key came with another experiment before")
}

/// Text of a value that is ours.
pub(crate) fn to_json<T: serde::Serialize>(value: &T) -> Result<String, Error> {
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
