//! Where the kernels take their wavefronts from: a table over the tile's field, or rays traced for each point.

use glam::DVec2;

use super::density::STEP_UM;
use super::kernel::KernelSpec;
use super::transfer::{FieldPoint, wavefront_options, wavefronts};
use crate::optics::Projection;
use crate::psf::{FieldTable, Wavefront, WavelengthNodes};

/// Spectra of wavefronts that a field point takes: its own, and four beside it for the density.
const SPECTRA_PER_POINT: usize = 5;
/// Half sides (degrees) up to which 3, 4 and 5 nodes hold the field to a hundredth of a wave at 6 mm, see the test of [`FieldTable`].
const HALF_DEG: [f64; 3] = [1.0, 2.5, 5.0];

/// The field of a tile.
pub struct Field<'a> {
    projection: &'a Projection,
    table: Option<FieldTable>,
}

impl<'a> Field<'a> {
    /// Traces a table when that is less work than all wavefronts, and exact enough.
    ///
    /// # Errors
    /// When the pupil cannot be traced.
    pub fn new(projection: &'a Projection, spec: &KernelSpec) -> Result<Self, String> {
        let none = Ok(Self { projection, table: None });
        let (Some(&first), Some(&last)) = (spec.nodes_nm.first(), spec.nodes_nm.last()) else {
            return none;
        };
        let Some(bounds) = bounds(projection, spec) else { return none };
        let Some(nodes) = nodes(bounds, spec.tolerance) else { return none };
        let points: usize = spec.field_nodes.iter().map(|n| *n as usize).product();
        let per_spectrum = WavelengthNodes::new(projection.eye(), [first, last]).nm().len();
        let traced = SPECTRA_PER_POINT * points * per_spectrum.min(spec.nodes_nm.len());
        if nodes.iter().product::<usize>() * per_spectrum >= traced {
            return none;
        }
        let options = wavefront_options(spec.stiles_crawford_rho10_per_mm2);
        let table = FieldTable::new(projection, bounds, nodes, [first, last], &options);
        Ok(Self { projection, table: Some(table.map_err(|e| e.to_string())?) })
    }

    /// The screen and the eye.
    pub fn projection(&self) -> &'a Projection {
        self.projection
    }

    /// Wavefronts `[wavelength]` of a field point.
    ///
    /// # Errors
    /// When the pupil cannot be traced.
    pub fn wavefronts(
        &self,
        point: &FieldPoint,
        nodes_nm: &[f64],
        rho10_per_mm2: f64,
    ) -> Result<Vec<Wavefront>, String> {
        let Some(table) = &self.table else {
            return wavefronts(self.projection, point, nodes_nm, rho10_per_mm2);
        };
        let here = table.at(point.tangent);
        Ok(nodes_nm.iter().map(|&nm| here.at(nm)).collect())
    }
}

/// Rectangle of the screen (tangents) that holds a tile and the points beside it; `None` when a part of it sees no screen.
fn bounds(projection: &Projection, spec: &KernelSpec) -> Option<[DVec2; 2]> {
    let [min, max] = spec.field_um;
    let (middle, half) = (0.5 * (min + max), 0.5 * (max - min) + STEP_UM);
    let mut bounds = [DVec2::MAX, DVec2::MIN];
    for x in [-1.0, 0.0, 1.0] {
        for y in [-1.0, 0.0, 1.0] {
            let tangent = projection.screen_tangent(middle + half * DVec2::new(x, y)).ok()?;
            bounds = [bounds[0].min(tangent), bounds[1].max(tangent)];
        }
    }
    Some(bounds)
}

/// Nodes along x and y for a tolerance of the kernels; `None` when the field is too large.
fn nodes([min, max]: [DVec2; 2], tolerance: f64) -> Option<[usize; 2]> {
    let finer = usize::from(tolerance < 2e-3) + usize::from(tolerance < 2e-4);
    let along = |size: f64| {
        let half_deg = (0.5 * size).atan().to_degrees();
        HALF_DEG.iter().position(|most| half_deg < *most).map(|i| i + 3 + finer)
    };
    Some([along(max.x - min.x)?, along(max.y - min.y)?])
}
