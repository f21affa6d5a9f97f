//! A biconic surface: its own radius and conic constant in each of two meridians at right angles, for astigmatic eyes.
//!
//! z = (c_a a² + c_b b²) / (1 + √(1 − P)), P = (1 + k_a) c_a² a² + (1 + k_b) c_b² b², with a along the axis, b across it and
//! z from the vertex. With equal meridians it is a conic of revolution. A ray is met by Newton's method from its hit on the
//! mean conic; at most 60 steps, then it counts as missed.

use glam::{DVec2, DVec3};

/// A biconic; lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Toric {
    /// z of the vertex, mm.
    pub vertex_z: f64,
    /// Unit vector (x, y) of the first meridian.
    pub axis: DVec2,
    /// Curvature along and across the axis, 1/mm.
    pub curvature: [f64; 2],
    /// Conic constant along and across the axis.
    pub conic: [f64; 2],
}

/// A step this short ends the search, mm.
const SETTLED_MM: f64 = 1e-13;

impl Toric {
    /// z from the vertex and its slopes along and across the axis; `None` outside of the surface.
    fn sag(&self, a: f64, b: f64) -> Option<(f64, f64, f64)> {
        let ([ca, cb], [ka, kb]) = (self.curvature, self.conic);
        let (pa, pb) = ((1.0 + ka) * ca * ca * a, (1.0 + kb) * cb * cb * b);
        let rest = 1.0 - pa * a - pb * b;
        if rest <= 0.0 {
            return None;
        }
        let root = rest.sqrt();
        let below = 1.0 + root;
        let q = ca * a * a + cb * b * b;
        // d root/da = −pa/root.
        let slope = |c: f64, at: f64, p: f64| 2.0 * c * at / below + q * p / (root * below * below);
        Some((q / below, slope(ca, a, pa), slope(cb, b, pb)))
    }

    fn local(&self, p: DVec3) -> (f64, f64) {
        let across = self.axis.perp();
        (self.axis.dot(p.truncate()), across.dot(p.truncate()))
    }

    /// Distance along the ray (unit direction) to the surface, from a distance nearby.
    pub fn hit_near(&self, origin: DVec3, d: DVec3, start: f64) -> Option<f64> {
        let mut t = start;
        let (da, db) = self.local(d);
        let gap = |t: f64| {
            let p = origin + t * d;
            let (a, b) = self.local(p);
            let (sag, slope_a, slope_b) = self.sag(a, b)?;
            Some((p.z - self.vertex_z - sag, d.z - slope_a * da - slope_b * db))
        };
        let (mut value, mut slope) = gap(t)?;
        for _ in 0..60 {
            let step = -value / slope;
            if !step.is_finite() {
                return None;
            }
            if step.abs() < SETTLED_MM {
                return Some(t + step);
            }
            let mut part = 1.0;
            let better = loop {
                match gap(t + part * step) {
                    Some(next) if next.0.abs() < value.abs() => break Some(next),
                    Some(_) | None => part *= 0.5,
                }
                if part < 1e-6 {
                    break None;
                }
            };
            let Some(next) = better else {
                // As near as rounding lets it come, or no hit at all.
                return (value.abs() < 1e-11).then_some(t);
            };
            t += part * step;
            (value, slope) = next;
        }
        None
    }

    /// Unit normal at a point of the surface, against the direction `d` of the ray that arrives.
    pub fn normal_against(&self, point: DVec3, d: DVec3) -> DVec3 {
        let (a, b) = self.local(point);
        let (_, slope_a, slope_b) = self.sag(a, b).unwrap_or_default();
        let lateral = slope_a * self.axis + slope_b * self.axis.perp();
        let n = DVec3::new(-lateral.x, -lateral.y, 1.0).normalize_or(DVec3::Z);
        if n.dot(d) > 0.0 { -n } else { n }
    }
}

#[cfg(test)]
mod tests {
    use super::super::surface::Conic;
    use super::*;

    #[test]
    fn equal_meridians_are_a_conic_of_revolution() {
        for (radius, k) in [(7.72, -0.26), (10.2, -3.1316), (-6.0, -1.0), (6.5, 0.0)] {
            let conic = Conic { vertex_z: 1.5, radius, conic: k };
            let c = 1.0 / radius;
            let axis = DVec2::from_angle(0.7);
            let toric = Toric { vertex_z: 1.5, axis, curvature: [c, c], conic: [k, k] };
            for j in 0..40 {
                let angle = 0.3 * f64::from(j);
                let d = DVec3::new(0.3 * angle.sin(), 0.3 * angle.cos(), 1.0).normalize();
                let origin = DVec3::new(0.05 * f64::from(j), -1.0, -10.0);
                let (Some(t), Some(u)) = (conic.hit(origin, d), toric.hit_near(origin, d, 11.0)) else {
                    continue;
                };
                assert!((t - u).abs() < 1e-12, "{radius} {j}: {t} {u}");
                let p = origin + t * d;
                assert!((conic.normal_against(p, d) - toric.normal_against(p, d)).length() < 1e-12);
            }
        }
    }

    #[test]
    fn each_meridian_is_its_own_conic() {
        let toric =
            Toric { vertex_z: 0.0, axis: DVec2::X, curvature: [1.0 / 8.0, 1.0 / 7.5], conic: [-0.2, 0.1] };
        for (axis, radius, conic) in [(DVec3::X, 8.0, -0.2), (DVec3::Y, 7.5, 0.1)] {
            let section = Conic { vertex_z: 0.0, radius, conic };
            for y in [-3.0, -0.5, 0.0, 2.0] {
                let origin = y * axis - 5.0 * DVec3::Z;
                let wanted = section.hit(origin, DVec3::Z).unwrap();
                assert!((toric.hit_near(origin, DVec3::Z, 5.0).unwrap() - wanted).abs() < 1e-12);
            }
        }
        assert!(toric.hit_near(DVec3::new(9.0, 9.0, -5.0), DVec3::Z, 5.0).is_none());
    }
}
