//! Weighted least squares of polynomials to scattered samples, several right-hand sides at once: Householder QR, which
//! keeps full accuracy in the fitted values although monomials are badly conditioned.

use super::polynomial::{Polynomial2, count, monomials};
use glam::DVec2;

/// Fits each right-hand side (one value a point) by a polynomial; the rows are weighted by √weight. A column that adds
/// nothing gets coefficient 0.
pub fn fit<const N: usize>(
    degree: usize,
    points: &[DVec2],
    weights: &[f64],
    mut sides: [Vec<f64>; N],
) -> [Polynomial2; N] {
    let (m, n) = (points.len(), count(degree));
    let mut columns = vec![0.0; m * n];
    for (row, (p, w)) in points.iter().zip(weights).enumerate() {
        let root = w.sqrt();
        monomials(degree, *p, |k, value| columns[k * m + row] = value * root);
        for side in &mut sides {
            side[row] *= root;
        }
    }
    // Triangularize: reflect each column onto the diagonal, the rest and the right-hand sides with it.
    let mut diagonal = vec![0.0; n];
    for k in 0..n.min(m) {
        let (left, right) = columns.split_at_mut((k + 1) * m);
        let v = &mut left[k * m + k..];
        let norm = dot(v, v).sqrt();
        let head = if v[0] > 0.0 { -norm } else { norm };
        diagonal[k] = head;
        v[0] -= head;
        let square = dot(v, v);
        if square > 0.0 {
            for other in right.chunks_exact_mut(m).map(|c| &mut c[k..]) {
                reflect(v, square, other);
            }
            for side in &mut sides {
                reflect(v, square, &mut side[k..]);
            }
        }
    }
    // Solve the triangle backwards.
    let least = 1e-13 * diagonal.iter().fold(0.0_f64, |a, d| a.max(d.abs()));
    sides.map(|side| {
        let mut c = vec![0.0; n];
        for k in (0..n.min(m)).rev() {
            let known: f64 = (k + 1..n).map(|l| columns[l * m + k] * c[l]).sum();
            c[k] = if diagonal[k].abs() > least {
                (side[k] - known) / diagonal[k]
            } else {
                0.0
            };
        }
        Polynomial2::new(degree, c)
    })
}

fn reflect(v: &[f64], square: f64, other: &mut [f64]) {
    let factor = 2.0 * dot(v, other) / square;
    for (o, v) in other.iter_mut().zip(v) {
        *o -= factor * v;
    }
}

/// Sum of products in four fixed lanes: the same order on every machine, and fast.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = ca
        .remainder()
        .iter()
        .zip(cb.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in ca.zip(cb) {
        for l in 0..4 {
            lanes[l] += x[l] * y[l];
        }
    }
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]) + tail
}
