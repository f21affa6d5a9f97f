//! The eye of an experiment: a preset, overrides of its data field by field, a person, a size, a pupil.
//!
//! The messages have the names of the data files, so overrides are laid over the preset's JSON; what is then not an eye is
//! refused with the field's path.

use photoneye_eye::catalog;
use photoneye_eye::cone::directional::{DEFAULT_RHO10_PER_MM2, PointingLaw};
use photoneye_eye::experiment::{Eye, StrayLight};
use photoneye_eye::optics::pupil::{PupilLaw, PupilScene, decentre_mm};
use photoneye_eye::optics::{Dispersion, OpticsError, Prescription, Side};
use photoneye_proto::{FieldError, v1};
use serde_json::Value;

use super::read::{choice, in_range, needed, number};

/// The eye that is taken when none is named.
pub const DEFAULT_EYE: &str = "escudero-sanz-navarro";

/// The paper's Stiles-Crawford coefficient, of e^(-ρ r²), 1/mm².
const PAPER_RHO_PER_MM2: f64 = 0.05;

/// What is taken as a whole when it is given, not field by field.
const WHOLE: [&str; 6] =
    ["polyline", "herzberger", "quadratic", "lens_gradient", "accommodation", "wavefront"];
/// Of these one given drops the others of the preset.
const TABLES: [&str; 3] = ["polyline", "herzberger", "quadratic"];

/// Most that the eye accommodates, by itself or by its age, dioptres.
fn amplitude_d(focus: &v1::Focus) -> Result<Option<f64>, FieldError> {
    match (focus.amplitude_d, focus.age_years) {
        (Some(_), Some(_)) => Err(FieldError::new("eye.focus.age_years", "excludes `amplitude_d`")),
        (amplitude_d, None) => Ok(amplitude_d.map(|d| d + 0.0)),
        // Mean amplitude of Hofstetter (1950).
        (None, Some(years)) => {
            let years = in_range("eye.focus.age_years", years, 1.0, 100.0)?;
            Ok(Some((18.5 - 0.3 * years).max(0.0)))
        }
    }
}

pub(super) fn eye(spec: Option<&v1::Eye>, distance_cm: f64) -> Result<Eye, FieldError> {
    use v1::eye::Side as S;
    let spec = spec.cloned().unwrap_or_default();
    let preset = spec.preset.clone().unwrap_or_else(|| DEFAULT_EYE.to_owned());
    if preset != DEFAULT_EYE && catalog::text("eyes", &preset).is_none() {
        let names = catalog::names("eyes").join("`, `");
        let message = format!("unknown eye `{preset}`, expected one of `{names}`");
        return Err(FieldError::new("eye.preset", message));
    }
    let own = prescription(&preset, &spec)?;
    let data = match &own {
        Some(data) => (**data).clone(),
        None => Prescription::preset(&preset).map_err(|e| refused("eye", e))?,
    };
    let focus = spec.focus.unwrap_or_default();
    let (rho10, pointing_sd_deg, pointing_law) = stiles_crawford(spec.stiles_crawford.as_ref())?;
    let pupil_mm = pupil_mm(&spec)?;
    let shift = number(spec.pupil_shift_mm_per_mm, 0.0);
    let shift = in_range("eye.pupil_shift_mm_per_mm", shift, -0.1, 0.1)?;
    let dispersion = dispersion(&spec, &data)?;
    check_pupil(&data, pupil_mm)?;
    Ok(Eye {
        preset,
        side: match choice("eye.side", spec.side, S::Right, S::as_str_name)? {
            S::Right => Side::Right,
            S::Left => Side::Left,
        },
        pupil_mm,
        decentre_mm: decentre_mm(number(spec.pupil_decentre_mm, data.stop_decentre_mm), shift, pupil_mm),
        focus_distance_cm: number(focus.distance_cm, distance_cm),
        focus_wavelength_nm: number(focus.wavelength_nm, 543.0),
        dispersion,
        macular_peak_density: number(spec.macular_peak_density, 0.404),
        lens_density_scale: number(spec.lens_density_scale, 1.0),
        cornea_density_scale: number(spec.cornea_density_scale, 1.0),
        stiles_crawford_rho10_per_mm2: rho10,
        pointing_sd_deg,
        pointing_law,
        reflection_losses: spec.reflection_losses.unwrap_or(false),
        stray_light: spec.stray_light.as_ref().map(|stray| StrayLight {
            age_years: number(stray.age_years, 30.0),
            pigmentation: number(stray.pigmentation, 0.5),
        }),
        prescription: own,
        relaxed: focus.relaxed.unwrap_or(false),
        amplitude_d: amplitude_d(&focus)?,
    })
}

/// An error of the optics with the path of its field below `path`.
fn refused(path: &str, error: OpticsError) -> FieldError {
    match error {
        OpticsError::OutOfRange { field, value, min, max } => FieldError::new(
            format!("{path}.{field}"),
            format!("{value} is out of range, allowed is {min} to {max}"),
        ),
        OpticsError::Wrong { field, why } => FieldError::new(format!("{path}.{field}"), why),
        OpticsError::UnknownPreset { .. }
        | OpticsError::BadData { .. }
        | OpticsError::CannotFocus { .. }
        | OpticsError::NoDirection { .. }
        | OpticsError::NoRay { .. }
        | OpticsError::OutsideField { .. } => FieldError::new(path, error.to_string()),
    }
}

/// The eye's data when they are not those of the preset as they stand.
fn prescription(preset: &str, spec: &v1::Eye) -> Result<Option<Box<Prescription>>, FieldError> {
    let data = Prescription::preset(preset).map_err(|e| refused("eye", e))?;
    let bare = v1::Eye {
        preset: None,
        side: None,
        pupil_mm: None,
        focus: None,
        dispersion: None,
        pupil_decentre_mm: None,
        macular_peak_density: None,
        lens_density_scale: None,
        cornea_density_scale: None,
        stiles_crawford: None,
        pupil_formula: None,
        pupil_shift_mm_per_mm: None,
        axial_length_mm: None,
        person: None,
        reflection_losses: None,
        stray_light: None,
        ..spec.clone()
    };
    let mut own = None;
    if bare != v1::Eye::default() {
        own = Some(overlaid(&data, &bare)?);
    }
    if let Some(person) = spec.person {
        if spec.axial_length_mm.is_some() {
            return Err(FieldError::new("eye.axial_length_mm", "excludes `person`, whose length is drawn"));
        }
        let person = own.as_ref().unwrap_or(&data).person(person.seed.unwrap_or(1));
        own = Some(person.map_err(|e| refused("eye", e))?);
    }
    if let Some(length_mm) = spec.axial_length_mm {
        let scaled = own.as_ref().unwrap_or(&data).scaled_to(length_mm);
        own = Some(scaled.map_err(|e| refused("eye", e))?);
    }
    Ok(own.map(Box::new))
}

/// The preset with the fields of a message in the place of its own.
fn overlaid(data: &Prescription, changes: &v1::Eye) -> Result<Prescription, FieldError> {
    let failed = |e: serde_json::Error| FieldError::new("eye", e.to_string());
    let mut base = serde_json::to_value(data).map_err(failed)?;
    let mut over = serde_json::to_value(changes).map_err(failed)?;
    not_a_number("eye", &over)?;
    if let (Some(base), Some(over)) = (base.as_object_mut(), over.as_object_mut()) {
        if TABLES.iter().any(|name| over.contains_key(*name)) {
            for name in TABLES {
                base.insert(name.to_owned(), Value::Null);
            }
        }
        // A gradient without parts and a message of defaults come as an empty object.
        if let Some(gradient) = over.get_mut("lens_gradient").and_then(Value::as_object_mut) {
            gradient.entry("parts").or_insert_with(|| Value::Array(Vec::new()));
        }
        if let Some(wavefront) = over.get_mut("wavefront").and_then(Value::as_object_mut) {
            wavefront.entry("coefficients_um").or_insert_with(|| Value::Array(Vec::new()));
        }
    }
    lay_over(&mut base, over, 0);
    let eye: Prescription = serde_path_to_error::deserialize(base).map_err(|error| {
        let path = format!("eye.{}", error.path());
        FieldError::new(path, error.into_inner().to_string())
    })?;
    eye.validate().map_err(|e| refused("eye", e))?;
    Ok(eye)
}

fn lay_over(base: &mut Value, over: Value, depth: u32) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (name, value) in over {
                let whole = depth == 0 && WHOLE.contains(&name.as_str());
                let slot = base.entry(name).or_insert(Value::Null);
                if whole { *slot = value } else { lay_over(slot, value, depth + 1) }
            }
        }
        (base, over) => *base = over,
    }
}

/// Over gRPC NaN and infinity may come; they are written as text or null.
fn not_a_number(path: &str, value: &Value) -> Result<(), FieldError> {
    match value {
        Value::Object(fields) => {
            fields.iter().try_for_each(|(name, value)| not_a_number(&format!("{path}.{name}"), value))
        }
        Value::Array(items) => (0..)
            .zip(items)
            .try_for_each(|(i, value): (usize, _)| not_a_number(&format!("{path}[{i}]"), value)),
        Value::Null | Value::String(_) => Err(FieldError::new(path, format!("{value} is not a number"))),
        Value::Number(_) | Value::Bool(_) => Ok(()),
    }
}

fn dispersion(spec: &v1::Eye, data: &Prescription) -> Result<Dispersion, FieldError> {
    use v1::eye::Dispersion as D;
    if spec.dispersion.is_none() {
        return Ok(data.default_dispersion());
    }
    let law = match choice("eye.dispersion", spec.dispersion, D::Herzberger, D::as_str_name)? {
        D::Herzberger => Dispersion::Herzberger,
        D::Polyline => Dispersion::Polyline,
        D::Quadratic => Dispersion::Quadratic,
    };
    data.check_dispersion(law).map_err(|e| refused("eye", e))?;
    Ok(law)
}

/// The pupil as it is given, or by a formula.
fn pupil_mm(spec: &v1::Eye) -> Result<f64, FieldError> {
    use v1::pupil_formula::Formula as F;
    let Some(given) = &spec.pupil_formula else { return Ok(number(spec.pupil_mm, 3.0)) };
    let path = "eye.pupil_formula";
    if spec.pupil_mm.is_some() {
        return Err(FieldError::new("eye.pupil_mm", "excludes `pupil_formula`"));
    }
    let law = match choice(&format!("{path}.formula"), given.formula, F::WatsonYellott, F::as_str_name)? {
        F::WatsonYellott => PupilLaw::WatsonYellott,
        F::StanleyDavies => PupilLaw::StanleyDavies,
        F::MoonSpencer => PupilLaw::MoonSpencer,
        F::DegrootGebhard => PupilLaw::DegrootGebhard,
        F::PokornySmith => PupilLaw::PokornySmith,
    };
    let scene = PupilScene {
        luminance_cd_m2: needed(&format!("{path}.luminance_cd_m2"), given.luminance_cd_m2)?,
        field_deg2: number(given.field_deg2, std::f64::consts::PI * 900.0),
        age_years: number(given.age_years, 28.58),
        binocular: given.binocular.unwrap_or(false),
    };
    law.diameter_mm(&scene).map_err(|e| refused(path, e))
}

/// A measured wavefront says nothing beyond its own pupil.
fn check_pupil(data: &Prescription, pupil_mm: f64) -> Result<(), FieldError> {
    let Some(wavefront) = &data.wavefront else { return Ok(()) };
    if pupil_mm <= wavefront.pupil_mm + 1e-9 {
        return Ok(());
    }
    let message =
        format!("{pupil_mm} is out of range, allowed is up to that of `wavefront`, {}", wavefront.pupil_mm);
    Err(FieldError::new("eye.pupil_mm", message))
}

/// Coefficient for base 10, the pointing error, and whose law it is.
fn stiles_crawford(spec: Option<&v1::StilesCrawford>) -> Result<(f64, f64, PointingLaw), FieldError> {
    use v1::stiles_crawford::{Base as B, Pointing as P};
    let spec = spec.copied().unwrap_or_default();
    let base = choice("eye.stiles_crawford.base", spec.base, B::Ten, B::as_str_name)?;
    let (usual, to_ten) = match base {
        B::Ten => (DEFAULT_RHO10_PER_MM2, 1.0),
        B::E => (PAPER_RHO_PER_MM2, std::f64::consts::LOG10_E),
    };
    let rho = in_range("eye.stiles_crawford.rho_per_mm2", number(spec.rho_per_mm2, usual), 0.0, 0.2)?;
    let pointing = choice("eye.stiles_crawford.pointing", spec.pointing, P::Population, P::as_str_name)?;
    let law = match pointing {
        P::Population => PointingLaw::Population,
        P::Paper => PointingLaw::Paper,
    };
    Ok((rho * to_ten, number(spec.perturbation_deg, 1.0), law))
}
