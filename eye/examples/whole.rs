//! scratch
use glam::DVec2;
use photoneye_eye::optics::*;
use photoneye_eye::retina::*;
use rayon::prelude::*;
fn main() {
    let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
    let state = EyeState {
        pupil_mm: 3.0,
        decentre_mm: 0.4,
        accommodation_a: 0.0,
        dispersion: Dispersion::Herzberger,
        side: Side::Right,
    };
    let geometry = photoneye_eye::plan::setup::retina_geometry(&prescription, &state).unwrap();
    let p = RetinaParams { geometry, ..RetinaParams::default() };
    let half: f64 = std::env::args().nth(1).unwrap().parse().unwrap();
    let region = RegionUm { min: DVec2::splat(-half), max: DVec2::splat(half) };
    let t0 = std::time::Instant::now();
    let mut total = Census::new(&p, &BANDS_DEG, if half > 5000.0 { 16 } else { 1 });
    let tiles = tiles_for(&region);
    for group in tiles.chunks(8) {
        let parts: Vec<Census> = group
            .par_iter()
            .map(|&t| {
                let tile = build_tile(&p, t).unwrap();
                let mut c = Census::new(&p, &BANDS_DEG, if half > 5000.0 { 16 } else { 1 });
                c.add(&tile, &t.region().unwrap());
                c
            })
            .collect();
        for c in &parts {
            total.merge(c);
        }
    }
    let s = total.statistics();
    println!("{:.1} s {:?}", t0.elapsed().as_secs_f64(), s.counts);
    for b in s.bands.iter().chain([&s.all]) {
        let ratio: Vec<String> =
            b.sectors.iter().map(|s| format!("{:.4}", s.cones as f64 / s.target_cones)).collect();
        println!(
            "{:6.2}-{:6.2} n {:8} ratio {:.4} [{}] S {:.4}/{:.4} six {:.3} w {:.3} near {:.3}±{:.3} psi {:.3} open {} s {:.3} ny {:.1} cov {:.3}",
            b.from_deg,
            b.to_deg,
            b.cones,
            b.density_ratio(),
            ratio.join(" "),
            b.s_share(),
            b.target_s_share(),
            b.six_share,
            b.within_1_5,
            b.nearest_mean,
            b.nearest_sd,
            b.psi6,
            b.open as f64 / (b.open + b.interior) as f64,
            b.s_nearest,
            b.nyquist_cpd(),
            b.coverage
        );
    }
}
