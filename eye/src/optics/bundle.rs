//! The rays of one object and wavelength at polar Gauss nodes of the real stop, each with its place and path on the
//! reference sphere.
//!
//! The reference sphere is centred on the landing point c of the chief ray and goes through the point of the chief ray
//! nearest to the centre of the exit pupil. A ray that meets it at Q has the direction cosines q = (Q − c)/|Q − c| along
//! the retina's tangents at c (not those of the ray itself: that form is wrong by 0.4–15 %), and the path difference
//! w = (optical path of the ray − that of the chief ray)/n', in mm of vitreous.
//!
//! Nodes: Gauss–Legendre in r² times uniform azimuth; weights sum to π, the area of the unit stop.

use super::aim::{Aimed, Aimer, Launch};
use super::error::OpticsError;
use super::object::Object;
use super::schematic_eye::SchematicEye;
use super::trace::Traced;
use crate::exposure::nodes::lagrange;
use crate::psf::quadrature::gauss_legendre;
use glam::{DMat2, DMat3, DVec2, DVec3};
use std::f64::consts::PI;

/// How many wavelengths before are continued.
const CONTINUED: usize = 2;

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
    /// How the rays and those of the edge were launched.
    launches: [Vec<Launch>; 2],
    /// Launch point of the chief ray, mm, and d(launch)/d(stop) there, mm per stop radius.
    chief_launch: (DVec2, DMat2),
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
        Self::trace_from(eye, object, wavelength_nm, [points, rim], None)
    }

    /// The rays of several wavelengths through the same points, each aimed by continuing those of the wavelengths before it.
    ///
    /// # Errors
    /// As [`PupilBundle::trace`].
    pub fn trace_series(
        eye: &SchematicEye,
        object: Object,
        wavelengths_nm: &[f64],
        points: &[(DVec2, f64)],
        rim: &[(DVec2, f64)],
    ) -> Result<Vec<Self>, OpticsError> {
        let mut made: Vec<Self> = Vec::with_capacity(wavelengths_nm.len());
        for &nm in wavelengths_nm {
            let guess = Self::continued(&made[made.len().saturating_sub(CONTINUED)..], nm);
            made.push(Self::trace_from(eye, object, nm, [points, rim], guess.as_ref())?);
        }
        Ok(made)
    }

    /// The launches at a wavelength on the polynomial through those of these bundles.
    fn continued(bundles: &[Self], wavelength_nm: f64) -> Option<[Vec<Launch>; 2]> {
        let last = bundles.last()?;
        let nodes: Vec<f64> = bundles.iter().map(|bundle| bundle.wavelength_nm).collect();
        let weights = lagrange(&nodes, wavelength_nm);
        let sum = |k: usize, i: usize| {
            let mut sum = Launch { uv: DVec2::ZERO, inverse: DMat2::ZERO };
            for (bundle, weight) in bundles.iter().zip(&weights) {
                let launch = &bundle.launches[k][i];
                sum.uv += *weight * launch.uv;
                sum.inverse += *weight * launch.inverse;
            }
            sum
        };
        Some([0, 1].map(|k| (0..last.launches[k].len()).map(|i| sum(k, i)).collect()))
    }

    fn trace_from(
        eye: &SchematicEye,
        object: Object,
        wavelength_nm: f64,
        [points, rim]: [&[(DVec2, f64)]; 2],
        guess: Option<&[Vec<Launch>; 2]>,
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
        let tracer = Tracer { aimer, sphere, chief_path, start: Launch { uv: chief_uv, inverse } };
        let [inner, outer] = guess.map_or([None; 2], |[inner, outer]| [Some(&inner[..]), Some(&outer[..])]);
        let (rays, inner) = tracer.rays(points, inner).ok_or_else(lost)?;
        let (edge, outer) = tracer.rays(rim, outer).ok_or_else(lost)?;
        Ok(Self {
            chief,
            landing,
            frame: tracer.sphere.frame,
            radius_mm: tracer.sphere.radius,
            n_vitreous: tracer.sphere.n_vitreous,
            wavelength_nm,
            rays,
            edge,
            launches: [inner, outer],
            chief_launch: (chief_uv, inverse * eye.stop_radius_mm()),
        })
    }

    /// Where a ray enters, from the chief ray, in radii of the entrance pupil ([`SchematicEye::entrance_radius_mm`]): `r = M⁻¹ (l - l₀)`,
    /// l the place in the launch plane, M = d(l)/d(stop) at the chief ray. To first order the place in the stop; the difference is the
    /// aberration of the entrance pupil.
    pub fn entrance(&self, ray: &PupilRay) -> DVec2 {
        let (chief, slope) = self.chief_launch;
        slope.inverse() * (ray.launch - chief)
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

struct Tracer<'a> {
    aimer: Aimer<'a>,
    sphere: Sphere,
    chief_path: f64,
    /// The chief ray's.
    start: Launch,
}

impl Tracer<'_> {
    /// One ray after the other, each aimed from its `guess` or else from the one before it or, when that is farther off, from the chief
    /// ray.
    fn rays(
        &self,
        points: &[(DVec2, f64)],
        guess: Option<&[Launch]>,
    ) -> Option<(Vec<PupilRay>, Vec<Launch>)> {
        let radius = self.aimer.stop_radius_mm();
        let mut seed = (DVec2::ZERO, self.start);
        let mut launches = Vec::with_capacity(points.len());
        let mut rays = Vec::with_capacity(points.len());
        for (k, &(stop, weight)) in points.iter().enumerate() {
            let target = stop * radius;
            let start = guess.and_then(|guess| guess.get(k).copied()).unwrap_or_else(|| {
                if (target - seed.0).length() > target.length() {
                    seed = (DVec2::ZERO, self.start);
                }
                let uv = seed.1.uv + seed.1.inverse * (target - seed.0);
                Launch { uv, ..seed.1 }
            });
            let aimed = self.aimer.near(target, start)?;
            seed = (target, aimed.launch);
            launches.push(aimed.launch);
            rays.push(self.ray(weight, &aimed)?);
        }
        Some((rays, launches))
    }

    /// A measured wavefront error at a place of the stop, mm of air; 0 at its centre.
    fn extra_mm(&self, stop: DVec2) -> f64 {
        let Some((eye, wavefront)) = self.aimer.extra() else { return 0.0 };
        let radius_mm = 0.5 * eye.state().pupil_mm;
        let at = |p: DVec2| wavefront.error_um(eye.state().side, p * radius_mm);
        1e-3 * (at(stop) - at(DVec2::ZERO))
    }

    fn ray(&self, weight: f64, aimed: &Aimed) -> Option<PupilRay> {
        let traced = &aimed.traced;
        let stop = aimed.stop / self.aimer.stop_radius_mm();
        // The rim may fail the iris by a rounding error; what counts is that the retina is reached.
        let landing = traced.hits[4]?;
        let (path, q) = self.sphere.meet(traced, aimed.path_before)?;
        let path = path - self.extra_mm(stop);
        Some(PupilRay {
            stop,
            weight,
            launch: aimed.launch.uv,
            irradiance: self.aimer.irradiance(aimed.launch.uv),
            q: q.truncate(),
            q_normal: q.z,
            opd_mm: (path - self.chief_path) / self.sphere.n_vitreous,
            landing,
            path_mm: traced.path_mm,
        })
    }
}

impl PupilNodes {
    /// Points of the unit stop with weights that sum to π, ring by ring from the innermost.
    pub fn points(&self) -> Vec<(DVec2, f64)> {
        self.rings(|_| self.azimuth)
    }

    /// The same with fewer azimuths on inner rings: harmonic m of a smooth function falls as the m-th power of the radius.
    pub fn thinned(&self) -> Vec<(DVec2, f64)> {
        let whole = self.azimuth as f64;
        self.rings(|radius| (0.5 * whole * (0.35 + 0.75 * radius).min(1.0)).ceil() as usize * 2)
    }

    fn rings(&self, azimuths: impl Fn(f64) -> usize) -> Vec<(DVec2, f64)> {
        let ring = |(x, w): (f64, f64)| {
            let radius = (0.5 * (1.0 + x)).sqrt();
            let count = azimuths(radius);
            let each = PI / count as f64;
            (0..count).map(move |a| (radius * DVec2::from_angle((2 * a + 1) as f64 * each), 0.5 * w * each))
        };
        gauss_legendre(self.radial).into_iter().flat_map(ring).collect()
    }

    /// Points of the rim at azimuth 2πk/edge.
    pub fn rim(&self) -> Vec<(DVec2, f64)> {
        (0..self.edge).map(|k| (DVec2::from_angle(2.0 * PI * k as f64 / self.edge as f64), 0.0)).collect()
    }
}
