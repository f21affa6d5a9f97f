//! Times of the optical kernels, one line a measurement: `cargo bench -p photoneye-eye --bench kernels`. A table of 45 wavelengths
//! at one field point, and the kernels of the scene of Figure 12 as planned, by pupil. Arguments: accuracy target, pupils (mm).
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

use clock::cpu_seconds;
use photoneye_eye::artifact::ArtifactSpec;
use photoneye_eye::exposure::KernelSpec;
use photoneye_eye::plan::plan;
use support::{WHITE, figure_12};

/// CPU seconds of a build, the shortest of `runs`, and the megabytes of its bytes.
fn build(spec: &KernelSpec, runs: usize) -> (f64, f64) {
    let mut best = (f64::MAX, 0.0);
    for _ in 0..runs {
        let started = cpu_seconds();
        let table = spec.wavefronts.as_ref().map(|table| table.build().unwrap());
        let bytes = spec.build(table.as_ref()).unwrap().to_bytes().unwrap();
        best = ((cpu_seconds() - started).min(best.0), 1e-6 * bytes.len() as f64);
    }
    best
}

fn main() {
    let numbers: Vec<f64> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let target = numbers.first().copied().unwrap_or(0.01);
    let pupils = if numbers.len() > 1 { &numbers[1..] } else { &[2.0, 3.0, 4.0, 6.0, 8.0, 9.0] };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    println!("one core, accuracy target {target}");
    for &pupil_mm in pupils {
        let mut experiment = figure_12(WHITE);
        experiment.accuracy_target = target;
        experiment.eye.pupil_mm = pupil_mm;
        let plan = plan(&experiment).unwrap();
        let kernels = plan.artifacts.iter().find_map(|a| match &a.spec {
            ArtifactSpec::Kernels(spec) => Some((spec, a.predicted_seconds)),
            _ => None,
        });
        let (spec, predicted) = kernels.unwrap();
        let mut table = (**spec).clone();
        table.wavefronts = None;
        table.nodes_nm = (0..45).map(|i| 390.0 + 10.0 * f64::from(i)).collect();
        (table.field_nodes, table.ecc_nodes) = (1, 1);
        let runs = if pupil_mm > 5.0 { 1 } else { 3 };
        let (seconds, _) = pool.install(|| build(&table, runs));
        println!("pupil {pupil_mm} mm: 45 wavelengths at one field point {:8.1} ms", 1e3 * seconds);
        let (seconds, megabytes) = pool.install(|| build(spec, runs));
        println!(
            "  {} field nodes x {} wavelengths                {seconds:8.3} s, predicted {predicted:.3}; {megabytes:.1} MB",
            plan.field_nodes,
            spec.nodes_nm.len()
        );
        let started = std::time::Instant::now();
        build(spec, 1);
        println!(
            "  the same on all cores, by the clock                {:.3} s",
            started.elapsed().as_secs_f64()
        );
    }
}
