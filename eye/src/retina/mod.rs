//! To be written.
use glam::DVec2;
use serde::{Deserialize, Serialize};
/// stub
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RetinaParams {}
/// stub
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileId {
    /// i
    pub i: i32,
    /// j
    pub j: i32,
}
/// stub
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionUm {
    /// min
    pub min: DVec2,
    /// max
    pub max: DVec2,
}
