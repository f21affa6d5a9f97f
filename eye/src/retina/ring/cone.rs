//! One cone of the live ring.

use glam::DVec2;

use super::super::field::Field;
use super::super::local::Metric;
use super::texture::texture;
use crate::rng::{Purpose, Stream};

/// `b` of the random stream of a cone's radius and kicks.
const CONE_STREAM: u64 = 3;
/// Radii stay within this many standard deviations.
const RADIUS_SIGMAS: f64 = 2.5;

/// A cone that is held in memory.
#[derive(Clone, Debug)]
pub(super) struct Cone {
    /// Birth number.
    pub(super) id: u64,
    /// Centre, µm of the chart.
    pub(super) at: DVec2,
    /// Metric of the birth place, once frozen of the final place.
    pub(super) metric: Metric,
    /// Nominal radius, µm across the cone; of the birth place for good (§15).
    pub(super) radius: f64,
    /// Hexagonal spacing of the target density, µm; of the birth place, once frozen of the final place.
    pub(super) spacing: f64,
    /// Growth cycle of the ring it was born in; `None` when it fills a void.
    pub(super) ring: Option<u32>,
    /// It moves until this growth cycle at least.
    pub(super) free_until: u32,
    /// It pushes but does not move any more.
    pub(super) frozen: bool,
    /// The voids round it have been looked for once.
    pub(super) searched: bool,
    /// Steps that were cut to the limit.
    pub(super) limited: u8,
    /// Encounters with a cone in the same place.
    pub(super) coincident: u8,
    /// Random numbers of its kicks.
    pub(super) stream: Stream,
}

impl Cone {
    /// A cone born at a place in a growth cycle; `factor` corrects the target spacing (see `front`).
    pub(super) fn born(field: &Field, id: u64, at: DVec2, ring: Option<u32>, factor: f64) -> Self {
        let here = field.local(at);
        let spacing = field.spacing_with(at, here.cos_tilt);
        let texture = texture(field, at.length());
        let mut stream = Stream::new(field.params.seed, Purpose::Mosaic, id, CONE_STREAM);
        let normal = stream.normal_pair().0.clamp(-RADIUS_SIGMAS, RADIUS_SIGMAS);
        let radius = texture.radius * (1.0 + texture.spread * normal);
        Self {
            id,
            at,
            metric: here.metric,
            radius: 0.5 * radius * factor * spacing,
            spacing,
            ring,
            free_until: 0,
            frozen: false,
            searched: false,
            limited: 0,
            coincident: 0,
            stream,
        }
    }
}

/// Squared distance of two cones across their mean direction.
#[inline]
pub(super) fn length2(p: (&Metric, DVec2), n: (&Metric, DVec2)) -> f64 {
    0.5 * p.0.plus(n.0).length2(n.1 - p.1)
}
