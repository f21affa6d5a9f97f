//! A lens with a gradient index as shells of constant index, the way it was simulated before (Deering 2005 §12).
//!
//! Shell k holds every place where k Δ ≤ n − n_vertex < (k + 1) Δ and has the index n_vertex + (k + 1/2) Δ; Δ is the rise of the
//! index on the axis over the number of shells. The walls are quadrics, so a straight ray meets them in closed form: along a ray
//! n = A + B t + C t², and an upward crossing of level L lies at t = 2 (L − A)/(B + √D) = (√D − B)/(2 C), a downward one
//! at 2 (L − A)/(B − √D) = −(√D + B)/(2 C), D = B² − 4 C (A − L). A ray that is totally reflected at a wall stays in its shell.
//!
//! # Accuracy
//! Error of the wavefront against the exact trace (3 mm pupil at the fovea, 555 nm, eye of Liou & Brennan, less piston and tilt; waves
//! rms): 12 shells 0.75, 25 0.23, 50 0.08, 100 0.04, 200 0.015, 400 0.03, 800 0.009, 1600 0.003. The fall is rough: walls that a ray
//! grazes in the middle of the lens kick it by √(2Δ/n), so single rays go astray up to several hundred shells. The eye's own
//! aberrations are 0.04.

use super::gradient::{Crossed, GradientLens};
use super::surface::{Surface, refract};
use glam::DVec3;

/// Crossings allowed per shell, and some more, before a ray counts as lost.
const CROSSINGS: (u32, u32) = (8, 1000);
/// A crossing may lie this far behind, mm: the ray stands on the wall.
const BEHIND_MM: f64 = 1e-10;

/// What the ray meets next.
#[derive(Clone, Copy)]
enum Next {
    Back,
    Plane,
    /// The wall to this shell.
    Wall(f64),
}

/// Index less that of the front vertex along a ray: A, B, C.
fn along(lens: &GradientLens, j: usize, p: DVec3, d: DVec3) -> [f64; 3] {
    let part = &lens.parts[j];
    let zeta = p.z - lens.front_z - part.from_mm;
    let radial = part.radial_per_mm2;
    let rise = part.index - lens.parts[0].index;
    [
        rise + zeta * (part.linear_per_mm + zeta * part.square_per_mm2) + radial * (p.x * p.x + p.y * p.y),
        (part.linear_per_mm + 2.0 * zeta * part.square_per_mm2) * d.z
            + 2.0 * radial * (p.x * d.x + p.y * d.y),
        part.square_per_mm2 * d.z * d.z + radial * (d.x * d.x + d.y * d.y),
    ]
}

/// Distance to where the index crosses `level` upwards (`way` 1) or downwards (−1).
fn crossing([a, b, c]: [f64; 3], level: f64, way: f64) -> Option<f64> {
    let root = (b * b - 4.0 * c * (a - level)).max(-1.0);
    if root < 0.0 {
        return None;
    }
    // Of the two forms of the root the one that adds: the other is 0/0 for a ray that stands on the wall.
    let signed = way * root.sqrt();
    let t = if way * b >= 0.0 { 2.0 * (level - a) / (b + signed) } else { (signed - b) / (2.0 * c) };
    (t.is_finite() && t >= -BEHIND_MM).then_some(t.max(0.0))
}

/// Largest rise of the index on the axis above that of the front vertex, up to the back vertex `thickness_mm` behind it.
fn largest_rise(lens: &GradientLens, thickness_mm: f64) -> f64 {
    let mut largest = 0.0_f64;
    for (j, part) in lens.parts.iter().enumerate() {
        let end = lens.parts.get(j + 1).map_or(thickness_mm, |next| next.from_mm) - part.from_mm;
        let top = -0.5 * part.linear_per_mm / part.square_per_mm2;
        let top = if top.is_finite() { top.clamp(0.0, end) } else { 0.0 };
        for zeta in [0.0, top, end] {
            let rise = zeta * (part.linear_per_mm + zeta * part.square_per_mm2);
            largest = largest.max(part.index - lens.parts[0].index + rise);
        }
    }
    largest
}

impl GradientLens {
    /// Rise of the index from shell to shell, 0 without shells; `thickness_mm` of the lens.
    pub(super) fn step_of(&self, shells: Option<u32>, thickness_mm: f64) -> f64 {
        shells.map_or(0.0, |shells| largest_rise(self, thickness_mm) / f64::from(shells.max(1)))
    }

    /// As [`GradientLens::cross`], from shell to shell; `point` lies in a shell of step [`GradientLens::step_of`].
    pub(super) fn cross_shells(
        &self,
        n_vertex: f64,
        point: DVec3,
        direction: DVec3,
        back: &Surface,
    ) -> Option<Crossed> {
        let step = self.shell_step;
        let (mut p, mut d, mut j) = (point, direction, self.part_at(point.z));
        let mut shell = (along(self, j, p, d)[0] / step).floor();
        let index = |shell: f64| n_vertex + (shell + 0.5) * step;
        let (mut path_mm, mut optical_mm) = (0.0, 0.0);
        let most = CROSSINGS.0 * (largest_rise(self, 10.0) / step).min(1e5) as u32 + CROSSINGS.1;
        for _ in 0..most {
            // What comes first.
            let here = along(self, j, p, d);
            let mut first = (back.hit(p, d)?, Next::Back);
            if let Some(next) = self.parts.get(j + 1) {
                let t = (self.front_z + next.from_mm - p.z) / d.z;
                if t < first.0 {
                    first = (t.max(0.0), Next::Plane);
                }
            }
            for way in [1.0, -1.0] {
                let level = (shell + f64::from(u8::from(way > 0.0))) * step;
                if let Some(t) = crossing(here, level, way).filter(|t| *t < first.0) {
                    first = (t, Next::Wall(shell + way));
                }
            }
            // Go there.
            let (t, next) = first;
            p += t * d;
            path_mm += t;
            optical_mm += index(shell) * t;
            let (normal, after) = match next {
                Next::Back => {
                    let index = index(shell);
                    return Some(Crossed { point: p, direction: d, index, path_mm, optical_mm });
                }
                Next::Plane => {
                    j += 1;
                    (DVec3::NEG_Z, (along(self, j, p, d)[0] / step).floor())
                }
                Next::Wall(after) => {
                    let part = &self.parts[j];
                    let zeta = p.z - self.front_z - part.from_mm;
                    let slope = part.linear_per_mm + 2.0 * zeta * part.square_per_mm2;
                    let lateral = 2.0 * part.radial_per_mm2;
                    (DVec3::new(lateral * p.x, lateral * p.y, slope).try_normalize()?, after)
                }
            };
            // Refract into the next shell, or stay in this one.
            if after.total_cmp(&shell).is_ne() {
                let normal = if normal.dot(d) > 0.0 { -normal } else { normal };
                if let Some(bent) = refract(d, normal, index(shell), index(after)) {
                    (d, shell) = (bent, after);
                } else {
                    d -= 2.0 * d.dot(normal) * normal;
                }
            }
            if d.z <= 1e-3 {
                return None;
            }
        }
        None
    }

    /// Index of the shell at a point.
    pub(super) fn shell_index(&self, n_vertex: f64, p: DVec3) -> f64 {
        let rise = along(self, self.part_at(p.z), p, DVec3::Z)[0];
        n_vertex + ((rise / self.shell_step).floor() + 0.5) * self.shell_step
    }
}
