//! What does not change between frames: point spreads by field node and wavelength, and what share of arriving photons each cone counts.

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::landing::Landing;
use super::spread::Spread;
use crate::exposure::cones::ConeTable;
use crate::exposure::expected::ARRIVING;
use crate::exposure::inputs::Inputs;
use crate::exposure::spectral::KINDS;
use crate::exposure::transfer::{FieldPoint, spot_radius_um, wavefronts};
use crate::psf::Wavefront;

/// Steps of eccentricity between which weights are interpolated.
const ECC_STEPS: usize = 32;
/// Largest distance of field nodes, visual degrees, for targets down to 0.5 % and below.
const NODE_DEG: [f64; 2] = [0.7, 0.35];

/// Optics at one field node and wavelength.
pub(super) struct Node {
    /// Landing point against that at the reference wavelength, µm.
    pub(super) shift_um: DVec2,
    /// A step on the chart from one along the retina's tangents.
    pub(super) chart_from_tangents: DMat2,
    /// The point spread.
    pub(super) spread: Spread,
}

/// What becomes of a drawn photon that has landed on a cone.
pub(super) struct Odds {
    /// Probability that it is counted.
    pub(super) counted: f64,
    /// Arriving photons it stands for.
    pub(super) arrived: f64,
    /// Of those, the guided ones.
    pub(super) guided: f64,
}

/// One cone's place among the weights.
struct Cone {
    kind: usize,
    ecc: (usize, f32),
    pointing: f32,
}

/// The tables.
pub(super) struct Tables {
    /// First node and step on the retina, µm, and their number along each side.
    first_um: DVec2,
    step_um: DVec2,
    side: [usize; 2],
    /// `[wave][node]`.
    nodes: Vec<Vec<Node>>,
    /// `[primary][wave][kind][eccentricity]`: share of the primary's photons that is caught.
    weights: Vec<Vec<Vec<[f32; ECC_STEPS + 1]>>>,
    /// `[primary][wave]`: the most that any cone counts.
    most: Vec<Vec<f64>>,
    cones: Vec<Cone>,
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
        target: f64,
    ) -> Result<Self, String> {
        let Inputs { kernels, retina, .. } = inputs;
        let spec = kernels.spec();
        let absorbers = spec.absorbers()?;
        let shares = spec.shares();
        let [ecc_from, ecc_to] = spec.ecc_deg;
        let ecc = |step: usize| ecc_from + (ecc_to - ecc_from) * step as f64 / ECC_STEPS as f64;
        let waves = spec.nodes_nm.len();
        let of_primary = |shares: &Vec<_>| {
            let mut weights = vec![vec![[0.0; ECC_STEPS + 1]; KINDS.len()]; waves];
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
        let weights: Vec<Vec<Vec<[f32; ECC_STEPS + 1]>>> = shares.par_iter().map(of_primary).collect();
        let cones: Vec<Cone> = cones
            .cones
            .iter()
            .map(|cone| {
                let at = ((cone.ecc_deg - ecc_from) / (ecc_to - ecc_from).max(1e-12)).clamp(0.0, 1.0)
                    * ECC_STEPS as f64;
                let below = (at as usize).min(ECC_STEPS - 1);
                let ecc = (below, (at - below as f64) as f32);
                Cone { kind: cone.cone_type as usize, ecc, pointing: cone.pointing as f32 }
            })
            .collect();
        let pointing = cones.iter().map(|cone| cone.pointing).fold(0.0, f32::max);

        // Nodes evenly over the retina that the window is imaged on and the cones lie on.
        let [from, to] = landing.bounds();
        let (low, high) = (landing.um(from), landing.um(to));
        let (min, max) = (low.min(high).max(retina.region.min), low.max(high).min(retina.region.max));
        let finest = NODE_DEG[usize::from(target < 0.005)] * 287.0;
        let side = [0, 1].map(|axis| ((max[axis] - min[axis]).max(0.0) / finest).ceil() as usize + 1);
        let step_um =
            DVec2::from_array([0, 1].map(|axis| (max[axis] - min[axis]) / (side[axis] - 1).max(1) as f64));
        let nodes = trace(inputs, min, step_um, side)?;
        let accepted = nodes.iter().flatten().map(|node| node.spread.accepted).fold(0.0, f64::max);
        let most = weights
            .iter()
            .map(|waves: &Vec<Vec<[f32; ECC_STEPS + 1]>>| {
                let of = |kinds: &Vec<[f32; ECC_STEPS + 1]>| {
                    kinds[..ARRIVING].iter().flatten().copied().fold(0.0, f32::max)
                };
                waves.iter().map(|kinds| f64::from(of(kinds) * pointing) * accepted).collect()
            })
            .collect();
        Ok(Self { first_um: min, step_um, side, nodes, weights, most, cones })
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

    /// One of the four nodes around a place of the retina, by chance, with bilinear weights.
    pub(super) fn node(&self, um: DVec2, wave: usize, chance: DVec2) -> &Node {
        let along = |axis: usize| {
            let last = self.side[axis] - 1;
            if last == 0 {
                return 0;
            }
            let at = ((um[axis] - self.first_um[axis]) / self.step_um[axis]).clamp(0.0, last as f64);
            ((at + chance[axis]) as usize).min(last)
        };
        &self.nodes[wave][along(1) * self.side[0] + along(0)]
    }

    /// What a cone does with a drawn photon that has landed on it.
    pub(super) fn odds(&self, cone: usize, primary: usize, wave: usize, node: &Node) -> Odds {
        let cone = &self.cones[cone];
        let kinds = &self.weights[primary][wave];
        let per_drawn = node.spread.accepted / self.most[primary][wave];
        let at = |kind: usize| {
            let (below, t) = cone.ecc;
            f64::from(kinds[kind][below] * (1.0 - t) + kinds[kind][below + 1] * t) * per_drawn
        };
        let (pointing, arrived) = (f64::from(cone.pointing), at(ARRIVING));
        Odds { counted: at(cone.kind) * pointing, arrived, guided: arrived * pointing }
    }
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
            let node = |wavefront: &Wavefront| Node {
                shift_um: wavefront.landing_um - point.landing_um,
                chart_from_tangents: point.chart_from_tangents(),
                spread: Spread::new(wavefront, spot_radius_um(wavefront)),
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
