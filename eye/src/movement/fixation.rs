//! The small movements of fixation on top of a drift (§11): tremor and microsaccades.
//!
//! Tremor: per axis 8 sines of equal power, one in each eighth of the band, with random frequency and phase. Microsaccades: at random
//! (Poisson) times, each within its duration along a straight line with the minimum-jerk profile `10s³ - 15s⁴ + 6s⁵`; the amplitude is
//! uniform in its logarithm, the direction random in the half plane that leads back to the fixated point.

use glam::DVec2;

use super::radians;
use crate::experiment;
use crate::math;
use crate::rng::{Purpose, Stream};

const LINES: usize = 8;

/// Drawn tremor.
#[derive(Clone, Debug)]
pub struct Tremor {
    amplitude: f64,
    highest_hz: f64,
    /// `[axis][line]`: frequency (Hz), phase (turns).
    lines: [[(f64, f64); LINES]; 2],
}

impl Tremor {
    /// Draws the lines.
    pub fn new(spec: &experiment::Tremor, seed: u64) -> Self {
        let step = (spec.to_hz - spec.from_hz) / LINES as f64;
        let axis = |axis: u64| {
            let mut stream = Stream::new(seed, Purpose::Movement, 1, axis);
            std::array::from_fn(|i| (spec.from_hz + step * (i as f64 + stream.uniform()), stream.uniform()))
        };
        // The mean square of a sum of n sines of amplitude a is n a²/2.
        let amplitude = radians(spec.rms_arcmin) * (2.0 / LINES as f64).sqrt();
        Self { amplitude, highest_hz: spec.to_hz, lines: [axis(0), axis(1)] }
    }

    /// Displacement at a time, radians.
    pub fn at(&self, t_s: f64) -> DVec2 {
        let sum = |lines: &[(f64, f64); LINES]| {
            lines
                .iter()
                .map(|(hz, phase)| math::sin_cos(std::f64::consts::TAU * (hz * t_s + phase).fract()).0)
                .sum::<f64>()
        };
        self.amplitude * DVec2::new(sum(&self.lines[0]), sum(&self.lines[1]))
    }

    /// Times between two times, a quarter of the shortest period apart, so that no swing is missed.
    pub fn bends(&self, from_s: f64, to_s: f64) -> Vec<f64> {
        let step = 0.25 / self.highest_hz;
        let (first, last) = ((from_s / step).floor() as u64, (to_s / step).ceil() as u64);
        (first..=last).map(|k| k as f64 * step).filter(|t| *t > from_s && *t < to_s).collect()
    }
}

/// One microsaccade.
#[derive(Clone, Copy, Debug)]
pub struct Saccade {
    /// Start, s.
    pub start_s: f64,
    /// End, s.
    pub end_s: f64,
    jump: DVec2,
}

/// Draws the microsaccades of a duration over a base path (radians at a time in s).
pub fn saccades(
    spec: &experiment::Microsaccades,
    seed: u64,
    duration_s: f64,
    base: impl Fn(f64) -> DVec2,
) -> Vec<Saccade> {
    let mut stream = Stream::new(seed, Purpose::Movement, 2, 0);
    let [least, most] = [spec.from_arcmin, spec.to_arcmin].map(|a| math::ln(radians(a)));
    let length_s = spec.duration_ms * 1e-3;
    let mut found: Vec<Saccade> = Vec::new();
    let mut start_s = 0.0;
    let mut jumped = DVec2::ZERO;
    if spec.rate_hz <= 0.0 {
        return found;
    }
    loop {
        start_s += -math::ln(1.0 - stream.uniform()) / spec.rate_hz;
        if start_s >= duration_s {
            return found;
        }
        let size = math::exp(least + (most - least) * stream.uniform());
        let (sin, cos) = math::sin_cos(std::f64::consts::TAU * stream.uniform());
        let mut jump = size * DVec2::new(cos, sin);
        if jump.dot(base(start_s) + jumped) > 0.0 {
            jump = -jump;
        }
        jumped += jump;
        found.push(Saccade { start_s, end_s: start_s + length_s, jump });
        // The next one waits for the end of this one.
        start_s += length_s;
    }
}

/// Sum of all jumps at a time, radians.
pub fn jumped(saccades: &[Saccade], t_s: f64) -> DVec2 {
    let part = |s: &Saccade| {
        let x = ((t_s - s.start_s) / (s.end_s - s.start_s)).clamp(0.0, 1.0);
        s.jump * (x * x * x * (10.0 - 15.0 * x + 6.0 * x * x))
    };
    saccades.iter().take_while(|s| s.start_s < t_s).map(part).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tremor_has_the_stated_size() {
        let spec = experiment::Tremor { rms_arcmin: 0.4, from_hz: 30.0, to_hz: 100.0 };
        let tremor = Tremor::new(&spec, 5);
        let n = 200_000;
        let square: f64 = (0..n).map(|i| tremor.at(f64::from(i) * 1e-3 * 0.37).length_squared()).sum::<f64>()
            / f64::from(n);
        // Two axes; the mean over 74 s of sines that are not in step is exact to a fraction of a percent.
        assert!((square.sqrt() / radians(0.4) / 2_f64.sqrt() - 1.0).abs() < 0.01, "{square}");
    }

    #[test]
    fn microsaccades_come_at_their_rate_and_lead_back() {
        let spec = experiment::Microsaccades { rate_hz: 2.0, ..experiment::Microsaccades::default() };
        let found = saccades(&spec, 1, 1000.0, |_| DVec2::ZERO);
        // Poisson with a pause of 25 ms: mean interval 0.525 s; sd of the count about √1905·0.95: 4 sd (alpha 6e-5).
        let expected = 1000.0 / (0.5 + 0.025);
        assert!((found.len() as f64 - expected).abs() < 4.0 * expected.sqrt(), "{}", found.len());
        let mut at = DVec2::ZERO;
        for saccade in &found {
            assert!(saccade.jump.dot(at) <= 0.0);
            at += saccade.jump;
            let size = saccade.jump.length();
            assert!(size >= radians(10.0) * 0.999 && size <= radians(60.0) * 1.001);
        }
        assert!((jumped(&found, 2000.0) - at).length() < 1e-12);
        assert!(jumped(&found, found[0].start_s) == DVec2::ZERO);
    }
}
