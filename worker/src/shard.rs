//! Computes one shard: some frames of one tile, a chunk a frame. While chunks are on their way, the next frames are counted.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use photoneye_eye::exposure::{AuditSample, Frame, FrameCounts, Memo};
use photoneye_eye::report::WorkReport;
use photoneye_eye::video::Picture;
use photoneye_proto::v1;
use photoneye_store::photons::{Photons, photons_stream};
use photoneye_store::table::{Counts, counts_stream};
use tokio::task::JoinHandle;

use crate::cpu::Stage;
use crate::lease::{Done, Lease};
use crate::pictures::Pictures;
use crate::scene::{Scene, model_error};
use crate::{Shared, WorkError, blocking, memory};

/// Chunks on their way to the server at the same time, at most.
const ON_THE_WAY: usize = 4;

/// One computed and encoded frame.
struct Chunk {
    bytes: Vec<u8>,
    frame: Frame,
    summary: Summary,
}

/// Sums by cone type L, M, S.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Summary {
    sum: [f64; 3],
    sum_squares: [f64; 3],
    cones: [u64; 3],
}

pub(crate) async fn run(shared: &Arc<Shared>, lease: &Lease, shard: v1::Shard) -> Result<Done, WorkError> {
    lease.progress(0.0, "prepare");
    let (scene, [prepare_seconds, prepare_cpu]) = shared.scenes.get(shared, lease, &shard).await?;
    let mut report = WorkReport {
        seconds: BTreeMap::from([("prepare".to_owned(), prepare_seconds)]),
        cpu_seconds: BTreeMap::from([("prepare".to_owned(), prepare_cpu)]),
        ..WorkReport::default()
    };
    let mut pictures = Pictures::default();
    let mut sending = Sending::default();
    let mut memo = Memo::default();
    for done in 0..shard.frame_count() {
        // Between frames: is the answer still wanted?
        lease.check()?;
        let index = shard.first_frame() + done;
        lease.progress(f64::from(done) / f64::from(shard.frame_count()), &format!("frame {index}"));

        // Count the frame.
        let shown = pictures.of_frame(shared, &scene, index).await?;
        if scene.clip.is_some() {
            let (started, cpu) = (Instant::now(), shared.cpu.begin());
            scene.make_ready(index, &shown).await?;
            stage(&mut report, "prepare", started, cpu);
        }
        let (started, cpu) = (Instant::now(), shared.cpu.begin());
        let (tile, first_cone, counted) = (shard.tile(), shard.first_cone(), Arc::clone(&scene));
        let pictures_shown = shown.clone();
        let kept = std::mem::take(&mut memo);
        let counting = move || count(&counted, (index, &pictures_shown), (tile, first_cone), kept);
        let chunk;
        (chunk, memo) = blocking(counting).await?;
        stage(&mut report, "count", started, cpu);

        // Compute a few cones again, when this frame is among those that are audited.
        if scene.exposure.is_audited(index) {
            let (started, cpu) = (Instant::now(), shared.cpu.begin());
            let (audited, frame) = (Arc::clone(&scene), chunk.frame.clone());
            report.audit.extend(blocking(move || audit(&audited, index, &shown, &frame)).await?);
            stage(&mut report, "audit", started, cpu);
        }

        // Hand the chunk over.
        tell(&mut report, &chunk.frame, &chunk.summary);
        sending.send(shared, index, chunk).await?;
    }
    let chunks = sending.all().await?;
    report.peak_memory_bytes = memory::peak_bytes();
    Ok(Done { done: v1::commit_request::Done::Shard(v1::ShardResult { chunks }), report })
}

/// Adds what a stage took.
fn stage(report: &mut WorkReport, name: &str, started: Instant, cpu: Stage) {
    *report.seconds.entry(name.to_owned()).or_default() += started.elapsed().as_secs_f64();
    *report.cpu_seconds.entry(name.to_owned()).or_default() += cpu.end();
}

/// Runs on a blocking thread: the audit of one frame.
fn audit(
    scene: &Scene,
    index: u32,
    shown: &[Arc<Picture>],
    frame: &Frame,
) -> Result<Vec<AuditSample>, WorkError> {
    let pictures: Vec<&Picture> = shown.iter().map(AsRef::as_ref).collect();
    let earlier = pictures.get(1..).unwrap_or_default();
    scene.exposure.audit(index, pictures.first().copied(), earlier, frame).map_err(model_error)
}

/// Chunks on their way to the server, in the order of frames, and those that are there.
#[derive(Default)]
struct Sending {
    on_the_way: VecDeque<JoinHandle<Result<v1::CommittedChunk, WorkError>>>,
    there: Vec<v1::CommittedChunk>,
}

impl Sending {
    /// Begins to send a chunk; waits for the first of those before when there are many.
    async fn send(&mut self, shared: &Arc<Shared>, index: u32, chunk: Chunk) -> Result<(), WorkError> {
        if self.on_the_way.len() >= ON_THE_WAY {
            self.first().await?;
        }
        let shared = Arc::clone(shared);
        self.on_the_way.push_back(tokio::spawn(async move {
            let digest = shared.remote.put(Bytes::from(chunk.bytes)).await?;
            Ok(v1::CommittedChunk {
                frame: Some(index),
                digest: Some(digest.to_string()),
                sum: chunk.summary.sum.to_vec(),
                sum_squares: chunk.summary.sum_squares.to_vec(),
                cones: chunk.summary.cones.to_vec(),
            })
        }));
        Ok(())
    }

    /// Waits for the first one that is on its way.
    async fn first(&mut self) -> Result<(), WorkError> {
        if let Some(sent) = self.on_the_way.pop_front() {
            self.there.push(sent.await.map_err(|_| WorkError::Dropped)??);
        }
        Ok(())
    }

    /// Waits until all are there.
    async fn all(mut self) -> Result<Vec<v1::CommittedChunk>, WorkError> {
        while !self.on_the_way.is_empty() {
            self.first().await?;
        }
        Ok(self.there)
    }
}

/// Runs on a blocking thread: counts one frame and encodes it.
fn count(
    scene: &Scene,
    (index, shown): (u32, &[Arc<Picture>]),
    (tile, first_cone): (u32, u64),
    mut memo: Memo,
) -> Result<(Chunk, Memo), WorkError> {
    let pictures: Vec<&Picture> = shown.iter().map(AsRef::as_ref).collect();
    let earlier = pictures.get(1..).unwrap_or_default();
    let shown = (pictures.first().copied(), earlier);
    let frame = scene.exposure.frame_going_on(index, shown, &mut memo).map_err(model_error)?;
    let counts = match &frame.counts {
        FrameCounts::Counts(counts) => Counts::U32(counts),
        FrameCounts::Means(means) => Counts::F32(means),
    };
    let mut bytes = counts_stream(index, tile, first_cone, counts)?;
    if let Some(list) = &frame.photons {
        let ids = scene.exposure.cone_ids();
        bytes.extend(photons_stream(&Photons {
            time_s: list.iter().map(|photon| photon.time_s).collect(),
            wavelength_nm: list.iter().map(|photon| photon.wavelength_nm).collect(),
            cone: list.iter().map(|photon| ids[photon.cone as usize]).collect(),
        })?);
    }
    Ok((Chunk { bytes, summary: summarize(&frame.counts, &scene.cone_types), frame }, memo))
}

/// Sums by type; cones without one are left out.
fn summarize(counts: &FrameCounts, cone_types: &[Option<u8>]) -> Summary {
    let values: Box<dyn Iterator<Item = f64> + '_> = match counts {
        FrameCounts::Counts(counts) => Box::new(counts.iter().map(|&count| f64::from(count))),
        FrameCounts::Means(means) => Box::new(means.iter().map(|&mean| f64::from(mean))),
    };
    let mut summary = Summary::default();
    for (value, &cone_type) in values.zip(cone_types) {
        let Some(cone_type) = cone_type else { continue };
        let i = usize::from(cone_type.min(2));
        summary.sum[i] += value;
        summary.sum_squares[i] += value * value;
        summary.cones[i] += 1;
    }
    summary
}

/// Adds one frame to the shard's report.
fn tell(report: &mut WorkReport, frame: &Frame, summary: &Summary) {
    report.budget.add(&frame.budget);
    for (event, count) in &frame.diagnostics {
        *report.diagnostics.entry(event.clone()).or_default() += count;
    }
    for i in 0..3 {
        report.counted[i] += summary.sum[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_go_to_their_type() {
        let summary =
            summarize(&FrameCounts::Counts(vec![1, 2, 3, 4, 9]), &[Some(0), Some(1), Some(1), Some(2), None]);
        let expected = Summary { sum: [1.0, 5.0, 4.0], sum_squares: [1.0, 13.0, 16.0], cones: [1, 2, 1] };
        assert_eq!(summary, expected);
    }
}
