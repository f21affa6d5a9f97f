//! Optical transfer of one field point at one wavelength as a polar table.
//!
//! A compact spread: along each direction the transfer function is computed at Chebyshev points in u, where |ν| = cutoff·(1 - (1-u)²),
//! which flattens its (1-x)^{3/2} end at the cutoff, and interpolated by the barycentric formula; over azimuth, where it is periodic,
//! by trigonometric interpolation. A wide one: by fast transforms ([`TransferMap`]) but for the tip and the end, which are computed
//! as before. The transverse chromatic shift is put in afterwards, exactly.

use glam::{DMat2, DVec2};
use rustfft::num_complex::Complex64;

use super::polar::PolarShape;
use crate::optics::{Object, Projection};
use crate::psf::quadrature::Rules;
use crate::psf::{Otf, StilesCrawfordApodization, TransferMap, Wavefront, WavefrontOptions, WavefrontTable};

/// Fewest points along a direction, over the whole range and over its tip or end.
const MIN_RADIAL: [usize; 2] = [18, 8];
/// Fewest directions over [0, π).
const MIN_AZIMUTHAL: usize = 14;
/// Points more per cycle of the spread's edge, along and around.
const RADIAL_PER_CYCLE: f64 = 2.5;
const AZIMUTHAL_PER_CYCLE: f64 = 2.0;
/// Spot radius, in cycles per pupil radius, from which the fast transforms are less work.
const MAP_FROM_TURNS: f64 = 1.5;

/// Part of the tip over which its quadrature goes over into the fast transforms. They differ slightly, and a
/// sudden step would become rings of light far from the source when moments are taken of the table
/// ([`super::around`]).
const BLEND: f64 = 0.5;

/// A point of the field.
#[derive(Clone, Debug)]
pub struct FieldPoint {
    /// The point of the screen, tangents.
    pub tangent: DVec2,
    /// What is imaged there.
    pub object: Object,
    /// Landing point at the reference wavelength, µm.
    pub landing_um: DVec2,
    /// Displacement from there of what stands for the image, µm.
    anchor_um: DVec2,
    /// Frequencies on the retina (cycles/µm along its local tangents) from frequencies on the screen (cycles per unit tangent).
    pub frequency_map: DMat2,
    /// Screen tangents per µm of retinal coordinates.
    tangent_from_um: DMat2,
}

impl FieldPoint {
    /// The point of the screen imaged on a point of the retina (µm).
    ///
    /// # Errors
    /// When the retinal point sees no screen.
    pub fn new(projection: &Projection, um: DVec2) -> Result<Self, String> {
        let tangent = projection.screen_tangent(um).map_err(|e| e.to_string())?;
        Self::of(projection, tangent, um)
    }

    /// The same by the point of the screen (unit tangents).
    ///
    /// # Errors
    /// When the point of the screen is not seen.
    pub fn at_tangent(projection: &Projection, tangent: DVec2) -> Result<Self, String> {
        let nm = projection.eye().prescription().reference_wavelength_nm;
        let um = projection.retina_um(tangent, nm).map_err(|e| e.to_string())?;
        Self::of(projection, tangent, um)
    }

    fn of(projection: &Projection, tangent: DVec2, um: DVec2) -> Result<Self, String> {
        let jacobian = projection.jacobian_um_per_tangent(tangent).map_err(|e| e.to_string())?;
        // Coordinates are arcs from the foveal centre: around it a step is shorter by sin(arc)/arc.
        let arc = um.length() / (1e3 * projection.eye().fovea().radius_mm);
        let around = if arc > 1e-6 { arc.sin() / arc } else { 1.0 };
        let way = um.normalize_or_zero();
        let side = way.perp();
        let local = DMat2::from_cols(way * way.x, way * way.y)
            + around * DMat2::from_cols(side * side.x, side * side.y);
        let local = if arc > 1e-6 { local } else { DMat2::IDENTITY };
        Ok(Self {
            tangent,
            object: projection.object(tangent),
            landing_um: um,
            anchor_um: DVec2::ZERO,
            frequency_map: (local * jacobian).inverse().transpose(),
            tangent_from_um: jacobian.inverse(),
        })
    }

    /// The same with images displaced by `um`, which changes over the retina by `slope`: the screen is mapped to displaced images.
    #[must_use]
    pub fn anchored(self, um: DVec2, slope: DMat2) -> Self {
        let local = self.frequency_map.transpose().inverse() * self.tangent_from_um;
        let jacobian = (DMat2::IDENTITY + slope) * self.tangent_from_um.inverse();
        Self {
            anchor_um: um,
            frequency_map: (local * jacobian).inverse().transpose(),
            tangent_from_um: jacobian.inverse(),
            ..self
        }
    }

    /// A step on the chart from a step along the retina's tangents, µm.
    pub fn chart_from_tangents(&self) -> DMat2 {
        self.tangent_from_um.inverse() * self.frequency_map.transpose()
    }

    /// Where a wavefront's chief ray lands, from that of the reference wavelength, as a shift of the screen (unit tangents).
    fn shift(&self, wavefront: &Wavefront) -> DVec2 {
        self.tangent_from_um * (wavefront.landing_um - self.landing_um - self.anchor_um)
    }
}

/// Transfer at one field point and wavelength.
#[derive(Clone, Debug)]
pub struct Transfer {
    /// `[azimuth][radius]`.
    pub table: Vec<Complex64>,
    /// Share of the pupil's light that is accepted.
    pub throughput: f64,
}

impl Transfer {
    /// Every value of the table times a factor.
    #[must_use]
    pub fn times(mut self, factor: f64) -> Self {
        self.table.iter_mut().for_each(|value| *value *= factor);
        self
    }
}

/// Some of a table's radii, computed at a few points along and around and interpolated to the table's.
#[derive(Clone, Copy, Debug)]
struct Ring {
    /// First and last radius, samples.
    radii: [usize; 2],
    /// Points along each direction and directions over [0, π).
    points: [usize; 2],
}

/// Wavefronts `[wavelength]` of a field point.
///
/// # Errors
/// When the pupil cannot be traced.
pub fn wavefronts(
    projection: &Projection,
    point: &FieldPoint,
    nodes_nm: &[f64],
    rho10_per_mm2: f64,
) -> Result<Vec<Wavefront>, String> {
    let options = wavefront_options(rho10_per_mm2);
    WavefrontTable::spectrum(projection.eye(), point.object, nodes_nm, &options).map_err(|e| e.to_string())
}

/// How wavefronts are made with a Stiles-Crawford coefficient.
pub fn wavefront_options(rho10_per_mm2: f64) -> WavefrontOptions {
    let stiles_crawford =
        (rho10_per_mm2 > 0.0).then_some(StilesCrawfordApodization { rho_base10_per_mm2: rho10_per_mm2 });
    WavefrontOptions { stiles_crawford, ..WavefrontOptions::default() }
}

/// Radius of the geometric spread and distance of its chief ray from the point imaged at the reference wavelength, on the screen
/// (unit tangents): the rates at which the transfer oscillates, cycles per frequency.
pub fn extent(point: &FieldPoint, wavefront: &Wavefront) -> [f64; 2] {
    let spot = point.frequency_map.transpose() * DVec2::splat(spot_radius_um(wavefront) / 2.0_f64.sqrt());
    [spot.length(), point.shift(wavefront).length()]
}

/// The same about the centroid of the light: radius of the geometric PSF and distance from the anchor of images.
pub fn extent_about_centroid(point: &FieldPoint, wavefront: &Wavefront) -> [f64; 2] {
    let (to_cosines, centroid) = (wavefront.axes.inverse().transpose(), wavefront.centroid_um());
    let radius = slopes(wavefront).map(|g| (to_cosines * g - centroid).length()).fold(0.0, f64::max);
    let spot = point.frequency_map.transpose() * DVec2::splat(radius / 2.0_f64.sqrt());
    let moved = point.tangent_from_um * (point.chart_from_tangents() * centroid);
    [spot.length(), (point.shift(wavefront) + moved).length()]
}

/// The transfer table of a field point at a wavelength.
pub fn transfer_table(point: &FieldPoint, wavefront: &Wavefront, shape: PolarShape) -> Transfer {
    let otf = Otf::new(wavefront);
    let last = shape.radial - 1;
    let mut table = vec![Complex64::ZERO; shape.len()];
    // Shift in the pupil, in its radii, at the table's last radius.
    let to_shift = wavefront.axes.inverse() * wavefront.wavelength_um() * point.frequency_map;
    let stretch =
        |k: u32| (to_shift * DVec2::from_angle(f64::from(k) * std::f64::consts::PI / 24.0)).length();
    let (least, most) = (0..24).map(stretch).fold((f64::MAX, 0.0_f64), |(a, b), s| (a.min(s), b.max(s)));
    let band = shape.radius * most;
    let turns = spot_turns(wavefront);
    let map = (turns > MAP_FROM_TURNS).then(|| TransferMap::new(wavefront, band)).flatten();
    let Some(map) = map else {
        rings(&otf, point, &mut table, shape, &[Ring::new([0, last], [turns * band.min(2.0); 2], false)]);
        return finish(point, wavefront, table, shape);
    };
    let step = shape.radius / last as f64;
    let inner = ((map.least() / (step * least)).ceil() as usize).min(last);
    let outer = ((map.most() / (step * most)).floor() as usize).clamp(inner, last);
    // Compute the tip and the end by quadrature.
    let tip = turns * step * inner as f64 * most;
    let mut left = vec![Ring::new([0, inner], [tip, tip], true)];
    if outer < last {
        let whole = turns * band.min(2.0);
        left.push(Ring::new([outer + 1, last], [whole - turns * map.most().min(band), whole], true));
    }
    rings(&otf, point, &mut table, shape, &left);
    // Blend into the map over the outer half of the tip and as far into the end.
    let width = (BLEND * inner as f64).max(1.0);
    for (j, line) in table.chunks_mut(shape.radial).enumerate() {
        let unit = point.frequency_map * shape.frequency(j, 1);
        for (i, value) in line.iter_mut().enumerate() {
            let inside = smooth_step(1.0 - (inner as f64 - i as f64) / width);
            let outside = if outer < last { smooth_step((i as f64 - outer as f64) / width) } else { 0.0 };
            let part = inside * (1.0 - outside);
            if part > 0.0 {
                *value = (1.0 - part) * *value + part * map.value(unit * i as f64);
            }
        }
    }
    finish(point, wavefront, table, shape)
}

/// 0 below 0, 1 above 1, with two continuous derivatives.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

impl Ring {
    /// A ring over which the transfer goes through so many cycles along and around; `part` of the range or all of it.
    fn new(radii: [usize; 2], cycles: [f64; 2], part: bool) -> Self {
        let least = MIN_RADIAL[usize::from(part)];
        let radial = least + (RADIAL_PER_CYCLE * cycles[0]).ceil() as usize;
        let azimuthal = MIN_AZIMUTHAL + (AZIMUTHAL_PER_CYCLE * cycles[1]).ceil() as usize;
        Self { radii, points: [radial, azimuthal] }
    }
}

/// Puts in the chromatic shift.
fn finish(
    point: &FieldPoint,
    wavefront: &Wavefront,
    mut table: Vec<Complex64>,
    shape: PolarShape,
) -> Transfer {
    shift(&mut table, point.shift(wavefront), shape);
    Transfer { table, throughput: wavefront.throughput() }
}

/// Largest distance from the chief ray's landing point at which rays land, µm: the gradient of the path difference.
pub fn spot_radius_um(wavefront: &Wavefront) -> f64 {
    let to_cosines = wavefront.axes.inverse().transpose();
    slopes(wavefront).map(|g| (to_cosines * g).length()).fold(0.0, f64::max)
}

/// The same in cycles per pupil coordinate.
fn spot_turns(wavefront: &Wavefront) -> f64 {
    slopes(wavefront).map(DVec2::length).fold(0.0, f64::max) / wavefront.wavelength_um()
}

/// Gradients of the path difference over the pupil, µm per pupil coordinate.
fn slopes(wavefront: &Wavefront) -> impl Iterator<Item = DVec2> + use<> {
    let [by_x, by_y] = wavefront.opd_um.gradient();
    let points = (0..4).flat_map(|ring| {
        (0..12).map(move |i| {
            DVec2::from_angle(f64::from(i) * std::f64::consts::FRAC_PI_6) * (0.25 * f64::from(ring + 1))
        })
    });
    points.map(move |p| DVec2::new(by_x.at(p), by_y.at(p)))
}

/// Computes rings of the table by quadrature.
fn rings(otf: &Otf, point: &FieldPoint, table: &mut [Complex64], shape: PolarShape, rings: &[Ring]) {
    let mut rules = Rules::default();
    for ring in rings {
        let directions: Vec<Vec<Complex64>> = (0..ring.points[1])
            .map(|j| {
                let angle = std::f64::consts::PI * j as f64 / ring.points[1] as f64;
                along(otf, &mut rules, point.frequency_map * DVec2::from_angle(angle), *ring, shape)
            })
            .collect();
        over_azimuth(&directions, *ring, table, shape);
    }
}

/// Transfer along a direction at the table's radii of a ring; `unit` is the retinal frequency of a unit screen frequency.
fn along(otf: &Otf, rules: &mut Rules, unit: DVec2, ring: Ring, shape: PolarShape) -> Vec<Complex64> {
    let per_radius = shape.radius / (shape.radial - 1) as f64 * unit.length();
    let u = |x: f64| 1.0 - (1.0 - x.min(1.0)).sqrt();
    let last = (ring.points[0] - 1) as f64;
    let mut us = Vec::with_capacity(ring.points[0]);
    let mut step = 0.0;
    // u = 1 is the cutoff, or the ring's last radius when that comes first.
    let values = otf.along(unit.y.atan2(unit.x), rules, |cutoff| {
        step = per_radius / cutoff;
        let [from, to] = ring.radii.map(|i| u(step * i as f64));
        let chebyshev = |i: usize| 0.5 * (1.0 - (std::f64::consts::PI * i as f64 / last).cos());
        us.extend((0..ring.points[0]).map(|i| from + (to - from) * chebyshev(i)));
        us.iter().map(|u| cutoff * (1.0 - (1.0 - u) * (1.0 - u))).collect()
    });
    (ring.radii[0]..=ring.radii[1])
        .map(|i| {
            let x = step * i as f64;
            if x >= 1.0 { Complex64::ZERO } else { barycentric(&us, &values, u(x)) }
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
fn over_azimuth(directions: &[Vec<Complex64>], ring: Ring, table: &mut [Complex64], shape: PolarShape) {
    let n = 2 * directions.len();
    for (j, line) in table.chunks_mut(shape.radial).enumerate() {
        let angle = std::f64::consts::PI * j as f64 / shape.azimuthal as f64;
        for (d, direction) in directions.iter().enumerate() {
            let at = std::f64::consts::PI * d as f64 / directions.len() as f64;
            let (near, far) = (dirichlet(angle - at, n), dirichlet(angle - at - std::f64::consts::PI, n));
            // near·z + far·conj(z).
            let (re, im) = (near + far, near - far);
            for (value, sample) in line[ring.radii[0]..=ring.radii[1]].iter_mut().zip(direction) {
                *value += Complex64::new(re * sample.re, im * sample.im);
            }
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Dispersion, EyeState, Prescription, SchematicEye, Side};

    /// Where quadrature and fast transforms meet, a table goes on smoothly: a step of 1e-5 between two radii would be
    /// a twenty times larger sixth difference.
    #[test]
    fn tables_of_wide_psfs_are_smooth() {
        let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
        let state = EyeState {
            pupil_mm: 6.0,
            decentre_mm: 0.4,
            accommodation_a: 0.0,
            dispersion: Dispersion::Herzberger,
            side: Side::Right,
        };
        let eye = SchematicEye::new(&prescription, &state).unwrap();
        let projection = Projection::new(&eye, 8e3).unwrap();
        let point = FieldPoint::at_tangent(&projection, DVec2::new(-0.36, 0.0)).unwrap();
        let wave = &wavefronts(&projection, &point, &[543.0], 0.0).unwrap()[0];
        let shape = PolarShape { radius: 3000.0, radial: 1200, azimuthal: 8 };
        let table = transfer_table(&point, wave, shape).table;
        let rough = |line: &[Complex64]| -> f64 {
            // The tip's own slope ends at 0.
            let six = line[8..].windows(7).map(|v| {
                let ends = (v[0] + v[6]) - 6.0 * (v[1] + v[5]) + 15.0 * (v[2] + v[4]) - 20.0 * v[3];
                ends.norm()
            });
            six.fold(0.0, f64::max)
        };
        let most = table.chunks(shape.radial).map(rough).fold(0.0, f64::max);
        assert!(most < 2e-5, "{most:.1e}");
    }
}
