//! `study prediction`: what the plan foresees against what it takes, after this machine's calibration: CPU seconds by stage, memory, and the
//! error estimate against the audit, for the example experiments and the built-in scenes.

use std::path::Path;

use photoneye_eye::exposure::audit::verdict;
use photoneye_eye::plan::{Machine, Stages, plan_on};

use super::Task;
use super::clock::{Stopwatch, kind, peak_bytes, reset_peak};
use super::error_time::{Scene, read, scenes};
use super::page::{Page, Table};
use super::scene::Runner;
use crate::cli_study::StudyArgs;
use crate::commands::calibrate::measure;
use crate::failure::Failure;
use crate::row;

/// Where the examples are, from the root of the repository.
const EXAMPLES: &str = "data/experiments";
/// Cones that are computed again in each scene.
const AUDITED: [u32; 2] = [24, 4];

/// One scene's ratios.
struct Ratios {
    seconds: f64,
    memory: f64,
    estimate: f64,
    kept: bool,
}

/// Fills the page.
pub fn study(task: &mut Task, args: &StudyArgs, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "Foreseen and found",
        "Each scene is planned with the factors of this machine, then run without cached artifacts. The audit computes cones again by a direct \
         sum; its error is relative, L1 over cones.",
    );
    let machine = measure(&mut |what| task.say(what)).map_err(Failure::failed)?;
    page.text(&format!("Factors of this machine: {machine:?}"));
    let columns = [
        "scene",
        "cones",
        "planned in s",
        "predicted s",
        "took s",
        "ratio",
        "predicted MB",
        "peak MB",
        "memory ratio",
        "target",
        "estimate",
        "audit",
        "bound 95 %",
        "estimate / audit",
    ];
    let mut table = Table::new("prediction", &format!("Foreseen and found, {}", kind()), &columns);
    let mut stages = Table::new(
        "prediction-stages",
        "By stage: predicted / took",
        &["scene", "mosaic", "optics", "preparation", "frames", "audit"],
    );
    let mut all = Vec::new();
    for scene in scenes_of(args, task.quick)? {
        task.say(&scene.name);
        all.push(judge(task, &machine, scene, (&mut table, &mut stages))?);
    }
    let within =
        |of: &dyn Fn(&Ratios) -> bool| 100.0 * all.iter().filter(|r| of(r)).count() as f64 / all.len() as f64;
    let factor = |ratio: f64, most: f64| ratio <= most && ratio >= 1.0 / most;
    page.text(&format!(
        "Seconds within a factor of 2: {:.0} %. Memory within 1.5: {:.0} %. Audit below the target: {:.0} %. Estimate at most 5 times the audit: \
         {:.0} %, not below half of it: {:.0} %.",
        within(&|r| factor(r.seconds, 2.0)),
        within(&|r| factor(r.memory, 1.5)),
        within(&|r| r.kept),
        within(&|r| r.estimate <= 5.0),
        within(&|r| r.estimate >= 0.5),
    ));
    page.table(table);
    page.table(stages);
    Ok(())
}

fn judge(
    task: &Task,
    machine: &Machine,
    mut scene: Scene,
    (table, by_stage): (&mut Table, &mut Table),
) -> Result<Ratios, Failure> {
    scene.experiment.audit_cones = AUDITED[usize::from(task.quick)];
    let watch = Stopwatch::start();
    let plan = plan_on(&scene.experiment, machine).map_err(Failure::usage)?;
    let planned_s = watch.seconds();
    reset_peak();
    let outcome = Runner::default().run(&scene.experiment, &scene.pictures).map_err(Failure::usage)?;
    let (peak, took) = (peak_bytes(), outcome.stages.total());
    let found = verdict(&outcome.audit, plan.engine != "EXPECTED").unwrap_or_default();
    let estimate: f64 = plan.error_estimate.iter().map(|p| p.relative).sum();
    let (error, target) = (found.relative_error, scene.experiment.accuracy_target);
    table.push(row![
        scene.name.clone(),
        outcome.counts.len(),
        planned_s,
        plan.predicted_seconds,
        took,
        plan.predicted_seconds / took,
        plan.predicted_bytes / 1e6,
        peak / 1e6,
        plan.predicted_bytes / peak,
        target,
        estimate,
        error,
        found.bound_95.unwrap_or(f64::NAN),
        estimate / error
    ]);
    let ratio =
        |of: fn(&Stages) -> f64| format!("{:.3} / {:.3}", of(&plan.predicted_stages), of(&outcome.stages));
    by_stage.push(row![
        scene.name,
        ratio(|s| s.mosaic),
        ratio(|s| s.optics),
        ratio(|s| s.prepare),
        ratio(|s| s.frames),
        ratio(|s| s.audit)
    ]);
    Ok(Ratios {
        seconds: plan.predicted_seconds / took,
        memory: plan.predicted_bytes / peak,
        estimate: estimate / error,
        kept: error - found.by_chance <= target,
    })
}

/// The examples, when they are here, and the built-in scenes; or the user's own.
fn scenes_of(args: &StudyArgs, quick: bool) -> Result<Vec<Scene>, Failure> {
    if let Some(path) = &args.spec {
        return Ok(vec![read(path, &args.set)?]);
    }
    let mut paths: Vec<_> = std::fs::read_dir(Path::new(EXAMPLES))
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "json"))
        .collect();
    paths.sort();
    let mut list: Vec<Scene> = paths.iter().map(|path| read(path, &[])).collect::<Result<_, _>>()?;
    list.extend(scenes::all(quick).map_err(Failure::failed)?);
    Ok(list)
}
