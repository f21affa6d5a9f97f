//! Poisson draws: one number per cone and frame from its own stream, so that a count depends on (seed, frame, cone id, mean) only.

use rand_distr::{Distribution, Poisson};

use crate::rng::{Purpose, Stream};

/// A Poisson number of mean `mean` for a cone in a frame. A mean of 0 or below gives 0; above the largest count it is clamped,
/// which the caller counts.
pub fn draw(seed: u64, frame: u32, cone_id: u64, mean: f64) -> u32 {
    let mut stream = Stream::new(seed, Purpose::Counts, u64::from(frame), cone_id);
    from_stream(&mut stream, mean).min(f64::from(u32::MAX)) as u32
}

/// The next Poisson number of a stream, as a whole f64; 0 for a mean that is not positive.
pub fn from_stream(stream: &mut Stream, mean: f64) -> f64 {
    Poisson::new(mean).map_or(0.0, |poisson| poisson.sample(stream))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and variance of 200,000 draws at several means; each check is 5 standard errors wide (alpha 6e-7 a check).
    #[test]
    fn mean_and_variance() {
        for mean in [0.03, 1.0, 9.7, 30.0, 4000.0] {
            let n = 200_000_u32;
            let draws: Vec<f64> = (0..n).map(|i| f64::from(draw(7, 3, u64::from(i), mean))).collect();
            let m = draws.iter().sum::<f64>() / f64::from(n);
            let v = draws.iter().map(|d| (d - m).powi(2)).sum::<f64>() / f64::from(n - 1);
            assert!((m - mean).abs() < 5.0 * (mean / f64::from(n)).sqrt(), "{mean}: mean {m}");
            let fourth = mean * (1.0 + 3.0 * mean) - mean * mean;
            assert!((v - mean).abs() < 5.0 * (fourth / f64::from(n)).sqrt(), "{mean}: variance {v}");
        }
    }

    #[test]
    fn extremes() {
        assert_eq!(draw(1, 0, 0, 0.0), 0);
        assert_eq!(draw(1, 0, 0, -1e-9), 0);
        assert_eq!(draw(1, 0, 0, 1e-12), 0);
        assert_eq!(draw(1, 0, 0, 1e18), u32::MAX);
    }
}
