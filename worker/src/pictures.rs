//! The pictures of a shard's frames, decoded once each: consecutive frames show the same or need the ones before.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use photoneye_eye::video::{Limits, Picture, decode_frame, film_rate_hz, mean_light};

use crate::scene::Scene;
use crate::{Shared, WorkError, blocking};

/// File and frame in it.
type Name = (String, u32);

/// The last decoded pictures and the last file.
#[derive(Default)]
pub(crate) struct Pictures {
    decoded: VecDeque<(Name, Arc<Picture>)>,
    file: Option<(String, Bytes)>,
}

impl Pictures {
    /// The picture of a frame and the earlier ones that it needs, the latest first; none for a drawn pattern. When there are
    /// fewer pictures than frames, the last one stays.
    pub(crate) async fn of_frame(
        &mut self,
        shared: &Shared,
        scene: &Scene,
        index: u32,
    ) -> Result<Vec<Arc<Picture>>, WorkError> {
        let Some(clip) = &scene.clip else {
            return Ok(Vec::new());
        };
        let history = scene.exposure.history();
        let mut pictures = Vec::new();
        let mut kept = history as usize + 1;
        for frame in (index.saturating_sub(history)..=index).rev() {
            let parts: Vec<(Name, f64)> = match clip.blobs.as_slice() {
                // One file may be a film.
                [only] => {
                    let parts = self.pictures_of(shared, scene, only, frame).await?;
                    parts.into_iter().map(|(picture, part)| ((only.clone(), picture), part)).collect()
                }
                files => match files.get(frame as usize).or(files.last()) {
                    Some(file) => vec![((file.clone(), 0), 1.0)],
                    None => return Ok(Vec::new()),
                },
            };
            kept += parts.len() - 1;
            let mut decoded = Vec::with_capacity(parts.len());
            for (name, part) in parts {
                decoded.push((self.decode(shared, scene, name).await?, part));
            }
            pictures.push(blend(scene, decoded).await?);
        }
        while self.decoded.len() > kept {
            self.decoded.pop_front();
        }
        Ok(pictures)
    }

    /// The pictures of a film that a frame shows, with their parts of its time.
    async fn pictures_of(
        &mut self,
        shared: &Shared,
        scene: &Scene,
        file: &str,
        frame: u32,
    ) -> Result<Vec<(u32, f64)>, WorkError> {
        let Some(from_film) = scene.clip.as_ref().and_then(|clip| clip.from_film) else {
            return Ok(vec![(frame, 1.0)]);
        };
        let bytes = self.bytes_of(shared, file).await?;
        let of_rate = |hz| from_film.pictures(frame, hz, scene.frame_rate_hz);
        Ok(film_rate_hz(&bytes).map_or(vec![(frame, 1.0)], of_rate))
    }

    /// The bytes of a file, which is kept.
    async fn bytes_of(&mut self, shared: &Shared, file: &str) -> Result<Bytes, WorkError> {
        if let Some((_, bytes)) = self.file.as_ref().filter(|(known, _)| known == file) {
            return Ok(bytes.clone());
        }
        let bytes = Bytes::from_owner(shared.cache.blob(file).await?);
        self.file = Some((file.to_owned(), bytes.clone()));
        Ok(bytes)
    }

    async fn decode(
        &mut self,
        shared: &Shared,
        scene: &Scene,
        name: Name,
    ) -> Result<Arc<Picture>, WorkError> {
        if let Some((_, picture)) = self.decoded.iter().find(|(known, _)| *known == name) {
            return Ok(Arc::clone(picture));
        }
        let bytes = self.bytes_of(shared, &name.0).await?;
        let format = scene.clip.as_ref().map(|clip| clip.format).unwrap_or_default();
        let (size, frame, file) = (scene.size_px, name.1, name.0.clone());
        let picture = blocking(move || {
            let decoded = decode_frame(&bytes, &format, size, frame, Limits::default());
            decoded.map_err(|error| WorkError::Model(format!("picture {file}, frame {frame}: {error}")))
        });
        let picture = Arc::new(picture.await?);
        self.decoded.push_back((name, Arc::clone(&picture)));
        Ok(picture)
    }
}

/// The mean light of pictures; one is itself.
async fn blend(scene: &Scene, mut parts: Vec<(Arc<Picture>, f64)>) -> Result<Arc<Picture>, WorkError> {
    if parts.len() == 1
        && let Some((only, _)) = parts.pop()
    {
        return Ok(only);
    }
    let curve = scene.curve;
    let mean = blocking(move || {
        let parts: Vec<(&Picture, f64)> =
            parts.iter().map(|(picture, part)| (picture.as_ref(), *part)).collect();
        mean_light(curve, &parts).ok_or_else(|| WorkError::Model("a frame shows no picture".to_owned()))
    });
    Ok(Arc::new(mean.await?))
}
