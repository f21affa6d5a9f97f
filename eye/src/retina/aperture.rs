//! How much of its cell a cone's light-collecting aperture fills (§13, §15).
//!
//! `Cell`: the paper's. Apertures fill the cells where there are no rods, and the fraction of Curcio's
//! photomicrographs beyond, π/4·d²·(cones counted in the same frame) (table below), monotone cubic in
//! eccentricity. Cells of the mosaic are not those of the frames, which lie in the horizontal streak: beyond
//! the fovea these apertures are 6 to 39 % larger than inner segments.
//!
//! `InnerSegment`: π/4·d², d the diameter of inner segments by `data/spectra/cone-inner-segment.csv` (Rodieck
//! 1998 at the centre, Curcio et al. 1990 beyond), monotone cubic in retinal degrees, constant past the data;
//! the fraction of the cell is
//!
//! min(1, π/4·d²·ρ), ρ cones per µm² of retina.     (1)
//!
//! d is measured in the plane of the retina, and ρ counts there: a cone's tilt shrinks cell and aperture
//! alike. Diameters are µm on a sphere of 12 mm, scaled to another radius with it, as the density is. The
//! mean aperture is π/4·d²; each cone's is its own cell shrunk about the cone.

use std::f64::consts::FRAC_PI_4;

use super::density::{CURCIO_RADIUS_UM, Cubic};
use super::params::{Aperture, RetinaParams};
use crate::catalog;

/// Radius of the sphere that the diameters are for, µm.
const DIAMETER_RADIUS_UM: f64 = 12_000.0;
/// (eccentricity µm on the 11.402 mm sphere, fraction of the cell inside the inner segment).
const OF_CELL: [(f64, f64); 7] = [
    (0.0, 1.0),
    (100.0, 1.0),
    (660.0, 0.802),
    (1_350.0, 0.621),
    (5_000.0, 0.312),
    (8_000.0, 0.268),
    (16_000.0, 0.204),
];

/// The law of the apertures of one set of parameters.
#[derive(Clone, Debug)]
pub(super) enum ApertureLaw {
    /// Fraction of the cell over µm on Curcio's sphere.
    Cell(Cubic),
    /// Diameter in µm over µm on Curcio's sphere.
    InnerSegment(Cubic),
}

impl ApertureLaw {
    /// Reads the embedded table `cone-inner-segment` where it is needed.
    pub(super) fn new(p: &RetinaParams) -> Self {
        match p.aperture {
            Aperture::Cell => Self::Cell(Cubic::new(&OF_CELL)),
            Aperture::InnerSegment => {
                let scale = p.geometry.radius_um / DIAMETER_RADIUS_UM;
                let text = catalog::text("spectra", "cone-inner-segment").unwrap_or_default();
                Self::InnerSegment(Cubic::new(&diameters(text, scale)))
            }
        }
    }

    /// Fraction of a cell that collects light, 0 to 1, at an eccentricity in µm on Curcio's sphere where
    /// there are `per_um2` cones on 1 µm² of retina (asked only where it matters).
    pub(super) fn fraction(&self, on_source_um: f64, per_um2: impl FnOnce() -> f64) -> f64 {
        match self {
            Self::Cell(of_cell) => of_cell.at(on_source_um).min(1.0),
            Self::InnerSegment(diameter) => {
                let d = diameter.at(on_source_um);
                (FRAC_PI_4 * d * d * per_um2()).min(1.0) // (1)
            }
        }
    }
}

/// (µm on Curcio's sphere, diameter in µm) of the table, diameters times `scale`.
fn diameters(text: &str, scale: f64) -> Vec<(f64, f64)> {
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.filter_map(|line| {
        let mut fields = line.split(',');
        let deg: f64 = fields.next()?.trim().parse().ok()?;
        let diameter: f64 = fields.nth(1)?.trim().parse().ok()?;
        Some((deg.to_radians() * CURCIO_RADIUS_UM, scale * diameter))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use glam::DVec2;

    use super::super::density::Density;
    use super::super::{RegionUm, build_region, import};
    use super::*;

    fn params(aperture: Aperture) -> RetinaParams {
        RetinaParams { aperture, ..RetinaParams::default() }
    }

    /// Fractions at the knots of both laws; a denser retina's inner segments never leave their cells.
    #[test]
    fn fractions_of_the_cell() {
        let [cell, inner] = [Aperture::Cell, Aperture::InnerSegment].map(|a| Density::new(&params(a)));
        let at = |mm: f64| DVec2::new(1e3 * mm * 12.0 / 11.402, 0.0);
        for (mm, of_cell, diameter) in
            [(0.0, 1.0, 2.3), (0.66, 0.802, 5.9 * 12.0 / 11.402), (8.0, 0.268, 7.5 * 12.0 / 11.402)]
        {
            assert!((cell.coverage(at(mm)) - of_cell).abs() < 1e-9, "{mm}");
            let want = FRAC_PI_4 * diameter * diameter * 1e-6 * inner.per_mm2(at(mm));
            assert!((inner.coverage(at(mm)) / want - 1.0).abs() < 1e-4, "{mm}");
        }
        let dense = RetinaParams { peak_density_per_mm2: 324_100.0, ..params(Aperture::InnerSegment) };
        assert!((Density::new(&dense).coverage(DVec2::ZERO) - 1.0).abs() < 1e-12);
    }

    /// Places, types, cells and directions do not depend on the aperture; the outline is the cell's, smaller.
    #[test]
    fn the_mosaic_stays_the_same() {
        let region = RegionUm { min: DVec2::splat(-40.0), max: DVec2::splat(40.0) };
        let [cell, inner] =
            [Aperture::Cell, Aperture::InnerSegment].map(|a| build_region(&params(a), &region).unwrap());
        assert_eq!(
            (&cell.id, &cell.x_um, &cell.cell_area_um2),
            (&inner.id, &inner.x_um, &inner.cell_area_um2)
        );
        assert!(cell.cone_type == inner.cone_type && cell.pointing == inner.pointing);
        assert_ne!(cell.to_bytes(), inner.to_bytes());
        for i in 0..cell.len() {
            let shrink = f64::from(inner.aperture_um2[i] / cell.aperture_um2[i]).sqrt();
            assert!((0.8..0.9).contains(&shrink), "{shrink}");
            for (full, part) in cell.polygon(i).zip(inner.polygon(i)) {
                assert!(((part - cell.center(i)) - shrink * (full - cell.center(i))).length() < 1e-5);
            }
        }
    }

    /// Measured cones four times as far apart as the law has them: each has the inner segment of its place,
    /// not a part of its large cell. Where they are closer than an inner segment is wide, it fills the cell.
    #[test]
    fn measured_cones_have_inner_segments_too() {
        for (spacing, full) in [(10.0, false), (2.0, true)] {
            let mut text = String::from("type,y_um,x_um\n");
            for k in 0..81 {
                let (a, b) = (f64::from(k % 9 - 4), f64::from(k / 9 - 4));
                let (x, y) = (spacing * (a + 0.5 * (b.abs() % 2.0)), spacing * 0.75_f64.sqrt() * b);
                writeln!(text, "L,{y},{x}").unwrap();
            }
            let retina = import(&text, &params(Aperture::InnerSegment), None).unwrap();
            let centre = (0..retina.len()).find(|&i| retina.center(i) == DVec2::ZERO).unwrap();
            let (aperture, cell) = (retina.aperture_um2[centre], retina.cell_area_um2[centre]);
            let want = if full { cell } else { (FRAC_PI_4 * 2.3 * 2.3) as f32 };
            assert!((aperture / want - 1.0).abs() < 2e-3, "{spacing}: {aperture} of {cell}");
        }
    }
}
