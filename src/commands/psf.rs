//! `psf`: one point spread of the eye as an array.

use std::time::Instant;

use photoneye_eye::optics::{EyeState, Object, SchematicEye};
use photoneye_eye::psf::{
    Amplitude, HuygensOptions, PsfGrid, PupilSampling, Wavefront, WavefrontOptions, huygens, psf, sampled,
    sampled_fft,
};
use photoneye_store::npy;
use serde_json::json;

use super::Context;
use super::eyes::asked_for;
use crate::cli_optics::{AmplitudeName, MethodName, PsfArgs};
use crate::failure::Failure;
use crate::output;
use crate::result_folder::write_file;

/// Runs the command.
pub fn run(context: &Context, args: &PsfArgs) -> Result<(), Failure> {
    if !(args.half_width_um > 0.0 && args.half_width_um <= 5000.0) {
        return Err(Failure::usage("--half-width-um: allowed is more than 0 and at most 5000"));
    }
    if !(365.0..=1014.0).contains(&args.wavelength_nm) {
        return Err(Failure::usage("--wavelength-nm: allowed are 365 to 1014"));
    }
    let (prescription, state) = asked_for(&args.eye)?;
    let state = EyeState { pupil_mm: args.pupil_mm, accommodation_a: args.accommodation_a, ..state };
    let eye = SchematicEye::new(&prescription, &state).map_err(Failure::usage)?;
    let (field_deg, wavelength_nm) = snapped(args, prescription.fovea_angle_deg)?;
    let object = Object::field(field_deg, args.object_vergence_d).map_err(Failure::usage)?;
    let grid = PsfGrid::new(args.samples as usize, args.half_width_um);
    let options = WavefrontOptions {
        amplitude: match args.amplitude {
            AmplitudeName::Flux => Amplitude::Flux,
            AmplitudeName::Uniform => Amplitude::Uniform,
        },
        ..WavefrontOptions::default()
    };

    // Compute, as often as asked.
    let wavefront = Wavefront::new(&eye, object, wavelength_nm, &options).map_err(Failure::usage)?;
    let started = Instant::now();
    let mut values = Vec::new();
    for _ in 0..args.repeat {
        let sampled = |sampling: PupilSampling| {
            let points = sampling.points(args.rays as usize, args.seed);
            sampled::psf(&eye, object, wavelength_nm, &options, &points, &grid).map_err(Failure::usage)
        };
        let fresh = || Wavefront::new(&eye, object, wavelength_nm, &options).map_err(Failure::usage);
        values = match args.method {
            MethodName::Fit => psf(&fresh()?, &grid),
            MethodName::Huygens => huygens::psf(&eye, object, wavelength_nm, &options, &nodes(args), &grid)
                .map_err(Failure::usage)?,
            MethodName::Random => sampled(PupilSampling::Random)?,
            MethodName::Stratified => sampled(PupilSampling::Stratified)?,
            MethodName::Grid => sampled(PupilSampling::Grid)?,
            MethodName::Gauss => sampled(PupilSampling::Gauss)?,
            // So many samples across give about that many inside the round pupil.
            MethodName::Fft => {
                let across = (f64::from(args.rays) * 4.0 / std::f64::consts::PI).sqrt();
                sampled_fft::psf(&fresh()?, &grid, across as usize, sampled_fft::Edge::Staircase)
            }
        };
    }
    if args.whole_window {
        let sum = values.iter().sum::<f64>() * wavefront.density_per_um2() * grid.pitch_um().powi(2);
        for value in &mut values {
            *value /= sum.max(f64::MIN_POSITIVE);
        }
    }
    let seconds = started.elapsed().as_secs_f64() / f64::from(args.repeat);

    let side = args.samples as usize;
    write_file(&args.out, &npy::f64_array(&[side, side], &values))?;
    tell(context, args, &wavefront, &values, seconds)
}

/// Field (degrees) and wavelength (nm) after the paper's snapping, where it is asked for.
fn snapped(args: &PsfArgs, fovea_deg: f64) -> Result<(f64, f64), Failure> {
    const UM_PER_DEG: f64 = 287.0;
    let snap = |name: &str, value: f64, from: f64, step: Option<f64>, most: f64| match step {
        None => Ok(value),
        Some(step) if step > 0.0 && step <= most => Ok(from + ((value - from) / step).round() * step),
        Some(_) => Err(Failure::usage(format!("{name}: allowed is more than 0 and at most {most}"))),
    };
    let field_deg = args.field_deg.unwrap_or(fovea_deg);
    let from_fovea = (field_deg - fovea_deg) * UM_PER_DEG;
    let um = snap("--node-um", from_fovea, 0.0, args.node_um, 5000.0)?;
    let nm = snap("--wavelength-step-nm", args.wavelength_nm, 390.0, args.wavelength_step_nm, 100.0)?;
    let field = if args.node_um.is_some() { fovea_deg + um / UM_PER_DEG } else { field_deg };
    Ok((field, nm.clamp(365.0, 1014.0)))
}

fn tell(
    context: &Context,
    args: &PsfArgs,
    wavefront: &Wavefront,
    values: &[f64],
    seconds: f64,
) -> Result<(), Failure> {
    let pitch_um = 2.0 * args.half_width_um / f64::from(args.samples);
    let energy = values.iter().sum::<f64>() * wavefront.density_per_um2() * pitch_um.powi(2);
    if context.json {
        return output::json(&json!({
            "strehl": wavefront.strehl(),
            "rms_waves": wavefront.rms_waves(),
            "energy_in_window": energy,
            "peak": values.iter().copied().fold(0.0, f64::max),
            "landing_um": wavefront.landing_um.to_array(),
            "landing_mm": wavefront.landing.to_array(),
            "pupil_area_mm2": wavefront.pupil_area_mm2,
            "density_per_um2": wavefront.density_per_um2(),
            "seconds_per_psf": seconds,
            "out": args.out,
        }));
    }
    output::line(format_args!("Strehl ratio    {:.4} at the chief ray", wavefront.strehl()))?;
    output::line(format_args!("wavefront error {:.4} waves rms", wavefront.rms_waves()))?;
    output::line(format_args!("energy          {energy:.4} of the light is in the window"))?;
    output::line(format_args!("time            {seconds:.6} s per point spread"))
}

/// Enough rays for the window and the pupil: phases grow with both.
fn nodes(args: &PsfArgs) -> HuygensOptions {
    let strength = (args.pupil_mm / 3.0).powi(2).max(1.0);
    let radial = ((14.0 + 0.65 * args.half_width_um) * strength).clamp(14.0, 400.0) as usize;
    HuygensOptions { radial, azimuth: 3 * radial + 6, exact_distance: true }
}
