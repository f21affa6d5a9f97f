//! The light that enters the eye: the beam of an object point that passes the real stop.
//!
//! Rays are named by where they cross a plane through the entrance pupil across the object's direction ([`super::aim`]).
//! Those that meet the rim of the stop enclose the beam; the flux that enters, for unit irradiance E at the corneal apex, is
//! `Φ = ∫ E(u) d²u` over the region inside, mm². For a distant object it is the beam's area.
//!
//! The diameter d of the entrance pupil (`pupil_mm`) is what the eye of a viewer on the line of sight, far away, would
//! measure: the stop is as large as `Φ = π d²/4` asks for parallel light from the fovea's direction at the reference
//! wavelength, with the decentre and the accommodation of the eye's state. (With the paraxial magnification 1.1334 the beam
//! would be 1.3, 3.8 and 6.5 % smaller at 3, 6 and 8 mm.) Illuminance of the retina in trolands is then luminance times π d²/4
//! at any distance: a screen at D is seen from the entrance pupil, which lies some 3 mm behind the apex.
//!
//! # Accuracy
//! The rim is taken at 16 points; its area is exact to 1e-9 for a smooth cornea, `eye/tests/validity/pupil.rs`.

use super::aim::Aimer;
use super::error::OpticsError;
use super::object::Object;
use super::schematic_eye::SchematicEye;
use crate::math;
use glam::DVec2;
use std::f64::consts::{FRAC_PI_4, PI, TAU};

/// Points of the rim.
const RIM: usize = 16;
/// Gauss nodes (in the squared radius) of the irradiance between the chief ray and the rim, each with half of the area.
const INSIDE: [f64; 2] = [0.211_324_865_405_187, 0.788_675_134_594_813];
/// Steps of the search for the stop, and relative error of the beam at which it ends.
const STEPS: u32 = 20;
const CLOSE: f64 = 1e-11;

/// Area of the entrance pupil of a diameter (mm), mm².
pub fn nominal_mm2(pupil_mm: f64) -> f64 {
    FRAC_PI_4 * pupil_mm * pupil_mm
}

impl SchematicEye {
    /// Flux through the stop (mm²) from an object at a vacuum wavelength (nm), for unit irradiance at the corneal apex on
    /// a plane across the light.
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when a part of the rim cannot be reached; [`OpticsError::OutOfRange`] for the wavelength.
    pub fn beam_mm2(&self, object: Object, wavelength_nm: f64) -> Result<f64, OpticsError> {
        let aimer = Aimer::new(self, object, wavelength_nm)?;
        beam(&aimer).ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })
    }

    /// The same eye with the stop with which the beam of the line of sight is that of an entrance pupil of `pupil_mm`.
    ///
    /// # Errors
    /// [`OpticsError::Wrong`] when no stop of this eye is so large.
    pub(super) fn with_pupil(mut self, pupil_mm: f64) -> Result<Self, OpticsError> {
        let p = self.prescription();
        let (object, nm) = (Object::field(p.fovea_angle_deg, 0.0)?, p.reference_wavelength_nm);
        let wanted = nominal_mm2(pupil_mm);
        // The beam grows nearly with the square of the stop's radius: Newton's method for its logarithm, the power from the step before.
        let mut power = 2.0;
        let mut before: Option<(f64, f64)> = None;
        for _ in 0..STEPS {
            let Ok(beam) = self.beam_mm2(object, nm) else { break };
            let miss = math::ln(beam / wanted);
            if miss.abs() < CLOSE {
                return Ok(self);
            }
            let radius = math::ln(self.stop_radius_mm);
            if let Some((radius_before, miss_before)) = before
                && (radius - radius_before).abs() > 1e-9
            {
                power = ((miss - miss_before) / (radius - radius_before)).clamp(0.5, 4.0);
            }
            before = Some((radius, miss));
            self.stop_radius_mm = math::exp(radius - miss / power);
        }
        let why =
            format!("no stop of this eye gives an entrance pupil of {pupil_mm} mm; a smaller one is allowed");
        Err(OpticsError::Wrong { field: "pupil_mm", why })
    }
}

/// The beam of an aimer's object, mm²; `None` when a part of the rim cannot be reached.
fn beam(aimer: &Aimer) -> Option<f64> {
    let chief = aimer.chief()?;
    let inverse = aimer.slope(chief)?.inverse();
    // Aim at the rim.
    let mut rim = [DVec2::ZERO; RIM];
    for (k, point) in rim.iter_mut().enumerate() {
        let target = aimer.stop_radius_mm() * math::unit(TAU * k as f64 / RIM as f64);
        *point = aimer.through(target, chief + inverse * target)? - chief;
    }
    // Integrate the irradiance from the chief ray to the rim: d²u = s ds |p × p'| dφ, s² uniform.
    let mut flux = 0.0;
    for k in 0..RIM {
        let cross = rim[k].perp_dot(slope_at(&rim, k)).abs();
        let mean = INSIDE.map(|square| aimer.irradiance(chief + square.sqrt() * rim[k]));
        flux += 0.5 * cross * 0.5 * (mean[0] + mean[1]);
    }
    Some(flux * TAU / RIM as f64)
}

/// Derivative by azimuth, at point `k`, of the trigonometric polynomial through evenly spaced points of a closed curve.
fn slope_at(points: &[DVec2; RIM], k: usize) -> DVec2 {
    let other = |j: usize| {
        let sign = if (k + j).is_multiple_of(2) { 0.5 } else { -0.5 };
        let half = PI * (k as f64 - j as f64) / RIM as f64;
        sign / half.tan() * points[j]
    };
    (0..RIM).filter(|j| *j != k).map(other).sum()
}
