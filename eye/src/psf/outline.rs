//! The edge of the pupil: a closed curve x(α), y(α) as Fourier series, α the azimuth in the real stop.

use super::sincos::sin_cos_turns;
use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A closed curve. Harmonic m is (cosine, sine) coefficients of x and y; harmonic 0 is the centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// (cosine part, sine part) of each harmonic.
    pub harmonics: Vec<(DVec2, DVec2)>,
}

/// Harmonics smaller than this, relative to a pupil of radius 1, are dropped.
const NEGLIGIBLE: f64 = 1e-11;

impl Outline {
    /// Through points at uniform parameter 2πk/n; harmonics below n/2.
    pub fn through(points: &[DVec2]) -> Self {
        let n = points.len();
        let top = n.div_ceil(2);
        let turn: Vec<(f64, f64)> = (0..n).map(|k| (TAU * k as f64 / n as f64).sin_cos()).collect();
        let mut harmonics: Vec<(DVec2, DVec2)> = (0..top)
            .map(|m| {
                let (mut cos, mut sin) = (DVec2::ZERO, DVec2::ZERO);
                for (k, p) in points.iter().enumerate() {
                    let (s, c) = turn[k * m % n];
                    cos += *p * c;
                    sin += *p * s;
                }
                let norm = if m == 0 { 1.0 } else { 2.0 } / n as f64;
                (cos * norm, sin * norm)
            })
            .collect();
        while harmonics.len() > 2
            && harmonics.last().is_some_and(|(c, s)| c.length() + s.length() < NEGLIGIBLE)
        {
            harmonics.pop();
        }
        Self { harmonics }
    }

    /// The unit circle.
    pub fn circle() -> Self {
        Self { harmonics: vec![(DVec2::ZERO, DVec2::ZERO), (DVec2::X, DVec2::Y)] }
    }

    /// The curve mapped by p → m p + offset.
    pub fn mapped(&self, m: DMat2, offset: DVec2) -> Self {
        let mut harmonics: Vec<_> = self.harmonics.iter().map(|(c, s)| (m * *c, m * *s)).collect();
        if let Some(first) = harmonics.first_mut() {
            first.0 += offset;
        }
        Self { harmonics }
    }

    /// Point, first and second derivative at parameter `alpha`.
    pub fn at(&self, alpha: f64) -> [DVec2; 3] {
        let (sin1, cos1) = sin_cos_turns(alpha / TAU);
        let (mut sin, mut cos) = (0.0, 1.0);
        let mut out = [DVec2::ZERO; 3];
        for (m, (c, s)) in self.harmonics.iter().enumerate() {
            let m = m as f64;
            let value = *c * cos + *s * sin;
            out[0] += value;
            out[1] += (*s * cos - *c * sin) * m;
            out[2] -= value * (m * m);
            (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
        }
        out
    }
}
