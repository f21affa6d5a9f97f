//! Cones as a structure of arrays: one tile of them, or the cones of a region.

use std::ops::Deref;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::clip::area;
use super::params::RetinaParams;
use super::tile::{RegionUm, TileId};
use super::types::Kind;

/// Long-, middle- and short-wavelength sensitive cones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum ConeType {
    /// Long.
    L = 0,
    /// Middle.
    M = 1,
    /// Short.
    S = 2,
}

/// Rare events met while cones were made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Encounters of two cones in one place (parted by a hashed direction).
    pub coincident: u64,
    /// Cones removed because another was closer than D = 0.6 (§15.4).
    pub removed: u64,
    /// Cones seeded in voids (§15.3).
    pub seeded: u64,
    /// Cones with a neighbour closer than D = 0.6 at the end.
    pub close_pairs: u64,
    /// Cells that reach the size limit.
    pub voids: u64,
    /// Cells that lost a corner to be convex; they overlap a neighbour's by a sliver where apertures fill the cells.
    pub concave: u64,
    /// Relaxation steps that were cut to the limit.
    pub limited_steps: u64,
}

impl Counts {
    /// Names of the counts, in the order of `to_array`.
    pub const NAMES: [&str; 7] = [
        "coincident cones parted",
        "degenerate cones removed",
        "cones seeded in voids",
        "close pairs",
        "voids",
        "concave cells",
        "limited steps",
    ];

    /// All counts, in the order of the fields.
    pub fn to_array(self) -> [u64; 7] {
        let Self { coincident, removed, seeded, close_pairs, voids, concave, limited_steps } = self;
        [coincident, removed, seeded, close_pairs, voids, concave, limited_steps]
    }

    pub(super) fn from_array(counts: [u64; 7]) -> Self {
        let [coincident, removed, seeded, close_pairs, voids, concave, limited_steps] = counts;
        Self { coincident, removed, seeded, close_pairs, voids, concave, limited_steps }
    }

    /// The sum of two.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        let (a, b) = (self.to_array(), other.to_array());
        Self::from_array(std::array::from_fn(|i| a[i] + b[i]))
    }
}

/// Cones, field by field; all vectors have one entry a cone unless said.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cones {
    /// Stable global number: ring, patch and lattice point of the birth place; unique in a retina and independent of tiles.
    pub id: Vec<u64>,
    /// Centre, µm of the chart; a multiple of 2^-16 µm.
    pub x_um: Vec<f64>,
    /// Centre, µm of the chart; a multiple of 2^-16 µm.
    pub y_um: Vec<f64>,
    /// L, M or S.
    pub cone_type: Vec<ConeType>,
    /// First corner of each polygon in `polygon_xy`, counted in corners; one more entry than cones.
    pub polygon_start: Vec<u32>,
    /// Corners x, y of the light-collecting aperture relative to the centre, µm of the chart, counter-clockwise, convex. Where the aperture
    /// fills the cell, centre + corner is exact in f64 and cones that share a corner get the same bits.
    pub polygon_xy: Vec<f32>,
    /// Area of the full cell in the plane across the cone's direction, µm².
    pub cell_area_um2: Vec<f32>,
    /// Area of the aperture polygon in the plane across the cone's direction, µm².
    pub aperture_um2: Vec<f32>,
    /// Pointing error, radians, along the x_um and y_um tangents: two independent normal numbers with `pointing_sd_deg` each.
    pub pointing: Vec<[f32; 2]>,
    /// Whether a measured cone lies at the rim of its mosaic or beside a gap, so that its cell is not known.
    pub edge: Vec<bool>,
    /// Rare events.
    pub counts: Counts,
}

impl Cones {
    /// Number of cones.
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }

    /// Centre of cone `i`, µm of the chart. Panics when there is no such cone.
    pub fn center(&self, i: usize) -> DVec2 {
        DVec2::new(self.x_um[i], self.y_um[i])
    }

    /// Corners of the aperture of cone `i`, absolute, µm of the chart, counter-clockwise. Panics when there is no such cone.
    pub fn polygon(&self, i: usize) -> impl ExactSizeIterator<Item = DVec2> + '_ {
        let center = self.center(i);
        self.corners(i).chunks_exact(2).map(move |c| center + DVec2::new(f64::from(c[0]), f64::from(c[1])))
    }

    /// The slice of `polygon_xy` of cone `i`.
    fn corners(&self, i: usize) -> &[f32] {
        &self.polygon_xy[2 * self.polygon_start[i] as usize..2 * self.polygon_start[i + 1] as usize]
    }

    /// Adds a cone with the cell `polygon` (absolute), of which `coverage` collects light.
    pub(super) fn push(
        &mut self,
        id: u64,
        at: DVec2,
        kind: Kind,
        polygon: &[DVec2],
        area_factor: f64,
        coverage: f64,
    ) {
        self.start();
        let shrink = coverage.sqrt();
        let cell = area(polygon) * area_factor;
        self.id.push(id);
        self.x_um.push(at.x);
        self.y_um.push(at.y);
        self.cone_type.push(kind.cone_type);
        for &corner in polygon {
            let relative = (corner - at) * shrink;
            self.polygon_xy.extend([relative.x as f32, relative.y as f32]);
        }
        self.polygon_start.push((self.polygon_xy.len() / 2) as u32);
        self.cell_area_um2.push(cell as f32);
        self.aperture_um2.push((cell * coverage) as f32);
        self.pointing.push(kind.pointing);
        self.edge.push(false);
    }

    /// Makes sure that `polygon_start` has its first entry.
    fn start(&mut self) {
        if self.polygon_start.is_empty() {
            self.polygon_start.push(0);
        }
    }

    /// Adds cone `i` of `from`.
    fn push_from(&mut self, from: &Self, i: usize) {
        self.start();
        self.id.push(from.id[i]);
        self.x_um.push(from.x_um[i]);
        self.y_um.push(from.y_um[i]);
        self.cone_type.push(from.cone_type[i]);
        self.polygon_xy.extend_from_slice(from.corners(i));
        self.polygon_start.push((self.polygon_xy.len() / 2) as u32);
        self.cell_area_um2.push(from.cell_area_um2[i]);
        self.aperture_um2.push(from.aperture_um2[i]);
        self.pointing.push(from.pointing[i]);
        self.edge.push(from.edge[i]);
    }
}

/// The cones whose centre lies in one tile, in Morton order of their birth places.
#[derive(Clone, Debug, PartialEq)]
pub struct RetinaTile {
    /// Which tile.
    pub tile: TileId,
    /// What it was made from.
    pub params: RetinaParams,
    /// The cones; their fields are reached directly.
    pub cones: Cones,
}

impl Deref for RetinaTile {
    type Target = Cones;

    fn deref(&self) -> &Cones {
        &self.cones
    }
}

/// The cones of a region, in Morton order of their centre.
#[derive(Clone, Debug, PartialEq)]
pub struct Retina {
    /// The region.
    pub region: RegionUm,
    /// What it was made from.
    pub params: RetinaParams,
    /// The cones; their fields are reached directly.
    pub cones: Cones,
}

impl Deref for Retina {
    type Target = Cones;

    fn deref(&self) -> &Cones {
        &self.cones
    }
}

impl Retina {
    /// The cones of the tiles whose centre is in the region, in Morton order of position, then by id; tiles may come in any order and repeat.
    /// Parameters are those of the first tile; of no tile, the default.
    pub fn assemble(tiles: &[RetinaTile], region: &RegionUm) -> Self {
        let params = tiles.first().map_or_else(RetinaParams::default, |t| t.params.clone());
        Self::gather(&tiles.iter().map(|t| &t.cones).collect::<Vec<_>>(), region, &params)
    }

    /// The same from bare cones.
    pub(super) fn gather(parts: &[&Cones], region: &RegionUm, params: &RetinaParams) -> Self {
        let mut order = Vec::new();
        let mut cones = Cones::default();
        let mut total = Counts::default();
        for (t, part) in parts.iter().enumerate() {
            total = total.plus(part.counts);
            for i in 0..part.len() {
                let at = part.center(i);
                if region.contains(at) {
                    order.push((morton(at), part.id[i], t, i));
                }
            }
        }
        order.sort_unstable();
        order.dedup_by_key(|o| o.1);
        cones.start();
        for (_, _, t, i) in order {
            cones.push_from(parts[t], i);
        }
        cones.counts = total;
        Self { region: *region, params: params.clone(), cones }
    }

    /// The cones of a part of it, in the same order; the counts stay those of the whole.
    #[must_use]
    pub fn within(&self, region: &RegionUm) -> Self {
        let cones = Cones { counts: self.cones.counts, ..self.part(region) };
        Self { region: *region, params: self.params.clone(), cones }
    }

    /// The cones in a rectangle, in order; without counts, which are of the whole.
    pub(super) fn part(&self, rectangle: &RegionUm) -> Cones {
        let mut part = Cones::default();
        part.start();
        for i in (0..self.len()).filter(|&i| rectangle.contains(self.center(i))) {
            part.push_from(&self.cones, i);
        }
        part
    }

    /// Number of cones.
    pub fn len(&self) -> usize {
        self.cones.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.cones.is_empty()
    }
}

/// Interleaved bits of the position in steps of 1/256 µm.
pub(super) fn morton(p: DVec2) -> u64 {
    let spread = |v: f64| {
        // Saturating: positions are within 32 mm of the origin.
        let mut x = u64::from(((v + 65_536.0) * 256.0) as u32);
        for (shift, mask) in [
            (16, 0x0000_FFFF_0000_FFFF_u64),
            (8, 0x00FF_00FF_00FF_00FF),
            (4, 0x0F0F_0F0F_0F0F_0F0F),
            (2, 0x3333_3333_3333_3333),
            (1, 0x5555_5555_5555_5555),
        ] {
            x = (x | (x << shift)) & mask;
        }
        x
    };
    spread(p.x) | (spread(p.y) << 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_interleaves() {
        let origin = morton(DVec2::ZERO);
        assert_eq!(morton(DVec2::new(1.0 / 256.0, 0.0)), origin + 1);
        assert_eq!(morton(DVec2::new(0.0, 1.0 / 256.0)), origin + 2);
        assert_eq!(morton(DVec2::splat(3.0 / 256.0)), origin + 15);
    }

    #[test]
    fn no_tiles_make_an_empty_retina() {
        let region = RegionUm { min: DVec2::ZERO, max: DVec2::ONE };
        let retina = Retina::assemble(&[], &region);
        assert!(retina.is_empty());
        assert_eq!(retina.polygon_start, [0]);
    }
}
