//! The retina piece by piece: one interface to both generators.
//!
//! `synthesize` hands over the tiles of a region in Morton order, each with all its cones in Morton order of their birth or place, and
//! keeps no more than a few of them: memory does not grow with the region. `domain` builds tiles in parallel. `ring` grows the whole disc
//! out to the region's farthest corner first and holds the region's cones; its own memory is the live ring.

use rayon::prelude::*;

use super::field::Field;
use super::mosaic::{Cones, Retina};
use super::params::{Generator, RetinaError, RetinaParams};
use super::ring;
use super::tile::{RegionUm, TileId, build_tile, tiles_for};

/// Tiles in work at a time, per thread.
const AHEAD: usize = 3;

/// Makes the tiles that meet `region`, does `work` on each (in parallel) and hands the results to `take` in Morton order. A tile is
/// given with its rectangle and all cones in it, those outside `region` too.
///
/// # Errors
/// Parameters out of range.
pub fn synthesize<T: Send>(
    p: &RetinaParams,
    region: &RegionUm,
    work: impl Fn(&RegionUm, Cones) -> T + Sync,
    mut take: impl FnMut(T),
) -> Result<(), RetinaError> {
    p.validate()?;
    let tiles: Vec<(TileId, RegionUm)> =
        tiles_for(region).into_iter().filter_map(|t| t.region().map(|r| (t, r))).collect();
    let grown = match p.generator {
        Generator::Domain => None,
        Generator::Ring => Some(grow(&Field::new(p), &covering(&tiles, region))?),
    };
    for group in tiles.chunks(AHEAD * rayon::current_num_threads()) {
        let made: Result<Vec<T>, RetinaError> = group
            .par_iter()
            .map(|(tile, rectangle)| {
                let cones = match &grown {
                    None => build_tile(p, *tile)?.cones,
                    Some(retina) => retina.part(rectangle),
                };
                Ok(work(rectangle, cones))
            })
            .collect();
        made?.into_iter().for_each(&mut take);
    }
    Ok(())
}

/// The rectangle that holds a region and its tiles.
fn covering(tiles: &[(TileId, RegionUm)], region: &RegionUm) -> RegionUm {
    tiles.iter().fold(*region, |all, (_, r)| RegionUm { min: all.min.min(r.min), max: all.max.max(r.max) })
}

/// The cones of a region by the ring generator.
pub(super) fn grow(field: &Field, region: &RegionUm) -> Result<Retina, RetinaError> {
    let mut batches = Vec::new();
    let report = ring::grow(field, region, &mut |batch| batches.push(batch))?;
    let mut retina = Retina::gather(&batches.iter().collect::<Vec<_>>(), region, field.params);
    // Voids and degenerate pairs are met while the disc grows, inside the region or not.
    retina.cones.counts.seeded = report.voids_filled;
    retina.cones.counts.removed = report.degenerate_removed;
    Ok(retina)
}
