//! Time per cone of the generators: regions of growing size, single tiles at several eccentricities, and the whole retina.
//!
//! `cargo bench -p photoneye-eye --bench retina` prints processor time of all threads, best of some runs; with `-- whole` the whole
//! retina, tile by tile, too.
#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use glam::DVec2;
use photoneye_eye::retina::{RegionUm, RetinaParams, TileId, build_region, build_tile, tiles_for};
use rayon::prelude::*;

/// Processor time of this process so far, seconds (utime and stime of /proc/self/stat, in ticks of 10 ms).
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default();
    let ticks: f64 = after.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum();
    ticks / 100.0
}

/// Repeats the work for about half a second of processor time and prints its mean.
fn report(what: &str, mut work: impl FnMut() -> usize) {
    let start = cpu_seconds();
    let (mut cones, mut runs) = (0, 0);
    while runs == 0 || (cpu_seconds() - start < 0.5 && runs < 100) {
        cones += work();
        runs += 1;
    }
    let seconds = cpu_seconds() - start;
    let each = seconds * 1e6 / cones.max(1) as f64;
    println!("{what}: {} cones, {:.3} s of CPU, {each:.2} µs per cone", cones / runs, seconds / runs as f64);
}

fn main() {
    let p = RetinaParams::default();
    let whole = std::env::args().any(|a| a == "whole");
    let region = |half: f64| RegionUm { min: DVec2::splat(-half), max: DVec2::splat(half) };
    for half in [50.0, 150.0, 450.0] {
        report(&format!("region ±{half} µm"), || build_region(&p, &region(half)).map_or(0, |r| r.len()));
    }
    for x_um in [0.0, 600.0, 1_500.0, 2_930.0, 8_000.0, 16_000.0, 22_000.0] {
        let at = DVec2::new(x_um, 100.0);
        let tiles = tiles_for(&RegionUm { min: at, max: at + 1.0 });
        let Some(&tile) = tiles.first() else { continue };
        report(&format!("tile at {x_um} µm"), || build_tile(&p, tile).map_or(0, |t| t.len()));
    }
    if whole {
        let tiles: Vec<TileId> = tiles_for(&region(30_000.0));
        report("whole retina", || tiles.par_iter().map(|&t| build_tile(&p, t).map_or(0, |t| t.len())).sum());
    }
}
