//! One piece of work: the photons of one layer of light from one block of pixels, wave by wave, a few hundred at a time in stages, so
//! that the memory that one photon waits for is fetched while others are computed.

use glam::DVec2;

use super::dice::{COUNT_TIME, PIXEL, Words, unit};
use super::landing::{Landing, Patch};
use super::list::{Lister, MAX_PHOTONS};
use super::sight::{Sight, place};
use super::tables::{Beam, Drawn};
use crate::display::Emitter;
use crate::exposure::{Photon, poisson};
use crate::retina::ConeIndex;
use crate::rng::Stream;

/// Side of a block, pixels.
pub(super) const BLOCK: usize = 8;
/// Pixels of a block.
const PIXELS: usize = BLOCK * BLOCK;
/// Photons a pixel from which on each pixel's number is drawn, and not each photon's pixel.
const MANY: f64 = 32.0;
/// Photons in one stage.
const BATCH: usize = 128;
/// Arriving photons are added up as whole multiples of this share: then the order of adding does not matter.
pub(super) const GRAIN: f64 = 1.0 / 1_048_576.0;

/// What one thread has counted: by cone, photons drawn, and the grains of photons that arrived and were guided.
pub(super) struct Tally {
    pub(super) counts: Vec<u32>,
    pub(super) drawn: u64,
    pub(super) arrived: u64,
    pub(super) guided: u64,
    /// Counted photons, when they are listed.
    pub(super) list: Vec<Photon>,
}

impl Tally {
    pub(super) fn new(cones: usize) -> Self {
        Self { counts: vec![0; cones], drawn: 0, arrived: 0, guided: 0, list: Vec::new() }
    }

    pub(super) fn add(&mut self, mut other: Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(sum, count)| *sum = sum.saturating_add(*count));
        self.drawn += other.drawn;
        self.arrived += other.arrived;
        self.guided += other.guided;
        self.list.append(&mut other.list);
    }
}

/// The pixels of a block that give light.
pub(super) struct Block {
    patches: Vec<Patch>,
    /// Light up to and with each pixel; endless beyond the last.
    until: [f64; PIXELS],
    total: f64,
}

/// One layer's light from a block.
pub(super) struct Piece<'a> {
    pub(super) emitter: &'a Emitter,
    pub(super) sight: &'a Sight<'a>,
    pub(super) block: Block,
}

/// One wavelength node's part of a piece.
pub(super) struct Wave<'a> {
    pub(super) beam: Beam<'a>,
    /// Share of the photons that is drawn.
    pub(super) rate: f64,
    /// Lists those that are counted.
    pub(super) lister: Option<Lister<'a>>,
}

impl Block {
    /// A block of pixels, each with its light into the pupil.
    pub(super) fn new(pixels: impl Iterator<Item = (f64, Patch)>) -> Self {
        let mut block =
            Self { patches: Vec::with_capacity(PIXELS), until: [f64::INFINITY; PIXELS], total: 0.0 };
        for (light, patch) in pixels {
            block.total += light;
            block.until[block.patches.len()] = block.total;
            block.patches.push(patch);
        }
        if let Some(last) = block.patches.len().checked_sub(1) {
            block.until[last] = f64::INFINITY;
        }
        block
    }

    /// Whether it is dark.
    pub(super) fn is_dark(&self) -> bool {
        self.total <= 0.0
    }

    /// A pixel by its light, for a uniform number.
    #[inline]
    fn pixel(&self, uniform: f64) -> usize {
        let wanted = uniform * self.total;
        let mut pixel = 0;
        // Halvings without a branch: which way they go is chance.
        for step in [32, 16, 8, 4, 2, 1] {
            pixel += if self.until[pixel + step - 1] <= wanted { step } else { 0 };
        }
        pixel
    }
}

/// What is known of the photons of a batch. Loops over it are short, so that many loads are under way at a time.
struct Stage {
    /// Where chief rays land at the reference wavelength, µm.
    seen: [DVec2; BATCH],
    chance: [u32; BATCH],
    drawn: [Drawn; BATCH],
    /// Entry of the point spread's core, later the line of the bin and its answer.
    held: [u32; BATCH],
    /// Bin and place in it.
    place: [(u32, [f32; 2]); BATCH],
    arrived: f64,
    guided: f64,
}

impl Stage {
    fn new() -> Self {
        Self {
            seen: [DVec2::ZERO; BATCH],
            chance: [0; BATCH],
            drawn: [Drawn::default(); BATCH],
            held: [0; BATCH],
            place: [(0, [0.0; 2]); BATCH],
            arrived: 0.0,
            guided: 0.0,
        }
    }

    /// Draws from the point spreads and finds what the bins say.
    fn land(&mut self, index: &ConeIndex, beam: &Beam, words: Words, first: u64, many: usize) {
        for (photon, (drawn, seen)) in (first..).zip(self.drawn.iter_mut().zip(&self.seen)).take(many) {
            *drawn = beam.spread(*seen, words, photon);
        }
        for (held, drawn) in self.held.iter_mut().zip(&self.drawn).take(many) {
            *held = beam.held(drawn.entry);
        }
        for i in 0..many {
            let landed = beam.landed(self.seen[i], &self.drawn[i], self.held[i], words, first + i as u64);
            self.place[i] = index.place(landed);
        }
        for (held, (bin, _)) in self.held.iter_mut().zip(&self.place).take(many) {
            *held = index.line(*bin);
        }
        for (held, (_, at)) in self.held.iter_mut().zip(&self.place).take(many) {
            *held = index.answer(*held, *at);
        }
    }

    /// Counts on the cones where photons landed.
    fn count(
        &mut self,
        index: &ConeIndex,
        wave: &Wave,
        words: Words,
        first: u64,
        many: usize,
        tally: &mut Tally,
    ) {
        for i in 0..many {
            let Some(cone) = index.cone(self.held[i], self.place[i].1) else {
                continue;
            };
            let odds = wave.beam.odds(cone, self.drawn[i].node);
            self.arrived += f64::from(odds.arrived);
            self.guided += f64::from(odds.guided);
            let count = &mut tally.counts[cone as usize];
            let counted = self.chance[i] < odds.counted;
            *count = count.saturating_add(u32::from(counted));
            if let (true, Some(lister)) = (counted, &wave.lister)
                && tally.list.len() <= MAX_PHOTONS
            {
                let caught = wave.beam.caught(cone);
                tally.list.push(lister.photon(words, first + i as u64, cone, &caught));
            }
        }
    }
}

impl Piece<'_> {
    /// Draws and counts the photons near one wavelength node.
    pub(super) fn count(
        &self,
        landing: &Landing,
        index: &ConeIndex,
        wave: &Wave,
        stream: &mut Stream,
        tally: &mut Tally,
    ) {
        let pixels = self.numbers(self.sight.share() * wave.rate, stream);
        let drawn = pixels.iter().map(|(_, number)| number).sum::<u64>();
        let words = Words { key: stream.bits() };
        tally.drawn += drawn;
        let mut stage = Stage::new();
        let mut first = 0;
        let mut runs = pixels.into_iter().filter(|run| run.1 > 0);
        let mut run = (None, 0);
        while first < drawn {
            let many = (drawn - first).min(BATCH as u64) as usize;
            let mut filled = 0;
            while filled < many {
                if run.1 == 0 {
                    run = runs.next().unwrap_or((None, u64::MAX));
                }
                let until = many.min(filled + run.1.min(BATCH as u64) as usize);
                let (seen, chances) = (&mut stage.seen[filled..until], &mut stage.chance[filled..until]);
                self.leave(landing, words, (run.0, first + filled as u64), seen, chances);
                (run.1, filled) = (run.1 - (until - filled) as u64, until);
            }
            stage.land(index, &wave.beam, words, first, many);
            stage.count(index, wave, words, first, many, tally);
            first += many as u64;
        }
        tally.arrived += (stage.arrived / GRAIN) as u64;
        tally.guided += (stage.guided / GRAIN) as u64;
    }

    /// How many photons to draw from a pixel each, or from any pixel.
    fn numbers(&self, rate: f64, stream: &mut Stream) -> Vec<(Option<usize>, u64)> {
        let pixels = self.block.patches.len();
        if self.block.total * rate < MANY * pixels as f64 {
            return vec![(None, poisson::from_stream(stream, self.block.total * rate) as u64)];
        }
        let light = |pixel: usize| {
            let before = if pixel == 0 { 0.0 } else { self.block.until[pixel - 1] };
            let until = if pixel + 1 == pixels { self.block.total } else { self.block.until[pixel] };
            until - before
        };
        (0..pixels)
            .map(|pixel| (Some(pixel), poisson::from_stream(stream, light(pixel) * rate) as u64))
            .collect()
    }

    /// Where on the retina chief rays of photons from a pixel (or any) land at the reference wavelength, and their chances to be counted.
    fn leave(
        &self,
        landing: &Landing,
        words: Words,
        (pixel, first): (Option<usize>, u64),
        seen: &mut [DVec2],
        chances: &mut [u32],
    ) {
        let rests = self.sight.rests();
        for (photon, (seen, chance)) in (first..).zip(seen.iter_mut().zip(chances)) {
            let pixel = pixel.unwrap_or_else(|| self.block.pixel(words.one(photon, PIXEL)));
            let bits = words.of(photon, COUNT_TIME);
            let sight = rests.unwrap_or_else(|| self.sight.at(unit((bits >> 32) as u32)));
            let place = place(self.emitter, words, photon) - sight;
            (*seen, *chance) = (self.block.patches[pixel].landing(landing, place), bits as u32);
        }
    }
}
