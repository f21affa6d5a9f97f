//! Points of a rectangle at which the optics are computed, and the weights that interpolate between them.
//!
//! For three and more points a side these are the Padua points of total degree N = n - 1: `(cos(jπ/N), cos(kπ/(N+1)))` with j + k even,
//! (N+1)(N+2)/2 of them, with the Lagrange polynomials `w_A (K_N(A, x) - T_N(x₁) T_N(A₁))`, K_N the kernel of the Chebyshev polynomials with
//! i + j <= N and w_A the cubature weight (Bos, Caliari, De Marchi, Vianello & Xu 2006): of what a grid of n x n adds to them, x²y², … , a small
//! patch has little. One or two points a side are Chebyshev's.

use std::f64::consts::PI;

use glam::{DMat2, DVec2};

use super::nodes::{chebyshev, lagrange};

/// The points of a rectangle.
#[derive(Clone, Debug)]
pub struct FieldNodes {
    min: DVec2,
    max: DVec2,
    /// Points along each side of a grid of the same degree.
    side: u32,
    points: Vec<DVec2>,
    /// `[point][polynomial]` of the Lagrange polynomials of Padua points; polynomials x^i y^j in the order of i, then j.
    lagrange: Vec<Vec<f64>>,
}

impl FieldNodes {
    /// For a rectangle, `side` points (1 or more) along each of its sides.
    pub fn new([min, max]: [DVec2; 2], side: u32) -> Self {
        let mut nodes = Self { min, max, side, points: Vec::new(), lagrange: Vec::new() };
        if side < 3 {
            let [xs, ys] = nodes.axes();
            nodes.points = ys.iter().flat_map(|y| xs.iter().map(move |x| DVec2::new(*x, *y))).collect();
            return nodes;
        }
        let (middle, half) = (0.5 * (min + max), 0.5 * (max - min));
        for (point, weight) in padua(side as usize - 1) {
            nodes.points.push(middle + half * point);
            nodes.lagrange.push(nodes.products(point, weight));
        }
        nodes
    }

    /// Number of points.
    pub fn count(side: u32) -> u32 {
        if side < 3 { side * side } else { side * (side + 1) / 2 }
    }

    /// The points, in the rectangle.
    pub fn points(&self) -> &[DVec2] {
        &self.points
    }

    /// Weight of each point in the value at a place.
    pub fn weights(&self, at: DVec2) -> Vec<f64> {
        if self.side < 3 {
            let [xs, ys] = self.axes();
            let (x, y) = (lagrange(&xs, at.x), lagrange(&ys, at.y));
            return y.iter().flat_map(|y| x.iter().map(move |x| x * y)).collect();
        }
        let at = (2.0 * at - self.min - self.max) / (self.max - self.min);
        let last = self.side as usize - 1;
        let (x, y) = (polynomials(at.x, last), polynomials(at.y, last));
        let products: Vec<f64> =
            x.iter().enumerate().flat_map(|(i, x)| y[..=last - i].iter().map(move |y| x * y)).collect();
        self.lagrange.iter().map(|own| own.iter().zip(&products).map(|(a, b)| a * b).sum()).collect()
    }

    /// First and second derivatives of each point's weight at a place.
    pub fn slopes(&self, at: DVec2) -> Vec<Slope> {
        let half = 0.5 * (self.max - self.min);
        let scale = DVec2::ONE / half;
        let place = (at - 0.5 * (self.min + self.max)) * scale;
        let slope = |[x, y]: [[f64; 3]; 2]| {
            let mixed = x[1] * y[1] * scale.x * scale.y;
            let (xx, yy) = (x[2] * y[0] * scale.x * scale.x, x[0] * y[2] * scale.y * scale.y);
            Slope {
                first: DVec2::new(x[1] * y[0], x[0] * y[1]) * scale,
                second: DMat2::from_cols(DVec2::new(xx, mixed), DVec2::new(mixed, yy)),
            }
        };
        if self.side < 3 {
            // Chebyshev's two points are at ±√½; a single one has a weight of 1 everywhere.
            let line = |at: f64| -> Vec<[f64; 3]> {
                match self.side {
                    2 => [-1.0, 1.0].map(|s| [0.5 + s * at * SQRT_HALF, s * SQRT_HALF, 0.0]).to_vec(),
                    _ => vec![[1.0, 0.0, 0.0]],
                }
            };
            let (xs, ys) = (line(place.x), line(place.y));
            return ys.iter().flat_map(|y| xs.iter().map(move |x| slope([*x, *y]))).collect();
        }
        let last = self.side as usize - 1;
        let (x, y) = (derivatives(place.x, last), derivatives(place.y, last));
        let products: Vec<Slope> = (0..=last)
            .flat_map(|i| (0..=last - i).map(move |j| (i, j)))
            .map(|(i, j)| slope([x[i], y[j]]))
            .collect();
        let sum = |own: &Vec<f64>| {
            let none = Slope { first: DVec2::ZERO, second: DMat2::ZERO };
            own.iter().zip(&products).fold(none, |sum, (weight, s)| Slope {
                first: sum.first + *weight * s.first,
                second: sum.second + *weight * s.second,
            })
        };
        self.lagrange.iter().map(sum).collect()
    }

    /// The Lagrange polynomial of a Padua point with a cubature weight, in products of Chebyshev polynomials.
    fn products(&self, point: DVec2, weight: f64) -> Vec<f64> {
        let last = self.side as usize - 1;
        let (x, y) = (polynomials(point.x, last), polynomials(point.y, last));
        let product = |(i, j): (usize, usize)| {
            // Normalized, the square of all but the first is twice as large; of the last one along x half is taken away.
            let twice = |order: usize| if order == 0 { 1.0 } else { 2.0 };
            let factor = if i == last { 1.0 } else { twice(i) * twice(j) };
            weight * factor * x[i] * y[j]
        };
        (0..=last).flat_map(|i| (0..=last - i).map(move |j| (i, j))).map(product).collect()
    }

    /// Chebyshev points along each side.
    fn axes(&self) -> [Vec<f64>; 2] {
        [0, 1].map(|axis| chebyshev(self.min[axis], self.max[axis], self.side as usize))
    }
}

/// Derivatives of a weight by the place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// By x and y.
    pub first: DVec2,
    /// Second ones.
    pub second: DMat2,
}

/// √½.
const SQRT_HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Padua points of the square [-1, 1]² for a total degree (1 or more), with their cubature weights.
fn padua(degree: usize) -> Vec<(DVec2, f64)> {
    let at = |i: usize, n: usize| (PI * i as f64 / n as f64).cos();
    let mut points = Vec::new();
    for j in 0..=degree {
        for k in (j % 2..=degree + 1).step_by(2) {
            let edges = i32::from(j == 0 || j == degree) + i32::from(k == 0 || k == degree + 1);
            let weight = 2.0 * 0.5_f64.powi(edges) / (degree * (degree + 1)) as f64;
            points.push((DVec2::new(at(j, degree), at(k, degree + 1)), weight));
        }
    }
    points
}

/// Chebyshev polynomials up to an order.
fn polynomials(x: f64, last: usize) -> Vec<f64> {
    let mut values = vec![1.0, x];
    while values.len() <= last {
        let [a, b] = [values[values.len() - 2], values[values.len() - 1]];
        values.push(2.0 * x * b - a);
    }
    values
}

/// Chebyshev polynomials up to an order with their first and second derivatives.
fn derivatives(x: f64, last: usize) -> Vec<[f64; 3]> {
    let mut values = vec![[1.0, 0.0, 0.0], [x, 1.0, 0.0]];
    while values.len() <= last {
        let [a, b] = [values[values.len() - 2], values[values.len() - 1]];
        let first = 2.0 * b[0] + 2.0 * x * b[1] - a[1];
        values.push([2.0 * x * b[0] - a[0], first, 4.0 * b[1] + 2.0 * x * b[2] - a[2]]);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against differences of the weights, inside and at a corner.
    #[test]
    fn slopes_are_the_derivatives_of_the_weights() {
        let rectangle = [DVec2::new(-100.0, 20.0), DVec2::new(300.0, 90.0)];
        let h = 0.01;
        for side in 1..=5 {
            let nodes = FieldNodes::new(rectangle, side);
            for at in [DVec2::new(13.0, 44.0), DVec2::new(300.0, 20.0)] {
                let weights = |x: f64, y: f64| nodes.weights(at + h * DVec2::new(x, y));
                let beside = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]].map(|[x, y]| weights(x, y));
                let corners =
                    [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]].map(|[x, y]| weights(x, y));
                for (i, slope) in nodes.slopes(at).into_iter().enumerate() {
                    let by = (beside[0][i] - beside[1][i]) / (2.0 * h);
                    let twice = (beside[2][i] - 2.0 * nodes.weights(at)[i] + beside[3][i]) / (h * h);
                    let mixed =
                        (corners[0][i] - corners[1][i] - corners[2][i] + corners[3][i]) / (4.0 * h * h);
                    assert!((by - slope.first.x).abs() < 1e-6, "{side}");
                    assert!((twice - slope.second.y_axis.y).abs() < 1e-6, "{side}");
                    assert!((mixed - slope.second.x_axis.y).abs() < 1e-6, "{side}");
                }
            }
        }
    }

    #[test]
    fn polynomials_of_the_degree_are_exact() {
        let rectangle = [DVec2::new(-100.0, 20.0), DVec2::new(300.0, 90.0)];
        for side in 1..=6 {
            let nodes = FieldNodes::new(rectangle, side);
            let points = nodes.points();
            assert_eq!(points.len(), FieldNodes::count(side) as usize);
            let unit = |p: DVec2| (p - DVec2::new(70.0, 60.0)) / 100.0;
            for i in 0..side as i32 {
                for j in 0..side as i32 - i {
                    let f = |p: DVec2| unit(p).x.powi(i) * unit(p).y.powi(j);
                    for at in [DVec2::new(-100.0, 90.0), DVec2::new(13.0, 77.0), DVec2::new(270.0, 21.0)] {
                        let made: f64 = nodes.weights(at).iter().zip(points).map(|(w, p)| w * f(*p)).sum();
                        assert!((made - f(at)).abs() < 1e-12, "{side} {i} {j}: {made} {}", f(at));
                    }
                }
            }
            for (i, point) in points.iter().enumerate() {
                assert!(point.cmpge(rectangle[0] - 1e-9).all() && point.cmple(rectangle[1] + 1e-9).all());
                for (j, weight) in nodes.weights(*point).into_iter().enumerate() {
                    assert!((weight - f64::from(u32::from(i == j))).abs() < 1e-12);
                }
            }
        }
    }
}
