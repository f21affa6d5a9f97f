//! Results: chunks in the order of commits, whole arrays, cone tables and pictures. One chunk of a stream is in memory at a time, and of a
//! few streams the next one.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use bytes::Bytes;
use futures::Stream;
use photoneye_proto::v1;
use photoneye_store::BlobDigest;
use photoneye_store::npy::{self, Scalar};
use photoneye_store::photons::{PhotonsTable, read_photons};
use photoneye_store::table::{Chunk, CountsTable, CountsVec, read_counts, read_counts_le};

use crate::ahead::Ahead;
use crate::error::{Error, Kind};
use crate::jobs::{Command, JobState};
use crate::service::Service;

/// How long a request waits for lost bytes to be made again.
const REMAKE: Duration = Duration::from_mins(2);

/// What follows in the stream of results.
enum Next {
    /// A chunk without its bytes, their digest, and the digest of the chunk behind it.
    Chunk(v1::ResultChunk, BlobDigest, Option<BlobDigest>),
    Wait,
    End(Option<Error>),
}

impl Service {
    /// Result chunks from a number on, waiting for new ones until the job ends.
    ///
    /// # Errors
    /// When there is no such job; inside the stream, when the job fails or is cancelled.
    pub async fn chunks(
        self: Arc<Self>,
        id: String,
        from: u64,
    ) -> Result<impl Stream<Item = Result<v1::ResultChunk, Error>> + use<>, Error> {
        self.look(&id, |_, _| ()).await?;
        Ok(async_stream::try_stream! {
            let mut changes = self.machine.changes();
            let mut seq = from.max(1);
            let mut ahead = None;
            loop {
                changes.mark_unchanged();
                match self.next(&id, seq).await? {
                    Next::Chunk(mut chunk, digest, behind) => {
                        let (frame, tile) = (chunk.frame(), chunk.tile());
                        chunk.bytes = Some(self.chunk_bytes(&id, frame, tile, digest, ahead).await?.into());
                        ahead = behind.and_then(|digest| self.ahead.read(&self.blobs, digest));
                        self.metrics.result_bytes.fetch_add(chunk.bytes().len() as u64, Relaxed);
                        yield chunk;
                        seq += 1;
                    }
                    Next::Wait => {
                        if changes.changed().await.is_err() {
                            return;
                        }
                    }
                    Next::End(None) => return,
                    Next::End(Some(error)) => Err(error)?,
                }
            }
        })
    }

    async fn next(&self, id: &str, seq: u64) -> Result<Next, Error> {
        self.look(id, |_, job| {
            let chunk_at = |seq: u64| {
                let place = job.order.get(seq as usize - 1)?;
                Some((place, job.chunks.get(place)?))
            };
            match (chunk_at(seq), job.state) {
                (Some(((frame, tile), chunk)), _) => {
                    let message = v1::ResultChunk {
                        seq: Some(seq),
                        frame: Some(*frame),
                        tile: Some(*tile),
                        first_cone: Some(chunk.first_cone),
                        cones: Some(chunk.cones as u32),
                        digest: Some(chunk.digest.to_string()),
                        bytes: None,
                    };
                    let behind = seq.checked_add(1).and_then(&chunk_at).map(|(_, chunk)| chunk.digest);
                    Next::Chunk(message, chunk.digest, behind)
                }
                (None, JobState::Queued | JobState::Running) => Next::Wait,
                (None, JobState::Succeeded) => Next::End(None),
                (None, JobState::Failed) => {
                    let reason = job.error.clone().unwrap_or_default();
                    Next::End(Some(Error::new(Kind::NotReady, format!("the job failed: {reason}"))))
                }
                (None, JobState::Cancelled) => {
                    Next::End(Some(Error::new(Kind::NotReady, "the job was cancelled")))
                }
            }
        })
        .await
    }

    /// The bytes of one chunk, which may have been read ahead; lost ones are computed again.
    async fn chunk_bytes(
        &self,
        id: &str,
        frame: u32,
        tile: u32,
        first: BlobDigest,
        ahead: Option<Ahead>,
    ) -> Result<Vec<u8>, Error> {
        if let Some(ahead) = ahead
            && let Some(bytes) = ahead.take(&first).await
        {
            return Ok(bytes);
        }
        let until = tokio::time::Instant::now() + REMAKE;
        let mut changes = self.machine.changes();
        let mut digest = first;
        let mut told = false;
        loop {
            changes.mark_unchanged();
            match self.with_blobs(move |blobs| blobs.get(&digest)).await {
                Ok(bytes) => return Ok(bytes),
                Err(error) if error.kind == Kind::NotFound => {
                    if !told {
                        self.machine.execute(Command::LostChunk(id.to_owned(), frame, tile)).await?;
                        told = true;
                        continue;
                    }
                    let rung = tokio::time::timeout_at(until, changes.changed()).await;
                    if !matches!(rung, Ok(Ok(()))) {
                        return Err(Error::new(Kind::Unavailable, "a lost result is being computed again"));
                    }
                }
                Err(error) => return Err(error),
            }
            let found =
                self.look(id, |_, job| job.chunks.get(&(frame, tile)).map(|chunk| chunk.digest)).await?;
            digest = found.unwrap_or(digest);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// One Arrow stream over all chunks from a number on.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn arrow(
        self: Arc<Self>,
        id: String,
        from: u64,
    ) -> Result<impl Stream<Item = Result<Bytes, Error>> + use<>, Error> {
        let means = self.means(&id).await?;
        let chunks = Arc::clone(&self).chunks(id, from).await?;
        Ok(async_stream::try_stream! {
            let mut table = CountsTable::new(means)?;
            for await chunk in chunks {
                let bytes = chunk?.bytes.unwrap_or_default();
                let chunk = self.unpack(bytes).await?;
                for from in (0..chunk.counts.len()).step_by(CountsTable::ROWS) {
                    yield Bytes::from(table.push(&chunk, from)?);
                }
            }
            yield Bytes::from(table.finish()?);
        })
    }

    /// Counts [frame, cone] as a NumPy file, frame by frame.
    ///
    /// # Errors
    /// When there is no such job or it has not succeeded.
    pub async fn npy(
        self: Arc<Self>,
        id: String,
    ) -> Result<impl Stream<Item = Result<Bytes, Error>> + use<>, Error> {
        let scalar = if self.means(&id).await? { Scalar::F32 } else { Scalar::U32 };
        let (places, frames, cones) = self.look_at_result(&id).await?;
        Ok(async_stream::try_stream! {
            yield Bytes::from(npy::header(scalar, &[frames as usize, cones as usize]));
            let mut behind = places.clone().into_iter().skip(1);
            let mut ahead = None;
            for (frame, tile, digest) in places {
                let bytes = self.chunk_bytes(&id, frame, tile, digest, ahead).await?;
                ahead = behind.next().and_then(|(.., digest)| self.ahead.read(&self.blobs, digest));
                yield Bytes::from_owner(tokio::task::spawn_blocking(move || read_counts_le(&bytes)).await??);
            }
        })
    }

    /// The counted photons of a job, frame by frame and tile by tile, as one Arrow stream.
    ///
    /// # Errors
    /// When there is no such job, it lists no photons or it has not succeeded.
    pub async fn photons(
        self: Arc<Self>,
        id: String,
    ) -> Result<impl Stream<Item = Result<Bytes, Error>> + use<>, Error> {
        if !self.experiment(&id).await?.counts.photon_list {
            return Err(Error::new(
                Kind::NotFound,
                "the job lists no photons: counts.photon_list was not set",
            ));
        }
        let (places, ..) = self.look_at_result(&id).await?;
        Ok(async_stream::try_stream! {
            let mut table = PhotonsTable::new()?;
            for (frame, tile, digest) in places {
                let bytes = self.chunk_bytes(&id, frame, tile, digest, None).await?;
                let photons = tokio::task::spawn_blocking(move || read_photons(&bytes)).await??;
                yield Bytes::from(table.push(frame, &photons.unwrap_or_default())?);
            }
            yield Bytes::from(table.finish()?);
        })
    }

    /// Counts of all cones in one frame, in the order of the cone table.
    ///
    /// # Errors
    /// When there is no such job or frame, or the frame is not computed yet.
    pub async fn frame(&self, id: &str, frame: u32) -> Result<Vec<f64>, Error> {
        let tiles = self
            .look(id, |_, job| {
                if frame >= job.frames {
                    let message = format!("no frame {frame}, the job has {}", job.frames);
                    return Err(Error::new(Kind::NotFound, message));
                }
                let digest = |tile: u32| job.chunks.get(&(frame, tile)).map(|chunk| (tile, chunk.digest));
                let tiles: Option<Vec<_>> = (0..job.tiles.len() as u32).map(digest).collect();
                tiles.ok_or_else(|| Error::new(Kind::NotReady, format!("frame {frame} is not computed yet")))
            })
            .await??;
        let mut counts = Vec::new();
        for (tile, digest) in tiles {
            match self.read_chunk(id, frame, tile, digest).await?.counts {
                CountsVec::U32(values) => counts.extend(values.into_iter().map(f64::from)),
                CountsVec::F32(values) => counts.extend(values.into_iter().map(f64::from)),
            }
        }
        Ok(counts)
    }

    async fn read_chunk(&self, id: &str, frame: u32, tile: u32, digest: BlobDigest) -> Result<Chunk, Error> {
        let bytes = self.chunk_bytes(id, frame, tile, digest, None).await?;
        self.unpack(bytes.into()).await
    }

    async fn unpack(&self, bytes: Bytes) -> Result<Chunk, Error> {
        let _turn = self.unpacking.acquire().await.ok();
        Ok(tokio::task::spawn_blocking(move || read_counts(&bytes)).await??)
    }

    /// Frame, tile and digest of every chunk in order, number of frames, number of cones.
    async fn look_at_result(&self, id: &str) -> Result<(Vec<(u32, u32, BlobDigest)>, u32, u64), Error> {
        self.look(id, |state, job| {
            let cones = state.first_cones(job).1;
            match (job.state, cones) {
                (JobState::Succeeded, Some(cones)) => {
                    let places =
                        job.chunks.iter().map(|((frame, tile), chunk)| (*frame, *tile, chunk.digest));
                    Ok((places.collect(), job.frames, cones))
                }
                (state, _) => Err(Error::new(Kind::NotReady, format!("the job is not done: {state:?}"))),
            }
        })
        .await?
    }

    /// Whether the job gives means instead of counts.
    async fn means(&self, id: &str) -> Result<bool, Error> {
        Ok(!self.experiment(id).await?.counts.poisson)
    }

    /// The validated experiment of a job.
    ///
    /// # Errors
    /// When there is no such job.
    pub async fn experiment(&self, id: &str) -> Result<photoneye_eye::experiment::Experiment, Error> {
        let name = self.look(id, |_, job| job.experiment_text.clone()).await?;
        let text = self.machine.document(&name).await?;
        let text = text.ok_or_else(|| crate::service::no_job(id))?;
        serde_json::from_str(&text).map_err(|error| Error::new(Kind::Internal, error.to_string()))
    }

    /// The bytes of the artifacts that hold a job's cones, a tile each; lost ones are built again.
    ///
    /// # Errors
    /// When there is no such job, or its retina is not built; with `wait`, only when the job ended without it.
    pub async fn cone_artifacts(&self, id: &str, wait: bool) -> Result<Vec<Vec<u8>>, Error> {
        let keys: Vec<String> = self
            .look(id, |_, job| job.tiles.iter().filter_map(|tile| tile.first().cloned()).collect())
            .await?;
        let mut all = Vec::new();
        for key in keys {
            all.push(self.artifact_bytes(id, &key, wait).await?);
        }
        Ok(all)
    }

    async fn artifact_bytes(&self, id: &str, key: &str, wait: bool) -> Result<Vec<u8>, Error> {
        let mut until = None;
        let mut changes = self.machine.changes();
        loop {
            changes.mark_unchanged();
            let (digest, built, job) = self
                .look(id, |state, job| {
                    let artifact = state.artifacts.get(key);
                    (artifact.and_then(|a| a.digest), artifact.is_some_and(|a| a.cones.is_some()), job.state)
                })
                .await?;
            if let Some(digest) = digest {
                match self.with_blobs(move |blobs| blobs.get(&digest)).await {
                    Err(error) if error.kind == Kind::NotFound => {}
                    result => return result,
                }
            } else if !built && (!job.active() || !wait) {
                return Err(Error::new(Kind::NotReady, "the retina is not built yet"));
            }
            // A first build takes the time that it takes; lost bytes are asked for once and waited for.
            if built && until.is_none() {
                until = Some(tokio::time::Instant::now() + REMAKE);
                self.machine.execute(Command::LostArtifact(key.to_owned())).await?;
                continue;
            }
            let rung = match until {
                Some(until) => {
                    tokio::time::timeout_at(until, changes.changed()).await.is_ok_and(|rung| rung.is_ok())
                }
                None => changes.changed().await.is_ok(),
            };
            if !rung {
                return Err(Error::new(Kind::Unavailable, "a lost retina is being built again"));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}
