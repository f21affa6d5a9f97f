//! Sine and cosine of 2π·t without branches, so that loops over nodes become vector code.
//!
//! t is reduced to an eighth of a turn by adding and taking away 1.5·2⁵² (rounds to the nearest integer); then Taylor
//! series to x¹³ and x¹⁴, |error| < 3e-14.

use std::f64::consts::TAU;

const ROUND: f64 = 6_755_399_441_055_744.0;

/// (sin 2πt, cos 2πt) for |t| < 1e9 turns.
#[inline(always)]
#[allow(clippy::inline_always)] // the loops that call it vectorize only when it is inlined
pub fn sin_cos_turns(t: f64) -> (f64, f64) {
    let rounded = 4.0 * t + ROUND;
    let quadrant = rounded.to_bits();
    let x = TAU * (t - 0.25 * (rounded - ROUND));
    let y = x * x;
    let s = x
        * (1.0
            + y * (-1.0 / 6.0
                + y * (1.0 / 120.0
                    + y * (-1.0 / 5040.0
                        + y * (1.0 / 362_880.0 + y * (-1.0 / 39_916_800.0 + y / 6_227_020_800.0))))));
    let c = 1.0
        + y * (-0.5
            + y * (1.0 / 24.0
                + y * (-1.0 / 720.0
                    + y * (1.0 / 40_320.0
                        + y * (-1.0 / 3_628_800.0 + y * (1.0 / 479_001_600.0 - y / 87_178_291_200.0))))));
    let swap = quadrant & 1 == 1;
    let (sin, cos) = (if swap { c } else { s }, if swap { s } else { c });
    let sin_sign = (quadrant & 2) << 62;
    let cos_sign = (quadrant.wrapping_add(1) & 2) << 62;
    (f64::from_bits(sin.to_bits() ^ sin_sign), f64::from_bits(cos.to_bits() ^ cos_sign))
}

#[cfg(test)]
mod tests {
    use super::sin_cos_turns;

    #[test]
    fn agrees_with_the_library() {
        for k in -4000..4000 {
            let t = f64::from(k) * 0.012_345 + 1e-4;
            let (s, c) = sin_cos_turns(t);
            let (sin, cos) = (t * std::f64::consts::TAU).sin_cos();
            assert!((s - sin).abs() < 1e-12 && (c - cos).abs() < 1e-12, "{t}");
        }
    }
}
