//! Chebyshev nodes and Lagrange interpolation in one variable.

/// Chebyshev nodes of the first kind in [min, max], increasing; one node is the middle.
pub fn chebyshev(min: f64, max: f64, n: usize) -> Vec<f64> {
    let (middle, half) = (0.5 * (min + max), 0.5 * (max - min));
    (0..n)
        .map(|i| middle - half * (std::f64::consts::PI * (2 * i + 1) as f64 / (2 * n) as f64).cos())
        .collect()
}

/// Lagrange weights of the nodes at x.
pub fn lagrange(nodes: &[f64], x: f64) -> Vec<f64> {
    (0..nodes.len())
        .map(|i| {
            let others = nodes.iter().enumerate().filter(|(j, _)| *j != i);
            others.map(|(_, node)| (x - node) / (nodes[i] - node)).product()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubics_are_exact_on_four_nodes() {
        let nodes = chebyshev(-1.0, 3.0, 4);
        let f = |x: f64| 2.0 - x + 0.5 * x.powi(3);
        let made: f64 = lagrange(&nodes, 2.7).iter().zip(&nodes).map(|(w, n)| w * f(*n)).sum();
        assert!((made - f(2.7)).abs() < 1e-12);
        assert_eq!(lagrange(&chebyshev(0.0, 2.0, 1), 1.7), vec![1.0]);
    }
}
