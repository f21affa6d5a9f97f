//! Counter-based random numbers: Philox 4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3").
//!
//! A stream is a pure function of (seed, purpose, a, b): the same bytes for any thread, tile, worker or order.

use rand::rand_core::{Infallible, TryRng};

use crate::math;

/// What a stream is for; streams of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Cone positions of the mosaic.
    Mosaic = 1,
    /// Cone types.
    Types = 2,
    /// Pointing error of each cone.
    Pointing = 3,
    /// Poisson counts.
    Counts = 4,
    /// Photons of the `paper` engine.
    Photons = 5,
    /// Rays of the `paper` engine.
    Rays = 6,
    /// Eye movement.
    Movement = 7,
    /// Samples drawn by tests and studies.
    Study = 8,
    /// Cones lost at random.
    Dropout = 9,
    /// Features of a person's eye.
    Eye = 10,
    /// Photons of the `events` engine.
    Events = 11,
    /// Cones that are computed again.
    Audit = 12,
    /// Photons of scattered light.
    Scattered = 13,
}

const MUL: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// Ten rounds of Philox 4x32 on one counter block.
fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let p0 = u64::from(MUL[0]) * u64::from(counter[0]);
        let p1 = u64::from(MUL[1]) * u64::from(counter[2]);
        counter = [
            (p1 >> 32) as u32 ^ counter[1] ^ key[0],
            p1 as u32,
            (p0 >> 32) as u32 ^ counter[3] ^ key[1],
            p0 as u32,
        ];
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    counter
}

/// One random stream. 2^32 blocks of four words long.
#[derive(Clone, Debug)]
pub struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
    block: [u32; 4],
    used: usize,
}

impl Stream {
    /// The stream of `purpose` for item (`a`, `b`), for example (frame, cone). `b` is taken modulo 2^32.
    pub fn new(seed: u64, purpose: Purpose, a: u64, b: u64) -> Self {
        // The key mixes seed, purpose and the high words; the counter holds b, the low word of a and the block number.
        let mixed = philox(
            [seed as u32, (seed >> 32) as u32, (a >> 32) as u32, (b >> 32) as u32],
            [purpose as u32, 0x7068_6F74],
        );
        Self {
            key: [mixed[0], mixed[1]],
            counter: [0, b as u32, a as u32, purpose as u32],
            block: [0; 4],
            used: 4,
        }
    }

    /// The next 32 bits.
    pub fn word(&mut self) -> u32 {
        if self.used == 4 {
            self.block = philox(self.counter, self.key);
            self.counter[0] = self.counter[0].wrapping_add(1);
            self.used = 0;
        }
        self.used += 1;
        self.block[self.used - 1]
    }

    /// 64 bits.
    pub fn bits(&mut self) -> u64 {
        (u64::from(self.word()) << 32) | u64::from(self.word())
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Two independent standard normal numbers (Box-Muller).
    pub fn normal_pair(&mut self) -> (f64, f64) {
        // 1 - u is in (0, 1], so the logarithm is finite.
        let radius = (-2.0 * math::ln(1.0 - self.uniform())).sqrt();
        let (sin, cos) = math::sin_cos(std::f64::consts::TAU * self.uniform());
        (radius * cos, radius * sin)
    }
}

/// Distance of the arguments of [`finalized`] for neighbouring counters.
pub const COUNT: u64 = 0x9E37_79B9_7F4A_7C15;

/// 64 well mixed bits of a key and a counter (SplitMix64, Steele et al. 2014): cheap random numbers where a stream would cost more than
/// what it is for. The key must itself be unique.
#[inline]
pub fn mixed(key: u64, counter: u64) -> u64 {
    finalized(key.wrapping_add(counter.wrapping_add(1).wrapping_mul(COUNT)))
}

/// The finalizer of [`mixed`].
#[inline]
pub fn finalized(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl TryRng for Stream {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(self.word())
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(u64::from(self.word()) | (u64::from(self.word()) << 32))
    }

    fn try_fill_bytes(&mut self, dst: &mut [u8]) -> Result<(), Infallible> {
        for part in dst.chunks_mut(4) {
            let word = self.word().to_le_bytes();
            part.copy_from_slice(&word[..part.len()]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the authors' Random123 library.
    #[test]
    fn philox_known_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            philox([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn streams_differ_in_every_argument() {
        let first = |s: u64, p, a, b| Stream::new(s, p, a, b).word();
        let base = first(1, Purpose::Counts, 2, 3);
        for other in [
            first(2, Purpose::Counts, 2, 3),
            first(1 << 32, Purpose::Counts, 2, 3),
            first(1, Purpose::Mosaic, 2, 3),
            first(1, Purpose::Counts, 3, 3),
            first(1, Purpose::Counts, 2, 4),
            first(1, Purpose::Counts, 2 | (1 << 40), 3),
        ] {
            assert_ne!(base, other);
        }
    }
}
