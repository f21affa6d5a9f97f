//! Figure 11: the point spread without and with diffraction, and the hole in its middle at half a dioptre.

use glam::DVec2;
use photoneye_eye::optics::{Object, PupilBundle};
use photoneye_eye::psf::{PsfGrid, PupilSampling, Wavefront, WavefrontOptions, psf};

use super::super::Task;
use super::super::page::{Page, Table};
use super::{FOVEA_DEG, NM, eye, failed};
use crate::chart::{Axis, Chart, Content, PALETTE, Series, Style, Tile, page as chart_page, sheet};
use crate::failure::Failure;
use crate::row;

/// Half of the paper's window, µm.
const HALF_UM: f64 = 10.0;
const SAMPLES: usize = 128;

/// Adds Figure 11 and the point spread through focus.
pub fn study(task: &Task, page: &mut Page) -> Result<(), Failure> {
    page.heading("Point spread (Figure 11)");
    let eye = eye(3.0)?;
    let spread = |vergence: f64| -> Result<(Vec<f64>, f64), Failure> {
        let object = Object::field(FOVEA_DEG, vergence).map_err(failed)?;
        let w = Wavefront::new(&eye, object, NM, &WavefrontOptions::default()).map_err(failed)?;
        let values = psf(&w, &PsfGrid::new(SAMPLES, HALF_UM));
        let energy = values.iter().sum::<f64>()
            * w.density_per_um2()
            * PsfGrid::new(SAMPLES, HALF_UM).pitch_um().powi(2);
        Ok((values, energy))
    };
    let mut table = Table::new(
        "figure11",
        "Middle and brightest ring of the point spread, 3 mm, 543 nm",
        &["object_D", "middle/ring", "ring_radius_um", "peak", "light_in_20um_window"],
    );
    let mut ratios = Vec::new();
    let mut hole = (f64::INFINITY, 0.0);
    let steps = task.pick(40, 20);
    for k in 0..=steps {
        let vergence = f64::from(k) / f64::from(steps);
        let (values, energy) = spread(vergence)?;
        let (middle, ring, radius) = profile(&values);
        if k % (steps / 20) == 0 {
            let peak = values.iter().copied().fold(0.0, f64::max);
            table.push(row![vergence, middle / ring, radius, peak, energy]);
        }
        ratios.push((vergence, middle / ring));
        if (0.4..=0.7).contains(&vergence) && middle / ring < hole.0 {
            hole = (middle / ring, vergence);
        }
    }
    let mut tiles = vec![no_diffraction(&eye, hole.1)?];
    for vergence in [hole.1, 0.0, 0.25, 0.75, 1.0] {
        let (values, energy) = spread(vergence)?;
        let peak = values.iter().copied().fold(0.0, f64::max);
        tiles.push(Tile {
            title: format!("{vergence} D, diffracted"),
            note: format!("{:.0} % of the light, peak {peak:.3}", 100.0 * energy),
            content: Content::Values(values.iter().map(|v| (v / peak).sqrt()).collect()),
            bar: (0.25, "5 µm".into()),
        });
    }
    page.picture(
        "figure11-spread",
        "Figure 11: 20 µm windows, brightness as the root of the intensity. First: rays only, no diffraction. The defocused spread has a \
         hole in its middle: a point is seen as the absence of light.",
        sheet("Point spread without and with diffraction, 3 mm, 543 nm, 5°", &tiles, 3),
    );
    let chart = Chart {
        title: "Depth of the hole".into(),
        x: Axis::linear("vergence of the object, dioptres"),
        y: Axis::linear("intensity in the middle / in the ring"),
        series: vec![Series::new("", ratios, Style::Both, PALETTE[0])],
        bands: Vec::new(),
    };
    page.picture("figure11-hole", "Middle over brightest ring against defocus.", chart_page("", &[chart], 1));
    page.table(table);
    Ok(())
}

/// Mean intensity about the centroid within 0.4 µm, the largest mean in a ring, and that ring's radius (µm).
fn profile(values: &[f64]) -> (f64, f64, f64) {
    const RING_UM: f64 = 0.4;
    let grid = PsfGrid::new(SAMPLES, HALF_UM);
    let at = |k: usize| DVec2::new(grid.offset(k / SAMPLES), grid.offset(k % SAMPLES));
    let total: f64 = values.iter().sum();
    let centre = values.iter().enumerate().map(|(k, v)| at(k) * *v).sum::<DVec2>() / total;
    let mut rings = vec![(0.0, 0.0); 24];
    for (k, value) in values.iter().enumerate() {
        if let Some((sum, count)) = rings.get_mut(((at(k) - centre).length() / RING_UM) as usize) {
            *sum += value;
            *count += 1.0;
        }
    }
    let mean: Vec<f64> = rings.iter().map(|(sum, count)| sum / f64::max(*count, 1.0)).collect();
    let best = (0..mean.len()).max_by(|a, b| mean[*a].total_cmp(&mean[*b])).unwrap_or(0);
    (mean[0], mean[best], (best as f64 + 0.5) * RING_UM)
}

/// Where rays land, as a density.
fn no_diffraction(eye: &photoneye_eye::optics::SchematicEye, vergence: f64) -> Result<Tile, Failure> {
    const CELLS: usize = 60;
    let object = Object::field(FOVEA_DEG, vergence).map_err(failed)?;
    let points = PupilSampling::Stratified.points(40_000, 1);
    let bundle = PupilBundle::trace_points(eye, object, NM, &points, &[]).map_err(failed)?;
    let outward = bundle.landing - eye.retina_centre();
    // The same axes as the point spread: first away from the optical axis.
    let along = (glam::DVec3::Y - outward * (outward.y / outward.length_squared())).normalize_or_zero();
    let across = along.cross(outward / outward.length());
    let mut cells = vec![0.0; CELLS * CELLS];
    for ray in &bundle.rays {
        let off = 1e3 * (ray.landing - bundle.landing);
        let index = |v: f64| ((v / HALF_UM + 1.0) * 0.5 * CELLS as f64).floor();
        let (i, j) = (index(off.dot(along)), index(off.dot(across)));
        if (0.0..CELLS as f64).contains(&i) && (0.0..CELLS as f64).contains(&j) {
            cells[i as usize * CELLS + j as usize] += 1.0;
        }
    }
    let most = cells.iter().copied().fold(1.0, f64::max);
    Ok(Tile {
        title: format!("{vergence} D, rays only"),
        note: "40,000 rays, no diffraction".into(),
        content: Content::Values(cells.iter().map(|c| (c / most).sqrt()).collect()),
        bar: (0.25, "5 µm".into()),
    })
}
