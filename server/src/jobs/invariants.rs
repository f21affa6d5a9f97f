//! What holds in every state of the machine: written once, for the model check, the property test and debug builds.

use super::lease::{MAX_FAILURES, MAX_LOSSES, Phase};
use super::state::{Job, JobState, State, WorkId};

impl State {
    /// The first invariant that does not hold.
    ///
    /// # Errors
    /// What is wrong.
    pub fn check(&self) -> Result<(), String> {
        self.jobs.values().try_for_each(|job| self.check_job(job))?;
        for artifact in self.artifacts.values() {
            let done = artifact.lease.phase == Phase::Done;
            ensure(done == artifact.digest.is_some(), || format!("{}: done without bytes", artifact.key))?;
        }
        for id in &self.leased {
            let lease = self.lease(id).ok_or_else(|| format!("{id}: leased, but unknown"))?;
            ensure(lease.phase == Phase::Leased, || format!("{id}: listed as leased"))?;
            ensure(lease.failures < MAX_FAILURES && lease.losses < MAX_LOSSES, || {
                format!("{id}: handed out after its caps")
            })?;
        }
        let mut holding = std::collections::BTreeMap::new();
        for id in &self.leased {
            if let WorkId::Shard(job, _) = id {
                let tenant = self.jobs.get(job).map_or("", |job| &job.tenant);
                *holding.entry(tenant.to_owned()).or_insert(0_usize) += 1;
            }
        }
        ensure(holding == self.holding, || format!("{holding:?} leased, {:?} counted", self.holding))?;
        let queued: usize = self.queues.values().map(std::collections::BTreeSet::len).sum();
        ensure(queued == self.active.len(), || format!("{queued} queued, {} active", self.active.len()))?;
        ensure(self.queues.keys().eq(self.passes.keys()), || "queues and shares differ".into())
    }

    fn check_job(&self, job: &Job) -> Result<(), String> {
        let id = &job.id;
        let done = job.shards.iter().filter(|shard| shard.lease.phase == Phase::Done).count();
        ensure(job.left == job.shards.len() - done, || format!("{id}: {} left", job.left))?;
        ensure(job.shard_count as usize == job.shards.len(), || format!("{id}: number of shards"))?;
        ensure((job.state == JobState::Succeeded) == (job.left == 0), || format!("{id}: {:?}", job.state))?;
        let named = job.result_digest.is_some();
        ensure(named == (job.state == JobState::Succeeded), || format!("{id}: digest of the result"))?;
        ensure(job.state.active() == self.active.contains(id), || format!("{id}: active"))?;
        let warned = !job.warnings.is_empty();
        ensure(!warned || job.state == JobState::Succeeded, || format!("{id}: warnings of {:?}", job.state))?;
        let mut numbers: Vec<u64> = job.chunks.values().map(|chunk| chunk.seq).collect();
        numbers.sort_unstable();
        ensure(numbers.into_iter().eq(1..=job.chunks.len() as u64), || {
            format!("{id}: numbers have gaps or doubles")
        })?;
        for (number, shard) in (0..).zip(&job.shards) {
            let phase = shard.lease.phase;
            let over = matches!(phase, Phase::Done | Phase::Cancelled | Phase::Failed);
            ensure(job.state.active() || over, || {
                format!("{id}: shard {number} of an ended job is {phase:?}")
            })?;
            // A shard that can be neither leased nor failed would hang the job.
            let stuck = job.state.active() && matches!(phase, Phase::Failed | Phase::Cancelled);
            ensure(!stuck, || format!("{id}: shard {number} is {phase:?}, the job hangs"))?;
            let listed = self.leased.contains(&WorkId::Shard(id.clone(), number));
            ensure(listed == (phase == Phase::Leased), || format!("{id}: shard {number}, list of leases"))?;
            if phase == Phase::Done {
                let frames = shard.first_frame..shard.first_frame + shard.frame_count;
                let there = frames.clone().all(|frame| job.chunks.contains_key(&(frame, shard.tile)));
                ensure(there, || format!("{id}: shard {number} is done without its chunks"))?;
            }
        }
        Ok(())
    }
}

fn ensure(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}
