//! The cones of a scene as the display sees them: apertures mapped onto the screen, and each cone's own factors.

use glam::DVec2;
use rayon::prelude::*;

use super::kernel::Kernels;
use super::scene::Scene;
use crate::cone::directional::Pointing;
use crate::display::EmissionLaw;
use crate::optics::Projection;
use crate::retina::{ConeType, Retina};

/// One cone.
#[derive(Clone, Debug)]
pub struct MappedCone {
    /// Corners of its aperture, pixels from the window's corner.
    pub polygon_px: Vec<DVec2>,
    /// Centre on the retina, µm.
    pub um: DVec2,
    /// Visual eccentricity, degrees.
    pub ecc_deg: f64,
    /// Its type.
    pub cone_type: ConeType,
    /// Factor from its pointing error.
    pub pointing: f64,
    /// Factor from the slant of screen and pupil, 1 at the gaze centre.
    pub geometry: f64,
}

/// All cones of a scene.
#[derive(Clone, Debug)]
pub struct ConeTable {
    /// In the order of the artifact.
    pub cones: Vec<MappedCone>,
}

/// Share of the light that a point of a flat screen sends into the pupil, relative to the gaze centre: the screen's emission law,
/// the squared distance and the pupil's slant.
pub fn slant_factor(law: EmissionLaw, projection: &Projection, tangent: DVec2) -> f64 {
    let cos2 = 1.0 / (1.0 + tangent.length_squared());
    let emission = match law {
        EmissionLaw::Lambertian => cos2 * cos2.sqrt(),
        EmissionLaw::Uniform => cos2,
    };
    let slant = |t: DVec2| projection.object(t).angle_deg().to_radians().cos();
    emission * slant(tangent) / slant(DVec2::ZERO)
}

impl ConeTable {
    /// Maps the cones of a patch.
    ///
    /// # Errors
    /// When a part of the patch does not see the screen.
    pub fn new(
        retina: &Retina,
        projection: &Projection,
        scene: &Scene,
        kernels: &Kernels,
        law: EmissionLaw,
        pointing: &Pointing,
    ) -> Result<Self, String> {
        let (mut min, mut max) = (DVec2::MAX, DVec2::MIN);
        for i in 0..retina.len() {
            for corner in retina.polygon(i) {
                (min, max) = (min.min(corner), max.max(corner));
            }
        }
        if retina.is_empty() {
            return Ok(Self { cones: Vec::new() });
        }
        let [node_min, node_max] = kernels.spec().field_um;
        let fit = projection.fit(min.min(node_min), max.max(node_max)).map_err(|e| e.to_string())?;
        let cones = (0..retina.len())
            .into_par_iter()
            .map(|i| {
                let um = DVec2::new(retina.x_um[i], retina.y_um[i]);
                let tangent = fit.screen_tangent(um);
                let [px, py] = retina.pointing[i];
                MappedCone {
                    polygon_px: retina.polygon(i).map(|c| scene.window_px(fit.screen_tangent(c))).collect(),
                    um,
                    ecc_deg: tangent.length().atan().to_degrees(),
                    cone_type: retina.cone_type[i],
                    pointing: pointing.factor(f64::from(px).hypot(f64::from(py))),
                    geometry: slant_factor(law, projection, tangent),
                }
            })
            .collect();
        Ok(Self { cones })
    }
}
