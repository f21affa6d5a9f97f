//! L, M and S cones (§13).
//!
//! S cones: each cone is a candidate with probability c, with a random rank; a candidate becomes S when no candidate of lower rank lies within the
//! hard core h (Matérn's second thinning). With m cones in a core (itself included) the share kept is (1 - (1 - c)^m)/m, so
//! c = 1 - (1 - m·s)^(1/m) gives the wanted share s. h = s_repulsion/sqrt(S density), at most `MAX_CORE` spacings. What is S depends
//! on cones within h only: tiles agree. The others are L or M at random with their ratio.

use glam::DVec2;

use super::field::Field;
use super::grid::Grid;
use super::mosaic::ConeType;
use super::relax::Relaxed;
use crate::math;
use crate::rng::{Purpose, Stream};

/// Largest hard core, in spacings.
const MAX_CORE: f64 = 3.0;
/// Cones this many rows from the tile can still decide about cones in it.
const ROWS: f64 = 4.5;

/// What is drawn for each cone: its type and pointing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kind {
    pub(super) cone_type: ConeType,
    pub(super) pointing: [f32; 2],
}

struct Candidate {
    cone: usize,
    rank: u64,
    core: f64,
}

/// Types and pointing of all cones near the tile.
pub(super) fn assign(field: &Field, cones: &Relaxed) -> Vec<Kind> {
    let seed = field.params.seed;
    let [l, m, _] = field.params.cone_ratio;
    let l_share = if l + m > 0.0 { l / (l + m) } else { 1.0 };
    let sd = field.params.pointing_sd_deg.to_radians();
    let none = Kind { cone_type: ConeType::L, pointing: [0.0; 2] };
    let mut kinds = vec![none; cones.id.len()];
    let mut candidates = Vec::new();
    for (i, &id) in cones.id.iter().enumerate() {
        if cones.rows[i] > ROWS {
            continue;
        }
        let mut stream = Stream::new(seed, Purpose::Types, id, 0);
        if stream.uniform() >= l_share {
            kinds[i].cone_type = ConeType::M;
        }
        let rank = (u64::from(stream.word()) << 32) | u64::from(stream.word());
        let share = field.density.s_share(cones.at[i]);
        if share > 0.0 {
            let (chance, core) = candidacy(share, field.params.s_repulsion, cones.spacing[i]);
            if Stream::new(seed, Purpose::Types, id, 1).uniform() < chance {
                candidates.push(Candidate { cone: i, rank, core });
            }
        }
        let (x, y) = Stream::new(seed, Purpose::Pointing, id, 0).normal_pair();
        kinds[i].pointing = [(x * sd) as f32, (y * sd) as f32];
    }
    for i in kept(cones, &candidates) {
        kinds[i].cone_type = ConeType::S;
    }
    // Where there are no others (blue-cone monochromats), S cones are everywhere.
    if l + m <= 0.0 {
        for kind in &mut kinds {
            kind.cone_type = ConeType::S;
        }
    }
    kinds
}

/// Chance of being a candidate and hard core in µm, for a share of S cones.
fn candidacy(share: f64, repulsion: f64, spacing: f64) -> (f64, f64) {
    let cell = spacing * spacing * 0.75_f64.sqrt();
    let core = (repulsion * (cell / share).sqrt()).min(MAX_CORE * spacing);
    let m = cones_within(core / spacing);
    (1.0 - math::pow((1.0 - m * share).max(0.0), 1.0 / m), core)
}

/// Mean number of cones within a distance in spacings of a cone, itself included: shells of the hexagonal lattice, blurred by 0.3.
fn cones_within(distance: f64) -> f64 {
    const SHELLS: [(f64, f64); 5] = [(6.0, 1.0), (6.0, 1.732), (6.0, 2.0), (12.0, 2.646), (6.0, 3.0)];
    let blurred = |at: f64| {
        let t = ((distance - at + 0.3) / 0.6).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    1.0 + SHELLS.iter().map(|&(n, at)| n * blurred(at)).sum::<f64>()
}

/// The candidates without a better one in their core.
fn kept(cones: &Relaxed, candidates: &[Candidate]) -> Vec<usize> {
    let at: Vec<DVec2> = candidates.iter().map(|c| cones.at[c.cone]).collect();
    let size = candidates.iter().map(|c| c.core).fold(1.0, f64::max);
    let grid = Grid::new(&at, size);
    candidates
        .iter()
        .filter(|c| {
            let (p, metric) = (cones.at[c.cone], cones.metric[c.cone]);
            let mut best = true;
            grid.near(p, c.core / metric.shortest(), |k| {
                let other = &candidates[k as usize];
                let within = metric.length2(cones.at[other.cone] - p) < c.core * c.core;
                best &= !(within && (other.rank, other.cone) < (c.rank, c.cone));
            });
            best
        })
        .map(|c| c.cone)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidacy_without_a_core_is_the_share() {
        assert!((candidacy(0.08, 0.0, 2.0).0 - 0.08).abs() < 1e-12);
        let (chance, core) = candidacy(0.08, 0.5, 2.0);
        assert!(chance > 0.08 && chance < 0.3 && core > 2.0 && core < 6.0);
        assert!(candidacy(1e-6, 0.5, 2.0).1 <= 6.0);
    }
}
