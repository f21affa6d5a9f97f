//! Polynomials of two variables, Σ c_ij x^i y^j with i + j ≤ degree; coefficients by rising i, then rising j.

use glam::DVec2;
use serde::{Deserialize, Serialize};

/// A polynomial of x and y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Polynomial2 {
    degree: usize,
    coefficients: Vec<f64>,
}

/// How many coefficients a degree has.
pub fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

impl Polynomial2 {
    /// The polynomial with these coefficients; missing ones are 0.
    pub fn new(degree: usize, mut coefficients: Vec<f64>) -> Self {
        coefficients.resize(count(degree), 0.0);
        Self { degree, coefficients }
    }

    /// The degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The coefficients: for each power of x, the powers of y.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    fn start(&self, i: usize) -> usize {
        i * (self.degree + 1) - i * i.saturating_sub(1) / 2
    }

    fn row(&self, i: usize) -> &[f64] {
        let start = self.start(i);
        &self.coefficients[start..=start + self.degree - i]
    }

    /// Value at a point.
    pub fn at(&self, p: DVec2) -> f64 {
        (0..=self.degree).rev().fold(0.0, |sum, i| sum * p.x + horner(self.row(i), p.y))
    }

    /// Coefficients of the polynomial in x at a fixed y, written to `out` (degree + 1 long).
    pub fn along_x(&self, y: f64, out: &mut [f64]) {
        for (i, o) in out.iter_mut().enumerate().take(self.degree + 1) {
            *o = horner(self.row(i), y);
        }
    }

    /// Every coefficient times `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self::new(self.degree, self.coefficients.iter().map(|c| c * factor).collect())
    }

    /// The polynomial of (−x, y).
    #[must_use]
    pub fn mirrored_x(&self) -> Self {
        let mut out = self.clone();
        for i in (1..=self.degree).step_by(2) {
            let start = self.start(i);
            out.coefficients[start..=start + self.degree - i].iter_mut().for_each(|c| *c = -*c);
        }
        out
    }

    /// Derivatives by x and y.
    pub fn gradient(&self) -> [Self; 2] {
        let degree = self.degree.saturating_sub(1);
        let mut g = [Self::new(degree, Vec::new()), Self::new(degree, Vec::new())];
        for i in 0..=self.degree {
            for (j, c) in self.row(i).iter().enumerate() {
                if i > 0 {
                    let k = g[0].start(i - 1) + j;
                    g[0].coefficients[k] += i as f64 * c;
                }
                if j > 0 {
                    let k = g[1].start(i) + j - 1;
                    g[1].coefficients[k] += j as f64 * c;
                }
            }
        }
        g
    }

    /// The same polynomial in coordinates turned by `angle`: x = a cos − b sin, y = a sin + b cos.
    pub fn rotated(&self, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        // Powers of x and y as polynomials of a and b of the same degree; entry k belongs to a^(n−k) b^k.
        let powers = |first: f64, second: f64| {
            let mut table = vec![vec![1.0]];
            for n in 1..=self.degree {
                let last = &table[n - 1];
                let mut next = vec![0.0; n + 1];
                for (k, c) in last.iter().enumerate() {
                    next[k] += first * c;
                    next[k + 1] += second * c;
                }
                table.push(next);
            }
            table
        };
        let (x, y) = (powers(cos, -sin), powers(sin, cos));
        let mut out = Self::new(self.degree, Vec::new());
        for (i, x_power) in x.iter().enumerate() {
            for (j, c) in self.row(i).iter().enumerate() {
                for (k, cx) in x_power.iter().enumerate() {
                    for (l, cy) in y[j].iter().enumerate() {
                        let b = k + l;
                        let at = out.start(i + j - b) + b;
                        out.coefficients[at] += c * cx * cy;
                    }
                }
            }
        }
        out
    }
}

/// Σ c_k x^k.
pub fn horner(c: &[f64], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// The monomials x^i y^j at a point, in the order of the coefficients.
pub fn monomials(degree: usize, p: DVec2, mut put: impl FnMut(usize, f64)) {
    let (mut k, mut x) = (0, 1.0);
    for i in 0..=degree {
        let mut term = x;
        for _ in 0..=degree - i {
            put(k, term);
            term *= p.y;
            k += 1;
        }
        x *= p.x;
    }
}

#[cfg(test)]
mod tests {
    use super::{Polynomial2, count, monomials};
    use glam::DVec2;

    fn sample(degree: usize) -> Polynomial2 {
        Polynomial2::new(
            degree,
            (0..count(degree)).map(|k| ((k * 7919 + 13) % 101) as f64 / 50.0 - 1.0).collect(),
        )
    }

    #[test]
    fn value_contraction_and_monomials_agree() {
        for degree in [0, 1, 5, 12] {
            let (p, at) = (sample(degree), DVec2::new(0.7, -0.4));
            let mut sum = 0.0;
            monomials(degree, at, |k, m| sum += p.coefficients()[k] * m);
            let mut line = vec![0.0; degree + 1];
            p.along_x(at.y, &mut line);
            assert!((p.at(at) - sum).abs() < 1e-13 && (super::horner(&line, at.x) - sum).abs() < 1e-13);
        }
    }

    #[test]
    fn rotation_keeps_values_and_gradient_is_the_slope() {
        for degree in [1, 4, 12] {
            let (p, ab, angle) = (sample(degree), DVec2::new(0.3, 0.8), 1.1);
            let xy = DVec2::from_angle(angle).rotate(ab);
            assert!((p.rotated(angle).at(ab) - p.at(xy)).abs() < 1e-12);
            let h = DVec2::new(1e-6, 0.0);
            let [gx, _] = p.gradient();
            assert!((gx.at(xy) - (p.at(xy + h) - p.at(xy - h)) / 2e-6).abs() < 1e-6);
        }
    }
}
