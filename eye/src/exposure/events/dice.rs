//! Random bits of the photons of one piece of work: a hashed counter, so that every photon has numbers of its own, whatever was drawn
//! before it.

use glam::DVec2;

use crate::rng::{COUNT, mixed};

/// 2^-32.
const UNIT: f64 = 1.0 / 4_294_967_296.0;
/// Purposes of a photon's words; up to 8.
/// Below: place in the pixel, twice 16 bits; above: whether it is counted.
pub(super) const PLACE_COUNT: u64 = 0;
/// Below: cell of the point spread; above: place in the cell, twice 16 bits.
pub(super) const CELL_JITTER: u64 = 1;
/// Below: field node, twice 16 bits; above: its time.
pub(super) const NODE_TIME: u64 = 2;
/// Above: pixel, where it is drawn.
pub(super) const PIXEL: u64 = 3;
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
        mixed(self.key, photon.wrapping_mul(8).wrapping_add(purpose))
    }

    /// Before the last step: the words of so many photons one after the other are the finalized sums of the first and multiples of the second.
    #[inline]
    pub(super) fn steps(self, first: u64, purpose: u64) -> [u64; 2] {
        let counter = first.wrapping_mul(8).wrapping_add(purpose);
        [self.key.wrapping_add(counter.wrapping_add(1).wrapping_mul(COUNT)), COUNT.wrapping_mul(8)]
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
        let bits = self.bits();
        DVec2::new(unit(bits as u32), above(bits))
    }
}

/// A uniform number in [0, 1).
#[inline]
pub(super) fn unit(bits: u32) -> f64 {
    f64::from(bits) * UNIT
}

/// A uniform number in [0, 1) in single precision, of the upper 24 bits.
#[inline]
pub(super) fn unit24(bits: u32) -> f32 {
    (bits >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// A uniform number in [0, 1) of the upper half of a word.
#[inline]
pub(super) fn above(bits: u64) -> f64 {
    unit((bits >> 32) as u32)
}

/// The two whole numbers of 16 bits in a half of a word.
#[inline]
pub(super) fn halves(bits: u32) -> [u32; 2] {
    [bits & 0xFFFF, bits >> 16]
}
