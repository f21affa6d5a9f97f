//! Light scattered in the eye: a veil over the image.
//!
//! The image keeps 1 − s of its light ([`angle`]: the function S of the angle and its integral s). A cone at x
//! receives as from a screen that sends `V(x) = ω_x Σ_j N_j e_j S(θ_xj)` photons a pixel (1): ω is the solid
//! angle of a pixel at the cone's place, N the photons of pixel j into the pupil as if it were at the gaze
//! centre, e the obliquity factor of the screen and the pupil at the pixel's own place. So light is spread as it
//! entered: `∫ V dx` over all directions is s of the light in the pupil, wherever it came from.
//!
//! V is a sum over light from near by (`near`, a convolution) and from afar (`far`, blocks); pixels of any
//! size are integrated over their rectangles (`lattice`).
//!
//! # Accuracy
//! 1 % of V, of pixels of any size at any distance; see `tests/validity/stray.rs`.
//!
//! # Cost
//! A screen of 1280 x 1024 pixels, a tile of 3.4° with 45,000 cones, two primaries, two cores: 0.6 s to prepare,
//! 0.1 s a frame.

pub mod angle;
mod chart;
mod far;
mod lattice;
mod near;

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::bounds;
use super::cones::ConeTable;
use super::expected::Means;
use super::inputs::Inputs;
use super::kernel::Kernels;
use super::light::{Course, Shown, Window, courses};
use super::primaries::Primaries;
use super::source::Projector;
use super::spectral::ARRIVING;
use crate::experiment::{Experiment, StrayLight};
use angle::Scatter;
use chart::{Chart, Screen, away};
use far::Far;
use near::Near;

/// One cone's part in the veil.
struct Receiver {
    /// Centre, pixels of the display.
    px: DVec2,
    /// Isomerizations and arriving photons per unit of V/ω, by primary, and the pointing factor.
    per_light: Vec<[f64; 2]>,
    pointing: f64,
}

/// The veil of a scene.
pub struct Veil {
    fraction: f64,
    /// Where pixels are.
    scene: super::scene::Scene,
    screen: crate::optics::Screen,
    chart: Chart,
    near: Option<Near>,
    far: Far,
    receivers: Vec<Receiver>,
}

/// What the cones receive of the veil, by primary.
pub struct Received {
    /// `[primary][cone]`: isomerizations.
    pub isomerized: Vec<Vec<f64>>,
    /// Photons that arrive at all cones.
    pub arrived: f64,
    /// The same after the cones' pointing errors.
    pub guided: f64,
}

impl Veil {
    /// Prepares the veil over a tile's cones.
    ///
    /// # Errors
    /// When the embedded tables or the display's spectra cannot be read.
    pub fn new(
        (experiment, inputs): (&Experiment, &Inputs),
        primaries: &Primaries,
        cones: &ConeTable,
        stray: StrayLight,
    ) -> Result<Self, String> {
        let scatter = Scatter::new(experiment, stray)?;
        let Primaries { kernels, projector } = primaries;
        let screen = Screen::new(&inputs.scene, &inputs.beams, &projector.display);
        let sight = projector.gaze.bounds().map(|at| DVec2::new(at.x, -at.y));
        let per_px = inputs.scene.tangent_per_px;
        let (shift_min, shift_max) = (sight[0].min(sight[1]) / per_px, sight[0].max(sight[1]) / per_px);
        let receivers = receivers(kernels, cones, &screen);
        let (min, max) = bounds(receivers.iter().map(|r| r.px).chain(none(&receivers)));
        let chart = Chart::new(screen.way(0.5 * (min + max + shift_min + shift_max)));
        let places = receivers.iter().flat_map(|r| {
            let corners = [
                shift_min,
                shift_max,
                DVec2::new(shift_min.x, shift_max.y),
                DVec2::new(shift_max.x, shift_min.y),
            ];
            corners.map(|shift| chart.at(screen.way(r.px + shift)))
        });
        let (min, max) = bounds(places.chain(none(&receivers)));
        let around = (&chart, [min, max]);
        let near = Near::new(&screen, around, &projector.emitters, &scatter);
        let far = Far::new(&screen, around, &projector.emitters, &scatter);
        let (scene, screen) = (inputs.scene.clone(), *inputs.beams.screen());
        Ok(Self { fraction: scatter.fraction(), scene, screen, chart, near, far, receivers })
    }

    /// Fraction of the light that stays in the image.
    pub fn kept(&self) -> f64 {
        1.0 - self.fraction
    }

    /// Takes the scattered light from the means of a frame and adds the veil.
    pub fn add(&self, means: &mut Means, shown: &Shown, projector: &Projector) {
        let kept = self.kept();
        means.isomerized.iter_mut().for_each(|mean| *mean *= kept);
        let received = self.received(shown, projector);
        for part in &received.isomerized {
            means.isomerized.iter_mut().zip(part).for_each(|(mean, more)| *mean += more);
        }
        means.arrived = means.arrived * kept + received.arrived;
        means.guided = means.guided * kept + received.guided;
    }

    /// What the cones receive in a frame.
    pub fn received(&self, shown: &Shown, projector: &Projector) -> Received {
        let display = &projector.display;
        let window = Window { first: [0; 2], size: [display.width_px, display.height_px] };
        let width = display.width_px as usize;
        let all: Vec<Vec<Course>> =
            projector.emitters.iter().map(|emitter| courses(emitter, display, shown.index)).collect();
        let lights: Vec<Vec<f64>> = (projector.emitters.par_iter().zip(&all))
            .map(|(emitter, courses)| window.frame_light(display, emitter, courses, shown))
            .collect();
        let numbered: Vec<(usize, &[f64])> = lights.iter().map(Vec::as_slice).enumerate().collect();
        let pairs: Vec<_> = numbered.chunks(2).collect();
        let near: Vec<Vec<Complex64>> = match &self.near {
            Some(near) => pairs.par_iter().map(|pair| near.light(pair, width)).collect(),
            None => Vec::new(),
        };
        let far: Vec<Vec<f64>> =
            numbered.par_iter().map(|(emitter, light)| self.far.light(*emitter, light, width)).collect();
        let mut received = Received { isomerized: Vec::new(), arrived: 0.0, guided: 0.0 };
        for (primary, emitter) in projector.emitters.iter().enumerate() {
            let photons = emitter.emitted() * projector.pupil_share;
            let shift = mean_sight(&all[primary], projector, shown.index);
            let value = |receiver: &Receiver| {
                let place = self.chart.at(self.scene_way(receiver.px + shift));
                let near =
                    self.near.as_ref().map_or(0.0, |one| one.read(&near[primary / 2], place, primary % 2));
                photons * (near + self.far.read(&far[primary], place)).max(0.0)
            };
            let light: Vec<f64> = self.receivers.par_iter().with_min_len(256).map(value).collect();
            let parts = self.receivers.iter().zip(&light);
            received
                .isomerized
                .push(parts.clone().map(|(r, light)| r.per_light[primary][0] * light).collect());
            for (receiver, light) in parts {
                let arriving = receiver.per_light[primary][1] * light;
                received.arrived += arriving;
                received.guided += arriving * receiver.pointing;
            }
        }
        received
    }

    /// Direction of a point of the display, pixels.
    fn scene_way(&self, px: DVec2) -> glam::DVec3 {
        let first = DVec2::new(f64::from(self.scene.first_px[0]), f64::from(self.scene.first_px[1]));
        away(self.screen.way(self.scene.tangent(px - first)))
    }
}

/// A point for a tile without cones.
fn none(receivers: &[Receiver]) -> Option<DVec2> {
    receivers.is_empty().then_some(DVec2::ZERO)
}

/// The line of sight on average over the time that a primary is lit, pixels (x right, y down).
fn mean_sight(courses: &[Course], projector: &Projector, index: u32) -> DVec2 {
    let per_px = projector.display.pixel_pitch_cm / projector.display.distance_cm;
    let frame_s = 1.0 / projector.display.frame_rate_hz;
    let segments = courses.iter().flat_map(|c| c.segments(&projector.gaze, index, frame_s, per_px));
    let (mut sum, mut shares) = (DVec2::ZERO, 0.0);
    for segment in segments {
        sum += segment.share * 0.5 * (segment.sight[0] + segment.sight[1]);
        shares += segment.share;
    }
    if shares > 0.0 { sum / shares } else { DVec2::ZERO }
}

/// The cones as they receive an even field.
fn receivers(kernels: &Kernels, cones: &ConeTable, screen: &Screen) -> Vec<Receiver> {
    let primaries = kernels.shares().len();
    // Fraction of an even field's photons, by primary.
    let even = |kind: usize, cone: &super::cones::MappedCone| -> Vec<f64> {
        let own = kernels.coefficients(kind, cone.um, cone.ecc_deg);
        let of = |k: usize| own.iter().enumerate().map(|(r, c)| c * kernels.table(kind, r, k)[0].re).sum();
        (0..primaries).map(of).collect()
    };
    cones
        .cones
        .par_iter()
        .map(|cone| {
            let corners = &cone.polygon_px;
            let next = corners.iter().cycle().skip(1);
            let area = 0.5 * corners.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>().abs();
            let centre = corners.iter().sum::<DVec2>() / corners.len().max(1) as f64;
            let px = screen.display_px(centre);
            // Kernels hold the light that enters from the cone's own place; scattered light has that of its sources in it.
            let received = area * screen.solid_angle(px) / screen.entering(px); // (1)
            let parts = even(cone.cone_type as usize, cone).into_iter().zip(even(ARRIVING, cone));
            let per_light =
                parts.map(|(own, all)| [received * cone.pointing * own, received * all]).collect();
            Receiver { px, per_light, pointing: cone.pointing }
        })
        .collect()
}
