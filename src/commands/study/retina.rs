//! `study retina`: what a mosaic costs from a thousand cones to the whole retina (§15), by both generators.
//!
//! A square about the foveal centre is asked for that holds about the wanted number: up to `WHOLE` cones as one region in memory, beyond
//! that tile by tile as they come, of which only a few are held. The halo that is built around a region makes small ones dear.

use glam::DVec2;
use photoneye_eye::plan::setup::setup;
use photoneye_eye::retina::{Cones, Density, Generator, RegionUm, RetinaParams, build_region, synthesize};

use super::Task;
use super::clock::{Stopwatch, kind, peak_bytes, reset_peak};
use super::page::{Page, Table};
use super::scene::{experiment, standard};
use crate::chart::{Axis, Chart, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// Most cones that the domain generator makes as one region.
const WHOLE: f64 = 1.2e5;

/// Fills the page.
pub fn study(task: &mut Task, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "What a mosaic costs",
        "Squares about the foveal centre, up to the whole retina; default parameters. CPU seconds of all threads with cells, types and \
         pointing; up to 120,000 cones (and all of the ring generator) are one region in memory, more come tile by tile. Memory is the largest of the process while it grew (its programs and tables included).",
    );
    let params =
        setup(&experiment(&standard(8, 2)).map_err(Failure::failed)?).map_err(Failure::failed)?.retina;
    let mut table = Table::new(
        "retina-cost",
        "Cost of a mosaic",
        &[
            "generator",
            "cones",
            "half_side_um",
            "seconds",
            "wall_seconds",
            "us_per_cone",
            "peak_memory_MB",
            "bytes_per_cone",
        ],
    );
    let domain: &[f64] =
        task.pick(&[1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 2e6, f64::INFINITY], &[1e3, 1e4, 1e5]);
    let ring: &[f64] = task.pick(&[1e3, 3e3, 1e4, 3e4, 1e5, 3e5], &[1e3, 1e4]);
    let mut curves = Vec::new();
    for (name, generator, sizes) in [("domain", Generator::Domain, domain), ("ring", Generator::Ring, ring)] {
        let params = RetinaParams { generator, ..params.clone() };
        let mut curve = Vec::new();
        for wanted in sizes {
            let half = half_side_um(&params, *wanted);
            task.say(&format!("{name}: a square of {:.2} mm", half / 500.0));
            let made = Made::new(&params, half, *wanted)?;
            table.push(row![
                name,
                made.cones,
                half,
                made.seconds,
                made.wall_s,
                1e6 * made.seconds / made.cones,
                made.peak / 1e6,
                made.peak / made.cones
            ]);
            curve.push(made);
        }
        curves.push((name, curve));
    }
    page.picture(
        "retina-cost",
        "Cost against number of cones. A line of slope one is a constant cost a cone.",
        chart_page("What a mosaic costs", &charts(&curves), 3),
    );
    page.table(table);
    Ok(())
}

/// A mosaic that was made.
struct Made {
    cones: f64,
    seconds: f64,
    wall_s: f64,
    peak: f64,
}

impl Made {
    fn new(params: &RetinaParams, half: f64, wanted: f64) -> Result<Self, Failure> {
        let region = RegionUm { min: DVec2::splat(-half), max: DVec2::splat(half) };
        reset_peak();
        let (watch, wall) = (Stopwatch::start(), std::time::Instant::now());
        let mut cones = 0.0;
        if wanted <= WHOLE || params.generator == Generator::Ring {
            cones = build_region(params, &region).map_err(Failure::failed)?.len() as f64;
        } else {
            let count = |_: &RegionUm, cones: Cones| {
                let places = cones.x_um.iter().zip(&cones.y_um);
                places.filter(|(x, y)| region.contains(DVec2::new(**x, **y))).count() as f64
            };
            synthesize(params, &region, count, |part| cones += part).map_err(Failure::failed)?;
        }
        Ok(Self { cones, seconds: watch.seconds(), wall_s: wall.elapsed().as_secs_f64(), peak: peak_bytes() })
    }
}

fn charts(curves: &[(&str, Vec<Made>)]) -> Vec<Chart> {
    let series = |value: fn(&Made) -> f64| -> Vec<Series> {
        curves
            .iter()
            .zip(PALETTE)
            .map(|((name, made), colour)| {
                let points = made.iter().map(|m| (m.cones, value(m))).collect();
                Series::new(name, points, Style::Both, colour)
            })
            .collect()
    };
    let chart = |title: &str, y: &str, log: bool, value: fn(&Made) -> f64| Chart {
        title: title.into(),
        x: Axis::log("cones in the region"),
        y: if log { Axis::log(y) } else { Axis { least: Some((0.0, 1.0)), ..Axis::linear(y) } },
        series: series(value),
        bands: Vec::new(),
    };
    vec![
        chart("Time", kind(), true, |m| m.seconds),
        chart("Time a cone", "µs of CPU a cone", true, |m| 1e6 * m.seconds / m.cones),
        chart("Memory", "largest memory of the process, MB", true, |m| m.peak / 1e6),
    ]
}

/// Half the side of the square about the foveal centre that holds about so many cones; the whole retina for infinity.
fn half_side_um(params: &RetinaParams, cones: f64) -> f64 {
    const STEPS: u32 = 4000;
    const DIRECTIONS: u32 = 16;
    let density = Density::new(params);
    let edge = density.ora_um() * 1.07;
    let step = edge / f64::from(STEPS);
    let mut sum = 0.0;
    for k in 0..STEPS {
        let r = (f64::from(k) + 0.5) * step;
        let mean = (0..DIRECTIONS)
            .map(|d| DVec2::from_angle(std::f64::consts::TAU * f64::from(d) / f64::from(DIRECTIONS)) * r)
            .map(|at| density.per_mm2(at))
            .sum::<f64>()
            / f64::from(DIRECTIONS);
        sum += mean * 1e-6 * std::f64::consts::TAU * r * step;
        if sum >= cones {
            // The square of the disc's area.
            return r * std::f64::consts::PI.sqrt() / 2.0;
        }
    }
    edge
}
