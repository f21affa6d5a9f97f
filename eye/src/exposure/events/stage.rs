//! A batch of photons on their way, stage by stage: each stage is a short loop over arrays, so that many loads of memory are under way at a
//! time and what is alike for all is done for several at once. What few photons need is done apart, so that no loop has to guess.
//!
//! Places on the retina are in bins of the cones' index from an origin near the block's image, in single precision: good to 1e-4 of a bin.

use multiversion::multiversion;

use super::dice::{CELL_JITTER, NODE_TIME, PLACE_COUNT, Words};
use super::piece::{Tally, Wave};
use super::tables::Field;
use crate::retina::{ConeIndex, Origin};

/// Photons of a batch.
pub(super) const BATCH: usize = 128;

/// The batch. `[photon]` everywhere; bits are halves of the words of [`super::dice`].
pub(super) struct Stage {
    pub(super) place: [u32; BATCH],
    chance: [u32; BATCH],
    cell: [u32; BATCH],
    jitter: [u32; BATCH],
    /// Bits of the field node, later its number.
    node: [u32; BATCH],
    pub(super) time: [u32; BATCH],
    /// Where chief rays land at the reference wavelength.
    pub(super) seen: [[f32; BATCH]; 2],
    /// Where photons land, later the place in the bin.
    at: [[f32; BATCH]; 2],
    bin: [u32; BATCH],
    /// What the core holds, later the line of the bin, then its answer.
    held: [u32; BATCH],
}

/// Some photons of a batch.
struct Few {
    which: [u8; BATCH],
    many: usize,
}

impl Few {
    fn none() -> Self {
        Self { which: [0; BATCH], many: 0 }
    }

    /// Adds a photon if it is one, without a branch.
    #[inline]
    fn add_if(&mut self, photon: usize, is_one: bool) {
        self.which[self.many % BATCH] = photon as u8;
        self.many += usize::from(is_one);
    }

    fn iter(&self) -> impl Iterator<Item = usize> {
        self.which.iter().take(self.many).map(|photon| usize::from(*photon))
    }
}

/// The lower and upper halves of the words of so many photons for a purpose.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn halves_of(
    (words, first, purpose): (Words, u64, u64),
    [lower, upper]: [&mut [u32; BATCH]; 2],
    many: usize,
) {
    for i in 0..many.min(BATCH) {
        let bits = words.of(first.wrapping_add(i as u64), purpose);
        (lower[i], upper[i]) = (bits as u32, (bits >> 32) as u32);
    }
}

impl Stage {
    pub(super) fn new() -> Self {
        let (none, nowhere) = ([0; BATCH], [[0.0; BATCH]; 2]);
        Self {
            place: none,
            chance: none,
            cell: none,
            jitter: none,
            node: none,
            time: none,
            seen: nowhere,
            at: nowhere,
            bin: none,
            held: none,
        }
    }

    /// Draws the bits of so many photons.
    pub(super) fn throw(&mut self, words: Words, first: u64, many: usize) {
        halves_of((words, first, PLACE_COUNT), [&mut self.place, &mut self.chance], many);
        halves_of((words, first, CELL_JITTER), [&mut self.cell, &mut self.jitter], many);
        halves_of((words, first, NODE_TIME), [&mut self.node, &mut self.time], many);
    }

    /// Draws from the point spreads and finds what the bins say.
    pub(super) fn land(
        &mut self,
        (index, origin, field): (&ConeIndex, Origin, &Field),
        wave: &Wave,
        (words, first): (Words, u64),
        many: usize,
    ) {
        // Said once, so that no loop looks at the ends of its arrays.
        let (beam, many) = (&wave.beam, many.min(BATCH));
        for i in 0..many {
            self.node[i] = field.node([self.seen[0][i], self.seen[1][i]], self.node[i]);
        }
        for i in 0..many {
            self.held[i] = beam.held(self.node[i], self.cell[i]);
        }
        let mut outside = Few::none();
        for i in 0..many {
            let seen = [self.seen[0][i], self.seen[1][i]];
            let drawn = (self.cell[i], self.held[i], self.jitter[i]);
            let (at, inside) = beam.landed(self.node[i], seen, drawn);
            (self.at[0][i], self.at[1][i]) = (at[0], at[1]);
            outside.add_if(i, !inside);
        }
        for i in outside.iter() {
            let (seen, dice) = ([self.seen[0][i], self.seen[1][i]], &mut words.more(first + i as u64, 0));
            let at = beam.landed_outside(self.node[i], seen, dice);
            (self.at[0][i], self.at[1][i]) = (at[0], at[1]);
        }
        for i in 0..many {
            let (bin, at) = index.place_near(origin, [self.at[0][i], self.at[1][i]]);
            (self.bin[i], self.at[0][i], self.at[1][i]) = (bin, at[0], at[1]);
        }
        for i in 0..many {
            self.held[i] = index.line(self.bin[i]);
        }
        for i in 0..many {
            self.held[i] = index.answer(self.held[i], [self.at[0][i], self.at[1][i]]);
        }
    }

    /// Counts on the cones where photons landed.
    pub(super) fn count(
        &mut self,
        index: &ConeIndex,
        wave: &Wave,
        (words, first): (Words, u64),
        many: usize,
        tally: &mut Tally,
    ) {
        let (mut lists, mut hits) = (Few::none(), Few::none());
        for (i, held) in self.held.iter().enumerate().take(many) {
            lists.add_if(i, ConeIndex::is_list(*held));
            hits.add_if(i, ConeIndex::is_cone(*held));
        }
        for i in lists.iter() {
            if let Some(cone) = index.cone(self.held[i], [self.at[0][i], self.at[1][i]]) {
                self.held[i] = cone;
                hits.add_if(i, true);
            }
        }
        let (mut arrived, mut guided) = (0.0, 0.0);
        for i in hits.iter() {
            let cone = self.held[i];
            let odds = wave.beam.odds(cone, self.node[i]);
            arrived += odds.arrived;
            guided += odds.guided;
            let counted = self.chance[i] < odds.counted;
            let count = &mut tally.counts[cone as usize];
            *count = count.saturating_add(u32::from(counted));
            if let Some(lister) = &wave.lister
                && counted
            {
                let (caught, photon) = (wave.beam.caught(cone), (words, first + i as u64));
                tally.list(|| lister.photon(self.time[i], photon, cone, &caught));
            }
        }
        tally.arrive(f64::from(arrived), f64::from(guided));
    }
}
