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

/// Chebyshev nodes in each of the pieces into which kinks cut a range: what is smooth between the kinks is
/// interpolated well.
#[derive(Clone, Debug, PartialEq)]
pub struct PiecewiseNodes {
    /// Inner ends of the pieces, increasing.
    kinks: Vec<f64>,
    pieces: Vec<Vec<f64>>,
}

impl PiecewiseNodes {
    /// `n` nodes a piece of [min, max].
    pub fn new(min: f64, max: f64, kinks: &[f64], n: usize) -> Self {
        let mut kinks: Vec<f64> = kinks.iter().copied().filter(|kink| *kink > min && *kink < max).collect();
        kinks.sort_by(f64::total_cmp);
        kinks.dedup();
        let ends: Vec<f64> = [min].into_iter().chain(kinks.iter().copied()).chain([max]).collect();
        let pieces = ends.windows(2).map(|ends| chebyshev(ends[0], ends[1], n)).collect();
        Self { kinks, pieces }
    }

    /// All nodes, increasing.
    pub fn values(&self) -> Vec<f64> {
        self.pieces.concat()
    }

    /// Weights of all nodes at x: those of other pieces are 0.
    pub fn weights(&self, x: f64) -> Vec<f64> {
        let own = self.kinks.partition_point(|kink| *kink < x);
        let of_piece = |(piece, nodes): (usize, &Vec<f64>)| {
            if piece == own { lagrange(nodes, x) } else { vec![0.0; nodes.len()] }
        };
        self.pieces.iter().enumerate().flat_map(of_piece).collect()
    }
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

    #[test]
    fn a_kinked_line_is_exact_on_two_nodes_a_piece() {
        let nodes = PiecewiseNodes::new(8.0, 12.0, &[5.0, 10.0, 13.0], 2);
        let f = |x: f64| x.min(10.0);
        for x in [7.9, 8.0, 9.99, 10.0, 10.01, 12.0] {
            let made: f64 = nodes.weights(x).iter().zip(nodes.values()).map(|(w, n)| w * f(n)).sum();
            assert!((made - f(x)).abs() < 1e-12, "{x} {made}");
        }
    }
}
