//! The wavefront of one object point and wavelength as polynomials over the pupil (§21).
//!
//! Pupil coordinates s: q = centre + axes·s, an affine map that takes the pupil to nearly the unit disc; q are the
//! direction cosines on the reference sphere along the retina's tangents (see [`crate::optics::bundle`]). Over s stand
//! * the path difference W(s), µm of vitreous, and
//! * the amplitude A(s) per ds: `Flux` A² = d(flux)/ds, so that ∫|field|² is the flux; `Uniform` A = d(stop area)/ds,
//!   every part of the stop weighs the same (ray-counting packages do this).
//!
//! A Stiles–Crawford apodization multiplies the amplitude by 10^(−ρ r²/2), r in mm of the entrance pupil, where the ray is traced to enter.

use super::chords::Chords;
use super::least_squares::LeastSquares;
use super::outline::Outline;
use super::polynomial::Polynomial2;
use super::quadrature::gauss_legendre;
use super::sincos::sin_cos_turns;
use crate::optics::{Object, OpticsError, PupilBundle, PupilNodes, SchematicEye};
use glam::{DMat2, DVec2, DVec3};
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// What the amplitude over the pupil follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Amplitude {
    /// √ of the ray map's Jacobian: each tube of rays keeps its flux.
    #[default]
    Flux,
    /// The area of the stop weighs evenly.
    Uniform,
}

/// Directional sensitivity of the cones, put into the pupil.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StilesCrawfordApodization {
    /// ρ of 10^(−ρ r²), per mm² of entrance pupil.
    pub rho_base10_per_mm2: f64,
}

/// How a wavefront is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WavefrontOptions {
    /// Amplitude over the pupil.
    pub amplitude: Amplitude,
    /// Directional sensitivity, if any.
    pub stiles_crawford: Option<StilesCrawfordApodization>,
    /// Degree of the polynomials; by default 8 to 4 mm of pupil, 12 beyond.
    pub degree: Option<usize>,
    /// Gauss nodes in r²; by default as many as the degree asks.
    pub radial_nodes: Option<usize>,
    /// Azimuths; by default as many as the degree asks.
    pub azimuth_nodes: Option<usize>,
}

/// A wavefront. Fields with no unit said are in pupil coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wavefront {
    /// Vacuum wavelength, nm.
    pub wavelength_nm: f64,
    /// Index of the vitreous.
    pub n_vitreous: f64,
    /// Landing point of the chief ray of this wavelength: (x_um, y_um).
    pub landing_um: DVec2,
    /// The same in the eye's frame, mm.
    pub landing: DVec3,
    /// Direction of the retina's tangent away from the optical axis, radians from the x_um axis towards y_um.
    pub meridional_angle: f64,
    /// Radius of the reference sphere, µm.
    pub radius_um: f64,
    /// Direction cosines of the middle of the pupil.
    pub centre: DVec2,
    /// Direction cosines per pupil coordinate.
    pub axes: DMat2,
    /// Path difference to the chief ray, µm of vitreous.
    pub opd_um: Polynomial2,
    /// Amplitude per pupil coordinate area.
    pub amplitude: Polynomial2,
    /// Edge of the pupil.
    pub outline: Outline,
    /// Flux into the pupil for unit irradiance at the apex across the light, mm² (no absorption, no apodization).
    pub pupil_area_mm2: f64,
    /// Mean path in the cornea / axial path.
    pub path_cornea: f64,
    /// Mean path in the lens / axial path.
    pub path_lens: f64,
    /// Variance over the pupil of path in the lens / axial path.
    pub path_lens_variance: f64,
    /// ∫A over the pupil.
    pub amplitude_sum: f64,
    /// ∫A² without apodization.
    pub energy_open: f64,
    pub(super) throughput: f64,
    pub(super) rms_um: f64,
}

impl Wavefront {
    /// The wavefront of an object at a vacuum wavelength (nm).
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when a part of the pupil does not see the object or the retina;
    /// [`OpticsError::OutOfRange`] for the wavelength or ρ.
    pub fn new(
        eye: &SchematicEye,
        object: Object,
        wavelength_nm: f64,
        options: &WavefrontOptions,
    ) -> Result<Self, OpticsError> {
        Self::series(eye, object, &[wavelength_nm], options)?
            .pop()
            .ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })
    }

    /// The wavefronts of an object at several vacuum wavelengths (nm), each aimed from the one before it.
    ///
    /// # Errors
    /// As [`Wavefront::new`].
    pub fn series(
        eye: &SchematicEye,
        object: Object,
        wavelengths_nm: &[f64],
        options: &WavefrontOptions,
    ) -> Result<Vec<Self>, OpticsError> {
        let degree = options.degree.unwrap_or(if eye.state().pupil_mm <= 4.0 { 8 } else { 12 }).clamp(2, 20);
        let nodes = PupilNodes {
            radial: options.radial_nodes.unwrap_or(degree / 2 + 1).max(2),
            azimuth: options.azimuth_nodes.unwrap_or(2 * degree + 2).max(6),
            edge: 2 * degree + 5,
        };
        let (points, rim) = (nodes.thinned(), nodes.rim());
        let rho = options.stiles_crawford.map_or(0.0, |s| s.rho_base10_per_mm2);
        crate::optics::error::in_range("rho_base10_per_mm2", rho, -0.5, 0.5)?;
        let bundles = PupilBundle::trace_series(eye, object, wavelengths_nm, &points, &rim)?;
        // Per entrance pupil radius².
        let rho = rho * eye.entrance_radius_mm()?.powi(2);
        let fitted = |bundle: &PupilBundle| Self::fitted(eye, bundle, options.amplitude, rho, degree, object);
        bundles.iter().map(fitted).collect()
    }

    /// The wavefront through the rays of a bundle; `rho` is per entrance pupil radius².
    fn fitted(
        eye: &SchematicEye,
        bundle: &PupilBundle,
        kind: Amplitude,
        rho: f64,
        degree: usize,
        object: Object,
    ) -> Result<Self, OpticsError> {
        let Some((centre, axes)) = pupil_coordinates(bundle) else {
            return Err(OpticsError::NoRay { angle_deg: object.angle_deg() });
        };
        let fitted = Fitted::new(eye, bundle, kind, rho, degree, centre, axes);
        Ok(Self {
            wavelength_nm: bundle.wavelength_nm,
            n_vitreous: bundle.n_vitreous,
            landing_um: eye.fovea().um_from_point(bundle.landing),
            landing: bundle.landing,
            meridional_angle: meridional_angle_of(eye, bundle),
            radius_um: 1e3 * bundle.radius_mm,
            centre,
            axes,
            opd_um: fitted.opd,
            amplitude: fitted.amplitude,
            outline: fitted.outline,
            pupil_area_mm2: fitted.flux,
            path_cornea: fitted.path_cornea,
            path_lens: fitted.path_lens,
            path_lens_variance: fitted.path_lens_variance,
            amplitude_sum: fitted.amplitude_sum,
            energy_open: fitted.energy_open,
            throughput: fitted.throughput,
            rms_um: bundle.variance_mm2().sqrt() * 1e3,
        })
    }

    /// A pupil that fills the disc of direction cosines |q| ≤ `sine` evenly, with a path difference (µm, over q/sine):
    /// for tests against closed forms.
    pub fn disc(sine: f64, wavelength_nm: f64, n_vitreous: f64, opd_um: Polynomial2) -> Self {
        let mut wavefront = Self {
            wavelength_nm,
            n_vitreous,
            landing_um: DVec2::ZERO,
            landing: DVec3::ZERO,
            meridional_angle: 0.0,
            radius_um: f64::INFINITY,
            centre: DVec2::ZERO,
            axes: DMat2::from_diagonal(DVec2::splat(sine)),
            opd_um,
            amplitude: Polynomial2::new(0, vec![1.0]),
            outline: Outline::circle(),
            pupil_area_mm2: PI,
            path_cornea: 1.0,
            path_lens: 1.0,
            path_lens_variance: 0.0,
            amplitude_sum: PI,
            energy_open: PI,
            throughput: 1.0,
            rms_um: 0.0,
        };
        let [mean, square] = wavefront.over_pupil(40, |s| {
            let w = wavefront.opd_um.at(s);
            [w, w * w]
        });
        wavefront.rms_um = (square / PI - (mean / PI).powi(2)).max(0.0).sqrt();
        wavefront
    }

    /// The wavefront of the object mirrored in the plane of the optical axis and the fovea, for an eye that has this symmetry: the
    /// superior component of directions and places changes sign, that of the pupil coordinates (the first) too.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let (place, pupil) = (DVec2::new(1.0, -1.0), DVec2::new(-1.0, 1.0));
        let sign = |m: usize| if m.is_multiple_of(2) { 1.0 } else { -1.0 };
        // The azimuth α in the stop becomes π − α.
        let harmonics = self.outline.harmonics.iter().enumerate();
        let harmonics = harmonics.map(|(m, (c, s))| (sign(m) * pupil * *c, -sign(m) * pupil * *s)).collect();
        Self {
            landing_um: place * self.landing_um,
            landing: DVec3::new(-1.0, 1.0, 1.0) * self.landing,
            meridional_angle: -self.meridional_angle,
            centre: place * self.centre,
            axes: DMat2::from_diagonal(place) * self.axes * DMat2::from_diagonal(pupil),
            opd_um: self.opd_um.mirrored_x(),
            amplitude: self.amplitude.mirrored_x(),
            outline: Outline { harmonics },
            ..self.clone()
        }
    }

    /// ∫ f(s) ds over the pupil by `nodes`² nodes on chords.
    fn over_pupil<const N: usize>(&self, nodes: usize, f: impl Fn(DVec2) -> [f64; N]) -> [f64; N] {
        let chords = Chords::new(&self.outline);
        let rule = gauss_legendre(nodes);
        let mut sum = [0.0; N];
        for (chord, wu) in chords.rule(nodes) {
            for &(v, wv) in &rule {
                let s = DVec2::new(chord.middle + 0.5 * chord.length * v, chord.y);
                let weight = wu * wv * 0.5 * chord.length;
                for (total, value) in sum.iter_mut().zip(f(s)) {
                    *total += weight * value;
                }
            }
        }
        sum
    }

    /// Wavelength in the vitreous, µm.
    pub fn wavelength_um(&self) -> f64 {
        self.wavelength_nm * 1e-3 / self.n_vitreous
    }

    /// Path difference left after piston and tilt, root mean square over the stop, in waves.
    pub fn rms_waves(&self) -> f64 {
        self.rms_um / self.wavelength_um()
    }

    /// Intensity at the landing point of the chief ray / that of the same pupil without path differences.
    pub fn strehl(&self) -> f64 {
        let nodes = 24 + (4.0 * self.largest_slope() / self.wavelength_um()).min(400.0) as usize;
        let [re, im] = self.over_pupil(nodes, |s| {
            let (sin, cos) = sin_cos_turns(self.opd_um.at(s) / self.wavelength_um());
            let a = self.amplitude.at(s);
            [a * cos, a * sin]
        });
        Complex64::new(re, im).norm_sqr() / (self.amplitude_sum * self.amplitude_sum)
    }

    /// Centroid of the point spread from the landing point of the chief ray: the mean over the pupil's light of where rays land, µm along
    /// x_um and y_um.
    pub fn centroid_um(&self) -> DVec2 {
        let [by_x, by_y] = self.opd_um.gradient();
        let [x, y, energy] = self.over_pupil(20, |s| {
            let e = self.amplitude.at(s).powi(2);
            [e * by_x.at(s), e * by_y.at(s), e]
        });
        self.axes.inverse().transpose() * DVec2::new(x, y) / energy
    }

    /// Flux with the apodization / flux without; 1 without Stiles–Crawford.
    pub fn throughput(&self) -> f64 {
        self.throughput
    }

    /// Probability density per µm² (it integrates to [`Wavefront::throughput`] over the whole plane) of a relative
    /// intensity of 1.
    pub fn density_per_um2(&self) -> f64 {
        let sum = self.amplitude_sum;
        sum * sum * self.axes.determinant().abs() / (self.wavelength_um().powi(2) * self.energy_open)
    }

    /// Largest |dW/ds| on a sample of the pupil, µm.
    pub(super) fn largest_slope(&self) -> f64 {
        let [x, y] = self.opd_um.gradient();
        self.samples().map(|s| x.at(s).hypot(y.at(s))).fold(0.0, f64::max)
    }

    /// Points over the pupil, dense enough to find maxima.
    pub(super) fn samples(&self) -> impl Iterator<Item = DVec2> + '_ {
        let centre = self.outline.harmonics.first().map_or(DVec2::ZERO, |h| h.0);
        (0..16).flat_map(move |k| {
            let edge = self.outline.at(PI * f64::from(k) / 8.0)[0];
            [0.0, 0.35, 0.7, 1.0].map(|r| centre + r * (edge - centre))
        })
    }
}

/// What the fits give.
struct Fitted {
    opd: Polynomial2,
    amplitude: Polynomial2,
    outline: Outline,
    flux: f64,
    throughput: f64,
    amplitude_sum: f64,
    energy_open: f64,
    path_cornea: f64,
    path_lens: f64,
    path_lens_variance: f64,
}

impl Fitted {
    fn new(
        eye: &SchematicEye,
        bundle: &PupilBundle,
        kind: Amplitude,
        rho: f64,
        degree: usize,
        centre: DVec2,
        axes: DMat2,
    ) -> Self {
        let inverse = axes.inverse();
        let points: Vec<DVec2> = bundle.rays.iter().map(|r| inverse * (r.q - centre)).collect();
        let weights: Vec<f64> = bundle.rays.iter().map(|r| r.weight).collect();
        let design = LeastSquares::new(degree, &points, &weights);
        // Path difference, and the maps back to the stop and the launch plane for their Jacobians.
        let rays = || bundle.rays.iter();
        let opd = design.fit(rays().map(|r| r.opd_mm * 1e3));
        let (stop_x, stop_y) = (design.fit(rays().map(|r| r.stop.x)), design.fit(rays().map(|r| r.stop.y)));
        let (launch_x, launch_y) =
            (design.fit(rays().map(|r| r.launch.x)), design.fit(rays().map(|r| r.launch.y)));
        let per_s = Jacobians::new([&stop_x, &stop_y, &launch_x, &launch_y]);
        let (mut flux, mut sum, mut open, mut kept) = (0.0, 0.0, 0.0, 0.0);
        // Light that the cones accept, its paths in cornea and lens, and the square of the last.
        let (mut accepted, mut cornea, mut lens, mut square) = (0.0, 0.0, 0.0, 0.0);
        let mut amplitudes = Vec::with_capacity(points.len());
        for (ray, s) in bundle.rays.iter().zip(&points) {
            let [stop_area, launch_area] = per_s.at(*s);
            let flux_density = ray.irradiance * launch_area;
            let amplitude = match kind {
                Amplitude::Flux => flux_density.sqrt(),
                Amplitude::Uniform => stop_area,
            };
            let apodization = 10.0_f64.powf(-0.5 * rho * bundle.entrance(ray).length_squared());
            amplitudes.push(amplitude * apodization);
            // d(stop) = stop_area·ds turns the weights of the stop into sums over s.
            let ds = ray.weight / stop_area;
            sum += ds * amplitude * apodization;
            open += ds * amplitude * amplitude;
            kept += ds * (amplitude * apodization).powi(2);
            flux += ds * flux_density;
            let weight = ds * flux_density * apodization * apodization;
            let [_, in_cornea, _, in_lens, _] = ray.path_mm;
            accepted += weight;
            cornea += weight * in_cornea;
            lens += weight * in_lens;
            square += weight * in_lens * in_lens;
        }
        let amplitude = design.fit(amplitudes.into_iter());
        let rim: Vec<DVec2> = bundle.edge.iter().map(|r| inverse * (r.q - centre)).collect();
        let thickness = eye.thickness_mm();
        Self {
            opd,
            amplitude,
            outline: Outline::through(&rim),
            flux,
            throughput: kept / open,
            amplitude_sum: sum,
            energy_open: open,
            path_cornea: cornea / (accepted * thickness[0]),
            path_lens: lens / (accepted * thickness[2]),
            path_lens_variance: (square / accepted - (lens / accepted).powi(2)).max(0.0)
                / thickness[2].powi(2),
        }
    }
}

/// |∂(x, y)/∂s| of two maps of the plane, coefficient by coefficient beside each other.
struct Jacobians {
    degree: usize,
    coefficients: Vec<[f64; 4]>,
}

impl Jacobians {
    /// Of the maps (x, y) and (z, w), fitted with the same degree.
    fn new(maps: [&Polynomial2; 4]) -> Self {
        let [x, y, z, w] = maps.map(Polynomial2::coefficients);
        let coefficients = x.iter().zip(y).zip(z.iter().zip(w)).map(|((x, y), (z, w))| [*x, *y, *z, *w]);
        Self { degree: maps[0].degree(), coefficients: coefficients.collect() }
    }

    /// Both at a point, by Horner's scheme with its derivative.
    fn at(&self, s: DVec2) -> [f64; 2] {
        let times =
            |a: [f64; 4], t: f64, b: [f64; 4]| -> [f64; 4] { std::array::from_fn(|l| a[l] * t + b[l]) };
        let (mut value, mut by_x, mut by_y) = ([0.0; 4], [0.0; 4], [0.0; 4]);
        let mut end = self.coefficients.len();
        // Rows of equal power of x, the highest (the shortest) first.
        for length in 1..=self.degree + 1 {
            let row = &self.coefficients[end - length..end];
            end -= length;
            let (mut along, mut slope) = ([0.0; 4], [0.0; 4]);
            for c in row.iter().rev() {
                slope = times(slope, s.y, along);
                along = times(along, s.y, *c);
            }
            by_x = times(by_x, s.x, value);
            value = times(value, s.x, along);
            by_y = times(by_y, s.x, slope);
        }
        [0, 2].map(|l| (by_x[l] * by_y[l + 1] - by_y[l] * by_x[l + 1]).abs())
    }
}

/// Centre and axes of the affine map from the unit stop to direction cosines, by least squares (the nodes are
/// orthogonal: mean, and first moments over 1/4 of the weight).
fn pupil_coordinates(bundle: &PupilBundle) -> Option<(DVec2, DMat2)> {
    let total: f64 = bundle.rays.iter().map(|r| r.weight).sum();
    let centre = bundle.rays.iter().map(|r| r.q * r.weight).sum::<DVec2>() / total;
    let moment = |f: fn(DVec2) -> f64| {
        bundle.rays.iter().map(|r| (r.q - centre) * (r.weight * f(r.stop))).sum::<DVec2>() / (total / 4.0)
    };
    let axes = DMat2::from_cols(moment(|s| s.x), moment(|s| s.y));
    (axes.determinant().abs() > 1e-12).then_some((centre, axes))
}

/// Angle, in the local retina frame, of the tangent away from the optical axis; the fovea's meridian on the axis itself.
pub(super) fn meridional_angle_of(eye: &SchematicEye, bundle: &PupilBundle) -> f64 {
    meridional_angle_at(eye, bundle.landing, bundle.frame)
}

/// The same at a place of the retina with its frame.
pub(super) fn meridional_angle_at(eye: &SchematicEye, landing: DVec3, frame: [DVec3; 3]) -> f64 {
    let outward = landing - eye.retina_centre();
    let lateral = outward.truncate();
    let sine = lateral.length();
    let way = if sine > 1e-9 { lateral / sine } else { DVec2::Y };
    let tangent = DVec3::new(way.x * outward.z, way.y * outward.z, -sine);
    tangent.dot(frame[1]).atan2(tangent.dot(frame[0]))
}
