//! Built-in scenes: bright, dim, fine, wide, moving, small and large pupils.

use serde_json::{Value, json};

use super::super::scene::{experiment, standard, with};
use super::Scene;

/// The scenes, two of them for a quick study.
///
/// # Errors
/// When the schema refuses one.
pub fn all(quick: bool) -> Result<Vec<Scene>, String> {
    let drift = json!({"drift": {"speed_arcmin_per_s": 1200, "direction_deg": 30}});
    let luminance = |value: f64| [("display.white_luminance_cd_m2", json!(value))];
    let line = json!([{"name": "white", "spectrum": {"line": {"nm": 555, "fwhm_nm": 0}}}]);
    let base = || standard(16, 2);
    let listed: Vec<(&str, Value)> = if quick {
        let region = json!({"x_min": -0.1, "x_max": 0.1, "y_min": -0.1, "y_max": 0.1});
        let small = |spec| with(spec, &[("retina.region_deg", region.clone())]);
        vec![
            ("dim, 3 mm", small(with(standard(8, 2), &luminance(10.0)))),
            (
                "moving, 2 mm",
                small(with(standard(8, 2), &[("gaze.movement", drift), ("eye.pupil_mm", json!(2))])),
            ),
        ]
    } else {
        vec![
            ("projector, 250 cd/m²", base()),
            ("bright, 50,000 cd/m²", with(base(), &luminance(50_000.0))),
            ("dim, 1 cd/m²", with(base(), &luminance(1.0))),
            ("fine, 30 c/deg", with(standard(60, 2), &[("display.pixel_pitch_cm", json!(0.116))])),
            ("wide, 2.5°", standard(60, 4)),
            ("moving, 20 arcmin a frame", with(base(), &[("gaze.movement", drift)])),
            ("pupil 2 mm", with(base(), &[("eye.pupil_mm", json!(2))])),
            // The optics of a wide pupil take minutes for a whole spectrum.
            (
                "pupil 6 mm, one line at 555 nm",
                with(base(), &[("eye.pupil_mm", json!(6)), ("display.primaries", line)]),
            ),
            ("Figure 12, a face's size", figure_12()),
            ("Figure 13, upper half", figure_13()),
            (
                "one lit pixel",
                with(
                    base(),
                    &[("video", json!({"pattern": {"point": {"at_px": [8, 8], "rgb": [1, 1, 1]}}}))],
                ),
            ),
        ]
    };
    listed
        .into_iter()
        .map(|(name, spec)| {
            let experiment = experiment(&spec).map_err(|e| format!("{name}: {e}"))?;
            Ok(Scene { name: name.into(), experiment, pictures: Vec::new() })
        })
        .collect()
}

/// The display of Figure 12 with squares of one pixel.
fn figure_12() -> Value {
    let drift = json!({"drift": {"speed_arcmin_per_s": 6, "direction_deg": 30}});
    with(standard(30, 1), &[("gaze.movement", drift)])
}

/// The upper, monochromatic half of Figure 13.
fn figure_13() -> Value {
    let line = json!([{"name": "white", "spectrum": {"line": {"nm": 543, "fwhm_nm": 1}}}]);
    json!({
        "eye": {"pupil_mm": 3, "focus": {"distance_cm": 50, "wavelength_nm": 543}},
        "display": {"preset": "printout-1200dpi", "white_luminance_cd_m2": 270.6, "primaries": line},
        "video": {"pattern": {"sloan_chart": {"layout": "PAPER"}}},
        "counts": {"engine": "EXPECTED", "noise": "NONE", "seed": 13},
    })
}
