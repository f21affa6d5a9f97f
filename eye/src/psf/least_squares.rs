//! Weighted least squares of polynomials to scattered samples, several right-hand sides at once: Householder QR, which
//! keeps full accuracy in the fitted values although monomials are badly conditioned.

use super::polynomial::{Polynomial2, count, monomials};
use glam::DVec2;

/// The triangularized design of one set of points; any number of right-hand sides can be solved with it.
#[derive(Clone, Debug)]
pub struct LeastSquares {
    degree: usize,
    roots: Vec<f64>,
    /// Column k: the triangle above row k, the reflecting vector from row k on.
    columns: Vec<f64>,
    squares: Vec<f64>,
    diagonal: Vec<f64>,
}

impl LeastSquares {
    /// The design of polynomials of a degree over points whose squared errors count by `weights`.
    pub fn new(degree: usize, points: &[DVec2], weights: &[f64]) -> Self {
        let m = points.len();
        let mut columns = vec![0.0; m * count(degree)];
        for (row, p) in points.iter().enumerate() {
            monomials(degree, *p, |k, value| columns[k * m + row] = value);
        }
        Self { degree, ..Self::from_columns(columns, weights) }
    }

    /// The design whose unknowns have the given columns, one after the other, each with one value a weight.
    pub fn from_columns(mut columns: Vec<f64>, weights: &[f64]) -> Self {
        let m = weights.len();
        let n = columns.len() / m.max(1);
        let roots: Vec<f64> = weights.iter().map(|w| w.sqrt()).collect();
        for column in columns.chunks_exact_mut(m.max(1)) {
            column.iter_mut().zip(&roots).for_each(|(value, root)| *value *= root);
        }
        let (mut diagonal, mut squares) = (vec![0.0; n], vec![0.0; n]);
        for k in 0..n.min(m) {
            let (left, right) = columns.split_at_mut((k + 1) * m);
            let v = &mut left[k * m + k..];
            let norm = dot(v, v).sqrt();
            diagonal[k] = if v[0] > 0.0 { -norm } else { norm };
            v[0] -= diagonal[k];
            squares[k] = dot(v, v);
            for other in right.chunks_exact_mut(m) {
                reflect(v, squares[k], &mut other[k..]);
            }
        }
        Self { degree: 0, roots, columns, squares, diagonal }
    }

    /// The polynomial nearest to one value a point. A column that adds nothing gets coefficient 0.
    pub fn fit(&self, values: impl Iterator<Item = f64>) -> Polynomial2 {
        Polynomial2::new(self.degree, self.solve(values))
    }

    /// The unknowns that come nearest to one value a point.
    pub fn solve(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let (m, n) = (self.roots.len(), self.diagonal.len());
        let mut side: Vec<f64> = values.zip(&self.roots).map(|(v, root)| v * root).collect();
        side.resize(m, 0.0);
        let used = n.min(m);
        for k in 0..used {
            reflect(&self.columns[k * m + k..(k + 1) * m], self.squares[k], &mut side[k..]);
        }
        // Solve the triangle backwards, column by column.
        let least = 1e-13 * self.diagonal.iter().fold(0.0_f64, |a, d| a.max(d.abs()));
        let mut c = vec![0.0; n];
        for k in (0..used).rev() {
            if self.diagonal[k].abs() > least {
                c[k] = side[k] / self.diagonal[k];
                for (above, r) in side.iter_mut().zip(&self.columns[k * m..k * m + k]) {
                    *above -= r * c[k];
                }
            }
        }
        c
    }
}

fn reflect(v: &[f64], square: f64, other: &mut [f64]) {
    if square <= 0.0 {
        return;
    }
    let factor = 2.0 * dot(v, other) / square;
    for (o, v) in other.iter_mut().zip(v) {
        *o -= factor * v;
    }
}

/// Sum of products in eight fixed lanes: the same order on every machine, and fast.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (ca, cb) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for l in 0..8 {
            lanes[l] += x[l] * y[l];
        }
    }
    let half: [f64; 4] = std::array::from_fn(|l| lanes[l] + lanes[l + 4]);
    (half[0] + half[2]) + (half[1] + half[3]) + tail
}
