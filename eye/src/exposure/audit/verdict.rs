//! What a few cones say of all: the relative L1 error with a bound that it exceeds once in twenty audits.
//!
//! With x_j = |value − reference|/q and y_j the total of the sample's frame and tile, `R = Σx/Σy` is a ratio of means; its standard error is
//! that of the residuals x − R·y (Cochran, Sampling Techniques, 6.4), the bound one-sided by Student's t. Few samples of a skewed
//! distribution: the bound is approximate, and with fewer than three there is none.

use serde::{Deserialize, Serialize};

use super::AuditSample;

/// Student's t, one-sided 95 %, for 2, 3, … degrees of freedom; then the normal's.
const T95: [f64; 10] = [2.920, 2.353, 2.132, 2.015, 1.943, 1.895, 1.860, 1.833, 1.812, 1.796];

/// What an audit found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Cones that were computed again.
    pub cones: u32,
    /// Relative error of the mean per cone, L1 over cones.
    pub relative_error: f64,
    /// Not above this, with a confidence of 95 %; none with fewer than three cones.
    pub bound_95: Option<f64>,
    /// The part of it that chance alone gives where the engine draws photons: √(2m/π) a cone of mean m.
    pub by_chance: f64,
}

/// Judges samples; `drawn` says that values are counts and not means. `None` without samples or light.
pub fn verdict(samples: &[AuditSample], drawn: bool) -> Option<Verdict> {
    let n = samples.len() as f64;
    let total: f64 = samples.iter().map(|s| s.total).sum();
    if total <= 0.0 {
        return None;
    }
    let sizes: Vec<f64> = samples.iter().map(|s| (s.value - s.reference).abs() / s.probability).collect();
    let relative_error = sizes.iter().sum::<f64>() / total;
    let residual = |(x, s): (&f64, &AuditSample)| (x - relative_error * s.total).powi(2);
    let squares: f64 = sizes.iter().zip(samples).map(residual).sum();
    let degrees = samples.len().saturating_sub(1);
    let bound_95 = (degrees >= 2).then(|| {
        let t = T95.get(degrees - 2).copied().unwrap_or(1.645 + 1.6 / degrees as f64);
        relative_error + t * (squares / degrees as f64 / n).sqrt() / (total / n)
    });
    let by_chance = if drawn {
        let chance =
            |s: &AuditSample| (s.reference.max(0.0) * std::f64::consts::FRAC_2_PI).sqrt() / s.probability;
        samples.iter().map(chance).sum::<f64>() / total
    } else {
        0.0
    };
    Some(Verdict { cones: samples.len() as u32, relative_error, bound_95, by_chance })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    /// Errors of 1 % on average over 1000 cones of very different light: the estimate is right on average, and the bound is kept in about
    /// 95 of 100 audits (at least 88: skewed, and 400 audits have a standard error of 1.1).
    #[test]
    fn the_bound_is_kept() {
        let mut stream = Stream::new(3, Purpose::Study, 0, 0);
        let cones: Vec<(f64, f64)> = (0..1000)
            .map(|i| {
                let mean = if i % 10 == 0 { 100.0 } else { 2.0 };
                (mean, mean * (1.0 + 0.02 * (stream.uniform() - 0.5)) + 0.01 * (stream.uniform() - 0.5))
            })
            .collect();
        let total: f64 = cones.iter().map(|c| c.0).sum();
        let truth = cones.iter().map(|(m, r)| (m - r).abs()).sum::<f64>() / total;
        let (mut kept, mut mean) = (0, 0.0);
        for _ in 0..400 {
            let samples: Vec<AuditSample> = (0..16)
                .map(|_| {
                    let mut left = stream.uniform();
                    let q = |m: f64| 0.5 * (m / total + 1e-3);
                    let i = (0..999).find(|i| {
                        left -= q(cones[*i].0);
                        left <= 0.0
                    });
                    let (value, reference) = cones[i.unwrap_or(999)];
                    let probability = q(value);
                    AuditSample { frame: 0, tile: 0, cone: 0, value, reference, probability, total }
                })
                .collect();
            let found = verdict(&samples, false).unwrap();
            kept += i32::from(found.bound_95.unwrap() >= truth);
            mean += found.relative_error / 400.0;
        }
        assert!(kept >= 352, "{kept} of 400");
        assert!((mean / truth - 1.0).abs() < 0.05, "{mean} {truth}");
    }

    #[test]
    fn no_light_no_verdict() {
        assert_eq!(verdict(&[], false), None);
    }
}
