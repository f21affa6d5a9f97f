//! Wavefronts over field and wavelength: a grid of Chebyshev nodes in the tangents of the screen, each with the nodes in wavelength of a
//! [`WavefrontTable`].
//!
//! Every quantity of a wavefront is smooth over the field, so it is interpolated by Lagrange polynomials in both tangents and in
//! wavelength. An eye without astigmatism and measured wavefront is its own mirror image in the plane of the optical axis and the fovea: of
//! a field that is so too, one half is traced.
//!
//! # Accuracy
//! Path differences against traced ones with the default eye, square fields about the line of sight, 400 to 700 nm: 3 nodes a side hold
//! ±1° to 2e-3 waves at 3 mm and 4e-3 at 6 mm (nearly all of it tilt, that is, place), 4 nodes ±2.5° to 1e-4 at 8 mm, 7 nodes ±12° to
//! 5e-4, 9 nodes ±30° to 6e-3 at 3 mm (tilt: 0.02 µm of place) and 11 nodes to 6e-4 at 8 mm; see the test.
//!
//! # Cost
//! One [`Wavefront`] a node and traced wavelength: 10 for a polyline of three pieces, 9 for a smooth law, 7 for fields wider than ±5°; those of
//! a node are one series.

use glam::DVec2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::table::{WavefrontTable, WavelengthNodes, blend};
use super::wavefront::{StilesCrawfordApodization, Wavefront, WavefrontOptions, meridional_angle_at};
use crate::exposure::nodes::{chebyshev, lagrange};
use crate::optics::{EyeState, OpticsError, Prescription, Projection, SchematicEye};
use crate::spectrum::{MAX_NM, MIN_NM};

const MAGIC: &[u8] = b"PEwaves1";
/// Half sides of fields, degrees, and the nodes along a side that hold them to a hundredth of a wave, for pupils up to 4 mm and up to 8 mm
/// (see the test).
const FIELDS: [(f64, [usize; 2]); 4] = [(2.5, [4, 4]), (5.0, [5, 5]), (12.0, [6, 6]), (30.0, [9, 11])];
const NARROW_MM: f64 = 4.0;
/// Fields with a larger half side have fewer wavelengths, degrees.
const WIDE_DEG: f64 = 6.0;

/// Wavelengths that are traced in a field.
fn wavelengths(eye: &SchematicEye, half_tangent: f64, range_nm: [f64; 2]) -> WavelengthNodes {
    let wide = half_tangent > WIDE_DEG.to_radians().tan();
    if wide { WavelengthNodes::few(eye, range_nm) } else { WavelengthNodes::new(eye, range_nm) }
}

/// What the wavefronts of a whole field are made from: one table for an eye, its pupil, its focus and a distance of the screen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldTableSpec {
    /// The eye.
    pub prescription: Prescription,
    /// Its pupil, focus and dispersion.
    pub state: EyeState,
    /// Distance of the screen from the corneal apex, mm.
    pub distance_mm: f64,
    /// Half side of the field, degrees about the line of sight.
    pub half_deg: f64,
    /// Nodes along a side.
    pub nodes: usize,
    /// Stiles-Crawford coefficient, base 10, 1/mm²; 0 is off.
    pub stiles_crawford_rho10_per_mm2: f64,
}

impl FieldTableSpec {
    /// Half side (degrees) and nodes along a side of the smallest field that holds `reach_deg`; `None` when none does.
    pub fn field(reach_deg: f64, pupil_mm: f64) -> Option<(f64, usize)> {
        let (half, nodes) = FIELDS.into_iter().find(|(half, _)| reach_deg <= *half)?;
        Some((half, nodes[usize::from(pupil_mm > NARROW_MM)]))
    }

    /// How many wavefronts are traced.
    ///
    /// # Errors
    /// When the eye is refused.
    pub fn traced(&self) -> Result<usize, OpticsError> {
        let eye = SchematicEye::new(&self.prescription, &self.state)?;
        let rows = if self.prescription.is_mirror_image() { self.nodes.div_ceil(2) } else { self.nodes };
        let half = self.half_deg.to_radians().tan();
        Ok(rows * self.nodes * wavelengths(&eye, half, [MIN_NM, MAX_NM]).nm().len())
    }

    /// Traces the table.
    ///
    /// # Errors
    /// As [`Wavefront::new`].
    pub fn build(&self) -> Result<FieldTable, OpticsError> {
        let eye = SchematicEye::new(&self.prescription, &self.state)?;
        let projection = Projection::new(&eye, self.distance_mm)?;
        let half = DVec2::splat(self.half_deg.to_radians().tan());
        let rho_base10_per_mm2 = self.stiles_crawford_rho10_per_mm2;
        let stiles_crawford =
            (rho_base10_per_mm2 > 0.0).then_some(StilesCrawfordApodization { rho_base10_per_mm2 });
        let options = WavefrontOptions { stiles_crawford, ..WavefrontOptions::default() };
        FieldTable::new(&projection, [-half, half], [self.nodes; 2], [MIN_NM, MAX_NM], &options)
    }
}

/// Wavefronts of a rectangle of the screen over a range of wavelengths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldTable {
    prescription: Prescription,
    state: EyeState,
    axes: [Vec<f64>; 2],
    wavelengths: WavelengthNodes,
    /// `[wavelength][y][x]`.
    nodes: Vec<Wavefront>,
}

impl FieldTable {
    /// Traces `nodes` along x and y for tangents from `min` to `max` and wavelengths of a range, nm.
    ///
    /// # Errors
    /// As [`Wavefront::new`].
    pub fn new(
        projection: &Projection,
        [min, max]: [DVec2; 2],
        nodes: [usize; 2],
        range_nm: [f64; 2],
        options: &WavefrontOptions,
    ) -> Result<Self, OpticsError> {
        let eye = projection.eye();
        let xs = chebyshev(min.x, max.x, nodes[0].max(1));
        let ys = chebyshev(min.y, max.y, nodes[1].max(1));
        let half = 0.5 * (max - min).max_element();
        let wavelengths = wavelengths(eye, half, range_nm);
        let mirrored = min.y.to_bits() == (-max.y).to_bits() && eye.prescription().is_mirror_image();
        let rows = if mirrored { ys.len().div_ceil(2) } else { ys.len() };
        let points: Vec<DVec2> =
            ys[..rows].iter().flat_map(|&y| xs.iter().map(move |&x| DVec2::new(x, y))).collect();
        let traced: Vec<Vec<Wavefront>> = points
            .par_iter()
            .map(|&t| Wavefront::series(eye, projection.object(t), wavelengths.nm(), options))
            .collect::<Result<_, _>>()?;
        let mut all = Vec::with_capacity(wavelengths.nm().len() * ys.len() * xs.len());
        for k in 0..wavelengths.nm().len() {
            all.extend(traced.iter().map(|series| series[k].clone()));
            for row in traced.chunks_exact(xs.len()).take(ys.len() - rows).rev() {
                all.extend(row.iter().map(|series| series[k].mirrored()));
            }
        }
        let (prescription, state) = (eye.prescription().clone(), eye.state());
        Ok(Self { prescription, state, axes: [xs, ys], wavelengths, nodes: all })
    }

    /// As bytes.
    ///
    /// # Errors
    /// Never for a table that was traced.
    pub fn to_bytes(&self) -> Result<Vec<u8>, String> {
        postcard::to_extend(self, MAGIC.to_vec()).map_err(|e| e.to_string())
    }

    /// From bytes.
    ///
    /// # Errors
    /// When the bytes are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let body = bytes.strip_prefix(MAGIC).ok_or("not a table of wavefronts")?;
        let table: Self = postcard::from_bytes(body).map_err(|e| e.to_string())?;
        let [xs, ys] = &table.axes;
        let expected = xs.len() * ys.len() * table.wavelengths.nm().len();
        if expected == 0 || expected != table.nodes.len() {
            return Err("its size does not fit its head".into());
        }
        Ok(table)
    }

    /// The wavefronts of a point of the screen (tangents).
    ///
    /// # Errors
    /// When the eye is refused.
    pub fn at(&self, tangent: DVec2) -> Result<WavefrontTable, OpticsError> {
        let [xs, ys] = &self.axes;
        let (across, down) = (lagrange(xs, tangent.x), lagrange(ys, tangent.y));
        let weights: Vec<f64> = down.iter().flat_map(|v| across.iter().map(move |u| u * v)).collect();
        let eye = SchematicEye::new(&self.prescription, &self.state)?;
        let planes = self.wavelengths.nm().iter().zip(self.nodes.chunks_exact(weights.len()));
        let nodes = planes.map(|(&nm, plane)| {
            let mut wavefront = blend(plane, &weights, nm, eye.indices(nm)[4]);
            let frame = eye.fovea().local_frame(wavefront.landing);
            wavefront.meridional_angle = meridional_angle_at(&eye, wavefront.landing, frame);
            wavefront
        });
        let nodes = nodes.collect();
        Ok(WavefrontTable::from_nodes(eye, self.wavelengths.clone(), nodes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Dispersion, EyeState, Prescription, SchematicEye, Side};

    /// Largest path difference from traced wavefronts, waves, over a square of `half_deg` about the line of sight.
    fn worst(dispersion: Dispersion, pupil_mm: f64, half_deg: f64, nodes: usize) -> f64 {
        let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
        let state =
            EyeState { pupil_mm, decentre_mm: 0.4, accommodation_a: 0.25, dispersion, side: Side::Right };
        let projection = Projection::new(&SchematicEye::new(&prescription, &state).unwrap(), 2400.0).unwrap();
        let half = DVec2::splat(half_deg.to_radians().tan());
        let options = WavefrontOptions::default();
        let table =
            FieldTable::new(&projection, [-half, half], [nodes; 2], [400.0, 700.0], &options).unwrap();
        let mut worst = 0.0_f64;
        for (k, nm) in (0..).zip([410.0, 466.0, 549.0, 655.0]) {
            let t = half * (0.97 * DVec2::from_angle(0.6 + 1.7 * f64::from(k)));
            let made = table.at(t).unwrap().at(nm);
            let exact = Wavefront::new(projection.eye(), projection.object(t), nm, &options).unwrap();
            let from_q = |w: &Wavefront, q: DVec2| {
                w.opd_um.at(w.axes.inverse() * (q - w.centre)) + q.dot(w.landing_um - exact.landing_um)
            };
            let piston = from_q(&made, exact.centre) - from_q(&exact, exact.centre);
            for i in 0..40 {
                let s = DVec2::from_angle(2.4 * f64::from(i)) * (f64::from(i) / 39.0).sqrt();
                let q = exact.centre + exact.axes * s;
                let gap = (from_q(&made, q) - from_q(&exact, q) - piston).abs() / exact.wavelength_um();
                worst = worst.max(gap);
            }
            assert!((made.throughput() / exact.throughput() - 1.0).abs() < 1e-3);
            assert!((made.meridional_angle - exact.meridional_angle).abs() < 1e-2);
        }
        worst
    }

    /// A point above the horizontal meridian and its mirror image below it.
    #[test]
    fn mirrored_wavefronts_are_the_traced_ones() {
        let prescription = Prescription::preset("liou-brennan-1997").unwrap();
        for side in [Side::Left, Side::Right] {
            let state = EyeState {
                pupil_mm: 4.0,
                decentre_mm: 0.3,
                accommodation_a: 0.0,
                dispersion: prescription.default_dispersion(),
                side,
            };
            let projection =
                Projection::new(&SchematicEye::new(&prescription, &state).unwrap(), 500.0).unwrap();
            let trace = |t: DVec2| {
                let object = projection.object(t);
                Wavefront::new(projection.eye(), object, 590.0, &WavefrontOptions::default()).unwrap()
            };
            let (above, below) = (trace(DVec2::new(0.2, 0.3)), trace(DVec2::new(0.2, -0.3)));
            let made = above.mirrored();
            assert!((made.landing_um - below.landing_um).length() < 1e-6);
            assert!((made.landing - below.landing).length() < 1e-9);
            assert!((made.meridional_angle - below.meridional_angle).abs() < 1e-9);
            assert!((made.centre - below.centre).length() < 1e-9);
            for i in 0..40 {
                let s = DVec2::from_angle(2.4 * f64::from(i)) * (f64::from(i) / 39.0).sqrt();
                assert!((made.axes * s - below.axes * s).length() < 1e-9);
                assert!((made.opd_um.at(s) - below.opd_um.at(s)).abs() < 1e-7);
                assert!((made.amplitude.at(s) / below.amplitude.at(s) - 1.0).abs() < 1e-7);
                let turn = 0.157 * f64::from(i);
                assert!((made.outline.at(turn)[0] - below.outline.at(turn)[0]).length() < 1e-9);
            }
        }
    }

    /// What the kernels ask: squares of a few degrees; and a field of 30 degrees to either side.
    #[test]
    fn few_nodes_hold_a_field() {
        for dispersion in [Dispersion::Polyline, Dispersion::Herzberger] {
            for (pupil_mm, half_deg, nodes, bound) in [
                (3.0, 1.0, 3, 3e-3),
                (3.0, 2.5, 4, 1e-3),
                (6.0, 1.0, 3, 1e-2),
                (6.0, 2.5, 4, 1e-3),
                (8.0, 2.5, 4, 1e-3),
                (6.0, 5.0, 5, 1e-3),
                (8.0, 12.0, 6, 1e-2),
                (4.0, 30.0, 9, 1e-2),
                (8.0, 30.0, 11, 1e-2),
                (3.0, 30.0, 7, 0.1),
                (3.0, 30.0, 9, 0.03),
            ] {
                let waves = worst(dispersion, pupil_mm, half_deg, nodes);
                println!(
                    "{dispersion:?} {pupil_mm} mm, {half_deg} degrees, {nodes} nodes: {waves:.1e} waves"
                );
                assert!(
                    waves < bound,
                    "{dispersion:?} {pupil_mm} mm, {half_deg}, {nodes}: {waves:.1e} waves"
                );
            }
        }
    }
}
