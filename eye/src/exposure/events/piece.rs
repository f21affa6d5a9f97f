//! One piece of work: the photons of one layer of light from one block of pixels, wave by wave, a batch at a time.

use std::ops::Range;

use glam::{DMat2, DVec2};
use multiversion::multiversion;

use super::dice::{PIXEL, Words, above, halves, unit};
use super::landing::{Landing, Patch};
use super::list::{Lister, MAX_PHOTONS};
use super::sight::{Sight, place};
use super::stage::{BATCH, Stage};
use super::tables::{Beam, Field};
use crate::display::Emitter;
use crate::exposure::{Photon, poisson};
use crate::retina::{ConeIndex, Origin};
use crate::rng::Stream;

/// Most pixels along the side of a block.
pub(super) const BLOCK: usize = 8;
/// Largest side of a block of more than one pixel, unit tangents (60 µm): what its photons ask of the cones' index stays in the cache.
pub(super) const BLOCK_TANGENT: f64 = 0.0036;
/// Pixels of a block.
const PIXELS: usize = BLOCK * BLOCK;
/// Photons a pixel from which on each pixel's number is drawn, and not each photon's pixel.
const MANY: f64 = 32.0;
/// A place that is far from all cones, bins.
const FAR: f32 = 1e9;
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

    /// Adds photons that arrived and were guided.
    pub(super) fn arrive(&mut self, arrived: f64, guided: f64) {
        self.arrived += (arrived / GRAIN) as u64;
        self.guided += (guided / GRAIN) as u64;
    }

    /// Lists a counted photon; one too many is enough to know that there are.
    pub(super) fn list(&mut self, photon: impl FnOnce() -> Photon) {
        if self.list.len() <= MAX_PHOTONS {
            self.list.push(photon());
        }
    }
}

/// Largest part of the distance between field nodes over which a pixel is seen for which all its photons have the chances of its middle
/// to be of a node.
const ONE_NODE: f32 = 0.125;

/// Photons to draw: of a field node or of those around each, from a pixel or from any.
struct Run {
    node: Option<u32>,
    pixel: Option<usize>,
    number: u64,
}

/// Where photons of a pixel are seen, by the whole numbers of their bits, bins from an origin.
#[derive(Clone, Copy)]
struct Straight {
    from: [f32; 2],
    across: [f32; 2],
    down: [f32; 2],
    during: [f32; 2],
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
    emitter: &'a Emitter,
    sight: &'a Sight<'a>,
    block: Block,
    /// By pixel, when all are.
    straight: Option<Vec<Straight>>,
    /// Field nodes and pixels near them, with the light of each that is of the node, when pixels are small.
    nodes: Option<Vec<(u32, usize, f64)>>,
    /// Whether `straight` places are the same all the time.
    still: bool,
    index: &'a ConeIndex,
    /// Where places are counted from.
    origin: Origin,
    field: Field,
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

    /// Light of a pixel.
    fn light(&self, pixel: usize) -> f64 {
        let before = if pixel == 0 { 0.0 } else { self.until[pixel - 1] };
        let until = if pixel + 1 == self.patches.len() { self.total } else { self.until[pixel] };
        until - before
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

impl Straight {
    /// A pixel of one rectangle without a spot whose image is affine, under a line of sight that moves evenly.
    fn new(
        (um, by): (DVec2, DMat2),
        emitter: &Emitter,
        [from, to]: [DVec2; 2],
        (index, origin): (&ConeIndex, Origin),
    ) -> Option<Self> {
        let ([([x0, y0, x1, y1], _)], 0.0) = (emitter.rects.as_slice(), emitter.spot_sd_px) else {
            return None;
        };
        let step = |px: DVec2, bits: i32| by * px * index.per_um() / f64::from(bits).exp2();
        let (across, down) = (step(DVec2::new(x1 - x0, 0.0), 16), step(DVec2::new(0.0, y1 - y0), 16));
        let corner = index.bins_from(origin, um + by * (DVec2::new(*x0, *y0) - from));
        let single = |v: DVec2| v.as_vec2().to_array();
        Some(Self {
            // A whole number stands for the middle of its part.
            from: single(corner + 0.5 * (across + down)),
            across: single(across),
            down: single(down),
            during: single(step(from - to, 31)),
        })
    }

    /// What it becomes where each place is shifted by some bins: affine through the corners of the pixel.
    fn shifted(&self, by: impl Fn([f32; 2]) -> [f32; 2]) -> Self {
        const ENDS: [f32; 3] = [65_536.0, 65_536.0, 2_147_483_648.0];
        let first = by(self.from);
        let mut shifted = *self;
        shifted.from = [0, 1].map(|axis| self.from[axis] + first[axis]);
        for (edge, end) in [&mut shifted.across, &mut shifted.down, &mut shifted.during].into_iter().zip(ENDS)
        {
            if !is_none(*edge) {
                let there = by([0, 1].map(|axis| self.from[axis] + edge[axis] * end));
                *edge = [0, 1].map(|axis| edge[axis] + (there[axis] - first[axis]) / end);
            }
        }
        shifted
    }

    /// Where photons are seen on average.
    fn middle(&self) -> [f32; 2] {
        self.seen(0x8000_8000, 0x8000_0000)
    }

    /// How far apart photons are seen, at most, along each axis.
    fn extent(&self) -> [f32; 2] {
        [0, 1].map(|axis| {
            65_536.0 * (self.across[axis].abs() + self.down[axis].abs())
                + 2_147_483_648.0 * self.during[axis].abs()
        })
    }

    /// Where a photon is seen.
    #[inline]
    fn seen(&self, place: u32, time: u32) -> [f32; 2] {
        let [across, down] = halves(place).map(|part| part as i32 as f32);
        let time = (time >> 1) as i32 as f32;
        [0, 1].map(|axis| {
            self.from[axis] + self.across[axis] * across + self.down[axis] * down + self.during[axis] * time
        })
    }
}

/// Whether a change is none.
fn is_none(by: [f32; 2]) -> bool {
    by.iter().all(|by| *by == 0.0)
}

/// Where photons of one pixel are seen.
#[multiversion(targets("x86_64+avx2"))]
fn leave_from(pixel: &Straight, (places, times): (&[u32], &[u32]), [xs, ys]: [&mut [f32]; 2]) {
    let pixel = *pixel;
    let many = places.len().min(times.len()).min(xs.len()).min(ys.len());
    for i in 0..many {
        let seen = pixel.seen(places[i], times[i]);
        (xs[i], ys[i]) = (seen[0], seen[1]);
    }
}

impl<'a> Piece<'a> {
    /// A block's light of an emitter, counted on the cones of an index.
    pub(super) fn new(
        emitter: &'a Emitter,
        sight: &'a Sight<'a>,
        block: Block,
        (index, origin, field): (&'a ConeIndex, Origin, Field),
    ) -> Self {
        let straight = sight.line().and_then(|line| {
            let of = |patch: &Patch| Straight::new(patch.straight()?, emitter, line, (index, origin));
            block.patches.iter().map(of).collect()
        });
        let nodes = straight.as_ref().and_then(|straight: &Vec<Straight>| {
            straight.iter().all(|pixel| field.part(pixel.extent()) < ONE_NODE).then(|| {
                let mut nodes: Vec<(u32, usize, f64)> = Vec::with_capacity(4 * straight.len());
                for (pixel, seen) in straight.iter().enumerate() {
                    let light = block.light(pixel);
                    let around = field.around(seen.middle()).into_iter().filter(|(_, weight)| *weight > 0.0);
                    nodes.extend(around.map(|(node, weight)| (node, pixel, light * f64::from(weight))));
                }
                nodes.sort_by_key(|(node, pixel, _)| (*node, *pixel));
                nodes
            })
        });
        let still = straight.iter().flatten().all(|pixel| is_none(pixel.during));
        Self { emitter, sight, block, straight, nodes, still, index, origin, field }
    }

    /// Draws and counts the photons near one wavelength node.
    pub(super) fn count(
        &self,
        landing: &Landing,
        wave: &Wave,
        stream: &mut Stream,
        (stage, tally): (&mut Stage, &mut Tally),
    ) {
        let runs = self.runs(self.sight.share() * wave.rate, stream);
        let drawn = runs.iter().map(|run| run.number).sum::<u64>();
        let words = Words { key: stream.bits() };
        tally.drawn += drawn;
        let mut first = 0;
        // Where the pixels are seen at this wavelength, when all photons are of one node each.
        let of_wave: Option<Vec<Straight>> = match &self.straight {
            Some(straight) if runs.first().is_some_and(|run| run.node.is_some()) => {
                let shift = |at| wave.beam.shift(&self.field, at);
                Some(straight.iter().map(|pixel| pixel.shifted(shift)).collect())
            }
            _ => None,
        };
        let straight = of_wave.as_ref().or(self.straight.as_ref()).map(Vec::as_slice);
        for runs in runs.chunk_by(|a, b| a.node == b.node) {
            let node = runs[0].node;
            let timed = node.is_none() || wave.lister.is_some() || !self.still;
            let mut left = runs.iter().map(|run| run.number).sum::<u64>();
            let mut runs = runs.iter().map(|run| (run.pixel, run.number)).filter(|run| run.1 > 0);
            let mut run = (None, 0);
            while left > 0 {
                let many = left.min(BATCH as u64) as usize;
                stage.throw((words, first), many, timed);
                let mut filled = 0;
                while filled < many {
                    if run.1 == 0 {
                        run = runs.next().unwrap_or((None, u64::MAX));
                    }
                    let until = many.min(filled + run.1.min(BATCH as u64) as usize);
                    self.leave((landing, straight), (words, first), run.0, (filled..until, stage));
                    (run.1, filled) = (run.1 - (until - filled) as u64, until);
                }
                let place = (self.index, self.origin, &self.field);
                stage.land(place, (&wave.beam, node), (words, first), many);
                stage.count(self.index, wave, (words, first), many, tally);
                (first, left) = (first + many as u64, left - many as u64);
            }
        }
    }

    /// How many photons to draw.
    fn runs(&self, rate: f64, stream: &mut Stream) -> Vec<Run> {
        let pixels = self.block.patches.len();
        let mut draw =
            |node, pixel, mean| Run { node, pixel, number: poisson::from_stream(stream, mean) as u64 };
        if self.block.total * rate < MANY * pixels as f64 {
            return vec![draw(None, None, self.block.total * rate)];
        }
        if let Some(nodes) = &self.nodes {
            return nodes
                .iter()
                .map(|(node, pixel, light)| draw(Some(*node), Some(*pixel), light * rate))
                .collect();
        }
        (0..pixels).map(|pixel| draw(None, Some(pixel), self.block.light(pixel) * rate)).collect()
    }

    /// Where on the retina chief rays of some photons of a batch from a pixel (or any) land: at the wavelength of `straight`, or at the
    /// reference wavelength.
    fn leave(
        &self,
        (landing, straight): (&Landing, Option<&[Straight]>),
        (words, first): (Words, u64),
        pixel: Option<usize>,
        (range, stage): (Range<usize>, &mut Stage),
    ) {
        let of_light = |i: usize| self.block.pixel(above(words.of(first + i as u64, PIXEL)));
        let Stage { place: places, time: times, seen: [xs, ys], .. } = stage;
        let bits = places[range.clone()].iter().zip(&times[range.clone()]);
        let seen = xs[range.clone()].iter_mut().zip(&mut ys[range.clone()]);
        let photons = seen.zip(bits);
        match (straight, pixel) {
            (Some(straight), Some(pixel)) => {
                let drawn = (&places[range.clone()], &times[range.clone()]);
                leave_from(&straight[pixel], drawn, [&mut xs[range.clone()], &mut ys[range]]);
            }
            (Some(straight), None) => {
                for (i, ((x, y), (place, time))) in range.zip(photons) {
                    [*x, *y] = straight[of_light(i)].seen(*place, *time);
                }
            }
            (None, pixel) => {
                for (i, ((x, y), (bits, time))) in range.zip(photons) {
                    let patch = &self.block.patches[pixel.unwrap_or_else(|| of_light(i))];
                    let from_sight =
                        place(self.emitter, *bits, words, first + i as u64) - self.sight.at(unit(*time));
                    let um = patch.landing(landing, from_sight);
                    let at = self.index.bins_from(self.origin, um).as_vec2();
                    [*x, *y] = if at.is_nan() { [FAR; 2] } else { at.to_array() };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{Channel, Waveform};
    use crate::retina::{RegionUm, Retina};

    /// The places of bits in single precision against the same in double.
    #[test]
    fn straight_places() {
        let index = ConeIndex::new(&Retina::assemble(&[], &RegionUm { min: DVec2::ZERO, max: DVec2::ONE }));
        let (um, by) = (DVec2::new(12.5, -7.25), DMat2::from_cols_array(&[16.1, 0.3, -0.2, -15.9]));
        let origin = index.origin(um + 3.0);
        let mut emitter = Emitter {
            channel: Channel::White,
            photons: Vec::new(),
            rects: vec![([0.1, 0.2, 0.8, 0.9], 1.0)],
            spot_sd_px: 0.0,
            waveform: Waveform::Steady,
        };
        let line = [DVec2::new(-0.5, 0.25), DVec2::new(1.5, -0.75)];
        let straight = Straight::new((um, by), &emitter, line, (&index, origin)).unwrap();
        let words = Words { key: 11 };
        // That of another wavelength, linear over the pixel.
        let shift = |at: [f32; 2]| [0.5 + 0.01 * at[0], -0.25 + 0.004 * at[0] - 0.02 * at[1]];
        for photon in 0..1_000 {
            let (bits, time) = (words.of(photon, 0) as u32, words.of(photon, 2) as u32);
            let px = place(&emitter, bits, words, photon) - line[0].lerp(line[1], unit(time));
            let exact = index.bins_from(origin, um + by * px);
            let seen = straight.seen(bits, time);
            let apart = (exact - DVec2::new(f64::from(seen[0]), f64::from(seen[1]))).abs().max_element();
            assert!(apart < 1e-4, "{exact} {seen:?}");
            let shifted = straight.shifted(shift).seen(bits, time);
            let by = shift(seen);
            assert!((0..2).all(|axis| (shifted[axis] - seen[axis] - by[axis]).abs() < 1e-4), "{shifted:?}");
        }
        emitter.spot_sd_px = 0.1;
        assert!(Straight::new((um, by), &emitter, line, (&index, origin)).is_none());
    }
}
