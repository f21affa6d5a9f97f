//! A convex outline cut into chords of constant y.
//!
//! y = y_mid + y_half·sin τ; the right end of the chord is x(τ), |τ| ≤ π/2, the left end x(π − τ). In τ both ends are
//! smooth (in y they end in square roots), so x(τ) is one short Fourier series and Gauss–Legendre in τ converges fast.

use super::outline::Outline;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Chords of an outline along x.
#[derive(Clone, Debug, PartialEq)]
pub struct Chords {
    middle: f64,
    half: f64,
    /// (cosine, sine) coefficients of x(τ).
    series: Vec<(f64, f64)>,
}

/// One chord.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chord {
    /// y of the chord.
    pub y: f64,
    /// dy/dτ.
    pub slope: f64,
    /// Middle of the chord.
    pub middle: f64,
    /// Length of the chord.
    pub length: f64,
}

impl Chords {
    /// The chords of an outline, whichever way round it runs.
    pub fn new(outline: &Outline) -> Self {
        let (c1, s1) = outline.harmonics.get(1).copied().unwrap_or_default();
        let top = extreme(outline, s1.y.atan2(c1.y));
        let bottom = extreme(outline, s1.y.atan2(c1.y) + PI);
        let (y_top, y_bottom) = (outline.at(top)[0].y, outline.at(bottom)[0].y);
        let (middle, half) = ((y_top + y_bottom) / 2.0, (y_top - y_bottom) / 2.0);
        let way = if outline.at(top - FRAC_PI_2)[0].x > outline.at(top + FRAC_PI_2)[0].x {
            1.0
        } else {
            -1.0
        };
        // x at parameters τ half a step off the top and bottom, where α(τ) is solved well.
        let n = (4 * (outline.harmonics.len() + 1)).clamp(12, 128);
        let step = TAU / n as f64;
        let samples: Vec<f64> = (0..n)
            .map(|k| {
                let tau = (k as f64 + 0.5) * step - FRAC_PI_2;
                let wanted = middle + half * tau.sin();
                let mut alpha = top + way * (tau - FRAC_PI_2);
                for _ in 0..12 {
                    let [p, d, _] = outline.at(alpha);
                    let move_by = (p.y - wanted) / d.y;
                    if !move_by.is_finite() {
                        break;
                    }
                    alpha -= move_by.clamp(-0.2, 0.2);
                    if move_by.abs() < 1e-14 {
                        break;
                    }
                }
                outline.at(alpha)[0].x
            })
            .collect();
        let mut series: Vec<(f64, f64)> = (0..n / 2)
            .map(|m| {
                let (mut c, mut s) = (0.0, 0.0);
                for (k, x) in samples.iter().enumerate() {
                    let (sin, cos) = (m as f64 * ((k as f64 + 0.5) * step - FRAC_PI_2)).sin_cos();
                    c += x * cos;
                    s += x * sin;
                }
                let norm = if m == 0 { 1.0 } else { 2.0 } / n as f64;
                (c * norm, s * norm)
            })
            .collect();
        let least = 1e-11 * half;
        while series.len() > 2 && series.last().is_some_and(|(c, s)| c.abs() + s.abs() < least) {
            series.pop();
        }
        Self { middle, half, series }
    }

    /// Half of the outline's extent in y.
    pub fn half_height(&self) -> f64 {
        self.half
    }

    /// The chord at τ. Harmonics of one parity make the middle, of the other the length.
    pub fn at(&self, tau: f64) -> Chord {
        let (sin1, cos1) = tau.sin_cos();
        let (mut sin, mut cos) = (0.0, 1.0);
        let (mut middle, mut half_length) = (0.0, 0.0);
        for (m, (c, s)) in self.series.iter().enumerate() {
            if m % 2 == 0 {
                middle += c * cos;
                half_length += s * sin;
            } else {
                middle += s * sin;
                half_length += c * cos;
            }
            (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
        }
        Chord {
            y: self.middle + self.half * sin1,
            slope: self.half * cos1,
            middle,
            length: 2.0 * half_length,
        }
    }

    /// τ and length of the longest chord.
    pub fn longest(&self) -> (f64, f64) {
        let (mut low, mut high) = (-1.2, 1.2);
        let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
        for _ in 0..40 {
            let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
            if self.at(a).length > self.at(b).length {
                high = b;
            } else {
                low = a;
            }
        }
        let tau = (low + high) / 2.0;
        (tau, self.at(tau).length)
    }

    /// The two τ, one each side of `peak`, at which the chord is `length` long.
    pub fn ends(&self, peak: f64, longest: f64, length: f64) -> (f64, f64) {
        let reach = (length / longest).clamp(0.0, 1.0).acos();
        let solve = |outer: f64| {
            let (mut inside, mut outside) = (peak, outer);
            let mut tau = (peak + reach * (outer - peak).signum()).clamp(-FRAC_PI_2, FRAC_PI_2);
            let h = 1e-6;
            for _ in 0..60 {
                let excess = self.at(tau).length - length;
                if excess > 0.0 {
                    inside = tau
                } else {
                    outside = tau
                }
                let slope = (self.at(tau + h).length - self.at(tau - h).length) / (2.0 * h);
                let mut next = tau - excess / slope;
                let (a, b) = (inside.min(outside), inside.max(outside));
                if !(next > a && next < b) {
                    next = (a + b) / 2.0;
                }
                let moved = (next - tau).abs();
                tau = next;
                if moved < 1e-11 {
                    break;
                }
            }
            tau
        };
        if length <= 0.0 {
            return (-FRAC_PI_2, FRAC_PI_2);
        }
        (solve(-FRAC_PI_2), solve(FRAC_PI_2))
    }
}

/// The parameter near `alpha` where y is extreme.
fn extreme(outline: &Outline, mut alpha: f64) -> f64 {
    for _ in 0..20 {
        let [_, d1, d2] = outline.at(alpha);
        let step = d1.y / d2.y;
        if !step.is_finite() {
            break;
        }
        alpha -= step.clamp(-0.2, 0.2);
        if step.abs() < 1e-15 {
            break;
        }
    }
    alpha
}

#[cfg(test)]
mod tests {
    use super::Chords;
    use crate::psf::outline::Outline;
    use glam::{DMat2, DVec2};

    #[test]
    fn chords_of_a_slanted_ellipse() {
        for flip in [1.0, -1.0] {
            let m = DMat2::from_cols(DVec2::new(2.0, 0.5), DVec2::new(0.3, 0.7 * flip));
            let chords = Chords::new(&Outline::circle().mapped(m, DVec2::new(3.0, -1.0)));
            let inverse = m.inverse();
            for tau in [-1.4, -0.5, 0.0, 0.9] {
                let c = chords.at(tau);
                for end in [-0.5, 0.5] {
                    let p = inverse * (DVec2::new(c.middle + end * c.length, c.y) - DVec2::new(3.0, -1.0));
                    assert!((p.length() - 1.0).abs() < 1e-10, "{tau} {end} {p}");
                }
            }
            let (peak, longest) = chords.longest();
            let (a, b) = chords.ends(peak, longest, 0.6 * longest);
            assert!((chords.at(a).length - 0.6 * longest).abs() < 1e-9 && a < peak && b > peak);
            assert!((chords.at(b).length - 0.6 * longest).abs() < 1e-9);
        }
    }
}
