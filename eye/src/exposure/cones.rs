//! The cones of a scene as the display sees them: apertures mapped onto the screen, and each cone's own factors.

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::bounds;
use super::inputs::Inputs;
use crate::display::EmissionLaw;
use crate::experiment::Experiment;
use crate::optics::BeamField;
use crate::plan::setup::setup;
use crate::retina::{ConeType, Retina};

/// One cone.
#[derive(Clone, Debug)]
pub struct MappedCone {
    /// Corners of its aperture, pixels from the window's corner.
    pub polygon_px: Vec<DVec2>,
    /// The place on the retina, µm, to which the chief ray goes from where its light comes.
    pub um: DVec2,
    /// Visual eccentricity, degrees.
    pub ecc_deg: f64,
    /// Its type.
    pub cone_type: ConeType,
    /// Whether it lies at the rim of a measured mosaic or beside a gap.
    pub edge: bool,
    /// Factor from its pointing error.
    pub pointing: f64,
}

/// The columns of the cone table that users get, in the order of the artifact; one value a cone unless said.
#[derive(Clone, Debug, Default)]
pub struct ConeColumns {
    /// Stable number.
    pub id: Vec<u64>,
    /// Centre, µm of arc from the foveal centre: nasal.
    pub x_um: Vec<f64>,
    /// Centre, µm of arc: superior.
    pub y_um: Vec<f64>,
    /// Visual field, degrees, right.
    pub x_deg: Vec<f64>,
    /// Visual field, degrees, up.
    pub y_deg: Vec<f64>,
    /// Visual eccentricity, degrees.
    pub ecc_deg: Vec<f64>,
    /// Retinal meridian, degrees in [0, 360): 0 nasal, 90 superior.
    pub meridian_deg: Vec<f64>,
    /// 0 L, 1 M, 2 S.
    pub cone_type: Vec<u8>,
    /// Light-collecting area, µm².
    pub aperture_um2: Vec<f32>,
    /// Whether it lies at the rim of a measured mosaic or beside a gap.
    pub edge: Vec<bool>,
    /// First corner of each polygon in `polygon_xy`, counted in corners; one more entry than cones.
    pub polygon_start: Vec<u32>,
    /// Corners x, y, absolute, µm.
    pub polygon_xy: Vec<f32>,
}

/// The cone table of an experiment's patch.
///
/// # Errors
/// When the patch does not see the screen.
pub fn cone_columns(experiment: &Experiment, retina: &Retina) -> Result<ConeColumns, String> {
    let projection = setup(experiment).map_err(|e| e.to_string())?.projection;
    let mut columns = ConeColumns {
        id: retina.id.clone(),
        x_um: retina.x_um.clone(),
        y_um: retina.y_um.clone(),
        cone_type: retina.cone_type.iter().map(|t| *t as u8).collect(),
        aperture_um2: retina.aperture_um2.clone(),
        edge: retina.edge.clone(),
        polygon_start: vec![0],
        ..ConeColumns::default()
    };
    if retina.is_empty() {
        return Ok(columns);
    }
    let (min, max) = bounds((0..retina.len()).map(|i| retina.center(i)));
    let fit = projection.fit(min - 1.0, max + 1.0).map_err(|e| e.to_string())?;
    for i in 0..retina.len() {
        let at = retina.center(i);
        let visual = projection.screen().visual_deg(fit.screen_tangent(at));
        columns.x_deg.push(visual.x);
        columns.y_deg.push(visual.y);
        columns.ecc_deg.push(visual.length());
        columns.meridian_deg.push(at.y.atan2(at.x).to_degrees().rem_euclid(360.0));
        for corner in retina.polygon(i) {
            columns.polygon_xy.extend([corner.x as f32, corner.y as f32]);
        }
        columns.polygon_start.push((columns.polygon_xy.len() / 2) as u32);
    }
    Ok(columns)
}

/// All cones of a scene.
#[derive(Clone, Debug)]
pub struct ConeTable {
    /// In the order of the artifact.
    pub cones: Vec<MappedCone>,
}

/// Light that enters the pupil from a point of a screen, over that which a pupil of nominal area gets from a point
/// at the nominal distance that faces the eye.
pub fn entering(law: EmissionLaw, beams: &BeamField, tangent: DVec2) -> f64 {
    law.irradiance(beams.screen(), tangent) * beams.relative(tangent)
}

impl ConeTable {
    /// Maps the cones of a patch.
    ///
    /// # Errors
    /// When a part of the patch does not see the screen.
    pub fn new(inputs: &Inputs) -> Result<Self, String> {
        let Inputs { retina, primaries, projection, scene, pointing, .. } = inputs;
        if retina.is_empty() {
            return Ok(Self { cones: Vec::new() });
        }
        // Behind a large pupil images are displaced: light of a cone at the edge comes from places beyond the patch.
        let centre = |i: usize| DVec2::new(retina.x_um[i], retina.y_um[i]);
        let sources: Vec<(DVec2, DMat2)> =
            (0..retina.len()).into_par_iter().map(|i| primaries.kernels.source_um(centre(i))).collect();
        let corners = (0..retina.len()).flat_map(|i| retina.polygon(i));
        let (min, max) = bounds(corners.chain(sources.iter().map(|(source, _)| *source)));
        let [node_min, node_max] = primaries.kernels.spec().field_um;
        let fit = projection.fit(min.min(node_min), max.max(node_max)).map_err(|e| e.to_string())?;
        let cones = (0..retina.len())
            .into_par_iter()
            .map(|i| {
                let um = centre(i);
                // Across a cone the maps are straight: at 40° its corners are off by 1e-4 of its width. Its place on the screen is
                // the one whose light arrives there; pigments are those of its own eccentricity.
                let (source, slope) = sources[i];
                let (tangent, jacobian) = fit.linear(source);
                let jacobian = jacobian * slope;
                let ecc_deg = projection.screen().eccentricity_deg(fit.linear(um).0);
                let [px, py] = retina.pointing[i];
                MappedCone {
                    polygon_px: retina
                        .polygon(i)
                        .map(|c| scene.window_px(tangent + jacobian * (c - um)))
                        .collect(),
                    um: source,
                    ecc_deg,
                    cone_type: retina.cone_type[i],
                    edge: retina.edge[i],
                    pointing: pointing.as_ref().map_or(1.0, |p| p.factor(f64::from(px).hypot(f64::from(py)))),
                }
            })
            .collect();
        Ok(Self { cones })
    }
}
