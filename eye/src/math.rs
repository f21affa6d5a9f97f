//! Elementary functions with the same bits on every machine.
//!
//! What the platform's library returns for sin or ln may differ in the last bit from machine to machine; where such a bit decides a
//! state (a cone's place, a draw), these are used instead: `libm`, compiled with the program. IEEE operations and
//! square roots are exact everywhere.

use glam::DVec2;

/// Sine and cosine of an angle, radians.
#[inline]
pub fn sin_cos(x: f64) -> (f64, f64) {
    libm::sincos(x)
}

/// e to the power x.
#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// Natural logarithm.
#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// x to the power y.
#[inline]
pub fn pow(x: f64, y: f64) -> f64 {
    libm::pow(x, y)
}

/// The unit vector at an angle from +x, radians.
#[inline]
pub fn unit(angle: f64) -> DVec2 {
    let (sin, cos) = sin_cos(angle);
    DVec2::new(cos, sin)
}

/// The angle of a vector from +x, radians, -π to π.
#[inline]
pub fn angle(v: DVec2) -> f64 {
    libm::atan2(v.y, v.x)
}
