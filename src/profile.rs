//! The cones' signal across a picture, averaged over its height (Figure 14): profile.csv and profile.png of a result folder.
//!
//! Columns are 0.25 arcmin wide. Of a frequency sweep the contrast that is left is fitted ([`photoneye_eye::video::sweep`]).

use std::fmt::Write as _;
use std::path::Path;

use glam::DVec2;
use photoneye_eye::experiment::{Experiment, Pattern, Video};
use photoneye_eye::video::ScreenView;
use photoneye_eye::video::reader::{self, Cones, Signal};
use photoneye_eye::video::sweep::{self, Contrast, cut_off};
use photoneye_store::table::ConeColumns;
use serde_json::Value;

use crate::chart::{Axis, Chart, PALETTE, Series, Style, page};
use crate::counts_file::CountsFile;
use crate::failure::{Failure, plain};
use crate::pictures::{read_cones, read_report, warnings};

/// Width of a column, degrees.
const COLUMN_DEG: f64 = 0.25 / 60.0;
/// Part of the picture's height that is used; the rest is its blurred edge.
const HEIGHT: f64 = 0.9;

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
    let view = ScreenView::of(&experiment).map_err(|e| Failure::failed(e.to_string()))?;
    let signals = signals(&cones, &sums, &view);
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
    if let Video::Pattern(Pattern::Sweep {
        from_cycles_per_degree, to_cycles_per_degree, sizes_hold, ..
    }) = &experiment.video
    {
        // Where the sweep is for each cone.
        let mut signals = signals;
        for signal in &mut signals {
            let px = view.px_at(DVec2::new(signal.x_deg, signal.y_deg));
            signal.x_deg = px.map_or(signal.x_deg, |px| view.across_deg(px, *sizes_hold));
        }
        let [left_deg, width_deg] = view.edge_and_width_deg(*sizes_hold);
        let range = [*from_cycles_per_degree, *to_cycles_per_degree];
        let contrasts = sweep::contrasts(&signals, left_deg, width_deg, range);
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
    let png = image.png_with(&warnings(&read_report(folder))).map_err(Failure::failed)?;
    save(&folder.join("profile.png"), &png)?;
    Ok(said)
}

fn experiment(folder: &Path) -> Result<Experiment, Failure> {
    let path = folder.join("report.json");
    let wrong = |why: String| Failure::usage(format!("{}: {why}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|e| wrong(plain(&e)))?;
    let mut report: Value = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
    serde_json::from_value(report["resolved"].take()).map_err(|e| wrong(format!("resolved: {e}")))
}

fn save(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|e| Failure::file("write", path, &e))
}

/// Cones on the picture, with their signal.
fn signals(cones: &ConeColumns, sums: &[f64], view: &ScreenView) -> Vec<Signal> {
    let display = view.display;
    let half = 0.5 * f64::from(display.height_px);
    let columns = Cones {
        x_deg: &cones.x_deg,
        y_deg: &cones.y_deg,
        kind: &cones.kind,
        aperture_um2: &cones.aperture_um2,
    };
    reader::signals(&columns, sums, |x_deg, y_deg| {
        view.px_at(DVec2::new(x_deg, y_deg)).is_some_and(|px| {
            (0.0..f64::from(display.width_px)).contains(&px.x) && (px.y - half).abs() < HEIGHT * half
        })
    })
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
