//! The measured mosaic of an experiment, looked at before the job is taken: it is there, it is text, and its rows are cones.

use photoneye_eye::experiment::Retina;
use photoneye_eye::retina::{RetinaGeometry, check_mosaic};
use photoneye_proto::FieldError;
use photoneye_store::BlobDigest;

use crate::access::Caller;
use crate::error::{Error, Kind};
use crate::service::Service;

/// The field, for errors.
const FIELD: &str = "retina.mosaic.blob";

impl Service {
    /// Refuses a mosaic that no artifact can be built from, with the line and value that are wrong.
    pub(crate) async fn check_mosaic(&self, caller: &Caller, retina: &Retina) -> Result<(), Error> {
        let Some(text) = &retina.mosaic else {
            return Ok(());
        };
        let digest: BlobDigest = text.parse().map_err(|_| FieldError::new(FIELD, "is not a digest"))?;
        let found = match self.readable(caller, &digest).await {
            Ok(()) => self.with_blobs(move |blobs| blobs.get(&digest)).await,
            Err(error) => Err(error),
        };
        let bytes = match found {
            Ok(bytes) => bytes,
            Err(error) if error.kind == Kind::NotFound => {
                return Err(FieldError::new(FIELD, format!("{}; upload it first", error.message)).into());
            }
            Err(error) => return Err(error),
        };
        let params = retina.params(0.0, RetinaGeometry::default());
        let check = move || {
            let csv = std::str::from_utf8(&bytes).map_err(|error| error.to_string())?;
            check_mosaic(csv, &params).map_err(|error| error.to_string())
        };
        let checked = tokio::task::spawn_blocking(check).await?;
        checked.map_err(|why| FieldError::new(FIELD, why))?;
        Ok(())
    }
}
