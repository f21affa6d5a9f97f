//! Fewest kernels that span a set of similar ones.
//!
//! The kernel that a cone sees depends on where it is: on the field (aberrations) and on the eccentricity
//! (macula, pigment). Over a patch these kernels are nearly dependent. What cones of all types and
//! eccentricities do with the wavelengths is a mixture of a few spectral modes ([`modes`]); each mode has a
//! kernel at every point of the field, and of these the principal directions under a norm are the smallest
//! basis for all places and types ([`Span::reduce`]): the dropped eigenvalues are the squared error.

use multiversion::multiversion;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

/// Sums that are kept side by side.
const LANES: usize = 8;

/// Σ w Re(x* y), in a fixed order.
#[multiversion(targets("x86_64+avx2"))]
fn dot(x: &[Complex64], y: &[Complex64], weights: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (whole, rest) = weights.as_chunks::<LANES>();
    let ((x, x_rest), (y, y_rest)) = (x.as_chunks::<LANES>(), y.as_chunks::<LANES>());
    for ((x, y), w) in x.iter().zip(y).zip(whole) {
        for lane in 0..LANES {
            sums[lane] += w[lane] * (x[lane].re * y[lane].re + x[lane].im * y[lane].im);
        }
    }
    for (lane, ((x, y), w)) in x_rest.iter().zip(y_rest).zip(rest).enumerate() {
        sums[lane] += w * (x.re * y.re + x.im * y.im);
    }
    sums.iter().sum()
}

/// Adds a kernel times a factor.
#[multiversion(targets("x86_64+avx2"))]
pub fn add(to: &mut [Complex64], kernel: &[Complex64], factor: f64) {
    for (to, kernel) in to.iter_mut().zip(kernel) {
        *to += factor * kernel;
    }
}

/// A set whose norm is smaller than this fraction of the largest one counts as if it had that norm: what it adds is not seen.
const FAINT: f64 = 1e-3;
/// A direction with less than this fraction of the largest square is a rounding error.
const DEPENDENT: f64 = 1e-13;

/// Rows of numbers as mixtures of few.
#[derive(Clone, Debug)]
pub struct Modes {
    /// `[row][mode]`.
    pub mixtures: Vec<Vec<f64>>,
    /// `[mode][number]`.
    pub modes: Vec<Vec<f64>>,
}

/// Few rows of numbers of which many are mixtures: `rows[a] ≈ Σ_s mixture[a][s] mode[s]`, with a relative error of at most about
/// `tolerance` of each row's own norm (faint rows: of a thousandth of the largest).
pub fn modes(rows: &[Vec<f64>], tolerance: f64) -> Modes {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norms: Vec<f64> = rows.iter().map(|row| product(row, row).sqrt()).collect();
    let least = (FAINT * norms.iter().copied().fold(0.0, f64::max)).max(f64::MIN_POSITIVE);
    let norms: Vec<f64> = norms.into_iter().map(|norm| norm.max(least)).collect();
    let n = rows.len();
    let gram = |a: usize| (0..n).map(|b| product(&rows[a], &rows[b]) / (norms[a] * norms[b])).collect();
    let (values, vectors) = symmetric_eigen((0..n).map(gram).collect());
    let (order, _) = largest_first(&values, tolerance);
    let mode = |&column: &usize| {
        let mut sum = vec![0.0; rows.first().map_or(0, Vec::len)];
        for ((row, norm), part) in rows.iter().zip(&norms).zip(&vectors) {
            sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += part[column] / norm * value);
        }
        sum
    };
    let mixture = |a: usize| order.iter().map(|&column| norms[a] * vectors[a][column]).collect();
    Modes { mixtures: (0..n).map(mixture).collect(), modes: order.iter().map(mode).collect() }
}

/// Fewer kernels for those that are mixtures of others.
#[derive(Clone, Debug)]
pub struct Reduced {
    /// `[r][sample]`.
    pub kernels: Vec<Vec<Complex64>>,
    /// `[r][old]`: a mixture's coefficient of kernel r from its old ones.
    pub from_old: Vec<Vec<f64>>,
    /// Root of the dropped fraction of the weighted squares, each set's by its share.
    pub error: f64,
}

impl Reduced {
    /// Coefficients of a mixture of the old kernels.
    pub fn coefficients(&self, mixture: &[f64]) -> Vec<f64> {
        self.from_old.iter().map(|row| row.iter().zip(mixture).map(|(f, c)| f * c).sum()).collect()
    }
}

/// Kernels `[old][sample]` and the principal directions of what they span. With their Gram matrix `G = W Wᵀ`
/// under the sample weights mixtures c of them are vectors Wᵀc of the same lengths and angles.
pub struct Span<'a> {
    kernels: &'a [Vec<Complex64>],
    /// Eigenvalues and eigenvectors (columns) of G.
    values: Vec<f64>,
    vectors: Vec<Vec<f64>>,
    /// Those that are not rounding errors.
    kept: Vec<usize>,
}

impl<'a> Span<'a> {
    /// Of kernels under sample weights.
    pub fn new(kernels: &'a [Vec<Complex64>], weights: &[f64]) -> Self {
        let n = kernels.len();
        let above: Vec<Vec<f64>> = (0..n)
            .into_par_iter()
            .map(|a| (a..n).map(|b| dot(&kernels[a], &kernels[b], weights)).collect())
            .collect();
        let gram = (0..n).map(|a| (0..n).map(|b| above[a.min(b)][a.max(b) - a.min(b)]).collect()).collect();
        let (values, vectors) = symmetric_eigen(gram);
        let largest = values.iter().copied().fold(0.0, f64::max);
        let kept = (0..n).filter(|&i| values[i] > DEPENDENT * largest).collect();
        Self { kernels, values, vectors, kept }
    }

    /// Kernels of a smaller basis for the mixtures `sets[set][a][old]`, with a relative root-mean-square
    /// error of at most `tolerance` of each set's own norm; the squares of the sets' errors count by their
    /// `shares`. The principal directions are found among as many numbers as there are kernels, whatever the
    /// number of mixtures and samples.
    pub fn reduce(&self, sets: &[&[Vec<f64>]], shares: &[f64], tolerance: f64) -> Reduced {
        let Self { kernels, values, vectors, kept } = self;
        let n = kernels.len();
        let place = |c: &Vec<f64>| -> Vec<f64> {
            let along = |&i: &usize| values[i].sqrt() * (0..n).map(|r| vectors[r][i] * c[r]).sum::<f64>();
            kept.iter().map(along).collect()
        };
        let places: Vec<Vec<Vec<f64>>> = sets.iter().map(|set| set.iter().map(place).collect()).collect();
        let square = |set: &Vec<Vec<f64>>| set.iter().flatten().map(|v| v * v).sum::<f64>();
        let most = places.iter().map(square).fold(0.0, f64::max);
        let mut spread = vec![vec![0.0; kept.len()]; kept.len()];
        for (set, share) in places.iter().zip(shares) {
            let factor = share / square(set).max(FAINT * FAINT * most).max(f64::MIN_POSITIVE);
            for at in set {
                for (row, x) in spread.iter_mut().zip(at) {
                    row.iter_mut().zip(at).for_each(|(sum, y)| *sum += factor * x * y);
                }
            }
        }
        let (squares, directions) = symmetric_eigen(spread);
        let (order, error) = largest_first(&squares, tolerance);
        // Of an orthonormal kernel along a direction.
        let of_old = |&r: &usize, power: f64| -> Vec<f64> {
            let part = |old: usize, (j, &i): (usize, &usize)| {
                vectors[old][i] * values[i].powf(power) * directions[j][r]
            };
            (0..n).map(|old| kept.iter().enumerate().map(|at| part(old, at)).sum()).collect()
        };
        let samples = kernels.first().map_or(0, Vec::len);
        let kernel = |r: &usize| {
            let mut sum = vec![Complex64::ZERO; samples];
            kernels.iter().zip(of_old(r, -0.5)).for_each(|(kernel, factor)| add(&mut sum, kernel, factor));
            sum
        };
        Reduced {
            kernels: order.par_iter().map(kernel).collect(),
            from_old: order.iter().map(|r| of_old(r, 0.5)).collect(),
            error,
        }
    }
}

/// Places of the largest values, as few as leave a sum of at most the square of `tolerance` of all; and the root of what they leave.
fn largest_first(values: &[f64], tolerance: f64) -> (Vec<usize>, f64) {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[j].total_cmp(&values[i]).then(i.cmp(&j)));
    let total: f64 = values.iter().map(|v| v.max(0.0)).sum();
    let mut dropped = total;
    let mut rank = 0;
    while rank < order.len() && (rank == 0 || dropped > tolerance * tolerance * total) {
        dropped = (dropped - values[order[rank]].max(0.0)).max(0.0);
        rank += 1;
    }
    order.truncate(rank);
    (order, if total > 0.0 { (dropped / total).sqrt() } else { 0.0 })
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations; at most 60 sweeps.
fn symmetric_eigen(mut a: Vec<Vec<f64>>) -> (Vec<f64>, Vec<Vec<f64>>) {
    let n = a.len();
    let mut v: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| if i == j { 1.0 } else { 0.0 }).collect()).collect();
    let scale: f64 = (0..n).map(|i| a[i][i].abs()).sum();
    for _ in 0..60 {
        let mut off = 0.0_f64;
        for p in 0..n {
            for q in p + 1..n {
                off = off.max(a[p][q].abs());
                if a[p][q].abs() > f64::MIN_POSITIVE {
                    rotate(&mut a, &mut v, p, q);
                }
            }
        }
        if off <= 1e-17 * scale {
            break;
        }
    }
    ((0..n).map(|i| a[i][i]).collect(), v)
}

/// One Jacobi rotation that zeroes `a[p][q]`.
fn rotate(a: &mut [Vec<f64>], v: &mut [Vec<f64>], p: usize, q: usize) {
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    for row in a.iter_mut() {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    let (upper, lower) = a.split_at_mut(q);
    for (at_p, at_q) in upper[p].iter_mut().zip(lower[0].iter_mut()) {
        (*at_p, *at_q) = (c * *at_p - s * *at_q, s * *at_p + c * *at_q);
    }
    for row in v.iter_mut() {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve rows from three independent ones, of norms that differ by 1e4.
    #[test]
    fn dependent_rows_have_few_modes() {
        let source = |r: usize, i: usize| ((i * (r + 1)) as f64 * 0.1).cos();
        let scale = |a: usize| if a < 6 { 1.0 } else { 1e-4 };
        let row = |a: usize| -> Vec<f64> {
            let at = |i| (0..3).map(|r| source(r, i) * ((a * (r + 2) + 1) as f64).sin() * scale(a)).sum();
            (0..200).map(at).collect()
        };
        let rows: Vec<Vec<f64>> = (0..12).map(row).collect();
        let Modes { mixtures, modes } = modes(&rows, 1e-6);
        assert_eq!(modes.len(), 3);
        for (row, mixture) in rows.iter().zip(&mixtures) {
            for (i, exact) in row.iter().enumerate() {
                let made: f64 = mixture.iter().zip(&modes).map(|(part, mode)| part * mode[i]).sum();
                assert!((made - exact).abs() < 1e-8, "{made} {exact}");
            }
        }
    }

    /// Seven kernels of which the mixtures need three: each mixture comes back, and so many kernels are enough.
    #[test]
    fn mixtures_need_fewer() {
        let source =
            |r: usize, i: usize| Complex64::new(((i * (r + 1)) as f64 * 0.1).cos(), (r * i) as f64 * 0.01);
        let old: Vec<Vec<Complex64>> = (0..7)
            .map(|a| {
                (0..200)
                    .map(|i| (0..5).map(|r| source(r, i) * (((a + 1) * (r + 2)) as f64).sin()).sum())
                    .collect()
            })
            .collect();
        // Mixtures of three of them, with norms that differ by 1e3.
        let set = |factor: f64| -> Vec<Vec<f64>> {
            let own =
                |a: usize| (0..7).map(move |r| if r < 3 { factor * ((a * r + r) as f64).cos() } else { 0.0 });
            (0..9).map(|a| own(a).collect()).collect()
        };
        let (first, second) = (set(1.0), set(1e-3));
        let made = Span::new(&old, &[1.0; 200]).reduce(&[&first, &second], &[0.7, 0.3], 1e-6);
        assert_eq!(made.kernels.len(), 3);
        for c in first.iter().chain(&second) {
            let scale = c.iter().map(|c| c.abs()).fold(0.0, f64::max);
            let own: Vec<f64> =
                made.from_old.iter().map(|row| row.iter().zip(c).map(|(f, c)| f * c).sum()).collect();
            for i in 0..200 {
                let exact: Complex64 = old.iter().zip(c).map(|(k, c)| k[i] * *c).sum();
                let reduced: Complex64 = made.kernels.iter().zip(&own).map(|(k, c)| k[i] * *c).sum();
                assert!((exact - reduced).norm() < 1e-5 * scale);
            }
        }
    }
}
