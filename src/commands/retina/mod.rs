//! `retina`: the cones out to an eccentricity as a table, with statistics, pictures, neighbours and receptive fields.
//!
//! Cones are made tile by tile and written as they come, so memory does not grow with the region; only `--neighbours` and `--fields` hold
//! all cones at once.

mod networks;
mod pictures;
mod statistics_page;
mod tables;

use std::fs;
use std::io::{BufWriter, Write as _};
use std::process::Command;

use glam::DVec2;
use photoneye_eye::experiment::Experiment;
use photoneye_eye::optics::Side;
use photoneye_eye::plan::setup::setup;
use photoneye_eye::retina::{
    BANDS_DEG, Census, Cones, RegionUm, RetinaParams, Statistics, build_region, import, synthesize,
};
use photoneye_store::table::{ConeColumns, ConesWriter};
use serde_json::json;

use super::Context;
use crate::cli_optics::{GeneratorName, RetinaArgs};
use crate::experiment_file::set;
use crate::failure::Failure;
use crate::output;
use crate::result_folder::{write_file, write_with};

const MAX_DEG: f64 = 130.0;
/// Beyond this eccentricity, visual degrees, neighbours are looked at for one cone in sixteen.
const SAMPLED_FROM_DEG: f64 = 15.0;
/// Largest measured mosaic that is read, bytes.
const MAX_IMPORT: u64 = 200 << 20;
/// Set for the process that already has the number of threads it was asked for.
const THREADS: &str = "RAYON_NUM_THREADS";

/// Runs the command.
pub fn run(context: &Context, args: &RetinaArgs) -> Result<(), Failure> {
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
    let mosaic = Mosaic {
        params: setup(&experiment).map_err(Failure::usage)?.retina,
        side: experiment.eye.side,
        from_deg: args.from_deg,
        to_deg: args.to_deg,
    };
    let written = match &args.import {
        None => grown(context, args, &mosaic)?,
        Some(path) => imported(args, path, &mosaic)?,
    };
    if let Some(path) = &args.statistics {
        let text = serde_json::to_vec_pretty(&tables::json(&written.statistics)).map_err(Failure::failed)?;
        write_file(path, &text)?;
    }
    if let Some(folder) = &args.png {
        draw(context, folder, &mosaic, &written)?;
    }
    tell(context, args, &written)
}

/// What is asked for.
struct Mosaic {
    params: RetinaParams,
    side: Side,
    from_deg: f64,
    to_deg: f64,
}

impl Mosaic {
    fn columns(&self, cones: &Cones) -> ConeColumns {
        tables::columns(cones, &self.params.geometry.visual, self.side, self.from_deg..=self.to_deg)
    }
}

/// What was written.
struct Written {
    statistics: Statistics,
    /// L, M and S cones in the table.
    types: [u64; 3],
    is_import: bool,
}

/// Makes the cones tile by tile and writes them.
fn grown(context: &Context, args: &RetinaArgs, mosaic: &Mosaic) -> Result<Written, Failure> {
    if args.generator == GeneratorName::Ring && !context.json {
        output::note(format_args!(
            "growing ring by ring, serially; the table follows when the disc is grown"
        ));
    }
    let region = reach(mosaic);
    let edges = edges(mosaic);
    let every = if mosaic.to_deg > SAMPLED_FROM_DEG { 16 } else { 1 };
    let mut total = Census::new(&mosaic.params, &edges, every);
    let mut types = [0_u64; 3];
    write_with(&args.out, |file| {
        let mut writer = ConesWriter::new(BufWriter::new(file)).map_err(Failure::failed)?;
        let mut failed = None;
        let work = |rectangle: &RegionUm, cones: Cones| {
            let mut census = Census::new(&mosaic.params, &edges, every);
            census.add(&cones, rectangle);
            (mosaic.columns(&cones), census)
        };
        synthesize(&mosaic.params, &region, work, |(columns, census)| {
            total.merge(&census);
            for kind in &columns.kind {
                types[usize::from(*kind).min(2)] += 1;
            }
            if failed.is_none() && !columns.is_empty() {
                failed = writer.push(&columns).err();
            }
        })
        .map_err(Failure::usage)?;
        if let Some(error) = failed {
            return Err(Failure::failed(error));
        }
        let mut out = writer.finish().map_err(Failure::failed)?;
        out.flush().map_err(|e| Failure::file("write", &args.out, &e))
    })?;
    if args.neighbours.is_some() || args.fields.is_some() {
        let retina = build_region(&mosaic.params, &region).map_err(Failure::usage)?;
        networks::write(args, &retina, |at| {
            let deg = mosaic.params.geometry.visual.eccentricity_deg(at);
            (mosaic.from_deg..=mosaic.to_deg).contains(&deg)
        })?;
    }
    Ok(Written { statistics: total.statistics(), types, is_import: false })
}

/// Reads a measured mosaic and writes it with its cells.
fn imported(args: &RetinaArgs, path: &std::path::Path, mosaic: &Mosaic) -> Result<Written, Failure> {
    let failed = |e: std::io::Error| Failure::file("read", path, &e);
    if fs::metadata(path).map_err(failed)?.len() > MAX_IMPORT {
        return Err(Failure::usage(format!("--import: {} is over {MAX_IMPORT} bytes", path.display())));
    }
    let text = fs::read_to_string(path).map_err(failed)?;
    let retina = import(&text, &mosaic.params, None)
        .map_err(|e| Failure::usage(format!("--import {}: {e}", path.display())))?;
    let columns = mosaic.columns(&retina);
    let mut types = [0_u64; 3];
    for kind in &columns.kind {
        types[usize::from(*kind).min(2)] += 1;
    }
    write_with(&args.out, |file| {
        let mut writer = ConesWriter::new(BufWriter::new(file)).map_err(Failure::failed)?;
        writer.push(&columns).map_err(Failure::failed)?;
        let mut out = writer.finish().map_err(Failure::failed)?;
        out.flush().map_err(|e| Failure::file("write", &args.out, &e))
    })?;
    if args.neighbours.is_some() || args.fields.is_some() {
        networks::write(args, &retina, |_| true)?;
    }
    let mut census = Census::new(&mosaic.params, &edges(mosaic), 1);
    census.add(&retina, &retina.region);
    Ok(Written { statistics: census.statistics(), types, is_import: true })
}

/// Edges of the bands between the eccentricities asked for.
fn edges(mosaic: &Mosaic) -> Vec<f64> {
    let inner = BANDS_DEG.into_iter().filter(|e| (mosaic.from_deg..mosaic.to_deg).contains(e));
    let mut edges: Vec<f64> = std::iter::once(mosaic.from_deg).chain(inner).chain([mosaic.to_deg]).collect();
    edges.dedup();
    edges
}

/// A rectangle of retina that holds everything out to the visual angle asked for.
fn reach(mosaic: &Mosaic) -> RegionUm {
    const DIRECTIONS: u32 = 128;
    let geometry = &mosaic.params.geometry;
    let edge = geometry.radius_um * (geometry.ora_retinal_deg * (1.0 + geometry.ora_dip.abs())).to_radians();
    let (mut min, mut max) = (DVec2::ZERO, DVec2::ZERO);
    for step in 0..DIRECTIONS {
        let way = DVec2::from_angle(std::f64::consts::TAU * f64::from(step) / f64::from(DIRECTIONS));
        let (mut low, mut high) = (0.0, edge);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            let inside = geometry.visual.eccentricity_deg(way * middle) < mosaic.to_deg;
            if inside { low = middle } else { high = middle }
        }
        (min, max) = (min.min(way * high), max.max(way * high));
    }
    // Between the directions the outline bulges by less than this.
    let margin = 2.0 + 0.001 * (max - min).length();
    RegionUm { min: min - margin, max: max + margin }
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
    let generator = match args.generator {
        GeneratorName::Domain => "DOMAIN",
        GeneratorName::Ring => "RING",
    };
    let mut spec = json!({
        "display": {"preset": "lcos-3chip", "width_px": 8, "height_px": 8},
        "video": {"pattern": {"uniform": {"rgb": [1, 1, 1]}}},
        "retina": {"seed": args.seed, "generator": generator},
    });
    for change in &args.set {
        set(&mut spec, change)?;
    }
    let message = photoneye_proto::experiment_from_json(&spec.to_string()).map_err(Failure::usage)?;
    photoneye_server::spec::experiment(&message).map_err(Failure::usage)
}

/// The statistics page, and pictures of a grown mosaic.
fn draw(
    context: &Context,
    folder: &std::path::Path,
    mosaic: &Mosaic,
    written: &Written,
) -> Result<(), Failure> {
    let cones: u64 = written.types.iter().sum();
    let what = if written.is_import { "Imported mosaic" } else { "Cone mosaic" };
    let title = format!("{what} to {}°, seed {}, {cones} cones", mosaic.to_deg, mosaic.params.seed);
    let columns = statistics_page::StatisticsColumns::from_rings(&title, &written.statistics.bands);
    pictures::write_png(&folder.join("statistics.png"), &statistics_page::statistics_page(&columns))?;
    if !written.is_import {
        let mut request = pictures::MosaicRequest::default();
        request.patches_deg.retain(|deg| *deg <= mosaic.to_deg);
        request.strip_to_deg = request.strip_to_deg.min(mosaic.to_deg);
        let cones_of =
            |region: &RegionUm| Ok(build_region(&mosaic.params, region).map_err(Failure::usage)?.cones);
        for picture in pictures::mosaic_pictures(&mosaic.params, &request, cones_of)? {
            pictures::write_png(&folder.join(picture.name), &picture.image)?;
        }
    }
    if !context.json {
        output::line(format_args!("pictures in {}", folder.display()))?;
    }
    Ok(())
}

fn tell(context: &Context, args: &RetinaArgs, written: &Written) -> Result<(), Failure> {
    let [l, m, s] = written.types;
    let cones = l + m + s;
    if context.json {
        let mut facts = tables::json(&written.statistics);
        facts["cones"] = json!(cones);
        facts["types"] = json!({"l": l, "m": m, "s": s});
        facts["out"] = json!(args.out);
        return output::json(&facts);
    }
    output::line(format_args!("{cones} cones: {l} L, {m} M, {s} S"))?;
    for line in tables::lines(&written.statistics) {
        output::line(format_args!("{line}"))?;
    }
    Ok(())
}
