//! Time per cone of the domain generator: the fovea in one piece, and single tiles at several eccentricities.
//!
//! `cargo bench -p photoneye-eye --bench retina`; prints the best of five runs.
#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::time::Instant;

use glam::DVec2;
use photoneye_eye::retina::{RegionUm, RetinaParams, TileId, build_region, build_tile};

fn report(what: &str, mut work: impl FnMut() -> usize) {
    let mut best = f64::INFINITY;
    let mut cones = 0;
    for _ in 0..5 {
        let start = Instant::now();
        cones = work();
        best = best.min(start.elapsed().as_secs_f64());
    }
    println!(
        "{what}: {cones} cones, {:.1} ms, {:.2} µs per cone",
        best * 1e3,
        best * 1e6 / cones.max(1) as f64
    );
}

fn main() {
    let p = RetinaParams::default();
    let region = |half: f64| RegionUm { min: DVec2::splat(-half), max: DVec2::splat(half) };
    for half in [150.0, 350.0, 450.0] {
        report(&format!("region ±{half} µm"), || build_region(&p, &region(half)).map_or(0, |r| r.len()));
    }
    for (i, j) in [(0, 0), (1, 0), (2, 0), (8, 8), (32, 0)] {
        report(&format!("tile ({i}, {j})"), || build_tile(&p, TileId { i, j }).map_or(0, |t| t.len()));
    }
}
