//! `calibrate`: how fast this machine is, stage by stage, against the constants of the cost model; kept in the data folder, where servers
//! find it.

use photoneye_eye::plan::{Machine, Stages, plan};
use photoneye_server::MACHINE_FILE;
use serde_json::json;

use super::Context;
use super::study::scene::{Runner, experiment, standard, with};
use crate::cli_study::CalibrateArgs;
use crate::failure::Failure;
use crate::output;
use crate::progress::Progress;
use crate::result_folder::write_file;

/// Runs the command.
pub fn run(context: &Context, args: &CalibrateArgs) -> Result<(), Failure> {
    let data = context.settings.data(args.data.clone())?;
    let mut progress = Progress::new(context.json);
    let machine = measure(&mut |what| progress.say(what)).map_err(Failure::failed)?;
    progress.finish();
    let path = data.join(MACHINE_FILE);
    let text = serde_json::to_string_pretty(&machine).map_err(Failure::failed)?;
    write_file(&path, text.as_bytes())?;
    if context.json {
        return output::json(&json!({"path": path, "machine": machine}));
    }
    output::line(format_args!("Stages take, against the cost model's constants:"))?;
    for (stage, factor) in [
        ("mosaic", machine.mosaic),
        ("optics", machine.optics),
        ("preparation", machine.prepare),
        ("frames", machine.frames),
        ("audit", machine.audit),
    ] {
        output::line(format_args!("  {stage:<12} x {factor:.2}"))?;
    }
    output::line(format_args!("{}", path.display()))
}

/// The machine's factors, from a few small experiments.
///
/// # Errors
/// What the model refuses.
pub fn measure(say: &mut dyn FnMut(&str)) -> Result<Machine, String> {
    let line = json!([{"name": "white", "spectrum": {"line": {"nm": 543, "fwhm_nm": 0}}}]);
    // A moving eye: frames that repeat would not be computed again.
    let drift = json!({"drift": {"speed_arcmin_per_s": 30, "direction_deg": 30}});
    let frames = [("frames.count", json!(40)), ("accuracy.audit_cones", json!(4)), ("gaze.movement", drift)];
    let scenes = [
        ("white light", with(standard(16, 2), &frames)),
        ("one line", with(with(standard(30, 2), &frames), &[("display.primaries", line)])),
    ];
    let (mut foreseen, mut taken) = (Stages::default(), Stages::default());
    for (name, spec) in scenes {
        say(&format!("calibrate: {name}"));
        let experiment = experiment(&spec)?;
        foreseen.add(&plan(&experiment).map_err(|e| e.to_string())?.predicted_stages);
        taken.add(&Runner::default().run(&experiment, &[])?.stages);
    }
    Ok(Machine::measured(&foreseen, &taken))
}
