//! Which cone's aperture owns a point of the chart.
//!
//! A raster of square bins over the apertures, some 24 in a small one. A bin has two half planes, each with a cone: the bin inside one
//! aperture, one that a wall crosses, and one with a gap between two apertures. Where more meet, the bin is split into four of half its
//! side, and where more meet in one of those, the answer is a list of walls: for every aperture of the bin those that cut it, and a point
//! inside all of them is inside the aperture. Apertures are convex.
//!
//! A wall is a line of the bin, made from its end points in lexicographic order, with the same bits for both cones. Cones that share one
//! share its half plane too; in a list a point on it counts as left of it. So such a point belongs to exactly one of the two.

use std::hint::select_unpredictable;

use glam::DVec2;

use super::mosaic::Retina;

/// Bins in a small aperture, about: one of ten is smaller.
const BINS_PER_CONE: f64 = 24.0;
/// Most bins per cone, all in all.
const MOST_BINS_PER_CONE: f64 = 128.0;
/// Most bins along a side: places far from all cones do not come around to others in 32 bits.
const MOST_BINS_ALONG: f64 = 60_000.0;
/// Answer: no aperture.
const NOBODY: u32 = u32::MAX;
/// Set in an answer that is no cone: the rest is the first of four bins, or the first wall of a list.
const MORE: u32 = 1 << 31;
/// Set in an answer that is a list of walls.
const LIST: u32 = 1 << 30;
/// Bins lie in memory in squares of this side, so that neighbours are near.
const SQUARE: u32 = 8;
/// A line nearer to a bin than this, in bins, is taken to cross it.
const HAIR: f64 = 1e-5;

/// The aperture is on the right of the wall.
const RIGHT: u32 = 1;
/// Last wall of an aperture in a bin.
const LAST: u32 = 2;
/// Last wall of a bin.
const END: u32 = 4;
/// No wall: the aperture holds the whole bin.
const WHOLE: u32 = 8;

/// Length of a half plane's normal: of whole numbers, it is off by 2e-5.
const ONE: f32 = 32_767.0;
/// Places in a bin are whole numbers of so many bits.
const PLACE_BITS: u32 = 15;
/// The last of the parts of a bin.
const PARTS: f32 = ((1 << PLACE_BITS) - 1) as f32;
/// Added to a single-precision number it leaves a whole one in its last bits, up to 2^22.
const ROUNDER: f32 = 12_582_912.0;
/// Bins from an origin that are outside.
const FAR: f32 = 1e6;
/// Bits by which a half plane's distance is coarser than the product of its normal and a place: 6e-5 of a bin.
const COARSE_BITS: u32 = 16;

/// Point location in the apertures of a retina.
#[derive(Clone, Debug)]
pub struct ConeIndex {
    first: DVec2,
    per_um: f64,
    raster: Raster,
    /// Those of the raster, the one that stands for all that are not there, and split ones, four by four.
    bins: Vec<Bin>,
    walls: Vec<Wall>,
}

/// Where in memory the bins are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raster {
    /// Columns and rows, and squares in a row.
    side: [u32; 2],
    squares: u32,
    /// The bin of what is outside.
    nowhere: u32,
}

/// The half planes of a bin, `normal · p >= at`: a point in the first is of the first cone, else one in the second of the second, else of
/// nobody. Small, so that many stay in the cache.
#[derive(Clone, Copy, Debug)]
struct Bin {
    normal: [[i16; 2]; 2],
    at: [i16; 2],
    answer: [u32; 2],
}

/// A bin from which places near it are counted, so that they fit into single precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin([i32; 2]);

/// A place in a bin, in [`PARTS`]: x below, y above.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Place(u32);

/// One wall in one bin: the line `normal · p = at`, p in bins from the bin's corner.
#[derive(Clone, Copy, Debug)]
struct Wall {
    normal: [f32; 2],
    at: f32,
    /// The cone times 16, and flags.
    tag: u32,
}

impl ConeIndex {
    /// An index over the cones of a retina.
    pub fn new(retina: &Retina) -> Self {
        let mut polygons: Vec<Vec<DVec2>> = (0..retina.len()).map(|i| retina.polygon(i).collect()).collect();
        let (min, max) = polygons
            .iter()
            .flatten()
            .fold((DVec2::MAX, DVec2::MIN), |(min, max), p| (min.min(*p), max.max(*p)));
        let extent = if min.x <= max.x { (max - min).max(DVec2::splat(1e-6)) } else { DVec2::ONE };
        let mut areas: Vec<f32> = retina.aperture_um2.iter().copied().filter(|area| *area > 0.0).collect();
        areas.sort_by(f32::total_cmp);
        let small = areas.get(areas.len() / 10).map_or(0.0, |area| f64::from(*area)) / BINS_PER_CONE;
        let least = extent.x * extent.y / (MOST_BINS_PER_CONE * polygons.len().max(1) as f64);
        let size = small.max(least).min(extent.x * extent.y).sqrt();
        let size = size.max(extent.max_element() / MOST_BINS_ALONG);
        let side = [extent.x, extent.y].map(|extent| (extent / size) as u32 + 1);
        let squares = side.map(|side| side.div_ceil(SQUARE));
        let nowhere = squares[0] * squares[1] * SQUARE * SQUARE;
        let raster = Raster { side, squares: squares[0], nowhere };
        let (first, per_um) = (if min.x <= max.x { min } else { DVec2::ZERO }, 1.0 / size);
        for corner in polygons.iter_mut().flatten() {
            *corner = (*corner - first) * per_um;
        }
        let mut parts: Vec<(u32, Wall)> = Vec::new();
        for (cone, polygon) in polygons.iter().enumerate().filter(|(_, polygon)| polygon.len() >= 3) {
            raster.enter(cone as u32, polygon, &mut parts);
        }
        let mut index = Self { first, per_um, raster, bins: Vec::new(), walls: Vec::new() };
        index.gather(&parts, &polygons);
        index
    }

    /// Sorts the walls by bin, cones in their order, and makes the bins.
    fn gather(&mut self, parts: &[(u32, Wall)], polygons: &[Vec<DVec2>]) {
        let nowhere = self.raster.nowhere as usize;
        let mut next = vec![0_u32; nowhere + 1];
        for (bin, _) in parts {
            next[*bin as usize + 1] += 1;
        }
        for bin in 0..nowhere {
            next[bin + 1] += next[bin];
        }
        let mut walls = vec![Wall { normal: [0.0; 2], at: 0.0, tag: 0 }; parts.len()];
        for (bin, wall) in parts {
            let slot = &mut next[*bin as usize];
            walls[*slot as usize] = *wall;
            *slot += 1;
        }
        // Now `next` holds the end of each bin.
        self.bins = vec![Bin::same(NOBODY); nowhere + 1];
        let mut from = 0;
        for bin in 0..nowhere {
            let of_bin = &walls[from as usize..next[bin] as usize];
            from = next[bin];
            self.bins[bin] = Bin::of(of_bin).unwrap_or_else(|| self.split(bin as u32, of_bin, polygons));
        }
    }

    /// Adds the four bins of a bin with these walls, and what leads to them.
    fn split(&mut self, bin: u32, walls: &[Wall], polygons: &[Vec<DVec2>]) -> Bin {
        let first = self.bins.len() as u32;
        let corner = self.raster.corner(bin) * 2.0;
        for quarter in 0..4_u32 {
            let corner = corner + DVec2::new(f64::from(quarter % 2), f64::from(quarter / 2));
            let mut parts = Vec::new();
            for wall in walls.iter().filter(|wall| wall.tag & LAST != 0) {
                let cone = wall.tag >> 4;
                cut(cone, (&polygons[cone as usize], 2.0), corner, quarter, &mut parts);
            }
            let walls: Vec<Wall> = parts.into_iter().map(|(_, wall)| wall).collect();
            let bin = Bin::of(&walls).unwrap_or_else(|| {
                let answer = MORE | LIST | self.walls.len() as u32;
                self.walls.extend_from_slice(&walls);
                self.walls.last_mut().into_iter().for_each(|last| last.tag |= END);
                Bin::same(answer)
            });
            self.bins.push(bin);
        }
        Bin::same(MORE | first)
    }

    /// The cone whose aperture owns `p`, µm of the chart; `None` between apertures and outside.
    #[inline]
    pub fn owner(&self, p: DVec2) -> Option<u32> {
        let at = (p - self.first) * self.per_um;
        if !(at.x >= 0.0 && at.y >= 0.0) {
            return None;
        }
        let (column, row) = (at.x as i32, at.y as i32);
        let part = |at: f64, whole: i32| ((at - f64::from(whole)) * f64::from(PARTS)) as u32;
        let place = Place(part(at.x, column) | part(at.y, row) << 16);
        self.cone(self.answer(self.raster.bin(column, row), place), place)
    }

    /// Bins in a µm.
    pub(crate) fn per_um(&self) -> f64 {
        self.per_um
    }

    /// The bin of a point, or the nearest one.
    pub(crate) fn origin(&self, p: DVec2) -> Origin {
        let at = (p - self.first) * self.per_um;
        let whole = |at: f64, side: u32| at.floor().clamp(0.0, f64::from(side)) as i32;
        let [columns, rows] = self.raster.side;
        Origin([whole(at.x, columns), whole(at.y, rows)])
    }

    /// A point in bins from an origin.
    pub(crate) fn bins_from(&self, origin: Origin, p: DVec2) -> DVec2 {
        let [column, row] = origin.0.map(f64::from);
        (p - self.first) * self.per_um - DVec2::new(column, row)
    }

    /// The raster of bins.
    pub(crate) fn raster(&self) -> Raster {
        self.raster
    }

    /// What a bin says of a place in it.
    #[inline]
    pub(crate) fn answer(&self, bin: u32, place: Place) -> u32 {
        self.bins[bin as usize].answer(place)
    }

    /// Whether an answer is a cone and no more has to be asked.
    #[inline]
    pub(crate) fn is_cone(answer: u32) -> bool {
        answer & MORE == 0
    }

    /// Whether more has to be asked.
    #[inline]
    pub(crate) fn is_more(answer: u32) -> bool {
        answer & MORE != 0 && answer != NOBODY
    }

    /// Asks more: what the quarter of the bin says, and where the place is in that.
    #[inline]
    pub(crate) fn quarter(&self, answer: u32, place: Place) -> (u32, Place) {
        let (quarter, place) = place.quarter();
        (self.answer((answer & !MORE) + quarter, place), place)
    }

    /// The cone that an answer means for a place in its bin.
    #[inline]
    pub(crate) fn cone(&self, answer: u32, place: Place) -> Option<u32> {
        let (answer, place) =
            if Self::is_more(answer) { self.quarter(answer, place) } else { (answer, place) };
        if Self::is_more(answer) {
            self.listed(answer, place)
        } else {
            Self::is_cone(answer).then_some(answer)
        }
    }

    /// Asks more of a quarter of a bin: the first aperture in its list of walls that holds a place.
    pub(crate) fn listed(&self, answer: u32, place: Place) -> Option<u32> {
        let first = answer & !(MORE | LIST);
        let [x, y] = place.parts().map(|part| part as f32 / PARTS);
        let mut inside = true;
        for wall in &self.walls[first as usize..] {
            let left = wall.normal[0] * x + wall.normal[1] * y >= wall.at;
            inside &= left != (wall.tag & RIGHT != 0);
            if wall.tag & LAST != 0 {
                if inside {
                    return Some(wall.tag >> 4);
                }
                if wall.tag & END != 0 {
                    return None;
                }
                inside = true;
            }
        }
        None
    }
}

impl Place {
    /// Both coordinates.
    #[inline]
    fn parts(self) -> [i32; 2] {
        [self.0 & 0xFFFF, self.0 >> 16].map(|part| part as i32)
    }

    /// In which quarter of the bin it is, and where there.
    #[inline]
    fn quarter(self) -> (u32, Self) {
        const HALF: u32 = 1 << (PLACE_BITS - 1);
        let quarter = u32::from(self.0 & HALF != 0) + 2 * u32::from(self.0 & (HALF << 16) != 0);
        (quarter, Self((self.0 & !(HALF | HALF << 16)) << 1))
    }
}

impl Raster {
    /// Where in memory the bin of a column and row is.
    #[inline]
    fn number(self, column: u32, row: u32) -> u32 {
        // Wraps for bins that are not there.
        let square = (row / SQUARE).wrapping_mul(self.squares).wrapping_add(column / SQUARE);
        square.wrapping_mul(SQUARE * SQUARE).wrapping_add(row % SQUARE * SQUARE + column % SQUARE)
    }

    /// The corner of a bin.
    fn corner(self, bin: u32) -> DVec2 {
        let (square, within) = (bin / (SQUARE * SQUARE), bin % (SQUARE * SQUARE));
        let column = square % self.squares * SQUARE + within % SQUARE;
        let row = square / self.squares * SQUARE + within / SQUARE;
        DVec2::new(f64::from(column), f64::from(row))
    }

    /// The bin in a column and row.
    #[inline]
    fn bin(self, column: i32, row: i32) -> u32 {
        let (column, row) = (column as u32, row as u32);
        let there = column < self.side[0] && row < self.side[1];
        let number = self.number(column, row);
        if there { number } else { self.nowhere }
    }

    /// The bin of a point in bins from an origin, and its place in the bin.
    #[inline]
    pub(crate) fn place_near(self, origin: Origin, at: [f32; 2]) -> (u32, Place) {
        // Whole numbers by adding one so large that nothing else has place beside them: a conversion is not made for several at once.
        // Far points stay outside: an origin is in the raster.
        let [x, y] = at.map(|at| {
            let at = if at > -FAR { at } else { -FAR };
            let at = if at < FAR { at } else { FAR };
            let whole = at - 0.5 + ROUNDER;
            let part = (at - (whole - ROUNDER)) * PARTS + ROUNDER;
            let bits = |number: f32| number.to_bits().wrapping_sub(ROUNDER.to_bits());
            (bits(whole) as i32, bits(part))
        });
        let bin = self.bin(origin.0[0].wrapping_add(x.0), origin.0[1].wrapping_add(y.0));
        (bin, Place(x.1 | y.1 << 16))
    }

    /// Enters a cone (corners in bins) into the bins it touches: its walls go to `parts` with their bin.
    fn enter(self, cone: u32, polygon: &[DVec2], parts: &mut Vec<(u32, Wall)>) {
        let (min, max) =
            polygon.iter().fold((DVec2::MAX, DVec2::MIN), |(min, max), p| (min.min(*p), max.max(*p)));
        let [columns, rows] = self.side;
        let [left, right] = [min.x - HAIR, max.x + HAIR].map(|x| (x as u32).min(columns - 1));
        let [top, bottom] = [min.y - HAIR, max.y + HAIR].map(|y| (y as u32).min(rows - 1));
        for row in top..=bottom {
            for column in left..=right {
                let corner = DVec2::new(f64::from(column), f64::from(row));
                cut(cone, (polygon, 1.0), corner, self.number(column, row), parts);
            }
        }
    }
}

impl Bin {
    /// With these walls, cones in their order. `None`: more than two half planes.
    fn of(walls: &[Wall]) -> Option<Self> {
        match *walls {
            [] => Some(Self::same(NOBODY)),
            [a] if a.tag & WHOLE != 0 => Some(Self::same(a.tag >> 4)),
            [a] => Some(Self::same(NOBODY).with(0, a)),
            // What is not of one is of the other.
            [a, b] if a.is_back_of(b) => Some(Self::same(b.tag >> 4).with(0, a)),
            [a, b] if a.tag & b.tag & LAST != 0 => Some(Self::same(NOBODY).with(0, a).with(1, b)),
            _ => None,
        }
    }

    /// The same answer everywhere.
    fn same(answer: u32) -> Self {
        Self { normal: [[0; 2]; 2], at: [i16::MIN; 2], answer: [answer; 2] }
    }

    /// With a wall's half plane and cone.
    fn with(mut self, half: usize, wall: Wall) -> Self {
        let sign = if wall.tag & RIGHT != 0 { -ONE } else { ONE };
        self.normal[half] = wall.normal.map(|n| (n * sign).round() as i16);
        self.at[half] = (wall.at * sign * (PARTS / (1 << COARSE_BITS) as f32)).round() as i16;
        self.answer[half] = wall.tag >> 4;
        self
    }

    /// What it says of a place in it. Which answer it is is chance: no branch.
    #[inline]
    fn answer(&self, place: Place) -> u32 {
        let [x, y] = place.parts();
        let holds = |half: usize| {
            let [a, b] = self.normal[half].map(i32::from);
            a * x + b * y >= i32::from(self.at[half]) << COARSE_BITS
        };
        let rest = select_unpredictable(holds(1), self.answer[1], NOBODY);
        select_unpredictable(holds(0), self.answer[0], rest)
    }
}

impl Wall {
    /// Whether this is the other cone's side of a wall.
    fn is_back_of(self, other: Self) -> bool {
        let apart = |a: f32, b: f32| f64::from((a - b).abs());
        (self.tag ^ other.tag) & RIGHT != 0
            && (self.tag | other.tag) & WHOLE == 0
            && self.tag >> 4 != other.tag >> 4
            && apart(self.at, other.at) < HAIR
            && apart(self.normal[0], other.normal[0]) < HAIR
            && apart(self.normal[1], other.normal[1]) < HAIR
    }
}

/// Adds to `parts` the walls of a polygon that cut the bin at `corner`, if the polygon has a part of the bin. Its corners are times `scale`
/// in bins.
fn cut(cone: u32, (polygon, scale): (&[DVec2], f64), corner: DVec2, bin: u32, parts: &mut Vec<(u32, Wall)>) {
    let before = parts.len();
    for (m, &from) in polygon.iter().enumerate() {
        let (from, to) = (from * scale, polygon[(m + 1) % polygon.len()] * scale);
        let turned = (from.x, from.y) > (to.x, to.y);
        let (a, b) = if turned { (to, from) } else { (from, to) };
        let along = b - a;
        let length = along.length();
        if length <= 0.0 {
            continue;
        }
        let normal = DVec2::new(-along.y, along.x) / length;
        let at = normal.dot(a - corner);
        // Least and most of normal · p - at over the bin.
        let (low, high) =
            (normal.min(DVec2::ZERO).element_sum() - at, normal.max(DVec2::ZERO).element_sum() - at);
        let (low, high) = if turned { (-high, -low) } else { (low, high) };
        if high < -0.5 * HAIR {
            parts.truncate(before);
            return;
        }
        if low <= HAIR {
            let tag = (cone << 4) | if turned { RIGHT } else { 0 };
            parts.push((bin, Wall { normal: [normal.x as f32, normal.y as f32], at: at as f32, tag }));
        }
    }
    match parts[before..].last_mut() {
        Some((_, last)) => last.tag |= LAST,
        // A line that has every point on its left.
        None => parts.push((bin, Wall { normal: [0.0; 2], at: -1.0, tag: (cone << 4) | LAST | WHOLE })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retina::{RegionUm, RetinaParams, build_region};
    use crate::rng::{Purpose, Stream};

    /// In mosaics without and with gaps: the raster, asked from afar and from an origin, against every aperture in turn.
    #[test]
    fn the_raster_says_what_the_polygons_say() {
        for at in [0.0, 300.0, 900.0] {
            let (min, max) = (DVec2::new(at - 40.0, -40.0), DVec2::new(at + 40.0, 40.0));
            let retina = build_region(&RetinaParams::default(), &RegionUm { min, max }).unwrap();
            let index = ConeIndex::new(&retina);
            let origin = index.origin(DVec2::new(at + 7.0, -3.0));
            let mut stream = Stream::new(9, Purpose::Study, 0, 0);
            let mut close = 0;
            for _ in 0..20_000 {
                let p = min - 3.0 + DVec2::new(stream.uniform(), stream.uniform()) * (max - min + 6.0);
                // How far inside an aperture.
                let depth = |cone: usize| {
                    let corners: Vec<DVec2> = retina.polygon(cone).collect();
                    let walls = corners.iter().zip(corners.iter().cycle().skip(1));
                    walls.map(|(a, b)| (*b - *a).normalize().perp_dot(p - *a)).fold(f64::INFINITY, f64::min)
                };
                let near = (0..retina.len()).filter(|i| (retina.center(*i) - p).length() < 20.0);
                let (cone, depth) =
                    near.map(|i| (i, depth(i))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, -1.0));
                let bins_from = index.bins_from(origin, p).as_vec2().to_array();
                let (bin, inside) = index.raster().place_near(origin, bins_from);
                let owner = index.cone(index.answer(bin, inside), inside);
                if depth.abs() < 1e-4 {
                    close += 1;
                    continue;
                }
                let polygons = (depth > 0.0).then_some(cone as u32);
                assert!(index.owner(p) == polygons && owner == polygons, "{p}: {owner:?} {polygons:?}");
            }
            assert!(close < 50, "{close}");
        }
    }

    /// Two triangles that share a wall: every point of it is in exactly one.
    #[test]
    fn a_point_on_a_wall_has_one_side() {
        let (a, b) = (DVec2::new(0.1, 0.7), DVec2::new(2.3, 0.2));
        let (below, above) = (DVec2::new(1.2, -1.0), DVec2::new(1.2, 2.0));
        let corner = DVec2::ZERO;
        for k in 0..1_000 {
            let p = a + (b - a) * (f64::from(k) / 999.0);
            let inside = [[below, b, a], [above, a, b]].map(|polygon| {
                let mut parts = Vec::new();
                cut(0, (&polygon, 1.0), corner, 0, &mut parts);
                // Only the shared wall: the others do not meet rounding here.
                parts
                    .iter()
                    .filter(|(_, wall)| (wall.normal[0] / wall.normal[1] - 0.5 / 2.2).abs() < 1e-5)
                    .all(|(_, wall)| {
                        let left = wall.normal[0] * p.x as f32 + wall.normal[1] * p.y as f32 >= wall.at;
                        left != (wall.tag & RIGHT != 0)
                    })
            });
            assert!(inside[0] != inside[1], "{p}");
        }
    }
}
