//! Which cone's aperture owns a point of the chart.
//!
//! A raster of square bins over the apertures, some 24 in a small one. A bin has two half planes, each with a cone: the bin inside one
//! aperture, one that a wall crosses, and one with a gap between two apertures. Where more meet, the answer is a list of walls: for every
//! aperture of the bin those that cut it, and a point inside all of them is inside the aperture. Apertures are convex.
//!
//! A point on a wall belongs to exactly one of the two cones: a wall is a line of the bin, made from its end points in lexicographic
//! order, with the same bits for both cones, and a point on it counts as left of it.

use glam::DVec2;

use super::mosaic::Retina;

/// Bins in a small aperture, about: one of ten is smaller.
const BINS_PER_CONE: f64 = 24.0;
/// Most bins per cone, all in all.
const MOST_BINS_PER_CONE: f64 = 128.0;
/// Answer: no aperture.
const NOBODY: u32 = u32::MAX;
/// In place of the number of a bin that is not there.
const NO_BIN: u32 = u32::MAX;
/// Set in an answer that is a list of walls; the rest is its first wall.
const LIST: u32 = 1 << 31;
/// Bins lie in memory in squares of this side, so that neighbours are near.
const SQUARE: usize = 8;
/// A line nearer to a bin than this, in bins, is taken to cross it.
const HAIR: f64 = 1e-5;

/// The aperture is on the right of the wall.
const RIGHT: u32 = 1;
/// Last wall of an aperture in a bin.
const LAST: u32 = 2;
/// Last wall of a bin.
const END: u32 = 4;
/// Length of a line's normal: of whole numbers, it is off by 2e-5.
const ONE: f32 = 32_767.0;
/// No wall: the aperture holds the whole bin.
const WHOLE: u32 = 8;

/// Point location in the apertures of a retina.
#[derive(Clone, Debug)]
pub struct ConeIndex {
    first: DVec2,
    per_um: f64,
    /// Columns and rows, and squares in a row.
    side: [usize; 2],
    squares: usize,
    /// By bin: its line.
    bins: Vec<u32>,
    lines: Vec<Line>,
    walls: Vec<Wall>,
}

/// The half planes of a bin, `normal · p >= at`, times [`ONE`]: a point in the first is of the first cone, else one in the second of the
/// second, else of nobody. Small, so that many stay in the cache.
#[derive(Clone, Copy, Debug)]
struct Line {
    normal: [[i16; 2]; 2],
    at: [f32; 2],
    /// The third is nobody's.
    answer: [u32; 3],
}

/// A bin from which places near it are counted, so that they fit into single precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin([i32; 2]);

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
        let polygons: Vec<Vec<DVec2>> = (0..retina.len()).map(|i| retina.polygon(i).collect()).collect();
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
        let side = [extent.x, extent.y].map(|extent| (extent / size) as usize + 1);
        let squares = side.map(|side| side.div_ceil(SQUARE));
        let first = if min.x <= max.x { min } else { DVec2::ZERO };
        let bins = vec![0; squares[0] * squares[1] * SQUARE * SQUARE];
        let lines = vec![Line::same(NOBODY)];
        let mut index =
            Self { first, per_um: 1.0 / size, side, squares: squares[0], bins, lines, walls: Vec::new() };
        let mut parts: Vec<(u32, Wall)> = Vec::new();
        for (cone, polygon) in polygons.iter().enumerate().filter(|(_, polygon)| polygon.len() >= 3) {
            index.add(cone as u32, polygon, &mut parts);
        }
        index.gather(&parts);
        index
    }

    /// Where in memory the bin of a column and row is.
    #[inline]
    fn number(&self, column: usize, row: usize) -> usize {
        let square = row / SQUARE * self.squares + column / SQUARE;
        square * SQUARE * SQUARE + row % SQUARE * SQUARE + column % SQUARE
    }

    /// Enters a cone into the bins it touches: its walls go to `parts` with their bin.
    fn add(&mut self, cone: u32, polygon: &[DVec2], parts: &mut Vec<(u32, Wall)>) {
        let local: Vec<DVec2> = polygon.iter().map(|p| (*p - self.first) * self.per_um).collect();
        let (min, max) =
            local.iter().fold((DVec2::MAX, DVec2::MIN), |(min, max), p| (min.min(*p), max.max(*p)));
        let [columns, rows] = self.side;
        let [left, right] = [min.x - HAIR, max.x + HAIR].map(|x| (x as usize).min(columns - 1));
        let [top, bottom] = [min.y - HAIR, max.y + HAIR].map(|y| (y as usize).min(rows - 1));
        for row in top..=bottom {
            for column in left..=right {
                let corner = DVec2::new(column as f64, row as f64);
                cut(cone, &local, corner, self.number(column, row) as u32, parts);
            }
        }
    }

    /// Sorts the walls by bin, cones in their order, and makes each bin's line.
    fn gather(&mut self, parts: &[(u32, Wall)]) {
        let mut next = vec![0_u32; self.bins.len() + 1];
        for (bin, _) in parts {
            next[*bin as usize + 1] += 1;
        }
        for bin in 0..self.bins.len() {
            next[bin + 1] += next[bin];
        }
        let mut walls = vec![Wall { normal: [0.0; 2], at: 0.0, tag: 0 }; parts.len()];
        for (bin, wall) in parts {
            let slot = &mut next[*bin as usize];
            walls[*slot as usize] = *wall;
            *slot += 1;
        }
        // Now `next` holds the end of each bin. Cones that hold a whole bin share a line.
        let mut whole: Vec<u32> = Vec::new();
        let mut from = 0;
        for bin in 0..self.bins.len() {
            let of_bin = &walls[from as usize..next[bin] as usize];
            from = next[bin];
            let line = match *of_bin {
                [] => continue,
                [a] if a.tag & WHOLE != 0 => {
                    let cone = (a.tag >> 4) as usize;
                    if whole.len() <= cone {
                        whole.resize(cone + 1, 0);
                    }
                    if whole[cone] > 0 {
                        self.bins[bin] = whole[cone];
                        continue;
                    }
                    whole[cone] = self.lines.len() as u32;
                    Line::same(a.tag >> 4)
                }
                [a] => Line::same(NOBODY).with(0, a),
                // What is not of one is of the other.
                [a, b] if a.is_back_of(b) => Line::same(b.tag >> 4).with(0, a),
                [a, b] if a.tag & b.tag & LAST != 0 => Line::same(NOBODY).with(0, a).with(1, b),
                [.., last] => {
                    let answer = LIST | self.walls.len() as u32;
                    self.walls.extend_from_slice(&of_bin[..of_bin.len() - 1]);
                    self.walls.push(Wall { tag: last.tag | END, ..last });
                    Line::same(answer)
                }
            };
            self.bins[bin] = self.lines.len() as u32;
            self.lines.push(line);
        }
    }

    /// The cone whose aperture owns `p`, µm of the chart; `None` between apertures and outside.
    #[inline]
    pub fn owner(&self, p: DVec2) -> Option<u32> {
        let (bin, at) = self.place(p);
        self.cone(self.answer(self.line(bin), at), at)
    }

    /// Bins in a µm.
    pub(crate) fn per_um(&self) -> f64 {
        self.per_um
    }

    /// The bin of a point, or one near the apertures for a point that is far from all.
    pub(crate) fn origin(&self, p: DVec2) -> Origin {
        let whole = |at: f64, side: usize| at.floor().clamp(-1e6, side as f64 + 1e6) as i32;
        let at = (p - self.first) * self.per_um;
        Origin([whole(at.x, self.side[0]), whole(at.y, self.side[1])])
    }

    /// A point in bins from an origin.
    pub(crate) fn bins_from(&self, origin: Origin, p: DVec2) -> DVec2 {
        let [column, row] = origin.0.map(f64::from);
        (p - self.first) * self.per_um - DVec2::new(column, row)
    }

    /// The bin of a point and its place in the bin. Far points have a bin that is not there.
    fn place(&self, p: DVec2) -> (u32, [f32; 2]) {
        let at = (p - self.first) * self.per_um;
        // What is negative or not a number becomes 0 here.
        let (column, row) = (at.x as i32, at.y as i32);
        if !(at.x >= 0.0 && at.y >= 0.0) {
            return (NO_BIN, [0.0; 2]);
        }
        (self.bin(column, row), [(at.x - f64::from(column)) as f32, (at.y - f64::from(row)) as f32])
    }

    /// The bin of a point in bins from an origin, and its place in the bin; far points have a bin that is not there.
    #[inline]
    pub(crate) fn place_near(&self, origin: Origin, at: [f32; 2]) -> (u32, [f32; 2]) {
        let floor = |x: f32| x as i32 - i32::from(((x as i32) as f32) > x);
        let whole = at.map(floor);
        let bin = self.bin(origin.0[0].wrapping_add(whole[0]), origin.0[1].wrapping_add(whole[1]));
        (bin, [at[0] - whole[0] as f32, at[1] - whole[1] as f32])
    }

    /// The bin in a column and row, if it is there.
    #[inline]
    fn bin(&self, column: i32, row: i32) -> u32 {
        let (column, row) = (column as u32, row as u32);
        let there = (column as usize) < self.side[0] && (row as usize) < self.side[1];
        if there { self.number(column as usize, row as usize) as u32 } else { NO_BIN }
    }

    /// The line of a bin.
    #[inline]
    pub(crate) fn line(&self, bin: u32) -> u32 {
        self.bins.get(bin as usize).copied().unwrap_or(0)
    }

    /// What a line says of a place in its bin.
    #[inline]
    pub(crate) fn answer(&self, line: u32, at: [f32; 2]) -> u32 {
        let Line { normal, at: least, answer } = &self.lines[line as usize];
        let holds = |half: usize| {
            let [x, y] = normal[half].map(f32::from);
            x * at[0] + y * at[1] >= least[half]
        };
        // Which one is chance: no branch.
        answer[usize::from(!holds(0)) * (1 + usize::from(!holds(1)))]
    }

    /// Whether an answer is a cone and no more has to be asked.
    #[inline]
    pub(crate) fn is_cone(answer: u32) -> bool {
        answer & LIST == 0
    }

    /// Whether an answer is a list of walls.
    #[inline]
    pub(crate) fn is_list(answer: u32) -> bool {
        answer & LIST != 0 && answer != NOBODY
    }

    /// The cone that an answer means for a place in its bin.
    #[inline]
    pub(crate) fn cone(&self, answer: u32, at: [f32; 2]) -> Option<u32> {
        match answer {
            NOBODY => None,
            cone if cone & LIST == 0 => Some(cone),
            list => self.listed(list & !LIST, at),
        }
    }

    /// The first aperture in a list of walls that holds a place.
    fn listed(&self, first: u32, [x, y]: [f32; 2]) -> Option<u32> {
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

impl Line {
    /// The same answer everywhere.
    fn same(answer: u32) -> Self {
        Self { normal: [[0; 2]; 2], at: [-1.0; 2], answer: [answer, answer, NOBODY] }
    }

    /// With a wall's half plane and cone.
    fn with(mut self, half: usize, wall: Wall) -> Self {
        let right = wall.tag & RIGHT != 0;
        let sign = if right { -ONE } else { ONE };
        self.normal[half] = wall.normal.map(|n| (n * sign).round() as i16);
        // What is right of a wall is not on it.
        self.at[half] = if right { (wall.at * sign).next_up() } else { wall.at * sign };
        self.answer[half] = wall.tag >> 4;
        self
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

/// Adds to `parts` the walls of a polygon (in bins) that cut the bin at `corner`, if the polygon has a part of the bin.
fn cut(cone: u32, polygon: &[DVec2], corner: DVec2, bin: u32, parts: &mut Vec<(u32, Wall)>) {
    let before = parts.len();
    for (m, &from) in polygon.iter().enumerate() {
        let to = polygon[(m + 1) % polygon.len()];
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
                let (bin, inside) = index.place_near(origin, bins_from);
                let owner = index.cone(index.answer(index.line(bin), inside), inside);
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
                cut(0, &polygon, corner, 0, &mut parts);
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
