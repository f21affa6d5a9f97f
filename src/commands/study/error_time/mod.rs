//! `study error-vs-time`: relative error of the mean per cone (L1 over cones, against a converged run) against CPU seconds, for each
//! setting and engine and several scenes; and how the time grows with cones, pixels, frames, luminance and pupil.
//!
//! Time holds optics, preparation and frames; the mosaic is the same for all settings and told apart. The engine `paper` draws single
//! photons: its error holds chance, √(2m/π) a cone of mean m, which is told beside it.

mod scaling;
pub mod scenes;

use photoneye_eye::experiment::{Engine, Experiment, PaperSettings};
use photoneye_eye::plan::plan;
use photoneye_eye::video::{Limits, Picture, decode_png};

use super::Task;
use super::clock::kind;
use super::page::{Page, Table};
use super::scene::{Outcome, Runner, l1};
use crate::chart::{Axis, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::cli_study::StudyArgs;
use crate::experiment_file::ExperimentFile;
use crate::failure::Failure;
use crate::row;

/// A scene to be judged.
pub struct Scene {
    /// What it is called.
    pub name: String,
    /// The experiment.
    pub experiment: Experiment,
    /// Its pictures; none for a drawn pattern.
    pub pictures: Vec<Picture>,
}

/// One run of a scene.
struct Point {
    knob: &'static str,
    setting: String,
    seconds: [f64; 3],
    error: f64,
    /// What chance alone gives.
    chance: f64,
}

impl Point {
    fn total(&self) -> f64 {
        self.seconds.iter().sum()
    }
}

const TARGET: &str = "accuracy.target";
const STEP: &str = "wavelength_step_nm";
const PAPER: &str = "engine PAPER";

/// Fills the page.
pub fn study(task: &mut Task, args: &StudyArgs, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "Error against time",
        "Relative error of the mean per cone, L1 over cones, against a converged run of the same scene (target 4e-4, all \
         frequencies, wavelengths every 2.5 nm). Seconds are CPU time of optics, preparation and frames; the mosaic is shared by all settings.",
    );
    let scenes = match &args.spec {
        Some(path) => vec![read(path, &args.set)?],
        None if !args.set.is_empty() => return Err(Failure::usage("--set: allowed together with --spec")),
        None => scenes::all(task.quick).map_err(Failure::failed)?,
    };
    let mut all = Table::new(
        "error-vs-time",
        "Every run",
        &[
            "scene",
            "cones",
            "knob",
            "setting",
            "seconds",
            "seconds_optics",
            "seconds_prepare",
            "seconds_frames",
            "error",
            "error_by_chance",
            "on_pareto_front",
        ],
    )
    .long();
    let mut short = Table::new(
        "error-vs-time-short",
        &format!("Default setting (target 0.01) and the paper's, {}", kind()),
        &[
            "scene",
            "cones",
            "seconds",
            "error",
            "least seconds for 1e-3",
            "paper: seconds",
            "paper: error",
            "of that chance",
        ],
    );
    let mut charts = Vec::new();
    for scene in &scenes {
        let (points, cones) = judge(task, scene)?;
        record(scene, cones, &points, &mut all, &mut short);
        charts.push(chart(&scene.name, &points));
    }
    page.picture(
        "error-vs-time",
        "Each point a run. Broken line: the Pareto front, runs that no other run beats in both. Points of the engine PAPER hold the chance \
         of single photons; runs of it that would take minutes are left out.",
        chart_page("Error of the mean per cone against time", &charts, 3),
    );
    page.table(short);
    page.table(all);
    if args.spec.is_none() {
        scaling::study(task, page)?;
    }
    Ok(())
}

/// The user's experiment.
///
/// # Errors
/// What the file or the schema refuses.
pub fn read(path: &std::path::Path, changes: &[String]) -> Result<Scene, Failure> {
    let mut file = ExperimentFile::read(path, changes)?;
    let bytes = file.keep();
    let pictures: Result<Vec<Picture>, _> = bytes.iter().map(|b| decode_png(b, Limits::default())).collect();
    let experiment = photoneye_server::spec::experiment(&file.experiment).map_err(Failure::usage)?;
    Ok(Scene { name: file.stem, experiment, pictures: pictures.map_err(Failure::usage)? })
}

/// All runs of a scene, and its number of cones.
fn judge(task: &mut Task, scene: &Scene) -> Result<(Vec<Point>, usize), Failure> {
    let mut runner = Runner::default();
    let expected = |target: f64, step: Option<f64>| {
        let mut e = scene.experiment.clone();
        (e.counts.engine, e.counts.poisson) = (Engine::Expected, false);
        (e.accuracy_target, e.counts.wavelength_step_nm) = (target, step);
        e
    };
    let mut run = |experiment: &Experiment| runner.run(experiment, &scene.pictures).map_err(Failure::usage);
    task.say(&format!("{}: converged run", scene.name));
    let reference = run(&expected(4e-4, Some(task.pick(2.5, 5.0))))?;
    task.say(&format!("{}: {} cones, settings", scene.name, reference.counts.len()));
    let mut points = Vec::new();
    let mut add = |knob, setting: String, outcome: &Outcome| -> Result<(), Failure> {
        let error = l1(&outcome.counts, &reference.counts).ok_or_else(|| {
            Failure::failed(format!("{}: dark, or other cones at another setting", scene.name))
        })?;
        let total: f64 = reference.counts.iter().sum();
        let chance =
            reference.counts.iter().map(|m| (m * std::f64::consts::FRAC_2_PI).sqrt()).sum::<f64>() / total;
        let chance = if knob == PAPER { chance } else { 0.0 };
        let seconds = [outcome.stages.optics, outcome.stages.prepare, outcome.stages.frames];
        points.push(Point { knob, setting, seconds, error, chance });
        Ok(())
    };
    let targets: &[f64] = task.pick(&[0.2, 0.05, 0.01, 0.005, 0.002, 0.001], &[0.1, 0.01, 0.001]);
    for target in targets {
        add(TARGET, target.to_string(), &run(&expected(*target, None))?)?;
    }
    let steps: &[f64] = task.pick(&[20.0, 10.0, 7.5, 5.0], &[20.0, 10.0]);
    for step in steps {
        add(STEP, step.to_string(), &run(&expected(0.001, Some(*step)))?)?;
    }
    let papers = PaperSettings::default();
    let variants = [
        ("paper's own", papers),
        ("256 rays", PaperSettings { rays: 256, ..papers }),
        ("4,096 rays", PaperSettings { rays: 4096, ..papers }),
        ("40 µm window", PaperSettings { window_um: 40.0, ..papers }),
        ("100 µm nodes", PaperSettings { node_um: 100.0, ..papers }),
    ];
    for (setting, paper) in variants.into_iter().take(task.pick(5, 1)) {
        let mut e = scene.experiment.clone();
        (e.counts.engine, e.counts.poisson, e.counts.paper) = (Engine::Paper, true, paper);
        // Photon by photon a bright scene takes hours.
        let predicted = plan(&e).map_err(Failure::usage)?.predicted_seconds;
        if predicted < 30.0 {
            add(PAPER, setting.to_owned(), &run(&e)?)?;
        } else {
            task.say(&format!("{}: engine PAPER left out, it would take {predicted:.0} s", scene.name));
        }
    }
    Ok((points, reference.counts.len()))
}

/// Whether no other run is both faster and better.
fn on_front(points: &[Point], k: usize) -> bool {
    let beats = |a: &Point, b: &Point| a.total() < b.total() && a.error <= b.error;
    points[k].error.is_finite() && !points.iter().any(|other| beats(other, &points[k]))
}

fn record(scene: &Scene, cones: usize, points: &[Point], all: &mut Table, short: &mut Table) {
    for (k, p) in points.iter().enumerate() {
        let [optics, prepare, frames] = p.seconds;
        let front = if on_front(points, k) { "yes" } else { "no" };
        all.push(row![
            scene.name.clone(),
            cones,
            p.knob,
            p.setting.clone(),
            p.total(),
            optics,
            prepare,
            frames,
            p.error,
            p.chance,
            front
        ]);
    }
    let of = |knob: &str, setting: &str| points.iter().find(|p| p.knob == knob && p.setting == setting);
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let default = of(TARGET, "0.01");
    let good = points.iter().filter(|p| p.error < 1e-3).map(Point::total).reduce(f64::min);
    let paper = of(PAPER, "paper's own");
    short.push(row![
        scene.name.clone(),
        cones,
        number(default.map(Point::total)),
        number(default.map(|p| p.error)),
        number(good),
        number(paper.map(Point::total)),
        number(paper.map(|p| p.error)),
        number(paper.map(|p| p.chance))
    ]);
}

fn chart(name: &str, points: &[Point]) -> Chart {
    let of = |knob: &str| points.iter().filter(|p| p.knob == knob).map(|p| (p.total(), p.error)).collect();
    let mut front: Vec<(f64, f64)> = (0..points.len())
        .filter(|k| on_front(points, *k))
        .map(|k| (points[k].total(), points[k].error))
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut series = vec![
        Series::new("Pareto front", front, Style::Dashed, DARK),
        Series::new("accuracy target", of(TARGET), Style::Points, PALETTE[0]),
        Series::new("wavelength step", of(STEP), Style::Points, PALETTE[1]),
        Series::new("engine PAPER", of(PAPER), Style::Points, PALETTE[3]),
    ];
    series.retain(|s| !s.points.is_empty());
    Chart {
        title: name.into(),
        x: Axis::log(kind()),
        y: Axis::log("relative error, L1 over cones"),
        series,
        bands: Vec::new(),
    }
}
