//! A convex outline cut into chords of constant y.
//!
//! y = y_mid + y_half·sin τ; the right end of the chord is x(τ), |τ| ≤ π/2, the left end x(π − τ). In τ both ends are
//! smooth (in y they end in square roots), so x(τ) is one short Fourier series.

use super::outline::Outline;
use super::sincos::sin_cos_turns;
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
        let (middle, half) = (f64::midpoint(y_top, y_bottom), (y_top - y_bottom) / 2.0);
        let way =
            if outline.at(top - FRAC_PI_2)[0].x > outline.at(top + FRAC_PI_2)[0].x { 1.0 } else { -1.0 };
        let rise = (way * (top - bottom)).rem_euclid(TAU);
        // x at parameters τ half a step off the top and bottom, where α(τ) is solved well.
        let n = (4 * (outline.harmonics.len() + 1)).clamp(12, 256);
        let step = TAU / n as f64;
        let samples: Vec<f64> = (0..n)
            .map(|k| {
                let tau = (k as f64 + 0.5) * step - FRAC_PI_2;
                // The right branch runs from the bottom up to the top, the left one on down to the bottom.
                let right = tau < FRAC_PI_2;
                let (from, to) =
                    if right { (top - way * rise, top) } else { (top, top + way * (TAU - rise)) };
                let part = if right { (tau + FRAC_PI_2) / PI } else { (tau - FRAC_PI_2) / PI };
                let alpha = crossing(outline, from, to, part, middle + half * tau.sin());
                outline.at(alpha)[0].x
            })
            .collect();
        let mut series: Vec<(f64, f64)> = (0..n / 2)
            .map(|m| {
                let (mut c, mut s) = (0.0, 0.0);
                for (k, x) in samples.iter().enumerate() {
                    let (sin, cos) = sin_cos_turns(m as f64 * ((k as f64 + 0.5) / n as f64 - 0.25));
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
        let (sin1, cos1) = sin_cos_turns(tau / TAU);
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

    /// Chords and weights that integrate over y: ∫ f dy = Σ w·f for f that vanishes at both ends as the chord's length
    /// does. In τ such an integrand is periodic and the trapezoidal rule is as good as Gauss's.
    pub fn rule(&self, nodes: usize) -> Vec<(Chord, f64)> {
        let step = PI / (nodes as f64 + 1.0);
        (1..=nodes)
            .map(|k| {
                let chord = self.at(k as f64 * step - FRAC_PI_2);
                (chord, step * chord.slope)
            })
            .collect()
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
        let tau = f64::midpoint(low, high);
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
                    inside = tau;
                } else {
                    outside = tau;
                }
                let slope = (self.at(tau + h).length - self.at(tau - h).length) / (2.0 * h);
                let step = excess / slope;
                // The overlap vanishes at its ends: an error here counts by its square.
                if step.abs() < 1e-8 {
                    return tau - step;
                }
                let mut next = tau - step;
                let (a, b) = (inside.min(outside), inside.max(outside));
                if !(next > a && next < b) {
                    next = f64::midpoint(a, b);
                }
                tau = next;
            }
            tau
        };
        if length <= 0.0 {
            return (-FRAC_PI_2, FRAC_PI_2);
        }
        (solve(-FRAC_PI_2), solve(FRAC_PI_2))
    }
}

/// The parameter between `from` and `to`, where y is monotonic, at which y is `wanted`; Newton's method kept inside.
fn crossing(outline: &Outline, from: f64, to: f64, part: f64, wanted: f64) -> f64 {
    let rising = outline.at(to)[0].y > outline.at(from)[0].y;
    let (mut before, mut after) = (from, to);
    let mut alpha = from + part * (to - from);
    for _ in 0..60 {
        let [p, d, _] = outline.at(alpha);
        let excess = p.y - wanted;
        if (excess > 0.0) == rising {
            after = alpha;
        } else {
            before = alpha;
        }
        let step = excess / d.y;
        if step.abs() < 1e-13 {
            return alpha - step;
        }
        let mut next = alpha - step;
        if !(next > before.min(after) && next < before.max(after)) {
            next = f64::midpoint(before, after);
        }
        alpha = next;
    }
    alpha
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
            assert!((chords.at(a).length - 0.6 * longest).abs() < 1e-7 && a < peak && b > peak);
            assert!((chords.at(b).length - 0.6 * longest).abs() < 1e-7);
        }
    }
}
