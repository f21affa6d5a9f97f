//! The tail of a PSF, outside of the audit's window: waves from the pupil's edge.
//!
//! Far from where rays land, the field at ξ comes from the points of the pupil's edge whose normal points at
//! ξ or away from it (Keller 1962). By the method of stationary phase, with A the amplitude there, κ the
//! edge's curvature and W'' the second derivative of the path difference along it, both in direction cosines,
//! ξ_e the landing point of the ray, Δ the distance from it along the normal n (`ξ = ξ_e + Δ n`):
//! `p = A² λ' / (4π² ∫A² Δ² (κ Δ + W''))`. Both points give `λ'/(2π³ NA r³)` for an even disc. Fringes between them are
//! narrower than cones and left out. In 1/r: `p = a/r³ (1 + b/r)`, `b = 3 ξ_e·n − W''/κ` weighted by a; used
//! as `a/(r − b/3)³`.

use std::f64::consts::{PI, TAU};

use glam::{DMat2, DVec2};

use crate::psf::Wavefront;

/// Directions in which the tail is known, and points of the edge that are looked at.
const DIRECTIONS: usize = 48;
const EDGE: usize = 192;
/// Largest factor on the tail that gives the PSF the energy it has.
const MOST: f64 = 2.0;
/// Smallest distance from the tail's centre, over that from the image.
const NEAREST: f64 = 0.3;

/// By direction: a and a·b.
#[derive(Clone, Debug)]
pub struct Tail(Vec<[f64; 2]>);

impl Tail {
    /// None.
    pub fn none() -> Self {
        Self(vec![[0.0; 2]; DIRECTIONS])
    }

    /// That of a wavefront, about a point from which its chief ray lands at `shift_um`: density per photon
    /// (1/µm² times r³), and the same times µm.
    pub fn new(w: &Wavefront, shift_um: DVec2) -> Self {
        let [by_x, by_y] = w.opd_um.gradient();
        let ([xx, xy], [_, yy]) = (by_x.gradient(), by_y.gradient());
        let to_pupil = w.axes.inverse();
        let edge = w.outline.mapped(w.axes, w.centre);
        let scale = w.wavelength_um() / (4.0 * PI * PI * w.axes.determinant().abs() * w.energy_open);
        // Angle of the normal, a, ξ_e·n and W''/κ at points of the edge.
        let at = |i: usize| -> [f64; 4] {
            let alpha = TAU * i as f64 / EDGE as f64;
            let [_, first, second] = edge.at(alpha);
            let s = w.outline.at(alpha)[0];
            let turn = first.perp_dot(second);
            // The curve's way round decides where its outside is.
            let normal = if turn > 0.0 { -first.perp() } else { first.perp() }.normalize();
            let curvature = turn.abs() / first.length().powi(3);
            let tangent = to_pupil * first.normalize();
            let landing = shift_um + to_pupil.transpose() * DVec2::new(by_x.at(s), by_y.at(s));
            let hessian = DMat2::from_cols(DVec2::new(xx.at(s), xy.at(s)), DVec2::new(xy.at(s), yy.at(s)));
            let bend = tangent.dot(hessian * tangent) / curvature;
            [normal.to_angle(), scale * w.amplitude.at(s).powi(2) / curvature, landing.dot(normal), bend]
        };
        let mut points: Vec<[f64; 4]> = (0..EDGE).map(at).collect();
        points.sort_by(|p, q| p[0].total_cmp(&q[0]));
        let along = |angle: f64| -> [f64; 4] {
            let above = points.partition_point(|p| p[0] < angle);
            let (p, q) = (points[(above + EDGE - 1) % EDGE], points[above % EDGE]);
            let gap = (q[0] - p[0]).rem_euclid(TAU).max(f64::MIN_POSITIVE);
            let t = ((angle - p[0]).rem_euclid(TAU) / gap).min(1.0);
            std::array::from_fn(|k| p[k] + t * (q[k] - p[k]))
        };
        let of_direction = |i: usize| {
            let angle = TAU * i as f64 / DIRECTIONS as f64;
            let back = |angle: f64| if angle > PI { angle - TAU } else { angle };
            let [_, near, landing, bend] = along(back(angle));
            let [_, far, behind, bent] = along(back(angle + PI));
            // Seen from the far side of the pupil the distance along the normal is negative.
            [near + far, near * (3.0 * landing - bend) + far * (bent - 3.0 * behind)]
        };
        Self((0..DIRECTIONS).map(of_direction).collect())
    }

    /// Adds a part of another one.
    pub fn add(&mut self, other: &Self, part: f64) {
        for (a, b) in self.0.iter_mut().zip(&other.0) {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += part * b);
        }
    }

    /// Every density times a factor.
    pub fn scale(&mut self, factor: f64) {
        self.0.iter_mut().flatten().for_each(|v| *v *= factor);
    }

    /// Gives the tail outside of a square (half side µm) the light that is missing inside.
    pub fn with_energy(&mut self, missing: f64, inside_um: f64) {
        let of_direction = |(i, [a, ab]): (usize, &[f64; 2])| {
            let direction = DVec2::from_angle(TAU * i as f64 / DIRECTIONS as f64);
            let r = inside_um / direction.abs().max_element();
            let centre = centre([*a, *ab], r);
            let x = r - centre;
            // ∫ a r/(r − c)³ dr from r on.
            TAU / DIRECTIONS as f64 * a * (1.0 / x + 0.5 * centre / (x * x))
        };
        let own: f64 = self.0.iter().enumerate().map(of_direction).sum();
        if own > 0.0 {
            self.scale((missing / own).clamp(1.0 / MOST, MOST));
        }
    }

    /// Density at an offset from the image.
    pub fn at(&self, offset_um: DVec2) -> f64 {
        let turn = (offset_um.to_angle() / TAU).rem_euclid(1.0) * DIRECTIONS as f64;
        let (first, t) = (turn as usize % DIRECTIONS, turn.fract());
        let (p, q) = (self.0[first], self.0[(first + 1) % DIRECTIONS]);
        let here: [f64; 2] = std::array::from_fn(|k| p[k] + t * (q[k] - p[k]));
        let r = offset_um.length();
        here[0] / (r - centre(here, r)).powi(3)
    }
}

/// Where the tail of a direction starts, along it; never near a distance at which it is read.
fn centre([a, ab]: [f64; 2], r: f64) -> f64 {
    if a == 0.0 { 0.0 } else { (ab / (3.0 * a)).clamp(-r, (1.0 - NEAREST) * r) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::psf::polynomial::Polynomial2;
    use crate::psf::{PsfGrid, psf};

    /// An even disc has λ'/(2π³ NA r³) about its image; tilted, about where its rays land; and a coma with a
    /// focus error has the PSF's own mean over its fringes.
    #[test]
    fn tails_of_known_wavefronts() {
        let (na, r) = (0.08, 100.0);
        let disc = Wavefront::disc(na, 543.0, 1.336, Polynomial2::new(1, vec![0.0, 0.0, 0.0]));
        let law = disc.wavelength_um() / (2.0 * PI.powi(3) * na * r * r * r);
        for angle in [0.0, 1.0, 4.0] {
            let made = Tail::new(&disc, DVec2::ZERO).at(r * DVec2::from_angle(angle));
            assert!((made / law - 1.0).abs() < 1e-3, "{made} {law}");
        }
        let moved = Tail::new(&disc, DVec2::new(6.0, 0.0)).at(DVec2::new(106.0, 0.0));
        assert!((moved / law - 1.0).abs() < 0.01, "{moved} {law}");
        // Coefficients by rising i, then rising j: 1, y, y², y³, x, x y, x y², x², x² y, x³.
        let opd = Polynomial2::new(3, vec![0.0, -0.4, 0.3, 0.6, 0.0, 0.0, 0.0, 0.3, 0.6, 0.0]);
        let w = Wavefront::disc(na, 543.0, 1.336, opd);
        let tail = Tail::new(&w, DVec2::ZERO);
        for direction in [DVec2::X, DVec2::Y, -DVec2::Y, DVec2::new(-0.6, 0.8)] {
            let grid = PsfGrid { centre_um: 110.0 * direction, fraunhofer: true, ..PsfGrid::new(64, 20.0) };
            let image = psf(&w, &grid);
            let mean = image.iter().sum::<f64>() / image.len() as f64 * w.density_per_um2();
            let points = (0..64).flat_map(|i| (0..64).map(move |j| (i, j)));
            let place =
                |(i, j): (usize, usize)| 110.0 * direction + DVec2::new(grid.offset(i), grid.offset(j));
            let made = points.map(|at| tail.at(place(at))).sum::<f64>() / 4096.0;
            println!("{direction}: {:.4}", made / mean);
            assert!((made / mean - 1.0).abs() < 0.06, "{direction}: {made} {mean}");
        }
    }
}
