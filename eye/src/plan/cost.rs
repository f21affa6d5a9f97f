//! Predicted cost: CPU seconds and bytes from the counts that drive them. Constants were measured on one core of a 2026 server.

use super::PlannedTile;
use super::engine::IMAGES;
use super::setup::Setup;
use crate::experiment::Experiment;
use crate::exposure::{KernelSpec, PolarShape};
use crate::retina::Density;

/// CPU seconds per cone built, mosaic and cells.
const SECONDS_PER_CONE: f64 = 11e-6;
/// CPU seconds per transfer table (field node x wavelength) at 3 mm.
const SECONDS_PER_TRANSFER: f64 = 2.5e-3;
/// CPU seconds and bytes per wavefront of a table at 3 mm.
pub const SECONDS_PER_WAVEFRONT: f64 = 0.2e-3;
pub const BYTES_PER_WAVEFRONT: f64 = 1_500.0;
/// A prediction.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Cones in the patch.
    pub cones: f64,
    /// CPU seconds for the mosaic.
    pub tiles_seconds: f64,
    /// Bytes of the mosaic.
    pub tiles_bytes: f64,
    /// Bytes of the cones.
    pub cones_bytes: f64,
    /// CPU seconds for the kernels.
    pub kernel_seconds: f64,
    /// Bytes of the kernels.
    pub kernel_bytes: f64,
    /// CPU seconds of everything.
    pub seconds: f64,
    /// Memory, bytes.
    pub bytes: f64,
}

/// Predicts the cost of an experiment without cached artifacts.
pub fn predict(experiment: &Experiment, setup: &Setup, tiles: &[PlannedTile]) -> Cost {
    let cones = cones_in(setup);
    let size = setup.region.max - setup.region.min;
    // Tiles are whole: the mosaic is built out to their edges and a halo beyond.
    let tiles_share = (size.x + 256.0) * (size.y + 256.0) / (size.x * size.y).max(1.0);
    let tiles_seconds = cones * tiles_share * SECONDS_PER_CONE;
    let mut kernel_seconds = 0.0;
    let mut kernel_bytes = 0.0;
    for PlannedTile { kernels, .. } in tiles {
        let (seconds, bytes) = kernel_cost(experiment, kernels);
        kernel_seconds += seconds;
        kernel_bytes += bytes;
    }
    let parts = tiles.len().max(1) as f64;
    let samples = tiles.iter().map(|t| t.scene.samples.iter().product::<usize>() as f64).sum::<f64>();
    let primaries = experiment.display.primaries.len() as f64;
    let counting = super::engine::cost(experiment.counts.engine, experiment, setup, tiles, cones);
    let cones_bytes = cones * 140.0;
    let images_bytes = samples * IMAGES * (2.0 * primaries + 4.0) + 4.0 * samples * 16.0;
    Cost {
        cones,
        tiles_seconds,
        tiles_bytes: cones_bytes * tiles_share,
        cones_bytes,
        kernel_seconds,
        kernel_bytes,
        seconds: tiles_seconds + kernel_seconds + counting.seconds(experiment.frames),
        // A worker keeps two tiles.
        bytes: 60e6
            + (2.0 * cones_bytes * tiles_share + cones * 900.0 + 3.0 * kernel_bytes + images_bytes)
                * (2.0 / parts).min(1.0),
    }
}

/// CPU seconds and bytes of the kernels of one tile. Measured: a wavefront's transfer is 2 ms at 3 mm and grows with its spread,
/// that is with the third power of the pupil, squared.
fn kernel_cost(experiment: &Experiment, kernels: &KernelSpec) -> (f64, f64) {
    let pupil = (experiment.eye.pupil_mm / 3.0).max(0.5);
    let cycles = 1e-4 * kernels.band * pupil.powi(3);
    let shape = PolarShape::for_cycles(kernels.band, [cycles, 2.0], kernels.tolerance);
    let transfers =
        f64::from(kernels.field_nodes[0] * kernels.field_nodes[1]) * kernels.nodes_nm.len() as f64;
    let seconds =
        transfers * (SECONDS_PER_TRANSFER * (1.0 + 0.05 * pupil.powi(6)) + 1e-7 * shape.len() as f64);
    (seconds, IMAGES * kernels.primaries.len() as f64 * shape.len() as f64 * 16.0)
}

/// Cones in the patch: the target density summed over a grid of 40 x 40 points.
pub(super) fn cones_in(setup: &Setup) -> f64 {
    const STEPS: u32 = 40;
    let target = Density::new(&setup.retina);
    let size = setup.region.max - setup.region.min;
    let mut density = 0.0;
    for i in 0..STEPS {
        for j in 0..STEPS {
            let part = glam::DVec2::new(f64::from(i) + 0.5, f64::from(j) + 0.5) / f64::from(STEPS);
            let at = setup.region.min + size * part;
            density += target.per_mm2(at);
        }
    }
    density / f64::from(STEPS * STEPS) * size.x * size.y * 1e-6
}
