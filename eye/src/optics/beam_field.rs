//! The beam that enters the eye from every point of a screen, over that of the line of sight: a table to read.
//!
//! `B(t) = Φ(t)/(π d²/4)`, Φ the flux through the stop for unit irradiance at the corneal apex ([`super::beam`]), d the entrance
//! pupil's diameter, at the reference wavelength. It is 1 for a distant point on the line of sight by definition, falls with
//! the angle θ to the optical axis somewhat more slowly than cos θ (the cornea magnifies a pupil seen from the side), and
//! holds the entrance pupil's distance behind the apex, some 3 mm, by which a near screen's light is weaker.
//!
//! Chebyshev nodes in θ times harmonics of the azimuth about the optical axis, from which the stop is little decentred.
//!
//! # Accuracy
//! 1e-5 up to 80° from the optical axis (behind pupils of 9 mm some 65°: farther out a part of the stop is
//! not seen), tested against the traced beam; beyond, in proportion to cos θ.

use super::error::OpticsError;
use super::projection::Projection;
use super::screen::Screen;
use super::{Object, beam};
use crate::math;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Angles from the optical axis up to which beams are traced, degrees: the first at which the whole stop is
/// seen.
const MOST_DEG: [f64; 6] = [80.0, 70.0, 65.0, 60.0, 55.0, 50.0];
/// Least distance of a point of the screen that is taken, mm.
const NEAREST_MM: f64 = 50.0;
/// Nodes of the angle and of the azimuth.
const ANGLES: usize = 14;
const AZIMUTHS: usize = 8;

/// Beam over nominal area by the place on the screen.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamField {
    screen: Screen,
    axes: [DVec3; 3],
    /// Largest angle of the table, radians.
    most: f64,
    /// Nodes of the angle, radians.
    angles: Vec<f64>,
    /// By node of the angle: mean, then cosine and sine of each harmonic of the azimuth.
    harmonics: Vec<[f64; AZIMUTHS - 1]>,
}

/// Nodes of the angle, radians: Chebyshev points of the second kind from 0 to `most`.
fn angle_at(node: usize, most: f64) -> f64 {
    0.5 * most * (1.0 - math::sin_cos(PI * node as f64 / (ANGLES - 1) as f64).1)
}

impl BeamField {
    /// Traces the beams of a screen's eye.
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when the whole stop is not seen from directions up to 50° off the optical axis.
    pub fn new(projection: &Projection) -> Result<Self, OpticsError> {
        let mut made = Self::up_to(projection, MOST_DEG[0].to_radians());
        for degrees in &MOST_DEG[1..] {
            if made.is_ok() {
                break;
            }
            made = Self::up_to(projection, degrees.to_radians());
        }
        made
    }

    fn up_to(projection: &Projection, most: f64) -> Result<Self, OpticsError> {
        let eye = projection.eye();
        let nominal = beam::nominal_mm2(eye.state().pupil_mm);
        let nm = eye.prescription().reference_wavelength_nm;
        let axes = eye.view_axes();
        let relative = |node: usize, azimuth: usize| -> Result<f64, OpticsError> {
            let (sin, cos) = math::sin_cos(angle_at(node, most));
            let across = math::unit(TAU * azimuth as f64 / AZIMUTHS as f64);
            let direction = DVec3::new(sin * across.x, sin * across.y, cos);
            let vergence = vergence(projection, direction);
            Ok(eye.beam_mm2(Object::with_vergence(direction, vergence)?, nm)? / nominal)
        };
        let of_node = |node: usize| -> Result<[f64; AZIMUTHS - 1], OpticsError> {
            let values = (0..AZIMUTHS).map(|a| relative(node, a)).collect::<Result<Vec<f64>, _>>()?;
            Ok(harmonics(&values))
        };
        let harmonics = (0..ANGLES).into_par_iter().map(of_node).collect::<Result<_, _>>()?;
        let angles = (0..ANGLES).map(|node| angle_at(node, most)).collect();
        Ok(Self { screen: *projection.screen(), axes, most, angles, harmonics })
    }

    /// The screen.
    pub fn screen(&self) -> &Screen {
        &self.screen
    }

    /// The beam from the point `t` of the screen over the nominal area of the entrance pupil.
    pub fn relative(&self, t: DVec2) -> f64 {
        // Direction of the light, its angle to the optical axis and its azimuth.
        let (direction, _) = self.screen.light_from(t, self.axes);
        let across = direction.truncate();
        let angle = across.length().atan2(direction.z);
        let most = self.most;
        let beyond =
            if angle > most { (math::sin_cos(angle).1 / math::sin_cos(most).1).max(0.0) } else { 1.0 };
        // Interpolate each harmonic over the angle by the barycentric formula.
        let (mut above, mut below) = ([0.0; AZIMUTHS - 1], 0.0);
        for (node, (values, at)) in self.harmonics.iter().zip(&self.angles).enumerate() {
            let gap = angle.min(most) - at;
            let half = if node == 0 || node == ANGLES - 1 { 0.5 } else { 1.0 };
            let sign = if node.is_multiple_of(2) { half } else { -half };
            let weight = if gap.abs() < 1e-12 { sign * 1e30 } else { sign / gap };
            below += weight;
            above.iter_mut().zip(values).for_each(|(sum, v)| *sum += weight * v);
        }
        // Sum the harmonics, cos nφ + i sin nφ by powers of the unit vector across.
        let unit = across.normalize_or(DVec2::X);
        let (mut power, mut value) = (DVec2::X, above[0]);
        for pair in above[1..].chunks_exact(2) {
            power = power.rotate(unit);
            value += pair[0] * power.x + pair[1] * power.y;
        }
        beyond * value / below
    }
}

/// 1/distance of the point of the screen whose light travels along `direction` (eye frame), 1/mm; 0 where
/// there is none.
fn vergence(projection: &Projection, direction: DVec3) -> f64 {
    let (screen, eye) = (projection.screen(), projection.eye());
    if screen.is_frontal() {
        // A flat screen is farther off by 1/cos of the angle to the line of sight.
        return direction.dot(eye.view_axes()[2]).max(0.0) / screen.nominal_mm();
    }
    screen
        .met_by(DVec3::ZERO, -eye.in_view(direction))
        .map_or(0.0, |t| 1.0 / screen.distance_mm(t).max(NEAREST_MM))
}

/// Mean, and cosine and sine of each harmonic below the highest, of values at even steps of the azimuth.
fn harmonics(values: &[f64]) -> [f64; AZIMUTHS - 1] {
    let mut made = [0.0; AZIMUTHS - 1];
    for (step, value) in values.iter().enumerate() {
        made[0] += value / AZIMUTHS as f64;
        for n in 1..AZIMUTHS / 2 {
            let turn = math::unit(TAU * (n * step) as f64 / AZIMUTHS as f64);
            made[2 * n - 1] += 2.0 * value * turn.x / AZIMUTHS as f64;
            made[2 * n] += 2.0 * value * turn.y / AZIMUTHS as f64;
        }
    }
    made
}
