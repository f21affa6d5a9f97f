//! Specs: defaults, presets with overrides, and errors that name the field, its value and what is allowed.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::too_many_lines,
    clippy::float_cmp,
    reason = "a test says by panicking what is wrong"
)]

use photoneye_eye::cone::directional::PointingLaw;
use photoneye_eye::display::White;
use photoneye_eye::experiment::{Experiment, Movement, Video};
use photoneye_eye::optics::{Dispersion, Prescription};
use photoneye_proto::experiment_from_json;
use photoneye_server::spec::experiment;
use serde_json::{Value, json};

fn read(spec: &Value) -> Result<Experiment, String> {
    let message = experiment_from_json(&spec.to_string()).map_err(|error| error.to_string())?;
    experiment(&message).map_err(|error| error.to_string())
}

/// A small spec with one part replaced.
fn with(part: &str, value: Value) -> Value {
    let mut spec =
        json!({"display": {"preset": "lcos-3chip"}, "video": {"pattern": {"uniform": {"rgb": [0, 0.5, 1]}}}});
    spec[part] = value;
    spec
}

#[test]
fn defaults_are_filled_in() {
    let read = read(&with("eye", json!({}))).unwrap();
    assert_eq!((read.eye.pupil_mm.to_bits(), read.retina.seed, read.frames), (3.0_f64.to_bits(), 1, 1));
    assert_eq!(read.gaze.movement, Movement::Still);
    assert_eq!(read.gaze.center_px, [15.0, 15.0]);
    assert!((read.eye.focus_distance_cm - 800.0).abs() < 1e-9, "the display's distance");
    assert_eq!(read.display.primaries.len(), 3);
}

#[test]
fn zero_is_a_value_and_minus_zero_is_zero() {
    let drift = json!({"movement": {"drift": {"speed_arcmin_per_s": 0}}});
    let zero = read(&with("gaze", drift)).unwrap();
    assert!(
        matches!(zero.gaze.movement, Movement::Drift { speed_arcmin_per_s, .. } if speed_arcmin_per_s.to_bits() == 0)
    );
    let minus = read(&with("gaze", json!({"movement": {"drift": {"speed_arcmin_per_s": -0.0}}}))).unwrap();
    assert_eq!(zero.digest().unwrap(), minus.digest().unwrap());
}

#[test]
fn a_preset_is_overridden_field_by_field_and_primaries_whole() {
    let line = json!([{"name": "green", "spectrum": {"line": {"nm": 543}}}]);
    let display = json!({"preset": "lcos-3chip", "lumens": 5, "width_px": 7, "primaries": line});
    let read = read(&with("display", display)).unwrap().display;
    assert_eq!((read.width_px, read.height_px, read.primaries.len()), (7, 30, 1));
    assert_eq!(read.white, White::Lumens(5.0));
    assert_eq!(read.primaries[0].rects, [[0.0, 0.0, 1.0, 1.0]]);
}

#[test]
fn cone_shares_are_scaled_to_one() {
    let read = read(&with("retina", json!({"cone_ratio": {"l": 2, "m": 1, "s": 1}}))).unwrap();
    assert_eq!(read.retina.cone_ratio, [0.5, 0.25, 0.25]);
}

#[test]
fn frames_follow_the_pictures() {
    let blob = photoneye_store::BlobDigest::of(b"").to_string();
    let read = read(&with("video", json!({"clip": {"blobs": [blob, blob]}}))).unwrap();
    assert_eq!(read.frames, 2);
    assert!(matches!(read.video, Video::Clip(clip) if clip.blobs.len() == 2));
}

/// The scan of a CRT, bleaching and isomerizations without light: read, with their defaults, off when they are not given.
#[test]
fn scan_bleaching_and_dark_isomerizations_are_read() {
    use photoneye_eye::display::{Scan, Waveform};
    let crt = read(&with("display", json!({"preset": "crt"}))).unwrap();
    let scan = crt.display.primaries[0].waveform.scan().copied();
    assert_eq!(scan, Some(Scan { share: 0.96, line: 0.76 }));
    let rows = json!([{"name": "white", "spectrum": {"equal_energy": {}}, "waveform": {"scan": {}}}]);
    let held = read(&with("display", json!({"preset": "lcos-3chip", "primaries": rows}))).unwrap();
    let pixel = Box::new(Waveform::Steady);
    let waveform = Waveform::Scanned { pixel, scan: Scan { share: 0.95, line: 0.8 } };
    assert_eq!(held.display.primaries[0].waveform, waveform);
    assert_eq!((crt.retina.dark_isomerizations_per_s, crt.retina.bleaching_td), (0.0, None));
    let cones = json!({"dark_isomerizations_per_s": 100, "bleaching": {}});
    let read = read(&with("retina", cones)).unwrap();
    assert_eq!(read.retina.dark_isomerizations_per_s, 100.0);
    // The default is the display's white, 250 cd/m² through 3 mm.
    let td = read.retina.bleaching_td.unwrap();
    let white = read.display.white_trolands(3.0);
    assert!((td - white).abs() < 1e-9 && td > 1.0, "{td}");
}

#[test]
fn errors_name_the_field_and_what_is_allowed() {
    let scanned = |waveform: Value| {
        let white = json!([{"name": "white", "spectrum": {"equal_energy": {}}, "waveform": waveform}]);
        json!({"preset": "lcos-3chip", "primaries": white})
    };
    let cases = [
        (
            "display",
            scanned(json!({"pwm": {"hz": 240, "duty": 0.5}, "scan": {}})),
            "display.primaries[0].waveform.scan: with pwm is out of range",
        ),
        (
            "display",
            scanned(json!({"phosphor": {"decay_us": 100, "start": 0.2}, "scan": {"share": 0.9}})),
            "display.primaries[0].waveform.scan.share: 0.9 is out of range",
        ),
        (
            "retina",
            json!({"bleaching": {"adaptation_td": -1}}),
            "retina.bleaching.adaptation_td: -1 is out of range",
        ),
        (
            "retina",
            json!({"dark_isomerizations_per_s": -1}),
            "retina.dark_isomerizations_per_s: -1 is out of range",
        ),
        ("eye", json!({"pupil_mm": 12}), "eye.pupil_mm: 12 is out of range, allowed is 0.5 to 9"),
        ("eye", json!({"preset": "cat"}), "eye.preset: unknown eye `cat`"),
        ("display", json!({"preset": "oled", "contrast": 0.5}), "display.contrast: 0.5 is out of range"),
        ("display", json!({"preset": "oled", "lag_ms": -1}), "display.lag_ms: -1 is out of range"),
        ("display", json!({"preset": "oled", "ambient": {}}), "display.ambient.illuminance_lux: is missing"),
        (
            "gaze",
            json!({"movement": {"recorded": {"t_s": [0, 1], "x_arcmin": [0], "y_arcmin": [0, 0]}}}),
            "gaze.movement.recorded.x_arcmin: 1 values, expected 2 as in t_s",
        ),
        (
            "gaze",
            json!({"movement": {"recorded": {"t_s": [1, 1], "x_arcmin": [0, 0], "y_arcmin": [0, 0]}}}),
            "gaze.movement.recorded.t_s[1]: 1 is out of range",
        ),
        (
            "video",
            json!({"pattern": {"sloan_chart": {"rows": [{"letters": "QED", "stroke_arcmin": 1}]}}}),
            "video.pattern.sloan_chart.rows[0].letters: QED is out of range, allowed is 1 to 100 letters of",
        ),
        (
            "video",
            json!({"clip": {"blobs": [], "yuv": {"matrix": "BT709"}}}),
            "video.clip.yuv.range: is missing",
        ),
        (
            "eye",
            json!({"stiles_crawford": {"rho_per_mm2": 1}}),
            "eye.stiles_crawford.rho_per_mm2: 1 is out of range",
        ),
        (
            "eye",
            json!({"cornea_density_scale": 6}),
            "eye.cornea_density_scale: 6 is out of range, allowed is 0 to 5",
        ),
        (
            "retina",
            json!({"cell_walls": "AVERAGING"}),
            "retina.cell_walls: 1 is out of range, allowed is AVERAGING with",
        ),
        (
            "retina",
            json!({"aperture": "ROD"}),
            "retina.aperture: unknown variant `ROD`, expected `CELL` or `INNER_SEGMENT`",
        ),
        ("retina", json!({"region_deg": {"x_min": 0}}), "retina.region_deg.x_max: is missing"),
        (
            "retina",
            json!({"cone_ratio": {"l": 0, "m": 0, "s": 0}}),
            "retina.cone_ratio: the shares are all 0",
        ),
        ("retina", json!({"cone_ratio": {"l": -1}}), "retina.cone_ratio.l: -1 is out of range"),
        ("display", json!({}), "display.white_luminance_cd_m2: is missing"),
        ("display", json!({"preset": "x"}), "display.preset: unknown display `x`, expected one of `"),
        (
            "display",
            json!({"preset": "lcos-3chip", "lumens": 1, "white_luminance_cd_m2": 1}),
            "display.lumens: excludes",
        ),
        (
            "display",
            json!({"preset": "lcos-3chip", "width_px": 0}),
            "display.width_px: 0 is out of range, allowed is 1 to 8192",
        ),
        (
            "display",
            json!({"preset": "lcos-3chip", "primaries": [{"name": "red", "spectrum": {}}]}),
            "display.primaries[0].spectrum: is empty, expected one of `line`, `named`, `table`, `equal_energy`",
        ),
        (
            "display",
            json!({"preset": "lcos-3chip", "primaries": [{"name": "pink"}]}),
            "display.primaries[0].name: unknown primary `pink`",
        ),
        ("video", json!({"files": {"paths": ["/etc/passwd"]}}), "video.files: the server reads no files"),
        ("video", json!({}), "video: is empty, expected one of"),
        (
            "video",
            json!({"pattern": {"uniform": {"rgb": [1, 2]}}}),
            "video.pattern.uniform.rgb: 2 values, expected 3",
        ),
        (
            "video",
            json!({"pattern": {"uniform": {"rgb": [1, 2, 0]}}}),
            "video.pattern.uniform.rgb[1]: 2 is out of range",
        ),
        ("video", json!({"clip": {"blobs": ["x"]}}), "video.clip.blobs[0]: `x` is not a digest"),
        ("video", json!({"clip": {"blobs": []}}), "video.clip.blobs: 0 is out of range"),
        ("gaze", json!({"center_px": [1]}), "gaze.center_px: 1 values, expected 2"),
        ("counts", json!({"engine": "EVENTS", "noise": "NONE"}), "counts.noise"),
        ("counts", json!({"noise": 7}), "counts.noise: invalid value"),
        ("frames", json!({"count": 0}), "frames.count: 0 is out of range, allowed is 1 to 100000"),
        ("accuracy", json!({"target": 1}), "accuracy.target: 1 is out of range"),
    ];
    for (part, value, expected) in cases {
        let error = read(&with(part, value.clone())).unwrap_err();
        assert!(error.starts_with(expected), "{value} gave: {error}");
    }
}

#[test]
fn an_eye_is_overridden_field_by_field_and_its_tables_whole() {
    let own = |eye: Value| read(&with("eye", eye)).unwrap().eye;
    assert!(own(json!({"preset": "navarro-1985", "pupil_mm": 5})).prescription.is_none());
    let eye = own(json!({"cornea_front": {"radius_mm": 7.9}, "fovea_angle_deg": 4, "pupil_mm": 5}));
    let data = eye.prescription.unwrap();
    assert_eq!(
        (data.cornea_front.radius_mm, data.cornea_front.conic, data.fovea_angle_deg),
        (7.9, -0.26, 4.0)
    );
    assert_eq!(data.lens_back.radius_mm, -6.0);
    let table = json!({"cornea": 1.376, "aqueous": 1.336, "lens": 1.42, "vitreous": 1.336,
        "constant": 0, "linear_per_um": 0, "square_per_um2": 0});
    let eye = own(
        json!({"quadratic": table, "accommodation": {}, "wavefront": {"pupil_mm": 6, "coefficients_um": [0, 0, 0, 0.1]}}),
    );
    assert_eq!(eye.dispersion, Dispersion::Quadratic);
    let data = eye.prescription.unwrap();
    assert!(data.herzberger.is_none() && data.polyline.is_none() && data.wavefront.is_some());
    let eye = own(json!({"preset": "liou-brennan-1997", "lens_gradient": {}}));
    assert!(eye.prescription.unwrap().lens_gradient.unwrap().parts.is_empty());
    assert_eq!((eye.decentre_mm, eye.dispersion), (0.5, Dispersion::Quadratic));
}

/// The data file of an eye is what an experiment may say of it: every preset, all inline over another one, is itself.
#[test]
fn every_eye_of_the_catalogue_can_be_given_inline() {
    for name in photoneye_eye::catalog::names("eyes") {
        let text = photoneye_eye::catalog::text("eyes", name).unwrap();
        let mut inline: Value = serde_json::from_str(text).unwrap();
        let fields = inline.as_object_mut().unwrap();
        let (description, source) = (fields.remove("description"), fields.remove("source"));
        fields.remove("stop_decentre_mm");
        fields.entry("lens_gradient").or_insert_with(|| json!({}));
        fields.entry("accommodation").or_insert_with(|| json!({}));
        let read = read(&with("eye", inline)).unwrap();
        let mut eye = *read.eye.prescription.unwrap();
        let mut preset = Prescription::preset(name).unwrap();
        (eye.description, eye.source) =
            (description.unwrap().as_str().unwrap().into(), source.unwrap().as_str().unwrap().into());
        eye.stop_decentre_mm = preset.stop_decentre_mm;
        eye.lens_gradient = eye.lens_gradient.filter(|gradient| !gradient.parts.is_empty());
        if preset.accommodation.is_none() {
            preset.accommodation = eye.accommodation;
        }
        assert!(eye == preset, "{name}");
    }
}

#[test]
fn persons_sizes_and_pupils() {
    let own = |eye: Value| read(&with("eye", eye)).unwrap().eye;
    let length = |eye: Value| own(eye).prescription.unwrap().axial_length_mm();
    assert!((length(json!({"axial_length_mm": 26})) - 26.0).abs() < 1e-9);
    let person = own(json!({"person": {"seed": 4}}));
    assert_eq!(person, own(json!({"person": {"seed": "4"}})));
    assert_ne!(person, own(json!({"person": {"seed": 5}})));
    let eye = own(json!({"pupil_formula": {"luminance_cd_m2": 100}, "pupil_shift_mm_per_mm": 0.02}));
    assert!((eye.pupil_mm - 3.850).abs() < 1e-3, "{}", eye.pupil_mm);
    assert!((eye.decentre_mm - (0.4 - 0.02 * 0.850)).abs() < 1e-4, "{}", eye.decentre_mm);
    assert!(own(json!({"focus": {"relaxed": true}})).relaxed);
}

/// Losses of light are fields of the eye beside its data: they leave the preset as it is.
#[test]
fn scattered_and_reflected_light() {
    let own = |eye: Value| read(&with("eye", eye)).unwrap().eye;
    let usual = own(json!({"stray_light": {}, "reflection_losses": true}));
    let light = usual.stray_light.unwrap();
    assert_eq!((light.age_years, light.pigmentation), (30.0, 0.5));
    assert!(usual.reflection_losses && usual.prescription.is_none());
    assert!(own(json!({})).stray_light.is_none());
    let error = read(&with("eye", json!({"stray_light": {"age_years": 200}}))).unwrap_err();
    assert!(error.starts_with("eye.stray_light.age_years: 200 is out of range"), "{error}");
}

/// The default coefficient depends on the base; a scale of the cornea is no data of the eye's surfaces.
#[test]
fn directional_sensitivity_and_the_cornea_s_scale() {
    let own = |eye: Value| read(&with("eye", eye)).unwrap().eye;
    let usual = own(json!({}));
    assert_eq!((usual.stiles_crawford_rho10_per_mm2, usual.pointing_law), (0.0415, PointingLaw::Population));
    let paper = own(json!({"stiles_crawford": {"base": "E", "pointing": "PAPER"}}));
    assert!((paper.stiles_crawford_rho10_per_mm2 - 0.05 / std::f64::consts::LN_10).abs() < 1e-15);
    assert_eq!(paper.pointing_law, PointingLaw::Paper);
    let scaled = own(json!({"cornea_density_scale": 2, "lens_density_scale": 0.5}));
    assert_eq!((scaled.cornea_density_scale, scaled.lens_density_scale), (2.0, 0.5));
    assert!(scaled.prescription.is_none());
}

#[test]
fn eyes_that_are_none_are_refused_by_field() {
    let cases = [
        (
            json!({"cornea_front": {"radius_mm": 0}}),
            "eye.cornea_front.radius_mm: 0 is out of range, allowed is 3 to 30",
        ),
        (json!({"lens_back": {"toric": {"radius_mm": -6}}}), "eye.lens_back.toric: missing field `conic`"),
        (json!({"lens_back": {"curvature": -6}}), "eye.lens_back.curvature: unknown field `curvature`"),
        (json!({"polyline": {"wavelength_nm": [500, 600]}}), "eye.polyline"),
        (json!({"axial_length_mm": 5}), "eye.axial_length_mm: 5 is out of range, allowed is 18 to 32"),
        (json!({"axial_length_mm": 25, "person": {}}), "eye.axial_length_mm: excludes `person`"),
        (
            json!({"pupil_mm": 3, "pupil_formula": {"luminance_cd_m2": 1}}),
            "eye.pupil_mm: excludes `pupil_formula`",
        ),
        (json!({"pupil_formula": {}}), "eye.pupil_formula.luminance_cd_m2: is missing"),
        (
            json!({"pupil_formula": {"luminance_cd_m2": 1, "age_years": 5}}),
            "eye.pupil_formula.age_years: 5 is out of range, allowed is 20 to 83",
        ),
        (
            json!({"preset": "liou-brennan-1997", "dispersion": "POLYLINE"}),
            "eye.dispersion: this eye has no table for `POLYLINE`, expected one of `QUADRATIC`",
        ),
        (
            json!({"pupil_mm": 6, "wavefront": {"pupil_mm": 5, "coefficients_um": []}}),
            "eye.pupil_mm: 6 is out of range, allowed is up to that of `wavefront`, 5",
        ),
        (json!({"wavefront": {"coefficients_um": [1]}}), "eye.wavefront: missing field `pupil_mm`"),
        (json!({"pupil_shift_mm_per_mm": 1}), "eye.pupil_shift_mm_per_mm: 1 is out of range"),
    ];
    for (value, expected) in cases {
        let error = read(&with("eye", value.clone())).unwrap_err();
        assert!(error.starts_with(expected), "{value} gave: {error}");
    }
}

/// Over gRPC numbers may come that JSON cannot say.
#[test]
fn what_only_binary_messages_can_say_is_refused_too() {
    let message = |change: &dyn Fn(&mut photoneye_proto::v1::Experiment)| {
        let mut message = experiment_from_json(&with("eye", json!({})).to_string()).unwrap();
        change(&mut message);
        experiment(&message).unwrap_err().to_string()
    };
    let nan = message(&|m| m.eye.as_mut().unwrap().pupil_mm = Some(f64::NAN));
    assert!(nan.starts_with("eye.pupil_mm: NaN is out of range"), "{nan}");
    let infinite = message(&|m| m.display.as_mut().unwrap().distance_cm = Some(f64::INFINITY));
    assert!(infinite.starts_with("display.distance_cm: inf"), "{infinite}");
    let surface = photoneye_proto::v1::Surface { radius_mm: Some(f64::NAN), ..Default::default() };
    let radius = message(&|m| m.eye.as_mut().unwrap().cornea_front = Some(surface));
    assert!(
        radius.starts_with("eye.cornea_front.radius_mm: ") && radius.ends_with("is not a number"),
        "{radius}"
    );
    let side = message(&|m| m.eye.as_mut().unwrap().side = Some(9));
    assert_eq!(side, "eye.side: unknown variant `9`, expected one of `RIGHT`, `LEFT`");
}

#[test]
fn every_display_of_the_catalogue_fits() {
    for name in photoneye_eye::catalog::names("displays") {
        read(&with("display", json!({"preset": name}))).unwrap();
    }
}
