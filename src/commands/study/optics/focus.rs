//! Strehl ratio: of the accommodated eye against the distance in focus, and through focus for several pupils.

use photoneye_eye::optics::{Object, SchematicEye};
use photoneye_eye::psf::{PsfGrid, Wavefront, WavefrontOptions, psf};

use super::super::page::{Page, Table};
use super::{FOVEA_DEG, NM, eye, failed, prescription, state};
use crate::chart::{Axis, Chart, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// Adds the tables and the curves.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Focus");
    let p = prescription()?;
    let mut table = Table::new(
        "accommodation",
        "Best focus on the fovea, 3 mm, 543 nm",
        &["distance_m", "nominal_A", "lens_front_R_mm", "strehl_peak", "strehl_at_chief_ray", "rms_waves"],
    );
    for distance_mm in [f64::INFINITY, 8000.0, 2400.0, 1000.0, 500.0, 1000.0 / 3.0, 250.0, 125.0] {
        let a = SchematicEye::accommodation_for(&p, &state(3.0, 0.0), distance_mm, NM).map_err(failed)?;
        let eye =
            SchematicEye::new(&p, &state(3.0, a)).and_then(|e| e.at_distance(distance_mm)).map_err(failed)?;
        let w = wavefront(&eye, 1e3 / distance_mm)?;
        let ln = if a < -0.5 { f64::NAN } else { a.ln_1p() };
        let slope = p.accommodation.as_ref().map_or(0.0, |law| law.lens_front_radius_mm);
        let radius = p.lens_front.radius_mm + slope * ln;
        table.push(row![distance_mm / 1e3, a, radius, peak(&w), w.strehl(), w.rms_waves()]);
    }
    page.table(table);
    let mut curves = Table::new(
        "through-focus",
        "Strehl ratio (peak) through focus",
        &["pupil_mm", "object_D", "strehl_peak", "rms_waves"],
    )
    .long();
    let mut series = Vec::new();
    for (k, pupil) in [2.0, 3.0, 4.0, 6.0].into_iter().enumerate() {
        let eye = eye(pupil)?;
        let mut points = Vec::new();
        for step in -16..=16 {
            let vergence = f64::from(step) / 8.0;
            let w = wavefront(&eye, vergence)?;
            let strehl = peak(&w);
            curves.push(row![pupil, vergence, strehl, w.rms_waves()]);
            points.push((vergence, strehl));
        }
        series.push(Series::new(&format!("{pupil} mm"), points, Style::Both, PALETTE[k]));
    }
    let chart = Chart {
        title: "Strehl ratio through focus".into(),
        x: Axis::linear("vergence of the object, dioptres"),
        y: Axis::log("peak / peak without aberrations"),
        series,
        bands: Vec::new(),
    };
    page.picture(
        "through-focus",
        "Peak of the point spread over that of the same pupil without path differences, unaccommodated eye, 543 nm.",
        chart_page("", &[chart], 1),
    );
    page.table(curves);
    Ok(())
}

fn wavefront(eye: &SchematicEye, vergence: f64) -> Result<Wavefront, Failure> {
    let object = Object::field(FOVEA_DEG, vergence).map_err(failed)?;
    Wavefront::new(eye, object, NM, &WavefrontOptions::default()).map_err(failed)
}

/// Peak over a window that holds the spot.
fn peak(w: &Wavefront) -> f64 {
    psf(w, &PsfGrid::new(96, 12.0)).into_iter().fold(0.0, f64::max)
}
