//! What a few cones say of all: the relative L1 error with two bounds; each is on the wrong side once in twenty audits.
//!
//! With x_j = |value − reference|/q and y_j the total of the sample's frame and tile, `R = Σx/Σy` is a ratio of
//! means; its standard error s is that of the residuals x − R·y (Cochran, Sampling Techniques, 6.4). Bounds are
//! one-sided by Student's t:
//!   upper   R + t·s
//!   lower   max(0, R − C − t·s), C the part of R that chance gives where photons are drawn
//! Few samples of a skewed distribution: bounds are approximate, and with fewer than three samples there are none.

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
    /// Chance aside not below this, with a confidence of 95 %; none with fewer than three cones.
    pub lower_bound_95: Option<f64>,
    /// The part of it that chance alone gives where the engine draws photons: E|N − m| a cone of mean m.
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
    let margin = (degrees >= 2).then(|| {
        let t = T95.get(degrees - 2).copied().unwrap_or(1.645 + 1.6 / degrees as f64);
        t * (squares / degrees as f64 / n).sqrt() / (total / n)
    });
    let by_chance = if drawn {
        let chance = |s: &AuditSample| poisson_deviation(s.reference.max(0.0)) / s.probability;
        samples.iter().map(chance).sum::<f64>() / total
    } else {
        0.0
    };
    Some(Verdict {
        cones: samples.len() as u32,
        relative_error,
        bound_95: margin.map(|margin| relative_error + margin),
        lower_bound_95: margin.map(|margin| (relative_error - by_chance - margin).max(0.0)),
        by_chance,
    })
}

/// Mean absolute deviation E|N − m| of a Poisson number N of mean m.
///
/// 2·m^(k+1)·e^(−m)/k! with k = ⌊m⌋ (Johnson, Kemp and Kotz, Univariate Discrete Distributions, 4.3); above a mean
/// of 100 √(2m/π), which is larger by 1/(12·m) at most.
fn poisson_deviation(mean: f64) -> f64 {
    if mean > 100.0 {
        return (mean * std::f64::consts::FRAC_2_PI).sqrt();
    }
    (1..=mean as u32).fold(2.0 * mean * (-mean).exp(), |term, i| term * mean / f64::from(i))
}

impl Verdict {
    /// One sentence for people when the error is above a target with a confidence of 95 %.
    pub fn warning(&self, target: f64) -> Option<String> {
        let lower = self.lower_bound_95.filter(|lower| *lower > target)?;
        let chance = match self.by_chance {
            chance if chance > 0.0 => format!(", of which photon noise explains {chance:.1e}"),
            _ => String::new(),
        };
        Some(format!(
            "accuracy: {} cones computed again show a relative error of {:.1e}{chance} (at least {lower:.1e} with \
             95 % confidence), above accuracy.target {target}",
            self.cones, self.relative_error
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    /// Audits of 16 cones of 1000, chosen with a probability that rises with their light.
    fn audits(stream: &mut Stream, cones: &[(f64, f64)], count: usize, drawn: bool) -> Vec<Verdict> {
        let total: f64 = cones.iter().map(|c| c.0).sum();
        let q = |m: f64| 0.5 * (m / total + 1e-3);
        let mut sample = || {
            let mut left = stream.uniform();
            let i = (0..999).find(|i| {
                left -= q(cones[*i].0);
                left <= 0.0
            });
            let (value, reference) = cones[i.unwrap_or(999)];
            AuditSample { frame: 0, tile: 0, cone: 0, value, reference, probability: q(value), total }
        };
        (0..count).map(|_| verdict(&(0..16).map(|_| sample()).collect::<Vec<_>>(), drawn).unwrap()).collect()
    }

    /// Errors of 1 % on average over 1000 cones of very different light: the estimate is right on average, and
    /// each bound is kept in about 95 of 100 audits (at least 88: skewed, and 400 audits have a standard error of
    /// 1.1).
    #[test]
    fn the_bounds_are_kept() {
        let mut stream = Stream::new(3, Purpose::Study, 0, 0);
        let cones: Vec<(f64, f64)> = (0..1000)
            .map(|i| {
                let mean = if i % 10 == 0 { 100.0 } else { 2.0 };
                (mean, mean * (1.0 + 0.02 * (stream.uniform() - 0.5)) + 0.01 * (stream.uniform() - 0.5))
            })
            .collect();
        let total: f64 = cones.iter().map(|c| c.0).sum();
        let truth = cones.iter().map(|(m, r)| (m - r).abs()).sum::<f64>() / total;
        let found = audits(&mut stream, &cones, 400, false);
        let below = found.iter().filter(|found| found.bound_95.unwrap() >= truth).count();
        let above = found.iter().filter(|found| found.lower_bound_95.unwrap() <= truth).count();
        let mean = found.iter().map(|found| found.relative_error / 400.0).sum::<f64>();
        assert!(below >= 352 && above >= 352, "{below} and {above} of 400");
        assert!((mean / truth - 1.0).abs() < 0.05, "{mean} {truth}");
    }

    /// Errors of 5 % on average: 16 cones say nearly always that a target of 0.5 % is missed.
    #[test]
    fn a_large_error_is_found() {
        let mut stream = Stream::new(5, Purpose::Study, 0, 0);
        let cones: Vec<(f64, f64)> =
            (0..1000).map(|_| (10.0, 10.0 * (1.0 + 0.2 * (stream.uniform() - 0.5)))).collect();
        let found = audits(&mut stream, &cones, 100, false);
        let warned = found.iter().filter(|found| found.warning(0.005).is_some()).count();
        assert!(warned >= 99, "{warned} of 100");
    }

    /// A count by waiting times.
    fn poisson(stream: &mut Stream, mean: f64) -> f64 {
        let (mut count, mut time) = (-1.0, 0.0);
        while time < mean {
            time -= (1.0 - stream.uniform()).ln();
            count += 1.0;
        }
        count
    }

    /// Against the sum over the distribution; above 100 a formula of one term is good to 2e-3.
    #[test]
    fn deviation_of_counts() {
        for mean in [0.0, 0.01, 0.6, 1.0, 1.5, 7.3, 99.9, 100.0, 100.5, 300.2] {
            let mut chance = f64::exp(-mean);
            let mut sum = 0.0;
            for count in 0..1000 {
                sum += chance * (f64::from(count) - mean).abs();
                chance *= mean / f64::from(count + 1);
            }
            let tolerance = if mean > 100.0 { 2e-3 * sum } else { 1e-12 * (1.0 + sum) };
            assert!((poisson_deviation(mean) - sum).abs() <= tolerance, "{mean}: {sum}");
        }
    }

    /// Photons that are drawn from the right means: their noise alone exceeds a target of 1e-3 in one of twenty
    /// audits at most, so that nobody is warned of photon noise.
    #[test]
    fn photon_noise_is_no_error() {
        let mut stream = Stream::new(4, Purpose::Study, 0, 0);
        let cones: Vec<(f64, f64)> = (0..1000)
            .map(|i| {
                let mean = if i % 10 == 0 { 100.0 } else { 0.6 };
                (poisson(&mut stream, mean), mean)
            })
            .collect();
        let found = audits(&mut stream, &cones, 400, true);
        let warned = found.iter().filter(|found| found.warning(1e-3).is_some()).count();
        // 20 are expected, with a standard deviation of 4.4.
        assert!(warned <= 33, "{warned} of 400");
        assert!(found.iter().all(|found| found.lower_bound_95.unwrap() >= 0.0));
    }

    #[test]
    fn a_warning_says_its_figures() {
        let samples = |count: usize| -> Vec<AuditSample> {
            let sample = |value: f64| AuditSample {
                frame: 0,
                tile: 0,
                cone: 0,
                value,
                reference: 10.0,
                probability: 1.0,
                total: 10.0,
            };
            (0..count).map(|i| sample(if i % 2 == 0 { 10.02 } else { 10.03 })).collect()
        };
        let found = verdict(&samples(6), false).unwrap();
        // Errors of 2e-3 and 3e-3 of the total in turn: mean 2.5e-3, deviation sqrt(6·(0.5e-3)²/5), t = 2.015.
        let lower = 2.5e-3 - 2.015 * (6.0 * 0.25e-6 / 5.0 / 6.0_f64).sqrt();
        assert!((found.lower_bound_95.unwrap() - lower).abs() < 1e-12, "{found:?} {lower}");
        assert_eq!(found.warning(lower + 1e-9), None);
        assert_eq!(
            found.warning(1e-3).unwrap(),
            "accuracy: 6 cones computed again show a relative error of 2.5e-3 (at least 2.0e-3 with 95 % confidence), \
             above accuracy.target 0.001"
        );
        let few = verdict(&samples(2), false).unwrap();
        assert_eq!((few.bound_95, few.lower_bound_95, few.warning(1e-9)), (None, None, None));
    }

    #[test]
    fn no_light_no_verdict() {
        assert_eq!(verdict(&[], false), None);
    }
}
