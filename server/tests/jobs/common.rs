//! A small job, the commands of a worker, and the work of a whole state.

use photoneye_server::jobs::state::{Summary, WorkId};
use photoneye_server::jobs::{Ask, Command, Commit, NewArtifact, NewJob, Reply, State, Text, step};
use photoneye_store::BlobDigest;

/// A job: two tiles whose cones are both made from one mosaic tile, one kernel, two shards a tile.
pub fn job(id: &str, request: Option<(String, String)>) -> NewJob {
    let artifact = |key: &str, inputs: &[&str]| NewArtifact {
        key: key.into(),
        kind: "kind".into(),
        spec_json: "{}".into(),
        inputs: inputs.iter().map(ToString::to_string).collect(),
        predicted_us: 1000,
    };
    NewJob {
        id: id.into(),
        experiment_digest: "e".into(),
        experiment: Text::of("{}"),
        plan: Text::of("{}"),
        frames: 4,
        artifacts: vec![
            artifact("mosaic", &[]),
            artifact("cones0", &["mosaic"]),
            artifact("cones1", &["mosaic"]),
            artifact("kernel", &[]),
        ],
        tiles: vec![vec!["cones0".into(), "kernel".into()], vec!["cones1".into(), "kernel".into()]],
        shards: vec![(0, 2, 0), (0, 2, 1), (2, 2, 0), (2, 2, 1)],
        shard_us: 500,
        goal: None,
        request,
        tenant: "local".into(),
        priority: 5,
        by: "test".into(),
        local: false,
    }
}

pub fn create(id: &str) -> Command {
    Command::Create(Box::new(job(id, None)))
}

/// The same by somebody in the server's process.
pub fn create_local(id: &str) -> Command {
    Command::Create(Box::new(NewJob { local: true, ..job(id, None) }))
}

pub fn ask(worker: &str) -> Ask {
    Ask { worker: worker.into(), most: usize::MAX, ..Ask::default() }
}

pub fn take(worker: &str) -> Command {
    Command::Lease(ask(worker))
}

/// The right commit for a piece of work; `salt` stands for what the computation gave.
pub fn commit(state: &State, id: WorkId, fence: u64, salt: u32) -> Command {
    let commit = match &id {
        WorkId::Build(key) => Commit::Artifact { digest: BlobDigest::of(key.as_bytes()), cones: Some(10) },
        WorkId::Shard(job, number) => {
            let shard = &state.jobs[job].shards[*number as usize];
            let frames = shard.first_frame..shard.first_frame + shard.frame_count;
            let digest = |frame| BlobDigest::of(format!("{frame} {} {salt}", shard.tile).as_bytes());
            let chunks = frames.map(|frame| (frame, digest(frame), Summary::default())).collect();
            Commit::Shard { chunks, audit: Vec::new() }
        }
    };
    Command::Commit { id, fence, commit, report_json: Some("{}".into()) }
}

/// Runs everything that there is to do.
pub fn drain(state: &mut State) -> usize {
    for done in 0.. {
        let Reply::Leased(Some((id, fence))) = step(state, take("w"), 0).0 else {
            return done;
        };
        let command = commit(state, id, fence, 0);
        assert_eq!(step(state, command, 0).0, Reply::Held(true));
    }
    unreachable!()
}

/// An hour, ms.
pub const HOUR_MS: i64 = 3_600_000;
