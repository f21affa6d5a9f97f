//! Fewest kernels that span a set of similar ones.
//!
//! The kernel that a cone sees depends on where it is: on the field (aberrations) and on the eccentricity (macula, pigment). Over a
//! patch these kernels K_a are nearly dependent. With the Gram matrix `G_ab = Σ w Re(K_a* K_b)` and its eigenvectors U,
//! `K_a ≈ Σ_r U_ar B_r`, `B_r = Σ_a U_ar K_a`, and the dropped eigenvalues are the squared error: the best basis of its size.
//!
//! Several sets (the types of cones) share one basis: each is compressed alone, finer than asked, and the few kernels that are left,
//! the squares of each set at its share of the cones, are compressed together. What L, M and S cones see differs little more than in their weights of the
//! primaries: 12 images instead of 18 on the scene of Figure 12 at 0.1 %, and those of one of them for light of one wavelength.

use multiversion::multiversion;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

/// A basis for a set of kernels.
#[derive(Clone, Debug)]
pub struct Basis {
    /// `[a][r]`: kernel a from basis kernel r.
    pub coefficients: Vec<Vec<f64>>,
    /// `[r][sample]`.
    pub kernels: Vec<Vec<Complex64>>,
    /// Root of the dropped share of the weighted squares.
    pub error: f64,
}

/// Compresses kernels `[a][sample]` under sample weights to a relative root-mean-square error of at most `tolerance`, which
/// makes sense down to about 1e-7 (eigenvalues are squares).
pub fn compress(kernels: &[Vec<Complex64>], weights: &[f64], tolerance: f64) -> Basis {
    let n = kernels.len();
    let mut gram = vec![vec![0.0; n]; n];
    for a in 0..n {
        for b in a..n {
            gram[a][b] = dot(&kernels[a], &kernels[b], weights);
            gram[b][a] = gram[a][b];
        }
    }
    let (values, vectors) = symmetric_eigen(gram);
    let (order, error) = largest_first(&values, tolerance);
    let samples = kernels.first().map_or(0, Vec::len);
    let mut basis = vec![vec![Complex64::ZERO; samples]; order.len()];
    for (kernel, &column) in basis.iter_mut().zip(&order) {
        for (a, source) in kernels.iter().enumerate() {
            add(kernel, source, vectors[a][column]);
        }
    }
    let coefficients = (0..n).map(|a| order.iter().map(|&column| vectors[a][column]).collect()).collect();
    Basis { coefficients, kernels: basis, error }
}

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

/// Error of a set alone over that of the sets together.
const ALONE: f64 = 0.2;
/// A set whose norm is smaller than this share of the largest one counts as if it had that norm: what it adds is not seen.
const FAINT: f64 = 1e-3;
/// A direction with less than this share of the largest square is a rounding error.
const DEPENDENT: f64 = 1e-13;

/// One basis for several sets of kernels `[set][a][sample]`: `coefficients[set][a][r]`.
#[derive(Clone, Debug)]
pub struct SharedBasis {
    /// `[set][a][r]`.
    pub coefficients: Vec<Vec<Vec<f64>>>,
    /// `[r][sample]`.
    pub kernels: Vec<Vec<Complex64>>,
    /// Root of the dropped share of the weighted squares, each set's by its share.
    pub error: f64,
}

/// As [`compress`] for several sets together; `tolerance` is relative to each set's own norm, and the squares of the sets' errors count by their
/// `shares`.
pub fn compress_together(
    sets: &[Vec<Vec<Complex64>>],
    shares: &[f64],
    weights: &[f64],
    tolerance: f64,
) -> SharedBasis {
    let alone: Vec<Basis> = sets.par_iter().map(|set| compress(set, weights, ALONE * tolerance)).collect();
    let square =
        |kernel: &Vec<Complex64>| kernel.iter().zip(weights).map(|(z, w)| w * z.norm_sqr()).sum::<f64>();
    let norms: Vec<f64> = alone.iter().map(|b| b.kernels.iter().map(square).sum::<f64>().sqrt()).collect();
    let least = (FAINT * norms.iter().copied().fold(0.0, f64::max)).max(f64::MIN_POSITIVE);
    let norms: Vec<f64> =
        norms.into_iter().zip(shares).map(|(norm, share)| norm.max(least) / share.sqrt()).collect();
    let scaled: Vec<Vec<Complex64>> = alone
        .iter()
        .zip(&norms)
        .flat_map(|(b, norm)| b.kernels.iter().map(move |kernel| kernel.iter().map(|z| z / norm).collect()))
        .collect();
    let together = compress(&scaled, weights, tolerance);
    let mut rows = together.coefficients.iter();
    let coefficients = alone.iter().zip(&norms).map(|(own, norm)| {
        let rows: Vec<&Vec<f64>> = rows.by_ref().take(own.kernels.len()).collect();
        let of_kernel = |own: &Vec<f64>| {
            let of = |r: usize| norm * own.iter().zip(&rows).map(|(c, row)| c * row[r]).sum::<f64>();
            (0..together.kernels.len()).map(of).collect()
        };
        own.coefficients.iter().map(of_kernel).collect()
    });
    let alone_error = alone.iter().map(|b| b.error).fold(0.0, f64::max);
    SharedBasis {
        coefficients: coefficients.collect(),
        error: together.error.hypot(alone_error),
        kernels: together.kernels,
    }
}

/// Fewer kernels for those that are mixtures of others.
#[derive(Clone, Debug)]
pub struct Reduced {
    /// `[r][sample]`.
    pub kernels: Vec<Vec<Complex64>>,
    /// `[r][old]`: a mixture's coefficient of kernel r from its old ones.
    pub from_old: Vec<Vec<f64>>,
    /// As [`SharedBasis::error`], of this step alone.
    pub error: f64,
}

/// Kernels of a smaller basis than `kernels[old][sample]` for the mixtures `sets[set][a][old]` of them; shares and tolerance as in
/// [`compress_together`]. With the Gram matrix of the kernels `G = W Wᵀ` the mixtures c are vectors Wᵀc of the same lengths and angles: their
/// principal directions are found among as many numbers as there are kernels, whatever the number of mixtures and samples.
pub fn reduce(
    kernels: &[Vec<Complex64>],
    sets: &[&[Vec<f64>]],
    shares: &[f64],
    weights: &[f64],
    tolerance: f64,
) -> Reduced {
    let n = kernels.len();
    let gram: Vec<Vec<f64>> =
        (0..n).map(|a| (0..n).map(|b| dot(&kernels[a], &kernels[b], weights)).collect()).collect();
    let (values, vectors) = symmetric_eigen(gram);
    let largest = values.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> = (0..n).filter(|&i| values[i] > DEPENDENT * largest).collect();
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
        let part =
            |old: usize, (j, &i): (usize, &usize)| vectors[old][i] * values[i].powf(power) * directions[j][r];
        (0..n).map(|old| kept.iter().enumerate().map(|at| part(old, at)).sum()).collect()
    };
    let samples = kernels.first().map_or(0, Vec::len);
    let kernel = |r: &usize| {
        let mut sum = vec![Complex64::ZERO; samples];
        kernels.iter().zip(of_old(r, -0.5)).for_each(|(kernel, factor)| add(&mut sum, kernel, factor));
        sum
    };
    Reduced {
        kernels: order.iter().map(kernel).collect(),
        from_old: order.iter().map(|r| of_old(r, 0.5)).collect(),
        error,
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

    #[test]
    fn dependent_kernels_need_few() {
        // Twelve kernels from three independent ones.
        let source =
            |r: usize, i: usize| Complex64::new(((i * (r + 1)) as f64 * 0.1).cos(), (r * i) as f64 * 0.01);
        let kernels: Vec<Vec<Complex64>> = (0..12)
            .map(|a| {
                (0..200).map(|i| (0..3).map(|r| source(r, i) * ((a * (r + 2)) as f64).sin()).sum()).collect()
            })
            .collect();
        let basis = compress(&kernels, &[1.0; 200], 1e-6);
        assert_eq!(basis.kernels.len(), 3);
        for (a, kernel) in kernels.iter().enumerate() {
            for (i, exact) in kernel.iter().enumerate() {
                let made: Complex64 = (0..3).map(|r| basis.kernels[r][i] * basis.coefficients[a][r]).sum();
                assert!((made - exact).norm() < 1e-5);
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
        let made = reduce(&old, &[&first, &second], &[0.7, 0.3], &[1.0; 200], 1e-6);
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

    /// Three sets of the same four kernels in other mixtures and at norms that differ by 1e4 and 1e9.
    #[test]
    fn sets_share_a_basis() {
        let source =
            |r: usize, i: usize| Complex64::new(((i * (r + 1)) as f64 * 0.1).cos(), (r * i) as f64 * 0.01);
        let kernel = |set: usize, a: usize| -> Vec<Complex64> {
            let factor = [1.0, 1e-2, 1e-7][set];
            let mixed = |i| (0..4).map(|r| source(r, i) * ((a * (r + 2) + set) as f64).sin() * factor).sum();
            (0..200).map(mixed).collect()
        };
        let sets: Vec<Vec<Vec<Complex64>>> =
            (0..3).map(|set| (0..9).map(|a| kernel(set, a)).collect()).collect();
        let basis = compress_together(&sets, &[0.5, 0.3, 0.2], &[1.0; 200], 1e-6);
        assert_eq!(basis.kernels.len(), 4);
        for (set, own) in sets.iter().enumerate() {
            // The last set is fainter than what is seen.
            let scale = [1.0, 1e-2, 1e-3][set];
            for (kernel, c) in own.iter().zip(&basis.coefficients[set]) {
                for (i, exact) in kernel.iter().enumerate() {
                    let made: Complex64 = (0..4).map(|r| basis.kernels[r][i] * c[r]).sum();
                    assert!((made - exact).norm() < 1e-4 * scale, "{set} {}", (made - exact).norm());
                }
            }
        }
    }
}
