//! The whole retina, fovea to ora: density, types and faults against their targets. A minute of processor time:
//! `cargo test --release -p photoneye-eye --test retina_whole -- --ignored`.

#![allow(clippy::unwrap_used, reason = "tests")]

use glam::DVec2;
use photoneye_eye::optics::{Dispersion, EyeState, Prescription, Side};
use photoneye_eye::plan::setup::retina_geometry;
use photoneye_eye::retina::{BANDS_DEG, Census, RegionUm, RetinaParams, Statistics, synthesize};

/// The statistics of a retina out to a distance along both axes, µm, neighbours looked at for one cone in 16.
fn counted(p: &RetinaParams, half_um: f64) -> Statistics {
    let region = RegionUm { min: DVec2::splat(-half_um), max: DVec2::splat(half_um) };
    let mut total = Census::new(p, &BANDS_DEG, 16);
    let work = |rectangle: &RegionUm, cones| {
        let mut census = Census::new(p, &BANDS_DEG, 16);
        census.add(&cones, rectangle);
        census
    };
    synthesize(p, &region, work, |census| total.merge(&census)).unwrap();
    total.statistics()
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
    let s = counted(&RetinaParams { geometry, ..RetinaParams::default() }, 30_000.0);
    assert!((s.all.density_ratio() - 1.0).abs() < 0.01, "{:?}", s.all);
    assert!((4_600_000..5_700_000).contains(&s.all.cones), "{}", s.all.cones);
    for b in s.bands.iter().filter(|b| b.from_deg >= 0.1 && b.to_deg <= 90.0) {
        assert!((b.density_ratio() - 1.0).abs() < 0.02, "{b:?}");
        // 5 %, or four standard deviations of a binomial where S cones are few: a chance of 1e-3 that one of a dozen bands is out.
        let allowed = (0.05 * b.target_s).max(4.0 * b.target_s.sqrt());
        assert!((b.types[2] as f64 - b.target_s).abs() <= allowed.max(1.0), "{b:?}");
        for sector in b.sectors.iter().filter(|sector| sector.target_cones > 5_000.0) {
            assert!((sector.cones as f64 / sector.target_cones - 1.0).abs() < 0.02, "{b:?}");
        }
    }
    let cones = s.all.cones as f64;
    assert_eq!((s.counts.coincident, s.counts.close_pairs), (0, 0));
    assert!(
        (s.counts.voids as f64) < 1e-4 * cones && (s.counts.concave as f64) < 1e-5 * cones,
        "{:?}",
        s.counts
    );
}
