//! What a cone does with the light that enters it: direction (§19), pigment (§20), isomerization.

pub mod directional;
pub mod pigment;

/// Share of absorbed photons that isomerize a pigment molecule (§20).
pub const ISOMERIZATION: f64 = 2.0 / 3.0;
