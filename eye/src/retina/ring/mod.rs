//! The paper's growth (§15): a retina grown ring by ring from a seed of seven cones.
//!
//! A growth cycle places a ring of new cones just outside the edge (`front`), lets them and the rows behind them move for some sub-cycles of
//! equation (4) (`settle`), removes one of each degenerate pair and puts new cones into voids (`repair`). A cone is known by its hops to the
//! edge, over neighbours with D <= 1.5: from six rows on it is frozen: it pushes, but does not move; four rows later it leaves the live ring for the
//! store (`output`), gets its walls and type when only frozen cones are near, is handed over and forgotten. So memory holds some forty rows,
//! and grows with the square root of the number of cones.
//!
//! This is the slow, readable reference beside the domain generator: serial, and always from the centre, so a cone's number, place and cell
//! do not depend on the region that is asked for, nor on threads.
//!
//! # As printed
//! §15.1 prints D >= 1.5 for neighbours; see `force`. §15 speaks of a circle; rings here keep a local distance to the edge, since spacings
//! differ by meridian. §15.3 finds voids by the walls of cells that are built anew every sub-cycle; here by empty circles, twice in a cone's life (`repair`).
//!
//! # Cost
//! 30 µs of processor time per cone born, cells and types included: 3.1 s for 104 thousand, 33 s for 1.09 million, 180 s for the whole retina of 5.55 million,
//! with at most 166,746 cones and 65 MB in memory.

mod cone;
mod front;
mod output;
mod pairs;
mod repair;
mod sectors;
mod settle;
#[cfg(test)]
mod tests;
mod texture;
mod walls;

use glam::DVec2;

use super::field::Field;
use super::mosaic::Cones;
use super::params::RetinaError;
use super::relax::quantized;
use super::tile::RegionUm;
use cone::Cone;
use front::{Front, last_ring};
use output::Store;
use pairs::{FAR, Pairs};
use settle::Settled;

/// Hops to the edge from which a cone is frozen.
const FREEZE: u8 = 6;
/// Hops to the edge from which a frozen cone is out of reach of all that move.
const LEAVE: u8 = 10;
/// Growth cycles in which a cone that fills a void moves in any case.
const FREE: u32 = 2;
/// Hops at which a cone is searched for voids a second time, and beyond which it is not any more.
const SEARCHED: [u8; 2] = [FREEZE - 1, LEAVE - 2 - FREE as u8];
/// D of neighbours, equation (3).
const NEIGHBOUR: f64 = super::force::NEIGHBOUR;
/// Growth cycles between batches of output.
const BATCH: u32 = 12;
/// Bound of the loop: rings from the fovea to the ora at the densest.
const MAX_CYCLES: u32 = 60_000;

/// What happened during a growth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RingReport {
    /// Growth cycles.
    pub(super) cycles: u32,
    /// Cones born, those that were removed included.
    pub(super) cones_grown: u64,
    /// Cones that were put into voids.
    pub(super) voids_filled: u64,
    /// Cones that were removed because they were too close to another.
    pub(super) degenerate_removed: u64,
    /// Largest number of cones in memory.
    pub(super) most_live: usize,
    /// Largest root mean square step, in radii, of a growth cycle's last sub-cycle from the tenth cycle on.
    pub(super) last_step: f64,
    /// Smallest and largest factor of the feedback on the density.
    pub(super) factor: [f64; 2],
}

/// Grows the retina ring by ring and hands over the cones of `region` in batches as they are deep frozen.
///
/// # Errors
/// `RetinaError::Stalled` when a ring finds no place short of the ora; it does not happen for allowed parameters.
pub(super) fn grow(
    field: &Field,
    region: &RegionUm,
    emit: &mut dyn FnMut(Cones),
) -> Result<RingReport, RetinaError> {
    let mut growth = Growth::new(field);
    let far = region.farthest_from_origin().min(field.density.ora_um());
    for number in 2..MAX_CYCLES {
        if growth.pending_from() > far {
            return Ok(growth.report);
        }
        if !growth.cycle(number) {
            growth.leave_all();
            growth.store.hand_over(field, &[], region, emit);
            return Ok(growth.report);
        }
        if number % BATCH == 0 {
            growth.store.hand_over(field, &growth.live, region, emit);
        }
    }
    Err(RetinaError::Stalled { rho_um: growth.front.rho })
}

/// A retina that is being grown.
struct Growth<'a> {
    field: &'a Field<'a>,
    front: Front,
    /// Cones that move or push.
    live: Vec<Cone>,
    store: Store,
    /// Number of the last ring.
    ring: u32,
    kicks: Vec<DVec2>,
    report: RingReport,
}

impl<'a> Growth<'a> {
    /// The seed: ring 0 is the centre, ring 1 the hexagon.
    fn new(field: &'a Field<'a>) -> Self {
        let mut growth = Self {
            field,
            front: Front::new(),
            live: Vec::new(),
            store: Store::default(),
            ring: 1,
            kicks: settle::kicks(),
            report: RingReport { factor: [1.0; 2], ..RingReport::default() },
        };
        for (k, at) in Front::seed(field).into_iter().enumerate() {
            growth.bear(at, Some(k.min(1) as u32), 0);
        }
        growth
    }

    fn bear(&mut self, at: DVec2, ring: Option<u32>, free_until: u32) {
        let id = self.report.cones_grown;
        self.report.cones_grown += 1;
        let cone = Cone::born(self.field, id, at, ring, self.front.factor);
        self.live.push(Cone { free_until, ..cone });
    }

    /// Smallest eccentricity of a cone that has not been handed over, µm.
    fn pending_from(&self) -> f64 {
        self.live.iter().map(|c| c.at.length()).fold(self.store.nearest_pending(), f64::min)
    }

    /// One growth cycle; false when there is no place for a ring any more.
    fn cycle(&mut self, number: u32) -> bool {
        let places = self.front.next_ring(self.field, &last_ring(&self.live, self.ring), number);
        if places.is_empty() {
            return false;
        }
        for at in places {
            self.bear(at, Some(number), 0);
        }
        self.ring = number;
        self.live = settle::sorted(&self.live);
        let sub_cycles = texture::texture(self.field, self.front.rho).sub_cycles;
        let Settled { bodies, pairs, last_step } = settle::settle(&mut self.live, sub_cycles, &self.kicks);
        let depth = self.depth(&bodies, &pairs);
        let removed = repair::degenerate(&self.live, &bodies, &pairs, &depth);
        let voids = repair::voids(&mut self.live, &bodies, &pairs, &depth, SEARCHED);
        self.freeze(&depth, &removed, number);
        self.report.voids_filled += voids.len() as u64;
        for at in voids {
            self.bear(at, None, number + FREE);
        }
        self.front.correct(&self.live, &last_ring(&self.live, number));
        self.note(number, last_step);
        true
    }

    /// Hops of each live cone from the last ring.
    fn depth(&self, bodies: &[pairs::Body], pairs: &Pairs) -> Vec<u8> {
        let mut depth = vec![FAR; self.live.len()];
        let edge = (0..self.live.len() as u32).filter(|&i| self.live[i as usize].ring == Some(self.ring));
        pairs.both_ways(bodies, NEIGHBOUR).hops(edge, LEAVE, &mut depth);
        depth
    }

    /// Drops the removed cones, freezes those deep enough for the next cycle, and moves those out of reach to the store.
    fn freeze(&mut self, depth: &[u8], removed: &[bool], number: u32) {
        let live = std::mem::take(&mut self.live);
        for ((mut cone, &depth), &removed) in live.into_iter().zip(depth).zip(removed) {
            if removed {
                self.report.degenerate_removed += 1;
                continue;
            }
            // The next ring will be one hop farther out.
            let hops = depth.saturating_add(1);
            if hops >= FREEZE && number >= cone.free_until && !cone.frozen {
                self.freeze_one(&mut cone);
            }
            if hops > LEAVE && cone.frozen {
                self.store.push(cone);
            } else {
                self.live.push(cone);
            }
        }
    }

    /// Fixes a cone at its final place.
    fn freeze_one(&mut self, cone: &mut Cone) {
        cone.frozen = true;
        cone.at = quantized(cone.at);
        let here = self.field.local(cone.at);
        cone.metric = here.metric;
        cone.spacing = self.field.spacing_with(cone.at, here.cos_tilt);
        self.front.add_frozen(cone);
    }

    /// The end: every cone is frozen and leaves.
    fn leave_all(&mut self) {
        for mut cone in std::mem::take(&mut self.live) {
            if !cone.frozen {
                self.freeze_one(&mut cone);
            }
            self.store.push(cone);
        }
    }

    fn note(&mut self, number: u32, last_step: f64) {
        let report = &mut self.report;
        report.cycles = number;
        report.most_live = report.most_live.max(self.live.len() + self.store.len());
        if number >= 10 {
            report.last_step = report.last_step.max(last_step);
        }
        let [low, high] = report.factor;
        report.factor = [low.min(self.front.factor), high.max(self.front.factor)];
    }
}
