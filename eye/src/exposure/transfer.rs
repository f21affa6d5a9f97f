//! Optical transfer of one field point at one wavelength as a polar table.
//!
//! Along each direction the transfer function is computed at Chebyshev points in u, where |ν| = cutoff·(1 - (1-u)²), which
//! flattens its (1-x)^{3/2} end at the cutoff, and interpolated by the barycentric formula; over azimuth, where it is periodic,
//! by trigonometric interpolation. The transverse chromatic shift is put in afterwards, exactly.

use glam::{DMat2, DVec2};
use rustfft::num_complex::Complex64;

use super::polar::PolarShape;
use super::spectral::Paths;
use crate::optics::{Object, Projection};
use crate::psf::{Otf, StilesCrawfordApodization, Wavefront, WavefrontOptions};

/// Fewest points along a direction.
const MIN_RADIAL: usize = 20;
/// Fewest directions over [0, π).
const MIN_AZIMUTHAL: usize = 16;

/// A point of the field.
#[derive(Clone, Debug)]
pub struct FieldPoint {
    /// What is imaged there.
    pub object: Object,
    /// On the screen.
    pub tangent: DVec2,
    /// Landing point at the reference wavelength, µm.
    pub landing_um: DVec2,
    /// Frequencies on the retina (cycles/µm) from frequencies on the screen (cycles per unit tangent).
    pub frequency_map: DMat2,
}

impl FieldPoint {
    /// The point of the screen imaged on a point of the retina (µm).
    ///
    /// # Errors
    /// When the retinal point sees no screen.
    pub fn new(projection: &Projection, um: DVec2) -> Result<Self, String> {
        let tangent = projection.screen_tangent(um).map_err(|e| e.to_string())?;
        let jacobian = projection.jacobian_um_per_tangent(tangent).map_err(|e| e.to_string())?;
        Ok(Self {
            object: projection.object(tangent),
            tangent,
            landing_um: um,
            frequency_map: jacobian.inverse().transpose(),
        })
    }
}

/// Transfer at one field point and wavelength.
#[derive(Clone, Debug)]
pub struct Transfer {
    /// `[azimuth][radius]`.
    pub table: Vec<Complex64>,
    /// Share of the pupil's light that is accepted.
    pub throughput: f64,
    /// Path lengths in the media.
    pub paths: Paths,
}

/// The transfer table of a field point at a wavelength.
///
/// # Errors
/// When the pupil cannot be traced.
pub fn transfer_table(
    projection: &Projection,
    point: &FieldPoint,
    nm: f64,
    rho10_per_mm2: f64,
    shape: PolarShape,
) -> Result<Transfer, String> {
    let wavefront = wavefront(projection, point, nm, rho10_per_mm2)?;
    let otf = Otf::new(&wavefront);
    let landing = projection.retina_um(point.tangent, nm).map_err(|e| e.to_string())?;
    // Cycles of the spread's edge within the frequencies that are kept decide how finely the transfer oscillates.
    let kept = shape.radius * (point.frequency_map * DVec2::X).length();
    let cycles = spot_radius_um(&wavefront) * otf.cutoff(0.0).min(kept);
    let radial = MIN_RADIAL + (2.5 * cycles).ceil() as usize;
    let azimuthal = MIN_AZIMUTHAL + (2.0 * cycles).ceil() as usize;
    let directions: Vec<Vec<Complex64>> = (0..azimuthal)
        .map(|j| {
            let angle = std::f64::consts::PI * j as f64 / azimuthal as f64;
            along(&otf, point.frequency_map * DVec2::from_angle(angle), radial, shape)
        })
        .collect();
    let mut table = over_azimuth(&directions, shape);
    shift(&mut table, point.frequency_map.transpose() * (landing - point.landing_um), shape);
    let paths = Paths { cornea: wavefront.path_cornea, lens: wavefront.path_lens };
    Ok(Transfer { table, throughput: wavefront.throughput(), paths })
}

/// The wavefront of a field point at a wavelength.
///
/// # Errors
/// When the pupil cannot be traced.
pub fn wavefront(
    projection: &Projection,
    point: &FieldPoint,
    nm: f64,
    rho10_per_mm2: f64,
) -> Result<Wavefront, String> {
    let stiles_crawford =
        (rho10_per_mm2 > 0.0).then_some(StilesCrawfordApodization { rho_base10_per_mm2: rho10_per_mm2 });
    let options = WavefrontOptions { stiles_crawford, ..WavefrontOptions::default() };
    Wavefront::new(projection.eye(), point.object, nm, &options).map_err(|e| e.to_string())
}

/// Largest distance from the chief ray's landing point at which rays land, µm: the gradient of the path difference.
pub fn spot_radius_um(wavefront: &Wavefront) -> f64 {
    let [by_x, by_y] = wavefront.opd_um.gradient();
    let to_cosines = wavefront.axes.inverse().transpose();
    let points = (0..4).flat_map(|ring| {
        (0..12).map(move |i| {
            DVec2::from_angle(f64::from(i) * std::f64::consts::FRAC_PI_6) * (0.25 * f64::from(ring + 1))
        })
    });
    points.map(|p| (to_cosines * DVec2::new(by_x.at(p), by_y.at(p))).length()).fold(0.0, f64::max)
}

/// Transfer along a direction at the table's radii; `unit` is the retinal frequency of a unit screen frequency.
fn along(otf: &Otf, unit: DVec2, points: usize, shape: PolarShape) -> Vec<Complex64> {
    let direction = unit.y.atan2(unit.x);
    let cutoff = otf.cutoff(direction);
    // u = 1 is the cutoff, or the last radius of the table when that comes first.
    let kept = shape.radius * unit.length();
    let last_u = if kept < cutoff { 1.0 - (1.0 - kept / cutoff).sqrt() } else { 1.0 };
    let last = (points - 1) as f64;
    let chebyshev = |i: usize| 0.5 * last_u * (1.0 - (std::f64::consts::PI * i as f64 / last).cos());
    let us: Vec<f64> = (0..points).map(chebyshev).collect();
    let nus: Vec<f64> = us.iter().map(|u| cutoff * (1.0 - (1.0 - u) * (1.0 - u))).collect();
    let values = otf.radial(direction, &nus);
    let step = shape.radius / (shape.radial - 1) as f64 * unit.length() / cutoff;
    (0..shape.radial)
        .map(|i| {
            let x = step * i as f64;
            if x >= 1.0 { Complex64::ZERO } else { barycentric(&us, &values, 1.0 - (1.0 - x).sqrt()) }
        })
        .collect()
}

/// Barycentric interpolation on Chebyshev points of the second kind.
fn barycentric(nodes: &[f64], values: &[Complex64], at: f64) -> Complex64 {
    let last = nodes.len() - 1;
    let (mut above, mut below) = (Complex64::ZERO, 0.0);
    for (i, (node, value)) in nodes.iter().zip(values).enumerate() {
        let gap = at - node;
        if gap.abs() < 1e-14 {
            return *value;
        }
        let half = if i == 0 || i == last { 0.5 } else { 1.0 };
        let weight = if i % 2 == 0 { half } else { -half } / gap;
        above += weight * value;
        below += weight;
    }
    above / below
}

/// Trigonometric interpolation from `directions` over [0, π) (conjugate on the other half) to the table's azimuths.
fn over_azimuth(directions: &[Vec<Complex64>], shape: PolarShape) -> Vec<Complex64> {
    let n = 2 * directions.len();
    let mut table = vec![Complex64::ZERO; shape.len()];
    for (j, line) in table.chunks_mut(shape.radial).enumerate() {
        let angle = std::f64::consts::PI * j as f64 / shape.azimuthal as f64;
        for (d, direction) in directions.iter().enumerate() {
            let at = std::f64::consts::PI * d as f64 / directions.len() as f64;
            let (near, far) = (dirichlet(angle - at, n), dirichlet(angle - at - std::f64::consts::PI, n));
            for (value, sample) in line.iter_mut().zip(direction) {
                *value += near * sample + far * sample.conj();
            }
        }
    }
    table
}

/// Interpolation kernel of n equal samples (even) on the circle.
fn dirichlet(angle: f64, n: usize) -> f64 {
    let half = 0.5 * angle;
    if half.sin().abs() < 1e-12 {
        return 1.0;
    }
    (n as f64 * half).sin() / (n as f64 * half.tan())
}

/// Multiplies by the transform of a shift by `tangent` on the screen.
fn shift(table: &mut [Complex64], tangent: DVec2, shape: PolarShape) {
    for (j, line) in table.chunks_mut(shape.radial).enumerate() {
        let step = -std::f64::consts::TAU * shape.frequency(j, 1).dot(tangent);
        for (i, value) in line.iter_mut().enumerate() {
            *value *= Complex64::cis(step * i as f64);
        }
    }
}
