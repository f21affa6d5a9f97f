//! Scenes that are ready to be counted. The many shards of one job use the same one, so the last few are kept.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use photoneye_eye::display::Curve;
use photoneye_eye::experiment::{Clip, Experiment, Movement, Video};
use photoneye_eye::exposure::{Exposure, ExposureError};
use photoneye_eye::movement::recording;
use photoneye_eye::video::Picture;
use photoneye_proto::v1;
use photoneye_store::BlobDigest;
use tokio::sync::{Mutex, OnceCell};

use crate::lease::Lease;
use crate::{Shared, WorkError, blocking};

/// Scenes kept at the same time.
const KEPT: usize = 2;

/// A prepared scene.
pub(crate) struct Scene {
    pub(crate) exposure: Exposure,
    /// Type of each cone of the tile: 0 L, 1 M, 2 S; `None` of those left out of statistics.
    pub(crate) cone_types: Vec<Option<u8>>,
    /// The files; `None` for a drawn pattern.
    pub(crate) clip: Option<Clip>,
    /// Columns and rows of the display.
    pub(crate) size_px: [u32; 2],
    /// From pixel values to light.
    pub(crate) curve: Curve,
    /// Frames per second of the display.
    pub(crate) frame_rate_hz: f64,
    /// Held while pictures of a clip are made ready for: once, however many shards wait.
    preparing: Mutex<()>,
}

impl Scene {
    /// Prepares what a frame that shows such pictures needs, if no frame before did.
    pub(crate) async fn make_ready(
        self: &Arc<Self>,
        index: u32,
        shown: &[Arc<Picture>],
    ) -> Result<(), WorkError> {
        let _held = self.preparing.lock().await;
        let (scene, shown) = (Arc::clone(self), shown.to_vec());
        blocking(move || {
            let pictures: Vec<&Picture> = shown.iter().map(AsRef::as_ref).collect();
            let earlier = pictures.get(1..).unwrap_or_default();
            scene.exposure.make_ready(index, pictures.first().copied(), earlier).map_err(model_error)
        })
        .await
    }
}

type Slot = Arc<OnceCell<Arc<Scene>>>;

/// The last scenes, the latest at the back.
#[derive(Default)]
pub(crate) struct Scenes {
    kept: Mutex<VecDeque<(BlobDigest, Slot)>>,
}

impl Scenes {
    /// The scene of a shard, and the seconds and CPU seconds that its preparation took (0 when it was there). Prepared once, however many
    /// shards ask.
    pub(crate) async fn get(
        &self,
        shared: &Shared,
        lease: &Lease,
        shard: &v1::Shard,
    ) -> Result<(Arc<Scene>, [f64; 2]), WorkError> {
        let slot = self.slot(name(shard)).await;
        let (started, cpu) = (Instant::now(), shared.cpu.begin());
        let mut prepared = false;
        let scene = slot
            .get_or_try_init(|| {
                prepared = true;
                prepare(shared, lease, shard)
            })
            .await?;
        let cpu = cpu.end();
        let seconds = if prepared { [started.elapsed().as_secs_f64(), cpu] } else { [0.0; 2] };
        Ok((Arc::clone(scene), seconds))
    }

    async fn slot(&self, name: BlobDigest) -> Slot {
        let mut kept = self.kept.lock().await;
        let found = kept.iter().position(|(other, _)| *other == name);
        let entry = found.and_then(|place| kept.remove(place)).unwrap_or_else(|| (name, Slot::default()));
        let slot = Arc::clone(&entry.1);
        kept.push_back(entry);
        while kept.len() > KEPT {
            kept.pop_front();
        }
        slot
    }
}

/// Everything that a scene depends on.
fn name(shard: &v1::Shard) -> BlobDigest {
    let keys = shard.artifacts.iter().map(v1::ArtifactRef::digest);
    let parts: Vec<&str> = std::iter::once(shard.experiment_json()).chain(keys).collect();
    BlobDigest::of(parts.join("\n").as_bytes())
}

async fn prepare(shared: &Shared, lease: &Lease, shard: &v1::Shard) -> Result<Arc<Scene>, WorkError> {
    let mut experiment: Experiment = serde_json::from_str(shard.experiment_json())
        .map_err(|error| WorkError::Passing(format!("this worker cannot read the experiment: {error}")))?;
    if let Movement::Recording(table) = &experiment.gaze.movement {
        let bytes = shared.cache.blob(table).await?;
        let read = blocking(move || {
            let text = std::str::from_utf8(bytes.as_ref()).map_err(|error| error.to_string());
            text.and_then(recording::read).map_err(WorkError::Model)
        });
        experiment.gaze.movement = Movement::Recorded(read.await?.samples());
    }
    let mut artifacts = Vec::with_capacity(shard.artifacts.len());
    for artifact in &shard.artifacts {
        artifacts.push(shared.cache.artifact(artifact).await?);
        lease.check()?;
    }
    let clip = match &experiment.video {
        Video::Clip(clip) => Some(clip.clone()),
        Video::Pattern(_) => None,
    };
    let size_px = [experiment.display.width_px, experiment.display.height_px];
    let (curve, frame_rate_hz) = (experiment.display.curve(), experiment.display.frame_rate_hz);
    blocking(move || {
        let exposure = Exposure::new(&experiment, &artifacts).map_err(model_error)?;
        let cone_types = exposure.cone_types_inside();
        Ok(Arc::new(Scene {
            exposure,
            cone_types,
            clip,
            size_px,
            curve,
            frame_rate_hz,
            preparing: Mutex::new(()),
        }))
    })
    .await
}

/// A damaged artifact may be whole at the next try; what the model refuses it refuses again.
pub(crate) fn model_error(error: ExposureError) -> WorkError {
    match error {
        ExposureError::Artifact(..) => WorkError::Passing(error.to_string()),
        ExposureError::Model(_) | ExposureError::PictureSize(..) => WorkError::Model(error.to_string()),
    }
}
