//! The window of the display that a patch of retina sees, and the periodic grid on which its image is computed.
//!
//! Pixel coordinates: x to the right, y down, in pixel pitches from the top left corner of the display. The image is made
//! periodic; the period is a whole number of pixels, so that the picture's spectrum is a small discrete transform repeated, and
//! long enough that no copy of the picture comes nearer than the guard distance to a simulated cone.

use glam::DVec2;

use crate::display::Display;

/// A period may be shorter by this part of the guard distance, for a smaller grid and a good number of pixels.
const SHORTER: f64 = 4.0;
/// A period may be longer by this part of itself, for a good number of pixels.
const LONGER: usize = 32;
/// Largest side of the grid, samples.
pub const MAX_GRID: usize = 6144;

/// Window and grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// First column and row of the display inside the window.
    pub first_px: [u32; 2],
    /// Columns and rows of the display inside the window.
    pub size_px: [u32; 2],
    /// Period, pixels.
    pub period_px: [usize; 2],
    /// Samples in a period.
    pub samples: [usize; 2],
    /// Highest frequency kept, cycles per unit tangent.
    pub band: f64,
    /// Unit tangents (screen distance over viewing distance) in a pixel pitch.
    pub tangent_per_px: f64,
    /// Rectangle of the window that the cones see at rest, pixels from its corner: minimum and maximum.
    pub cones_px: [DVec2; 2],
    /// Point of the display on the foveal centre at rest, pixels.
    centre_px: DVec2,
}

/// What decides window and grid.
#[derive(Clone, Copy, Debug)]
pub struct SceneNeeds {
    /// Point of the display on the foveal centre at rest, pixels.
    pub centre_px: DVec2,
    /// Rectangle of the screen (unit tangents, y up) that the cones see.
    pub cones: [DVec2; 2],
    /// Rectangle of the line of sight's positions on the screen over all frames (unit tangents).
    pub sight: [DVec2; 2],
    /// Distance between a cone and the nearest copy of the blurred picture, up to a quarter less, unit tangents.
    pub guard: f64,
    /// How far rays land from where they should, unit tangents.
    pub blur: f64,
    /// Highest frequency kept, cycles per unit tangent.
    pub band: f64,
    /// Samples per two cycles of that frequency, at least (> 1).
    pub oversampling: f64,
}

impl Scene {
    /// Window and grid for a display.
    ///
    /// # Errors
    /// The needed number of samples when it is above [`MAX_GRID`].
    pub fn new(display: &Display, needs: &SceneNeeds) -> Result<Self, usize> {
        let tangent_per_px = display.pixel_pitch_cm / display.distance_cm;
        let flip = |t: DVec2| DVec2::new(t.x, -t.y) / tangent_per_px;
        let bounds = |[a, b]: [DVec2; 2]| (flip(a).min(flip(b)), flip(a).max(flip(b)));
        let (cones_min, cones_max) = bounds(needs.cones);
        let (sight_min, sight_max) = bounds(needs.sight);
        let shorter = (needs.guard / tangent_per_px / SHORTER) as usize;
        let guard = (needs.guard + needs.blur) / tangent_per_px;
        // A pixel at p is seen at p - sight: the window holds whatever comes within the guard of a cone.
        let last = DVec2::new(f64::from(display.width_px), f64::from(display.height_px));
        let from = (needs.centre_px + cones_min + sight_min - guard).floor().clamp(DVec2::ZERO, last);
        let to = (needs.centre_px + cones_max + sight_max + guard).ceil().clamp(from, last);
        let seen_from = from - needs.centre_px - sight_max;
        let seen_to = to - needs.centre_px - sight_min;
        let reach = (cones_max - seen_from).max(seen_to - cones_min).max(DVec2::ONE) + guard;
        let per_px = 2.0 * needs.oversampling * needs.band * tangent_per_px;
        let samples_of = |p: usize| good_size((per_px * p as f64).ceil().max(16.0) as usize);
        let period = [reach.x, reach.y].map(|reach| good_period(even(reach), shorter, samples_of));
        let samples = period.map(samples_of);
        if let Some(&large) = samples.iter().find(|&&s| s > MAX_GRID) {
            return Err(large);
        }
        Ok(Self {
            first_px: [from.x as u32, from.y as u32],
            size_px: [(to.x - from.x) as u32, (to.y - from.y) as u32],
            period_px: period,
            samples,
            band: needs.band,
            tangent_per_px,
            cones_px: [cones_min, cones_max].map(|p| needs.centre_px + p - from),
            centre_px: needs.centre_px,
        })
    }

    /// A scene that has only a period and a grid.
    #[cfg(test)]
    pub fn for_test(period_px: [usize; 2], samples: [usize; 2]) -> Self {
        let (first_px, size_px) = ([0; 2], [1; 2]);
        Self {
            first_px,
            size_px,
            period_px,
            samples,
            band: 1.0,
            tangent_per_px: 1.0,
            cones_px: [DVec2::ZERO; 2],
            centre_px: DVec2::ZERO,
        }
    }

    /// Pixels from the window's corner, of a point of the screen in unit tangents (y up).
    pub fn window_px(&self, tangent: DVec2) -> DVec2 {
        let corner = DVec2::new(f64::from(self.first_px[0]), f64::from(self.first_px[1]));
        self.centre_px + DVec2::new(tangent.x, -tangent.y) / self.tangent_per_px - corner
    }

    /// Tangent coordinates (y up) of a point in pixels from the window's corner: the inverse of [`Scene::window_px`].
    pub fn tangent(&self, window_px: DVec2) -> DVec2 {
        let corner = DVec2::new(f64::from(self.first_px[0]), f64::from(self.first_px[1]));
        let from_centre = (window_px + corner - self.centre_px) * self.tangent_per_px;
        DVec2::new(from_centre.x, -from_centre.y)
    }

    /// Samples in a pixel pitch.
    pub fn samples_per_px(&self) -> DVec2 {
        DVec2::new(
            self.samples[0] as f64 / self.period_px[0] as f64,
            self.samples[1] as f64 / self.period_px[1] as f64,
        )
    }
}

/// The next even whole number of pixels.
fn even(px: f64) -> usize {
    ((px / 2.0).ceil() as usize).max(1) * 2
}

/// An even period of so many pixels, up to `shorter` fewer or a few more, without large prime factors: where there are many pixels their
/// transform is much of the work. Of those that are not longer the longest of those with the smallest grid.
fn good_period(px: usize, shorter: usize, samples_of: impl Fn(usize) -> usize) -> usize {
    let good = |n: &usize| n.is_multiple_of(2) && has_no_prime_above_eleven(*n);
    let first = px.saturating_sub(shorter).max(2);
    let best = (first..=px).rev().filter(good).min_by_key(|&n| samples_of(n));
    best.or_else(|| (px..=px + px / LONGER).find(good)).unwrap_or(px)
}

fn has_no_prime_above_eleven(mut n: usize) -> bool {
    for p in [2, 3, 5, 7, 11] {
        while n.is_multiple_of(p) {
            n /= p;
        }
    }
    n == 1
}

/// The next even size without prime factors but 2, 3 and at most one of 5, 7 and 11: transforms of others take up to twice as long.
pub fn good_size(at_least: usize) -> usize {
    let smooth = |mut n: usize| {
        n /= [5, 7, 11].into_iter().find(|p| n.is_multiple_of(*p)).unwrap_or(1);
        for p in [2, 3] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    (at_least.next_multiple_of(2)..).step_by(2).find(|&n| smooth(n)).unwrap_or(at_least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_have_small_primes() {
        let even = |n| good_period(n, 18, |_| 1);
        assert_eq!([16, 34, 782, 800, 816].map(even), [16, 32, 770, 800, 810]);
        assert_eq!([22, 26, 782, 1700].map(|n| good_period(n, 1, |_| 1)), [22, 26, 784, 1728]);
        // A period a little shorter has a much smaller grid.
        assert_eq!(good_period(816, 18, |n| if n < 809 { 384 } else { 432 }), 800);
    }

    #[test]
    fn sizes_are_smooth() {
        assert_eq!([16, 17, 91, 391, 441, 641].map(good_size), [16, 18, 96, 396, 448, 648]);
    }
}
