//! `plan`: what would be computed, what is left out and why, and what it costs.

use std::collections::BTreeMap;

use photoneye_proto::v1;

use super::Context;
use crate::cli::PlanArgs;
use crate::experiment_file::ExperimentFile;
use crate::failure::Failure;
use crate::service::Service;
use crate::{output, summary};

/// Runs the command.
pub async fn run(context: Context, args: PlanArgs) -> Result<(), Failure> {
    let mut experiment = ExperimentFile::read(&args.spec.spec, &args.spec.set)?;
    let mut place = args.place;
    // Nothing is computed.
    place.workers = Some(0);
    let service = Service::open(&context.settings, place).await?;
    let reply = ask(&service, &mut experiment).await;
    service.close(false).await;
    let reply = reply?;
    let plan = reply.plan.clone().unwrap_or_default();
    for warning in &plan.warnings {
        output::note(format_args!("warning: {warning}"));
    }
    if context.json {
        return output::json(&as_json(&plan, reply.experiment_json())?);
    }
    for line in explain(&plan) {
        output::line(format_args!("{line}"))?;
    }
    Ok(())
}

async fn ask(service: &Service, experiment: &mut ExperimentFile) -> Result<v1::PlanReply, Failure> {
    experiment.upload(&service.client).await?;
    let reply = service.client.plan(experiment.experiment.clone()).await;
    reply.map_err(|error| experiment.name_pictures(error.into()))
}

/// The plan's own fields, and the experiment with every default filled in.
fn as_json(plan: &v1::Plan, experiment_json: &str) -> Result<serde_json::Value, Failure> {
    let mut value = serde_json::to_value(plan).map_err(Failure::failed)?;
    let experiment = serde_json::from_str(experiment_json).map_err(Failure::failed)?;
    if let Some(fields) = value.as_object_mut() {
        fields.insert("experiment".into(), experiment);
        // An empty list is a fact too.
        fields.entry("omissions").or_insert_with(|| serde_json::json!([]));
    }
    Ok(value)
}

fn explain(plan: &v1::Plan) -> Vec<String> {
    let mut lines = vec![
        format!("Engine        {}: {}", plan.engine(), plan.engine_reason()),
        format!("Frames        {} in {} tile(s)", plan.frames(), plan.tiles()),
        format!("Cones         about {}", summary::number(plan.predicted_cones())),
    ];
    lines.extend(plan.display.as_ref().map(screen));
    lines.extend(plan.focus.as_ref().map(focus));
    if let [x0, x1, y0, y1] = plan.region_um[..] {
        lines.push(format!("Patch         {:.0} x {:.0} µm of retina", x1 - x0, y1 - y0));
    }
    if let (Some(first), Some(last)) = (plan.wavelengths_nm.first(), plan.wavelengths_nm.last()) {
        lines.push(format!(
            "Optics        {} wavelengths from {first:.0} to {last:.0} nm at {} point(s) of the field, grid {} x {}",
            plan.wavelengths_nm.len(),
            plan.field_nodes(),
            plan.grid_width(),
            plan.grid_height()
        ));
    }
    lines.extend(builds(plan));
    for omission in &plan.omissions {
        lines.push(format!(
            "Left out      {}: {} (error at most {:.1e})",
            omission.what(),
            omission.why(),
            omission.bound()
        ));
    }
    lines.push(format!(
        "Cost          about {:.1} s of computing, {:.0} MB of memory",
        plan.predicted_seconds(),
        plan.predicted_bytes() / 1e6
    ));
    lines
}

/// Where the display is seen.
fn screen(seen: &v1::DisplaySeen) -> String {
    let corner = |corner: &[f64]| match corner {
        [x, y] => format!("({x:.1}, {y:.1})"),
        _ => String::new(),
    };
    let corners: Vec<String> = seen.corners_deg.chunks(2).map(corner).collect();
    let [across, down] = seen.px_per_deg[..] else { return String::new() };
    let [least, most] = seen.px_per_deg_at_edges[..] else { return String::new() };
    format!(
        "Screen        fixated {:.1} cm away, the eye turned by {:.1}°; corners at {}°; {across:.1} x {down:.1} \
         pixels per degree at the gaze, {least:.1} to {most:.1} at the edges",
        seen.fixated_cm(),
        seen.turned_deg(),
        corners.join(" "),
    )
}

/// How the eye is focused.
fn focus(focus: &v1::EyeFocus) -> String {
    format!(
        "Focus         object at {:.2} D, far point of the eye {:.2} D, accommodation {:.2} D, {:.2} D out of focus",
        focus.wanted_d(),
        focus.far_point_d(),
        focus.accommodation_d(),
        focus.residual_d().abs(),
    )
}

/// One line a kind of artifact.
fn builds(plan: &v1::Plan) -> Vec<String> {
    let mut kinds: BTreeMap<&str, (u32, u32, f64)> = BTreeMap::new();
    for artifact in &plan.artifacts {
        let (there, needed, seconds) = kinds.entry(artifact.kind()).or_default();
        *there += u32::from(artifact.cached());
        *needed += 1;
        *seconds += if artifact.cached() { 0.0 } else { artifact.predicted_seconds() };
    }
    let line = |(kind, (there, needed, seconds)): (&str, (u32, u32, f64))| {
        format!("Build         {needed} x {kind}, {there} there already, about {seconds:.2} s")
    };
    kinds.into_iter().map(line).collect()
}
