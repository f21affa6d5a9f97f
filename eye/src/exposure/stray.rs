//! Light scattered in the eye: a veil over the image.
//!
//! The glare function of the CIE (report 135/1, Vos & van den Berg 1999), equivalent luminance per illuminance at the eye by the angle θ
//! (degrees), 1/sr; its two narrow terms are aberration and diffraction, which the kernels hold; the wide ones are scatter:
//! `f(θ) = (1 + 1.6 (age/70)⁴) (400/(1 + (θ/0.1)²) + 3e-8 θ² + p (1300/(1 + (θ/0.1)²)^1.5 + 0.8/(1 + (θ/0.1)²)^0.5)) + 2.5e-3 p`.
//! It is taken as the same at all wavelengths. The image keeps 1 − ∫f dΩ of its light; a cone at x receives as from a screen that
//! sends `V(x) = Σ_j N_j f(θ_xj) ω_x` photons a pixel, ω the pixel's solid angle.
//!
//! Pixels are taken in blocks of about `BLOCK_DEG`, those further than `NEAR_DEG` in blocks of ten by ten of them; V is computed
//! on a grid as fine as the blocks and interpolated linearly between.

use glam::DVec2;
use rayon::prelude::*;

use super::bounds;
use super::cones::{ConeTable, entering};
use super::expected::Means;
use super::inputs::Inputs;
use super::kernel::Kernels;
use super::light::{Course, Shown, courses, frame_light};
use super::primaries::Primaries;
use super::source::Projector;
use super::spectral::ARRIVING;
use crate::experiment::StrayLight;

/// Side of a small block.
const BLOCK_DEG: f64 = 0.1;
/// Where large blocks begin; a large block is [`LARGE`] small ones wide.
const NEAR_DEG: f64 = 2.5;
const LARGE: usize = 10;
/// Largest grid on which V is computed, points a side.
const MOST_POINTS: f64 = 64.0;

/// f(θ), 1/sr.
pub fn scattered_per_sr(stray: StrayLight, theta_deg: f64) -> f64 {
    let age = 1.0 + 1.6 * (stray.age_years / 70.0).powi(4);
    let fall = 1.0 + (theta_deg / 0.1).powi(2);
    let wall = stray.pigmentation * (1300.0 * fall.powf(-1.5) + 0.8 * fall.powf(-0.5));
    age * (400.0 / fall + 3e-8 * theta_deg * theta_deg + wall) + 2.5e-3 * stray.pigmentation
}

/// Share of the light that is scattered: ∫ f dΩ over the half space, by the midpoint rule in ln(θ + 0.01°).
pub fn scattered_share(stray: StrayLight) -> f64 {
    const STEPS: u32 = 400;
    let (from, to) = (0.01_f64.ln(), 90.01_f64.ln());
    let step = (to - from) / f64::from(STEPS);
    (0..STEPS)
        .map(|i| {
            let at = (from + (f64::from(i) + 0.5) * step).exp();
            let theta = at - 0.01;
            scattered_per_sr(stray, theta) * theta.to_radians().sin() * at.to_radians() * step
        })
        .sum::<f64>()
        * std::f64::consts::TAU
}

/// One cone's part in the veil.
struct Receiver {
    /// Place in the grid of V, points.
    at: DVec2,
    /// Isomerizations and arriving photons per photon a pixel of V, by primary, and the pointing factor.
    per_photon: Vec<[f64; 2]>,
    pointing: f64,
}

/// The veil of a scene.
pub struct Veil {
    share: f64,
    /// Pixels in a small block's side; small blocks in a row; large blocks in a row.
    block_px: u32,
    small: [usize; 2],
    large: [usize; 2],
    /// Slant factor of each small block.
    slant: Vec<f64>,
    /// Points of the grid in a row, and for each point the blocks that count and f ω: small blocks first, large ones from `small` on.
    columns: usize,
    sources: Vec<Vec<(u32, f32)>>,
    px_per_point: f64,
    receivers: Vec<Receiver>,
}

impl Veil {
    /// Prepares the veil over a tile's cones.
    pub fn new(inputs: &Inputs, primaries: &Primaries, cones: &ConeTable, stray: StrayLight) -> Self {
        let Primaries { kernels, projector } = primaries;
        let Inputs { scene, beams, .. } = inputs;
        let display = &projector.display;
        let px_deg = scene.tangent_per_px.to_degrees();
        let block_px = ((BLOCK_DEG / px_deg).floor() as u32).max(1);
        let small = [display.width_px, display.height_px].map(|n| n.div_ceil(block_px) as usize);
        let large = small.map(|n| n.div_ceil(LARGE));
        // Directions of blocks and points, from pixels of the display.
        let first = DVec2::new(f64::from(scene.first_px[0]), f64::from(scene.first_px[1]));
        let tangent = |px: DVec2| scene.tangent(px - first);
        let way = |px: DVec2| tangent(px).extend(1.0).normalize();
        let block = |index: usize, width: usize, side: f64| {
            (DVec2::new((index % width) as f64, (index / width) as f64) + 0.5) * side
        };
        let side = f64::from(block_px);
        let small_at: Vec<DVec2> = (0..small[0] * small[1]).map(|i| block(i, small[0], side)).collect();
        let slant = small_at.iter().map(|px| entering(display.emission_law, beams, tangent(*px))).collect();
        let large_side = side * LARGE as f64;
        let (min, max) = bounds(cones.cones.iter().flat_map(|c| c.polygon_px.iter().map(|p| *p + first)));
        let size = (max - min).max(DVec2::ZERO);
        let px_per_point = side.max(size.max_element() / MOST_POINTS);
        let [columns, rows] = (size / px_per_point).to_array().map(|n| n.ceil() as usize + 2);
        let omega = |px: DVec2| scene.tangent_per_px.powi(2) / (1.0 + tangent(px).length_squared()).powf(1.5);
        let sources = (0..columns * rows)
            .into_par_iter()
            .map(|point| {
                let at = min + DVec2::new((point % columns) as f64, (point / columns) as f64) * px_per_point;
                let (here, omega) = (way(at), omega(at));
                let angle = |px: DVec2| way(px).cross(here).length().atan2(way(px).dot(here)).to_degrees();
                let weight = |px: DVec2| (scattered_per_sr(stray, angle(px)) * omega) as f32;
                let mut list = Vec::new();
                for index in 0..large[0] * large[1] {
                    let middle = block(index, large[0], large_side);
                    if angle(middle) > NEAR_DEG {
                        list.push(((small_at.len() + index) as u32, weight(middle)));
                        continue;
                    }
                    let corner = [(index % large[0]) * LARGE, (index / large[0]) * LARGE];
                    for row in corner[1]..(corner[1] + LARGE).min(small[1]) {
                        for column in corner[0]..(corner[0] + LARGE).min(small[0]) {
                            let child = row * small[0] + column;
                            list.push((child as u32, weight(small_at[child])));
                        }
                    }
                }
                list
            })
            .collect();
        let receivers = receivers(kernels, cones, min - first, px_per_point);
        let share = scattered_share(stray);
        Self { share, block_px, small, large, slant, columns, sources, px_per_point, receivers }
    }

    /// Takes the scattered light from the means of a frame and adds the veil.
    pub fn add(&self, means: &mut Means, shown: &Shown, projector: &Projector) {
        let kept = 1.0 - self.share;
        means.isomerized.iter_mut().for_each(|mean| *mean *= kept);
        (means.arrived, means.guided) = (means.arrived * kept, means.guided * kept);
        let seconds = 1.0 / projector.display.frame_rate_hz;
        for (primary, emitter) in projector.emitters.iter().enumerate() {
            let photons = emitter.emitted() * projector.pupil_share;
            let courses = courses(emitter, &projector.display, shown.index);
            let light =
                |at: [u32; 2]| photons * frame_light(&projector.display, emitter, &courses, shown, at);
            let blocks = self.blocks([projector.display.width_px, projector.display.height_px], light);
            let value = |list: &Vec<(u32, f32)>| {
                list.iter().map(|(block, weight)| f64::from(*weight) * blocks[*block as usize]).sum::<f64>()
            };
            let veil: Vec<f64> = self.sources.par_iter().map(value).collect();
            let shift = mean_sight(&courses, projector, shown.index, seconds) / self.px_per_point;
            for (receiver, mean) in self.receivers.iter().zip(&mut means.isomerized) {
                let light = self.read(&veil, receiver.at + shift);
                let [isomerized, arriving] = receiver.per_photon[primary];
                *mean += isomerized * light;
                means.arrived += arriving * light;
                means.guided += arriving * receiver.pointing * light;
            }
        }
    }

    /// Light of the small blocks, then of the large ones.
    fn blocks(&self, [width, height]: [u32; 2], light: impl Fn([u32; 2]) -> f64) -> Vec<f64> {
        let count = self.small[0] * self.small[1];
        let mut blocks = vec![0.0; count + self.large[0] * self.large[1]];
        for row in 0..height {
            let start = (row / self.block_px) as usize * self.small[0];
            for column in 0..width {
                blocks[start + (column / self.block_px) as usize] += light([column, row]);
            }
        }
        for index in 0..count {
            blocks[index] *= self.slant[index];
            let (column, row) = (index % self.small[0] / LARGE, index / self.small[0] / LARGE);
            let value = blocks[index];
            blocks[count + row * self.large[0] + column] += value;
        }
        blocks
    }

    /// V between its points; the edge's value beyond.
    fn read(&self, veil: &[f64], at: DVec2) -> f64 {
        let rows = veil.len() / self.columns;
        let last = DVec2::new((self.columns - 1) as f64, (rows - 1) as f64);
        let at = at.clamp(DVec2::ZERO, last);
        let below = at.floor().min(last - 1.0);
        let t = at - below;
        let start = below.y as usize * self.columns + below.x as usize;
        let line = |start: usize| veil[start] + t.x * (veil[start + 1] - veil[start]);
        line(start) + t.y * (line(start + self.columns) - line(start))
    }
}

/// The line of sight on average over the time that a primary is lit, pixels (x right, y down).
fn mean_sight(courses: &[Course], projector: &Projector, index: u32, frame_s: f64) -> DVec2 {
    let per_px = projector.display.pixel_pitch_cm / projector.display.distance_cm;
    let segments = courses.iter().flat_map(|c| c.segments(&projector.gaze, index, frame_s, per_px));
    let (mut sum, mut shares) = (DVec2::ZERO, 0.0);
    for segment in segments {
        sum += segment.share * 0.5 * (segment.sight[0] + segment.sight[1]);
        shares += segment.share;
    }
    if shares > 0.0 { sum / shares } else { DVec2::ZERO }
}

/// What the cones receive of a veil on a grid from `corner_px` (pixels from the window's corner).
fn receivers(kernels: &Kernels, cones: &ConeTable, corner_px: DVec2, px_per_point: f64) -> Vec<Receiver> {
    let mean_light = |kind: usize, primary: usize, coefficients: &[f64]| {
        let at_zero = |(r, c): (usize, &f64)| c * kernels.table(kind, r, primary)[0].re;
        coefficients.iter().enumerate().map(at_zero).sum::<f64>()
    };
    cones
        .cones
        .par_iter()
        .map(|cone| {
            let corners = &cone.polygon_px;
            let next = corners.iter().cycle().skip(1);
            let area = 0.5 * corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>().abs();
            let centre = corners.iter().sum::<DVec2>() / corners.len().max(1) as f64;
            let kind = cone.cone_type as usize;
            let (own, arriving) = (
                kernels.coefficients(kind, cone.um, cone.ecc_deg),
                kernels.coefficients(ARRIVING, cone.um, cone.ecc_deg),
            );
            let per_photon = (0..kernels.shares().len()).map(|k| {
                [area * cone.pointing * mean_light(kind, k, &own), area * mean_light(ARRIVING, k, &arriving)]
            });
            let per_photon = per_photon.collect();
            Receiver { at: (centre - corner_px) / px_per_point, per_photon, pointing: cone.pointing }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{scattered_per_sr, scattered_share};
    use crate::experiment::StrayLight;

    /// With its two narrow terms, which the kernels replace, the function is the CIE's general one within 20 % from 3° on (they are two
    /// fits of the same data); at 70 years more than twice as much is scattered as at 20.
    #[test]
    fn the_veil_is_that_of_the_cie() {
        let stray = |age_years| StrayLight { age_years, pigmentation: 0.5 };
        let narrow = |age: f64, theta: f64| {
            let term = |peak: f64, width: f64| peak * (1.0 + (theta / width).powi(2)).powf(-1.5);
            (1.0 - 0.08 * (age / 70.0).powi(4)) * (term(9.2e6, 0.0046) + term(1.5e5, 0.045))
        };
        for (age, theta) in [(20.0_f64, 3.0_f64), (20.0, 10.0), (70.0, 3.0), (70.0, 10.0), (70.0, 30.0)] {
            let general = 10.0 / theta.powi(3)
                + (5.0 / theta.powi(2) + 0.05 / theta) * (1.0 + (age / 62.5).powi(4))
                + 0.0025 * 0.5;
            let ratio = (narrow(age, theta) + scattered_per_sr(stray(age), theta)) / general;
            assert!((0.8..1.25).contains(&ratio), "{age} years, {theta} degrees: {ratio}");
        }
        let (young, old) = (scattered_share(stray(20.0)), scattered_share(stray(70.0)));
        assert!((0.05..0.1).contains(&young) && (2.2..2.8).contains(&(old / young)), "{young} {old}");
    }
}
