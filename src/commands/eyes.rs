//! `eyes`: the eyes of the catalogue, with what they are and can do.

use photoneye_eye::catalog;
use photoneye_eye::optics::{EyeState, Prescription, SchematicEye, Side};
use serde_json::{Value, json};

use super::Context;
use crate::cli_optics::EyeArgs;
use crate::failure::{Failure, plain};
use crate::output;

/// Largest file of an eye that is read, bytes.
const MAX_FILE: u64 = 1 << 20;

/// Runs the command.
pub fn run(context: &Context) -> Result<(), Failure> {
    let mut eyes = Vec::new();
    for name in catalog::names("eyes") {
        let p = Prescription::preset(name).map_err(Failure::failed)?;
        eyes.push((name, facts(name, &p)?, p));
    }
    if context.json {
        return output::json(&json!({"eyes": eyes.iter().map(|(_, facts, _)| facts).collect::<Vec<_>>()}));
    }
    for (name, facts, p) in &eyes {
        output::line(format_args!("{name}"))?;
        output::line(format_args!("  {}", p.description))?;
        output::line(format_args!(
            "  power {:.2} D at {} nm, length {:.2} mm, stop x {:.4}, fovea at {}°, {}; dispersion {}",
            facts["power_d"].as_f64().unwrap_or_default(),
            p.reference_wavelength_nm,
            p.axial_length_mm(),
            facts["stop_magnification"].as_f64().unwrap_or_default(),
            p.fovea_angle_deg,
            if p.accommodation.is_some() { "accommodates" } else { "does not accommodate" },
            p.dispersions().iter().map(|law| law.name()).collect::<Vec<_>>().join(", "),
        ))?;
        output::line(format_args!("  {}", p.source))?;
    }
    Ok(())
}

fn facts(name: &str, p: &Prescription) -> Result<Value, Failure> {
    let eye = SchematicEye::new(p, &state(p, Side::Right)).map_err(Failure::failed)?;
    let nm = p.reference_wavelength_nm;
    let cardinal = eye.cardinal(nm);
    Ok(json!({
        "name": name,
        "description": p.description,
        "source": p.source,
        "reference_wavelength_nm": nm,
        "power_d": cardinal.power_d,
        "axial_length_mm": p.axial_length_mm(),
        "stop_magnification": cardinal.stop_magnification,
        "entrance_pupil_z_mm": cardinal.entrance_pupil_z_mm,
        "exit_pupil_z_mm": cardinal.exit_pupil_z_mm,
        "fovea_angle_deg": p.fovea_angle_deg,
        "stop_decentre_mm": p.stop_decentre_mm,
        "accommodates": p.accommodation.is_some(),
        "relaxed_focus_d": eye.focus_vergence_d(nm).map_err(Failure::failed)?,
        "dispersion": p.dispersions().iter().map(|law| law.name()).collect::<Vec<_>>(),
    }))
}

fn state(p: &Prescription, side: Side) -> EyeState {
    let dispersion = p.default_dispersion();
    EyeState { pupil_mm: 3.0, decentre_mm: p.stop_decentre_mm, accommodation_a: 0.0, dispersion, side }
}

/// The eye that was asked for, and its unaccommodated state with a pupil of 3 mm.
pub(super) fn asked_for(args: &EyeArgs) -> Result<(Prescription, EyeState), Failure> {
    let name = args.eye.as_str();
    let is_file = std::path::Path::new(name).extension().is_some_and(|end| end.eq_ignore_ascii_case("json"));
    let prescription = if is_file {
        let failed = |e: std::io::Error| Failure::usage(format!("{name}: {}", plain(&e)));
        if std::fs::metadata(name).map_err(failed)?.len() > MAX_FILE {
            return Err(Failure::usage(format!("{name}: larger than {MAX_FILE} bytes, not an eye")));
        }
        Prescription::from_json(name, &std::fs::read_to_string(name).map_err(failed)?)
    } else {
        Prescription::preset(name)
    };
    let prescription = prescription.map_err(|e| Failure::usage(format!("--eye: {e}")))?;
    let mut state = state(&prescription, args.side.into());
    state.decentre_mm = args.decentre_mm.unwrap_or(state.decentre_mm);
    state.dispersion = args.dispersion.map_or(state.dispersion, Into::into);
    Ok((prescription, state))
}
