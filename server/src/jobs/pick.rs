//! Which work a worker gets: of the tenant that had least so far (stride scheduling on predicted cost), its job of the highest
//! priority that had least; of that first what others wait for, then what the worker has inputs for.

use std::collections::BTreeSet;

use super::command::Ask;
use super::lease::Phase;
use super::state::{Job, State, WorkId};

/// The next piece of work for a worker; no shard of a tenant that has as many of them at work as it may.
pub fn pick(state: &State, ask: &Ask) -> Option<WorkId> {
    let mut tenants: Vec<_> =
        state.queues.iter().map(|(name, queue)| (state.passes.get(name), name, queue)).collect();
    tenants.sort_unstable_by_key(|(pass, name, _)| (*pass, *name));
    let jobs = tenants.into_iter().flat_map(|(.., queue)| queue).filter_map(|place| state.jobs.get(&place.3));
    let mut jobs = jobs.filter(|job| job.local || !ask.local_only);
    let room = |job: &Job| state.holding.get(&job.tenant).is_none_or(|held| *held < ask.most);
    // Of thousands of jobs that wait for the same builds, one says that there is nothing to build.
    let mut stuck = BTreeSet::new();
    let mut of_job = |job: &Job| {
        let waiting = stuck.contains(&job.artifacts);
        let first = if waiting { None } else { build(state, &needed(state, job)) };
        if first.is_none() && !waiting && build(state, &unready(state, job)).is_none() {
            stuck.insert(job.artifacts.clone());
        }
        first.or_else(|| if room(job) { shard(state, job, &ask.holds) } else { None })
    };
    jobs.find_map(&mut of_job).or_else(|| {
        let mut wanted = BTreeSet::new();
        state.asked.iter().for_each(|key| want(state, key, &mut wanted));
        build(state, &wanted)
    })
}

/// Artifacts that a job's open shards still need, directly or to be made from.
pub fn needed(state: &State, job: &Job) -> BTreeSet<String> {
    let mut wanted = BTreeSet::new();
    let tiles = job.open.iter().filter(|(_, shards)| !shards.is_empty());
    for key in tiles.filter_map(|(tile, _)| job.tiles.get(*tile as usize)).flatten() {
        want(state, key, &mut wanted);
    }
    // A tile's place in the cone table follows from the cones of the tiles before it.
    for key in job.tiles.iter().filter_map(|tile| tile.first()) {
        if state.artifacts.get(key).is_some_and(|artifact| artifact.cones.is_none()) {
            want(state, key, &mut wanted);
        }
    }
    wanted
}

/// All artifacts of a job that are not ready.
fn unready(state: &State, job: &Job) -> BTreeSet<String> {
    let mut wanted = BTreeSet::new();
    job.artifacts.iter().for_each(|key| want(state, key, &mut wanted));
    wanted
}

/// Adds an artifact that is not ready and everything it is made from that is not.
fn want(state: &State, key: &str, wanted: &mut BTreeSet<String>) {
    let mut stack = vec![key.to_owned()];
    while let Some(key) = stack.pop() {
        if state.ready(&key) || wanted.contains(&key) {
            continue;
        }
        if let Some(artifact) = state.artifacts.get(&key) {
            stack.extend(artifact.inputs.iter().cloned());
        }
        wanted.insert(key);
    }
}

/// The first of the wanted artifacts that can be built now.
fn build(state: &State, wanted: &BTreeSet<String>) -> Option<WorkId> {
    let open = wanted.iter().filter_map(|key| state.artifacts.get(key)).find(|artifact| {
        artifact.lease.phase == Phase::Open && artifact.inputs.iter().all(|input| state.ready(input))
    });
    open.map(|artifact| WorkId::Build(artifact.key.clone()))
}

/// An open shard whose artifacts are ready, of the tile for which the worker holds most of them.
fn shard(state: &State, job: &Job, holds: &BTreeSet<String>) -> Option<WorkId> {
    let known = state.first_cones(job).0.len();
    let ready = job.open.iter().filter_map(|(tile, shards)| {
        let first = *shards.first()?;
        let artifacts = job.tiles.get(*tile as usize)?;
        let ready = (*tile as usize) < known && artifacts.iter().all(|key| state.ready(key));
        ready.then(|| (artifacts.iter().filter(|key| holds.contains(*key)).count(), first))
    });
    // Of equals the first tile.
    let best = ready.reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map(|(_, number)| WorkId::Shard(job.id.clone(), number))
}
