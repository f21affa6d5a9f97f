//! From an experiment to the geometry of its scene: focused eye, screen, patch of retina, window and grid.
//!
//! Both the planner and the engines call this, so a plan says what is run.

use std::sync::OnceLock;

use glam::{DVec2, DVec3};

use super::band::{Moduli, band};
use super::focus::{focused_eye, relaxed};
use super::{Numerics, PlanError, Rule};
use crate::display::Placement;
use crate::experiment::{Engine, Experiment, MAX_REGION_DEG, RangeError};
use crate::exposure::scene::{MAX_GRID, Scene, SceneNeeds};
use crate::movement::Gaze;
use crate::optics::{EyeState, FieldFit, Fixation, Prescription, Projection, SchematicEye, ScreenPose};
use crate::retina::{ConeType, RegionUm, RetinaGeometry, RetinaParams};

/// Retina beyond the picture's edge that is simulated because the picture's blur falls on it, µm.
pub(super) const MARGIN_UM: f64 = 75.0;
/// What is simulated beyond that when cones outside are not left out, µm.
const WIDE_UM: f64 = 300.0;
/// µm of retina per unit tangent at the fovea, for distances that need no better.
pub(super) const UM_PER_TANGENT: f64 = 16_440.0;
/// Distance in blurs that a copy keeps beside the guard: rays of wavelengths that are not traced land farther, and the law of the tail holds
/// far from the blur's edge only. 5 dioptres off focus 1.0 and 1.3 left an L1 of 1.2e-3 and 1.1e-3 at a target of 1e-3.
const BLUR: f64 = 2.0;
/// Largest patch that is one tile, µm (6 visual degrees and the picture's blur), and largest tile of a larger one.
const MAX_SINGLE_UM: f64 = 1_950.0;
const TILE_UM: f64 = 1_100.0;

/// The geometry of a scene.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The eye's data.
    pub prescription: Prescription,
    /// Pupil, focus, dispersion.
    pub state: EyeState,
    /// The screen before the focused eye.
    pub projection: Projection,
    /// Eye movement as the fovea sees it.
    pub gaze: Gaze,
    /// Largest angle that a unit of the screen subtends in the patch, radians about, and at least 1.
    widest: f64,
    /// The patch of retina.
    pub region: RegionUm,
    /// The parts of the patch that are computed one by one, row by row: result tiles.
    pub tiles: Vec<RegionUm>,
    /// The mosaic's parameters.
    pub retina: RetinaParams,
    /// Digest of the table of measured cones, if they take the mosaic's place, and the type of cones that
    /// were not classified.
    pub mosaic: Option<(String, Option<ConeType>)>,
    /// Distance between a cone and the nearest copy of the picture, beyond what the blur asks, µm.
    pub guard_um: f64,
    /// The transfer over the patch, traced when it is asked for.
    pub(super) moduli: OnceLock<Result<Moduli, String>>,
}

/// The geometry of an experiment's scene.
///
/// # Errors
/// When the optics refuse, the eye turns too far, or the scene is larger than what is served; the error names the field.
pub fn setup(experiment: &Experiment) -> Result<Setup, PlanError> {
    let (prescription, state) = focused_eye(experiment)?;
    let model = |e: crate::optics::OpticsError| PlanError::Model(e.to_string());
    let eye = SchematicEye::new(&prescription, &state).map_err(model)?;
    let fixation = fixation_of(experiment, &eye)?;
    let projection = Projection::of(&eye, fixation.screen).map_err(model)?;
    let gaze = gaze(experiment, &fixation)?;
    let region = region(experiment, &projection, gaze.bounds())?;
    let widest = widest(&projection, &region)?;
    let guard_um = Numerics::new(experiment).guard_um;
    let tiles = tiles(&region);
    if tiles.len() > 1 && experiment.counts.engine == Engine::Paper {
        let side = region.max - region.min;
        let value = format!("a patch of {:.0} x {:.0} µm", side.x, side.y);
        let allowed = format!("at most {MAX_SINGLE_UM} µm a side with counts.engine PAPER");
        return Err(RangeError::new("retina.region_deg", value, &allowed).into());
    }
    let retina = retina_params(experiment, &prescription, &state)?;
    let mosaic = experiment.retina.mosaic.clone().map(|table| (table, experiment.retina.mosaic_type_unknown));
    Ok(Setup {
        prescription,
        state,
        projection,
        gaze,
        widest,
        region,
        tiles,
        retina,
        mosaic,
        guard_um,
        moduli: OnceLock::new(),
    })
}

/// Largest turn of the eye from straight ahead, degrees.
const MOST_TURNED_DEG: f64 = 45.0;

/// The eye of an experiment as it fixates the gaze centre.
///
/// # Errors
/// When the optics refuse, or the eye cannot look there; the error names the field.
pub fn fixation(experiment: &Experiment) -> Result<Fixation, PlanError> {
    let eye = &experiment.eye;
    let model = |e: crate::optics::OpticsError| PlanError::Model(e.to_string());
    let prescription = eye.prescription().map_err(model)?;
    fixation_of(experiment, &SchematicEye::new(&prescription, &relaxed(experiment)).map_err(model)?)
}

fn fixation_of(experiment: &Experiment, eye: &SchematicEye) -> Result<Fixation, PlanError> {
    let (display, [x, y]) = (&experiment.display, experiment.gaze.center_px);
    let Placement::Fixed { eye_at_px, tilt_deg, turn_deg, curvature_radius_cm } = display.placement else {
        return Ok(Fixation::frontal(eye, 10.0 * display.distance_cm));
    };
    let curvature_per_mm = curvature_radius_cm.map_or(0.0, |radius_cm| 0.1 / radius_cm);
    let pose = ScreenPose { distance_mm: 10.0 * display.distance_cm, tilt_deg, turn_deg, curvature_per_mm };
    let found = Fixation::new(eye, &pose, display.offset_mm([x, y]));
    let refused = |seen: String| {
        let allowed = format!(
            "a point at most {MOST_TURNED_DEG}° from straight ahead, which is [{}, {}] (display.eye_at_px){seen}; display.placement              FRONTAL has the screen face the eye at every gaze",
            eye_at_px[0], eye_at_px[1]
        );
        RangeError::new("gaze.center_px", format!("[{x}, {y}]"), &allowed)
    };
    let Some(fixation) = found else {
        return Err(refused(", and before the screen".into()).into());
    };
    if fixation.turned_deg() > MOST_TURNED_DEG {
        return Err(refused(format!(", here it is {:.1}°", fixation.turned_deg())).into());
    }
    Ok(fixation)
}

/// The movement of an experiment's eye.
///
/// # Errors
/// When the eye turns too far or moves more than is served; the error names the field.
pub fn gaze(experiment: &Experiment, fixation: &Fixation) -> Result<Gaze, PlanError> {
    let frame_s = 1.0 / experiment.display.frame_rate_hz;
    Ok(Gaze::new(&experiment.gaze, fixation, experiment.frames, frame_s)?)
}

/// Retina beyond a tile that its kernels look at, µm.
const BESIDE_UM: f64 = 200.0;

impl Setup {
    /// Largest angle along the screen's axes from the line of sight to what the kernels of the patch look at, degrees; `None` when a part
    /// of that sees no screen.
    pub(super) fn reach_deg(&self) -> Option<f64> {
        let beside = RegionUm { min: self.region.min - BESIDE_UM, max: self.region.max + BESIDE_UM };
        let [min, max] = screen_bounds(&self.projection, &beside).ok()?;
        Some(min.abs().max(max.abs()).max_element().atan().to_degrees())
    }

    /// The movement as the middle of a tile sees it.
    ///
    /// # Errors
    /// When the middle sees no screen.
    pub fn gaze_of(&self, tile: &RegionUm) -> Result<Gaze, PlanError> {
        self.gaze_at(0.5 * (tile.min + tile.max)).map_err(PlanError::Model)
    }

    /// The movement as a place of the retina sees it (µm).
    ///
    /// # Errors
    /// When the place sees no screen.
    pub fn gaze_at(&self, um: DVec2) -> Result<Gaze, String> {
        if self.gaze.is_still() {
            return Ok(self.gaze.clone());
        }
        let tangent = self.projection.screen_tangent(um).map_err(|e| e.to_string())?;
        Ok(self.gaze.seen_along(self.projection.line_to(tangent)))
    }

    /// Highest frequency of the eye at the shortest wavelength, cycles per unit of the screen; 5 % above pupil over
    /// wavelength, because the pupil seen from the field is not exactly round.
    pub(super) fn cutoff(&self, experiment: &Experiment) -> f64 {
        1.05 * experiment.eye.pupil_mm * 1e6 / crate::spectrum::MIN_NM * self.widest
    }

    /// Fewest µm of retina per unit of the screen in a tile, about; across the line of sight that of the fovea.
    fn least_um_per_tangent(&self, tile: &RegionUm) -> Result<f64, PlanError> {
        if self.projection.screen().is_frontal() {
            return Ok(UM_PER_TANGENT);
        }
        let mut least = UM_PER_TANGENT;
        for um in edge_points([tile.min, tile.max], 2) {
            let map = |e: crate::optics::OpticsError| PlanError::Model(e.to_string());
            let tangent = self.projection.screen_tangent(um).map_err(map)?;
            let jacobian = self.projection.jacobian_um_per_tangent(tangent).map_err(map)?;
            let longer = jacobian.x_axis.length().max(jacobian.y_axis.length());
            least = least.min(jacobian.determinant().abs() / longer);
        }
        Ok(least)
    }

    /// Window and grid of a result tile. A tile is imaged with all light that comes near its cones, wherever it is on the screen: tiles
    /// need no light from each other.
    ///
    /// # Errors
    /// When the tile sees no screen or its grid is larger than what is served.
    pub fn scene(&self, experiment: &Experiment, tile: &RegionUm) -> Result<Scene, PlanError> {
        let seen = self.seen(experiment, tile)?;
        let needs = SceneNeeds {
            centre_px: DVec2::from_array(experiment.gaze.center_px),
            cones: screen_bounds(&self.projection, tile)?,
            sight: self.gaze_of(tile)?.bounds(),
            guard: self.guard_um / self.least_um_per_tangent(tile)?,
            blur: BLUR * seen.blur,
            band: band(experiment, self, tile, &seen),
            oversampling: Numerics::new(experiment).oversampling,
        };
        Scene::new(&experiment.display, &needs).map_err(|samples| {
            let allowed = format!("a scene of at most {MAX_GRID} grid samples a side, here it would be {samples}; give a smaller retina.region_deg or less movement");
            RangeError::new("retina.region_deg", "the scene", &allowed).into()
        })
    }
}

/// A patch in tiles: whole when it is small, else in equal parts of at most [`TILE_UM`] a side.
fn tiles(region: &RegionUm) -> Vec<RegionUm> {
    let size = region.max - region.min;
    if size.max_element() <= MAX_SINGLE_UM {
        return vec![*region];
    }
    let parts = (size / TILE_UM).ceil().max(DVec2::ONE);
    let (columns, rows) = (parts.x as u32, parts.y as u32);
    // The same expression for both sides of a seam, so that no cone is lost or counted twice.
    let seam = |from: f64, to: f64, i: u32, n: u32| {
        if i == n { to } else { from + (to - from) * f64::from(i) / f64::from(n) }
    };
    let corner = |i, j| {
        let (min, max) = (region.min, region.max);
        DVec2::new(seam(min.x, max.x, i, columns), seam(min.y, max.y, j, rows))
    };
    (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i, j)))
        .map(|(i, j)| RegionUm { min: corner(i, j), max: corner(i + 1, j + 1) })
        .collect()
}

fn retina_params(
    experiment: &Experiment,
    prescription: &Prescription,
    state: &EyeState,
) -> Result<RetinaParams, PlanError> {
    let geometry = retina_geometry(prescription, state)?;
    let params = experiment.retina.params(experiment.eye.pointing_sd_deg, geometry);
    params.validate().map_err(|e| PlanError::Model(e.to_string()))?;
    Ok(params)
}

/// The retina's shape, what its cones aim at and the visual field on it, from chief rays of the unaccommodated eye: a mosaic depends on
/// no display and no focus. Rounded (nm; 1e-6 degrees), so that the key of a mosaic does not hang on the last bits of a trace. 4 ms.
///
/// # Errors
/// When the optics refuse; the error names the field.
pub fn retina_geometry(prescription: &Prescription, state: &EyeState) -> Result<RetinaGeometry, PlanError> {
    let model = |e: crate::optics::OpticsError| PlanError::Model(e.to_string());
    let relaxed = EyeState { accommodation_a: 0.0, ..*state };
    let eye = SchematicEye::new(prescription, &relaxed).map_err(model)?;
    let FieldFit { visual, exit_pupil } = FieldFit::new(&eye).map_err(model)?;
    let radius_um = (eye.fovea().radius_mm * 1e6).round() / 1e3;
    Ok(RetinaGeometry { radius_um, exit_pupil, visual, ..RetinaGeometry::default() })
}

/// The patch of retina: fixed by the experiment, or what the picture, its blur and the movement cover.
fn region(
    experiment: &Experiment,
    projection: &Projection,
    sight: [DVec2; 2],
) -> Result<RegionUm, PlanError> {
    let tangent = |deg: f64| deg.to_radians().tan();
    let screen = projection.screen();
    // Points on the edge of the patch, in units of the screen.
    let (edge, margin) = if let Some([x0, x1, y0, y1]) = experiment.retina.region_deg {
        let corners = [DVec2::new(tangent(x0), tangent(y0)), DVec2::new(tangent(x1), tangent(y1))];
        let on_screen = |way: DVec2| screen.met_by(DVec3::ZERO, way.extend(-1.0));
        let edge: Option<Vec<DVec2>> = edge_points(corners, 4).into_iter().map(on_screen).collect();
        let Some(edge) = edge else {
            let value = format!("{x0} to {x1}, {y0} to {y1}");
            let allowed = "directions in which the screen's plane lies before the eye";
            return Err(RangeError::new("retina.region_deg", value, allowed).into());
        };
        (edge, 0.0)
    } else {
        let display = &experiment.display;
        let per_px = display.pixel_pitch_cm / display.distance_cm;
        let size = DVec2::new(f64::from(display.width_px), f64::from(display.height_px));
        let centre = DVec2::from_array(experiment.gaze.center_px);
        let (from, to) = (-centre * per_px, (size - centre) * per_px);
        let picture = [DVec2::new(from.x, -to.y) - sight[1], DVec2::new(to.x, -from.y) - sight[0]];
        let wide = if Rule::ConesOutside.applies(experiment) { 0.0 } else { WIDE_UM };
        (edge_points(picture, 4), MARGIN_UM + wide)
    };
    // Along each axis, as `retina.region_deg` is given.
    let reach_deg = |t: &DVec2| {
        let way = screen.way(*t);
        (way.truncate().abs().max_element()).atan2(-way.z).to_degrees()
    };
    let extent_deg = edge.iter().map(reach_deg).fold(0.0, f64::max);
    if extent_deg > MAX_REGION_DEG + 1e-9 {
        let allowed = format!(
            "within {MAX_REGION_DEG}° of the gaze centre; here the picture with its movement reaches {extent_deg:.2}°, give retina.region_deg"
        );
        return Err(RangeError::new("retina.region_deg", "the picture", &allowed).into());
    }
    let (mut min, mut max) = (DVec2::MAX, DVec2::MIN);
    for t in edge {
        let um = projection.retina_um(t, 543.0).map_err(|e| PlanError::Model(e.to_string()))?;
        (min, max) = (min.min(um), max.max(um));
    }
    Ok(RegionUm { min: min - margin, max: max + margin })
}

/// Largest angle that a unit of the screen subtends in a patch, radians about, and at least 1.
fn widest(projection: &Projection, region: &RegionUm) -> Result<f64, PlanError> {
    let mut widest = 1.0;
    if !projection.screen().is_frontal() {
        for um in edge_points([region.min, region.max], 4) {
            let t = projection.screen_tangent(um).map_err(|e| PlanError::Model(e.to_string()))?;
            widest = f64::max(widest, projection.screen().nearness(t).sqrt());
        }
    }
    Ok(widest)
}

/// Rectangle of the screen that holds everything imaged on a patch and on the apertures that stick out of it.
fn screen_bounds(projection: &Projection, region: &RegionUm) -> Result<[DVec2; 2], PlanError> {
    // Apertures stick out by 8 µm, and an edge of a tile is bent by 12.
    const BEYOND_UM: f64 = 24.0;
    let (mut min, mut max) = (DVec2::MAX, DVec2::MIN);
    for um in edge_points([region.min - BEYOND_UM, region.max + BEYOND_UM], 1) {
        let t = projection.screen_tangent(um).map_err(|e| PlanError::Model(e.to_string()))?;
        (min, max) = (min.min(t), max.max(t));
    }
    Ok([min, max])
}

/// Corners of a rectangle and points on its edges between, `steps` parts an edge.
fn edge_points([a, b]: [DVec2; 2], steps: u32) -> Vec<DVec2> {
    let corners = [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y)];
    let edge = |k: usize| (0..steps).map(move |i| (k, f64::from(i) / f64::from(steps)));
    (0..4).flat_map(edge).map(|(k, t)| corners[k].lerp(corners[(k + 1) % 4], t)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_a_patch_once() {
        let region = RegionUm { min: DVec2::new(-4000.3, -2000.1), max: DVec2::new(3999.9, 1234.5) };
        let tiles = tiles(&region);
        assert_eq!(tiles.len(), 8 * 3);
        for i in 0..5000 {
            let part = DVec2::new(f64::from(i) * 0.618_034 % 1.0, f64::from(i) * 0.754_877 % 1.0);
            let at = region.min + part * (region.max - region.min);
            assert_eq!(tiles.iter().filter(|t| t.contains(at)).count(), 1, "{at}");
        }
        // Seams are the same number on both sides.
        for tile in &tiles {
            let right = tiles.iter().filter(|t| t.min.x.to_bits() == tile.max.x.to_bits()).count();
            assert!(right == 3 || tile.max.x.to_bits() == region.max.x.to_bits(), "{tile:?}");
        }
    }

    fn traced(decentre_mm: f64, accommodation_a: f64, side: crate::optics::Side) -> RetinaGeometry {
        let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
        let dispersion = crate::optics::Dispersion::Herzberger;
        retina_geometry(
            &prescription,
            &EyeState { pupil_mm: 3.0, decentre_mm, accommodation_a, dispersion, side },
        )
        .unwrap()
    }

    /// The traced geometry of the default eye is the one that the mosaic has as its default: the paraxial exit pupil, to 5 µm across
    /// the ray to the fovea; along it, where it moves no cone, to 10 µm.
    #[test]
    fn the_retina_aims_at_the_traced_exit_pupil() {
        use crate::optics::Side;
        for side in [Side::Right, Side::Left] {
            let traced = traced(0.4, 2.0, side);
            let default = RetinaGeometry::default();
            for (axis, tolerance_um) in [5.0, 5.0, 10.0].into_iter().enumerate() {
                let gap = traced.exit_pupil.at_um[0][axis] - default.exit_pupil.at_um[0][axis];
                assert!(gap.abs() < tolerance_um, "{:?}", traced.exit_pupil);
                let gap = traced.exit_pupil.axis[axis] - default.exit_pupil.axis[axis];
                assert!(gap.abs() < 1e-5, "{:?}", traced.exit_pupil);
            }
            assert!((traced.visual.deg_per_um() * 287.0 - 1.0).abs() < 0.01, "{:?}", traced.visual);
        }
    }

    /// Both eyes have one geometry, focus does not change it, and it is one that a mosaic can be made from, for every decentre.
    #[test]
    fn the_geometry_is_that_of_either_eye_and_is_allowed() {
        use crate::optics::Side;
        assert_eq!(traced(0.4, 0.0, Side::Right), traced(0.4, 3.0, Side::Left));
        for decentre in [-1.0, -0.5, 0.0, 0.4, 1.0] {
            let geometry = traced(decentre, 0.0, Side::Right);
            let params = RetinaParams { geometry, ..RetinaParams::default() };
            assert_eq!(params.validate(), Ok(()), "{decentre}");
        }
    }

    /// Tilt of the cones: 11° at 20 visual degrees, about 43° at the ora (mean over the meridians 41.4°).
    #[test]
    fn tilts_of_the_traced_geometry() {
        let g = traced(0.4, 0.0, crate::optics::Side::Right);
        let mean = |um: f64| {
            (0..8)
                .map(|k| DVec2::from_angle(f64::from(k) * std::f64::consts::FRAC_PI_4) * um)
                .map(|at| crate::retina::local(&g, at).cos_tilt.acos().to_degrees())
                .sum::<f64>()
                / 8.0
        };
        let (at_20, at_ora) =
            (mean(27.2_f64.to_radians() * 12_000.0), mean(120.0_f64.to_radians() * 12_000.0));
        assert!((at_20 - 11.0).abs() < 0.5 && (at_ora - 42.0).abs() < 1.0, "{at_20} {at_ora}");
    }
}
