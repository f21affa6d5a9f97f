//! §12: how many shells of constant index does a lens with a gradient need?

#![allow(clippy::unwrap_used, reason = "a test stops at the first error")]

use glam::DVec2;
use photoneye_eye::optics::{EyeState, Object, Prescription, PupilBundle, SchematicEye, Side};
use std::f64::consts::TAU;

/// Rays of a 3 mm pupil at the fovea: place in the stop and path difference in waves of 555 nm.
fn waves(shells: Option<u32>) -> Vec<(DVec2, f64)> {
    let mut p = Prescription::preset("liou-brennan-1997").unwrap();
    p.lens_gradient.as_mut().unwrap().shells = shells;
    let state = EyeState {
        pupil_mm: 3.0,
        decentre_mm: p.stop_decentre_mm,
        accommodation_a: 0.0,
        dispersion: p.default_dispersion(),
        side: Side::Right,
    };
    let eye = SchematicEye::new(&p, &state).unwrap();
    // Equal areas and azimuths: every ray weighs the same.
    let points: Vec<(DVec2, f64)> = (0..24)
        .flat_map(|i| (0..72).map(move |k| (f64::from(i), f64::from(k))))
        .map(|(i, k)| (DVec2::from_angle(TAU * k / 72.0) * ((i + 0.5) / 24.0).sqrt(), 1.0))
        .collect();
    let object = Object::field(5.0, 0.0).unwrap();
    let bundle = PupilBundle::trace_points(&eye, object, 555.0, &points, &[]).unwrap();
    bundle.rays.iter().map(|r| (r.stop, r.opd_mm / bundle.wavelength_mm())).collect()
}

/// Root mean square of the wavefront's error over the pupil, less its mean and its tilt: a shifted image is no error.
fn error(shells: u32, exact: &[(DVec2, f64)]) -> f64 {
    let gap: Vec<(DVec2, f64)> =
        waves(Some(shells)).iter().zip(exact).map(|((s, a), (_, b))| (*s, a - b)).collect();
    // 1, 2x and 2y are orthonormal over the disc.
    let mean = |f: &dyn Fn(DVec2) -> f64| gap.iter().map(|(s, g)| g * f(*s)).sum::<f64>() / gap.len() as f64;
    let (piston, x, y) = (mean(&|_| 1.0), mean(&|s| 2.0 * s.x), mean(&|s| 2.0 * s.y));
    let rest = gap.iter().map(|(s, g)| (g - piston - 2.0 * x * s.x - 2.0 * y * s.y).powi(2));
    (rest.sum::<f64>() / gap.len() as f64).sqrt()
}

/// The error falls with the number of shells, but slowly: where walls are grazed, in the middle of the lens, each kicks a ray by
/// √(2Δ/n). With 100 to 400 shells it is still some 0.03 waves, where the eye's own aberrations are 0.04.
#[test]
fn shells_come_close_to_the_gradient() {
    let exact = waves(None);
    let errors = [12, 25, 50, 100, 200, 400, 800, 1600].map(|n| (n, error(n, &exact)));
    for (n, error) in &errors {
        println!("{n:>5} shells: wavefront error {error:.4} waves rms");
    }
    assert!(errors[0].1 > 0.2 && errors[7].1 < 0.05 && errors[5].1 < 0.1, "{errors:?}");
}
