//! The list of counted photons: when each left and its wavelength.
//!
//! Time: the inverse of the light's course, from the number that decided the line of sight. Wavelength: of the samples λ_i of the primary's
//! spectrum near the wavelength node m, with the chance that a cone of type T at eccentricity e that counted a photon of the node has
//! counted this one, `share(λ_i) hat_m(λ_i) τ(λ_i, e) q_T(λ_i, e)`, between steps of e as the weights are.

use super::dice::{Words, unit};
use super::tables::{Caught, ECC_STEPS};
use crate::exposure::Photon;
use crate::exposure::light::Course;
use crate::exposure::spectral::{ARRIVING, Absorbers, KINDS, Paths, Share};

/// Most photons in the list of one frame and tile: 20 bytes each, 15 MB, which a client still gets as one message with the counts.
pub const MAX_PHOTONS: usize = 750_000;

/// Wavelengths of the photons of one primary near one node that cones count.
pub(super) struct Wavelengths {
    nm: Vec<f32>,
    /// `[kind][eccentricity][sample]`: sums of the catch, with each sample.
    until: Vec<Vec<Vec<f32>>>,
}

/// What lists the photons of one layer near one node.
pub(super) struct Lister<'a> {
    pub(super) wavelengths: &'a Wavelengths,
    pub(super) course: &'a Course,
    /// Number of the frame, and its length, s.
    pub(super) frame: u32,
    pub(super) frame_s: f64,
}

impl Wavelengths {
    /// Of the shares of a primary near node number `node`, at the steps of eccentricity.
    pub(super) fn new(
        absorbers: &Absorbers,
        shares: &[Share],
        (nodes_nm, node): (&[f64], usize),
        ecc_deg: impl Fn(usize) -> f64,
        paths: Paths,
    ) -> Self {
        let hat = |nm: f64| {
            let side = |end: Option<&f64>| match end {
                Some(end) => ((nm - end) / (nodes_nm[node] - end)).clamp(0.0, 1.0),
                None => 1.0,
            };
            let below = node.checked_sub(1).and_then(|below| nodes_nm.get(below));
            if nm <= nodes_nm[node] { side(below) } else { side(nodes_nm.get(node + 1)) }
        };
        let near: Vec<Share> =
            shares.iter().map(|(nm, share)| (*nm, share * hat(*nm))).filter(|near| near.1 > 0.0).collect();
        let sums = |kind: usize, step: usize| {
            let mut sum = 0.0;
            let until = near.iter().map(|(nm, share)| {
                sum += share * absorbers.caught_at(KINDS[kind], *nm, ecc_deg(step), paths);
                sum as f32
            });
            until.collect()
        };
        let of_kind = |kind: usize| (0..=ECC_STEPS).map(|step| sums(kind, step)).collect();
        Self {
            nm: near.iter().map(|near| near.0 as f32).collect(),
            until: (0..ARRIVING).map(of_kind).collect(),
        }
    }

    /// A wavelength for two uniform numbers.
    fn draw(&self, caught: &Caught, [which, uniform]: [f64; 2]) -> f32 {
        let steps = &self.until[caught.kind];
        let total = |step: usize| f64::from(steps[step].last().copied().unwrap_or(0.0));
        let t = f64::from(caught.t);
        let (below, above) = ((1.0 - t) * total(caught.below), t * total(caught.below + 1));
        let step = caught.below + usize::from(which * (below + above) >= below);
        let wanted = uniform * total(step);
        let sample = steps[step].partition_point(|until| f64::from(*until) <= wanted);
        self.nm.get(sample).or(self.nm.last()).copied().unwrap_or(0.0)
    }
}

impl Lister<'_> {
    /// A photon that a cone has counted.
    pub(super) fn photon(
        &self,
        time: u32,
        (words, photon): (Words, u64),
        cone: u32,
        caught: &Caught,
    ) -> Photon {
        let time = self.course.time(unit(time));
        let pair = words.more(photon, 3).pair();
        Photon {
            time_s: (f64::from(self.frame) + time) * self.frame_s,
            wavelength_nm: self.wavelengths.draw(caught, [pair.x, pair.y]),
            cone,
        }
    }
}
