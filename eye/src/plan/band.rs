//! The highest spatial frequency that a patch of retina needs.
//!
//! A cone's mean holds a picture's frequency ν times pixel(ν) · optics(ν) · aperture(ν). With a picture of equal strength at all
//! frequencies (random pixels) what is lost above B, relative to what there is, is at most
//! `E(B)² = ∫_B |pixel·optics·aperture|² ν dν / ∫_0 (the same)`. The optics are those of a perfect lens with the pupil's diameter
//! at [`LONG_NM`], the aperture is that of the densest cones of the patch, a pixel is a square as wide as its smallest rectangle.

use std::f64::consts::{FRAC_PI_4, PI};

use glam::DVec2;

use super::setup::{Setup, UM_PER_TANGENT, cutoff};
use crate::experiment::Experiment;
use crate::retina::{Density, RegionUm};

/// Wavelength at which the perfect lens passes no less than a real eye at those that cones catch best, nm.
const LONG_NM: f64 = 500.0;
/// E(B) per accuracy target.
const LOSS: f64 = 0.3;
/// Steps of the integral.
const STEPS: u32 = 400;

/// Highest frequency kept for a patch, cycles per unit tangent: the eye's own, or where E(B) is small against the accuracy target.
pub fn band(experiment: &Experiment, setup: &Setup, region: &RegionUm) -> f64 {
    let target = experiment.accuracy_target;
    let cutoff = cutoff(experiment);
    if target < 5e-4 {
        return cutoff;
    }
    let density = Density::new(&setup.retina);
    let nearest = DVec2::ZERO.clamp(region.min, region.max);
    // Not nearer than half a degree: of the foveal peak only few cones are made.
    let aperture_um2 = 1e6 * density.coverage(nearest) / density.per_mm2(nearest);
    let display = &experiment.display;
    let side = |r: &[f64; 4]| (r[2] - r[0]).min(r[3] - r[1]);
    let pixel = display.primaries.iter().flat_map(|p| &p.rects).map(side).fold(1.0, f64::min);
    let pixel = pixel * display.pixel_pitch_cm / display.distance_cm;
    let aperture = (aperture_um2 / FRAC_PI_4).sqrt() / UM_PER_TANGENT;
    let lens = experiment.eye.pupil_mm * 1e6 / LONG_NM;
    // An aberrated pupil passes far less than the perfect one: limits for small pixels.
    let most = cutoff.min(if target >= 0.005 { 90.0 } else { 130.0 } * 180.0 / PI);
    let part = |i: u32| {
        let nu = most * (f64::from(i) + 0.5) / f64::from(STEPS);
        // The mean over directions of the square's transform squared is near that of a disc of the same area.
        let value = disc(nu * pixel / FRAC_PI_4.sqrt()) * disc(nu * aperture) * transfer(nu / lens);
        value * value * nu
    };
    let parts: Vec<f64> = (0..STEPS).map(part).collect();
    let total: f64 = parts.iter().sum();
    let mut lost = 0.0;
    let mut kept = STEPS;
    while kept > 1 {
        lost += parts[kept as usize - 1];
        if lost > (LOSS * target).powi(2) * total {
            break;
        }
        kept -= 1;
    }
    (most * f64::from(kept) / f64::from(STEPS)).min(cutoff)
}

/// Transform of a disc of diameter 1 at ν = `x`, 1 at 0; beyond its first zero its envelope.
fn disc(x: f64) -> f64 {
    let z = PI * x;
    if z > 2.9 {
        return (8.0 / PI).sqrt() * z.powf(-1.5);
    }
    // 2 J1(z)/z by its power series.
    let q = -0.25 * z * z;
    1.0 + q / 2.0 * (1.0 + q / 6.0 * (1.0 + q / 12.0 * (1.0 + q / 20.0 * (1.0 + q / 30.0))))
}

/// Transfer of a perfect lens at a part of its cutoff.
fn transfer(x: f64) -> f64 {
    if x >= 1.0 { 0.0 } else { 2.0 / PI * (x.acos() - x * (1.0 - x * x).sqrt()) }
}

#[cfg(test)]
mod tests {
    use super::{disc, transfer};

    #[test]
    fn transforms_begin_at_one_and_fall() {
        assert!((disc(0.0) - 1.0).abs() < 1e-12 && (transfer(0.0) - 1.0).abs() < 1e-12);
        // 2 J1(z)/z at z = 1 and 2.
        assert!((disc(1.0 / std::f64::consts::PI) - 0.880_101_17).abs() < 1e-6);
        assert!((disc(2.0 / std::f64::consts::PI) - 0.576_724_81).abs() < 1e-3);
        assert!((0..100).all(|i| transfer(f64::from(i + 1) / 100.0) < transfer(f64::from(i) / 100.0)));
    }
}
