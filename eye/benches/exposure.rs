//! Times of the engines on the scene of Figure 12, one line a measurement: `cargo bench -p photoneye-eye --bench exposure`.
//! The paper's engine is the anchor: both are timed in the same run.
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

use std::time::Instant;

use clock::cpu_seconds;
use photoneye_eye::experiment::{Engine, Experiment, Pattern};
use photoneye_eye::exposure::Exposure;
use support::{exposure, figure_12};

/// Median wall seconds of a few runs.
fn median(runs: usize, mut f: impl FnMut()) -> f64 {
    let mut seconds: Vec<f64> = (0..runs)
        .map(|_| {
            let started = Instant::now();
            f();
            started.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[runs / 2]
}

/// Processor seconds of the busiest thread of some, the median of five runs: the wall's on a machine with nothing else to do.
fn busiest(threads: usize, f: impl Fn() + Sync) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut seconds: Vec<f64> = (0..5)
        .map(|_| {
            let before = pool.broadcast(|_| cpu_seconds());
            pool.install(&f);
            let after = pool.broadcast(|_| cpu_seconds());
            after.iter().zip(before).map(|(after, before)| after - before).fold(0.0, f64::max)
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[2]
}

fn prepared(experiment: &Experiment) -> Exposure {
    let started = Instant::now();
    let (plan, exposure) = exposure(experiment);
    let cold = started.elapsed().as_secs_f64();
    println!(
        "plan, build and prepare, nothing cached      {cold:8.3} s   {} cones, grid {:?}",
        exposure.len(),
        plan.grid
    );
    exposure
}

/// The engine `expected` on a wide picture and on the scene of the others: seconds of a frame there.
fn expected(narrow: &Experiment) -> f64 {
    // The picture with more than 1 degree of retina around it: some 50,000 cones.
    let mut experiment = narrow.clone();
    experiment.retina.region_deg = Some([-1.85, 1.85, -1.85, 1.85]);
    let wide = prepared(&experiment);
    let frame = median(9, || drop(wide.frame(0, None).unwrap()));
    println!(
        "expected, one frame                          {:8.1} ms  {:.2} µs a cone",
        1e3 * frame,
        1e6 * frame / wide.len() as f64
    );
    let narrow = prepared(narrow);
    median(9, || drop(narrow.frame(0, None).unwrap()))
}

fn main() {
    let mut experiment = figure_12(Pattern::Checkerboard { square_px: 3 });
    let events_alone = std::env::args().any(|arg| arg == "events");
    let fast = if events_alone { 0.0 } else { expected(&experiment) };
    experiment.counts.engine = Engine::Events;
    let events = prepared(&experiment);
    let drawn = events.frame(0, None).unwrap().diagnostics[0].1 as f64;
    let counted: f64 = events.frame(0, None).unwrap().budget.isomerized.iter().sum();
    let [alone, both] = [1, 2].map(|threads| busiest(threads, || drop(events.frame(0, None).unwrap())));
    println!(
        "events, one frame on one core                {alone:8.3} s   {:.1} ns a drawn photon, {:.2} drawn for one counted",
        1e9 * alone / drawn,
        drawn / counted
    );
    println!(
        "events, one frame on two threads             {both:8.3} s   {:.1} ns a drawn photon, {:.2} times as fast",
        1e9 * both / drawn,
        alone / both
    );
    if events_alone {
        return;
    }
    experiment.counts.engine = Engine::Paper;
    let paper = prepared(&experiment);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let photons = paper.frame(0, None).unwrap().budget.into_pupil();
    let slow = pool.install(|| median(1, || drop(paper.frame(0, None).unwrap())));
    println!(
        "paper, one frame on one core                 {slow:8.2} s   {:.2} million photons a second",
        1e-6 * photons / slow
    );
    println!("paper / expected, one frame                  {:8.0}", slow / fast);
}
