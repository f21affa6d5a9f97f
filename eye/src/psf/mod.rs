//! Point spread and optical transfer (§21).
pub mod quadrature;
