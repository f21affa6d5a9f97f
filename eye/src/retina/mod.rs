//! The retina (§13 to §15): where the cones are, their cells, types and directions.
//!
//! Frame: retina coordinates (x_um, y_um) are arc lengths from the foveal centre on a sphere of 12 mm radius, azimuthal equidistant:
//! x = ecc·cos(meridian), y = ecc·sin(meridian); meridian 0 is nasal retina (the optic disc), 90° superior. Places are stored in this chart;
//! distances between cones are measured across their direction to the exit pupil (`local`).
//!
//! From parameters to cones, file by file: `density` says how many; `lattice` lays patches of hexagonal
//! lattice at that density; `relax` moves the cones by the force of `force`; `cells` draws their walls,
//! `aperture` says how much of them collects light; `types` makes them L, M or S; `tile` does all that for
//! one square of the chart as a pure function; `mosaic` holds the result; `index` finds the cone at a point;
//! `census` and `statistics` compare with the targets; `graph` says which cones are neighbours,
//! `receptive_field` makes centres and surrounds of them; `import` makes a retina of a measured mosaic
//! (`table`).

mod aperture;
mod cells;
mod census;
mod clip;
mod codec;
mod density;
mod field;
mod force;
mod graph;
mod grid;
mod import;
mod index;
mod lattice;
mod local;
mod mosaic;
mod params;
mod receptive_field;
mod relax;
mod ring;
mod statistics;
mod stiffness;
mod synthesize;
mod table;
mod tile;
mod types;
mod visual;

pub use census::Census;
pub use density::Density;
pub use force::{K1, K2, K3, K3_LIMIT, NEIGHBOUR, RADIUS_FACTOR, normalized_distance, spline};
pub use graph::NeighbourGraph;
pub use import::{check_mosaic, import};
pub use index::ConeIndex;
pub(crate) use index::{Origin, Place, Raster};
pub use local::{Frame, Local, Metric, local};
pub use mosaic::{ConeType, Cones, Counts, Retina, RetinaTile};
pub use params::{
    Aperture, CellWalls, DensityLaw, Dropout, ExitPupil, Generator, OpticDisc, RetinaError, RetinaGeometry,
    RetinaParams,
};
pub use receptive_field::{FieldRow, ReceptiveField, Role};
pub use statistics::{BANDS_DEG, Band, SECTORS, Sector, Statistics, statistics, statistics_in_bands};
pub use stiffness::last_step_rms;
pub use synthesize::synthesize;
pub use table::{ImportError, LEAST_DISTANCE_UM, MAX_ROWS};
pub use tile::{RegionUm, TILE_UM, TileId, build_region, build_tile, tiles_for};
pub use visual::{Rim, VisualMap};
