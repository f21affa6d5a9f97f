//! One ray through the four refracting surfaces to the retina (§12).
//!
//! Surfaces 0 cornea front, 1 cornea back, 2 lens front, 3 lens back, 4 retina. Media 0 air, 1 cornea, 2 aqueous,
//! 3 lens, 4 vitreous. Lengths in mm; path lengths are counted from the ray's origin.

use super::error::OpticsError;
use super::gradient::{Crossed, GradientLens};
use super::schematic_eye::SchematicEye;
use super::surface::refract;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// A ray: origin (mm) and unit direction, both finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    origin: DVec3,
    direction: DVec3,
}

impl Ray {
    /// A ray from `origin` (mm) along `direction` (any length).
    ///
    /// # Errors
    /// [`OpticsError::NoDirection`] when the direction has no length or a number is not finite.
    pub fn new(origin: DVec3, direction: DVec3) -> Result<Self, OpticsError> {
        let direction = direction
            .try_normalize()
            .filter(|_| origin.is_finite())
            .ok_or(OpticsError::NoDirection { field: "ray" })?;
        Ok(Self { origin, direction })
    }

    /// Where the ray starts, mm.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Its unit direction.
    pub fn direction(&self) -> DVec3 {
        self.direction
    }

    /// A ray whose direction is a unit vector already.
    pub(super) fn from_unit(origin: DVec3, direction: DVec3) -> Self {
        Self { origin, direction }
    }
}

/// How a ray ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RayFate {
    /// It reached the retina.
    Arrived,
    /// It does not meet surface k (0 cornea front … 4 retina).
    MissedSurface(usize),
    /// It is totally reflected at surface k.
    TotalInternalReflection(usize),
    /// It meets the iris outside the pupil (hits and paths are those without the iris).
    StoppedByIris,
}

/// A traced ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Traced {
    /// Where the ray meets each surface, mm; `None` from the first surface that it does not meet.
    pub hits: [Option<DVec3>; 5],
    /// Where it crosses the plane of the stop, mm.
    pub stop: Option<DVec3>,
    /// Geometric length in air, cornea, aqueous, lens, vitreous, mm; 0 where it never came.
    pub path_mm: [f64; 5],
    /// Optical path length from the origin to the last hit, mm.
    pub optical_path_mm: f64,
    /// Unit direction after the last surface met.
    pub direction: DVec3,
    /// How it ended.
    pub fate: RayFate,
}

impl Traced {
    /// Where it lands on the retina, if it does and the iris lets it.
    pub fn landing(&self) -> Option<DVec3> {
        if self.fate == RayFate::Arrived { self.hits[4] } else { None }
    }
}

impl SchematicEye {
    /// Traces a ray at a vacuum wavelength (nm). The iris is noted in the fate; the trace goes on as if it were open.
    pub fn trace(&self, ray: &Ray, wavelength_nm: f64) -> Traced {
        self.trace_with(ray, &self.indices(wavelength_nm))
    }

    /// As [`SchematicEye::trace`], with the five indices of the media given.
    pub fn trace_with(&self, ray: &Ray, n: &[f64; 5]) -> Traced {
        let mut traced = Traced {
            hits: [None; 5],
            stop: None,
            path_mm: [0.0; 5],
            optical_path_mm: 0.0,
            direction: ray.direction,
            fate: RayFate::Arrived,
        };
        let mut point = ray.origin;
        for k in 0..5 {
            // At the iris, before the lens: note where, and go on.
            if k == 2 {
                traced.stop = self.cross_stop(point, traced.direction);
                if !traced.stop.is_some_and(|s| self.inside_pupil(s)) {
                    traced.fate = RayFate::StoppedByIris;
                }
            }
            // Go to the next surface.
            let surface = &self.surfaces[k];
            if k == 3
                && let Some(lens) = &self.gradient
            {
                let Some(out) = self.through_lens(lens, &mut traced, n, point) else {
                    return traced.ended(RayFate::MissedSurface(3));
                };
                let normal = surface.normal_against(out.point, out.direction);
                let Some(direction) = refract(out.direction, normal, out.index, n[4]) else {
                    return traced.ended(RayFate::TotalInternalReflection(3));
                };
                (point, traced.direction) = (out.point, direction);
                continue;
            }
            let t = if k == 4 {
                surface.conic.far_hit(point, traced.direction)
            } else {
                surface.hit(point, traced.direction)
            };
            let Some(t) = t else {
                return traced.ended(RayFate::MissedSurface(k));
            };
            point += t * traced.direction;
            traced.hits[k] = Some(point);
            traced.path_mm[k] = t;
            traced.optical_path_mm += n[k] * t;
            // Refract there.
            if k < 4 {
                let normal = surface.normal_against(point, traced.direction);
                let after = self.index_behind(k, point, n);
                let Some(direction) = refract(traced.direction, normal, n[k], after) else {
                    return traced.ended(RayFate::TotalInternalReflection(k));
                };
                traced.direction = direction;
            }
        }
        traced
    }

    /// Index just behind surface k: of its medium, or of the place where a lens with a gradient is met.
    fn index_behind(&self, k: usize, point: DVec3, n: &[f64; 5]) -> f64 {
        match &self.gradient {
            Some(lens) if k == 2 => lens.index_at(n[3], point),
            Some(_) | None => n[k + 1],
        }
    }

    /// From the front of a lens with a gradient to its back, noted in `traced`.
    fn through_lens(
        &self,
        lens: &GradientLens,
        traced: &mut Traced,
        n: &[f64; 5],
        from: DVec3,
    ) -> Option<Crossed> {
        let out = lens.cross(n[3], from, traced.direction, &self.surfaces[3])?;
        traced.hits[3] = Some(out.point);
        traced.path_mm[3] = out.path_mm;
        traced.optical_path_mm += out.optical_mm;
        traced.direction = out.direction;
        Some(out)
    }

    /// Where a ray crosses the plane of the stop (mm, from the stop's centre); only the cornea is traced.
    pub(super) fn stop_point(&self, ray: &Ray, n: &[f64; 5]) -> Option<DVec2> {
        let (mut point, mut direction) = (ray.origin, ray.direction);
        for (k, surface) in self.surfaces.iter().enumerate().take(2) {
            point += surface.hit(point, direction)? * direction;
            direction = refract(direction, surface.normal_against(point, direction), n[k], n[k + 1])?;
        }
        let s = self.cross_stop(point, direction)?;
        Some(DVec2::new(s.x, s.y + self.state.decentre_mm))
    }

    fn cross_stop(&self, point: DVec3, direction: DVec3) -> Option<DVec3> {
        let t = (self.stop_z - point.z) / direction.z;
        (direction.z > 0.0 && t.is_finite()).then(|| point + t * direction)
    }

    fn inside_pupil(&self, s: DVec3) -> bool {
        let from_centre = DVec2::new(s.x, s.y + self.state.decentre_mm);
        from_centre.length_squared() <= (self.stop_radius_mm * (1.0 + 1e-9)).powi(2)
    }
}

impl Traced {
    fn ended(mut self, fate: RayFate) -> Self {
        if self.fate != RayFate::StoppedByIris {
            self.fate = fate;
        }
        self
    }
}
