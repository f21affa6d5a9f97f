//! A frame of 1280 x 1024 pixels over 53°: what three of its tiles cost, and all of them by their cones and grids:
//! `cargo bench -p photoneye-eye --bench wide`. CPU seconds of one core (Linux).
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    missing_docs,
    reason = "a benchmark prints and stops at the first error"
)]

#[path = "clock/mod.rs"]
mod clock;
#[path = "../tests/support/mod.rs"]
mod support;

use std::collections::BTreeMap;

use clock::cpu_seconds;
use photoneye_eye::artifact::{ArtifactSpec, Input};
use photoneye_eye::digest::Digest;
use photoneye_eye::experiment::Pattern;
use photoneye_eye::exposure::Exposure;
use photoneye_eye::plan::{Plan, plan};
use support::figure_12;

fn timed<T>(f: impl FnOnce() -> T) -> (T, f64) {
    let started = cpu_seconds();
    let value = f();
    (value, cpu_seconds() - started)
}

/// An artifact with all it is made from.
fn build(plan: &Plan, key: Digest, built: &mut BTreeMap<Digest, Vec<u8>>) {
    if built.contains_key(&key) {
        return;
    }
    let artifact = plan.artifacts.iter().find(|a| a.key == key).unwrap();
    artifact.inputs.iter().for_each(|input| build(plan, *input, built));
    let inputs: Vec<Input> = artifact.inputs.iter().map(|k| (*k, built[k].as_slice())).collect();
    let bytes = artifact.spec.build(&inputs).unwrap().bytes;
    built.insert(key, bytes);
}

fn main() {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 2 });
    let display = &mut experiment.display;
    (display.width_px, display.height_px, display.distance_cm) = (1280, 1024, 60.0);
    display.pixel_pitch_cm = 2.0 * 60.0 * 26.5_f64.to_radians().tan() / 1280.0;
    experiment.eye.focus_distance_cm = 60.0;
    experiment.gaze.center_px = [640.0, 512.0];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (plan, seconds) = pool.install(|| timed(|| plan(&experiment).unwrap()));
    println!(
        "planned in {seconds:.2} s: {} tiles, {:.2} million cones, {:.0} CPU s and {:.2} GB predicted, largest grid {:?}",
        plan.tile_artifacts.len(),
        1e-6 * plan.predicted_cones,
        plan.predicted_seconds,
        1e-9 * plan.predicted_bytes,
        plan.grid
    );
    let kernels = |keys: &[Digest]| match &plan.artifacts.iter().find(|a| a.key == keys[1]).unwrap().spec {
        ArtifactSpec::Kernels(spec) => (**spec).clone(),
        _ => unreachable!("the second artifact of a tile are its kernels"),
    };
    let bands = plan.tile_artifacts.iter().map(|keys| kernels(keys).band.to_radians());
    println!(
        "band {:.0} to {:.0} cycles per degree",
        bands.clone().fold(f64::MAX, f64::min),
        bands.fold(0.0, f64::max)
    );
    for wanted_um in [0.0, 3000.0, 6000.0] {
        let keys = plan
            .tile_artifacts
            .iter()
            .min_by(|a, b| {
                let off = |keys: &[Digest]| {
                    let [min, max] = kernels(keys).field_um;
                    (0.5 * (min + max) - glam::DVec2::new(wanted_um, 0.0)).length()
                };
                off(a).total_cmp(&off(b))
            })
            .unwrap();
        let mut built = BTreeMap::new();
        pool.install(|| build(&plan, keys[0], &mut built));
        let ((), kernel_seconds) = pool.install(|| timed(|| build(&plan, keys[1], &mut built)));
        let artifacts: Vec<&Vec<u8>> = keys.iter().map(|k| &built[k]).collect();
        let (exposure, prepare) = pool.install(|| timed(|| Exposure::new(&experiment, &artifacts).unwrap()));
        let _first = pool.install(|| exposure.frame(0, None).unwrap());
        let ((), frame) = pool.install(|| timed(|| drop(exposure.frame(0, None).unwrap())));
        println!(
            "tile at {wanted_um} µm: band {:.0} c/deg, {} cones; kernels {kernel_seconds:.2} s, prepare {prepare:.2} s, frame {:.1} ms, {:.2} µs a cone",
            kernels(keys).band.to_radians(),
            exposure.len(),
            1e3 * frame,
            1e6 * frame / exposure.len() as f64
        );
    }
}
