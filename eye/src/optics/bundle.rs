//! The rays of one object and wavelength at polar Gauss nodes of the real stop, each with its place and path on the
//! reference sphere.
//!
//! The reference sphere is centred on the landing point c of the chief ray and goes through the point of the chief ray
//! nearest to the centre of the exit pupil. A ray that meets it at Q has the direction cosines q = (Q − c)/|Q − c| along
//! the retina's tangents at c (not those of the ray itself: that form is wrong by 0.4–15 %), and the path difference
//! w = (optical path of the ray − that of the chief ray)/n', in mm of vitreous.
//!
//! Nodes: Gauss–Legendre in r² times uniform azimuth; weights sum to π, the area of the unit stop.

use super::aim::Aimer;
use super::error::OpticsError;
use super::object::Object;
use super::schematic_eye::SchematicEye;
use super::trace::Traced;
use crate::psf::quadrature::gauss_legendre;
use glam::{DMat2, DMat3, DVec2, DVec3};
use std::f64::consts::PI;

/// How many rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PupilNodes {
    /// Gauss nodes in r².
    pub radial: usize,
    /// Uniform azimuths.
    pub azimuth: usize,
    /// Rays along the edge of the stop.
    pub edge: usize,
}

/// One ray of the pupil.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PupilRay {
    /// Where it crosses the stop, in stop radii.
    pub stop: DVec2,
    /// Quadrature weight in the unit stop.
    pub weight: f64,
    /// Where it crosses the launch plane across the object's direction, mm.
    pub launch: DVec2,
    /// Flux per launch-plane area, for unit irradiance at the apex.
    pub irradiance: f64,
    /// Direction cosines on the reference sphere along the retina's tangents.
    pub q: DVec2,
    /// Third direction cosine, along the normal into the eye.
    pub q_normal: f64,
    /// Path difference to the chief ray, mm of vitreous.
    pub opd_mm: f64,
    /// Where it lands on the retina, mm, eye frame.
    pub landing: DVec3,
    /// Geometric path in air, cornea, aqueous, lens, vitreous (to the retina), mm.
    pub path_mm: [f64; 5],
}

/// The rays of a pupil.
#[derive(Clone, Debug, PartialEq)]
pub struct PupilBundle {
    /// The chief ray.
    pub chief: Traced,
    /// Landing point of the chief ray, mm, eye frame: the centre of the reference sphere.
    pub landing: DVec3,
    /// Retina tangents along x_um and y_um, and the normal into the eye, at the landing point.
    pub frame: [DVec3; 3],
    /// Radius of the reference sphere, mm.
    pub radius_mm: f64,
    /// Index of the vitreous.
    pub n_vitreous: f64,
    /// Vacuum wavelength, nm.
    pub wavelength_nm: f64,
    /// Rays at the nodes.
    pub rays: Vec<PupilRay>,
    /// Rays along the edge of the stop, at uniform azimuth from 0.
    pub edge: Vec<PupilRay>,
}

struct Sphere {
    centre: DVec3,
    frame: [DVec3; 3],
    radius: f64,
    n_vitreous: f64,
}

impl Sphere {
    /// Optical path to the sphere (mm) and unit vector from its centre to the point met, in the local frame.
    fn meet(&self, ray: &Traced, path_before: f64) -> Option<(f64, DVec3)> {
        let back = ray.hits[3]? - self.centre;
        let along = back.dot(ray.direction);
        let t = -along - (along * along - back.length_squared() + self.radius * self.radius).max(0.0).sqrt();
        let q = (back + t * ray.direction) / self.radius;
        let path = path_before + ray.optical_path_mm + self.n_vitreous * (t - ray.path_mm[4]);
        Some((path, DVec3::new(q.dot(self.frame[0]), q.dot(self.frame[1]), q.dot(self.frame[2]))))
    }
}

impl PupilBundle {
    /// Aims and traces the rays at the nodes.
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when a ray of the pupil does not reach the retina; [`OpticsError::OutOfRange`] for the
    /// wavelength.
    pub fn trace(
        eye: &SchematicEye,
        object: Object,
        wavelength_nm: f64,
        nodes: PupilNodes,
    ) -> Result<Self, OpticsError> {
        Self::trace_points(eye, object, wavelength_nm, &nodes.points(), &nodes.rim())
    }

    /// Aims and traces the rays through points of the stop: (stop radii, weight), and points of its rim.
    ///
    /// # Errors
    /// As [`PupilBundle::trace`].
    pub fn trace_points(
        eye: &SchematicEye,
        object: Object,
        wavelength_nm: f64,
        points: &[(DVec2, f64)],
        rim: &[(DVec2, f64)],
    ) -> Result<Self, OpticsError> {
        let lost = || OpticsError::NoRay { angle_deg: object.angle_deg() };
        let aimer = Aimer::new(eye, object, wavelength_nm)?;
        let chief_uv = aimer.chief().ok_or_else(lost)?;
        let (ray, chief_before) = aimer.launch(chief_uv);
        let chief = eye.trace_with(&ray, &aimer.indices);
        let (Some(landing), Some(back)) = (chief.landing(), chief.hits[3]) else {
            return Err(lost());
        };
        let exit = back + (eye.exit_pupil - back).dot(chief.direction) * chief.direction;
        let sphere = Sphere {
            centre: landing,
            frame: eye.fovea().local_frame(landing),
            radius: (exit - landing).length(),
            n_vitreous: aimer.indices[4],
        };
        let chief_path = sphere.meet(&chief, chief_before).ok_or_else(lost)?.0;
        let inverse = aimer.slope(chief_uv).ok_or_else(lost)?.inverse();
        let tracer = Tracer { aimer, sphere, chief_path, start: (DVec2::ZERO, chief_uv, inverse) };
        let rays = tracer.rays(points).ok_or_else(lost)?;
        let edge = tracer.rays(rim).ok_or_else(lost)?;
        Ok(Self {
            chief,
            landing,
            frame: tracer.sphere.frame,
            radius_mm: tracer.sphere.radius,
            n_vitreous: tracer.sphere.n_vitreous,
            wavelength_nm,
            rays,
            edge,
        })
    }

    /// Wavelength in the vitreous, mm.
    pub fn wavelength_mm(&self) -> f64 {
        self.wavelength_nm * 1e-6 / self.n_vitreous
    }

    /// Mean square path difference over the stop after piston and tilt are taken out, mm² of vitreous.
    pub fn variance_mm2(&self) -> f64 {
        let (mut m, mut v, mut square, mut total) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
        let scale = self.rays.iter().map(|r| r.q.length()).fold(1e-12, f64::max);
        for r in &self.rays {
            let basis = DVec3::new(1.0, r.q.x / scale, r.q.y / scale);
            m += r.weight * DMat3::from_cols(basis * basis.x, basis * basis.y, basis * basis.z);
            v += r.weight * r.opd_mm * basis;
            square += r.weight * r.opd_mm * r.opd_mm;
            total += r.weight;
        }
        if m.determinant().abs() < 1e-30 {
            return square / total.max(1e-30);
        }
        ((square - v.dot(m.inverse() * v)) / total).max(0.0)
    }
}

/// A solved ray that others start from: stop point (mm), launch point (mm), inverse slope.
type Seed = (DVec2, DVec2, DMat2);

struct Tracer<'a> {
    aimer: Aimer<'a>,
    sphere: Sphere,
    chief_path: f64,
    start: Seed,
}

impl Tracer<'_> {
    /// One ray after the other, each aimed from the one before it or, when that is farther off, from the chief ray.
    fn rays(&self, points: &[(DVec2, f64)]) -> Option<Vec<PupilRay>> {
        let radius = self.aimer.stop_radius_mm();
        let mut seed = self.start;
        points
            .iter()
            .map(|&(stop, weight)| {
                let target = stop * radius;
                if (target - seed.0).length() > target.length() {
                    seed = self.start;
                }
                let start = seed.1 + seed.2 * (target - seed.0);
                let uv = self.aimer.near(target, start, &mut seed.2)?;
                (seed.0, seed.1) = (target, uv);
                self.ray(stop, weight, uv)
            })
            .collect()
    }

    /// A measured wavefront error at a place of the stop, mm of air; 0 at its centre.
    fn extra_mm(&self, stop: DVec2) -> f64 {
        let Some((eye, wavefront)) = self.aimer.extra() else { return 0.0 };
        let radius_mm = eye.stop_radius_mm() * eye.stop_magnification();
        let at = |p: DVec2| wavefront.error_um(eye.state().side, p * radius_mm);
        1e-3 * (at(stop) - at(DVec2::ZERO))
    }

    fn ray(&self, stop: DVec2, weight: f64, uv: DVec2) -> Option<PupilRay> {
        let (ray, before) = self.aimer.launch(uv);
        let traced = self.aimer.trace(&ray);
        // The rim may fail the iris by a rounding error; what counts is that the retina is reached.
        let landing = traced.hits[4]?;
        let (path, q) = self.sphere.meet(&traced, before)?;
        let path = path - self.extra_mm(stop);
        Some(PupilRay {
            stop,
            weight,
            launch: uv,
            irradiance: self.aimer.irradiance(uv),
            q: q.truncate(),
            q_normal: q.z,
            opd_mm: (path - self.chief_path) / self.sphere.n_vitreous,
            landing,
            path_mm: traced.path_mm,
        })
    }
}

impl PupilNodes {
    /// Points of the unit stop with weights that sum to π, spoke by spoke from the centre out.
    pub fn points(&self) -> Vec<(DVec2, f64)> {
        let radii = gauss_legendre(self.radial);
        let azimuths = self.azimuth.max(1) as f64;
        (0..self.azimuth)
            .flat_map(|a| {
                let way = DVec2::from_angle(2.0 * PI * (a as f64 + 0.5) / azimuths);
                radii.iter().map(move |&(x, w)| (way * (0.5 * (1.0 + x)).sqrt(), w * 0.5 * PI / azimuths))
            })
            .collect()
    }

    /// Points of the rim at azimuth 2πk/edge.
    pub fn rim(&self) -> Vec<(DVec2, f64)> {
        (0..self.edge).map(|k| (DVec2::from_angle(2.0 * PI * k as f64 / self.edge as f64), 0.0)).collect()
    }
}
