//! What a retina is made from: parameters, their allowed ranges, and the errors of this folder.
//!
//! Two scales of angle meet here: retinal degrees (about the centre of the sphere) and visual degrees (about the nodal
//! point). Near the fovea one visual degree is 287 µm on this eye; `visual_deg_per_um` carries that number.

use serde::{Deserialize, Serialize};

/// The method that places the cones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Generator {
    /// Patches of hexagonal lattice, relaxed by the force of §15.2; every tile is a pure function of the parameters.
    #[default]
    Domain,
}

/// Shape of the retina and the place that its cones point at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RetinaGeometry {
    /// Radius of the retinal sphere, µm.
    pub radius_um: f64,
    /// Centre of the exit pupil in the foveal frame, µm: origin at the foveal centre; axes: nasal tangent (+x_um),
    /// superior tangent (+y_um), inward normal (towards the centre of the sphere).
    pub exit_pupil_um: [f64; 3],
    /// Visual degrees per µm of retina near the fovea.
    pub visual_deg_per_um: f64,
    /// Eccentricity of the ora serrata, retinal degrees. No cone lies beyond it.
    pub ora_retinal_deg: f64,
    /// Cone density at the ora on Curcio's scale, cones/mm²; past the data the density runs linearly to it.
    pub ora_density_per_mm2: f64,
}

impl Default for RetinaGeometry {
    /// The eye of Escudero-Sanz and Navarro 1999 with the stop 0.4 mm off the axis (§8, §12): sphere centre (0, 0, 11.9203) mm,
    /// foveal centre (0, 1.43280, 23.83445) mm, exit pupil (0, -0.415, 3.6825) mm, +y temporal on the retina.
    fn default() -> Self {
        Self {
            radius_um: 12_000.0,
            exit_pupil_um: [-571.56, 0.0, 20_228.54],
            visual_deg_per_um: 1.0 / 287.0,
            ora_retinal_deg: 120.0,
            ora_density_per_mm2: 4_000.0,
        }
    }
}

/// Everything that determines a retina.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RetinaParams {
    /// Seed of places, types and pointing; every value is good.
    pub seed: u64,
    /// The method that places the cones.
    pub generator: Generator,
    /// Density at the foveal centre on Curcio's scale, cones/mm², before the factor (11.402/12)² (98,200 to 324,100).
    pub peak_density_per_mm2: f64,
    /// Shares of L, M and S cones; they sum to 1.
    pub cone_ratio: [f64; 3],
    /// Hard core around an S cone free of other S cones, in mean spacings of S cones, 1/sqrt(S density) (0 to 0.52).
    pub s_repulsion: f64,
    /// Standard deviation of the pointing error along each of the two tangents, degrees (0 to 10).
    pub pointing_sd_deg: f64,
    /// Shape of the retina.
    pub geometry: RetinaGeometry,
}

impl Default for RetinaParams {
    fn default() -> Self {
        Self {
            seed: 1,
            generator: Generator::Domain,
            peak_density_per_mm2: 199_000.0,
            cone_ratio: [0.62, 0.30, 0.08],
            s_repulsion: 0.5,
            pointing_sd_deg: 1.0,
            geometry: RetinaGeometry::default(),
        }
    }
}

/// Why a retina cannot be made or read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RetinaError {
    /// A parameter is outside its range.
    #[error("{field} is {value}, allowed are {allowed}")]
    Parameter {
        /// Path of the field, such as `geometry.radius_um`.
        field: &'static str,
        /// The value found.
        value: f64,
        /// The allowed range in words.
        allowed: &'static str,
    },
    /// The tile does not start a block of the tiling (see `tiles_for`).
    #[error("({i}, {j}) is not a tile of the retina")]
    NotATile {
        /// Column.
        i: i32,
        /// Row.
        j: i32,
    },
    /// The halo stayed too thin for an exact result; it does not happen for allowed parameters.
    #[error("the halo of the rectangle at ({x_um} µm, {y_um} µm) is too thin")]
    Halo {
        /// Lower left corner.
        x_um: f64,
        /// Lower left corner.
        y_um: f64,
    },
    /// Stored bytes are not a retina, or are damaged.
    #[error("stored retina: {0}")]
    Bytes(&'static str),
}

/// Refuses values outside `min..=max`, and NaN.
fn check(
    field: &'static str,
    value: f64,
    min: f64,
    max: f64,
    allowed: &'static str,
) -> Result<(), RetinaError> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(RetinaError::Parameter { field, value, allowed }) }
}

impl RetinaParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `RetinaError::Parameter` with the first field out of range, its value and what is allowed.
    pub fn validate(&self) -> Result<(), RetinaError> {
        let [l, m, s] = self.cone_ratio;
        let g = &self.geometry;
        let [px, py, pz] = g.exit_pupil_um;
        check("peak_density_per_mm2", self.peak_density_per_mm2, 98_200.0, 324_100.0, "98200 to 324100")?;
        check("cone_ratio.l", l, 0.0, 1.0, "0 to 1")?;
        check("cone_ratio.m", m, 0.0, 1.0, "0 to 1")?;
        check("cone_ratio.s", s, 0.0, 0.5, "0 to 0.5")?;
        let off = (l + m + s - 1.0).abs();
        if off > 1e-9 {
            let (field, allowed) = ("cone_ratio", "shares that sum to 1");
            return Err(RetinaError::Parameter { field, value: l + m + s, allowed });
        }
        check("s_repulsion", self.s_repulsion, 0.0, 0.52, "0 to 0.52")?;
        check("pointing_sd_deg", self.pointing_sd_deg, 0.0, 10.0, "0 to 10")?;
        check("geometry.radius_um", g.radius_um, 8_000.0, 16_000.0, "8000 to 16000")?;
        check("geometry.exit_pupil_um[0]", px, -4_000.0, 4_000.0, "-4000 to 4000")?;
        check("geometry.exit_pupil_um[1]", py, -4_000.0, 4_000.0, "-4000 to 4000")?;
        let (low, high) = (1.2 * g.radius_um, 1.9 * g.radius_um);
        check("geometry.exit_pupil_um[2]", pz, low, high, "1.2 to 1.9 radii of the sphere")?;
        check("geometry.visual_deg_per_um", g.visual_deg_per_um, 1.0 / 500.0, 1.0 / 150.0, "1/500 to 1/150")?;
        check("geometry.ora_retinal_deg", g.ora_retinal_deg, 60.0, 120.0, "60 to 120")?;
        let (value, allowed) = (g.ora_density_per_mm2, "1000 to 10000");
        check("geometry.ora_density_per_mm2", value, 1_000.0, 10_000.0, allowed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_is_valid_and_nonsense_is_refused_by_name() {
        let good = RetinaParams::default();
        assert_eq!(good.validate(), Ok(()));
        let field = |p: RetinaParams| match p.validate() {
            Err(RetinaError::Parameter { field, .. }) => field,
            _ => "none",
        };
        let peak = |v| field(RetinaParams { peak_density_per_mm2: v, ..RetinaParams::default() });
        assert_eq!(peak(f64::NAN), "peak_density_per_mm2");
        assert_eq!(peak(98_199.0), "peak_density_per_mm2");
        assert_eq!(peak(f64::INFINITY), "peak_density_per_mm2");
        let ratio = |v| field(RetinaParams { cone_ratio: v, ..RetinaParams::default() });
        assert_eq!(ratio([0.6, 0.3, 0.2]), "cone_ratio");
        assert_eq!(ratio([1.3, -0.3, 0.0]), "cone_ratio.l");
        let sd = RetinaParams { pointing_sd_deg: -1.0, ..RetinaParams::default() };
        assert_eq!(field(sd), "pointing_sd_deg");
    }

    /// The foveal frame from the centres in the optical frame (mm, +y temporal, +x down for a right eye).
    #[test]
    fn exit_pupil_of_the_default_eye() {
        let (centre, fovea, pupil) = ((0.0, 11.9203), (1.43280, 23.83445), (-0.415, 3.6825));
        let normal: (f64, f64) = ((centre.0 - fovea.0) / 12.0, (centre.1 - fovea.1) / 12.0);
        let nasal = (normal.1, -normal.0);
        let d = (pupil.0 - fovea.0, pupil.1 - fovea.1);
        let got = RetinaGeometry::default().exit_pupil_um;
        assert!((got[0] - 1e3 * (d.0 * nasal.0 + d.1 * nasal.1)).abs() < 1.0);
        assert!((got[2] - 1e3 * (d.0 * normal.0 + d.1 * normal.1)).abs() < 1.0);
    }
}
