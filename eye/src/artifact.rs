//! Artifacts: what is built once and kept under the hash of its inputs.
//!
//! An artifact is a KIND, a VERSION and its inputs; its key is the hash of a typed canonical encoding of exactly these, and the
//! builder sees nothing else.

use serde::{Deserialize, Serialize};

use crate::digest::{Digest, digest_of};
use crate::exposure::KernelSpec;
use crate::psf::{FieldTable, FieldTableSpec};
use crate::retina::{
    ConeType, Counts, RegionUm, Retina, RetinaParams, RetinaTile, TileId, build_tile, import,
};

/// An artifact's inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ArtifactSpec {
    /// A square of the mosaic.
    RetinaTile {
        /// How the mosaic grows.
        params: Box<RetinaParams>,
        /// Which square.
        tile: TileId,
    },
    /// The cones of a scene's region, put together from mosaic tiles; its bytes are `Retina::to_bytes`.
    Cones {
        /// Keys of the mosaic tiles, in order.
        tiles: Vec<Digest>,
        /// The region.
        region: RegionUm,
    },
    /// The cones of a scene's region out of a measured mosaic; its bytes are `Retina::to_bytes`.
    MeasuredCones {
        /// Digest of the table's text, `b3:<64 hex digits>/<size>`.
        table: String,
        /// Seed, geometry, aperture and pointing.
        params: Box<RetinaParams>,
        /// Type of cones that were not classified; `None`: they are refused.
        type_unknown: Option<ConeType>,
        /// The region.
        region: RegionUm,
    },
    /// The wavefronts of an eye over field and wavelength.
    Wavefronts(Box<FieldTableSpec>),
    /// The optical kernels of a scene.
    Kernels(Box<KernelSpec>),
}

/// A built artifact.
#[derive(Clone, Debug)]
pub struct Built {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Cones in it, for kinds that hold cones.
    pub cones: Option<u64>,
    /// Cones by type, for kinds that hold cones.
    pub cones_by_type: [u64; 3],
    /// Counts of rare events.
    pub diagnostics: Vec<(String, u64)>,
}

impl Built {
    fn without_cones(bytes: Vec<u8>) -> Self {
        Self { bytes, cones: None, cones_by_type: [0; 3], diagnostics: Vec::new() }
    }
}

/// Bytes of an input with its key.
pub type Input<'a> = (Digest, &'a [u8]);

/// Why an artifact cannot be built.
#[derive(Clone, Debug, thiserror::Error)]
pub enum BuildError {
    /// An input is missing or its bytes are not what the key promises.
    #[error("artifact input {0} is missing or damaged: {1}")]
    Input(Digest, String),
    /// The model refuses.
    #[error("{0}")]
    Model(String),
}

impl ArtifactSpec {
    /// `retina-tile`, `cones`, `wavefronts` or `kernels`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::RetinaTile { .. } => "retina-tile",
            Self::Cones { .. } | Self::MeasuredCones { .. } => "cones",
            Self::Wavefronts(_) => "wavefronts",
            Self::Kernels(_) => "kernels",
        }
    }

    /// Rises whenever the same inputs give other bytes.
    fn version(&self) -> u32 {
        match self {
            Self::RetinaTile { .. } | Self::Cones { .. } | Self::MeasuredCones { .. } => 3,
            Self::Wavefronts(_) => 4,
            Self::Kernels(_) => 14,
        }
    }

    /// The hash of kind, version and inputs.
    ///
    /// # Errors
    /// Never for validated inputs.
    pub fn key(&self) -> Result<Digest, postcard::Error> {
        digest_of(self.kind(), self.version(), self)
    }

    /// Keys of the artifacts it is made from.
    ///
    /// # Errors
    /// As [`ArtifactSpec::key`].
    pub fn inputs(&self) -> Result<Vec<Digest>, postcard::Error> {
        match self {
            Self::Cones { tiles, .. } => Ok(tiles.clone()),
            Self::Kernels(spec) => {
                spec.wavefronts.iter().map(|table| Self::Wavefronts(table.clone()).key()).collect()
            }
            Self::RetinaTile { .. } | Self::MeasuredCones { .. } | Self::Wavefronts(_) => Ok(Vec::new()),
        }
    }

    /// Digest of the uploaded blob that it is made from, if any; its bytes are an input under [`blob_key`].
    pub fn blob(&self) -> Option<&str> {
        match self {
            Self::MeasuredCones { table, .. } => Some(table),
            Self::RetinaTile { .. } | Self::Cones { .. } | Self::Wavefronts(_) | Self::Kernels(_) => None,
        }
    }

    /// Builds the artifact from its inputs: those of [`ArtifactSpec::inputs`] and [`ArtifactSpec::blob`].
    ///
    /// # Errors
    /// [`BuildError::Input`] for an input that is missing or damaged, [`BuildError::Model`] when the model refuses.
    pub fn build(&self, inputs: &[Input]) -> Result<Built, BuildError> {
        match self {
            // Grow the cones of a tile.
            Self::RetinaTile { params, tile } => {
                let tile = build_tile(params, *tile).map_err(|e| BuildError::Model(e.to_string()))?;
                Ok(Built {
                    bytes: tile.to_bytes(),
                    cones: Some(tile.len() as u64),
                    cones_by_type: by_type(&tile.cone_type),
                    diagnostics: events(tile.counts),
                })
            }
            // Put the cones of tiles together.
            Self::Cones { tiles, region } => {
                let tiles = read_tiles(tiles, inputs)?;
                let retina = Retina::assemble(&tiles, region);
                Ok(Built {
                    bytes: retina.to_bytes(),
                    cones: Some(retina.len() as u64),
                    cones_by_type: by_type(&retina.cone_type),
                    diagnostics: Vec::new(),
                })
            }
            // Take the cones from an uploaded table.
            Self::MeasuredCones { table, params, type_unknown, region } => {
                let retina = measured(input(blob_key(table)?, inputs)?, params, *type_unknown, region)?;
                Ok(Built {
                    bytes: retina.to_bytes(),
                    cones: Some(retina.len() as u64),
                    cones_by_type: by_type(&retina.cone_type),
                    diagnostics: events(retina.cones.counts),
                })
            }
            // Trace the wavefronts over the field.
            Self::Wavefronts(spec) => {
                let table = spec.build().map_err(|e| BuildError::Model(e.to_string()))?;
                Ok(Built::without_cones(table.to_bytes().map_err(BuildError::Model)?))
            }
            // Compute the kernels, with the table of wavefronts if there is one.
            Self::Kernels(spec) => {
                let keys = self.inputs().map_err(|e| BuildError::Model(e.to_string()))?;
                let table = keys.first().map(|key| {
                    let bytes = input(*key, inputs)?;
                    FieldTable::from_bytes(bytes).map_err(|e| BuildError::Input(*key, e))
                });
                let kernels = spec.build(table.transpose()?.as_ref()).map_err(BuildError::Model)?;
                Ok(Built::without_cones(kernels.to_bytes().map_err(BuildError::Model)?))
            }
        }
    }
}

fn read_tiles(keys: &[Digest], inputs: &[Input]) -> Result<Vec<RetinaTile>, BuildError> {
    keys.iter()
        .map(|key| {
            let bytes = input(*key, inputs)?;
            RetinaTile::from_bytes(bytes).map_err(|e| BuildError::Input(*key, e.to_string()))
        })
        .collect()
}

fn input<'a>(key: Digest, inputs: &[Input<'a>]) -> Result<&'a [u8], BuildError> {
    let found = inputs.iter().find(|(other, _)| *other == key);
    found.map(|(_, bytes)| *bytes).ok_or_else(|| BuildError::Input(key, "it was not given".into()))
}

/// The key of an uploaded blob among the inputs: the hash in its digest.
///
/// # Errors
/// When the text is not a digest.
pub fn blob_key(digest: &str) -> Result<Digest, BuildError> {
    let hex = digest.strip_prefix("b3:").and_then(|rest| rest.split('/').next()).unwrap_or(digest);
    hex.parse().map_err(BuildError::Model)
}

/// The cones of a table that lie in a region.
fn measured(
    csv: &[u8],
    params: &RetinaParams,
    type_unknown: Option<ConeType>,
    region: &RegionUm,
) -> Result<Retina, BuildError> {
    let refused = |why: String| BuildError::Model(format!("retina.mosaic: {why}"));
    let csv = std::str::from_utf8(csv).map_err(|e| refused(e.to_string()))?;
    let all = import(csv, params, type_unknown).map_err(|e| refused(e.to_string()))?;
    let retina = all.within(region);
    if retina.is_empty() {
        let box_of = |r: &RegionUm| {
            format!("x {:.0} to {:.0}, y {:.0} to {:.0} µm", r.min.x, r.max.x, r.min.y, r.max.y)
        };
        return Err(refused(format!(
            "no cone of it lies in the scene's patch of retina ({}); its cones lie in {}",
            box_of(region),
            box_of(&all.region)
        )));
    }
    Ok(retina)
}

fn by_type(types: &[ConeType]) -> [u64; 3] {
    let mut counts = [0; 3];
    for cone_type in types {
        counts[*cone_type as usize] += 1;
    }
    counts
}

fn events(counts: Counts) -> Vec<(String, u64)> {
    Counts::NAMES.iter().map(|n| (*n).to_owned()).zip(counts.to_array()).collect()
}
