//! The whole retina, fovea to ora: density, types and faults against their targets. A minute of processor time:
//! `cargo test --release -p photoneye-eye --test retina_whole -- --ignored`.

#![allow(clippy::unwrap_used, reason = "tests")]

use glam::DVec2;
use photoneye_eye::optics::{Dispersion, EyeState, Prescription, Side};
use photoneye_eye::plan::setup::retina_geometry;
use photoneye_eye::retina::{BANDS_DEG, Census, Cones, RegionUm, RetinaParams, Statistics, synthesize};
use photoneye_eye::rng::{Purpose, Stream};
use std::f64::consts::TAU;

/// Points thrown into a tile.
const POINTS: usize = 250;

/// Points of a tile that lie in one full cell, and points thrown among cones all round. Cells are the apertures without the gaps that
/// rods fill.
fn owned_once(cones: &Cones, rectangle: &RegionUm, seed: u64) -> (u64, u64) {
    let area: f64 = cones.cell_area_um2.iter().map(|a| f64::from(*a)).sum();
    let reach = 4.0 * (area / cones.len().max(1) as f64).sqrt();
    let (min, max) = (rectangle.min + reach, rectangle.max - reach);
    let mut stream = Stream::new(seed, Purpose::Study, 0, 0);
    let (mut once, mut thrown) = (0, 0);
    for _ in 0..POINTS {
        let p = min + DVec2::new(stream.uniform(), stream.uniform()) * (max - min);
        let near: Vec<usize> = (0..cones.len()).filter(|&i| (cones.center(i) - p).length() < reach).collect();
        // The tile's own edge, the disc and the ora leave a gap in the ring of neighbours.
        let mut around: Vec<f64> = near.iter().map(|&i| (cones.center(i) - p).to_angle()).collect();
        around.sort_unstable_by(f64::total_cmp);
        let last = around.last().map(|last| last - TAU);
        let gap = last.iter().chain(&around).zip(&around).map(|(a, b)| b - a).fold(0.0, f64::max);
        if near.len() < 12 || gap > 1.5 {
            continue;
        }
        thrown += 1;
        let owners = near.iter().filter(|&&i| {
            let full = f64::from(cones.cell_area_um2[i] / cones.aperture_um2[i]).sqrt();
            let at = cones.center(i) + (p - cones.center(i)) / full;
            let corner: Vec<DVec2> = cones.polygon(i).collect();
            (0..corner.len())
                .all(|m| (corner[(m + 1) % corner.len()] - corner[m]).perp_dot(at - corner[m]) > 0.0)
        });
        once += u64::from(owners.count() == 1);
    }
    (once, thrown)
}

/// The statistics of a retina out to a distance along both axes, µm, neighbours looked at for one cone in 16.
fn counted(p: &RetinaParams, half_um: f64) -> (Statistics, (u64, u64)) {
    let region = RegionUm { min: DVec2::splat(-half_um), max: DVec2::splat(half_um) };
    let mut total = Census::new(p, &BANDS_DEG, 16);
    let mut cover = (0, 0);
    let work = |rectangle: &RegionUm, cones: Cones| {
        let mut census = Census::new(p, &BANDS_DEG, 16);
        census.add(&cones, rectangle);
        let place = (rectangle.min.x.to_bits(), rectangle.min.y.to_bits());
        (census, owned_once(&cones, rectangle, place.0 ^ place.1.rotate_left(32)))
    };
    let take = |(census, (once, thrown))| {
        total.merge(&census);
        cover = (cover.0 + once, cover.1 + thrown);
    };
    synthesize(p, &region, work, take).unwrap();
    (total.statistics(), cover)
}

#[test]
#[ignore = "a minute of processor time; the gate runs it"]
fn the_whole_retina_meets_its_targets() {
    let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
    let state = EyeState {
        pupil_mm: 3.0,
        decentre_mm: 0.4,
        accommodation_a: 0.0,
        dispersion: Dispersion::Herzberger,
        side: Side::Right,
    };
    let geometry = retina_geometry(&prescription, &state).unwrap();
    let (s, (once, thrown)) = counted(&RetinaParams { geometry, ..RetinaParams::default() }, 30_000.0);
    assert!((s.all.density_ratio() - 1.0).abs() < 0.01, "{:?}", s.all);
    // Curcio et al. 1990: 4.6 million on average, 4.08 to 5.29 in single eyes.
    println!("{} cones", s.all.cones);
    assert!((4_080_000..5_290_000).contains(&s.all.cones), "{}", s.all.cones);
    for b in s.bands.iter().filter(|b| b.from_deg >= 0.1 && b.to_deg <= 90.0) {
        assert!((b.density_ratio() - 1.0).abs() < 0.02, "{b:?}");
        // 5 %, or four standard deviations of a binomial where S cones are few: a chance of 1e-3 that one of a dozen bands is out.
        let allowed = (0.05 * b.target_s).max(4.0 * b.target_s.sqrt());
        assert!((b.types[2] as f64 - b.target_s).abs() <= allowed.max(1.0), "{b:?}");
        for sector in b.sectors.iter().filter(|sector| sector.target_cones > 5_000.0) {
            assert!((sector.cones as f64 / sector.target_cones - 1.0).abs() < 0.02, "{b:?}");
        }
    }
    // Cells tile the retina: a point lies in one of them. More than 99.9 % of them (measured: all of 36263).
    assert!(thrown > 32_000 && ((thrown - once) as f64) < 1e-3 * thrown as f64, "{once} of {thrown}");
    let cones = s.all.cones as f64;
    assert_eq!((s.counts.coincident, s.counts.close_pairs), (0, 0));
    assert!(
        (s.counts.voids as f64) < 1e-4 * cones && (s.counts.concave as f64) < 1e-5 * cones,
        "{:?}",
        s.counts
    );
}

/// A region of 300,000 cones in one go, whatever the number of threads: parts stay small enough for their halos.
#[test]
#[ignore = "six seconds of processor time; the gate runs it"]
fn a_large_region_is_made_at_once() {
    let region = RegionUm { min: DVec2::splat(-2_340.0), max: DVec2::splat(2_340.0) };
    let p = RetinaParams::default();
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| photoneye_eye::retina::build_region(&p, &region).unwrap())
    };
    let (one, two) = (made(1), made(2));
    assert!(one.len() > 250_000 && one.to_bytes() == two.to_bytes(), "{} cones", one.len());
}
