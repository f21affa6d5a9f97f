//! Modulation transfer at the fovea for pupils of 2 to 6 mm, against the diffraction limit and the mean human eye.
//!
//! Mean of best-corrected human eyes (Watson 2013, J Vis 13(6):18): M(u, d) = (1 + (u/u1)²)^(−0.62)·√D(u, d, 555 nm), u in cycles per
//! degree, d the pupil in mm, u1 = 21.95 − 5.512 d + 0.3922 d²; D is the diffraction limit.

use std::f64::consts::PI;

use glam::DVec2;
use photoneye_eye::optics::{Object, Projection, SchematicEye};
use photoneye_eye::psf::{Otf, Wavefront, WavefrontOptions};

use super::super::page::{Page, Table};
use super::{FOVEA_DEG, failed, prescription, state};
use crate::chart::{Axis, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// Wavelength of the comparison, nm.
const NM: f64 = 555.0;
/// Directions over which the transfer is averaged.
const DIRECTIONS: u32 = 12;

/// Adds curves and a table.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Modulation transfer");
    let mut charts = Vec::new();
    let mut curves = Table::new(
        "transfer",
        "Modulation transfer, mean over directions, 555 nm in best focus",
        &["pupil_mm", "cycles_per_degree", "eye", "diffraction_limit", "watson_2013"],
    )
    .long();
    let mut short = Table::new(
        "transfer-short",
        "Modulation at some frequencies (eye / diffraction limit / mean human eye, Watson 2013)",
        &["pupil_mm", "10 c/deg", "20 c/deg", "30 c/deg", "60 c/deg"],
    );
    for pupil in [2.0, 3.0, 4.0, 5.0, 6.0] {
        let eye = Transfer::new(pupil)?;
        let frequencies: Vec<f64> = (0..=100).map(|k| 1.2 * f64::from(k)).collect();
        let values = eye.modulation(&frequencies);
        let limit: Vec<f64> = frequencies.iter().map(|u| diffraction(*u, pupil)).collect();
        let human: Vec<f64> = frequencies.iter().map(|u| watson(*u, pupil)).collect();
        for ((u, v), (d, h)) in frequencies.iter().zip(&values).zip(limit.iter().zip(&human)) {
            curves.push(row![pupil, *u, *v, *d, *h]);
        }
        let at = |u: f64| {
            let v = eye.modulation(&[u]);
            format!("{:.3} / {:.3} / {:.3}", v[0], diffraction(u, pupil), watson(u, pupil))
        };
        short.push(row![pupil, at(10.0), at(20.0), at(30.0), at(60.0)]);
        let curve = |name: &str, values: &[f64], style, colour| {
            Series::new(
                name,
                frequencies.iter().copied().zip(values.iter().copied()).collect(),
                style,
                colour,
            )
        };
        let mut y = Axis::linear("modulation transfer");
        y.range = Some((0.0, 1.0));
        charts.push(Chart {
            title: format!("{pupil} mm pupil"),
            x: Axis::linear("cycles per degree"),
            y,
            series: vec![
                curve("diffraction limit", &limit, Style::Dashed, DARK),
                curve("this eye", &values, Style::Line, PALETTE[0]),
                curve("mean human eye", &human, Style::Line, PALETTE[1]),
            ],
            bands: Vec::new(),
        });
    }
    page.picture(
        "transfer",
        "Transfer at 555 nm, the eye focused at infinity for that wavelength, mean over 12 directions. The schematic eye has only the \
         aberrations of its surfaces; real eyes (Watson 2013, mean of measured wavefronts) have irregular ones as well.",
        chart_page("Modulation transfer at the fovea", &charts, 3),
    );
    page.table(short);
    page.table(curves);
    Ok(())
}

/// The transfer of the eye at one pupil.
struct Transfer {
    otf: Otf,
    projection: Projection,
}

impl Transfer {
    fn new(pupil_mm: f64) -> Result<Self, Failure> {
        let p = prescription()?;
        let a =
            SchematicEye::accommodation_for(&p, &state(pupil_mm, 0.0), f64::INFINITY, NM).map_err(failed)?;
        let eye = SchematicEye::new(&p, &state(pupil_mm, a)).map_err(failed)?;
        let projection = Projection::new(&eye, f64::INFINITY).map_err(failed)?;
        let object = Object::field(FOVEA_DEG, 0.0).map_err(failed)?;
        let w = Wavefront::new(projection.eye(), object, NM, &WavefrontOptions::default()).map_err(failed)?;
        Ok(Self { otf: Otf::new(&w), projection })
    }

    /// Mean modulus over directions at frequencies in cycles per degree.
    fn modulation(&self, cycles_per_degree: &[f64]) -> Vec<f64> {
        let Ok(um_per_tangent) = self.projection.jacobian_um_per_tangent(DVec2::ZERO) else {
            return vec![f64::NAN; cycles_per_degree.len()];
        };
        let to_retina = um_per_tangent.inverse().transpose() * (180.0 / PI);
        let mut sums = vec![0.0; cycles_per_degree.len()];
        for k in 0..DIRECTIONS {
            let way = to_retina * DVec2::from_angle(PI * f64::from(k) / f64::from(DIRECTIONS));
            let nus: Vec<f64> = cycles_per_degree.iter().map(|u| u * way.length()).collect();
            let values = self.otf.radial(way.y.atan2(way.x), &nus);
            sums.iter_mut().zip(values).for_each(|(s, v)| *s += v.norm() / f64::from(DIRECTIONS));
        }
        sums
    }
}

/// Transfer of a round pupil without aberrations.
fn diffraction(cycles_per_degree: f64, pupil_mm: f64) -> f64 {
    let x = (cycles_per_degree / (pupil_mm * PI * 1e6 / (NM * 180.0))).min(1.0);
    2.0 / PI * (x.acos() - x * (1.0 - x * x).sqrt())
}

/// Mean human eye.
fn watson(cycles_per_degree: f64, pupil_mm: f64) -> f64 {
    let u1 = 21.95 - 5.512 * pupil_mm + 0.3922 * pupil_mm * pupil_mm;
    (1.0 + (cycles_per_degree / u1).powi(2)).powf(-0.62) * diffraction(cycles_per_degree, pupil_mm).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The schematic eye lies below its diffraction limit everywhere, and at 2 mm within 2 % of it.
    #[test]
    fn the_eye_is_below_the_diffraction_limit() {
        let frequencies = [5.0, 10.0, 20.0, 40.0];
        for (pupil, within) in [(2.0, 0.02), (6.0, 1.0)] {
            let eye = Transfer::new(pupil).unwrap();
            for (u, v) in frequencies.iter().zip(eye.modulation(&frequencies)) {
                let limit = diffraction(*u, pupil);
                assert!(v < limit + 2e-3 && v > limit - within, "{pupil} mm, {u} c/deg: {v}, limit {limit}");
            }
        }
    }
}
