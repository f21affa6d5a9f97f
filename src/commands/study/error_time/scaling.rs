//! How CPU seconds grow with cones, pixels, frames, luminance and pupil, at the default accuracy.

use photoneye_eye::experiment::Engine;
use photoneye_eye::plan::plan;
use serde_json::{Value, json};

use super::super::Task;
use super::super::clock::kind;
use super::super::page::{Page, Table};
use super::super::scene::{Runner, experiment, standard, with};
use crate::chart::{Axis, Chart, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// A quantity that is changed.
struct Quantity {
    name: &'static str,
    axis: &'static str,
    /// Number on the axis (0: the number of cones) and the experiment.
    runs: Vec<(f64, Value)>,
}

/// Adds charts and tables.
pub fn study(task: &mut Task, page: &mut Page) -> Result<(), Failure> {
    page.heading("How time grows");
    let mut table = Table::new(
        "scaling",
        "CPU seconds by stage",
        &["quantity", "value", "engine", "cones", "mosaic", "optics", "preparation", "frames"],
    )
    .long();
    let mut charts = Vec::new();
    for quantity in quantities(task) {
        task.say(&format!("growth with {}", quantity.name));
        let mut curves = vec![Vec::new(); 5];
        // The mosaic is the same but where its own time is asked for.
        let mut runner = Runner::default();
        for (value, spec) in &quantity.runs {
            let mut e = experiment(spec).map_err(Failure::failed)?;
            for engine in [Engine::Expected, Engine::Paper, Engine::Events] {
                e.counts.engine = engine;
                e.counts.poisson = true;
                e.audit_cones = 0;
                if engine != Engine::Expected
                    && plan(&e).map_err(Failure::failed)?.predicted_seconds > task.pick(30.0, 3.0)
                {
                    continue;
                }
                if quantity.name == "cones" && engine == Engine::Expected {
                    runner = Runner::default();
                }
                let o = runner.run(&e, &[]).map_err(Failure::failed)?;
                let cones = o.counts.len();
                let x = if *value > 0.0 { *value } else { cones as f64 };
                let name = match engine {
                    Engine::Paper => "PAPER",
                    Engine::Events => "EVENTS",
                    Engine::Expected => "EXPECTED",
                };
                table.push(row![
                    quantity.name,
                    x,
                    name,
                    cones,
                    o.stages.mosaic,
                    o.stages.optics,
                    o.stages.prepare,
                    o.stages.frames
                ]);
                if engine == Engine::Expected {
                    if o.stages.mosaic > 0.0 {
                        curves[0].push((x, o.stages.mosaic));
                    }
                    curves[1].push((x, o.stages.optics + o.stages.prepare));
                    curves[2].push((x, o.stages.frames));
                } else {
                    curves[if engine == Engine::Paper { 3 } else { 4 }].push((x, o.stages.frames));
                }
            }
        }
        charts.push(chart(&quantity, curves));
    }
    page.picture(
        "scaling",
        "CPU seconds by stage at the default accuracy; a mosaic that was there already costs nothing; a checkerboard on a projector of 250 cd/m², 3 mm, one frame, where that is not what \
         changes.",
        chart_page("How time grows", &charts, 3),
    );
    page.table(table);
    Ok(())
}

/// One panel: seconds of each stage.
fn chart(quantity: &Quantity, curves: Vec<Vec<(f64, f64)>>) -> Chart {
    let names = ["mosaic", "optics, preparation", "frames", "frames, engine PAPER", "frames, engine EVENTS"];
    Chart {
        title: format!("Growth with {}", quantity.name),
        x: Axis::log(quantity.axis),
        y: Axis::log(kind()),
        series: curves
            .into_iter()
            .enumerate()
            .filter(|(_, points)| !points.is_empty())
            .map(|(k, points)| Series::new(names[k], points, Style::Both, PALETTE[k]))
            .collect(),
        bands: Vec::new(),
    }
}

fn quantities(task: &Task) -> Vec<Quantity> {
    let square = |half: f64| json!({"x_min": -half, "x_max": half, "y_min": -half, "y_max": half});
    let base = || with(standard(12, 2), &[("retina.region_deg", square(0.1))]);
    let runs = |values: &[f64], spec: &dyn Fn(f64) -> Value| {
        let few = if task.quick { 2 } else { values.len() };
        values.iter().take(few).map(|v| (*v, spec(*v))).collect::<Vec<_>>()
    };
    let mut cones = runs(&[0.05, 0.1, 0.2, 0.4, 0.8, 1.6], &|half| {
        with(standard(12, 2), &[("retina.region_deg", square(half))])
    });
    for run in &mut cones {
        run.0 = 0.0;
    }
    vec![
        Quantity { name: "cones", axis: "cones", runs: cones },
        Quantity {
            name: "pixels",
            axis: "pixels of the display (the same field)",
            runs: runs(&[64.0, 256.0, 1024.0, 4096.0, 16384.0, 65536.0], &|pixels| {
                let side = pixels.sqrt();
                let spec = with(standard(side as u32, 2), &[("retina.region_deg", square(0.1))]);
                with(spec, &[("display.pixel_pitch_cm", json!(0.58 * 12.0 / side))])
            }),
        },
        Quantity {
            name: "frames",
            axis: "frames",
            runs: runs(&[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0], &|n| {
                with(base(), &[("frames.count", json!(n as u32))])
            }),
        },
        Quantity {
            name: "luminance",
            axis: "luminance of white, cd/m²",
            runs: runs(&[0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e6], &|l| {
                with(base(), &[("display.white_luminance_cd_m2", json!(l))])
            }),
        },
        Quantity {
            name: "pupil",
            axis: "entrance pupil, mm",
            runs: runs(&[1.0, 2.0, 3.0, 4.0, 6.0, 8.0], &|mm| with(base(), &[("eye.pupil_mm", json!(mm))])),
        },
    ]
}
