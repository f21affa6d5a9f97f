//! A conic of revolution about the z axis, a surface that may also be toric, and Snell's law.
//!
//! x² + y² + (1+k) z² − 2 R z = 0, z from the vertex. Along a ray o + t d (|d| = 1) this is A t² + 2 B t + C = 0 with
//! A = 1 + k d_z², B = o·d + k o_z d_z − R d_z, C = |o|² + k o_z² − 2 R o_z.
//!
//! # Stability
//! A vanishes for a ray along the axis of a paraboloid (the lens back): the roots are taken as C/q and q/A with
//! q = −B − sign(B)·√(B² − AC), so the wanted root never divides by a vanishing A.

use super::toric::Toric;
use glam::DVec3;

/// A conic surface; lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conic {
    /// z of the vertex, mm.
    pub vertex_z: f64,
    /// Vertex radius, mm; positive when the centre lies towards +z.
    pub radius: f64,
    /// Conic constant.
    pub conic: f64,
}

/// A hit may lie this far behind the start, mm: surfaces may touch.
const BEHIND: f64 = 1e-9;

impl Conic {
    fn roots(&self, origin: DVec3, d: DVec3) -> Option<[f64; 2]> {
        let o = origin - DVec3::new(0.0, 0.0, self.vertex_z);
        let (k, r) = (self.conic, self.radius);
        let a = 1.0 + k * d.z * d.z;
        let b = o.dot(d) + k * o.z * d.z - r * d.z;
        let c = o.length_squared() + k * o.z * o.z - 2.0 * r * o.z;
        let discriminant = b * b - a * c;
        if discriminant.is_nan() || discriminant < 0.0 {
            return None;
        }
        let q = -b - b.signum() * discriminant.sqrt();
        Some([c / q, q / a])
    }

    /// Distance along the ray (unit direction) to the first hit on the vertex half of the conic.
    pub fn hit(&self, origin: DVec3, d: DVec3) -> Option<f64> {
        let mut first: Option<f64> = None;
        for t in self.roots(origin, d)? {
            let z = origin.z + t * d.z - self.vertex_z;
            let on_vertex_half = self.radius * (self.radius - (1.0 + self.conic) * z) > 0.0;
            if t.is_finite() && t >= -BEHIND && on_vertex_half && first.is_none_or(|f| t < f) {
                first = Some(t);
            }
        }
        first
    }

    /// Signed distance along the ray to the hit that is nearest to its start, before or behind it.
    pub fn nearest(&self, origin: DVec3, d: DVec3) -> Option<f64> {
        let [a, b] = self.roots(origin, d)?;
        let near = if b.is_finite() && b.abs() < a.abs() { b } else { a };
        near.is_finite().then_some(near)
    }

    /// Distance along the ray to the far hit: how a ray inside a closed surface, the retina, leaves it.
    pub fn far_hit(&self, origin: DVec3, d: DVec3) -> Option<f64> {
        let [a, b] = self.roots(origin, d)?;
        let far = if b.is_finite() { a.max(b) } else { a };
        (far.is_finite() && far >= -BEHIND).then_some(far)
    }

    /// Unit normal at a point of the surface, against the direction `d` of the ray that arrives.
    pub fn normal_against(&self, point: DVec3, d: DVec3) -> DVec3 {
        let z = point.z - self.vertex_z;
        let g = DVec3::new(point.x, point.y, (1.0 + self.conic) * z - self.radius);
        let n = g / g.length();
        if n.dot(d) > 0.0 { -n } else { n }
    }
}

/// A surface of the eye: a conic, or a toric one about its mean conic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// The conic; of a toric surface the one of mean curvature, for paraxial values and first guesses.
    pub conic: Conic,
    /// Radii of two meridians, if they differ.
    pub toric: Option<Toric>,
}

impl Surface {
    /// Distance along the ray (unit direction) to the first hit.
    pub fn hit(&self, origin: DVec3, d: DVec3) -> Option<f64> {
        let first = self.conic.hit(origin, d);
        let Some(toric) = &self.toric else { return first };
        toric.hit_near(origin, d, first?).filter(|t| *t >= -BEHIND)
    }

    /// Signed distance along the ray to the hit that is nearest to its start, before or behind it.
    pub fn nearest(&self, origin: DVec3, d: DVec3) -> Option<f64> {
        let near = self.conic.nearest(origin, d);
        let Some(toric) = &self.toric else { return near };
        toric.hit_near(origin, d, near?)
    }

    /// Unit normal at a point of the surface, against the direction `d` of the ray that arrives.
    pub fn normal_against(&self, point: DVec3, d: DVec3) -> DVec3 {
        self.toric
            .as_ref()
            .map_or_else(|| self.conic.normal_against(point, d), |t| t.normal_against(point, d))
    }
}

/// Snell's law: direction after the surface; `None` at total internal reflection. `normal` is against `d`.
pub fn refract(d: DVec3, normal: DVec3, n_before: f64, n_after: f64) -> Option<DVec3> {
    let mu = n_before / n_after;
    let cos_in = -d.dot(normal);
    let cos2_out = 1.0 - mu * mu * (1.0 - cos_in * cos_in);
    if cos2_out < 0.0 {
        return None;
    }
    // A unit vector, as d and the normal are.
    Some(mu * d + (mu * cos_in - cos2_out.sqrt()) * normal)
}
