//! Scattered light that cones receive: Poisson numbers, by what becomes of the photons.
//!
//! Of A photons that arrive at an aperture (with the pupil's apodization in them), A/t enter it from any
//! direction, t the throughput; A·P are guided, P the cone's factor; I/(2/3) are absorbed and I isomerize.
//! The numbers of each fate are Poisson and independent, a split Poisson process. What was scattered out of
//! the image and comes to no cone fell between the cones.

use super::{Paper, Tally};
use crate::cone::ISOMERIZATION;
use crate::exposure::light::Shown;
use crate::exposure::poisson;
use crate::exposure::source::Projector;
use crate::exposure::stray::{Received, Veil};
use crate::rng::{Purpose, Stream};

/// The scattered light of a patch.
pub(super) struct Scattered {
    pub(super) veil: Veil,
    /// Stable numbers of the cones.
    pub(super) ids: Vec<u64>,
    /// Fraction of the light that cones aimed at the pupil's centre accept.
    pub(super) throughput: f64,
}

impl Scattered {
    /// Draws a frame's photons.
    pub(super) fn count(&self, (shown, projector): (&Shown, &Projector), paper: &Paper, tally: &mut Tally) {
        let received = self.veil.received(shown, projector);
        let frame = u64::from(shown.index);
        let (mut mean, mut isomerized) = (0.0, 0.0);
        for (cone, (id, count)) in self.ids.iter().zip(&mut tally.counts).enumerate() {
            let mut stream = Stream::new(paper.seed, Purpose::Scattered, frame, *id);
            let own = received.isomerized.iter().map(|primary| primary[cone]).sum();
            let photons = poisson::from_stream(&mut stream, own).min(f64::from(u32::MAX));
            *count = count.saturating_add(photons as u32);
            tally.budget.isomerized[paper.cones[cone].cone_type as usize] += photons;
            (mean, isomerized) = (mean + own, isomerized + photons);
        }
        let mut stream = Stream::new(paper.seed, Purpose::Scattered, frame, u64::MAX);
        let came = isomerized + self.lost((&received, mean), &mut stream, tally);
        tally.budget.between_cones += (tally.scattered as f64 - came).max(0.0);
    }

    /// The fates of arriving photons that isomerize nothing; their number.
    fn lost(&self, (received, isomerized): (&Received, f64), stream: &mut Stream, tally: &mut Tally) -> f64 {
        let absorbed = isomerized / ISOMERIZATION;
        let entered = received.arrived / self.throughput;
        let means = [entered - received.guided, received.guided - absorbed, absorbed - isomerized];
        let [unguided, unabsorbed, unused] = means.map(|mean| poisson::from_stream(stream, mean));
        tally.budget.stiles_crawford += unguided;
        tally.budget.not_absorbed += unabsorbed;
        tally.budget.not_isomerized += unused;
        unguided + unabsorbed + unused
    }
}
