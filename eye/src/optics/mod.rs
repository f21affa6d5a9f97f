//! To be written.
use serde::{Deserialize, Serialize};
/// Dispersion law.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Dispersion {
    /// Herzberger.
    Herzberger,
    /// Polyline.
    Polyline,
}
/// Side of the head.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Side {
    /// Right.
    Right,
    /// Left.
    Left,
}
