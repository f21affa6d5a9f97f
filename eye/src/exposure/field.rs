//! Where the kernels take their wavefronts from: the table of the whole field, or rays traced for each point.

use super::transfer::{FieldPoint, wavefronts};
use crate::optics::Projection;
use crate::psf::{FieldTable, FieldTableSpec, Wavefront, WavelengthNodes};

use super::kernel::KernelSpec;
use super::padua::FieldNodes;

/// The field of a tile.
pub struct Field<'a> {
    projection: &'a Projection,
    table: Option<&'a FieldTable>,
}

impl<'a> Field<'a> {
    /// The field with or without a table that holds it.
    pub fn new(projection: &'a Projection, table: Option<&'a FieldTable>) -> Self {
        Self { projection, table }
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
        let Some(table) = self.table else {
            return wavefronts(self.projection, point, nodes_nm, rho10_per_mm2);
        };
        let here = table.at(point.tangent).map_err(|e| e.to_string())?;
        Ok(nodes_nm.iter().map(|&nm| here.at(nm)).collect())
    }
}

/// The table for kernels whose points lie within `reach_deg` of the line of sight; `None` when it would be more work than it saves or
/// the field is too large.
pub fn table_for(kernels: &[&KernelSpec], projection: &Projection, reach_deg: f64) -> Option<FieldTableSpec> {
    let first = kernels.first()?;
    // The table is of a flat screen across the line of sight.
    if !first.screen.is_frontal() {
        return None;
    }
    let (half_deg, nodes) = FieldTableSpec::field(reach_deg, first.state.pupil_mm)?;
    let spec = FieldTableSpec {
        prescription: first.prescription.clone(),
        state: first.state,
        distance_mm: first.screen.nominal_mm(),
        half_deg,
        nodes,
        stiles_crawford_rho10_per_mm2: first.stiles_crawford_rho10_per_mm2,
    };
    let traced = |kernels: &&KernelSpec| {
        let (from, to) = (kernels.nodes_nm.first()?, kernels.nodes_nm.last()?);
        let spectrum = WavelengthNodes::new(projection.eye(), [*from, *to]).nm().len();
        let points: usize = FieldNodes::count(kernels.field_nodes) as usize;
        Some(points * spectrum.min(kernels.nodes_nm.len()))
    };
    let saved: usize = kernels.iter().filter_map(traced).sum();
    (spec.traced().ok()? < saved).then_some(spec)
}
