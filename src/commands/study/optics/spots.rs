//! Spot diagrams: where the rays of one point land, for several fields, pupils and distances, with Figure 3's eye.

use glam::DVec2;
use photoneye_eye::optics::{Object, PupilBundle, PupilNodes};
use photoneye_eye::psf::PupilSampling;

use super::super::page::{Page, Table};
use super::{NM, eye, failed};
use crate::chart::{Content, PALETTE, Tile, sheet};
use crate::failure::Failure;
use crate::row;

/// Adds the diagrams and their sizes.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Spots");
    let mut tiles = Vec::new();
    let mut table = Table::new(
        "spots",
        "Root mean square distance of the landing points from their centroid",
        &["field_deg", "pupil_mm", "object_D", "rms_um"],
    );
    let cases = [
        (5.0, 2.0, 0.0),
        (5.0, 3.0, 0.0),
        (5.0, 6.0, 0.0),
        (5.0, 3.0, 0.5),
        (5.0, 3.0, -0.5),
        (0.0, 3.0, 0.0),
        (10.0, 3.0, 0.0),
        (20.0, 3.0, 0.0),
        (40.0, 3.0, 0.0),
    ];
    for (field, pupil, vergence) in cases {
        let eye = eye(pupil)?;
        let object = Object::field(field, vergence).map_err(failed)?;
        let landing = |points: &[(DVec2, f64)]| -> Result<Vec<(DVec2, f64)>, Failure> {
            let bundle = PupilBundle::trace_points(&eye, object, NM, points, &[]).map_err(failed)?;
            let [x, y, _] = bundle.frame;
            let offset = |at: glam::DVec3| {
                1e3 * DVec2::new((at - bundle.landing).dot(x), (at - bundle.landing).dot(y))
            };
            Ok(bundle.rays.iter().map(|r| (offset(r.landing), r.weight)).collect())
        };
        let nodes = PupilNodes { radial: 12, azimuth: 48, edge: 0 };
        let rms = rms(&landing(&nodes.points())?);
        table.push(row![field, pupil, vergence, rms]);
        let dots = landing(&PupilSampling::Grid.points(1200, 1))?;
        let reach = dots.iter().map(|(p, _)| p.abs().max_element()).fold(1.0, f64::max);
        let half =
            [5.0, 10.0, 20.0, 50.0, 100.0, 200.0].into_iter().find(|h| *h > 1.05 * reach).unwrap_or(500.0);
        let points = dots.iter().map(|(p, _)| [p.x / half, p.y / half]).collect();
        tiles.push(Tile {
            title: format!("{field}°, {pupil} mm, {vergence} D"),
            note: format!("rms {rms:.2} µm"),
            content: Content::Points(vec![(PALETTE[0], points)]),
            bar: (0.25, format!("{} µm", 0.5 * half)),
        });
    }
    page.picture(
        "spots",
        "Landing points of a square lattice of rays over the pupil: field angle from the optical axis (the fovea is at 5°), pupil, \
         vergence of the object in dioptres. Nasal retina to the right.",
        sheet("Spot diagrams, 543 nm, no accommodation", &tiles, 3),
    );
    page.table(table);
    Ok(())
}

/// Weighted root mean square distance from the centroid.
fn rms(points: &[(DVec2, f64)]) -> f64 {
    let total: f64 = points.iter().map(|p| p.1).sum();
    let centre = points.iter().map(|(p, w)| *p * *w).sum::<DVec2>() / total;
    (points.iter().map(|(p, w)| w * (*p - centre).length_squared()).sum::<f64>() / total).sqrt()
}
