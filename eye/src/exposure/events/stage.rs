//! A batch of photons on their way, stage by stage: each stage is a short loop over arrays, so that many loads of memory are under way at a
//! time and what is alike for all is done for several at once. What few photons need is done apart, so that no loop has to guess.
//!
//! Places on the retina are in bins of the cones' index from an origin near the block's image, in single precision: good to 1e-4 of a bin.

use multiversion::multiversion;

use super::dice::{CELL_JITTER, NODE_TIME, PLACE_COUNT, Words, unit24};
use super::piece::{Tally, Wave};
use super::spread::{OUTSIDE, Outside};
use super::tables::{Beam, Field, Node, Odds};
use crate::retina::{ConeIndex, Origin, Place, Raster};
use crate::rng::finalized;

/// Photons of a batch.
pub(super) const BATCH: usize = 256;

/// The batch. `[photon]` everywhere; bits are halves of the words of [`super::dice`].
pub(super) struct Stage {
    pub(super) place: [u32; BATCH],
    chance: [u32; BATCH],
    cell: [u32; BATCH],
    jitter: [u32; BATCH],
    /// Bits of the field node, later its number.
    node: [u32; BATCH],
    pub(super) time: [u32; BATCH],
    /// Where chief rays land, at the reference wavelength until that of the photons is known.
    pub(super) seen: [[f32; BATCH]; 2],
    /// Photons outside the core, empty between batches.
    outside: Vec<(usize, Outside)>,
    /// Where photons land.
    at: [[f32; BATCH]; 2],
    /// The bin there, and the place in it.
    bin: [u32; BATCH],
    inside: [Place; BATCH],
    /// What the core holds, later the answer of the bin.
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
    let [mut at, step] = words.steps(first, purpose);
    for i in 0..many.min(BATCH) {
        let bits = finalized(at);
        at = at.wrapping_add(step);
        (lower[i], upper[i]) = (bits as u32, (bits >> 32) as u32);
    }
}

/// Where photons land: cell of the core, and place.
struct Landed<'a> {
    cell: &'a mut [u32; BATCH],
    at: &'a mut [[f32; BATCH]; 2],
}

/// Where so many photons land that are of one node, from where they are seen, what its core holds, and their jitter.
#[multiversion(targets("x86_64+avx2"))]
fn land_of_one(
    node: &Node,
    (seen, held, jitter): (&[[f32; BATCH]; 2], &[u32; BATCH], &[u32; BATCH]),
    landed: Landed,
    many: usize,
) {
    let node = *node;
    let Landed { cell, at: [xs, ys] } = landed;
    for i in 0..many.min(BATCH) {
        let (to, at) = node.landed([seen[0][i], seen[1][i]], (cell[i], held[i], jitter[i]));
        (cell[i], xs[i], ys[i]) = (to, at[0], at[1]);
    }
}

/// The bins of so many places, and where in their bins these are.
#[multiversion(targets("x86_64+avx2"))]
fn bins(
    (raster, origin): (Raster, Origin),
    [xs, ys]: &[[f32; BATCH]; 2],
    (bin, inside): (&mut [u32; BATCH], &mut [Place; BATCH]),
    many: usize,
) {
    for i in 0..many.min(BATCH) {
        (bin[i], inside[i]) = raster.place_near(origin, [xs[i], ys[i]]);
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
            outside: Vec::with_capacity(BATCH),
            bin: none,
            inside: [Place::default(); BATCH],
            held: none,
        }
    }

    /// Draws the bits of so many photons, those of node and time if somebody asks for them.
    pub(super) fn throw(&mut self, (words, first): (Words, u64), many: usize, timed: bool) {
        halves_of((words, first, PLACE_COUNT), [&mut self.place, &mut self.chance], many);
        halves_of((words, first, CELL_JITTER), [&mut self.cell, &mut self.jitter], many);
        if timed {
            halves_of((words, first, NODE_TIME), [&mut self.node, &mut self.time], many);
        }
    }

    /// Draws from the point spreads, of one node or of those around each photon, and finds what the bins say. Photons of one node are seen
    /// where their own wavelength is.
    pub(super) fn land(
        &mut self,
        (index, origin, field): (&ConeIndex, Origin, &Field),
        (beam, node): (&Beam, Option<u32>),
        (words, first): (Words, u64),
        many: usize,
    ) {
        // Said once, so that no loop looks at the ends of its arrays.
        let many = many.min(BATCH);
        let landing = Landed { cell: &mut self.cell, at: &mut self.at };
        if let Some(node) = node {
            self.node[..many].fill(node);
            let core = beam.core(node);
            for i in 0..many {
                self.held[i] = core.held(landing.cell[i]);
            }
            land_of_one(core.node, (&self.seen, &self.held, &self.jitter), landing, many);
        } else {
            for i in 0..many {
                let at = [self.seen[0][i], self.seen[1][i]];
                self.node[i] = field.node(at, self.node[i]);
                let shift = beam.shift(field, at);
                (self.seen[0][i], self.seen[1][i]) = (at[0] + shift[0], at[1] + shift[1]);
            }
            for i in 0..many {
                self.held[i] = beam.core(self.node[i]).held(landing.cell[i]);
            }
            for i in 0..many {
                let seen = [self.seen[0][i], self.seen[1][i]];
                let drawn = (landing.cell[i], self.held[i], self.jitter[i]);
                let at;
                (landing.cell[i], at) = beam.core(self.node[i]).node.landed(seen, drawn);
                (landing.at[0][i], landing.at[1][i]) = (at[0], at[1]);
            }
        }
        let mut outside = Few::none();
        for i in 0..many {
            outside.add_if(i, self.cell[i] == OUTSIDE);
        }
        let looked = outside.iter().map(|i| {
            let dice = words.more(first + i as u64, 0);
            (i, beam.outside(self.node[i]).look_outside(dice))
        });
        self.outside.extend(looked);
        for (i, photon) in self.outside.drain(..) {
            let cells = beam.outside(self.node[i]).place_outside(photon);
            let at = beam.landed_outside(self.node[i], [self.seen[0][i], self.seen[1][i]], cells);
            (self.at[0][i], self.at[1][i]) = (at[0], at[1]);
        }
        bins((index.raster(), origin), &self.at, (&mut self.bin, &mut self.inside), many);
        for i in 0..many {
            self.held[i] = index.answer(self.bin[i], self.inside[i]);
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
        let (mut more, mut walls, mut hits) = (Few::none(), Few::none(), Few::none());
        for (i, held) in self.held.iter().enumerate().take(many) {
            more.add_if(i, ConeIndex::is_more(*held));
        }
        for i in more.iter() {
            (self.held[i], self.inside[i]) = index.quarter(self.held[i], self.inside[i]);
        }
        for i in more.iter() {
            walls.add_if(i, ConeIndex::is_more(self.held[i]));
        }
        for i in walls.iter() {
            self.held[i] = index.listed(self.held[i], self.inside[i]).unwrap_or(u32::MAX);
        }
        for (i, held) in self.held.iter().enumerate().take(many) {
            hits.add_if(i, ConeIndex::is_cone(*held));
        }
        let (mut arrived, mut guided) = (0.0, 0.0);
        let counts = tally.counts.as_mut_slice();
        for i in hits.iter() {
            let cone = self.held[i];
            let odds = wave.beam.odds(cone, self.node[i]);
            arrived += odds.arrived;
            guided += odds.guided;
            let count = &mut counts[cone as usize];
            *count = count.saturating_add(u32::from(self.counts(i, &odds)));
        }
        tally.arrive(f64::from(arrived), f64::from(guided));
        let Some(lister) = &wave.lister else { return };
        for i in hits.iter() {
            let cone = self.held[i];
            if self.counts(i, &wave.beam.odds(cone, self.node[i])) {
                let (caught, photon) = (wave.beam.caught(cone), (words, first + i as u64));
                tally.list(|| lister.photon(self.time[i], photon, cone, &caught));
            }
        }
    }

    /// Whether a photon is counted.
    #[inline]
    fn counts(&self, photon: usize, odds: &Odds) -> bool {
        unit24(self.chance[photon]) < odds.counted
    }
}
