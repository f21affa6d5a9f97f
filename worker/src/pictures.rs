//! The pictures of a shard's frames, decoded once each: consecutive frames show the same or need the ones before.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use photoneye_eye::video::{Limits, Picture, decode_frame, film_rate_hz};

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
        for frame in (index.saturating_sub(history)..=index).rev() {
            let name = match clip.blobs.as_slice() {
                // One file may be a film.
                [only] => (only.clone(), self.picture_of(shared, scene, only, frame).await?),
                files => match files.get(frame as usize).or(files.last()) {
                    Some(file) => (file.clone(), 0),
                    None => return Ok(Vec::new()),
                },
            };
            pictures.push(self.decode(shared, scene, name).await?);
        }
        while self.decoded.len() > history as usize + 1 {
            self.decoded.pop_front();
        }
        Ok(pictures)
    }

    /// The picture of a film that a frame shows.
    async fn picture_of(
        &mut self,
        shared: &Shared,
        scene: &Scene,
        file: &str,
        frame: u32,
    ) -> Result<u32, WorkError> {
        let Some(from_film) = scene.clip.as_ref().and_then(|clip| clip.from_film) else { return Ok(frame) };
        let bytes = self.bytes_of(shared, file).await?;
        Ok(film_rate_hz(&bytes).map_or(frame, |hz| from_film.picture(frame, hz, scene.frame_rate_hz)))
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
