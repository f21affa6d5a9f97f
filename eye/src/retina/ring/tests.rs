//! Tests.
use super::*;
use crate::retina::params::RetinaParams;
use crate::retina::mosaic::Retina;
use crate::retina::statistics::{statistics, Band};

fn grown(p: &RetinaParams, half: f64) -> (Retina, RingReport) {
    let region = RegionUm { min: DVec2::splat(-half), max: DVec2::splat(half) };
    let field = Field::new(p);
    let mut parts = Vec::new();
    let report = grow(&field, &region, &mut |c| parts.push(c)).unwrap();
    (Retina::gather(&parts.iter().collect::<Vec<_>>(), &region, p), report)
}

#[test]
#[ignore = "study"]
fn study() {
    let half: f64 = std::env::var("HALF").map_or(300.0, |s| s.parse().unwrap());
    let cycles: Option<u32> = std::env::var("CYCLES").ok().map(|s| s.parse().unwrap());
    let p = RetinaParams { cycles, ..RetinaParams::default() };
    let t = std::time::Instant::now();
    let (r, report) = grown(&p, half);
    let e = t.elapsed().as_secs_f64();
    println!("{} kept, {:.2} s, {:.2} µs per cone grown\n{report:?}\n{:?}", r.len(), e, e * 1e6 / report.cones_grown as f64, r.counts);
    if half > 10_000.0 { return; }
    let s = statistics(&r);
    for b in s.bands.iter().chain([&s.all]) {
        let Band { from_deg, cones, six_share, within_1_5, nearest_mean, nearest_sd, psi6, .. } = b;
        println!("{from_deg:6} n {cones} ratio {:.4} six {six_share:.3} w {within_1_5:.3} near {nearest_mean:.3} {nearest_sd:.3} psi6 {psi6:.3} S {:.4}", b.density_ratio(), b.s_share());
    }
}
