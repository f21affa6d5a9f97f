//! What came out, for a person: where the photons went, what the cones counted, how long it took.

use std::fmt::Write as _;
use std::path::Path;

use photoneye_eye::report::PhotonBudget;
use serde_json::Value;

/// The summary of a report.json, as lines.
pub fn of_report(report: &Value, out: &Path, pictures: usize) -> String {
    let mut text = String::new();
    let budget = serde_json::from_value(report["photon_budget"].clone()).unwrap_or_default();
    photons(&mut text, &budget);
    cones(&mut text, report);
    audit(&mut text, report);
    for warning in crate::pictures::warnings(report) {
        let _ = writeln!(text, "Warning       {warning}");
    }
    seconds(&mut text, report);
    let _ = writeln!(text, "Result        {}", out.display());
    if pictures > 0 {
        let _ = writeln!(text, "Pictures      {}", out.join("frames").display());
    }
    text.trim_end().to_owned()
}

fn photons(text: &mut String, budget: &PhotonBudget) {
    if budget.emitted <= 0.0 {
        let _ = writeln!(text, "Photons       none: the display is dark");
        return;
    }
    let pupil = budget.into_pupil();
    let _ = writeln!(text, "Photons       {} leave the display", number(budget.emitted));
    let _ = writeln!(
        text,
        "              {} enter the pupil (1 of {})",
        number(pupil),
        number(budget.emitted / pupil.max(f64::MIN_POSITIVE))
    );
    let losses = [
        ("reflected at the cornea and the lens", budget.reflected),
        ("lost in the cornea", budget.cornea),
        ("lost in the lens", budget.lens),
        ("lost in the macular pigment", budget.macula),
        ("fall between the cones or beside the patch", budget.between_cones),
        ("enter a cone obliquely (Stiles-Crawford)", budget.stiles_crawford),
        ("pass through the cone's pigment", budget.not_absorbed),
        ("are absorbed without isomerizing", budget.not_isomerized),
    ];
    for (what, photons) in losses.into_iter().filter(|(what, n)| *n > 0.0 || !what.starts_with("reflected")) {
        let _ = writeln!(text, "              {:>6} {what}", percent(photons, pupil));
    }
    let isomerized: f64 = budget.isomerized.iter().sum();
    let _ = writeln!(
        text,
        "              {:>6} isomerize a pigment molecule: {}",
        percent(isomerized, pupil),
        number(isomerized)
    );
    if budget.dark > 0.0 {
        let _ = writeln!(text, "              {} isomerizations come without light", number(budget.dark));
    }
}

fn cones(text: &mut String, report: &Value) {
    let of_type = |name: &str| report["cones"][name].as_u64().unwrap_or(0);
    let total: u64 = ["l", "m", "s"].into_iter().map(of_type).sum();
    let _ = writeln!(text, "Cones         {total}");
    for (name, letter) in [("l", "L"), ("m", "M"), ("s", "S")] {
        let _ = writeln!(
            text,
            "              {:>6} {letter}, on average {:.2} isomerizations a frame",
            of_type(name),
            mean_of_type(report, name)
        );
    }
    if let Some(edge @ 1..) = report["edge_cones"].as_u64() {
        let _ = writeln!(
            text,
            "              {edge:>6} more at the rim of the mosaic or beside gaps, left out of the means"
        );
    }
}

/// The mean over the listed frames.
fn mean_of_type(report: &Value, name: &str) -> f64 {
    let frames = report["frames"].as_array().map_or(&[][..], Vec::as_slice);
    let means = frames.iter().filter_map(|frame| frame["types"][name]["mean"].as_f64());
    let (sum, count) = means.fold((0.0, 0.0), |(sum, count), mean| (sum + mean, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// What was found by computing cones again.
fn audit(text: &mut String, report: &Value) {
    let found = &report["audit"];
    let Some(error) = found["relative_error"].as_f64() else { return };
    let bound = found["bound_95"].as_f64().map_or(String::new(), |b| format!(", at most {b:.1e} (95 %)"));
    let target = found["target"].as_f64().unwrap_or(0.0);
    let chance = found["by_chance"].as_f64().filter(|c| *c > 0.0);
    let chance = chance.map_or(String::new(), |c| format!(", of that {c:.1e} by chance"));
    let cones = found["cones"].as_u64().unwrap_or(0);
    let _ = writeln!(
        text,
        "Audit         {cones} cones computed again: error {error:.1e}{bound}{chance}; target {target}"
    );
}

fn seconds(text: &mut String, report: &Value) {
    let none = serde_json::Map::new();
    let stages = report["seconds"].as_object().unwrap_or(&none);
    let seconds = |value: &Value| value.as_f64().unwrap_or(0.0);
    let total: f64 = stages.values().map(seconds).sum();
    let wall = seconds(&report["wall_seconds"]);
    let _ = writeln!(
        text,
        "Time          {wall:.2} s from start to end; work, cached parts included, {total:.2} s:"
    );
    for (stage, value) in stages {
        let _ = writeln!(text, "              {:>6.2} s {stage}", seconds(value));
    }
    if let Some(bytes) = report["peak_memory_bytes"].as_f64().filter(|bytes| *bytes > 0.0) {
        let _ = writeln!(text, "Peak memory   {:.0} MB", bytes / 1e6);
    }
}

fn percent(part: f64, whole: f64) -> String {
    if whole > 0.0 { format!("{:.1} %", 100.0 * part / whole) } else { "–".into() }
}

/// 1234567 -> `1,234,567`; from ten million on `1.23e7`.
pub fn number(value: f64) -> String {
    if !(0.0..1e7).contains(&value) {
        return format!("{value:.3e}");
    }
    let digits = format!("{value:.0}");
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_readable() {
        assert_eq!(number(0.0), "0");
        assert_eq!(number(1_234_567.4), "1,234,567");
        assert_eq!(number(123.0), "123");
        assert_eq!(number(2.5e12), "2.500e12");
    }

    #[test]
    fn every_fate_is_told() {
        let budget = PhotonBudget {
            emitted: 100.0,
            missed_pupil: 50.0,
            lens: 25.0,
            isomerized: [20.0, 5.0, 0.0],
            ..PhotonBudget::default()
        };
        let report = serde_json::json!({
            "photon_budget": budget,
            "cones": {"l": 2, "m": 1, "s": 0},
            "frames": [{"types": {"l": {"mean": 10.0}, "m": {"mean": 5.0}}}],
            "seconds": {"count": 0.5},
            "warnings": ["accuracy: above the target"],
        });
        let text = of_report(&report, Path::new("out/x"), 1);
        for part in [
            "50 enter the pupil",
            "50.0 % lost in the lens",
            "50.0 % isomerize",
            "10.00",
            "out/x",
            "Warning       accuracy: above",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
    }
}
