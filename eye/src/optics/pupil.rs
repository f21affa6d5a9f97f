//! Diameter of the pupil from what the eye looks at, by five published formulas, and the shift of its centre with size.
//!
//! L luminance in cd/m², a area of the adapting field in deg², y age in years, F = L·a·M with M = 1 for two eyes and 0.1 for
//! one; D in mm:
//! * Watson & Yellott 2012: D = S(F) + (y − 28.58)(0.02132 − 0.009562 S(F)), S the formula of Stanley & Davies;
//! * Stanley & Davies 1995: S(La) = 7.75 − 5.75 u/(u + 2), u = (La/846)^0.41;
//! * Moon & Spencer 1944: D = 4.9 − 3 tanh(0.4 (log₁₀ L + 1)) (L in the units of its later editions);
//! * de Groot & Gebhard 1952: log₁₀ D = 0.8558 − 0.000401 (log₁₀ L + 8.6)³;
//! * Pokorny & Smith 1997: D = 5 − 3 tanh(0.4 log₁₀ L).
//!
//! Only the first knows age and the number of eyes, only the first two the field's area.

use super::error::{OpticsError, in_range};
use crate::math;

/// Which formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PupilLaw {
    /// Watson & Yellott 2012, the unified formula.
    WatsonYellott,
    /// Stanley & Davies 1995.
    StanleyDavies,
    /// Moon & Spencer 1944.
    MoonSpencer,
    /// de Groot & Gebhard 1952.
    DegrootGebhard,
    /// Pokorny & Smith 1997.
    PokornySmith,
}

/// What the eye looks at, and whose eye it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PupilScene {
    /// Luminance, cd/m², 1e-6 to 1e7.
    pub luminance_cd_m2: f64,
    /// Area of the adapting field, deg², 0.01 to 20000.
    pub field_deg2: f64,
    /// Age, years, 20 to 83 (what the formula was made for).
    pub age_years: f64,
    /// Whether both eyes look.
    pub binocular: bool,
}

impl PupilLaw {
    /// Diameter of the entrance pupil, mm.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] for the scene, or when the formula's diameter is not between 0.5 and 9 mm.
    pub fn diameter_mm(self, scene: &PupilScene) -> Result<f64, OpticsError> {
        let luminance = in_range("luminance_cd_m2", scene.luminance_cd_m2, 1e-6, 1e7)?;
        let area = in_range("field_deg2", scene.field_deg2, 0.01, 20_000.0)?;
        let age = in_range("age_years", scene.age_years, 20.0, 83.0)?;
        let log10 = math::ln(luminance) / std::f64::consts::LN_10;
        let stanley_davies = |flux: f64| {
            let u = math::pow(flux / 846.0, 0.41);
            7.75 - 5.75 * u / (u + 2.0)
        };
        let diameter = match self {
            Self::WatsonYellott => {
                let eyes = if scene.binocular { 1.0 } else { 0.1 };
                let s = stanley_davies(luminance * area * eyes);
                s + (age - 28.58) * (0.02132 - 0.009_562 * s)
            }
            Self::StanleyDavies => stanley_davies(luminance * area),
            Self::MoonSpencer => 4.9 - 3.0 * tanh(0.4 * (log10 + 1.0)),
            Self::DegrootGebhard => {
                let x = log10 + 8.6;
                math::pow(10.0, 0.8558 - 4.01e-4 * x * x * x)
            }
            Self::PokornySmith => 5.0 - 3.0 * tanh(0.4 * log10),
        };
        in_range("diameter (mm)", diameter, 0.5, 9.0)
    }
}

fn tanh(x: f64) -> f64 {
    let e = math::exp(2.0 * x);
    (e - 1.0) / (e + 1.0)
}

/// Decentre of the stop (mm, nasal) of a pupil of `pupil_mm`: the centre moves towards temporal as the pupil opens, by
/// `shift_mm_per_mm` for every mm beyond 3 mm (Wyatt 1995: some 0.1 mm over the pupil's range; eyes differ).
pub fn decentre_mm(at_3_mm: f64, shift_mm_per_mm: f64, pupil_mm: f64) -> f64 {
    at_3_mm - shift_mm_per_mm * (pupil_mm - 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values published with the formulas: field of 60° diameter, age 28.58; Watson & Yellott for one eye.
    #[test]
    fn published_values() {
        let laws = [
            PupilLaw::StanleyDavies,
            PupilLaw::WatsonYellott,
            PupilLaw::MoonSpencer,
            PupilLaw::DegrootGebhard,
            PupilLaw::PokornySmith,
        ];
        for (luminance_cd_m2, wanted) in [
            (0.001, [7.485, 7.644, 6.892, 6.101, 7.501]),
            (0.1, [6.359, 7.115, 4.900, 4.784, 6.140]),
            (10.0, [3.850, 5.159, 2.908, 3.170, 3.860]),
            (300.0, [2.605, 3.335, 2.250, 2.045, 2.727]),
            (10_000.0, [2.156, 2.385, 2.008, 1.131, 2.235]),
        ] {
            let field_deg2 = std::f64::consts::PI * 900.0;
            let scene = PupilScene { luminance_cd_m2, field_deg2, age_years: 28.58, binocular: false };
            for (law, wanted) in laws.iter().zip(wanted) {
                let d = law.diameter_mm(&scene).unwrap();
                assert!((d - wanted).abs() < 6e-4, "{law:?} at {luminance_cd_m2}: {d}");
            }
        }
    }

    #[test]
    fn age_and_both_eyes_close_the_pupil() {
        let scene =
            PupilScene { luminance_cd_m2: 100.0, field_deg2: 100.0, age_years: 30.0, binocular: false };
        let d = |s: PupilScene| PupilLaw::WatsonYellott.diameter_mm(&s).unwrap();
        assert!(d(PupilScene { age_years: 70.0, ..scene }) < d(scene) - 0.5);
        assert!(d(PupilScene { binocular: true, ..scene }) < d(scene) - 0.5);
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        let scene = PupilScene { luminance_cd_m2: 1e7, field_deg2: 100.0, age_years: 30.0, binocular: false };
        let error = |law: PupilLaw, s: PupilScene| law.diameter_mm(&s).unwrap_err().to_string();
        assert!(error(PupilLaw::DegrootGebhard, scene).starts_with("diameter (mm): 0.2"));
        for (s, field) in [
            (PupilScene { luminance_cd_m2: f64::NAN, ..scene }, "luminance_cd_m2: NaN"),
            (PupilScene { field_deg2: 0.0, ..scene }, "field_deg2: 0"),
            (PupilScene { age_years: 3.0, ..scene }, "age_years: 3 is outside 20 to 83"),
        ] {
            assert!(error(PupilLaw::WatsonYellott, s).starts_with(field));
        }
    }

    #[test]
    fn the_pupil_shifts_with_size() {
        assert!((decentre_mm(0.4, 0.025, 7.0) - 0.3).abs() < 1e-15);
        assert!(decentre_mm(0.4, 0.0, 8.0).to_bits() == 0.4_f64.to_bits());
    }
}
