//! Chebyshev polynomials of the inverse projection over a rectangle of the retina: screen point and exit pupil
//! direction of any retinal point in some hundred nanoseconds, the error measured between the nodes.

use super::error::{OpticsError, in_range};
use super::projection::Projection;
use glam::{DMat2, DVec2, DVec3};
use std::f64::consts::PI;

/// Degrees tried in turn, until the error stops mattering.
const DEGREES: [usize; 4] = [6, 10, 16, 24];
/// Error in tangent units at which a higher degree is not tried (a third of a nanometre on the retina).
const GOOD: f64 = 2e-11;

/// The fitted inverse projection.
#[derive(Clone, Debug, PartialEq)]
pub struct ProjectionFit {
    centre: DVec2,
    half: DVec2,
    order: usize,
    /// t.x, t.y and the local x and y of the exit pupil direction, coefficient [j·order + i] of T_i(x) T_j(y).
    coefficients: Vec<[f64; 4]>,
    max_error: f64,
}

impl ProjectionFit {
    pub(super) fn new(p: &Projection, min_um: DVec2, max_um: DVec2) -> Result<Self, OpticsError> {
        in_range("fit width (µm)", max_um.x - min_um.x, 0.0, 1e5)?;
        in_range("fit height (µm)", max_um.y - min_um.y, 0.0, 1e5)?;
        let half = ((max_um - min_um) / 2.0).max(DVec2::splat(1.0));
        let mut best: Option<Self> = None;
        for order in DEGREES.map(|d| d + 1) {
            let mut fit = Self {
                centre: (min_um + max_um) / 2.0,
                half,
                order,
                coefficients: Vec::new(),
                max_error: 0.0,
            };
            fit.solve(p)?;
            fit.max_error = fit.probe(p)?;
            let done = fit.max_error < GOOD;
            if best.as_ref().is_none_or(|b| fit.max_error < b.max_error) {
                best = Some(fit);
            }
            if done {
                break;
            }
        }
        best.ok_or(OpticsError::OutsideField { x_um: min_um.x, y_um: min_um.y })
    }

    fn solve(&mut self, p: &Projection) -> Result<(), OpticsError> {
        let m = self.order;
        let angle = |k: usize| PI * (k as f64 + 0.5) / m as f64;
        let mut values = Vec::with_capacity(m * m);
        for j in 0..m {
            for i in 0..m {
                let um = self.centre + self.half * DVec2::new(angle(i).cos(), angle(j).cos());
                let t = p.screen_tangent(um)?;
                let e = p.exit_direction_at(t)?;
                values.push([t.x, t.y, e.x, e.y]);
            }
        }
        // Discrete cosine transform along each axis in turn.
        let norm = |k: usize| if k == 0 { 1.0 / m as f64 } else { 2.0 / m as f64 };
        let cosine = |k: usize, i: usize| norm(k) * (k as f64 * angle(i)).cos();
        let mut rows = vec![[0.0; 4]; m * m];
        for (index, row) in rows.iter_mut().enumerate() {
            let (j, k) = (index / m, index % m);
            for i in 0..m {
                add(row, cosine(k, i), &values[j * m + i]);
            }
        }
        self.coefficients = vec![[0.0; 4]; m * m];
        for (index, out) in self.coefficients.iter_mut().enumerate() {
            let (l, k) = (index / m, index % m);
            for j in 0..m {
                add(out, cosine(l, j), &rows[j * m + k]);
            }
        }
        Ok(())
    }

    fn probe(&self, p: &Projection) -> Result<f64, OpticsError> {
        let mut worst = 0.0_f64;
        let at = [-1.0, -0.83, -0.31, 0.07, 0.52, 0.93, 1.0];
        for x in at {
            for y in at {
                let um = self.centre + self.half * DVec2::new(x, y);
                worst = worst.max((self.screen_tangent(um) - p.screen_tangent(um)?).length());
            }
        }
        Ok(worst)
    }

    /// Values and derivatives by the scaled x and y.
    fn evaluate(&self, um: DVec2) -> [[f64; 4]; 3] {
        let u = ((um - self.centre) / self.half).clamp(DVec2::NEG_ONE, DVec2::ONE);
        let (tx, dx) = chebyshev(u.x, self.order);
        let (ty, dy) = chebyshev(u.y, self.order);
        let mut out = [[0.0; 4]; 3];
        for (j, row) in self.coefficients.chunks_exact(self.order).enumerate() {
            let (mut sum, mut slope) = ([0.0; 4], [0.0; 4]);
            for (i, c) in row.iter().enumerate() {
                add(&mut sum, tx[i], c);
                add(&mut slope, dx[i], c);
            }
            add(&mut out[0], ty[j], &sum);
            add(&mut out[1], ty[j], &slope);
            add(&mut out[2], dy[j], &sum);
        }
        out
    }

    /// Tangent coordinates imaged on (x_um, y_um); outside of the rectangle those of its nearest edge.
    pub fn screen_tangent(&self, um: DVec2) -> DVec2 {
        let [v, _, _] = self.evaluate(um);
        DVec2::new(v[0], v[1])
    }

    /// [`ProjectionFit::screen_tangent`] and [`ProjectionFit::jacobian_tangent_per_um`].
    pub fn linear(&self, um: DVec2) -> (DVec2, DMat2) {
        let [v, x, y] = self.evaluate(um);
        let jacobian =
            DMat2::from_cols(DVec2::new(x[0], x[1]) / self.half.x, DVec2::new(y[0], y[1]) / self.half.y);
        (DVec2::new(v[0], v[1]), jacobian)
    }

    /// d t/d(x_um, y_um); columns are the derivatives by x_um and y_um.
    pub fn jacobian_tangent_per_um(&self, um: DVec2) -> DMat2 {
        self.linear(um).1
    }

    /// Unit vector towards the exit pupil, as [`Projection::exit_pupil_direction`].
    pub fn exit_pupil_direction(&self, um: DVec2) -> DVec3 {
        let [v, _, _] = self.evaluate(um);
        DVec3::new(v[2], v[3], (1.0 - v[2] * v[2] - v[3] * v[3]).max(0.0).sqrt())
    }

    /// Largest error of [`ProjectionFit::screen_tangent`] seen at 49 points between the nodes, tangent units.
    pub fn max_error(&self) -> f64 {
        self.max_error
    }
}

fn add(sum: &mut [f64; 4], weight: f64, term: &[f64; 4]) {
    for (s, t) in sum.iter_mut().zip(term) {
        *s += weight * t;
    }
}

/// T_k(x) and T_k'(x) for k below `order` (at most 25).
fn chebyshev(x: f64, order: usize) -> ([f64; 25], [f64; 25]) {
    let (mut t, mut d) = ([0.0; 25], [0.0; 25]);
    t[0] = 1.0;
    t[1] = x;
    d[1] = 1.0;
    for k in 2..order.min(25) {
        t[k] = 2.0 * x * t[k - 1] - t[k - 2];
        d[k] = 2.0 * t[k - 1] + 2.0 * x * d[k - 1] - d[k - 2];
    }
    (t, d)
}
