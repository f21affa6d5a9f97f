//! What a retina is made from: parameters, their allowed ranges, and the errors of this folder.
//!
//! Two scales of angle meet here: retinal degrees (about the centre of the sphere) and visual degrees (about the nodal
//! point). Near the fovea one visual degree is 287 µm on this eye; `VisualMap` carries that number and what becomes of it farther out.

use serde::{Deserialize, Serialize};

use super::visual::VisualMap;

/// The method that places the cones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Generator {
    /// Patches of hexagonal lattice, relaxed by the force of §15.2; every tile is a pure function of the parameters.
    #[default]
    Domain,
    /// The paper's growth: ring after ring from a seed of seven cones.
    Ring,
}

/// The law of cone density over eccentricity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum DensityLaw {
    /// The four meridians of Curcio et al. 1990.
    #[default]
    Curcio,
    /// Tyler 1997 from 1 to 20 visual degrees and linear to the ora (§13, equation 1), with Curcio's change by meridian.
    Tyler,
}

/// How the corners of cells are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum CellWalls {
    /// A power diagram of limited cells.
    #[default]
    Power,
    /// The paper's averages over groups of mutual neighbours (§15.3); `Generator::Ring` only.
    Averaging,
}

/// Which part of a cell collects light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Aperture {
    /// The whole cell where there are no rods, and less of it beyond, as in the paper.
    #[default]
    Cell,
    /// As much as measured inner segments are wide: 2.3 µm at the centre (Rodieck 1998), 6.2 to 8.4 µm beyond
    /// (Curcio et al. 1990).
    InnerSegment,
}

/// Cones that are lost at random.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dropout {
    /// Share of the cones that is lost (0 to 1).
    pub fraction: f64,
    /// Seed of the choice; every value is good.
    pub seed: u64,
}

/// The hole that the optic nerve leaves: an ellipse without cones, in visual degrees from the foveal centre (nasal, superior).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpticDisc {
    /// Centre.
    pub centre_deg: [f64; 2],
    /// Width and height.
    pub size_deg: [f64; 2],
}

impl Default for OpticDisc {
    /// §15.4: 15° nasal, 2° up, 5° wide, 7° tall.
    fn default() -> Self {
        Self { centre_deg: [15.0, 2.0], size_deg: [5.0, 7.0] }
    }
}

/// Where the centre of the exit pupil is seen from a place of the retina, in the foveal frame: origin at the foveal centre; axes: nasal
/// tangent (+x_um), superior tangent (+y_um), inward normal (towards the centre of the sphere).
///
/// The pupil seen at an angle ψ from the optical axis (about the sphere's centre) is not where the paraxial one is: centre =
/// Σ `at_um[k]`·(1 - cos ψ)^k.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExitPupil {
    /// Unit vector from the centre of the sphere to where the optical axis meets the retina.
    pub axis: [f64; 3],
    /// Coefficients, µm.
    pub at_um: [[f64; 3]; 4],
}

/// Shape of the retina, the place that its cones point at, and the visual field on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RetinaGeometry {
    /// Radius of the retinal sphere, µm.
    pub radius_um: f64,
    /// What the cones point at.
    pub exit_pupil: ExitPupil,
    /// Visual angles of places on the retina.
    pub visual: VisualMap,
    /// Eccentricity of the ora serrata, retinal degrees, mean over the meridians (60 to 120). No cone lies
    /// beyond it.
    pub ora_retinal_deg: f64,
    /// How much nearer the ora is on the nasal side, and farther on the temporal one, as a fraction of its
    /// eccentricity (-0.1 to 0.1); negative: farther on the nasal side.
    pub ora_dip: f64,
    /// Cone density at the ora on Curcio's scale, cones/mm² (1000 to 10,000); past the data the density runs
    /// linearly to it.
    pub ora_density_per_mm2: f64,
}

impl Default for RetinaGeometry {
    /// The eye of Escudero-Sanz and Navarro 1999 with the stop 0.4 mm off the axis (§8, §12), paraxially: sphere centre (0, 0, 11.9203) mm,
    /// foveal centre (0, 1.43280, 23.83445) mm, exit pupil (0, -0.415, 3.6825) mm from everywhere, +y temporal on the retina; one visual
    /// degree is 287 µm everywhere. A traced eye gives better (`plan::setup::retina_geometry`).
    ///
    /// The ora: 111° nasal, 102° above and below, 93° temporal, where the counts of Curcio et al. 1990 end
    /// (112.5°, 102.5° and 97.5°, 92.5°). Her table then integrates to 4.59 million cones where she gives 4.6
    /// (4.08 to 5.29), on 1092 mm² of the 12 mm sphere (ADR 18).
    fn default() -> Self {
        Self {
            radius_um: 12_000.0,
            exit_pupil: ExitPupil {
                axis: [0.119_400, 0.0, -0.992_846],
                at_um: [[-571.56, 0.0, 20_228.54], [0.0; 3], [0.0; 3], [0.0; 3]],
            },
            visual: VisualMap::linear(1.0 / 287.0),
            ora_retinal_deg: 102.0,
            ora_dip: -0.09,
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
    /// The law of density.
    pub density: DensityLaw,
    /// Density at the foveal centre on Curcio's scale, cones/mm², before the factor (11.402/12)² (98,200 to 324,100).
    pub peak_density_per_mm2: f64,
    /// Cones of the whole retina with its optic disc filled; the density beyond the fovea is scaled to reach it (3 to 8 million). `None`: what the law gives.
    pub total_cones: Option<f64>,
    /// Relaxation sub-cycles everywhere (5 to 200); `None`: as living mosaics ask for.
    pub cycles: Option<u32>,
    /// How cells are formed.
    pub cell_walls: CellWalls,
    /// Which part of a cell collects light.
    pub aperture: Aperture,
    /// Shares of L, M and S cones; they sum to 1.
    pub cone_ratio: [f64; 3],
    /// No S cones inside the first eccentricity, and their full share from the second on, visual degrees (§13).
    pub s_ramp_deg: [f64; 2],
    /// Hard core around an S cone free of other S cones, in mean spacings of S cones, 1/sqrt(S density) (0 to 0.52).
    pub s_repulsion: f64,
    /// Standard deviation of the pointing error along each of the two tangents, degrees (0 to 10).
    pub pointing_sd_deg: f64,
    /// Cones lost at random; their places stay empty.
    pub dropout: Option<Dropout>,
    /// The hole of the optic nerve; `None`: cones everywhere.
    pub optic_disc: Option<OpticDisc>,
    /// Shape of the retina.
    pub geometry: RetinaGeometry,
}

impl Default for RetinaParams {
    fn default() -> Self {
        Self {
            seed: 1,
            generator: Generator::Domain,
            density: DensityLaw::Curcio,
            peak_density_per_mm2: 199_000.0,
            total_cones: None,
            cycles: None,
            cell_walls: CellWalls::Power,
            aperture: Aperture::Cell,
            s_ramp_deg: [0.175, 1.5],
            cone_ratio: [0.62, 0.30, 0.08],
            s_repulsion: 0.5,
            pointing_sd_deg: 1.0,
            dropout: None,
            optic_disc: Some(OpticDisc::default()),
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
    /// The ring generator's growth came to a stop; it does not happen for allowed parameters.
    #[error("growth stopped at {rho_um} µm from the foveal centre")]
    Stalled {
        /// Mean eccentricity of the last ring.
        rho_um: f64,
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
        check("peak_density_per_mm2", self.peak_density_per_mm2, 98_200.0, 324_100.0, "98200 to 324100")?;
        check("cone_ratio.l", l, 0.0, 1.0, "0 to 1")?;
        check("cone_ratio.m", m, 0.0, 1.0, "0 to 1")?;
        check("cone_ratio.s", s, 0.0, 1.0, "0 to 1")?;
        // Shares of types sum to 1.
        let off = (l + m + s - 1.0).abs();
        if off > 1e-9 {
            let (field, allowed) = ("cone_ratio", "shares that sum to 1");
            return Err(RetinaError::Parameter { field, value: l + m + s, allowed });
        }
        check("s_repulsion", self.s_repulsion, 0.0, 0.52, "0 to 0.52")?;
        let [from, to] = self.s_ramp_deg;
        check("s_free_deg", from, 0.0, 5.0, "0 to 5")?;
        check("s_full_deg", to, from + 1e-3, 20.0, "more than s_free_deg, at most 20")?;
        if let Some(total) = self.total_cones {
            check("total_cones", total, 3e6, 8e6, "3000000 to 8000000")?;
        }
        if let Some(cycles) = self.cycles {
            check("cycles", f64::from(cycles), 5.0, 200.0, "5 to 200")?;
        }
        if self.cell_walls == CellWalls::Averaging && self.generator != Generator::Ring {
            let allowed = "AVERAGING with the generator RING only";
            return Err(RetinaError::Parameter { field: "cell_walls", value: 1.0, allowed });
        }
        if let Some(dropout) = self.dropout {
            check("dropout.fraction", dropout.fraction, 0.0, 1.0, "0 to 1")?;
        }
        // Places: the optic disc, the sphere, the exit pupil.
        if let Some(disc) = self.optic_disc {
            for value in disc.centre_deg {
                check("optic_disc.centre_deg", value, -90.0, 90.0, "-90 to 90")?;
            }
            for value in disc.size_deg {
                check("optic_disc.size_deg", value, 0.0, 30.0, "0 to 30")?;
            }
        }
        check("pointing_sd_deg", self.pointing_sd_deg, 0.0, 10.0, "0 to 10")?;
        check("geometry.radius_um", g.radius_um, 8_000.0, 16_000.0, "8000 to 16000")?;
        for [px, py, _] in g.exit_pupil.at_um {
            check("geometry.exit_pupil.at_um[..][0]", px, -4_000.0, 4_000.0, "-4000 to 4000")?;
            check("geometry.exit_pupil.at_um[..][1]", py, -4_000.0, 4_000.0, "-4000 to 4000")?;
        }
        let (value, low, high) = (g.exit_pupil.at_um[0][2], 1.2 * g.radius_um, 1.9 * g.radius_um);
        check("geometry.exit_pupil.at_um[0][2]", value, low, high, "1.2 to 1.9 radii of the sphere")?;
        let axis = g.exit_pupil.axis.iter().map(|a| a * a).sum::<f64>();
        check("geometry.exit_pupil.axis", axis, 0.999, 1.001, "a unit vector")?;
        let scale = g.visual.deg_per_um();
        check(
            "geometry.visual",
            scale,
            1.0 / 500.0,
            1.0 / 150.0,
            "1/500 to 1/150 degrees per µm at the fovea",
        )?;
        check("geometry.ora_retinal_deg", g.ora_retinal_deg, 60.0, 120.0, "60 to 120")?;
        check("geometry.ora_dip", g.ora_dip, -0.1, 0.1, "-0.1 to 0.1")?;
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
        let ExitPupil { axis, at_um: [got, ..] } = RetinaGeometry::default().exit_pupil;
        assert!((axis[0] - nasal.1).abs() < 1e-5 && (axis[2] - normal.1).abs() < 1e-5);
        assert!((got[0] - 1e3 * (d.0 * nasal.0 + d.1 * nasal.1)).abs() < 1.0);
        assert!((got[2] - 1e3 * (d.0 * normal.0 + d.1 * normal.1)).abs() < 1.0);
    }
}
