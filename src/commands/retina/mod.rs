//! `retina`: the cones out to an eccentricity, as a table and figures.

#[allow(dead_code, reason = "the command will draw with it")]
mod pictures;
#[allow(dead_code, reason = "the command will draw with it")]
mod statistics_page;

use std::process::Command;

use glam::DVec2;
use photoneye_eye::experiment::Experiment;
use photoneye_eye::exposure::cone_columns;
use photoneye_eye::plan::setup::{Setup, setup};
use photoneye_eye::retina::{Band, RegionUm, Retina, build_region, statistics};
use photoneye_store::table::{ConeColumns, cones_file};
use serde_json::{Value, json};

use super::Context;
use crate::cli_optics::{GeneratorName, RetinaArgs};
use crate::experiment_file::set;
use crate::failure::Failure;
use crate::output;
use crate::result_folder::write_file;

/// Up to here visual angles are traced through the eye; beyond, the scale of the fovea is used.
const TRACED_DEG: f64 = 20.0;
const MAX_DEG: f64 = 120.0;
/// Set for the process that already has the number of threads it was asked for.
const THREADS: &str = "RAYON_NUM_THREADS";

/// Runs the command.
pub fn run(context: &Context, args: &RetinaArgs) -> Result<(), Failure> {
    if args.generator == GeneratorName::Ring {
        return Err(Failure::usage("--generator ring: not built yet, use domain"));
    }
    let range = 0.0..=MAX_DEG;
    if !(range.contains(&args.to_deg) && range.contains(&args.from_deg) && args.from_deg < args.to_deg) {
        return Err(Failure::usage(format!(
            "--to-deg: allowed is more than --from-deg and at most {MAX_DEG}"
        )));
    }
    if let Some(threads) = args.threads
        && std::env::var(THREADS).ok() != Some(threads.to_string())
    {
        return again_with_threads(threads);
    }
    let experiment = experiment(args)?;
    let setup = setup(&experiment).map_err(Failure::usage)?;
    let scale = setup.retina.geometry.visual.deg_per_um();
    let traced = args.to_deg <= TRACED_DEG;
    let region = if traced { traced_region(&setup, args.to_deg)? } else { square(args.to_deg / scale) };
    let retina = build_region(&setup.retina, &region).map_err(Failure::usage)?;
    let table = if traced { traced_table(&experiment, &retina)? } else { scaled_table(&retina, scale) };
    let table = ring(&table, args.from_deg, args.to_deg);
    write_file(&args.out, &cones_file(&table).map_err(Failure::failed)?)?;
    tell(context, args, &table, &statistics(&retina).bands)
}

/// The number of threads is fixed when a process starts: start this one again with it.
fn again_with_threads(threads: usize) -> Result<(), Failure> {
    if threads == 0 {
        return Err(Failure::usage("--threads: allowed is 1 or more"));
    }
    let program = std::env::current_exe()?;
    let status =
        Command::new(program).args(std::env::args_os().skip(1)).env(THREADS, threads.to_string()).status()?;
    if status.success() { Ok(()) } else { std::process::exit(status.code().unwrap_or(1)) }
}

/// The experiment whose retina is asked for: all defaults but those that were set.
fn experiment(args: &RetinaArgs) -> Result<Experiment, Failure> {
    let mut spec = json!({
        "display": {"preset": "lcos-3chip", "width_px": 8, "height_px": 8},
        "video": {"pattern": {"uniform": {"rgb": [1, 1, 1]}}},
        "retina": {"seed": args.seed},
    });
    for change in &args.set {
        set(&mut spec, change)?;
    }
    let message = photoneye_proto::experiment_from_json(&spec.to_string()).map_err(Failure::usage)?;
    photoneye_server::spec::experiment(&message).map_err(Failure::usage)
}

fn square(half_um: f64) -> RegionUm {
    RegionUm { min: DVec2::splat(-half_um), max: DVec2::splat(half_um) }
}

/// A rectangle of retina that holds everything out to a visual angle.
fn traced_region(setup: &Setup, to_deg: f64) -> Result<RegionUm, Failure> {
    let (mut min, mut max) = (DVec2::ZERO, DVec2::ZERO);
    for step in 0..64 {
        let direction = DVec2::from_angle(std::f64::consts::TAU * f64::from(step) / 64.0);
        let tangent = direction * to_deg.to_radians().tan();
        let wavelength = setup.prescription.reference_wavelength_nm;
        let um = setup.projection.retina_um(tangent, wavelength).map_err(Failure::usage)?;
        (min, max) = (min.min(um), max.max(um));
    }
    // Between the directions the outline bulges by less than this.
    let margin = 2.0 + 0.002 * (max - min).length();
    Ok(RegionUm { min: min - margin, max: max + margin })
}

fn traced_table(experiment: &Experiment, retina: &Retina) -> Result<ConeColumns, Failure> {
    let columns = cone_columns(experiment, retina).map_err(Failure::failed)?;
    Ok(ConeColumns {
        id: columns.id,
        x_um: columns.x_um,
        y_um: columns.y_um,
        x_deg: columns.x_deg,
        y_deg: columns.y_deg,
        ecc_deg: columns.ecc_deg,
        meridian_deg: columns.meridian_deg,
        kind: columns.cone_type,
        aperture_um2: columns.aperture_um2,
        // The model counts corners, the table numbers.
        polygon_start: columns.polygon_start.iter().map(|corner| 2 * corner).collect(),
        polygon: columns.polygon_xy,
    })
}

/// The scale of the fovea everywhere (right eye: up in the field is down on the retina).
fn scaled_table(retina: &Retina, deg_per_um: f64) -> ConeColumns {
    let mut table = ConeColumns {
        id: retina.id.clone(),
        x_um: retina.x_um.clone(),
        y_um: retina.y_um.clone(),
        kind: retina.cone_type.iter().map(|cone_type| *cone_type as u8).collect(),
        aperture_um2: retina.aperture_um2.clone(),
        polygon_start: retina.polygon_start.iter().map(|corner| 2 * corner).collect(),
        ..ConeColumns::default()
    };
    for cone in 0..retina.len() {
        let at = retina.center(cone);
        table.x_deg.push(at.x * deg_per_um);
        table.y_deg.push(-at.y * deg_per_um);
        table.ecc_deg.push(at.length() * deg_per_um);
        table.meridian_deg.push(at.y.atan2(at.x).to_degrees().rem_euclid(360.0));
        for corner in retina.polygon(cone) {
            table.polygon.extend([corner.x as f32, corner.y as f32]);
        }
    }
    table
}

/// The rows between two eccentricities.
fn ring(table: &ConeColumns, from_deg: f64, to_deg: f64) -> ConeColumns {
    let mut out = ConeColumns { polygon_start: vec![0], ..ConeColumns::default() };
    for cone in (0..table.len()).filter(|&cone| (from_deg..=to_deg).contains(&table.ecc_deg[cone])) {
        out.id.push(table.id[cone]);
        out.x_um.push(table.x_um[cone]);
        out.y_um.push(table.y_um[cone]);
        out.x_deg.push(table.x_deg[cone]);
        out.y_deg.push(table.y_deg[cone]);
        out.ecc_deg.push(table.ecc_deg[cone]);
        out.meridian_deg.push(table.meridian_deg[cone]);
        out.kind.push(table.kind[cone]);
        out.aperture_um2.push(table.aperture_um2[cone]);
        out.polygon.extend(table.polygon_of(cone));
        out.polygon_start.push(out.polygon.len() as u32);
    }
    out
}

fn tell(context: &Context, args: &RetinaArgs, table: &ConeColumns, bands: &[Band]) -> Result<(), Failure> {
    let mut types = [0_u64; 3];
    for kind in &table.kind {
        types[usize::from(*kind).min(2)] += 1;
    }
    let [l, m, s] = types;
    let bands = || bands.iter().filter(|band| band.from_deg < args.to_deg && band.to_deg > args.from_deg);
    if context.json {
        let bands: Vec<Value> = bands().map(band_json).collect();
        let types = json!({"l": l, "m": m, "s": s});
        return output::json(&json!({"cones": table.len(), "types": types, "bands": bands, "out": args.out}));
    }
    output::line(format_args!("{} cones: {l} L, {m} M, {s} S", table.len()))?;
    output::line(format_args!(
        "degrees        cones  density/target  S share  six neighbours  nearest/spacing"
    ))?;
    for band in bands() {
        output::line(format_args!(
            "{:>6.3}-{:<6.3} {:>6}  {:>14.4}  {:>7.4}  {:>14.3}  {:>6.3} ± {:.3}",
            band.from_deg,
            band.to_deg,
            band.cones,
            band.density_ratio(),
            band.s_share(),
            band.six_share,
            band.nearest_mean,
            band.nearest_sd
        ))?;
    }
    Ok(())
}

fn band_json(band: &Band) -> Value {
    json!({
        "from_deg": band.from_deg,
        "to_deg": band.to_deg,
        "cones": band.cones,
        "target_cones": band.target_cones,
        "types": band.types,
        "six_share": band.six_share,
        "nearest_mean": band.nearest_mean,
        "nearest_sd": band.nearest_sd,
        "psi6": band.psi6,
        "coverage": band.coverage,
    })
}
