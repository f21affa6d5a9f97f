//! Chromatic difference of focus against the chromatic eye, and the sideways colour error at the fovea.
//!
//! Refraction of the human eye (Thibos et al. 1992, Appl Opt 31:3594): R = 1.68524 − 633.46/(λ − 214.102) dioptres, λ in nm.

use photoneye_eye::optics::{
    Dispersion, EyeState, Object, OpticsError, PupilBundle, PupilNodes, SchematicEye,
};

use super::super::page::{Page, Table};
use super::{FOVEA_DEG, NM, failed, prescription, state};
use crate::chart::{Axis, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// Where all curves are 0, nm.
const ZERO_NM: f64 = 589.3;

/// Adds the curves.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Colour");
    let p = prescription()?;
    let eye = |dispersion| SchematicEye::new(&p, &EyeState { dispersion, ..state(3.0, 0.0) }).map_err(failed);
    let (herzberger, polyline) = (eye(Dispersion::Herzberger)?, eye(Dispersion::Polyline)?);
    let zero = [
        refraction(&herzberger, ZERO_NM).map_err(failed)?,
        refraction(&polyline, ZERO_NM).map_err(failed)?,
        thibos(ZERO_NM),
    ];
    let mut table = Table::new(
        "colour",
        "Refraction relative to 589.3 nm (dioptres; negative: short-sighted) and landing of the chief ray relative to 543 nm",
        &["wavelength_nm", "herzberger_D", "polyline_D", "thibos_1992_D", "sideways_um"],
    );
    let chief = |nm: f64| -> Result<f64, Failure> {
        let chief =
            herzberger.chief_ray(Object::field(FOVEA_DEG, 0.0).map_err(failed)?, nm).map_err(failed)?;
        Ok(herzberger.fovea().um_from_point(chief.landing().unwrap_or_default()).x)
    };
    let middle = chief(NM)?;
    let mut curves = [Vec::new(), Vec::new(), Vec::new()];
    for nm in (400..=700).step_by(20).map(f64::from) {
        let values = [
            refraction(&herzberger, nm).map_err(failed)? - zero[0],
            refraction(&polyline, nm).map_err(failed)? - zero[1],
            thibos(nm) - zero[2],
        ];
        curves.iter_mut().zip(values).for_each(|(curve, value)| curve.push((nm, value)));
        table.push(row![nm, values[0], values[1], values[2], chief(nm)? - middle]);
    }
    let [a, b, c] = curves;
    let range = |curve: &[(f64, f64)]| curve.last().map_or(0.0, |l| l.1) - curve.first().map_or(0.0, |f| f.1);
    page.text(&format!(
        "400 to 700 nm: {:.2} D with Herzberger's dispersion, {:.2} D with the paper's four-point line, {:.2} D in people (Thibos et al. 1992).",
        range(&a),
        range(&b),
        range(&c)
    ));
    let chart = Chart {
        title: "Chromatic difference of refraction".into(),
        x: Axis::linear("wavelength in vacuum, nm"),
        y: Axis::linear("refraction relative to 589.3 nm, dioptres"),
        series: vec![
            Series::new("Herzberger", a, Style::Line, PALETTE[0]),
            Series::new("polyline", b, Style::Line, PALETTE[1]),
            Series::new("people (Thibos 1992)", c, Style::Dashed, DARK),
        ],
        bands: Vec::new(),
    };
    page.picture("colour", "Focus against wavelength at the fovea, 3 mm.", chart_page("", &[chart], 1));
    page.table(table);
    Ok(())
}

/// Refraction of a human eye, dioptres.
fn thibos(nm: f64) -> f64 {
    1.68524 - 633.46 / (nm - 214.102)
}

/// Refraction of the eye: minus the vergence of the object that is in best focus on the fovea (least wavefront error), dioptres.
fn refraction(eye: &SchematicEye, nm: f64) -> Result<f64, OpticsError> {
    let nodes = PupilNodes { radial: 6, azimuth: 16, edge: 0 };
    let variance = |vergence: f64| -> Result<f64, OpticsError> {
        let object = Object::field(FOVEA_DEG, vergence)?;
        Ok(PupilBundle::trace(eye, object, nm, nodes)?.variance_mm2())
    };
    // The variance is very nearly a parabola in the vergence.
    let (mut x, mut h) = (0.0, 1.0);
    for _ in 0..6 {
        let (low, middle, high) = (variance(x - h)?, variance(x)?, variance(x + h)?);
        x += (0.5 * h * (low - high) / (low - 2.0 * middle + high)).clamp(-2.0, 2.0);
        h = (0.5 * h).max(0.05);
    }
    Ok(-x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Emmetropic at 543 nm but for the pupil's spherical aberration; 2.47 D (Herzberger) from 400 to 700 nm.
    #[test]
    fn refraction_of_the_eye() {
        let eye = SchematicEye::new(&prescription().unwrap(), &state(3.0, 0.0)).unwrap();
        let at = |nm| refraction(&eye, nm).unwrap();
        assert!(at(543.0).abs() < 0.1, "{}", at(543.0));
        assert!((at(700.0) - at(400.0) - 2.47).abs() < 0.03, "{}", at(700.0) - at(400.0));
    }
}
