//! `study error-vs-time`: relative error of the mean per cone (L1 over cones, against a converged run) against CPU seconds, for each
//! setting and engine and several scenes; and how the time grows with cones, pixels, frames, luminance and pupil.
//!
//! Time holds optics, preparation and frames; the mosaic is the same for all settings and told apart. The engine `paper` draws single
//! photons: its error holds chance, √(2m/π) a cone of mean m, which is told beside it.

mod scaling;
pub mod scenes;

use photoneye_eye::experiment::{Engine, Experiment, PaperSettings};
use photoneye_eye::plan::{Knobs, plan};
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
const EVENTS: &str = "engine EVENTS";
/// An engine that would take longer than so many seconds in a run is left out; the paper's own settings, the anchor, may take longer.
const PATIENCE_S: [f64; 2] = [60.0, 30.0];
const ANCHOR_PATIENCE_S: f64 = 240.0;

/// A knob of the engine EXPECTED: its values, fine last, and how one is set.
type Knob = (&'static str, &'static [f64], fn(&mut Knobs, f64));

/// Turned one by one at the default target.
const KNOBS: [Knob; 7] = [
    ("basis_tolerance", &[1e-2, 1e-3, 3e-4, 3e-5], |k, v| k.basis_tolerance = Some(v)),
    ("band_loss", &[1e-2, 1e-3, 5e-5], |k, v| k.band_loss = Some(v)),
    ("guard_um", &[75.0, 150.0, 600.0], |k, v| k.guard_um = Some(v)),
    ("spread_width", &[3.0, 6.0, 8.0], |k, v| k.spread_width = Some(v as u32)),
    ("oversampling", &[1.12, 1.4], |k, v| k.oversampling = Some(v)),
    ("field_nodes", &[1.0, 2.0, 4.0], |k, v| k.field_nodes = Some(v as u32)),
    ("ecc_nodes", &[1.0, 2.0, 4.0], |k, v| k.ecc_nodes = Some(v as u32)),
];

/// Fills the page.
pub fn study(task: &mut Task, args: &StudyArgs, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "Error against time",
        "Relative error of the mean per cone, L1 over cones, against a converged run of the same scene: every setting finer than any that is \
         judged (basis 1e-6, band loss 2e-5, copies 1.2 mm away, wavelengths every 5 nm, double precision). Seconds are CPU time of optics, \
         preparation and frames; the mosaic is shared by all settings.",
    );
    let scenes = match &args.spec {
        Some(path) => vec![read(path, &args.set)?],
        None if !args.set.is_empty() => return Err(Failure::usage("--set: allowed together with --spec")),
        None => chosen(scenes::all(task.quick).map_err(Failure::failed)?, &args.scene)?,
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
        &format!("Default setting (target 0.001) and the paper's, {}", kind()),
        &[
            "scene",
            "cones",
            "seconds",
            "error",
            "least seconds for 1e-3",
            "paper: seconds",
            "paper: error",
            "of that chance",
            "times faster at the paper's error",
            "times more exact at its time",
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
    if args.spec.is_none() && args.scene.is_empty() {
        scaling::study(task, page)?;
    }
    Ok(())
}

/// The scenes with one of `names` in theirs; all when there are none.
fn chosen(all: Vec<Scene>, names: &[String]) -> Result<Vec<Scene>, Failure> {
    let is_in = |scene: &Scene, name: &String| scene.name.to_lowercase().contains(&name.to_lowercase());
    if let Some(name) = names.iter().find(|name| !all.iter().any(|scene| is_in(scene, name))) {
        let known: Vec<&str> = all.iter().map(|scene| scene.name.as_str()).collect();
        return Err(Failure::usage(format!("--scene {name}: none of {}", known.join("; "))));
    }
    let wanted = |scene: &Scene| names.is_empty() || names.iter().any(|name| is_in(scene, name));
    Ok(all.into_iter().filter(wanted).collect())
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

/// The runs of a scene.
struct Judge<'a> {
    scene: &'a Scene,
    runner: Runner,
    reference: Vec<f64>,
    points: Vec<Point>,
}

impl Judge<'_> {
    fn run(&mut self, experiment: &Experiment) -> Result<Outcome, Failure> {
        self.runner.run(experiment, &self.scene.pictures).map_err(Failure::usage)
    }

    /// Means at a target.
    fn expected(&self, target: f64, step: Option<f64>) -> Experiment {
        let mut e = self.scene.experiment.clone();
        (e.counts.engine, e.counts.poisson) = (Engine::Expected, false);
        (e.accuracy_target, e.counts.wavelength_step_nm, e.audit_cones) = (target, step, 0);
        e
    }

    fn add(&mut self, knob: &'static str, setting: String, outcome: &Outcome) -> Result<(), Failure> {
        let error = l1(&outcome.counts, &self.reference).ok_or_else(|| {
            Failure::failed(format!("{}: dark, or other cones at another setting", self.scene.name))
        })?;
        let total: f64 = self.reference.iter().sum();
        let one = |m: &f64| (m * std::f64::consts::FRAC_2_PI).sqrt();
        let drawn = knob == PAPER || knob == EVENTS;
        let chance = if drawn { self.reference.iter().map(one).sum::<f64>() / total } else { 0.0 };
        let seconds = [outcome.stages.optics, outcome.stages.prepare, outcome.stages.frames];
        self.points.push(Point { knob, setting, seconds, error, chance });
        Ok(())
    }

    /// Targets, wavelength steps and knobs of `EXPECTED`.
    fn settings(&mut self, task: &mut Task) -> Result<(), Failure> {
        let targets: &[f64] = task.pick(&[0.2, 0.05, 0.01, 0.005, 0.002, 0.001], &[0.1, 0.01, 0.001]);
        for target in targets {
            match self.run(&self.expected(*target, None)) {
                Ok(outcome) => self.add(TARGET, target.to_string(), &outcome)?,
                Err(why) => task.say(&format!("{}: target {target} left out: {why}", self.scene.name)),
            }
        }
        let steps: &[f64] = task.pick(&[20.0, 10.0, 7.5, 5.0], &[20.0, 10.0]);
        for step in steps {
            let outcome = self.run(&self.expected(0.001, Some(*step)))?;
            self.add(STEP, step.to_string(), &outcome)?;
        }
        for (name, values, set) in KNOBS.into_iter().take(task.pick(KNOBS.len(), 2)) {
            for value in values {
                let mut e = self.expected(0.001, None);
                set(&mut e.counts.knobs, *value);
                let outcome = self.run(&e)?;
                self.add(name, value.to_string(), &outcome)?;
            }
        }
        Ok(())
    }

    /// An engine that draws photons, when it does not take too long.
    fn drawn(
        &mut self,
        task: &mut Task,
        (setting, patience_s): (&str, f64),
        change: impl Fn(&mut Experiment),
    ) -> Result<(), Failure> {
        let mut e = self.scene.experiment.clone();
        (e.counts.poisson, e.audit_cones) = (true, 0);
        change(&mut e);
        let knob = if e.counts.engine == Engine::Paper { PAPER } else { EVENTS };
        let predicted = plan(&e).map_err(Failure::usage)?.predicted_seconds;
        if predicted > patience_s {
            task.say(&format!("{}: {knob} left out, it would take {predicted:.0} s", self.scene.name));
            return Ok(());
        }
        let outcome = self.run(&e)?;
        self.add(knob, setting.to_owned(), &outcome)
    }
}

/// The settings of a converged run.
fn finest(task: &Task) -> Knobs {
    Knobs {
        basis_tolerance: Some(task.pick(1e-6, 1e-5)),
        band_loss: Some(task.pick(2e-5, 1e-4)),
        guard_um: Some(task.pick(1200.0, 600.0)),
        spread_width: Some(10),
        oversampling: Some(1.5),
        field_nodes: Some(4),
        ecc_nodes: Some(4),
        double_precision: Some(true),
    }
}

/// All runs of a scene, and its number of cones.
fn judge(task: &mut Task, scene: &Scene) -> Result<(Vec<Point>, usize), Failure> {
    let mut judge = Judge { scene, runner: Runner::default(), reference: Vec::new(), points: Vec::new() };
    task.say(&format!("{}: converged run", scene.name));
    let mut converged = judge.expected(0.001, Some(task.pick(5.0, 10.0)));
    converged.counts.knobs = finest(task);
    judge.reference = judge.run(&converged)?.counts;
    task.say(&format!("{}: {} cones, settings", scene.name, judge.reference.len()));
    judge.settings(task)?;
    if scene.experiment.eye.stray_light.is_none() {
        let patience_s = task.pick(PATIENCE_S[0], PATIENCE_S[1]);
        let anchor_s = task.pick(ANCHOR_PATIENCE_S, PATIENCE_S[1]);
        judge.drawn(task, ("photon by photon", patience_s), |e| e.counts.engine = Engine::Events)?;
        let papers = PaperSettings::default();
        let variants = [
            ("paper's own", papers),
            ("256 rays", PaperSettings { rays: 256, ..papers }),
            ("4,096 rays", PaperSettings { rays: 4096, ..papers }),
            ("40 µm window", PaperSettings { window_um: 40.0, ..papers }),
            ("100 µm nodes", PaperSettings { node_um: 100.0, ..papers }),
        ];
        for (i, (setting, paper)) in variants.into_iter().take(task.pick(5, 1)).enumerate() {
            let patience_s = if i == 0 { anchor_s } else { patience_s };
            judge.drawn(task, (setting, patience_s), |e| {
                (e.counts.engine, e.counts.paper) = (Engine::Paper, paper);
            })?;
        }
    }
    Ok((judge.points, judge.reference.len()))
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
    let default = of(TARGET, "0.001");
    let good = points.iter().filter(|p| p.error < 1e-3).map(Point::total).reduce(f64::min);
    let paper = of(PAPER, "paper's own");
    let [faster, better] = paper.map_or([f64::NAN; 2], |paper| against(points, paper));
    short.push(row![
        scene.name.clone(),
        cones,
        number(default.map(Point::total)),
        number(default.map(|p| p.error)),
        number(good),
        number(paper.map(Point::total)),
        number(paper.map(|p| p.error)),
        number(paper.map(|p| p.chance)),
        faster,
        better
    ]);
}

/// How many times faster than the paper's own settings `EXPECTED` has at most the error that is not chance in them, and how many times more
/// exact it is in at most their time.
fn against(points: &[Point], paper: &Point) -> [f64; 2] {
    let ours = || points.iter().filter(|p| p.knob != PAPER && p.knob != EVENTS);
    // Chance and error add in squares.
    let own = (paper.error.powi(2) - paper.chance.powi(2)).max(0.0).sqrt();
    let fastest = ours().filter(|p| p.error <= own).map(Point::total).fold(f64::INFINITY, f64::min);
    let best = ours().filter(|p| p.total() <= paper.total()).map(|p| p.error).fold(f64::INFINITY, f64::min);
    [paper.total() / fastest, own / best]
}

fn chart(name: &str, points: &[Point]) -> Chart {
    let of = |knob: &str| -> Vec<(f64, f64)> {
        points.iter().filter(|p| p.knob == knob).map(|p| (p.total(), p.error)).collect()
    };
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
        Series::new("engine EVENTS", of(EVENTS), Style::Points, PALETTE[4]),
        Series::new(
            "other knobs",
            KNOBS.iter().flat_map(|knob| of(knob.0)).collect(),
            Style::Points,
            PALETTE[2],
        ),
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
