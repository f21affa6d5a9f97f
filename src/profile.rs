//! The cones' signal across a picture, averaged over its height (Figure 14): profile.csv and profile.png of a result folder.
//!
//! A cone's signal is its count over what a cone of its type and aperture counts on the average. Columns are 0.25 arcmin wide. Of a
//! frequency sweep the contrast is fitted in windows of 4 cycles per degree: weighted least squares of `a + b cos φ + c sin φ` with the
//! sweep's own phase φ at each cone, contrast `√(b²+c²)/a`, standard error `√(2/N)` for N counts.

use std::fmt::Write as _;
use std::path::Path;

use photoneye_eye::experiment::{Experiment, Pattern, Video};
use photoneye_eye::picture::encode_png;
use photoneye_store::table::ConeColumns;
use serde_json::Value;

use crate::chart::{Axis, Chart, PALETTE, Series, Style, page};
use crate::counts_file::CountsFile;
use crate::failure::{Failure, plain};
use crate::pictures::read_cones;

/// Width of a column, degrees.
const COLUMN_DEG: f64 = 0.25 / 60.0;
/// Width of a window, cycles per degree.
const WINDOW_CPD: f64 = 4.0;
/// Part of the picture's height that is used; the rest is its blurred edge.
const HEIGHT: f64 = 0.9;

/// A cone in the picture: degrees from the gaze centre to the right, counts, and counts of an average cone like it.
#[derive(Clone, Copy)]
struct Signal {
    x_deg: f64,
    count: f64,
    usual: f64,
}

/// Contrast that is left around a frequency.
#[derive(Clone, Copy, Debug)]
struct Contrast {
    cycles_per_degree: f64,
    left: f64,
    error: f64,
}

/// Writes profile.csv and profile.png (and sweep.csv of a sweep) and says what was read off.
///
/// # Errors
/// When a file is missing or damaged, or the disk refuses.
pub fn write(folder: &Path) -> Result<String, Failure> {
    let experiment = experiment(folder)?;
    let cones = read_cones(&folder.join("cones.arrow"))?;
    let mut counts = CountsFile::open(&folder.join("counts.npy"))?;
    let mut sums = vec![0.0; counts.cones];
    for index in 0..counts.frames {
        sums.iter_mut().zip(counts.frame(index)?).for_each(|(sum, value)| *sum += value);
    }
    let signals = signals(&cones, &sums, &experiment);
    let profile = columns(&signals);
    let mut csv = String::from("x_deg,signal\n");
    for (x, signal) in &profile {
        // Writing into a string cannot fail.
        let _ = writeln!(csv, "{x:.6},{signal:.6}");
    }
    save(&folder.join("profile.csv"), csv.as_bytes())?;
    let mut charts = vec![Chart {
        title: "Signal of the cones, averaged over the height".into(),
        x: Axis::linear("Visual field, degrees"),
        y: Axis::linear("Count over mean count"),
        series: vec![Series::new("", profile, Style::Line, PALETTE[0])],
        bands: Vec::new(),
    }];
    let mut said = format!("profile of {} cones in {}", signals.len(), folder.display());
    if let Video::Pattern(Pattern::Sweep { from_cycles_per_degree, to_cycles_per_degree, .. }) =
        &experiment.video
    {
        let contrasts = contrasts(&signals, &experiment, [*from_cycles_per_degree, *to_cycles_per_degree]);
        let mut csv = String::from("cycles_per_degree,contrast,standard_error\n");
        for c in &contrasts {
            let _ = writeln!(csv, "{:.3},{:.5},{:.5}", c.cycles_per_degree, c.left, c.error);
        }
        save(&folder.join("sweep.csv"), csv.as_bytes())?;
        for level in [0.5, 0.2, 0.1] {
            let _ = match cut_off(&contrasts, level) {
                Some(cpd) => write!(said, "; contrast {level} at {cpd:.1} cycles per degree"),
                None => write!(said, "; contrast above {level} throughout"),
            };
        }
        charts.push(sweep_chart(&contrasts));
    }
    let image = page("", &charts, 1);
    let png = encode_png(image.width, image.height, &image.rgb).map_err(Failure::failed)?;
    save(&folder.join("profile.png"), &png)?;
    Ok(said)
}

fn experiment(folder: &Path) -> Result<Experiment, Failure> {
    let path = folder.join("report.json");
    let wrong = |why: String| Failure::usage(format!("{}: {why}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|e| wrong(plain(&e)))?;
    let mut report: Value = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
    serde_json::from_value(report["spec"].take()).map_err(|e| wrong(format!("spec: {e}")))
}

fn save(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|e| Failure::file("write", path, &e))
}

/// Cones on the picture, with their signal.
fn signals(cones: &ConeColumns, sums: &[f64], experiment: &Experiment) -> Vec<Signal> {
    let display = &experiment.display;
    let pixel_deg = display.pixel_radians().to_degrees();
    let centre = experiment.gaze.center_px;
    let half = 0.5 * f64::from(display.height_px);
    let inside = |i: &usize| {
        let (column, row) =
            (centre[0] + cones.x_deg[*i] / pixel_deg, centre[1] - cones.y_deg[*i] / pixel_deg);
        (0.0..f64::from(display.width_px)).contains(&column) && (row - half).abs() < HEIGHT * half
    };
    let mut rates = [[0.0; 2]; 3];
    for i in (0..sums.len()).filter(inside) {
        let rate = &mut rates[usize::from(cones.kind[i].min(2))];
        rate[0] += sums[i];
        rate[1] += f64::from(cones.aperture_um2[i]);
    }
    let signal = |i: usize| {
        let [count, area] = rates[usize::from(cones.kind[i].min(2))];
        let usual = if area > 0.0 { count / area * f64::from(cones.aperture_um2[i]) } else { 0.0 };
        Signal { x_deg: cones.x_deg[i], count: sums[i], usual }
    };
    (0..sums.len()).filter(inside).map(signal).filter(|s| s.usual > 0.0).collect()
}

/// Mean signal by column; columns without cones are left out.
fn columns(signals: &[Signal]) -> Vec<(f64, f64)> {
    let mut sums: std::collections::BTreeMap<i64, [f64; 2]> = std::collections::BTreeMap::new();
    for signal in signals {
        let sum = sums.entry((signal.x_deg / COLUMN_DEG).floor() as i64).or_default();
        sum[0] += signal.count;
        sum[1] += signal.usual;
    }
    sums.into_iter()
        .map(|(column, [count, usual])| ((column as f64 + 0.5) * COLUMN_DEG, count / usual))
        .collect()
}

fn contrasts(signals: &[Signal], experiment: &Experiment, [from, to]: [f64; 2]) -> Vec<Contrast> {
    let pixel_deg = experiment.display.pixel_radians().to_degrees();
    let left = -experiment.gaze.center_px[0] * pixel_deg;
    let rise = (to - from) / (f64::from(experiment.display.width_px) * pixel_deg);
    let windows = ((to - from).abs() / WINDOW_CPD).ceil().max(1.0) as usize;
    let mut moments = vec![[[0.0; 4]; 3]; windows];
    let mut counts = vec![0.0; windows];
    for signal in signals {
        let x = signal.x_deg - left;
        let window = ((rise * x).abs() / WINDOW_CPD) as usize;
        let Some(moment) = moments.get_mut(window) else { continue };
        let (sin, cos) = (std::f64::consts::TAU * (from * x + 0.5 * rise * x * x)).sin_cos();
        let basis = [1.0, cos, sin];
        for (row, a) in moment.iter_mut().zip(basis) {
            (0..3).for_each(|j| row[j] += signal.usual * a * basis[j]);
            row[3] += a * signal.count;
        }
        counts[window] += signal.count;
    }
    let fit = |(i, (moment, count)): (usize, (&[[f64; 4]; 3], &f64))| {
        let cycles_per_degree = from + (to - from).signum() * WINDOW_CPD * (i as f64 + 0.5);
        // Less than one cycle in a window fits anything.
        if cycles_per_degree * WINDOW_CPD < rise.abs() {
            return None;
        }
        let [a, b, c] = solve(*moment)?;
        Some(Contrast { cycles_per_degree, left: b.hypot(c) / a, error: (2.0 / count).sqrt() })
    };
    moments.iter().zip(&counts).enumerate().filter_map(fit).collect()
}

/// Solves three equations; `None` when they do not determine the answer.
fn solve(mut m: [[f64; 4]; 3]) -> Option<[f64; 3]> {
    for i in 0..3 {
        let pivot = (i..3).max_by(|&a, &b| m[a][i].abs().total_cmp(&m[b][i].abs()))?;
        m.swap(i, pivot);
        if m[i][i].abs() < 1e-12 {
            return None;
        }
        for k in (0..3).filter(|k| *k != i) {
            let factor = m[k][i] / m[i][i];
            let row = m[i];
            m[k].iter_mut().zip(row).for_each(|(value, above)| *value -= factor * above);
        }
    }
    Some([m[0][3] / m[0][0], m[1][3] / m[1][1], m[2][3] / m[2][2]])
}

/// Frequency at which the contrast falls below a level for good, by linear interpolation.
fn cut_off(contrasts: &[Contrast], level: f64) -> Option<f64> {
    let last = contrasts.iter().rposition(|c| c.left >= level)?;
    let (a, b) = (contrasts[last], contrasts.get(last + 1)?);
    let part = (a.left - level) / (a.left - b.left);
    Some(a.cycles_per_degree + part * (b.cycles_per_degree - a.cycles_per_degree))
}

fn sweep_chart(contrasts: &[Contrast]) -> Chart {
    let points = contrasts.iter().map(|c| (c.cycles_per_degree, c.left)).collect();
    let mut series = Series::new("", points, Style::Both, PALETTE[1]);
    series.error = contrasts.iter().map(|c| c.error).collect();
    Chart {
        title: "Contrast that is left".into(),
        x: Axis::linear("Cycles per degree"),
        y: Axis { least: Some((0.0, 1.0)), ..Axis::linear("Contrast") },
        series: vec![series],
        bands: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_equations_are_solved() {
        let [a, b, c] = solve([[2.0, 1.0, 0.0, 4.0], [0.0, 0.0, 3.0, 9.0], [1.0, -1.0, 1.0, 2.0]]).unwrap();
        assert!((a - 1.0).abs() < 1e-12 && (b - 2.0).abs() < 1e-12 && (c - 3.0).abs() < 1e-12);
        assert!(solve([[1.0, 2.0, 3.0, 4.0]; 3]).is_none());
    }

    #[test]
    fn the_cut_off_is_the_last_fall_below_the_level() {
        let at = |cycles_per_degree: f64, left: f64| Contrast { cycles_per_degree, left, error: 0.0 };
        let curve = [at(10.0, 0.9), at(20.0, 0.4), at(30.0, 0.6), at(40.0, 0.2)];
        assert!((cut_off(&curve, 0.5).unwrap() - 32.5).abs() < 1e-9);
        assert!(cut_off(&curve, 0.1).is_none());
    }
}
