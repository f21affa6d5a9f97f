//! The highest spatial frequency that a patch of retina needs.
//!
//! A cone's mean holds a picture's frequency ν times pixel(ν) · optics(ν) · aperture(ν). With a picture of equal strength at all
//! frequencies (random pixels) what is lost above B, relative to what there is, is at most
//! `E(B)² = ∫_B |pixel·optics·aperture|² ν dν / ∫_0 (the same)`. The optics are the largest modulus of transfer over a few wavelengths
//! and directions, traced at the middle of a small patch, of a large one at 3 x 3 points with linear interpolation between; the aperture is
//! that of the densest cones of the patch, a pixel is a square as wide as its smallest rectangle.

use std::f64::consts::{FRAC_PI_4, PI};

use glam::DVec2;
use rayon::prelude::*;

use super::setup::{Setup, UM_PER_TANGENT};
use super::{Numerics, PlanError, Rule};
use crate::display::photon_shares;
use crate::experiment::Experiment;
use crate::exposure::transfer::{FieldPoint, extent, wavefronts};
use crate::optics::OpticsError;
use crate::psf::Otf;
use crate::retina::{Density, RegionUm};

/// Parts of a display's light up to the wavelengths that are traced.
const QUANTILES: [f64; 3] = [0.3, 0.55, 0.8];
/// Directions over half a turn.
const DIRECTIONS: u32 = 3;
/// Frequencies at which the transfer is computed, and steps of the integral.
const POINTS: usize = 24;
const STEPS: u32 = 400;

/// Step of the map's second derivatives, unit tangents.
const BEND_STEP: f64 = 2e-3;

/// Parts of half a large patch at which the transfer is traced, along either axis.
const PLACES: [f64; 3] = [-0.95, 0.0, 0.95];

/// The light's way to one place.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Largest modulus of transfer at equal steps of frequency from 0 to the cutoff.
    moduli: Vec<f64>,
    /// Farthest that rays land from the place where they should, unit tangents of the screen.
    pub blur: f64,
    /// Bend of the map from screen to retina: halves of its second derivatives over the first ones, per unit
    /// tangent.
    pub bend: f64,
}

/// The same over the patch.
#[derive(Clone, Debug)]
pub struct Moduli {
    /// Places along x and y, µm.
    axes: [Vec<f64>; 2],
    /// `[y][x]`.
    seen: Vec<Seen>,
}

impl Moduli {
    /// Traces the transfer.
    fn new(experiment: &Experiment, setup: &Setup) -> Result<Self, String> {
        let (middle, half) =
            (0.5 * (setup.region.min + setup.region.max), 0.5 * (setup.region.max - setup.region.min));
        let places = |axis: usize| -> Vec<f64> {
            let parts = if setup.tiles.len() > 1 { &PLACES[..] } else { &PLACES[1..2] };
            parts.iter().map(|p| middle[axis] + p * half[axis]).collect()
        };
        let axes = [places(0), places(1)];
        let at: Vec<DVec2> =
            axes[1].iter().flat_map(|y| axes[0].iter().map(move |x| DVec2::new(*x, *y))).collect();
        let seen = at.par_iter().map(|um| seen(experiment, setup, *um)).collect::<Result<_, _>>()?;
        Ok(Self { axes, seen })
    }

    /// At a place.
    fn at(&self, um: DVec2) -> Seen {
        let [x, y] = [0, 1].map(|axis| weights(&self.axes[axis], um[axis]));
        let mut sum = Seen { moduli: vec![0.0; POINTS], blur: 0.0, bend: 0.0 };
        for (row, wy) in y.iter().enumerate() {
            for (column, wx) in x.iter().enumerate() {
                let seen = &self.seen[row * x.len() + column];
                sum.moduli.iter_mut().zip(&seen.moduli).for_each(|(s, c)| *s += wx * wy * c);
                sum.blur += wx * wy * seen.blur;
                sum.bend += wx * wy * seen.bend;
            }
        }
        sum
    }
}

impl Setup {
    /// What the middle of a patch sees.
    ///
    /// # Errors
    /// When a part of the patch sees no screen or cannot be traced.
    pub fn seen(&self, experiment: &Experiment, region: &RegionUm) -> Result<Seen, PlanError> {
        let moduli = self.moduli.get_or_init(|| Moduli::new(experiment, self));
        Ok(moduli.as_ref().map_err(|e| PlanError::Model(e.clone()))?.at(0.5 * (region.min + region.max)))
    }
}

/// Weights of linear interpolation; the end's value beyond the ends.
fn weights(axis: &[f64], at: f64) -> Vec<f64> {
    let mut weights = vec![0.0; axis.len()];
    let above = axis.partition_point(|node| *node < at).clamp(1, axis.len().max(2) - 1);
    if axis.len() < 2 {
        return vec![1.0];
    }
    let t = ((at - axis[above - 1]) / (axis[above] - axis[above - 1])).clamp(0.0, 1.0);
    (weights[above - 1], weights[above]) = (1.0 - t, t);
    weights
}

/// Highest frequency kept for a patch, cycles per unit tangent: the eye's own, or where E(B) is small against the accuracy target.
pub fn band(experiment: &Experiment, setup: &Setup, region: &RegionUm, seen: &Seen) -> f64 {
    let most = setup.cutoff(experiment);
    if !Rule::CoarseGrids.applies(experiment) {
        return most;
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
    let loss = Numerics::new(experiment).band_loss;
    let part = |i: u32| {
        let x = (f64::from(i) + 0.5) / f64::from(STEPS);
        let nu = most * x;
        // The mean over directions of the square's transform squared is near that of a disc of the same area.
        let value = disc(nu * pixel / FRAC_PI_4.sqrt()) * disc(nu * aperture) * interpolate(&seen.moduli, x);
        value * value * nu
    };
    let parts: Vec<f64> = (0..STEPS).map(part).collect();
    let total: f64 = parts.iter().sum();
    let mut lost = 0.0;
    let mut kept = STEPS;
    while kept > 1 {
        lost += parts[kept as usize - 1];
        if lost > loss.powi(2) * total {
            break;
        }
        kept -= 1;
    }
    most * f64::from(kept) / f64::from(STEPS)
}

/// Traces the light to a place.
fn seen(experiment: &Experiment, setup: &Setup, um: DVec2) -> Result<Seen, String> {
    let point = FieldPoint::new(&setup.projection, um)?;
    let rho = experiment.eye.stiles_crawford_rho10_per_mm2;
    let waves = wavefronts(&setup.projection, &point, &bright_nm(experiment), rho)?;
    let step = setup.cutoff(experiment) / (POINTS - 1) as f64;
    let jobs: Vec<(usize, u32)> =
        (0..waves.len()).flat_map(|wave| (0..DIRECTIONS).map(move |d| (wave, d))).collect();
    let curves: Vec<Vec<f64>> = jobs
        .par_iter()
        .map(|&(wave, d)| {
            let unit = point.frequency_map * DVec2::from_angle(PI * f64::from(d) / f64::from(DIRECTIONS));
            let nus: Vec<f64> = (0..POINTS).map(|i| step * i as f64 * unit.length()).collect();
            let values = Otf::new(&waves[wave]).radial(unit.y.atan2(unit.x), &nus);
            values.iter().map(|z| z.norm()).collect()
        })
        .collect();
    let largest = |i: usize| curves.iter().map(|curve| curve[i]).fold(0.0, f64::max);
    let blur = waves.iter().map(|wave| extent(&point, wave).iter().sum()).fold(0.0, f64::max);
    let bend = bend(setup, point.tangent)?;
    Ok(Seen { moduli: (0..POINTS).map(largest).collect(), blur, bend })
}

/// Largest half of a second derivative of the map from screen to retina over its first one, per unit tangent.
fn bend(setup: &Setup, tangent: DVec2) -> Result<f64, String> {
    let jacobian =
        |t: DVec2| setup.projection.jacobian_um_per_tangent(t).map_err(|e: OpticsError| e.to_string());
    let to_tangents = jacobian(tangent)?.inverse();
    let mut most = 0.0_f64;
    for axis in [DVec2::X, DVec2::Y] {
        let change = jacobian(tangent + BEND_STEP * axis)? - jacobian(tangent - BEND_STEP * axis)?;
        let relative = to_tangents * change * (0.25 / BEND_STEP);
        most = most.max(relative.x_axis.abs().max(relative.y_axis.abs()).max_element());
    }
    Ok(most)
}

/// A few wavelengths of the display's light.
fn bright_nm(experiment: &Experiment) -> Vec<f64> {
    let spectra: Vec<_> = experiment.display.primaries.iter().map(|p| p.spectrum.clone()).collect();
    let mut light: Vec<(f64, f64)> = photon_shares(&spectra).concat();
    light.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = light.iter().map(|l| l.1).sum();
    let mut nodes: Vec<f64> = Vec::new();
    let mut sum = 0.0;
    for (nm, share) in light {
        sum += share;
        while QUANTILES.get(nodes.len()).is_some_and(|part| sum >= part * total) {
            nodes.push(nm);
        }
    }
    nodes.dedup();
    nodes
}

/// Linear interpolation between values at equal steps over [0, 1].
fn interpolate(values: &[f64], x: f64) -> f64 {
    let at = x * (values.len() - 1) as f64;
    let below = (at as usize).min(values.len() - 2);
    values[below] + (values[below + 1] - values[below]) * (at - below as f64)
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

#[cfg(test)]
mod tests {
    use super::disc;

    #[test]
    fn the_transform_of_a_disc() {
        assert!((disc(0.0) - 1.0).abs() < 1e-12);
        // 2 J1(z)/z at z = 1 and 2.
        assert!((disc(1.0 / std::f64::consts::PI) - 0.880_101_17).abs() < 1e-6);
        assert!((disc(2.0 / std::f64::consts::PI) - 0.576_724_81).abs() < 1e-3);
    }
}
