//! The engine `expected` on whole scenes: conservation, uniform fields, orientation, determinism.

mod support;

use photoneye_eye::exposure::{Frame, FrameCounts};
use support::{WHITE, exposure, figure_12};

fn means(frame: &Frame) -> &[f32] {
    match &frame.counts {
        FrameCounts::Means(means) => means,
        FrameCounts::Counts(_) => panic!("means were asked for"),
    }
}

#[test]
fn every_photon_has_one_fate() {
    let (plan, exposure) = exposure(&figure_12(WHITE));
    let started = std::time::Instant::now();
    let frame = exposure.frame(0, None).unwrap();
    println!(
        "frame {:.3} s, {} cones, grid {:?}",
        started.elapsed().as_secs_f64(),
        exposure.len(),
        plan.grid
    );
    println!("{:#?}", frame.budget);
    assert!((frame.budget.fates() / frame.budget.emitted - 1.0).abs() < 1e-12);
}
