//! What came out, for a person: where the photons went, what the cones counted, how long it took.

use std::fmt::Write as _;
use std::path::Path;

use photoneye_eye::report::WorkReport;
use serde_json::Value;

/// The summary of a report.json, as lines.
pub fn of_report(report: &Value, out: &Path, pictures: usize) -> String {
    let mut text = String::new();
    let work: WorkReport = serde_json::from_value(report["work"].clone()).unwrap_or_default();
    photons(&mut text, &work);
    cones(&mut text, &work, frames(report));
    seconds(&mut text, &work);
    let _ = writeln!(text, "Result        {}", out.display());
    if pictures > 0 {
        let _ = writeln!(text, "Pictures      {}", out.join("frames").display());
    }
    text.trim_end().to_owned()
}

/// Number of frames of the report.
fn frames(report: &Value) -> u64 {
    report["experiment"]["frames"].as_u64().unwrap_or(1).max(1)
}

fn photons(text: &mut String, work: &WorkReport) {
    let budget = &work.budget;
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
        ("lost in the cornea", budget.cornea),
        ("lost in the lens", budget.lens),
        ("lost in the macular pigment", budget.macula),
        ("fall between the cones or beside the patch", budget.between_cones),
        ("enter a cone obliquely (Stiles-Crawford)", budget.stiles_crawford),
        ("pass through the cone's pigment", budget.not_absorbed),
        ("are absorbed without isomerizing", budget.not_isomerized),
    ];
    for (what, photons) in losses {
        let _ = writeln!(text, "              {:>6} {what}", percent(photons, pupil));
    }
    let isomerized: f64 = budget.isomerized.iter().sum();
    let _ = writeln!(
        text,
        "              {:>6} isomerize a pigment molecule: {}",
        percent(isomerized, pupil),
        number(isomerized)
    );
}

fn cones(text: &mut String, work: &WorkReport, frames: u64) {
    let total: u64 = work.cones.iter().sum();
    let _ = writeln!(text, "Cones         {total}");
    for (i, name) in ["L", "M", "S"].iter().enumerate() {
        let looks = work.cones[i] * frames;
        let mean = if looks > 0 {
            work.counted[i] / looks as f64
        } else {
            0.0
        };
        let _ = writeln!(
            text,
            "              {:>6} {name}, on average {mean:.2} isomerizations a frame",
            work.cones[i]
        );
    }
}

fn seconds(text: &mut String, work: &WorkReport) {
    let total: f64 = work.seconds.values().sum();
    let _ = writeln!(text, "Work          {total:.2} s");
    for (stage, seconds) in &work.seconds {
        let _ = writeln!(text, "              {seconds:>6.2} s {stage}");
    }
    if work.peak_memory_bytes > 0 {
        let _ = writeln!(
            text,
            "Peak memory   {:.0} MB",
            work.peak_memory_bytes as f64 / 1e6
        );
    }
}

fn percent(part: f64, whole: f64) -> String {
    if whole > 0.0 {
        format!("{:.1} %", 100.0 * part / whole)
    } else {
        "–".into()
    }
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
        let mut work = WorkReport {
            cones: [2, 1, 0],
            counted: [20.0, 5.0, 0.0],
            ..WorkReport::default()
        };
        work.budget.emitted = 100.0;
        work.budget.missed_pupil = 50.0;
        work.budget.lens = 25.0;
        work.budget.isomerized = [20.0, 5.0, 0.0];
        let report = serde_json::json!({"work": work, "experiment": {"frames": 1}});
        let text = of_report(&report, Path::new("out/x"), 1);
        for part in [
            "50 enter the pupil",
            "50.0 % lost in the lens",
            "50.0 % isomerize",
            "10.00",
            "out/x",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
    }
}
