use glam::DVec2;
use photoneye_eye::retina::*;
fn main() {
    let x: f64 = std::env::args().nth(1).unwrap().parse().unwrap();
    let at = DVec2::new(x, 100.0);
    let t = tiles_for(&RegionUm { min: at, max: at + 1.0 })[0];
    let r = build_tile(&RetinaParams::default(), t).unwrap();
    eprintln!("{} cones {:?}", r.len(), r.counts);
}
