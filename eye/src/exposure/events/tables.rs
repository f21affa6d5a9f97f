//! What does not change between frames: point spreads by field node and wavelength, and what share of arriving photons each cone counts.

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::dice::halves;
use super::landing::Landing;
use super::list::Wavelengths;
use super::spread::Spread;
use crate::experiment::Experiment;
use crate::exposure::cones::{ConeTable, MappedCone};
use crate::exposure::inputs::Inputs;
use crate::exposure::spectral::{ARRIVING, KINDS, Paths, Share};
use crate::exposure::transfer::{FieldPoint, spot_radius_um, wavefronts};
use crate::exposure::{KernelSpec, Kernels};
use crate::optics::beam::nominal_mm2;
use crate::optics::{BeamField, Projection};
use crate::psf::Wavefront;
use crate::retina::{ConeIndex, Origin};

/// Steps of eccentricity between which weights are interpolated.
pub(super) const ECC_STEPS: usize = 32;
/// Largest distance of field nodes, µm (0.7°).
pub(crate) const NODE_UM: f64 = 200.0;

/// 2^-16: a place in a cell is a whole number of 16 bits.
const PART: f64 = 1.0 / 65_536.0;

/// Optics at one field node and wavelength, what every photon asks of it.
#[derive(Clone, Copy)]
pub(super) struct Node {
    /// From the landing point at the reference wavelength to that at this one, bins of the cones' index.
    shift: [f32; 2],
    /// From there to the first corner of the point spread's core.
    corner: [f32; 2],
    /// Bins from one of the parts of a cell to the next, by row and by column.
    by_row: [f32; 2],
    by_column: [f32; 2],
    /// Where its core begins, and the binary logarithm of its side.
    core: u32,
    bits: u32,
}

/// The nodes of one wavelength.
struct Nodes {
    places: Vec<Node>,
    /// The cores of their point spreads, one after the other.
    cores: Vec<u32>,
    /// The point spreads without their cores.
    spreads: Vec<Spread>,
}

/// The field nodes around a block of pixels, in bins from the block's origin.
#[derive(Clone, Copy)]
pub(super) struct Field {
    from: [f32; 2],
    per_bin: [f32; 2],
    last: [f32; 2],
    across: u32,
}

/// One cone's place among the weights.
#[derive(Clone, Copy)]
struct Cone {
    /// Of the step of eccentricity below and its kind, in the weights one after the other.
    weight: u32,
    /// How far it is to the next step.
    t: f32,
    pointing: f32,
}

impl Cone {
    /// A cone between the ends of the table's eccentricities.
    fn new(cone: &MappedCone, [from, to]: [f64; 2]) -> Self {
        let at = ((cone.ecc_deg - from) / (to - from).max(1e-12)).clamp(0.0, 1.0) * ECC_STEPS as f64;
        let below = (at as usize).min(ECC_STEPS - 1);
        let weight = below * KINDS.len() + cone.cone_type as usize;
        Self { weight: weight as u32, t: (at - below as f64) as f32, pointing: cone.pointing as f32 }
    }

    fn caught(self) -> Caught {
        let weight = self.weight as usize;
        Caught { kind: weight % KINDS.len(), below: weight / KINDS.len(), t: self.t }
    }
}

/// Which weights a cone counts with: its kind, and its place between two steps of eccentricity.
pub(super) struct Caught {
    pub(super) kind: usize,
    pub(super) below: usize,
    pub(super) t: f32,
}

/// The core of a node's point spread.
#[derive(Clone, Copy)]
pub(super) struct Core<'a> {
    pub(super) node: &'a Node,
    cells: &'a [u32],
}

/// What becomes of a drawn photon that has landed on a cone.
pub(super) struct Odds {
    /// Probability that it is counted.
    pub(super) counted: f32,
    /// Arriving photons it stands for.
    pub(super) arrived: f32,
    /// Of those, the guided ones.
    pub(super) guided: f32,
}

/// Weights by step of eccentricity and kind.
type Weights = [[f32; KINDS.len()]; ECC_STEPS + 1];

/// What is needed of one primary near one wavelength node.
pub(super) struct Beam<'a> {
    cones: &'a [Cone],
    nodes: &'a Nodes,
    /// By field node: odds per weight.
    per_weight: &'a [f32],
    weights: &'a Weights,
}

/// The tables.
pub(super) struct Tables {
    /// First node on the retina, µm, nodes per µm, and the number of nodes along each side.
    first_um: DVec2,
    per_um: DVec2,
    side: [usize; 2],
    /// `[wave]`.
    nodes: Vec<Nodes>,
    /// `[primary][wave]`: shares of the primary's photons that are caught.
    weights: Vec<Vec<Weights>>,
    /// `[primary][wave][node]`.
    per_weight: Vec<Vec<Vec<f32>>>,
    /// `[primary][wave]`: the most that any cone counts.
    most: Vec<Vec<f64>>,
    cones: Vec<Cone>,
    /// `[primary][wave]`, when photons are listed.
    wavelengths: Vec<Vec<Wavelengths>>,
}

impl Tables {
    /// Traces the eye at the nodes and looks the weights up.
    ///
    /// # Errors
    /// When a node is not seen or the pupil cannot be traced there.
    pub(super) fn new(
        (inputs, kernels): (&Inputs, &Kernels),
        (cones, index): (&ConeTable, &ConeIndex),
        landing: &Landing,
        experiment: &Experiment,
    ) -> Result<Self, String> {
        let Inputs { retina, projection, .. } = inputs;
        let spec = kernels.spec();
        let absorbers = spec.absorbers()?;
        let shares = kernels.shares();
        let [ecc_from, ecc_to] = spec.ecc_deg;
        let ecc = |step: usize| ecc_from + (ecc_to - ecc_from) * step as f64 / ECC_STEPS as f64;
        let waves = spec.nodes_nm.len();
        let paths: Vec<Paths> = spec.nodes_nm.iter().map(|nm| kernels.paths_at(*nm)).collect();
        let of_primary = |shares: &Vec<_>| {
            let mut weights: Vec<Weights> = vec![[[0.0; KINDS.len()]; ECC_STEPS + 1]; waves];
            for (k, kind) in KINDS.into_iter().enumerate() {
                for step in 0..=ECC_STEPS {
                    let caught = absorbers.weights_along(shares, &spec.nodes_nm, kind, ecc(step), &paths);
                    for (wave, value) in weights.iter_mut().zip(caught) {
                        wave[step][k] = value as f32;
                    }
                }
            }
            weights
        };
        let weights: Vec<Vec<Weights>> = shares.par_iter().map(of_primary).collect();
        let cones: Vec<Cone> = cones.cones.iter().map(|cone| Cone::new(cone, spec.ecc_deg)).collect();
        let pointing = cones.iter().map(|cone| cone.pointing).fold(0.0, f32::max);

        let listed = experiment.counts.photon_list;
        let of_node = |shares: &[Share], node: usize| {
            Wavelengths::new(&absorbers, shares, (&spec.nodes_nm, node), ecc, paths[node])
        };
        let wavelengths = if listed { table(shares, waves, of_node) } else { Vec::new() };

        // Nodes evenly over the retina that the window is imaged on and the cones lie on.
        let [from, to] = landing.bounds();
        let (low, high) = (landing.um(from), landing.um(to));
        let (min, max) = (low.min(high).max(retina.region.min), low.max(high).min(retina.region.max));
        let side = [0, 1].map(|axis| ((max[axis] - min[axis]).max(0.0) / NODE_UM).ceil() as usize + 1);
        let step_um =
            DVec2::from_array([0, 1].map(|axis| (max[axis] - min[axis]) / (side[axis] - 1).max(1) as f64));
        let nodes = trace((projection, &inputs.beams), spec, (min, step_um, side), index.per_um())?;
        let accepted = nodes.iter().flat_map(|n| &n.spreads).map(|s| s.accepted).fold(0.0, f64::max);
        let most_of = |weights: &Weights| {
            let caught = weights.iter().flat_map(|kinds| &kinds[..ARRIVING]).copied().fold(0.0, f32::max);
            f64::from(caught * pointing) * accepted
        };
        let most: Vec<Vec<f64>> = weights.iter().map(|waves| waves.iter().map(most_of).collect()).collect();
        let odds = |(nodes, most): (&Nodes, &f64)| {
            nodes.spreads.iter().map(|spread| (spread.accepted / most) as f32).collect()
        };
        let per_weight = most.iter().map(|most| nodes.iter().zip(most).map(odds).collect()).collect();
        let per_um =
            DVec2::from_array([0, 1].map(|axis| if side[axis] > 1 { 1.0 / step_um[axis] } else { 0.0 }));
        Ok(Self { first_um: min, per_um, side, nodes, weights, per_weight, most, cones, wavelengths })
    }

    /// Number of wavelength nodes.
    pub(super) fn waves(&self) -> usize {
        self.nodes.len()
    }

    /// Number of cones.
    pub(super) fn cones(&self) -> usize {
        self.cones.len()
    }

    /// Share of a primary's photons near a wavelength node that is drawn.
    pub(super) fn most(&self, primary: usize, wave: usize) -> f64 {
        self.most[primary][wave]
    }

    /// Wavelengths of a primary near a node, when photons are listed.
    pub(super) fn wavelengths(&self, primary: usize, wave: usize) -> Option<&Wavelengths> {
        self.wavelengths.get(primary).and_then(|waves| waves.get(wave))
    }

    /// A primary's light near a wavelength node.
    pub(super) fn beam(&self, primary: usize, wave: usize) -> Beam<'_> {
        Beam {
            cones: &self.cones,
            nodes: &self.nodes[wave],
            per_weight: &self.per_weight[primary][wave],
            weights: &self.weights[primary][wave],
        }
    }

    /// Which weights a cone counts with.
    pub(super) fn caught(&self, cone: u32) -> Caught {
        self.cones[cone as usize].caught()
    }

    /// A wavelength node, as often as a cone counts a primary's photons near it, for a uniform number.
    pub(super) fn wave(&self, primary: usize, caught: &Caught, uniform: f64) -> usize {
        let of = |weights: &Weights| f64::from(weights[caught.below][caught.kind]);
        let weights = &self.weights[primary];
        let mut left = uniform * weights.iter().map(of).sum::<f64>();
        let wave = weights.iter().position(|weights| {
            left -= of(weights);
            left < 0.0
        });
        wave.unwrap_or(0)
    }

    /// The field nodes for places in bins from an origin.
    pub(super) fn field(&self, index: &ConeIndex, origin: Origin) -> Field {
        let per_bin = self.per_um / index.per_um();
        let from = -index.bins_from(origin, self.first_um) * per_bin;
        Field {
            from: from.as_vec2().to_array(),
            per_bin: per_bin.as_vec2().to_array(),
            last: self.side.map(|side| (side - 1) as f32),
            across: self.side[0] as u32,
        }
    }
}

/// A number between 0 and the last, without a branch: `clamp` looks at its bounds first.
#[inline]
fn within(x: f32, last: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < last { x } else { last }
}

impl Field {
    /// One of the four nodes around a place, by chance (two numbers of 16 bits), with bilinear weights.
    #[inline]
    pub(super) fn node(&self, at: [f32; 2], chance: u32) -> u32 {
        let chance = halves(chance);
        let along = |axis: usize| {
            let place = within(self.from[axis] + at[axis] * self.per_bin[axis], self.last[axis]);
            within(place + chance[axis] as i32 as f32 * PART as f32, self.last[axis]) as i32 as u32
        };
        along(1) * self.across + along(0)
    }

    /// The nodes around a place with their bilinear weights, more than one time each at the ends.
    pub(super) fn around(&self, at: [f32; 2]) -> [(u32, f32); 4] {
        let [x, y] = [0, 1].map(|axis| {
            let place = within(self.from[axis] + at[axis] * self.per_bin[axis], self.last[axis]);
            let below = place as i32 as f32;
            [(below, 1.0 - (place - below)), (within(below + 1.0, self.last[axis]), place - below)]
        });
        let node = |row: (f32, f32), column: (f32, f32)| {
            (row.0 as u32 * self.across + column.0 as u32, row.1 * column.1)
        };
        [node(y[0], x[0]), node(y[0], x[1]), node(y[1], x[0]), node(y[1], x[1])]
    }

    /// How much of the distance between nodes a length is, along the axis where it is more.
    pub(super) fn part(&self, bins: [f32; 2]) -> f32 {
        (bins[0] * self.per_bin[0]).abs().max((bins[1] * self.per_bin[1]).abs())
    }
}

impl Beam<'_> {
    /// A node's point spread where nearly all light is.
    #[inline]
    pub(super) fn core(&self, node: u32) -> Core<'_> {
        let node = &self.nodes.places[node as usize];
        Core { node, cells: &self.nodes.cores[node.core as usize..][..1 << (2 * node.bits)] }
    }

    /// From the landing point at the reference wavelength to that at this one, for a chief ray that lands at a place: bilinear between nodes.
    pub(super) fn shift(&self, field: &Field, at: [f32; 2]) -> [f32; 2] {
        let mut sum = [0.0; 2];
        for (node, weight) in field.around(at) {
            let shift = self.nodes.places[node as usize].shift;
            sum = [sum[0] + weight * shift[0], sum[1] + weight * shift[1]];
        }
        sum
    }

    /// A node's point spread outside its core.
    #[inline]
    pub(super) fn outside(&self, node: u32) -> &Spread {
        &self.nodes.spreads[node as usize]
    }

    /// Where a photon lands that is so many cells from the core's first corner.
    #[inline]
    pub(super) fn landed_outside(&self, node: u32, seen: [f32; 2], cells: DVec2) -> [f32; 2] {
        self.nodes.places[node as usize].at(seen, (cells / PART).as_vec2().to_array())
    }

    /// Which weights a cone counts with.
    pub(super) fn caught(&self, cone: u32) -> Caught {
        self.cones[cone as usize].caught()
    }

    /// What a cone does with a drawn photon that has landed on it.
    #[inline]
    pub(super) fn odds(&self, cone: u32, node: u32) -> Odds {
        let Cone { weight, t, pointing } = self.cones[cone as usize];
        let per_weight = self.per_weight[node as usize];
        let weights = self.weights.as_flattened();
        // Never more, which spares looking at the end of the table.
        let weight = weight as usize % (ECC_STEPS * KINDS.len());
        let at = |low: usize| {
            let (low, high) = (weights[low], weights[low + KINDS.len()]);
            (low + (high - low) * t) * per_weight
        };
        let arrived = at(weight / KINDS.len() * KINDS.len() + ARRIVING);
        Odds { counted: at(weight) * pointing, arrived, guided: arrived * pointing }
    }
}

impl Core<'_> {
    /// What it holds for a photon's bits.
    #[inline]
    pub(super) fn held(self, bits: u32) -> u32 {
        self.cells[self.node.entry(bits) as usize]
    }
}

impl Node {
    /// Of a point spread with its shift and the steps over a cell, in bins; its core is not placed yet.
    fn new(shift: DVec2, step: DMat2, spread: &Spread) -> Self {
        let [by_row, by_column] = [step.x_axis, step.y_axis].map(|step| step * PART);
        // A place of 16 bits is the middle of its part.
        // Point spreads are blended where their light is, so that what differs between nodes is their form alone.
        let centre = step * spread.centre;
        let (shift, corner) = (shift + centre, step * spread.corner() - centre + 0.5 * (by_row + by_column));
        let single = |v: DVec2| v.as_vec2().to_array();
        Self {
            shift: single(shift),
            corner: single(corner),
            by_row: single(by_row),
            by_column: single(by_column),
            core: 0,
            bits: spread.bits,
        }
    }

    /// The entry of the core for a photon's bits.
    #[inline]
    fn entry(&self, bits: u32) -> u32 {
        bits & ((1 << (2 * self.bits)) - 1)
    }

    /// The cell in which a photon lands, from where its chief ray does, for its bits and what the core holds for them, and where.
    #[inline]
    pub(super) fn landed(&self, seen: [f32; 2], (bits, held, jitter): (u32, u32, u32)) -> (u32, [f32; 2]) {
        let cell = if bits >> 16 < held >> 16 { self.entry(bits) } else { held & 0xFFFF };
        let jitter = halves(jitter);
        let [row, column] = [cell >> self.bits, cell & ((1 << self.bits) - 1)];
        // 7 and 16 bits: whole in single precision.
        let parts = [(row << 16) | jitter[0], (column << 16) | jitter[1]].map(|parts| parts as i32 as f32);
        (cell, self.at(seen, parts))
    }

    /// A place in parts of cells from the core's corner.
    #[inline]
    fn at(&self, seen: [f32; 2], [row, column]: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|axis| {
            seen[axis] + self.corner[axis] + self.by_row[axis] * row + self.by_column[axis] * column
        })
    }
}

/// `[primary][wave]`.
fn table<T: Send>(
    shares: &[Vec<Share>],
    waves: usize,
    of_node: impl Fn(&[Share], usize) -> T + Sync,
) -> Vec<Vec<T>> {
    shares.par_iter().map(|shares| (0..waves).map(|node| of_node(shares, node)).collect()).collect()
}

/// By wavelength the nodes of a grid: its first one, steps, and number along each side.
fn trace(
    (projection, beams): (&Projection, &BeamField),
    spec: &KernelSpec,
    (first_um, step_um, side): (DVec2, DVec2, [usize; 2]),
    bins_per_um: f64,
) -> Result<Vec<Nodes>, String> {
    let points: Vec<FieldPoint> = (0..side[0] * side[1])
        .map(|node| {
            let place = DVec2::new((node % side[0]) as f64, (node / side[0]) as f64);
            FieldPoint::new(projection, first_um + step_um * place)
        })
        .collect::<Result<_, String>>()?;
    let by_point: Vec<Vec<(Node, Spread)>> = points
        .par_iter()
        .map(|point| {
            let waves = wavefronts(projection, point, &spec.nodes_nm, spec.stiles_crawford_rho10_per_mm2)?;
            // Pixels are weighted with the beam at the reference wavelength; other wavelengths see a slightly other pupil.
            let beam_mm2 = nominal_mm2(spec.state.pupil_mm) * beams.relative(point.tangent);
            let node = |wavefront: &Wavefront| {
                let mut spread = Spread::new(wavefront, spot_radius_um(wavefront));
                spread.accepted *= wavefront.pupil_area_mm2 / beam_mm2;
                let step_um = point.chart_from_tangents() * spread.pitch_um;
                let shift_um = wavefront.landing_um - point.landing_um;
                (Node::new(shift_um * bins_per_um, step_um * bins_per_um, &spread), spread)
            };
            Ok(waves.par_iter().map(node).collect())
        })
        .collect::<Result<_, String>>()?;
    let none = || Nodes { places: Vec::new(), cores: Vec::new(), spreads: Vec::new() };
    let mut rows: Vec<Nodes> = spec.nodes_nm.iter().map(|_| none()).collect();
    for nodes in by_point {
        for (row, (node, mut spread)) in rows.iter_mut().zip(nodes) {
            row.places.push(Node { core: row.cores.len() as u32, ..node });
            row.cores.append(&mut spread.take_core());
            row.spreads.push(spread);
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exposure::events::dice::Words;

    /// How often each node is drawn, by chi-square of 3 degrees; alpha 1e-6: 30.7.
    #[test]
    fn nodes_are_drawn_with_bilinear_weights() {
        const DRAWS: u64 = 200_000;
        let field = Field { from: [0.5, 1.0], per_bin: [0.01, 0.02], last: [2.0, 3.0], across: 3 };
        let words = Words { key: 5 };
        for at in [[30.0, 10.0], [97.0, -45.0], [149.0, 61.0]] {
            let (x, y) = (0.5 + 0.01 * f64::from(at[0]), 1.0 + 0.02 * f64::from(at[1]));
            let mut drawn = [0.0; 12];
            for photon in 0..DRAWS {
                drawn[field.node(at, words.of(photon, 0) as u32) as usize] += 1.0;
            }
            let hat = |x: f64, node: usize| (1.0 - (x - node as f64).abs()).max(0.0);
            let weight = |node: usize| hat(x, node % 3) * hat(y, node / 3);
            let mut around = [0.0; 12];
            for (node, weight) in field.around(at) {
                around[node as usize] += f64::from(weight);
            }
            assert!((0..12).all(|node| (around[node] - weight(node)).abs() < 1e-6), "{around:?}");
            let chi2: f64 = (0..12)
                .map(|node| {
                    let mean = weight(node) * DRAWS as f64;
                    let off: f64 = drawn[node] - mean;
                    if mean < 1e-9 { off * 1e9 } else { off * off / mean }
                })
                .sum();
            assert!(chi2 < 30.7, "{chi2} {drawn:?}");
        }
        // Far away: the nearest node.
        assert_eq!([[-1e9, 1e9], [1e9, -1e9]].map(|at| field.node(at, u32::MAX)), [9, 2]);
    }
}
