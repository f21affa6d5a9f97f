//! `psf`: one point spread of the eye as an array.

use std::time::Instant;

use photoneye_eye::optics::{EyeState, Object, SchematicEye};
use photoneye_eye::psf::{Amplitude, HuygensOptions, PsfGrid, Wavefront, WavefrontOptions, huygens, psf};
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
    let field_deg = args.field_deg.unwrap_or(prescription.fovea_angle_deg);
    let eye = SchematicEye::new(&prescription, &state).map_err(Failure::usage)?;
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
    let wavefront = Wavefront::new(&eye, object, args.wavelength_nm, &options).map_err(Failure::usage)?;
    let started = Instant::now();
    let mut values = Vec::new();
    for _ in 0..args.repeat {
        values = match args.method {
            MethodName::Fit => {
                let fresh = Wavefront::new(&eye, object, args.wavelength_nm, &options);
                psf(&fresh.map_err(Failure::usage)?, &grid)
            }
            MethodName::Huygens => {
                huygens::psf(&eye, object, args.wavelength_nm, &options, &nodes(args), &grid)
                    .map_err(Failure::usage)?
            }
        };
    }
    let seconds = started.elapsed().as_secs_f64() / f64::from(args.repeat);

    let side = args.samples as usize;
    write_file(&args.out, &npy::f64_array(&[side, side], &values))?;
    tell(context, args, &wavefront, &values, seconds)
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
