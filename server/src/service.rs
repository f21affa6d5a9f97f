//! What both doors, REST and gRPC, do: one function for each request.

use std::sync::Arc;
use std::time::Duration;

use futures::Stream;
use photoneye_proto::{FieldError, v1};
use photoneye_store::{BlobDigest, Blobs};
use tokio::sync::Semaphore;
use tokio::time::Instant;

use crate::access::{Access, Caller, Role};
use crate::ahead::Places;
use crate::error::{Error, Kind};
use crate::fleet::Fleet;
use crate::jobs::{Command, Job, Machine, Record, Reply, State};
use crate::metrics::Metrics;
use crate::prepare::Plans;
use crate::quota::Quota;
use crate::view;

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
    /// Jobs of one tenant that are not finished.
    pub tenant_jobs: usize,
    /// Shards of one tenant that are at work at the same time.
    pub tenant_leases: usize,
    /// Predicted cones of a job.
    pub job_cones: f64,
    /// Frames of a job times its result tiles.
    pub job_chunks: u64,
    /// Predicted work that a tenant may ask for at once, CPU seconds.
    pub burst_seconds: f64,
    /// Predicted work that a tenant may ask for in the long run, CPU seconds a second.
    pub rate: f64,
    /// Jobs that are remembered, the latest; those at work always.
    pub kept_jobs: u64,
    /// Records of the audit that are kept, the latest.
    pub kept_audit: u64,
    /// Jobs that ended and records older than so many days are deleted; `None`: only by number.
    pub keep_days: Option<f64>,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            active_jobs: 10_000,
            job_bytes: 64e9,
            job_seconds: 30.0 * 86400.0,
            blob_bytes: 4 << 30,
            tenant_jobs: 5_000,
            tenant_leases: 1_000,
            job_cones: 20e6,
            job_chunks: 4_000_000,
            burst_seconds: 30.0 * 86400.0,
            rate: 1000.0,
            kept_jobs: 1_000_000,
            kept_audit: 1_000_000,
            keep_days: None,
        }
    }
}

/// Chunks that are unpacked at the same time, at most.
pub const UNPACKED: usize = 2;

/// Events of one watcher, at most so often.
const EVENT_PAUSE: Duration = Duration::from_millis(100);
/// Meanwhile it is looked whether the job has ended, at most so often.
const LOOK_PAUSE: Duration = Duration::from_millis(10);

/// The service behind both doors.
pub struct Service {
    /// Jobs and leases.
    pub machine: Machine,
    /// Bytes.
    pub blobs: Arc<dyn Blobs>,
    /// What is accepted.
    pub limits: Limits,
    /// Who may ask.
    pub access: Access,
    /// How much tenants have asked for.
    pub quota: Quota,
    /// Workers that were heard.
    pub fleet: Fleet,
    /// Counters.
    pub metrics: Metrics,
    /// Turns at unpacking a chunk: meanwhile it takes several times its size.
    pub unpacking: Semaphore,
    /// Places of chunks that are read ahead.
    pub ahead: Places,
    /// The last plans.
    pub plans: Plans,
    /// Only jobs that were made in this process are worked on; the others wait for another one.
    pub local_only: bool,
    /// How fast the machine is, for predictions.
    pub speed: photoneye_eye::plan::Machine,
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

    /// One job with its plan.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn job(&self, id: &str) -> Result<v1::Job, Error> {
        let look = |state: &State, job: &Job| (view::job(state, job), job.plan_text.clone());
        let (mut job, plan) = self.look(id, look).await?;
        let plan = self.machine.document(&plan).await?;
        job.plan = plan.and_then(|text| photoneye_proto::from_json(&text).ok());
        Ok(job)
    }

    /// Looks at one job.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn look<T>(&self, id: &str, look: impl FnOnce(&State, &Job) -> T) -> Result<T, Error> {
        let found = self.machine.read_job(id, |state| state.jobs.get(id).map(|job| look(state, job))).await?;
        found.ok_or_else(|| no_job(id))
    }

    /// Jobs, newest first.
    ///
    /// # Errors
    /// When the page or its size does not fit.
    pub async fn list(
        &self,
        caller: &Caller,
        page: Option<&str>,
        size: Option<u32>,
    ) -> Result<v1::ListJobsReply, Error> {
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
        let tenant = (!caller.sees_all()).then_some(caller.tenant.as_str());
        let mut jobs = self.machine.documents().jobs(before, size + 1, tenant).await?;
        let more = jobs.len() > size as usize;
        jobs.truncate(size as usize);
        let next_page = jobs.last().filter(|_| more).map(|job| job.number.to_string());
        // What is at work is known better here than the database can tell.
        let view = |state: &State| {
            let view = |job: &Job| view::job(state, state.jobs.get(&job.id).unwrap_or(job));
            jobs.iter().map(view).collect()
        };
        Ok(v1::ListJobsReply { next_page, jobs: self.machine.read(view) })
    }

    /// Refuses the job of another tenant as if it were not there.
    ///
    /// # Errors
    /// When it is not theirs, or not there; who sees everything is told that by what comes next.
    pub async fn owned(&self, caller: &Caller, id: &str) -> Result<(), Error> {
        if caller.sees_all() || self.look(id, |_, job| job.tenant == caller.tenant).await? {
            return Ok(());
        }
        Err(no_job(id))
    }

    /// Refuses the blob of another tenant as if it were not there.
    ///
    /// # Errors
    /// When it is not theirs.
    pub async fn readable(&self, caller: &Caller, digest: &BlobDigest) -> Result<(), Error> {
        if caller.may(Role::Worker)
            || self.machine.documents().may_read(&caller.tenant, &digest.to_string()).await?
        {
            return Ok(());
        }
        Err(Error::new(Kind::NotFound, format!("no blob {digest}")))
    }

    /// Takes a job back; one that ended stays as it is.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn cancel(&self, caller: &Caller, id: &str) -> Result<v1::Job, Error> {
        self.owned(caller, id).await?;
        self.note("cancel job", caller, id).await?;
        match self.machine.execute(Command::Cancel(id.to_owned())).await? {
            Reply::NoSuchJob => Err(no_job(id)),
            _ => self.job(id).await,
        }
    }

    /// Puts on record who did what.
    async fn note(&self, action: &'static str, caller: &Caller, object: &str) -> Result<(), Error> {
        let record = Record::Audit {
            tenant: caller.tenant.clone(),
            who: caller.who.clone(),
            action,
            object: object.to_owned(),
        };
        self.machine.execute(Command::Note(record)).await?;
        Ok(())
    }

    /// Puts on record whose an uploaded blob is.
    ///
    /// # Errors
    /// When the record cannot be kept.
    pub async fn uploaded(&self, caller: &Caller, digest: BlobDigest) -> Result<(), Error> {
        let record = Record::Upload { tenant: caller.tenant.clone(), digest };
        self.machine.execute(Command::Note(record)).await?;
        Ok(())
    }

    /// The job at each change after a version, until it ends; at most ten events a second, the last state always and at once.
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
            let (mut last, mut next) = (after, Instant::now());
            loop {
                changes.mark_unchanged();
                let look = |state: &State, job: &Job| {
                    let active = job.state.active();
                    // Whoever has seen the last change of an ended job gets it once more and the end.
                    let told = !active || (job.version > last && Instant::now() >= next);
                    (job.version, active, told.then(|| view::job(state, job)))
                };
                let Ok((version, active, told)) = self.look(&id, look).await else { return };
                if told.is_some() {
                    (last, next) = (version, Instant::now() + EVENT_PAUSE);
                    yield v1::JobEvent { seq: Some(version), job: told };
                }
                if !active {
                    return;
                }
                // What may not be told yet is told when it may.
                let changed = if version > last {
                    tokio::time::timeout_at(next, changes.changed()).await.unwrap_or(Ok(()))
                } else {
                    changes.changed().await
                };
                if changed.is_err() {
                    return;
                }
                tokio::time::sleep(LOOK_PAUSE).await;
            }
        })
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
