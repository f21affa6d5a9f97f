//! Figure 10: 190° of rays into the schematic eye, and where their chief rays land.

use glam::DVec3;
use photoneye_eye::optics::{Object, Ray, RayFate, SchematicEye, Traced};

use super::super::page::{Page, Table};
use super::drawing::Section;
use super::{NM, eye, failed, prescription};
use crate::chart::{Axis, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// Half of the fan, degrees.
const REACH_DEG: i32 = 95;

/// Adds the drawing and the table of chief rays.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("190° of rays (Figure 10)");
    let eye = eye(3.0)?;
    let mut section =
        Section::new("190° of rays into the schematic eye, 543 nm, 3 mm pupil", 30.0, 12.0, 26.0, 14.0);
    for (k, angle) in (-REACH_DEG..=REACH_DEG).step_by(10).enumerate() {
        for traced in parallel(&eye, f64::from(angle)) {
            let mut points: Vec<(f64, f64)> = traced.1.hits.iter().flatten().map(|h| (h.z, h.y)).collect();
            let start = traced.1.hits[0].unwrap_or_default() - 5.0 * traced.0;
            points.insert(0, (start.z, start.y));
            section.path(&points, 0.9, PALETTE[k % PALETTE.len()]);
        }
    }
    section.outline(&prescription()?, 3.0, 0.4, eye.stop_magnification());
    page.picture(
        "figure10-fan",
        "Figure 10: parallel rays every 10° that pass the pupil. At high eccentricities they meet the retina far from its normal.",
        section.canvas.finish(),
    );
    let mut table = Table::new(
        "chief-rays",
        "Chief rays: where they land and at what angle",
        &["field_deg", "retinal_deg_from_axis", "retinal_deg_per_field_deg", "angle_to_retina_normal_deg"],
    );
    let mut curve = Vec::new();
    for angle in (-REACH_DEG..=REACH_DEG).step_by(5) {
        let field = f64::from(angle);
        let chief = eye.chief_ray(Object::field(field, 0.0).map_err(failed)?, NM).map_err(failed)?;
        let arm = chief.landing().unwrap_or_default() - eye.retina_centre();
        let retinal = arm.y.atan2(arm.z).to_degrees();
        let incidence = (chief.direction.dot(arm) / arm.length()).clamp(-1.0, 1.0).acos().to_degrees();
        curve.push((field, retinal));
        table.push(row![field, retinal, if angle == 0 { f64::NAN } else { retinal / field }, incidence]);
    }
    let chart = Chart {
        title: "Landing of chief rays".into(),
        x: Axis::linear("field angle from the optical axis, degrees"),
        y: Axis::linear("retinal angle from the axis, degrees"),
        series: vec![
            Series::new("traced", curve, Style::Both, PALETTE[0]),
            Series::new("one to one", vec![(-95.0, -95.0), (95.0, 95.0)], Style::Dashed, DARK),
        ],
        bands: Vec::new(),
    };
    page.picture(
        "chief-rays",
        "Retinal angle (at the centre of the retinal sphere) against field angle.",
        chart_page("", &[chart], 1),
    );
    page.table(table);
    Ok(())
}

/// Rays of one direction that reach the retina, 0.75 mm apart, with that direction.
fn parallel(eye: &SchematicEye, angle_deg: f64) -> Vec<(DVec3, Traced)> {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let (along, across) = (DVec3::new(0.0, sin, cos), DVec3::new(0.0, cos, -sin));
    let centre = DVec3::new(0.0, 0.0, 3.0);
    (-12..=12)
        .filter_map(|k| Ray::new(centre + 0.6 * f64::from(k) * across - 30.0 * along, along).ok())
        .map(|ray| (along, eye.trace(&ray, NM)))
        .filter(|(_, traced)| traced.fate == RayFate::Arrived)
        .collect()
}
