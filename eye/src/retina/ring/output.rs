//! From frozen cones to output: deep freezing, cells, types, and forgetting.
//!
//! The store holds cones that have left the live ring. Every few growth cycles the hops between cones (D <= 1.5) are counted anew: a cone at least four hops
//! from the live ring, whose inner rows are frozen too, has only frozen cones within seven hops, so its cell and type are final: it is deep frozen and
//! handed over, if it is in the region. A cone more than eight hops from all that are not yet handed over is forgotten.
//!
//! Cells and types are made arc by arc of some thousand cones, each with the cones up to seven hops round it, sorted by birth number: corners are
//! computed from sorted sets of cones, so arcs and batches agree bit by bit.

use glam::DVec2;

use super::super::cells::build_cells;
use super::super::field::Field;
use super::super::mosaic::Cones;
use super::super::params::CellWalls;
use super::super::relax::Relaxed;
use super::super::tile::{CELL_ROWS, RegionUm};
use super::super::types::{Kind, assign};
use super::cone::Cone;
use super::pairs::{Body, FAR, Links, Pairs, mean_spacing};
use super::sectors::{Sectors, turn};
use super::settle::bodies;
use super::walls::averaged_walls;

/// D of neighbours, equation (3).
const NEIGHBOUR: f64 = super::super::force::NEIGHBOUR;
/// Hops from the live ring at which a cone is deep frozen.
const DEEP: u8 = 4;
/// Hops round a cone that decide about its cell and type.
const MARGIN: u8 = 7;
/// Most cones of an arc.
const ARC: usize = 4_096;

/// The cones that have left the live ring.
#[derive(Debug, Default)]
pub(super) struct Store {
    cones: Vec<Cone>,
    /// Handed over already.
    done: Vec<bool>,
}

impl Store {
    pub(super) fn len(&self) -> usize {
        self.cones.len()
    }

    pub(super) fn push(&mut self, cone: Cone) {
        self.cones.push(cone);
        self.done.push(false);
    }

    /// Smallest eccentricity of a cone that has not been handed over, µm.
    pub(super) fn nearest_pending(&self) -> f64 {
        let pending = self.cones.iter().zip(&self.done).filter(|(_, done)| !**done);
        pending.map(|(c, _)| c.at.length()).fold(f64::INFINITY, f64::min)
    }

    /// Hands over the deep-frozen cones of the region (all that are left when `live` is empty) and forgets what no other cell needs.
    pub(super) fn hand_over(
        &mut self,
        field: &Field,
        live: &[Cone],
        region: &RegionUm,
        emit: &mut dyn FnMut(Cones),
    ) {
        let all: Vec<&Cone> = self.cones.iter().chain(live).collect();
        let bodies = bodies(all.iter().copied());
        let links = links(&bodies);
        let first_live = self.cones.len() as u32;
        let mut hops = vec![FAR; all.len()];
        links.hops(first_live..all.len() as u32, DEEP - 1, &mut hops);
        let deep: Vec<u32> =
            (0..first_live).filter(|&i| !self.done[i as usize] && hops[i as usize] == FAR).collect();
        let mut wanted: Vec<u32> =
            deep.iter().copied().filter(|&i| region.contains(all[i as usize].at)).collect();
        let turn_of = |i: u32| turn(all[i as usize].at);
        wanted.sort_by(|&a, &b| turn_of(a).total_cmp(&turn_of(b)).then(a.cmp(&b)));
        hops.fill(FAR);
        for arc in wanted.chunks(ARC) {
            emit(finish(field, &all, &links, arc, &mut hops));
        }
        for &i in &deep {
            self.done[i as usize] = true;
        }
        let pending = (0..all.len() as u32).filter(|&i| !self.done.get(i as usize).copied().unwrap_or(false));
        hops.fill(FAR);
        links.hops(pending, MARGIN + 1, &mut hops);
        let needed = |i: usize| hops[i] != FAR;
        let mut i = 0;
        self.cones.retain(|_| {
            i += 1;
            needed(i - 1)
        });
        self.done = (0..self.done.len()).filter(|&i| needed(i)).map(|i| self.done[i]).collect();
    }
}

/// Neighbours with D <= 1.5.
fn links(bodies: &[Body]) -> Links {
    let at: Vec<DVec2> = bodies.iter().map(|b| b.at).collect();
    let sectors = Sectors::new(&at, mean_spacing(bodies));
    Pairs::within(bodies, &sectors, NEIGHBOUR).both_ways(bodies, NEIGHBOUR)
}

/// Cells and types of the cones of an arc. `hops` is `FAR` everywhere, before and after.
fn finish(field: &Field, all: &[&Cone], links: &Links, arc: &[u32], hops: &mut [u8]) -> Cones {
    let mut near = links.hops(arc.iter().copied(), MARGIN, hops);
    near.sort_unstable_by_key(|&i| all[i as usize].id);
    let mut batch = Relaxed::default();
    for &i in &near {
        let cone = all[i as usize];
        batch.id.push(cone.id);
        batch.at.push(cone.at);
        batch.radius.push(cone.radius);
        batch.spacing.push(cone.spacing);
        batch.metric.push(cone.metric);
        batch.rows.push(f64::from(hops[i as usize]));
        batch.exact.push(true);
        batch.limited.push(cone.limited);
        batch.coincident.push(cone.coincident);
        hops[i as usize] = FAR;
    }
    let kinds = assign(field, &batch);
    let mut out = Cones::default();
    if field.params.cell_walls == CellWalls::Averaging {
        let walls = averaged_walls(&batch);
        collect(field, &batch, &kinds, |i| walls.polygon(i), &mut out, |i| walls.flags(i));
    } else {
        let cells = build_cells(&batch, CELL_ROWS);
        let flags = |i: usize| [cells.close[i], cells.void[i], cells.concave[i]];
        collect(field, &batch, &kinds, |i| cells.polygon(i), &mut out, flags);
    }
    out
}

/// The cones of the arc that the retina keeps. `flags`: close pair, void, concave.
fn collect<'a>(
    field: &Field,
    batch: &Relaxed,
    kinds: &[Kind],
    polygon: impl Fn(usize) -> &'a [DVec2],
    out: &mut Cones,
    flags: impl Fn(usize) -> [bool; 3],
) {
    for (i, &kind) in kinds.iter().enumerate() {
        let at = batch.at[i];
        if batch.rows[i] > 0.0 || !field.keeps(batch.id[i], at) {
            continue;
        }
        let [close, void, concave] = flags(i);
        out.counts.coincident += u64::from(batch.coincident[i]);
        out.counts.limited_steps += u64::from(batch.limited[i]);
        out.counts.close_pairs += u64::from(close);
        out.counts.voids += u64::from(void);
        out.counts.concave += u64::from(concave);
        let area_factor = batch.metric[i].area_factor();
        out.push(batch.id[i], at, kind, polygon(i), area_factor, field.density.coverage(at));
    }
}
