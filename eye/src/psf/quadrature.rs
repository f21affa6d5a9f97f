//! Gauss–Legendre nodes and weights on [−1, 1], by Newton's method on the three-term recurrence.

use std::f64::consts::PI;

/// Nodes with their weights.
pub type Rule = Vec<(f64, f64)>;

/// The n nodes, rising, with their weights; they integrate polynomials of degree 2n − 1 exactly.
pub fn gauss_legendre(n: usize) -> Rule {
    let mut rule = vec![(0.0, 2.0); n];
    if n < 2 {
        return rule;
    }
    for i in 0..n.div_ceil(2) {
        let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..12 {
            let (mut p0, mut p1) = (1.0, x);
            for k in 2..=n {
                let k = k as f64;
                (p0, p1) = (p1, ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k);
            }
            slope = n as f64 * (x * p1 - p0) / (x * x - 1.0);
            let step = p1 / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        let weight = 2.0 / ((1.0 - x * x) * slope * slope);
        rule[n - 1 - i] = (x, weight);
        rule[i] = (-x, weight);
    }
    if n % 2 == 1 {
        rule[n / 2].0 = 0.0;
    }
    rule
}

/// Rules that were asked for, kept for the next time.
#[derive(Clone, Debug, Default)]
pub struct Rules(Vec<Rule>);

impl Rules {
    /// The rules of `first` and `second` nodes.
    pub fn pair(&mut self, first: usize, second: usize) -> (&Rule, &Rule) {
        if self.0.len() <= first.max(second) {
            self.0.resize(first.max(second) + 1, Vec::new());
        }
        for nodes in [first, second] {
            if self.0[nodes].is_empty() {
                self.0[nodes] = gauss_legendre(nodes);
            }
        }
        (&self.0[first], &self.0[second])
    }
}

#[cfg(test)]
mod tests {
    use super::gauss_legendre;

    #[test]
    fn integrates_even_powers_exactly() {
        for n in [1, 2, 5, 8, 33, 120] {
            for power in (0..2 * n.min(20)).step_by(2) {
                let sum: f64 = gauss_legendre(n).iter().map(|(x, w)| w * x.powi(power as i32)).sum();
                assert!((sum - 2.0 / (power as f64 + 1.0)).abs() < 1e-13, "n {n} power {power}: {sum}");
            }
        }
    }
}
