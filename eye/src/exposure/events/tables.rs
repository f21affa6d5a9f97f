//! What does not change between frames: point spreads by field node and wavelength, and what share of arriving photons each cone counts.

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::dice::{CELL, JITTER_NODE, Words};
use super::landing::Landing;
use super::list::Wavelengths;
use super::spread::Spread;
use crate::experiment::Experiment;
use crate::exposure::cones::{ConeTable, MappedCone};
use crate::exposure::expected::ARRIVING;
use crate::exposure::inputs::Inputs;
use crate::exposure::spectral::{KINDS, Share};
use crate::exposure::transfer::{FieldPoint, spot_radius_um, wavefronts};
use crate::psf::Wavefront;

/// Steps of eccentricity between which weights are interpolated.
pub(super) const ECC_STEPS: usize = 32;
/// Largest distance of field nodes, visual degrees, for targets down to 0.5 % and below.
const NODE_DEG: [f64; 2] = [0.7, 0.35];

/// Optics at one field node and wavelength.
pub(super) struct Node {
    /// From the landing point at the reference wavelength to the first corner of the point spread's core, µm.
    corner_um: DVec2,
    /// A step on the chart, µm, from one over a cell of the point spread.
    step_um: DMat2,
    /// The point spread, its core apart.
    spread: Spread,
    /// Where its core begins.
    core: u32,
}

/// One cone's place among the weights.
#[derive(Clone, Copy)]
struct Cone {
    kind: u32,
    below: u32,
    t: f32,
    pointing: f32,
}

/// What a photon draws from the point spreads: field node, entry of the core, and bits for the cell and the place in it.
#[derive(Clone, Copy, Default)]
pub(super) struct Drawn {
    pub(super) node: u32,
    pub(super) entry: u32,
    bits: u32,
    jitter: u32,
}

/// In place of an entry: outside the core.
const OUTSIDE: u32 = u32::MAX;

impl Cone {
    /// A cone between the ends of the table's eccentricities.
    fn new(cone: &MappedCone, [from, to]: [f64; 2]) -> Self {
        let at = ((cone.ecc_deg - from) / (to - from).max(1e-12)).clamp(0.0, 1.0) * ECC_STEPS as f64;
        let below = (at as usize).min(ECC_STEPS - 1);
        let (kind, pointing) = (cone.cone_type as u32, cone.pointing as f32);
        Self { kind, below: below as u32, t: (at - below as f64) as f32, pointing }
    }
}

/// Which weights a cone counts with: its kind, and its place between two steps of eccentricity.
pub(super) struct Caught {
    pub(super) kind: usize,
    pub(super) below: usize,
    pub(super) t: f32,
}

/// What becomes of a drawn photon that has landed on a cone.
pub(super) struct Odds {
    /// Probability that it is counted, of 2^32.
    pub(super) counted: u32,
    /// Arriving photons it stands for.
    pub(super) arrived: f32,
    /// Of those, the guided ones.
    pub(super) guided: f32,
}

/// Weights of one kind by step of eccentricity.
type Weights = [f32; ECC_STEPS + 1];

/// What is needed of one primary near one wavelength node.
pub(super) struct Beam<'a> {
    tables: &'a Tables,
    nodes: &'a [Node],
    cores: &'a [u32],
    /// By field node: odds per weight.
    per_weight: Vec<f32>,
    weights: &'a [Weights; KINDS.len()],
}

/// The tables.
pub(super) struct Tables {
    /// First node on the retina, µm, steps per µm, and the number of nodes along each side.
    first_um: DVec2,
    per_um: DVec2,
    side: [usize; 2],
    /// `[wave][node]`.
    nodes: Vec<Vec<Node>>,
    /// `[wave]`: the cores of the nodes' point spreads, one after the other.
    cores: Vec<Vec<u32>>,
    /// `[primary][wave][kind][eccentricity]`: share of the primary's photons that is caught.
    weights: Vec<Vec<[Weights; KINDS.len()]>>,
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
        inputs: &Inputs,
        cones: &ConeTable,
        landing: &Landing,
        experiment: &Experiment,
    ) -> Result<Self, String> {
        let Inputs { kernels, retina, .. } = inputs;
        let spec = kernels.spec();
        let absorbers = spec.absorbers()?;
        let shares = spec.shares();
        let [ecc_from, ecc_to] = spec.ecc_deg;
        let ecc = |step: usize| ecc_from + (ecc_to - ecc_from) * step as f64 / ECC_STEPS as f64;
        let waves = spec.nodes_nm.len();
        let of_primary = |shares: &Vec<_>| {
            let mut weights = vec![[[0.0; ECC_STEPS + 1]; KINDS.len()]; waves];
            for (k, kind) in KINDS.into_iter().enumerate() {
                for step in 0..=ECC_STEPS {
                    let caught = absorbers.weights(shares, &spec.nodes_nm, kind, ecc(step), kernels.paths());
                    for (wave, value) in weights.iter_mut().zip(caught) {
                        wave[k][step] = value as f32;
                    }
                }
            }
            weights
        };
        let weights: Vec<Vec<[Weights; KINDS.len()]>> = shares.par_iter().map(of_primary).collect();
        let cones: Vec<Cone> = cones.cones.iter().map(|cone| Cone::new(cone, spec.ecc_deg)).collect();
        let pointing = cones.iter().map(|cone| cone.pointing).fold(0.0, f32::max);

        let listed = experiment.counts.photon_list;
        let of_node = |shares: &[Share], node: usize| {
            Wavelengths::new(&absorbers, shares, (&spec.nodes_nm, node), ecc, kernels.paths())
        };
        let wavelengths = if listed { table(&shares, waves, of_node) } else { Vec::new() };

        // Nodes evenly over the retina that the window is imaged on and the cones lie on.
        let [from, to] = landing.bounds();
        let (low, high) = (landing.um(from), landing.um(to));
        let (min, max) = (low.min(high).max(retina.region.min), low.max(high).min(retina.region.max));
        let finest = NODE_DEG[usize::from(experiment.accuracy_target < 0.005)] * 287.0;
        let side = [0, 1].map(|axis| ((max[axis] - min[axis]).max(0.0) / finest).ceil() as usize + 1);
        let step_um =
            DVec2::from_array([0, 1].map(|axis| (max[axis] - min[axis]) / (side[axis] - 1).max(1) as f64));
        let mut nodes = trace(inputs, min, step_um, side)?;
        let cores = nodes.iter_mut().map(|nodes| joined(nodes)).collect();
        let accepted = nodes.iter().flatten().map(|node| node.spread.accepted).fold(0.0, f64::max);
        let most = weights
            .iter()
            .map(|waves: &Vec<[Weights; KINDS.len()]>| {
                let of = |kinds: &[Weights; KINDS.len()]| {
                    kinds[..ARRIVING].iter().flatten().copied().fold(0.0, f32::max)
                };
                waves.iter().map(|kinds| f64::from(of(kinds) * pointing) * accepted).collect()
            })
            .collect();
        let per_um =
            DVec2::from_array([0, 1].map(|axis| if side[axis] > 1 { 1.0 / step_um[axis] } else { 0.0 }));
        Ok(Self { first_um: min, per_um, side, nodes, cores, weights, most, cones, wavelengths })
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
        let nodes = &self.nodes[wave];
        let most = self.most[primary][wave];
        let per_weight = nodes.iter().map(|node| (node.spread.accepted / most) as f32).collect();
        Beam {
            tables: self,
            nodes,
            cores: &self.cores[wave],
            per_weight,
            weights: &self.weights[primary][wave],
        }
    }

    /// One of the four nodes around a place of the retina, by chance (two numbers of 2^16), with bilinear weights.
    #[inline]
    fn node(&self, um: DVec2, chance: u32) -> usize {
        const UNIT: f64 = 1.0 / 65_536.0;
        let along = |axis: usize, chance: u32| {
            let last = (self.side[axis] - 1) as f64;
            // A place that is not a number is on node 0.
            let at = ((um[axis] - self.first_um[axis]) * self.per_um[axis]).max(0.0).min(last);
            (at + f64::from(chance) * UNIT).min(last) as usize
        };
        along(1, chance >> 16) * self.side[0] + along(0, chance & 0xFFFF)
    }
}

impl Beam<'_> {
    /// What a photon seen at a place takes from the point spreads.
    #[inline]
    pub(super) fn spread(&self, um: DVec2, words: Words, photon: u64) -> Drawn {
        let other = words.of(photon, JITTER_NODE);
        let node = self.tables.node(um, (other >> 32) as u32);
        let bits = words.of(photon, CELL);
        let Node { spread, core, .. } = &self.nodes[node];
        let inside = (bits >> 32) as u32 >= spread.outside;
        let entry = if inside { core + spread.entry(bits as u32) } else { OUTSIDE };
        Drawn { node: node as u32, entry, bits: bits as u32, jitter: other as u32 }
    }

    /// What an entry of the cores holds.
    #[inline]
    pub(super) fn held(&self, entry: u32) -> u32 {
        self.cores.get(entry as usize).copied().unwrap_or(0)
    }

    /// Where a photon lands, µm, from where its chief ray at the reference wavelength does.
    #[inline]
    pub(super) fn landed(&self, um: DVec2, drawn: &Drawn, held: u32, words: Words, photon: u64) -> DVec2 {
        const UNIT: f64 = 1.0 / 65_536.0;
        let node = &self.nodes[drawn.node as usize];
        let place = if drawn.entry == OUTSIDE {
            node.spread.draw_outside(&mut words.more(photon, 0))
        } else {
            let (row, column) = node.spread.place(drawn.bits, held);
            let jitter = [drawn.jitter & 0xFFFF, drawn.jitter >> 16].map(|j| (f64::from(j) + 0.5) * UNIT);
            DVec2::new(f64::from(row) + jitter[0], f64::from(column) + jitter[1])
        };
        um + node.corner_um + node.step_um * place
    }

    /// Which weights a cone counts with.
    pub(super) fn caught(&self, cone: u32) -> Caught {
        let Cone { kind, below, t, .. } = self.tables.cones[cone as usize];
        Caught { kind: kind as usize, below: below as usize, t }
    }

    /// What a cone does with a drawn photon that has landed on it.
    #[inline]
    pub(super) fn odds(&self, cone: u32, node: u32) -> Odds {
        let Cone { kind, below, t, pointing } = self.tables.cones[cone as usize];
        let per_weight = self.per_weight[node as usize];
        let at = |weights: &Weights| {
            let (low, high) = (weights[below as usize], weights[below as usize + 1]);
            (low + (high - low) * t) * per_weight
        };
        let arrived = at(&self.weights[ARRIVING]);
        let counted = at(&self.weights[kind as usize]) * pointing;
        Odds { counted: (counted * 4_294_967_296.0) as u32, arrived, guided: arrived * pointing }
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

/// The cores of some nodes in one table.
fn joined(nodes: &mut [Node]) -> Vec<u32> {
    let mut cores = Vec::new();
    for node in nodes {
        node.core = cores.len() as u32;
        cores.append(&mut node.spread.take_core());
    }
    cores
}

/// `[wave][node]`.
fn trace(
    inputs: &Inputs,
    first_um: DVec2,
    step_um: DVec2,
    side: [usize; 2],
) -> Result<Vec<Vec<Node>>, String> {
    let Inputs { kernels, projection, .. } = inputs;
    let spec = kernels.spec();
    let points: Vec<FieldPoint> = (0..side[0] * side[1])
        .map(|node| {
            let place = DVec2::new((node % side[0]) as f64, (node / side[0]) as f64);
            FieldPoint::new(projection, first_um + step_um * place)
        })
        .collect::<Result<_, String>>()?;
    let by_point: Vec<Vec<Node>> = points
        .par_iter()
        .map(|point| {
            let waves = wavefronts(projection, point, &spec.nodes_nm, spec.stiles_crawford_rho10_per_mm2)?;
            let node = |wavefront: &Wavefront| {
                let spread = Spread::new(wavefront, spot_radius_um(wavefront));
                let step_um = point.chart_from_tangents() * spread.pitch_um;
                let shift_um = wavefront.landing_um - point.landing_um;
                Node { corner_um: shift_um + step_um * spread.corner(), step_um, spread, core: 0 }
            };
            Ok(waves.par_iter().map(node).collect())
        })
        .collect::<Result<_, String>>()?;
    let mut rows: Vec<Vec<Node>> = spec.nodes_nm.iter().map(|_| Vec::new()).collect();
    for nodes in by_point {
        rows.iter_mut().zip(nodes).for_each(|(row, node)| row.push(node));
    }
    Ok(rows)
}
