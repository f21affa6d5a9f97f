//! The wavefronts of one object point over wavelength, from a few traced ones.
//!
//! Everything in a [`Wavefront`] is a smooth function of the wavelength as long as the refractive indices are: it is interpolated by
//! Lagrange polynomials over Chebyshev nodes that include the ends, in 1/λ (the poles of the dispersion lie farthest off there). The
//! indices of a polyline have kinks: each straight piece has its own nodes, few of them and in λ, and shares those at its ends. Path
//! differences are exact to 1e-5 waves, with the fewer nodes of wide fields to 2e-4 (see the test).
//!
//! # Cost
//! Beside the traced nodes, an interpolated wavefront costs 1 to 2 µs.

use super::outline::Outline;
use super::polynomial::Polynomial2;
use super::wavefront::{Wavefront, WavefrontOptions};
use crate::exposure::nodes::lagrange;
use crate::optics::{Dispersion, Object, OpticsError, SchematicEye};
use glam::{DMat2, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Traced wavelengths of a smooth law and in one straight piece of a polyline.
const NODES: [usize; 2] = [9, 4];
/// The same of a wide field, which is interpolated over the field to 1e-2 waves.
const FEW_NODES: [usize; 2] = [7, 3];

/// Nodes in wavelength: smooth pieces that share their ends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WavelengthNodes {
    nm: Vec<f64>,
    /// Nodes in a piece, both ends counted.
    per_piece: usize,
    straight: bool,
}

impl WavelengthNodes {
    /// The nodes of an eye's dispersion from `from_nm` to `to_nm`.
    pub fn new(eye: &SchematicEye, range_nm: [f64; 2]) -> Self {
        Self::with(eye, range_nm, NODES)
    }

    /// Fewer of them.
    pub fn few(eye: &SchematicEye, range_nm: [f64; 2]) -> Self {
        Self::with(eye, range_nm, FEW_NODES)
    }

    fn with(eye: &SchematicEye, [from_nm, to_nm]: [f64; 2], [smooth, in_piece]: [usize; 2]) -> Self {
        let straight = eye.state().dispersion == Dispersion::Polyline;
        let per_piece = if straight { in_piece } else { smooth };
        let kinks = eye.prescription().kinks_nm(eye.state().dispersion);
        let mut from = from_nm;
        let mut nm = vec![from_nm];
        for end in kinks.into_iter().filter(|k| *k > from_nm && *k < to_nm).chain([to_nm]) {
            let (a, b) = if straight { (from, end) } else { (from.recip(), end.recip()) };
            nm.extend((1..per_piece).map(|i| {
                let x = f64::midpoint(a, b) + 0.5 * (a - b) * (PI * i as f64 / (per_piece - 1) as f64).cos();
                if i + 1 == per_piece {
                    end
                } else if straight {
                    x
                } else {
                    x.recip()
                }
            }));
            from = end;
        }
        Self { nm, per_piece, straight }
    }

    /// The nodes, nm, rising.
    pub fn nm(&self) -> &[f64] {
        &self.nm
    }

    /// First node of the piece of a wavelength and the weights of its nodes.
    fn weights(&self, nm: f64) -> (usize, Vec<f64>) {
        let step = self.per_piece - 1;
        let ends = self.nm.iter().skip(step).step_by(step);
        let piece = ends.take_while(|end| **end < nm).count().min((self.nm.len() - 2) / step);
        let nodes = &self.nm[piece * step..=(piece + 1) * step];
        let weights = if self.straight {
            lagrange(nodes, nm)
        } else {
            let inverse: Vec<f64> = nodes.iter().map(|nm| nm.recip()).collect();
            lagrange(&inverse, nm.recip())
        };
        (piece * step, weights)
    }
}

/// Wavefronts of one object point over a range of wavelengths.
#[derive(Clone, Debug)]
pub struct WavefrontTable {
    eye: SchematicEye,
    wavelengths: WavelengthNodes,
    nodes: Vec<Wavefront>,
}

impl WavefrontTable {
    /// Traces the nodes for wavelengths from `from_nm` to `to_nm`.
    ///
    /// # Errors
    /// As [`Wavefront::new`].
    pub fn new(
        eye: &SchematicEye,
        object: Object,
        range_nm: [f64; 2],
        options: &WavefrontOptions,
    ) -> Result<Self, OpticsError> {
        let wavelengths = WavelengthNodes::new(eye, range_nm);
        let nodes = Wavefront::series(eye, object, wavelengths.nm(), options)?;
        Ok(Self::from_nodes(eye.clone(), wavelengths, nodes))
    }

    /// A table of wavefronts at the nodes, however they were made.
    pub(super) fn from_nodes(eye: SchematicEye, wavelengths: WavelengthNodes, nodes: Vec<Wavefront>) -> Self {
        Self { eye, wavelengths, nodes }
    }

    /// The wavefront at a wavelength (nm) of the range.
    pub fn at(&self, nm: f64) -> Wavefront {
        let (first, weights) = self.wavelengths.weights(nm);
        blend(&self.nodes[first..first + weights.len()], &weights, nm, self.eye.indices(nm)[4])
    }

    /// Wavefronts at many wavelengths (nm, rising), each traced where that is less work.
    ///
    /// # Errors
    /// As [`Wavefront::new`].
    pub fn spectrum(
        eye: &SchematicEye,
        object: Object,
        wavelengths_nm: &[f64],
        options: &WavefrontOptions,
    ) -> Result<Vec<Wavefront>, OpticsError> {
        let (Some(first), Some(last)) = (wavelengths_nm.first(), wavelengths_nm.last()) else {
            return Ok(Vec::new());
        };
        if wavelengths_nm.len() <= WavelengthNodes::new(eye, [*first, *last]).nm().len() {
            return Wavefront::series(eye, object, wavelengths_nm, options);
        }
        let table = Self::new(eye, object, [*first, *last], options)?;
        Ok(wavelengths_nm.iter().map(|&nm| table.at(nm)).collect())
    }
}

/// Σ weight·wavefront, quantity by quantity.
pub(super) fn blend(nodes: &[Wavefront], weights: &[f64], wavelength_nm: f64, n_vitreous: f64) -> Wavefront {
    let sum = |f: &dyn Fn(&Wavefront) -> f64| nodes.iter().zip(weights).map(|(n, w)| w * f(n)).sum::<f64>();
    let sum2 =
        |f: &dyn Fn(&Wavefront) -> DVec2| nodes.iter().zip(weights).map(|(n, w)| *w * f(n)).sum::<DVec2>();
    let polynomial = |f: &dyn Fn(&Wavefront) -> &Polynomial2| {
        let degree = nodes.iter().map(|n| f(n).degree()).max().unwrap_or(0);
        let mut total = vec![0.0; super::polynomial::count(degree)];
        for (node, weight) in nodes.iter().zip(weights) {
            total.iter_mut().zip(f(node).coefficients()).for_each(|(t, c)| *t += weight * c);
        }
        Polynomial2::new(degree, total)
    };
    let harmonics = nodes.iter().map(|n| n.outline.harmonics.len()).max().unwrap_or(0);
    let harmonic = |n: &Wavefront, m: usize| n.outline.harmonics.get(m).copied().unwrap_or_default();
    let outline = Outline {
        harmonics: (0..harmonics)
            .map(|m| (sum2(&|n| harmonic(n, m).0), sum2(&|n| harmonic(n, m).1)))
            .collect(),
    };
    let nearest = nodes.iter().min_by(|a, b| {
        (a.wavelength_nm - wavelength_nm).abs().total_cmp(&(b.wavelength_nm - wavelength_nm).abs())
    });
    Wavefront {
        wavelength_nm,
        n_vitreous,
        landing_um: sum2(&|n| n.landing_um),
        landing: nodes.iter().zip(weights).map(|(n, w)| *w * n.landing).sum::<DVec3>(),
        meridional_angle: nearest.map_or(0.0, |n| n.meridional_angle),
        radius_um: sum(&|n| n.radius_um),
        centre: sum2(&|n| n.centre),
        axes: DMat2::from_cols(sum2(&|n| n.axes.x_axis), sum2(&|n| n.axes.y_axis)),
        opd_um: polynomial(&|n| &n.opd_um),
        amplitude: polynomial(&|n| &n.amplitude),
        outline,
        pupil_area_mm2: sum(&|n| n.pupil_area_mm2),
        path_cornea: sum(&|n| n.path_cornea),
        path_lens: sum(&|n| n.path_lens),
        path_lens_variance: sum(&|n| n.path_lens_variance),
        amplitude_sum: sum(&|n| n.amplitude_sum),
        energy_open: sum(&|n| n.energy_open),
        throughput: sum(&|n| n.throughput),
        rms_um: sum(&|n| n.rms_um),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{EyeState, Prescription, Side};

    /// Largest difference from traced wavefronts, waves, and of the landing point, µm.
    fn worst(dispersion: Dispersion, pupil_mm: f64, field_deg: f64, few: bool) -> (f64, f64) {
        let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
        let state =
            EyeState { pupil_mm, decentre_mm: 0.4, accommodation_a: 1.0, dispersion, side: Side::Right };
        let eye = SchematicEye::new(&prescription, &state).unwrap();
        let (object, options) = (Object::field(field_deg, 0.3).unwrap(), WavefrontOptions::default());
        let range_nm = [400.0, 700.0];
        let nodes =
            if few { WavelengthNodes::few(&eye, range_nm) } else { WavelengthNodes::new(&eye, range_nm) };
        let traced = Wavefront::series(&eye, object, nodes.nm(), &options).unwrap();
        let table = WavefrontTable::from_nodes(eye.clone(), nodes, traced);
        let mut worst = (0.0_f64, 0.0_f64);
        for nm in [400.0, 411.0, 437.0, 466.0, 505.0, 542.0, 549.0, 588.0, 600.0, 655.0, 695.0, 700.0] {
            let (made, exact) = (table.at(nm), Wavefront::new(&eye, object, nm, &options).unwrap());
            // The landing point is a reference only (its aim is good to 1 nm): what counts is W + q·landing.
            let from_q = |w: &Wavefront, q: DVec2| {
                w.opd_um.at(w.axes.inverse() * (q - w.centre)) + q.dot(w.landing_um - exact.landing_um)
            };
            let piston = from_q(&made, exact.centre) - from_q(&exact, exact.centre);
            for k in 0..40 {
                let s = DVec2::from_angle(2.4 * f64::from(k)) * (f64::from(k) / 39.0).sqrt();
                let q = exact.centre + exact.axes * s;
                let gap = (from_q(&made, q) - from_q(&exact, q) - piston).abs() / exact.wavelength_um();
                worst.0 = worst.0.max(gap);
            }
            worst.1 = worst.1.max((made.landing_um - exact.landing_um).length());
            let energy = (made.energy_open / exact.energy_open - 1.0).abs();
            let bound = if few { 1e-4 } else { 1e-5 };
            assert!(energy < bound, "{dispersion:?} {pupil_mm} mm {field_deg}, {nm} nm: {energy:.1e}");
            assert!((made.throughput() / exact.throughput() - 1.0).abs() < bound);
        }
        worst
    }

    #[test]
    fn interpolated_wavefronts_are_the_traced_ones() {
        for dispersion in [Dispersion::Herzberger, Dispersion::Polyline] {
            for (pupil_mm, field_deg) in [(3.0, 5.0), (8.0, 5.0), (3.0, 30.0)] {
                let (few, few_um) = worst(dispersion, pupil_mm, field_deg, true);
                println!(
                    "{dispersion:?} {pupil_mm} mm {field_deg} degrees, few nodes: {few:.1e} waves, {few_um:.1e} um"
                );
                assert!(
                    few < 3e-4 && few_um < 1e-3,
                    "{dispersion:?} {pupil_mm} mm {field_deg}: {few:.1e} waves"
                );
                let (waves, um) = worst(dispersion, pupil_mm, field_deg, false);
                println!("{dispersion:?} {pupil_mm} mm {field_deg} degrees: {waves:.1e} waves, {um:.1e} um");
                assert!(waves < 1e-5, "{dispersion:?} {pupil_mm} mm {field_deg}: {waves:.1e} waves");
                assert!(um < 2e-3, "{dispersion:?} {pupil_mm} mm {field_deg}: {um:.1e} µm");
            }
        }
    }
}
