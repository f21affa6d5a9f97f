//! What the apertures that were not chosen would change, over a patch of retina.
//!
//! A cone counts in proportion to its aperture. At a place where the chosen law fills the fraction c of a
//! cell and the other one the fraction o, counts would change by o/c - 1. No unit.

use glam::DVec2;

use crate::retina::{Aperture, Density, RegionUm, RetinaParams};

/// Points along each side of the patch at which the laws are compared.
const STEPS: u32 = 32;

/// Relative changes of the counts of cones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Visual degrees of the place nearest to the foveal centre, and the change there.
    pub nearest: (f64, f64),
    /// Visual degrees of the place farthest from it, and the change there.
    pub farthest: (f64, f64),
    /// Largest size of a change in the patch.
    pub largest: f64,
}

/// The other aperture.
pub const fn other(chosen: Aperture) -> Aperture {
    match chosen {
        Aperture::Cell => Aperture::InnerSegment,
        Aperture::InnerSegment => Aperture::Cell,
    }
}

/// The change from the chosen apertures to the other ones.
pub fn change(chosen: &RetinaParams, region: &RegionUm) -> Change {
    let with = Density::new(chosen);
    let without = Density::new(&RetinaParams { aperture: other(chosen.aperture), ..chosen.clone() });
    let at = |place: DVec2| without.coverage(place) / with.coverage(place) - 1.0;
    let told = |place: DVec2| (with.visual_deg(place), at(place));

    // Take the ends of the patch.
    let nearest = DVec2::ZERO.clamp(region.min, region.max);
    let outward = region.max.abs().cmpgt(region.min.abs());
    let farthest = DVec2::select(outward, region.max, region.min);

    // Look for the largest change between them.
    let step = (region.max - region.min) / f64::from(STEPS);
    let places = (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |j| DVec2::new(f64::from(i), f64::from(j))));
    let sizes = places.map(|k| at(region.min + k * step).abs());
    let (nearest, farthest) = (told(nearest), told(farthest));
    let largest = sizes.fold(nearest.1.abs().max(farthest.1.abs()), f64::max);
    Change { nearest, farthest, largest }
}
