//! Tiles: the retina's chart cut into squares that can be made one by one, in any order, anywhere.
//!
//! The chart is divided into squares of `TILE_UM`; away from the fovea, where cones are rarer, aligned blocks of 2x2 and 4x4 of them
//! are one tile. A tile is named by the square at its lower left corner. Its edges are half-open, so a cone is in one tile.
//!
//! A tile is made from birth places in a halo round it. `relax` follows which cones have seen all their true neighbours at every
//! sub-cycle; a tile whose cones, cells and types did not all come from such cones is made again with a thicker halo. So tiles agree
//! bit by bit along their borders.
//!
//! # Cost
//! Larger tiles have less halo a cone; see `cargo bench -p photoneye-eye --bench retina`.

use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cells::{Cells, build_cells};
use super::field::Field;
use super::mosaic::{Cones, Retina, RetinaTile, morton};
use super::params::{Generator, RetinaError, RetinaParams};
use super::relax::{Relaxed, relax};
use super::synthesize::grow;
use super::types::{Kind, assign};

/// Side of the smallest tile, µm of the chart.
pub const TILE_UM: f64 = 1_024.0;
/// Distance from the foveal centre, µm, from which blocks of 2 and 4 squares a side are one tile.
const BLOCK_FROM_UM: [f64; 2] = [2_000.0, 6_000.0];
/// Rows of cones round a tile that must be exact: cells two rows out with all their neighbours, S cones three rows out.
const EXACT_ROWS: f64 = 6.0;
/// Rows round a tile for which cells are built.
pub(super) const CELL_ROWS: f64 = 4.0;
/// No cone is farther than this from the foveal centre along an axis, µm of arc.
const LIMIT_UM: f64 = 36_000.0;
/// Fewest and most cones in a part of a region.
const PART_CONES: [f64; 2] = [4_000.0, 40_000.0];
/// How often a halo is widened before giving up.
const ATTEMPTS: u32 = 4;

/// A rectangle of the chart, µm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionUm {
    /// Lower left corner.
    pub min: DVec2,
    /// Upper right corner.
    pub max: DVec2,
}

impl RegionUm {
    /// Whether the point is inside; the lower edges belong to the region, the upper ones do not.
    pub fn contains(&self, p: DVec2) -> bool {
        p.cmpge(self.min).all() && p.cmplt(self.max).all()
    }

    pub(super) fn contains_closed(&self, p: DVec2) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    pub(super) fn grown(&self, by: f64) -> Self {
        Self { min: self.min - DVec2::splat(by), max: self.max + DVec2::splat(by) }
    }

    /// The part within `limit` of the origin along both axes; `None` when nothing is left or the region is not a number.
    fn within(&self, limit: f64) -> Option<Self> {
        let part = Self { min: self.min.max(DVec2::splat(-limit)), max: self.max.min(DVec2::splat(limit)) };
        let sound = self.min.is_finite() && self.max.is_finite() && part.min.cmplt(part.max).all();
        sound.then_some(part)
    }

    pub(super) fn corners(&self) -> [DVec2; 4] {
        [self.min, DVec2::new(self.max.x, self.min.y), self.max, DVec2::new(self.min.x, self.max.y)]
    }

    pub(super) fn nearest(&self, p: DVec2) -> DVec2 {
        p.max(self.min).min(self.max)
    }

    pub(super) fn distance_to_origin(&self) -> f64 {
        self.nearest(DVec2::ZERO).length()
    }

    pub(super) fn farthest_from_origin(&self) -> f64 {
        self.corners().iter().map(|c| c.length()).fold(0.0, f64::max)
    }
}

/// Name of a tile: column and row of its lower left square, `TILE_UM` a step, (0, 0) starting at the foveal centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TileId {
    /// Column.
    pub i: i32,
    /// Row.
    pub j: i32,
}

impl TileId {
    /// The tile that holds the square (i, j).
    fn of_square(i: i32, j: i32) -> (Self, i32) {
        let mut found = (Self { i, j }, 1);
        for (level, from) in BLOCK_FROM_UM.iter().enumerate() {
            let side = 2 << level;
            let block = Self { i: i.div_euclid(side) * side, j: j.div_euclid(side) * side };
            if square_region(block, side).distance_to_origin() < *from {
                break;
            }
            found = (block, side);
        }
        found
    }

    /// The lower left corner, µm.
    fn corner(self) -> DVec2 {
        DVec2::new(f64::from(self.i), f64::from(self.j)) * TILE_UM
    }

    /// The part of the chart that the tile owns; `None` when no tile starts here.
    pub fn region(self) -> Option<RegionUm> {
        let limit = 1 << 20;
        if self.i.abs() > limit || self.j.abs() > limit {
            return None;
        }
        let (tile, side) = Self::of_square(self.i, self.j);
        (tile == self).then(|| square_region(tile, side))
    }
}

fn square_region(t: TileId, side: i32) -> RegionUm {
    let at = |i: i32| f64::from(i) * TILE_UM;
    RegionUm { min: DVec2::new(at(t.i), at(t.j)), max: DVec2::new(at(t.i + side), at(t.j + side)) }
}

/// The tiles that meet the region, in Morton order: the cones of one after the other are in Morton order too. Nothing beyond 36 mm of arc is listed; an empty or NaN region has no tiles.
pub fn tiles_for(region: &RegionUm) -> Vec<TileId> {
    let Some(inside) = region.within(LIMIT_UM) else {
        return Vec::new();
    };
    let (low, high) = ((inside.min / TILE_UM).floor(), (inside.max / TILE_UM).ceil());
    let mut tiles: Vec<TileId> = (low.x as i32..high.x as i32)
        .flat_map(|i| (low.y as i32..high.y as i32).map(move |j| TileId::of_square(i, j).0))
        .collect();
    tiles.sort_unstable_by_key(|t| morton(t.corner()));
    tiles.dedup();
    tiles
}

/// The cones of one tile: a pure function of parameters and tile. With the ring generator the disc out to the tile's far corner is grown
/// for it.
///
/// # Errors
/// Parameters out of range, or a tile that is not one of the tiling.
pub fn build_tile(p: &RetinaParams, t: TileId) -> Result<RetinaTile, RetinaError> {
    p.validate()?;
    let region = t.region().ok_or(RetinaError::NotATile { i: t.i, j: t.j })?;
    let field = Field::new(p);
    if region.distance_to_origin() > field.density.ora_um() {
        return Ok(RetinaTile { tile: t, params: p.clone(), cones: Cones::default() });
    }
    let cones = match p.generator {
        Generator::Domain => build_cones(&field, &region)?,
        Generator::Ring => grow(&field, &region)?.cones,
    };
    Ok(RetinaTile { tile: t, params: p.clone(), cones })
}

/// The cones of a rectangle: what they are does not depend on the rectangle.
fn build_cones(field: &Field, region: &RegionUm) -> Result<Cones, RetinaError> {
    for attempt in 0..ATTEMPTS {
        let relaxed = relax(field, region, EXACT_ROWS, 1.0 + 0.25 * f64::from(attempt));
        if relaxed.is_exact(EXACT_ROWS) {
            let cells = build_cells(&relaxed, CELL_ROWS);
            let kinds = assign(field, &relaxed);
            return Ok(collect(field, region, &relaxed, &cells, &kinds));
        }
    }
    Err(RetinaError::Halo { x_um: region.min.x, y_um: region.min.y })
}

/// The cones whose final place is in the region, in Morton order of birth.
fn collect(field: &Field, region: &RegionUm, relaxed: &Relaxed, cells: &Cells, kinds: &[Kind]) -> Cones {
    let mut cones = Cones::default();
    cones.counts.removed = relaxed.removed.iter().filter(|&&at| region.contains(at)).count() as u64;
    for (i, (&at, &kind)) in relaxed.at.iter().zip(kinds).enumerate() {
        if !region.contains(at) || relaxed.rows[i] > CELL_ROWS || !field.keeps(relaxed.id[i], at) {
            continue;
        }
        cones.counts.coincident += u64::from(relaxed.coincident[i]);
        cones.counts.limited_steps += u64::from(relaxed.limited[i]);
        cones.counts.close_pairs += u64::from(cells.close[i]);
        cones.counts.voids += u64::from(cells.void[i]);
        cones.counts.concave += u64::from(cells.concave[i]);
        let area_factor = relaxed.metric[i].area_factor();
        let coverage = field.density.coverage(at);
        let polygon = cells.polygon(i);
        cones.push(relaxed.id[i], at, kind, polygon, area_factor, coverage);
    }
    cones
}

/// The cones of a region, made in parallel in parts as large as the number of threads allows, which share less halo than
/// tiles do. The cones and their order are those of `assemble` over the region's tiles, for any number of threads; `counts` are of the region alone.
///
/// # Errors
/// Parameters out of range.
pub fn build_region(p: &RetinaParams, region: &RegionUm) -> Result<Retina, RetinaError> {
    p.validate()?;
    let field = Field::new(p);
    if p.generator == Generator::Ring {
        return match region.within(LIMIT_UM) {
            Some(_) => grow(&field, region),
            None => Ok(Retina::gather(&[], region, p)),
        };
    }
    let mut parts = Vec::new();
    if let Some(inside) = region.within(LIMIT_UM) {
        let share = expected_cones(&field, &inside) / rayon::current_num_threads() as f64;
        split(&field, inside, share.clamp(PART_CONES[0], PART_CONES[1]), &mut parts);
    }
    let parts: Result<Vec<_>, _> = parts.par_iter().map(|part| build_cones(&field, part)).collect();
    Ok(Retina::gather(&parts?.iter().collect::<Vec<_>>(), region, p))
}

/// Cones that the target asks for in a rectangle, by 8 x 8 midpoints.
fn expected_cones(field: &Field, region: &RegionUm) -> f64 {
    let step = (region.max - region.min) / 8.0;
    let density: f64 = (0..64)
        .map(|k| region.min + step * DVec2::new(f64::from(k % 8) + 0.5, f64::from(k / 8) + 0.5))
        .filter(|at| field.density.is_retina(*at))
        .map(|at| field.density.per_mm2(at))
        .sum();
    1e-6 * density * step.x * step.y
}

/// Halves a rectangle across its longer side until no part is expected to hold over 1.2 times `share` cones or is larger than a tile may
/// be there (over a longer way the density changes too much for one halo).
fn split(field: &Field, region: RegionUm, share: f64, parts: &mut Vec<RegionUm>) {
    let size = region.max - region.min;
    let blocks = BLOCK_FROM_UM.iter().filter(|from| region.distance_to_origin() >= **from).count() as i32;
    let largest = 1.5 * TILE_UM * f64::from(1_i32 << blocks);
    let fits = size.max_element() <= largest && expected_cones(field, &region) <= 1.2 * share;
    if fits || size.max_element() < TILE_UM / 8.0 {
        parts.push(region);
        return;
    }
    let middle = 0.5 * (region.min + region.max);
    let (mut low, mut high) = (region, region);
    if size.x >= size.y {
        (low.max.x, high.min.x) = (middle.x, middle.x);
    } else {
        (low.max.y, high.min.y) = (middle.y, middle.y);
    }
    split(field, low, share, parts);
    split(field, high, share, parts);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_partition_the_chart() {
        let region = RegionUm { min: DVec2::new(-9_000.0, -3_000.0), max: DVec2::new(2_000.0, 9_000.0) };
        let tiles = tiles_for(&region);
        assert!(tiles.is_sorted_by_key(|t| morton(t.corner())));
        for k in 0..2_000 {
            let p = DVec2::new(
                f64::from(k * 7_919 % 11_000) - 9_000.0,
                f64::from(k * 104_729 % 12_000) - 3_000.0,
            );
            assert_eq!(tiles.iter().filter(|t| t.region().unwrap().contains(p)).count(), 1);
        }
        let far = tiles.iter().find(|t| t.region().unwrap().distance_to_origin() > 6_500.0).unwrap();
        assert!(TileId { i: far.i + 1, j: far.j }.region().is_none());
        assert!(TileId { i: i32::MIN, j: i32::MAX }.region().is_none());
        let nan = RegionUm { min: DVec2::NAN, max: DVec2::NAN };
        assert!(tiles_for(&nan).is_empty());
    }
}
