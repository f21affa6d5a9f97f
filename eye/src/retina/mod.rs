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
/// stub
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum ConeType {
    /// L
    L = 0,
    /// M
    M = 1,
    /// S
    S = 2,
}
