//! Cone tables and pictures of a job, made from its retina when somebody asks.

use photoneye_eye::experiment::{Experiment, Movement};
use photoneye_eye::exposure::cone_columns;
use photoneye_eye::optics::Side;
use photoneye_eye::picture::{ConeShapes, View};
use photoneye_eye::retina::Retina;
use photoneye_store::table::{ConeColumns, cones_file};

use crate::error::{Error, Kind};
use crate::service::Service;

/// Side of a picture when none is asked for, pixels.
pub const SIDE_PX: u32 = 800;

impl Service {
    /// The cone table as an Arrow file.
    ///
    /// # Errors
    /// As [`Service::cone_artifacts`].
    pub async fn cones_file(&self, id: &str, wait: bool) -> Result<Vec<u8>, Error> {
        let experiment = self.experiment(id).await?;
        let artifacts = self.cone_artifacts(id, wait).await?;
        tokio::task::spawn_blocking(move || Ok(cones_file(&columns(&experiment, &artifacts)?)?)).await?
    }

    /// One frame as a PNG, the longer side as many pixels; warnings of the job are texts in it.
    ///
    /// # Errors
    /// When there is no such job or frame, it is not computed yet, or the side is out of range.
    pub async fn picture(&self, id: &str, frame: u32, side_px: u32) -> Result<Vec<u8>, Error> {
        let counts = self.frame(id, frame).await?;
        let warnings = self.look(id, |_, job| job.warnings.clone()).await?;
        let experiment = self.experiment(id).await?;
        let artifacts = self.cone_artifacts(id, false).await?;
        let draw = move || {
            let shapes = shapes(columns(&experiment, &artifacts)?, experiment.eye.side);
            let view = View::new(&shapes, side_px).map_err(crate::spec::field_error)?;
            view.image(&shapes, &counts).png_with(&warnings).map_err(internal)
        };
        tokio::task::spawn_blocking(draw).await?
    }
}

/// The rows of all tiles, one below the other.
fn columns(experiment: &Experiment, artifacts: &[Vec<u8>]) -> Result<ConeColumns, Error> {
    // Where cones are does not depend on the movement, whose samples may be in a table that nobody read here.
    let mut experiment = experiment.clone();
    experiment.gaze.movement = Movement::Still;
    let mut all = ConeColumns::default();
    for bytes in artifacts {
        let retina = Retina::from_bytes(bytes).map_err(internal)?;
        let tile = cone_columns(&experiment, &retina).map_err(internal)?;
        all.append(&ConeColumns {
            id: tile.id,
            x_um: tile.x_um,
            y_um: tile.y_um,
            x_deg: tile.x_deg,
            y_deg: tile.y_deg,
            ecc_deg: tile.ecc_deg,
            meridian_deg: tile.meridian_deg,
            kind: tile.cone_type,
            aperture_um2: tile.aperture_um2,
            edge: tile.edge,
            // The model counts corners, the table numbers.
            polygon_start: tile.polygon_start.iter().map(|corner| 2 * corner).collect(),
            polygon: tile.polygon_xy,
        });
    }
    Ok(all)
}

fn shapes(cones: ConeColumns, side: Side) -> ConeShapes {
    ConeShapes {
        start: cones.polygon_start.iter().map(|start| start / 2).collect(),
        corners: cones.polygon.chunks_exact(2).map(|corner| [corner[0], corner[1]]).collect(),
        cone_type: cones.kind,
        aperture_um2: cones.aperture_um2,
        mirrored: side == Side::Left,
    }
}

fn internal(error: impl ToString) -> Error {
    Error::new(Kind::Internal, error.to_string())
}
