//! Random-walk drift after Mergenthaler & Engbert 2007 (Phys. Rev. Lett. 98, 138104): a self-avoiding walk with delayed feedback.
//!
//! Per axis, steps of 1 ms: `w' = (1-γ) w - λ tanh(ε w(t-τ)) + N(0, 0.075)`, `x' = x + w' + N(0, 0.35)`, with the printed constants
//! γ = 0.25, λ = 0.15, ε = 1.1, τ = 70 ms horizontally and 40 ms vertically, in units of 0.5 arcmin. Two seconds of warm-up are dropped;
//! the walk starts on the fixated point.

use glam::DVec2;

use crate::math;
use crate::rng::{Purpose, Stream};

/// A step, s.
pub const STEP_S: f64 = 1e-3;
/// Steps before time 0.
const WARM_UP: usize = 2000;
const GAMMA: f64 = 0.25;
const LAMBDA: f64 = 0.15;
const EPSILON: f64 = 1.1;
/// Steps of delay, horizontal and vertical.
const DELAY: [usize; 2] = [70, 40];
/// Standard deviations of the noise on w and on x.
const NOISE: [f64; 2] = [0.075, 0.35];

/// A drawn walk.
#[derive(Clone, Debug)]
pub struct Walk {
    /// Places at whole steps, radians, from time 0.
    places: Vec<DVec2>,
}

impl Walk {
    /// Draws a walk of a unit (radians) for a duration.
    pub fn new(seed: u64, unit_radians: f64, duration_s: f64) -> Self {
        let steps = (duration_s / STEP_S).ceil() as usize + 2;
        let [x, y] = [0, 1].map(|axis| axis_walk(seed, axis, steps));
        Self { places: x.into_iter().zip(y).map(|(x, y)| unit_radians * DVec2::new(x, y)).collect() }
    }

    /// Place at a time, radians; linear within a step.
    pub fn at(&self, t_s: f64) -> DVec2 {
        let step = (t_s / STEP_S).max(0.0);
        let before = (step as usize).min(self.places.len() - 2);
        self.places[before].lerp(self.places[before + 1], (step - before as f64).min(1.0))
    }

    /// Whole steps between two times.
    pub fn bends(from_s: f64, to_s: f64) -> Vec<f64> {
        let (first, last) = ((from_s / STEP_S).floor() as u64, (to_s / STEP_S).ceil() as u64);
        (first..=last).map(|k| k as f64 * STEP_S).filter(|t| *t > from_s && *t < to_s).collect()
    }
}

fn axis_walk(seed: u64, axis: usize, steps: usize) -> Vec<f64> {
    let mut stream = Stream::new(seed, Purpose::Movement, 0, axis as u64);
    let delay = DELAY[axis];
    let mut w = vec![0.0; WARM_UP + steps];
    let mut x = 0.0;
    let mut places = Vec::with_capacity(steps);
    for k in 1..WARM_UP + steps {
        let (a, b) = stream.normal_pair();
        let delayed = if k > delay { w[k - 1 - delay] } else { 0.0 };
        w[k] = (1.0 - GAMMA) * w[k - 1] - LAMBDA * tanh(EPSILON * delayed) + NOISE[0] * a;
        if k == WARM_UP {
            x = 0.0;
            places.push(x);
        } else {
            x += w[k] + NOISE[1] * b;
            if k > WARM_UP {
                places.push(x);
            }
        }
    }
    places
}

/// Hyperbolic tangent with the same bits everywhere.
fn tanh(x: f64) -> f64 {
    let e = math::exp(-2.0 * x.abs());
    x.signum() * (1.0 - e) / (1.0 + e)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At short lags the walk diffuses with the step's own variance; the delayed feedback keeps long lags well below free diffusion.
    #[test]
    fn steps_have_the_stated_variance_and_long_walks_stay() {
        let walk = Walk::new(3, 1.0, 60.0);
        let variance = |lag: usize| {
            let n = walk.places.len() - lag;
            (0..n).map(|i| (walk.places[i + lag] - walk.places[i]).length_squared()).sum::<f64>()
                / n as f64
                / 2.0
        };
        // One step: 0.35² from x; w adds its own small variance (0.075² / (1 - 0.75²) and the feedback's).
        let one = variance(1);
        assert!(one > 0.35 * 0.35 && one < 0.35 * 0.35 + 0.04, "{one}");
        assert!(variance(10) < 400.0 * one, "{}", variance(10));
        assert!(walk.at(0.0) == DVec2::ZERO);
    }

    #[test]
    fn the_same_seed_gives_the_same_walk_of_any_length() {
        let (short, long) = (Walk::new(9, 1.0, 0.1), Walk::new(9, 1.0, 2.0));
        assert!(short.places[..] == long.places[..short.places.len()]);
        assert!(short.at(0.05) != Walk::new(10, 1.0, 0.1).at(0.05));
    }

    #[test]
    fn tanh_is_tanh() {
        for x in [-3.0_f64, -1e-3, 0.0, 0.5, 40.0] {
            assert!((tanh(x) - x.tanh()).abs() < 1e-15);
        }
    }
}
