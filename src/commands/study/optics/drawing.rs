//! Figure 3: the schematic eye in section, drawn to scale, and its cardinal values.

use photoneye_eye::optics::Prescription;

use super::super::page::{Page, Table};
use super::{NM, eye, prescription};
use crate::chart::{Canvas, Colour, DARK, Font, PALETTE};
use crate::failure::Failure;
use crate::row;

const GREY: Colour = [150; 3];

/// A section of the eye: z to the right, y up, mm.
pub(super) struct Section {
    /// The page.
    pub(super) canvas: Canvas,
    px_per_mm: f64,
    /// Pixel of the corneal apex.
    origin: [f64; 2],
}

impl Section {
    /// An empty page that shows z from -`before_mm` and y within ±`half_mm`.
    pub(super) fn new(title: &str, px_per_mm: f64, before_mm: f64, after_mm: f64, half_mm: f64) -> Self {
        const TOP: f64 = 48.0;
        let width = (before_mm + after_mm) * px_per_mm;
        let mut canvas = Canvas::new(width as i32, (2.0 * half_mm * px_per_mm + TOP) as i32);
        canvas.text(Font::Large, title, 16, 14, DARK);
        Self { canvas, px_per_mm, origin: [before_mm * px_per_mm, half_mm * px_per_mm + TOP] }
    }

    /// Pixel of a point.
    pub(super) fn pixel(&self, z: f64, y: f64) -> [f64; 2] {
        [self.origin[0] + z * self.px_per_mm, self.origin[1] - y * self.px_per_mm]
    }

    /// A line through points (z, y).
    pub(super) fn path(&mut self, points: &[(f64, f64)], width: f64, colour: Colour) {
        let area = self.canvas.area();
        for pair in points.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|(z, y)| self.pixel(z, y));
            self.canvas.line(area, a, b, width, colour);
        }
    }

    /// Words beside a point.
    pub(super) fn words(&mut self, text: &str, z: f64, y: f64, colour: Colour) {
        let [x, y] = self.pixel(z, y);
        self.canvas.text(Font::Small, text, x as i32, y as i32, colour);
    }

    /// Surfaces, iris and retina of an unaccommodated eye.
    pub(super) fn outline(&mut self, p: &Prescription, pupil_mm: f64, decentre_mm: f64, magnification: f64) {
        let surfaces = [&p.cornea_front, &p.cornea_back, &p.lens_front, &p.lens_back];
        let mut z = 0.0;
        for (surface, edge) in surfaces.into_iter().zip([6.2, 5.6, 4.6, 4.6]) {
            let points: Vec<(f64, f64)> = (-60..=60)
                .filter_map(|k| {
                    let y = edge * f64::from(k) / 60.0;
                    Some((z + sag(surface.radius_mm, surface.conic, y)?, y))
                })
                .collect();
            self.path(&points, 2.0, PALETTE[0]);
            z += surface.thickness_mm;
        }
        // Iris: two bars in front of the lens.
        let stop_z = p.cornea_front.thickness_mm + p.cornea_back.thickness_mm;
        let radius = pupil_mm / magnification / 2.0;
        for way in [-1.0, 1.0] {
            self.path(&[(stop_z, way * radius - decentre_mm), (stop_z, way * 5.8)], 4.0, [140, 90, 40]);
        }
        // Retina: the part of the sphere behind the ora serrata, near 120 degrees from the axis.
        let (radius, centre) = (p.retina_radius_mm.abs(), z + p.retina_radius_mm);
        let arc = |from: i32, to: i32| -> Vec<(f64, f64)> {
            let at = |k: i32| (f64::from(k) * 2.0).to_radians();
            (from..=to).map(|k| (centre + radius * at(k).cos(), radius * at(k).sin())).collect()
        };
        self.path(&arc(-60, 60), 2.6, PALETTE[1]);
        self.path(&arc(60, 75), 1.0, GREY);
        self.path(&arc(-75, -60), 1.0, GREY);
    }
}

/// Depth of a conic at a height; `None` beyond its rim.
fn sag(radius: f64, conic: f64, y: f64) -> Option<f64> {
    let root = 1.0 - (1.0 + conic) * y * y / (radius * radius);
    (root >= 0.0).then(|| y * y / (radius * (1.0 + root.sqrt())))
}

/// Adds the drawing and the cardinal values.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("The eye (Figure 3)");
    let p = prescription()?;
    let eye = eye(3.0)?;
    let mut section = Section::new("Schematic eye in section, to scale, mm", 36.0, 4.0, 27.0, 13.2);
    section.path(&[(-3.5, 0.0), (26.5, 0.0)], 1.0, GREY);
    section.outline(&p, 3.0, 0.4, eye.stop_magnification());
    if let Ok(chief) =
        eye.chief_ray(photoneye_eye::optics::Object::field(5.0, 0.0).map_err(super::failed)?, NM)
    {
        let mut points: Vec<(f64, f64)> = chief.hits.iter().flatten().map(|h| (h.z, h.y)).collect();
        let slope = 5.0_f64.to_radians().tan();
        points.insert(0, (-3.5, points[0].1 - (points[0].0 + 3.5) * slope));
        section.path(&points, 1.4, PALETTE[2]);
    }
    let fovea = eye.fovea().position;
    let dot = section.pixel(fovea.z, fovea.y);
    let area = section.canvas.area();
    section.canvas.dot(area, dot, 5.0, PALETTE[2]);
    section.words("fovea", fovea.z + 0.3, fovea.y + 0.9, DARK);
    for (text, z, y) in [
        ("cornea 0.55: R 7.72, k -0.26; R 6.5", -3.7, 11.6),
        ("pupil, 0.4 off the axis", 4.0, 6.6),
        ("lens 4.00: R 10.2, k -3.1316; R -6.0, k -1", 4.6, -5.2),
        ("aqueous 3.05", 0.75, 2.2),
        ("vitreous 16.3203", 13.0, -1.0),
        ("retina R 12, to the ora serrata (120°)", 8.6, 10.8),
    ] {
        section.words(text, z, y, DARK);
    }
    page.picture(
        "figure03-eye",
        "Figure 3: surfaces (blue), iris (brown), retina to the ora serrata (orange), chief ray to the fovea (green), optical axis (grey).",
        section.canvas.finish(),
    );
    let mut table = Table::new(
        "cardinal",
        "Cardinal values, mm from the corneal apex",
        &["wavelength_nm", "power_D", "entrance pupil z", "stop magnification", "exit pupil z", "N", "N'"],
    );
    for nm in [458.0, NM, 589.3, 632.8] {
        let c = eye.cardinal(nm);
        table.push(row![
            nm,
            c.power_d,
            c.entrance_pupil_z_mm,
            c.stop_magnification,
            c.exit_pupil_z_mm,
            c.first_nodal_z_mm,
            c.second_nodal_z_mm
        ]);
    }
    page.table(table);
    page.text("Paper, section 16: the stop is 1.13 times smaller than the entrance pupil.");
    Ok(())
}
