//! Light scattered on a cone, as the sum over all pixels of the display that it is: `ω Σ_j N_j e_j ∫ S(θ)
//! dA`, each pixel by itself, over the area of its rectangles where it is near: cut until a part is no wider
//! than an eighth of its distance or 0.03°, nine Gauss nodes each. Shares the function S of the angle with
//! the engines, no block, grid or transform.

use glam::{DVec2, DVec3};

use super::super::cones::entering;
use super::super::light::{Course, Shown, frame_light};
use super::super::source::Projector;
use super::super::stray::angle::Scatter;
use crate::display::Emitter;
use crate::optics::BeamField;
use crate::psf::quadrature::gauss_legendre;

/// A pixel that is farther than so many times its pitch is a point.
const FAR: f64 = 20.0;
/// Widest part of a pixel, degrees, or by its distance.
const PART_DEG: f64 = 0.03;
const PART: f64 = 0.125;
/// Gauss-Hermite rule with three points for a standard normal number.
const SPOT: [(f64, f64); 3] =
    [(-1.732_050_807_568_877, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877, 1.0 / 6.0)];

/// A cone before the display.
pub struct Seen<'a> {
    /// Light and movement.
    pub projector: &'a Projector,
    /// Screen and eye.
    pub beams: &'a BeamField,
    /// What is shown.
    pub shown: &'a Shown<'a>,
    /// Point of the display at the gaze centre, pixels.
    pub gaze_px: DVec2,
    /// Point of the display that the cone sees at rest, pixels, and where it is seen on average while a
    /// primary is lit.
    pub cone_px: DVec2,
    pub sight_px: DVec2,
}

impl Seen<'_> {
    fn per_px(&self) -> f64 {
        self.projector.display.pixel_pitch_cm / self.projector.display.distance_cm
    }

    fn tangent(&self, px: DVec2) -> DVec2 {
        let from = (px - self.gaze_px) * self.per_px();
        DVec2::new(from.x, -from.y)
    }

    /// Direction of a point of the display, of any length.
    fn way(&self, px: DVec2) -> DVec3 {
        self.beams.screen().way(self.tangent(px))
    }

    /// Light that a pixel's area at the cone's place receives, relative to that of a pixel into the pupil.
    pub fn light(&self, emitter: &Emitter, courses: &[Course], scatter: &Scatter) -> f64 {
        let display = &self.projector.display;
        let here = self.way(self.cone_px + self.sight_px).normalize();
        let solid_angle = self.per_px().powi(2) * self.beams.screen().solid_angle(self.tangent(self.cone_px));
        let middle = emitter.rects.iter().fold(DVec2::ZERO, |sum, ([x0, y0, x1, y1], share)| {
            sum + share * 0.5 * DVec2::new(x0 + x1, y0 + y1)
        });
        let mut sum = 0.0;
        for row in 0..display.height_px {
            for column in 0..display.width_px {
                let light = frame_light(display, emitter, courses, self.shown, [column, row]);
                if light <= 0.0 {
                    continue;
                }
                let corner = DVec2::new(f64::from(column), f64::from(row));
                let theta = self.angle(corner + middle, here);
                let near = theta < FAR * self.per_px().to_degrees();
                sum += light
                    * if near {
                        self.pixel(emitter, corner, here, scatter)
                    } else {
                        scatter.per_sr(theta) * self.entering(corner + middle)
                    };
            }
        }
        sum * solid_angle
    }

    fn entering(&self, px: DVec2) -> f64 {
        entering(self.projector.display.emission_law, self.beams, self.tangent(px))
    }

    fn angle(&self, px: DVec2, here: DVec3) -> f64 {
        let there = self.way(px);
        there.cross(here).length().atan2(there.dot(here)).to_degrees()
    }

    /// Mean over the rectangles of a pixel.
    fn pixel(&self, emitter: &Emitter, corner: DVec2, here: DVec3, scatter: &Scatter) -> f64 {
        let spot = |x: f64, y: f64| emitter.spot_sd_px * DVec2::new(x, y);
        let spots: Vec<(DVec2, f64)> = if emitter.spot_sd_px > 0.0 {
            SPOT.iter().flat_map(|(x, v)| SPOT.iter().map(move |(y, w)| (spot(*x, *y), v * w))).collect()
        } else {
            vec![(DVec2::ZERO, 1.0)]
        };
        let mut sum = 0.0;
        for ([x0, y0, x1, y1], share) in &emitter.rects {
            for (shift, weight) in &spots {
                let ends = [DVec2::new(*x0, *y0), DVec2::new(*x1, *y1)].map(|end| corner + end + *shift);
                sum += share * weight * self.part(ends, here, scatter);
            }
        }
        sum
    }

    /// Mean over a rectangle.
    fn part(&self, [from, to]: [DVec2; 2], here: DVec3, scatter: &Scatter) -> f64 {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let most = PART_DEG.max(PART * self.angle(middle, here));
        let wide = [half.x, half.y].map(|half| 2.0 * half * self.per_px().to_degrees() > most);
        if wide[0] || wide[1] {
            // Halved along the longer side.
            let cut = if half.x > half.y { DVec2::new(middle.x, to.y) } else { DVec2::new(to.x, middle.y) };
            let other = from + to - cut;
            return 0.5 * (self.part([from, cut], here, scatter) + self.part([other, to], here, scatter));
        }
        let rule = gauss_legendre(3);
        let at = |(u, v): (f64, f64)| {
            let px = middle + half * DVec2::new(u, v);
            scatter.per_sr(self.angle(px, here)) * self.entering(px)
        };
        rule.iter().flat_map(|(u, v)| rule.iter().map(move |(x, w)| 0.25 * v * w * at((*u, *x)))).sum()
    }
}
