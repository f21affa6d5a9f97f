//! From the light of sources to what a cone collects: kernels of points of the field, seen from the cone.
//!
//! Light spreads from its source: with `k_y(ξ)` the density, at an offset ξ on the screen, of what a point y sends, a cone at x
//! counts `∫ S(y) k_y(x − y) dy`. It thus collects with `c_x(ξ) = k_{x−ξ}(ξ)`, which is one function of the offset, so that
//! the images of the engine stay convolutions. Kernels are known at points f of the field with interpolating polynomials ℓ_f,
//! `k_y = Σ_f ℓ_f(y) k_f`; expanded about the cone,
//! `c_x = Σ_f [ℓ_f − ξ·∇ℓ_f + ½ ξξ:∇∇ℓ_f](x) k_f(ξ)`, exact for polynomials of the second degree. In frequencies a factor ξ_a
//! is the operator `M_a = (i/2π) ∂/∂ν_a`:
//! `C_x(ν) = K_x − Σ_a M_a Σ_f ∂_aℓ_f K_f + ½ Σ_ab M_a M_b Σ_f ∂_a∂_bℓ_f K_f`.
//! At ν = 0 this is `1 − div m + …`, m the displacement of the PSF's centroid: how densely an even field lands.
//!
//! Kernels are taken on the screen by the local magnification J of their point. The map X from screen to retina bends within
//! a wide PSF: `k(ξ) = k_lin(ξ + q)·(1 + div q)`, `q = ½ J⁻¹ ∂∂X ξξ`, to first order `k_lin + ∇·(q k_lin)`, in frequencies
//! `2πi Σ_c ν_c ½ Σ_ab Q_cab M_a M_b K`.
//!
//! # Stability
//! The transfer of a pupil with an edge leaves ν = 0 with a slope (its PSF falls as 1/r³), so that second moments do not
//! exist. They are taken on the table's radii only, where the slope adds 1e-6 of the kernel; at radius 0 the limit without it.

use std::f64::consts::{PI, TAU};

use glam::{DMat2, DVec2};
use multiversion::multiversion;
use rustfft::num_complex::Complex64;

use super::lowrank::add;
use super::padua::FieldNodes;
use super::polar::PolarShape;
use super::transfer::FieldPoint;
use crate::optics::Projection;

/// Points of the differences along a direction, and half of those around.
const POINTS: usize = 7;
/// Points on either side of the middle.
const REACH: usize = POINTS / 2;
/// Central differences of the sixth order, over the step, for distances of 1, 2 and 3 steps.
const CENTRAL: [f64; 3] = [0.75, -0.15, 1.0 / 60.0];
/// How much anchored kernels differ over a tile, about.
const VARIATION: f64 = 0.03;
/// Smallest bend that is computed, over the kernels' tolerance.
const SEEN: f64 = 0.2;
/// Step of the map's second derivatives, unit tangents.
const STEP: f64 = 2e-3;

/// What surrounds one point of the field.
pub struct Around {
    /// `[field point]`: derivatives of its polynomial by the screen's tangents.
    first: Vec<DVec2>,
    /// `[field point]`: halves of the second derivatives xx, yy and the whole xy.
    second: Vec<[f64; 3]>,
    /// By component of q: coefficients of ξ_x², ξ_y² and ξ_x ξ_y.
    bend: [[f64; 3]; 2],
    /// Whether that is seen.
    bends: bool,
    /// Whether second derivatives of the kernels are.
    curves: bool,
}

impl Around {
    /// The surroundings of a point of `nodes`, for PSFs as wide as `spot` (radius, unit tangents) and kernels of a `tolerance`.
    ///
    /// # Errors
    /// When the screen beside the point is not seen.
    pub fn new(
        projection: &Projection,
        nodes: &FieldNodes,
        point: &FieldPoint,
        (spot, tolerance): (f64, f64),
    ) -> Result<Self, String> {
        let jacobian = |t: DVec2| projection.jacobian_um_per_tangent(t).map_err(|e| e.to_string());
        let here = jacobian(point.tangent)?;
        let by = |axis: DVec2| -> Result<DMat2, String> {
            let step = STEP * axis;
            Ok((jacobian(point.tangent + step)? - jacobian(point.tangent - step)?) * (0.5 / STEP))
        };
        let (by_x, by_y) = (by(DVec2::X)?, by(DVec2::Y)?);
        // Second derivatives of the map: xx, yy and the mean of both mixed ones.
        let curved = [by_x.x_axis, by_y.y_axis, 0.5 * (by_x.y_axis + by_y.x_axis)];
        let bent = curved.map(|c| here.inverse() * c);
        let bend = [0, 1].map(|c| [0.5 * bent[0][c], 0.5 * bent[1][c], bent[2][c]]);
        // The bend moves light by b ξ², a part b ξ of a PSF that is ξ wide.
        let bends = bend.iter().flatten().map(|b| b.abs()).fold(0.0, f64::max) * spot > SEEN * tolerance;
        // Chain rule from places on the retina to the screen.
        let slopes = nodes.slopes(point.landing_um);
        let first = slopes.iter().map(|s| here.transpose() * s.first).collect();
        let second: Vec<[f64; 3]> = slopes
            .iter()
            .map(|s| {
                let quadratic = here.transpose() * s.second * here;
                let [xx, yy, xy] = curved.map(|c| s.first.dot(c));
                [0.5 * (quadratic.x_axis.x + xx), 0.5 * (quadratic.y_axis.y + yy), quadratic.x_axis.y + xy]
            })
            .collect();
        // Over a PSF the polynomials curve by ∂∂ℓ ξ²/2, and what they weigh differs by some per cent over the
        // field.
        let most = second.iter().flatten().map(|s| s.abs()).fold(0.0, f64::max);
        let curves = VARIATION * most * spot * spot > SEEN * tolerance;
        Ok(Self { first, second, bend, bends, curves })
    }

    /// What a cone at the point `own` of the field collects, from the kernels `[field point][primary·sample]`.
    pub fn collected(&self, shape: &Moments, kernels: &[&[Complex64]], own: usize) -> Vec<Complex64> {
        let mut made = kernels[own].to_vec();
        let samples = shape.shape.len();
        let mut scratch = Scratch::new(samples);
        for primary in 0..made.len() / samples.max(1) {
            let range = primary * samples..(primary + 1) * samples;
            let parts: Vec<&[Complex64]> = kernels.iter().map(|k| &k[range.clone()]).collect();
            self.add_field(shape, &parts, &mut made[range.clone()], &mut scratch);
            if self.bends {
                self.add_bend(shape, parts[own], &mut made[range], &mut scratch);
            }
        }
        made
    }

    /// Adds the change of the kernels over the field: `M_x(−G_x + M_x H_xx + M_y H_xy) + M_y(−G_y + M_y H_yy)`.
    fn add_field(
        &self,
        shape: &Moments,
        kernels: &[&[Complex64]],
        to: &mut [Complex64],
        scratch: &mut Scratch,
    ) {
        let Scratch { sum, inner, .. } = scratch;
        let sums = |weight: &dyn Fn(usize) -> f64, sum: &mut Vec<Complex64>| {
            sum.fill(Complex64::ZERO);
            for (f, kernel) in kernels.iter().enumerate() {
                let weight = weight(f);
                if weight != 0.0 {
                    add(sum, kernel, weight);
                }
            }
        };
        for axis in [0, 1] {
            sums(&|f| -self.first[f][axis], inner);
            if self.curves {
                sums(&|f| self.second[f][axis], sum);
                shape.add_moment(sum, axis, inner);
            }
            if self.curves && axis == 0 {
                sums(&|f| self.second[f][2], sum);
                shape.add_moment(sum, 1, inner);
            }
            shape.add_moment(inner, axis, to);
        }
    }

    /// Adds the bend of the map within the PSF: `2πi Σ_c ν_c [b_cxx M_x M_x + b_cyy M_y M_y + b_cxy M_x M_y] K`.
    fn add_bend(&self, shape: &Moments, kernel: &[Complex64], to: &mut [Complex64], scratch: &mut Scratch) {
        let Scratch { sum, inner, outer } = scratch;
        // (M_x M_x, M_y M_y, M_x M_y), one after the other.
        for (part, axes) in [[0, 0], [1, 1], [0, 1]].into_iter().enumerate() {
            // M_x K is there from the first part when the last one asks for it again.
            if part == 2 {
                std::mem::swap(sum, inner);
            } else {
                inner.fill(Complex64::ZERO);
                shape.add_moment(kernel, axes[0], inner);
                if part == 0 {
                    sum.copy_from_slice(inner);
                }
            }
            outer.fill(Complex64::ZERO);
            shape.add_moment(inner, axes[1], outer);
            let bend = DVec2::new(self.bend[0][part], self.bend[1][part]);
            for (azimuth, (to, second)) in
                to.chunks_mut(shape.shape.radial).zip(outer.chunks(shape.shape.radial)).enumerate()
            {
                let step = TAU * shape.shape.frequency(azimuth, 1).dot(bend);
                for (i, (to, second)) in to.iter_mut().zip(second).enumerate() {
                    *to += Complex64::new(0.0, step * i as f64) * second;
                }
            }
        }
    }
}

/// Tables that are used again.
struct Scratch {
    sum: Vec<Complex64>,
    inner: Vec<Complex64>,
    outer: Vec<Complex64>,
}

impl Scratch {
    fn new(samples: usize) -> Self {
        let zeros = || vec![Complex64::ZERO; samples];
        Self { sum: zeros(), inner: zeros(), outer: zeros() }
    }
}

/// The operators M_a on tables of a shape.
pub struct Moments {
    shape: PolarShape,
    /// By radius: the first of seven radii, and the weights of the derivative by the radius.
    along: Vec<(usize, [f64; POINTS])>,
    /// Weights of the derivative by the azimuth for distances of 1, 2 and 3 steps.
    around: [f64; 3],
    /// By radius: its inverse; 1 at 0.
    over_radius: Vec<f64>,
    /// Radii in a unit of frequency.
    per_step: f64,
}

impl Moments {
    /// For tables of a shape.
    pub fn new(shape: PolarShape) -> Self {
        let step = shape.radius / (shape.radial - 1) as f64;
        let of_radius = |i: usize| {
            let first = i.saturating_sub(POINTS / 2).min(shape.radial - POINTS);
            (first, derivative(i - first).map(|w| w / step))
        };
        let turn = PI / shape.azimuthal as f64;
        let over = |i: usize| if i == 0 { 1.0 } else { 1.0 / (step * i as f64) };
        Self {
            shape,
            along: (0..shape.radial).map(of_radius).collect(),
            around: CENTRAL.map(|w| w / turn),
            over_radius: (0..shape.radial).map(over).collect(),
            per_step: 1.0 / step,
        }
    }

    /// Adds `M_axis` of a table: the transform of the kernel times its offset along x (0) or y (1).
    fn add_moment(&self, table: &[Complex64], axis: usize, to: &mut [Complex64]) {
        let Self { shape, along, around, over_radius, per_step } = self;
        let radial = shape.radial;
        let mut turned = vec![Complex64::ZERO; radial];
        for (j, to) in to.chunks_mut(radial).enumerate() {
            let (sin, cos) = (PI * j as f64 / shape.azimuthal as f64).sin_cos();
            // ∂_x = cos φ ∂_r − sin φ/r ∂_φ, ∂_y = sin φ ∂_r + cos φ/r ∂_φ.
            let (by_radius, by_azimuth) = if axis == 0 { (cos, -sin) } else { (sin, cos) };
            turned.fill(Complex64::ZERO);
            for (distance, weight) in (1_i64..).zip(around) {
                for (sign, weight) in [(1, *weight), (-1, -weight)] {
                    self.add_line(table, j as i64 + sign * distance, weight, &mut turned);
                }
            }
            // Near 0 the table is linear along each direction: ∂_φ/r is ∂_φ of its slope.
            turned[0] = weighted(&turned[..POINTS], &along[0].1);
            let line = &table[j * radial..(j + 1) * radial];
            // Radii near the ends have one-sided differences.
            let ends = (0..REACH).chain(radial - REACH..radial);
            for i in ends {
                let (first, weights) = &along[i];
                let slope = weighted(&line[*first..first + POINTS], weights);
                let v = by_radius * slope + by_azimuth * over_radius[i] * turned[i];
                to[i] += Complex64::new(-v.im, v.re) / TAU;
            }
            let inner = REACH..radial - REACH;
            let parts = [&turned[inner.clone()], line];
            add_inner(parts, &over_radius[inner.clone()], [by_radius, by_azimuth, *per_step], &mut to[inner]);
        }
    }

    /// Adds a direction's line, conjugate beyond half a turn.
    fn add_line(&self, table: &[Complex64], azimuth: i64, weight: f64, to: &mut [Complex64]) {
        let half = self.shape.azimuthal as i64;
        let index = azimuth.rem_euclid(2 * half);
        let line = (index % half) as usize * self.shape.radial;
        let line = &table[line..line + self.shape.radial];
        add_turned(to, line, weight, index >= half);
    }
}

/// Adds the moment at inner radii, from the derivative by azimuth there and the whole line.
#[multiversion(targets("x86_64+avx2"))]
fn add_inner(
    [turned, line]: [&[Complex64]; 2],
    over_radius: &[f64],
    [by_radius, by_azimuth, per_step]: [f64; 3],
    to: &mut [Complex64],
) {
    let count = to.len();
    let [a, b, c] = CENTRAL.map(|w| w * by_radius * per_step / TAU);
    let d = by_azimuth / TAU;
    let at = |offset: usize| &line[offset..offset + count];
    let (p1, p2, p3, m1, m2, m3) = (at(4), at(5), at(6), at(2), at(1), at(0));
    let (turned, over_radius) = (&turned[..count], &over_radius[..count]);
    for i in 0..count {
        let around = d * over_radius[i];
        let re = a * (p1[i].re - m1[i].re)
            + b * (p2[i].re - m2[i].re)
            + c * (p3[i].re - m3[i].re)
            + around * turned[i].re;
        let im = a * (p1[i].im - m1[i].im)
            + b * (p2[i].im - m2[i].im)
            + c * (p3[i].im - m3[i].im)
            + around * turned[i].im;
        to[i].re -= im;
        to[i].im += re;
    }
}

/// Adds a line times a factor, conjugate or not.
#[multiversion(targets("x86_64+avx2"))]
fn add_turned(to: &mut [Complex64], line: &[Complex64], weight: f64, conjugate: bool) {
    let of_im = if conjugate { -weight } else { weight };
    for (to, z) in to.iter_mut().zip(line) {
        to.re += weight * z.re;
        to.im += of_im * z.im;
    }
}

fn weighted(values: &[Complex64], weights: &[f64; POINTS]) -> Complex64 {
    values.iter().zip(weights).map(|(z, w)| z * w).sum()
}

/// Weights of the derivative at node `at` of the polynomial through nodes 0, 1, … 6.
fn derivative(at: usize) -> [f64; POINTS] {
    let gap = |a: usize, b: usize| a as f64 - b as f64;
    std::array::from_fn(|j| {
        if j == at {
            return (0..POINTS).filter(|k| *k != at).map(|k| 1.0 / gap(at, k)).sum();
        }
        let others = (0..POINTS).filter(|k| *k != j && *k != at);
        others.map(|k| gap(at, k) / gap(j, k)).product::<f64>() / gap(j, at)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The transform of a Gaussian beside the origin: first and second moments in closed form.
    #[test]
    fn moments_of_a_gaussian() {
        let shape = PolarShape { radius: 2.0, radial: 60, azimuthal: 40 };
        let (sd, centre) = (0.2, DVec2::new(0.15, -0.1));
        let exact = |nu: DVec2| {
            let fall = (-0.5 * (TAU * sd).powi(2) * nu.length_squared()).exp();
            Complex64::from_polar(fall, -TAU * nu.dot(centre))
        };
        let table: Vec<Complex64> = (0..shape.azimuthal)
            .flat_map(|j| (0..shape.radial).map(move |i| shape.frequency(j, i)))
            .map(exact)
            .collect();
        let moments = Moments::new(shape);
        let mut first = vec![Complex64::ZERO; shape.len()];
        moments.add_moment(&table, 0, &mut first);
        let mut second = vec![Complex64::ZERO; shape.len()];
        moments.add_moment(&first, 1, &mut second);
        for j in 0..shape.azimuthal {
            for i in 0..shape.radial {
                let nu = shape.frequency(j, i);
                // FT[ξ k] = (centre − 2πi sd² ν) K.
                let factor = |axis: usize| Complex64::new(centre[axis], -TAU * sd * sd * nu[axis]);
                let at = j * shape.radial + i;
                assert!((first[at] - factor(0) * exact(nu)).norm() < 2e-5, "{j} {i}");
                assert!((second[at] - factor(0) * factor(1) * exact(nu)).norm() < 2e-4, "{j} {i}");
            }
        }
    }
}
