//! `displays`: what there is to choose from, one display in full, and the import of a display of ColorVideoVDP.
//!
//! ColorVideoVDP (Mantiuk et al. 2024) describes displays in a JSON file: an entry a display with `resolution`, `viewing_distance_meters`
//! (or `_inches`), `diagonal_size_inches`, `max_luminance`, `contrast` (or `min_luminance`), `E_ambient`, `k_refl` and `colorspace`. It holds no
//! spectra and no pixel structure: these are taken from a preset, which is said.

use std::path::Path;

use photoneye_eye::catalog;
use photoneye_eye::display::MOST_SIDE_PX;
use serde_json::{Map, Value, json};

use super::Context;
use crate::cli::DisplaysArgs;
use crate::failure::{Failure, plain};
use crate::output;

/// Most bytes of an imported file.
const MAX_BYTES: u64 = 1 << 20;
const INCH_CM: f64 = 2.54;

/// Runs the command.
pub fn run(context: &Context, args: &DisplaysArgs) -> Result<(), Failure> {
    if let Some(file) = &args.import {
        return output::json(&imported(file, args.name.as_deref(), &args.spectra_of)?);
    }
    if let Some(name) = &args.name {
        return output::json(&preset(name)?);
    }
    let names = catalog::names("displays");
    if context.json {
        let all = names.iter().map(|name| Ok(json!({"name": name, "display": preset(name)?})));
        return output::json(&json!({"displays": all.collect::<Result<Vec<_>, Failure>>()?}));
    }
    for name in names {
        let display = preset(name)?;
        let number = |field: &str| display[field].as_f64().unwrap_or_default();
        let text = |field: &str| display[field].as_str().unwrap_or_default().to_owned();
        let size =
            format!("{} x {}, {} Hz", number("width_px"), number("height_px"), number("frame_rate_hz"));
        output::line(format_args!("{name:22} {size}, {} cd/m²", number("white_luminance_cd_m2")))?;
        for part in ["description", "source", "licence"] {
            output::line(format_args!("    {part:12} {}", text(part)))?;
        }
    }
    Ok(())
}

fn preset(name: &str) -> Result<Value, Failure> {
    let text = catalog::text("displays", name).ok_or_else(|| {
        let names = catalog::names("displays").join("`, `");
        Failure::usage(format!("unknown display `{name}`, expected one of `{names}`"))
    })?;
    serde_json::from_str(text).map_err(Failure::failed)
}

/// A display of a ColorVideoVDP file as the `display` part of an experiment.
fn imported(file: &Path, name: Option<&str>, spectra_of: &str) -> Result<Value, Failure> {
    let wrong = |why: String| Failure::usage(format!("{}: {why}", file.display()));
    let length = std::fs::metadata(file).map_err(|e| wrong(plain(&e)))?.len();
    if length > MAX_BYTES {
        return Err(wrong(format!("{length} bytes, allowed are {MAX_BYTES}")));
    }
    let text = std::fs::read_to_string(file).map_err(|e| wrong(plain(&e)))?;
    let root: Map<String, Value> =
        serde_json::from_str(&text).map_err(|e| wrong(format!("not JSON: {e}")))?;
    preset(spectra_of)?;
    let entry = if root.contains_key("resolution") {
        &root
    } else {
        let names = || root.keys().map(String::as_str).collect::<Vec<_>>().join("`, `");
        let name = name.ok_or_else(|| wrong(format!("name one of its displays: `{}`", names())))?;
        let entry = root.get(name).and_then(Value::as_object);
        entry.ok_or_else(|| wrong(format!("no display `{name}`, expected one of `{}`", names())))?
    };
    converted(entry, spectra_of).map_err(wrong)
}

fn converted(entry: &Map<String, Value>, spectra_of: &str) -> Result<Value, String> {
    let number = |field: &str| number_of(entry, field);
    let needed = |field: &str| number(field)?.filter(|v| *v > 0.0).ok_or(format!("{field}: is missing or 0"));
    let size: Option<Vec<f64>> = entry
        .get("resolution")
        .and_then(Value::as_array)
        .map(|list| list.iter().filter_map(Value::as_f64).collect());
    let [width, height] = size.as_deref().unwrap_or_default() else {
        return Err("resolution: expected two numbers".into());
    };
    let (width, height) = (*width, *height);
    let sides = 1.0..=f64::from(MOST_SIDE_PX);
    if !(sides.contains(&width) && sides.contains(&height)) {
        return Err(format!(
            "resolution: {width} x {height} is out of range, allowed is 1 to {MOST_SIDE_PX}"
        ));
    }
    let distance_cm = match (number("viewing_distance_meters")?, number("viewing_distance_inches")?) {
        (Some(metres), _) => 100.0 * metres,
        (None, Some(inches)) => INCH_CM * inches,
        (None, None) => return Err("viewing_distance_meters: is missing".into()),
    };
    let white = needed("max_luminance")?;
    if let Some(exposure) = number("exposure")?.filter(|exposure| (exposure - 1.0).abs() > 1e-12) {
        return Err(format!(
            "exposure: {exposure} is not taken, allowed is 1; multiply the linear values of the pictures instead"
        ));
    }
    // A headset has the angle between its corners instead of a size.
    let diagonal_cm = match number("fov_diagonal")? {
        Some(degrees) if entry.get("diagonal_size_inches").is_none() => {
            if !(1.0..179.0).contains(&degrees) {
                return Err(format!("fov_diagonal: {degrees} is out of range, allowed is 1 to 179"));
            }
            2.0 * distance_cm * (0.5 * degrees.to_radians()).tan()
        }
        _ => INCH_CM * needed("diagonal_size_inches")?,
    };
    let contrast = match (number("contrast")?, number("min_luminance")?) {
        (Some(contrast), _) => Some(contrast),
        (None, Some(black)) if black > 0.0 => Some(white / black),
        _ => None,
    };
    let colorspace = entry.get("colorspace").and_then(Value::as_str).unwrap_or("sRGB");
    let transfer = transfer(colorspace)?;
    let mut display = json!({
        "preset": spectra_of,
        "width_px": width,
        "height_px": height,
        "pixel_pitch_cm": diagonal_cm / width.hypot(height),
        "distance_cm": distance_cm,
        "white_luminance_cd_m2": white,
        "transfer": transfer,
    });
    if transfer == "HLG" {
        display["hlg_system_gamma"] = json!(hlg_system_gamma(white, number("E_ambient")?));
    }
    if let Some(contrast) = contrast {
        display["contrast"] = json!(contrast.clamp(1.0, 1e9));
    }
    if let Some(lux) = number("E_ambient")? {
        let reflectance = number("k_refl")?.unwrap_or(0.005);
        display["ambient"] = json!({"illuminance_lux": lux, "reflectance": reflectance});
    }
    let name = entry.get("name").and_then(Value::as_str).unwrap_or("a display");
    // There linear values are in cd/m².
    let linear =
        if transfer == "LINEAR" { format!("; linear values are over {white} cd/m²") } else { String::new() };
    display["description"] = json!(format!(
        "{name}, as in a file of ColorVideoVDP; spectra and pixels of {spectra_of}, not of {colorspace}{linear}"
    ));
    Ok(display)
}

/// ColorVideoVDP's own law: 1.2 up to 1000 cd/m², beyond it BT.2100's, less with a bright surround (BBC WHP
/// 369).
fn hlg_system_gamma(white_cd_m2: f64, surround_lux: Option<f64>) -> f64 {
    if white_cd_m2 <= 1000.0 {
        return 1.2;
    }
    let surround = surround_lux.filter(|lux| *lux > 0.0).map_or(0.0, |lux| 0.07623 * (lux / 5.0).log10());
    1.2 + 0.42 * (white_cd_m2 / 1000.0).log10() - surround
}

/// A number of 0 or more of an entry, if it has the field.
fn number_of(entry: &Map<String, Value>, field: &str) -> Result<Option<f64>, String> {
    match entry.get(field) {
        None | Some(Value::Null) => Ok(None),
        Some(value) => match value.as_f64().filter(|v| v.is_finite() && *v >= 0.0) {
            Some(number) => Ok(Some(number)),
            None => Err(format!("{field}: {value} is not a number of 0 or more")),
        },
    }
}

/// The transfer of a colour space: ColorVideoVDP shows BT.709 by the law of sRGB.
fn transfer(colorspace: &str) -> Result<&'static str, String> {
    let lower = colorspace.to_lowercase();
    let has = |words: &[&str]| words.iter().any(|word| lower.contains(word));
    if has(&["hlg"]) {
        Ok("HLG")
    } else if has(&["pq"]) {
        Ok("PQ")
    } else if has(&["linear", "luminance"]) {
        Ok("LINEAR")
    } else if has(&["srgb", "p3", "709"]) {
        Ok("SRGB")
    } else if has(&["1886"]) {
        Ok("BT1886")
    } else {
        Err(format!(
            "colorspace: `{colorspace}` has no known transfer; known are sRGB, P3, BT.709, BT.1886, PQ, HLG and linear"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_display_of_color_video_vdp_becomes_one_of_ours() {
        let entry = json!({
            "name": "30-inch 4K", "resolution": [3840, 2160], "viewing_distance_meters": 0.7472,
            "diagonal_size_inches": 30, "max_luminance": 200, "contrast": 1000, "E_ambient": 250,
        });
        let display = converted(entry.as_object().unwrap(), "lcd-wled").unwrap();
        // 30 inches are 4405.8 pixels long.
        assert!((display["pixel_pitch_cm"].as_f64().unwrap() - 76.2 / 4405.814).abs() < 1e-6);
        assert!((display["distance_cm"].as_f64().unwrap() - 74.72).abs() < 1e-9);
        assert_eq!((&display["transfer"], &display["preset"]), (&json!("SRGB"), &json!("lcd-wled")));
        assert!(display["ambient"]["illuminance_lux"] == 250.0 && display["contrast"] == 1000.0);
        // Our schema takes it.
        let spec = json!({"display": display, "video": {"pattern": {"uniform": {"rgb": [1, 1, 1]}}}});
        assert!(photoneye_proto::experiment_from_json(&spec.to_string()).is_ok());
    }

    /// PQ stays absolute PQ, BT.709 is shown by the law of sRGB; a headset has an angle instead of a size.
    #[test]
    fn colour_spaces_and_headsets_keep_their_meaning() {
        for (name, ours) in
            [("BT.2020-PQ", "PQ"), ("BT.2020-HLG", "HLG"), ("BT.709", "SRGB"), ("BT.2020-linear", "LINEAR")]
        {
            assert_eq!(transfer(name), Ok(ours));
        }
        // 1590 cd/m² and 10 lx: 1.2 + 0.42 log10(1.59) − 0.07623 log10(2).
        let phone = json!({
            "resolution": [2532, 1170], "viewing_distance_inches": 20, "diagonal_size_inches": 6.1,
            "max_luminance": 1590, "E_ambient": 10, "colorspace": "BT.2020-HLG",
        });
        let display = converted(phone.as_object().unwrap(), "oled").unwrap();
        let gamma = display["hlg_system_gamma"].as_f64().unwrap();
        assert!((gamma - 1.261_64).abs() < 1e-4, "{gamma}");
        let headset = json!({
            "resolution": [1440, 1600], "viewing_distance_meters": 3, "fov_diagonal": 110, "max_luminance": 100,
        });
        let display = converted(headset.as_object().unwrap(), "oled").unwrap();
        // The tangent of 55° times 3 m is half of a diagonal of 2152.6 pixels.
        let pitch_cm = display["pixel_pitch_cm"].as_f64().unwrap();
        assert!((pitch_cm / (2.0 * 300.0 * 1.428_148 / 2_152.580) - 1.0).abs() < 1e-6, "{pitch_cm}");
    }

    #[test]
    fn what_is_missing_or_odd_is_named() {
        let whole = json!({
            "resolution": [100, 100], "viewing_distance_inches": 20, "diagonal_size_inches": 10, "max_luminance": 100,
        });
        for (field, value) in [
            ("resolution", json!([9000, 10])),
            ("resolution", json!("x")),
            ("viewing_distance_inches", Value::Null),
            ("max_luminance", json!(-1)),
            ("colorspace", json!("XYZ")),
            ("exposure", json!(4)),
        ] {
            let mut entry = whole.clone();
            entry[field] = value;
            let error = converted(entry.as_object().unwrap(), "oled").unwrap_err();
            assert!(error.contains(&field[..8]), "{error}");
        }
    }
}
