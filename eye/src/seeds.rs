//! Seeds of an experiment: that of its photon noise, and the one it takes where none is given.

use crate::digest::{Digest, digest_of};
use crate::experiment::{COUNTS_VERSION, Experiment};
use crate::rng::mixed;

impl Experiment {
    /// Seed of everything random in the counts: photons of other mosaics are others, too.
    pub fn noise_seed(&self) -> u64 {
        let mosaic = self.retina.mosaic.as_deref().unwrap_or_default();
        let of_mosaic = mosaic.bytes().fold(self.retina.seed, |key, byte| mixed(key, u64::from(byte)));
        mixed(self.counts.seed, of_mosaic)
    }

    /// A seed that follows from everything but the seeds of counts and movement. It has 53 bits, so that
    /// every JSON reader keeps it.
    ///
    /// # Errors
    /// Never for an experiment that was validated.
    pub fn seed_of_content(&self) -> Result<u64, postcard::Error> {
        let mut seedless = self.clone();
        (seedless.counts.seed, seedless.gaze.seed) = (0, 0);
        let Digest(bytes) = digest_of("default seed", COUNTS_VERSION, &seedless)?;
        let [a, b, c, d, e, f, g, h, ..] = bytes;
        Ok((u64::from_le_bytes([a, b, c, d, e, f, g, h]) >> 11).max(1))
    }
}
