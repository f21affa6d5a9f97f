//! Random bits of the photons of one piece of work: a hashed counter, so that every photon has numbers of its own, whatever was drawn
//! before it.

use glam::DVec2;

use crate::rng::mixed;

/// 2^-32.
const UNIT: f64 = 1.0 / 4_294_967_296.0;
/// Purposes of a photon's words; up to 8.
pub(super) const PLACE: u64 = 0;
/// Below: whether it is counted; above: its time.
pub(super) const COUNT_TIME: u64 = 1;
/// Below: cell of the point spread; above: whether it is one of the core.
pub(super) const CELL: u64 = 2;
/// Below: place in the cell; above: field node.
pub(super) const JITTER_NODE: u64 = 3;
/// Pixel, where it is drawn.
pub(super) const PIXEL: u64 = 4;
/// The key of more words, for what few photons need.
const MORE: u64 = 7;

/// The words of the photons of one piece.
#[derive(Clone, Copy)]
pub(super) struct Words {
    pub(super) key: u64,
}

/// Any number of words.
pub(super) struct Dice {
    key: u64,
    counter: u64,
}

impl Words {
    /// 64 bits of a photon for a purpose.
    #[inline]
    pub(super) fn of(self, photon: u64, purpose: u64) -> u64 {
        mixed(self.key, (photon << 3) | purpose)
    }

    /// Two uniform numbers of 32 bits in [0, 1).
    #[inline]
    pub(super) fn pair(self, photon: u64, purpose: u64) -> DVec2 {
        pair(self.of(photon, purpose))
    }

    /// A uniform number of 32 bits in [0, 1).
    #[inline]
    pub(super) fn one(self, photon: u64, purpose: u64) -> f64 {
        unit((self.of(photon, purpose) >> 32) as u32)
    }

    /// More words for a photon; different ones for each `what`.
    pub(super) fn more(self, photon: u64, what: u64) -> Dice {
        Dice { key: mixed(self.of(photon, MORE), what), counter: 0 }
    }
}

impl Dice {
    pub(super) fn bits(&mut self) -> u64 {
        self.counter += 1;
        mixed(self.key, self.counter)
    }

    /// Two uniform numbers of 32 bits in [0, 1).
    pub(super) fn pair(&mut self) -> DVec2 {
        pair(self.bits())
    }
}

#[inline]
fn pair(bits: u64) -> DVec2 {
    DVec2::new(unit(bits as u32), unit((bits >> 32) as u32))
}

/// A uniform number in [0, 1).
#[inline]
pub(super) fn unit(bits: u32) -> f64 {
    f64::from(bits) * UNIT
}
