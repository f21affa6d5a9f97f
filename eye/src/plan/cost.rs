//! Predicted cost: CPU seconds by stage and bytes, from the counts that drive them, times a machine's own factors.
//!
//! The constants here and in [`super::engine`] were measured on one core of a 2026 server; [`Machine`] holds a machine against it. The
//! choice of an engine takes the constants alone, so that whoever runs an experiment again gets the same counts.

use serde::{Deserialize, Serialize};

use super::PlannedTile;
use super::engine::IMAGES;
use super::setup::{Setup, UM_PER_TANGENT};
use crate::display::emitters;
use crate::experiment::{Engine, Experiment};
use crate::exposure::audit::Work;
use crate::exposure::padua::FieldNodes;
use crate::exposure::spectral::KINDS;
use crate::exposure::{KernelSpec, PolarShape, TABLE_TOLERANCE, TRANSFER_BLOCK, history};
use crate::retina::{Density, RegionUm, tiles_for};

/// CPU seconds per cone of a mosaic tile, with its halo and cells.
const SECONDS_PER_CONE: f64 = 16e-6;
/// CPU seconds per transfer table (field node x wavelength); per square of the turns of its phase; per
/// sample.
const SECONDS_PER_TRANSFER: f64 = 1.7e-3;
const SECONDS_PER_SQUARE_TURN: f64 = 1.3e-6;
const SECONDS_PER_SAMPLE: f64 = 3.6e-7;
/// CPU seconds and bytes per wavefront of a table at 3 mm.
pub const SECONDS_PER_WAVEFRONT: f64 = 0.2e-3;
pub const BYTES_PER_WAVEFRONT: f64 = 1_500.0;
/// CPU seconds per point spread of an audit by matrix products and by fast transforms: of each, and per
/// sample of its window.
const AUDIT_SPREAD: [f64; 2] = [0.2e-3, 7.5e-8];
const AUDIT_FAST_SPREAD: [f64; 2] = [5e-3, 3.7e-8];
/// Blur by the eye's chromatic aberration in white light (300 nm), unit tangents per mm of pupil; lateral,
/// cycles per cycle of the band at the fovea and per degree of eccentricity.
const CHROMATIC_PER_MM: f64 = 0.5e-3;
const WHITE_NM: f64 = 300.0;
const LATERAL: [f64; 2] = [1.6e-4, 6.2e-5];
/// Spectral modes of the kernels, at most.
const MODES: f64 = 8.0;
/// CPU seconds per pixel of the screen, whose light the budget and the audit sum up: once; of a frame and of
/// its audit for each primary.
const SECONDS_PER_SCREEN_PIXEL: f64 = 1.6e-7;
const SECONDS_PER_PIXEL_LIGHT: f64 = 4e-8;
/// Bytes per pixel of a picture, and of the budget: for all primaries and for each, and of light while it is
/// summed up.
const BYTES_PER_PICTURE_PIXEL: f64 = 12.0;
const BYTES_PER_PIXEL: [f64; 2] = [12.0, 4.0];
/// Bytes of a cone in a tile.
const BYTES_PER_CONE: f64 = 140.0;
/// Bytes of a worker that has done something.
const BASE_BYTES: f64 = 90e6;

/// How slow a machine is against the one of the constants, by stage: factors on predicted seconds, 1 on that machine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// The mosaic.
    pub mosaic: f64,
    /// Optical kernels.
    pub optics: f64,
    /// Making a scene ready.
    pub prepare: f64,
    /// Frames.
    pub frames: f64,
    /// Cones computed again.
    pub audit: f64,
}

impl Default for Machine {
    fn default() -> Self {
        Self { mosaic: 1.0, optics: 1.0, prepare: 1.0, frames: 1.0, audit: 1.0 }
    }
}

impl Machine {
    /// The factors from what stages were predicted to take (without factors) and what they took; a stage without time keeps 1.
    #[must_use]
    pub fn measured(predicted: &Stages, taken: &Stages) -> Self {
        let factor = |of: fn(&Stages) -> f64| {
            let ratio = of(taken) / of(predicted);
            if ratio.is_finite() && ratio > 0.0 { ratio.clamp(0.01, 100.0) } else { 1.0 }
        };
        Self {
            mosaic: factor(|s| s.mosaic),
            optics: factor(|s| s.optics),
            prepare: factor(|s| s.prepare),
            frames: factor(|s| s.frames),
            audit: factor(|s| s.audit),
        }
    }
}

/// CPU seconds by stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stages {
    /// The mosaic.
    pub mosaic: f64,
    /// Optical kernels.
    pub optics: f64,
    /// Making the scenes ready.
    pub prepare: f64,
    /// All frames.
    pub frames: f64,
    /// Cones computed again.
    pub audit: f64,
}

impl Stages {
    /// The sum.
    pub fn total(&self) -> f64 {
        self.mosaic + self.optics + self.prepare + self.frames + self.audit
    }

    /// Adds others.
    pub fn add(&mut self, other: &Self) {
        self.mosaic += other.mosaic;
        self.optics += other.optics;
        self.prepare += other.prepare;
        self.frames += other.frames;
        self.audit += other.audit;
    }
}

/// A prediction.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Cones in the patch.
    pub cones: f64,
    /// CPU seconds.
    pub stages: Stages,
    /// Bytes of the mosaic.
    pub tiles_bytes: f64,
    /// Bytes of the cones.
    pub cones_bytes: f64,
    /// Bytes of the kernels.
    pub kernel_bytes: f64,
    /// Memory, bytes.
    pub bytes: f64,
}

/// Predicts the cost of an experiment without cached artifacts.
pub fn predict(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile], machine: &Machine) -> Cost {
    let cones = cones_in(setup);
    let built = built_cones(setup);
    let (mut optics, mut kernel_bytes, mut build_bytes) = (0.0, 0.0, 0.0_f64);
    let blurs: Vec<Blur> = tiles.iter().map(|tile| Blur::of(experiment, setup, tile)).collect();
    for (PlannedTile { kernels, .. }, blur) in tiles.iter().zip(&blurs) {
        let cost = kernel_cost(experiment, kernels, blur);
        optics += cost.seconds;
        kernel_bytes += cost.bytes;
        build_bytes = build_bytes.max(cost.build_bytes);
    }
    let audit = audit_cost(experiment, tiles, &blurs);
    let parts = tiles.len().max(1) as f64;
    let samples = tiles.iter().map(|t| t.scene.samples.iter().product::<usize>() as f64).sum::<f64>();
    let primaries = super::lit::computed_primaries(experiment) as f64;
    let counting = super::engine::cost(experiment.counts.engine, experiment, setup, tiles, cones);
    let cones_bytes = cones * BYTES_PER_CONE;
    let images_bytes = match experiment.counts.engine {
        Engine::Events => super::engine::table_bytes(experiment, setup, tiles),
        _ => samples * IMAGES * (2.0 * primaries + 4.0) + 4.0 * samples * 16.0,
    };
    // The whole screen counts in the budget, once for all tiles, and in the audit.
    let display = &experiment.display;
    let pixels = f64::from(display.width_px) * f64::from(display.height_px);
    let light = pixels * primaries * SECONDS_PER_PIXEL_LIGHT;
    let earlier = emitters(display).map_or(0, |emitters| history(&emitters, display));
    let pictures = f64::from(earlier.min(experiment.frames.saturating_sub(1)) + 1);
    let screen_bytes = pixels
        * (pictures * BYTES_PER_PICTURE_PIXEL
            + BYTES_PER_PIXEL[0]
            + display.primaries.len() as f64 * BYTES_PER_PIXEL[1]);
    let audited = f64::from(experiment.audit_cones.min(1));
    let stages = Stages {
        mosaic: machine.mosaic * built * SECONDS_PER_CONE,
        optics: machine.optics * optics,
        prepare: machine.prepare * (counting.prepare + pixels * SECONDS_PER_SCREEN_PIXEL),
        frames: machine.frames * f64::from(experiment.frames) * (counting.frame + light),
        audit: machine.audit * (audit.seconds + audited * light),
    };
    Cost {
        cones,
        stages,
        tiles_bytes: built * BYTES_PER_CONE,
        cones_bytes,
        kernel_bytes,
        // A worker keeps two tiles, and builds the kernels of two; or it audits.
        bytes: BASE_BYTES
            + screen_bytes
            + (parts.min(2.0) * build_bytes).max(audit.bytes)
            + 0.85
                * (2.0 * cones_bytes + cones * 900.0 + 3.0 * kernel_bytes + images_bytes)
                * (2.0 / parts).min(1.0),
    }
}

/// What the light to a tile is spread over.
struct Blur {
    /// Radius over all wavelengths, unit tangents.
    tangents: f64,
    /// Distance of wavelengths' images, unit tangents.
    lateral: f64,
}

impl Blur {
    /// From the rays that were traced to choose the band, at a few bright wavelengths.
    fn of(experiment: &Experiment, setup: &Setup, tile: &PlannedTile) -> Self {
        let bright = setup.seen(experiment, &tile.region).map_or(0.0, |seen| seen.blur);
        let white = (range_nm(&tile.kernels.nodes_nm) / WHITE_NM).min(1.0);
        let middle_um = 0.5 * (tile.region.min + tile.region.max);
        let ecc_deg = (middle_um.length() / UM_PER_TANGENT).to_degrees();
        Self {
            tangents: bright.hypot(white * CHROMATIC_PER_MM * experiment.eye.pupil_mm),
            lateral: white * (LATERAL[0] + LATERAL[1] * ecc_deg),
        }
    }
}

fn range_nm(nodes: &[f64]) -> f64 {
    nodes.last().unwrap_or(&0.0) - nodes.first().unwrap_or(&0.0)
}

/// CPU seconds and bytes of an audit.
struct AuditCost {
    seconds: f64,
    bytes: f64,
}

/// The audit: the point spreads of each cone and of source points beside it.
fn audit_cost(experiment: &Experiment, tiles: &[PlannedTile], blurs: &[Blur]) -> AuditCost {
    let tangents = blurs.iter().map(|blur| blur.tangents).sum::<f64>() / blurs.len().max(1) as f64;
    // The spot, and diffraction of light of 550 nm and 450 nm, µm.
    let spot_um = 1.08 * UM_PER_TANGENT * tangents;
    let pupil_mm = experiment.eye.pupil_mm;
    let widths_um = [550.0, 450.0].map(|nm| 1e-6 * nm * UM_PER_TANGENT / pupil_mm);
    let work = Work::new(pupil_mm, spot_um, tangents, widths_um);
    let nodes = tiles.first().map_or(&[][..], |t| t.kernels.nodes_nm.as_slice());
    let waves = (range_nm(nodes) / work.step_nm + 1.0).min(nodes.len() as f64 * 1.5);
    let [each, sample] = if work.fast { AUDIT_FAST_SPREAD } else { AUDIT_SPREAD };
    let (beside, samples) = (work.beside as f64, (work.samples * work.samples) as f64);
    let spreads = waves * (1.0 + beside / work.sparse as f64);
    let primaries = super::lit::computed_primaries(experiment).max(1) as f64;
    let cones = f64::from(experiment.audit_cones);
    AuditCost {
        seconds: cones * spreads * (each + sample * samples),
        // Sums by primary, four point spreads and their transforms.
        bytes: cones.min(1.0) * samples * 8.0 * (primaries * (2.0 + beside) + 12.0),
    }
}

/// What the kernels of one tile cost.
struct KernelCost {
    seconds: f64,
    /// Of the artifact, and while it is built.
    bytes: f64,
    build_bytes: f64,
}

/// CPU seconds and bytes of the kernels of one tile.
fn kernel_cost(experiment: &Experiment, kernels: &KernelSpec, blur: &Blur) -> KernelCost {
    let cycles = [blur.tangents, blur.lateral].map(|extent| kernels.band * extent);
    let shape = PolarShape::for_cycles(kernels.band, cycles, TABLE_TOLERANCE * kernels.tolerance);
    let points = f64::from(FieldNodes::count(kernels.field_nodes));
    let transfers = points * kernels.nodes_nm.len() as f64;
    // Turns of the phase over a pupil of mm, at 550 nm.
    let turns = blur.tangents * experiment.eye.pupil_mm * 1e-3 / 550e-9;
    let one = SECONDS_PER_TRANSFER
        + SECONDS_PER_SQUARE_TURN * turns * turns
        + SECONDS_PER_SAMPLE * shape.len() as f64;
    let (primaries, table) = (kernels.primaries.len() as f64, shape.len() as f64 * 16.0);
    // Some tables at a time; one a mode, place and primary, and what is collected of one mode.
    let modes = (KINDS.len() as f64 * f64::from(kernels.ecc_nodes)).min(MODES);
    KernelCost {
        seconds: transfers * one,
        bytes: IMAGES * primaries * table,
        build_bytes: table * ((modes + 1.5) * points * primaries + transfers.min(TRANSFER_BLOCK as f64)),
    }
}

/// Cones of the mosaic's tiles, which are whole.
fn built_cones(setup: &Setup) -> f64 {
    if setup.mosaic.is_some() {
        return 0.0;
    }
    let target = Density::new(&setup.retina);
    let of_tile = |tile: &crate::retina::TileId| {
        let Some(region) = tile.region() else { return 0.0 };
        mean_density(&target, &region, 6) * (region.max - region.min).element_product() * 1e-6
    };
    tiles_for(&setup.region).iter().map(of_tile).sum()
}

/// Cones in the patch: the target density summed over a grid of 40 x 40 points.
pub(super) fn cones_in(setup: &Setup) -> f64 {
    let size = setup.region.max - setup.region.min;
    mean_density(&Density::new(&setup.retina), &setup.region, 40) * size.element_product() * 1e-6
}

/// Mean over steps x steps points, 1/mm².
fn mean_density(target: &Density, region: &RegionUm, steps: u32) -> f64 {
    let mut density = 0.0;
    for (i, j) in (0..steps).flat_map(|i| (0..steps).map(move |j| (i, j))) {
        let part = glam::DVec2::new(f64::from(i) + 0.5, f64::from(j) + 0.5) / f64::from(steps);
        density += target.per_mm2(region.min + (region.max - region.min) * part);
    }
    density / f64::from(steps * steps)
}
