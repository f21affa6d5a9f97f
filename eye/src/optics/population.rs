//! Eyes of other sizes, and the eye of another person (§9: people's eyes are 24 ± 1 mm long, and their other features vary in
//! ways that make up for each other).
//!
//! A scaled eye has every length of the prescription in proportion; its power falls as its length grows, so it stays as
//! emmetropic as before. A person's eye is scaled to a length drawn from the normal distribution of the paper; then single
//! features are drawn about the scaled ones, and the curvatures of the lens, with the radial gradient inside it if there is one,
//! are changed by one factor until the paraxial refraction is again that of the prescription: the lens makes up for the rest.
//!
//! Spread (standard deviations, normal, cut at 2.5): length 1 mm (Deering 2005 §9); corneal radii 2 % beyond that of length,
//! conic of the corneal front 0.1, aqueous depth 8 %, lens thickness 5 %, angle of the fovea 1°, decentre of the pupil
//! 0.1 mm: round figures after Rozema et al. 2011 (IOVS 52:7937) and Atchison 2006.

use super::error::{OpticsError, in_range};
use super::gradient::GradientPart;
use super::prescription::{Prescription, Side, SurfaceData, ToricData};
use super::schematic_eye::{EyeState, SchematicEye};
use crate::rng::{Purpose, Stream};

/// Mean length of people's eyes, mm.
pub const MEAN_LENGTH_MM: f64 = 24.0;
/// Standard deviation of the length, mm.
pub const SD_LENGTH_MM: f64 = 1.0;
/// Draws farther out than this many standard deviations are moved to it.
const CUT: f64 = 2.5;
/// Bounds of the factor on the curvatures of the lens.
const LENS_FACTORS: (f64, f64) = (0.3, 2.5);

impl Prescription {
    /// The same eye with every length in proportion, `axial_length_mm` long (18 to 32). Indices, conic constants, angles and a
    /// measured wavefront stay.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] for the length, or for a part that is then no longer that of an eye.
    pub fn scaled_to(&self, axial_length_mm: f64) -> Result<Self, OpticsError> {
        in_range("axial_length_mm", axial_length_mm, 18.0, 32.0)?;
        let s = axial_length_mm / self.axial_length_mm();
        let surface = |d: &SurfaceData| SurfaceData {
            radius_mm: s * d.radius_mm,
            conic: d.conic,
            thickness_mm: s * d.thickness_mm,
            toric: d.toric.map(|t| ToricData { radius_mm: s * t.radius_mm, ..t }),
        };
        let mut eye = self.clone();
        eye.cornea_front = surface(&self.cornea_front);
        eye.cornea_back = surface(&self.cornea_back);
        eye.lens_front = surface(&self.lens_front);
        eye.lens_back = surface(&self.lens_back);
        eye.retina_radius_mm *= s;
        eye.stop_decentre_mm *= s;
        eye.rotation_centre_behind_apex_mm *= s;
        eye.rotation_centre_nasal_mm *= s;
        if let Some(gradient) = &mut eye.lens_gradient {
            for part in &mut gradient.parts {
                *part = GradientPart {
                    from_mm: s * part.from_mm,
                    index: part.index,
                    linear_per_mm: part.linear_per_mm / s,
                    square_per_mm2: part.square_per_mm2 / (s * s),
                    radial_per_mm2: part.radial_per_mm2 / (s * s),
                };
            }
        }
        if let Some(law) = &mut eye.accommodation {
            law.lens_front_radius_mm *= s;
            law.lens_back_radius_mm *= s;
            law.aqueous_depth_mm *= s;
            law.lens_thickness_mm *= s;
        }
        eye.validate()?;
        Ok(eye)
    }

    /// The eye of person number `seed`: the same for the same number.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] when no lens makes up for the features drawn, or a feature is not that of an eye.
    pub fn person(&self, seed: u64) -> Result<Self, OpticsError> {
        let mut stream = Stream::new(seed, Purpose::Eye, 0, 0);
        let mut spare = None;
        let mut normal = || {
            let z = spare.take().unwrap_or_else(|| {
                let (a, b) = stream.normal_pair();
                spare = Some(b);
                a
            });
            z.clamp(-CUT, CUT)
        };
        let length_mm = MEAN_LENGTH_MM + SD_LENGTH_MM * normal();
        let mut eye = self.scaled_to(length_mm)?;
        let cornea = 1.0 + 0.02 * normal();
        for surface in [&mut eye.cornea_front, &mut eye.cornea_back] {
            surface.radius_mm *= cornea;
            surface.toric = surface.toric.map(|t| ToricData { radius_mm: cornea * t.radius_mm, ..t });
        }
        eye.cornea_front.conic += 0.1 * normal();
        eye.cornea_back.thickness_mm *= 1.0 + 0.08 * normal();
        let lens = 1.0 + 0.05 * normal();
        eye.lens_front.thickness_mm *= lens;
        if let Some(gradient) = &mut eye.lens_gradient {
            // The gradient keeps its indices over the new thickness.
            for part in &mut gradient.parts {
                part.from_mm *= lens;
                part.linear_per_mm /= lens;
                part.square_per_mm2 /= lens * lens;
            }
        }
        eye.fovea_angle_deg = (eye.fovea_angle_deg + normal()).clamp(0.0, 15.0);
        eye.stop_decentre_mm = (eye.stop_decentre_mm + 0.1 * normal()).clamp(0.0, 1.0);
        let parts =
            eye.cornea_front.thickness_mm + eye.cornea_back.thickness_mm + eye.lens_front.thickness_mm;
        eye.lens_back.thickness_mm = length_mm - parts;
        eye.validate()?;
        let eye = eye.with_lens_for(self.refraction_d())?;
        eye.validate()?;
        Ok(eye)
    }

    /// The eye with the curvatures of its lens changed by one factor so that its paraxial refraction is `wanted_d`.
    fn with_lens_for(&self, wanted_d: f64) -> Result<Self, OpticsError> {
        let changed = |factor: f64| {
            let mut eye = self.clone();
            for surface in [&mut eye.lens_front, &mut eye.lens_back] {
                surface.radius_mm /= factor;
                surface.toric = surface.toric.map(|t| ToricData { radius_mm: t.radius_mm / factor, ..t });
            }
            for part in eye.lens_gradient.iter_mut().flat_map(|gradient| &mut gradient.parts) {
                part.radial_per_mm2 *= factor;
            }
            eye
        };
        // A larger factor is a stronger lens: the refraction falls towards myopia.
        let (mut low, mut high) = LENS_FACTORS;
        let (weakest, strongest) = (changed(low).refraction_d(), changed(high).refraction_d());
        in_range("refraction that the lens must give (D)", wanted_d, strongest, weakest)?;
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if changed(middle).refraction_d() > wanted_d { low = middle } else { high = middle }
        }
        Ok(changed(0.5 * (low + high)))
    }

    /// Paraxial refraction of the unaccommodated eye at its reference wavelength, D at its first principal point: what its power
    /// lacks for a sharp image at infinity; 0 emmetropic, negative myopic.
    pub fn refraction_d(&self) -> f64 {
        let dispersion = self.default_dispersion();
        let state =
            EyeState { pupil_mm: 3.0, decentre_mm: 0.0, accommodation_a: 0.0, dispersion, side: Side::Right };
        let eye = SchematicEye::build(self, &state, 1.0, 1.0);
        let nm = self.reference_wavelength_nm;
        let (c, n) = (eye.cardinal(nm), eye.indices(nm)[4]);
        let second_principal_mm = c.second_nodal_z_mm - (n - 1.0) * 1e3 / c.power_d;
        n * 1e3 / (self.axial_length_mm() - second_principal_mm) - c.power_d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn presets() -> Vec<Prescription> {
        crate::catalog::names("eyes").iter().map(|name| Prescription::preset(name).unwrap()).collect()
    }

    #[test]
    fn a_scaled_eye_is_in_focus_as_before() {
        for p in presets() {
            let larger = p.scaled_to(1.1 * p.axial_length_mm()).unwrap();
            assert!((larger.refraction_d() * 1.1 - p.refraction_d()).abs() < 1e-9);
            assert!((larger.retina_radius_mm - 1.1 * p.retina_radius_mm).abs() < 1e-12);
        }
        assert!(presets()[0].scaled_to(40.0).is_err());
    }

    /// Mean and standard deviation of the length as in §9 (the cut at 2.5 takes 3 % off the latter); everybody is in focus.
    #[test]
    fn people_have_eyes_of_24_mm_and_1_mm() {
        for p in presets() {
            let wanted = p.refraction_d();
            let people: Vec<Prescription> = (0..400).map(|seed| p.person(seed).unwrap()).collect();
            let lengths: Vec<f64> = people.iter().map(Prescription::axial_length_mm).collect();
            let mean = lengths.iter().sum::<f64>() / 400.0;
            let sd = (lengths.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 399.0).sqrt();
            // Four standard errors: alpha 6e-5 each.
            assert!((mean - MEAN_LENGTH_MM).abs() < 4.0 / 20.0, "{mean}");
            assert!((sd - 0.98).abs() < 4.0 / 28.0, "{sd}");
            for person in &people {
                assert!((person.refraction_d() - wanted).abs() < 1e-9);
            }
            assert_eq!(people[7], p.person(7).unwrap());
            assert_ne!(people[7], people[8]);
        }
    }
}
