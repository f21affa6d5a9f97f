//! One figure's experiment, run: counts of every frame, the cones, and what an observer sees in them.

use std::collections::BTreeMap;

use glam::DVec2;
use photoneye_eye::artifact::Input;
use photoneye_eye::digest::Digest;
use photoneye_eye::experiment::Experiment;
use photoneye_eye::exposure::{ConeColumns, Exposure, FrameCounts, cone_columns};
use photoneye_eye::movement::Gaze;
use photoneye_eye::picture::{ConeShapes, RgbImage, View};
use photoneye_eye::plan::plan;
use photoneye_eye::plan::setup::{fixation, gaze};
use photoneye_eye::retina::Retina;
use photoneye_eye::video::Picture;
use photoneye_eye::video::reader::{Cones, Seen, Signal, signals};
use serde_json::Value;

use super::super::scene::experiment;
use super::degrees;

/// A figure.
pub struct Figure {
    /// What was asked.
    pub experiment: Experiment,
    columns: ConeColumns,
    counts: Vec<Vec<f64>>,
    gaze: Gaze,
}

impl Figure {
    /// Runs an experiment of one result tile; `picture` is shown in all frames, or its drawn pattern.
    ///
    /// # Errors
    /// What the planner or the model refuses.
    pub fn new(spec: Value, picture: Option<Picture>) -> Result<Self, String> {
        let experiment = experiment(&spec)?;
        let plan = plan(&experiment).map_err(|e| e.to_string())?;
        let mut built: BTreeMap<Digest, Vec<u8>> = BTreeMap::new();
        for artifact in &plan.artifacts {
            let inputs: Vec<Input> = artifact.inputs.iter().map(|k| (*k, built[k].as_slice())).collect();
            let bytes = artifact.spec.build(&inputs).map_err(|e| e.to_string())?.bytes;
            built.insert(artifact.key, bytes);
        }
        let keys = plan.tile_artifacts.first().ok_or("the plan has no tile")?;
        let artifacts: Vec<&Vec<u8>> = keys.iter().map(|key| &built[key]).collect();
        let retina = Retina::from_bytes(artifacts[0]).map_err(|e| e.to_string())?;
        let columns = cone_columns(&experiment, &retina)?;
        let exposure = Exposure::new(&experiment, &artifacts).map_err(|e| e.to_string())?;
        let mut counts = Vec::new();
        for index in 0..experiment.frames {
            let frame = exposure.frame(index, picture.as_ref()).map_err(|e| e.to_string())?;
            counts.push(match frame.counts {
                FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).collect(),
                FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
            });
        }
        let fixation = fixation(&experiment).map_err(|e| e.to_string())?;
        let gaze = gaze(&experiment, &fixation).map_err(|e| e.to_string())?;
        Ok(Self { experiment, columns, counts, gaze })
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.counts.len()
    }

    /// Size of the screen, degrees.
    pub fn size_deg(&self) -> DVec2 {
        let display = &self.experiment.display;
        DVec2::new(f64::from(display.width_px), f64::from(display.height_px))
            * display.pixel_radians().to_degrees()
    }

    /// Signals of the cones on the screen for which `inside` holds (degrees right and up).
    pub fn signals(&self, frame: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<Signal> {
        let cones = Cones {
            x_deg: &self.columns.x_deg,
            y_deg: &self.columns.y_deg,
            kind: &self.columns.cone_type,
            aperture_um2: &self.columns.aperture_um2,
        };
        let half = 0.49 * self.size_deg();
        signals(&cones, &self.counts[frame], |x, y| x.abs() < half.x && y.abs() < half.y && inside(x, y))
    }

    /// What an observer sees in a frame.
    pub fn seen(&self, frame: usize, inside: impl Fn(f64, f64) -> bool) -> Seen {
        let middle_s = (frame as f64 + 0.5) / self.experiment.display.frame_rate_hz;
        Seen::new(&self.signals(frame, inside), degrees(self.gaze.screen_tangent(middle_s)))
    }

    /// The picture of a frame.
    ///
    /// # Errors
    /// When the side is out of range.
    pub fn image(&self, frame: usize, side_px: u32) -> Result<RgbImage, String> {
        let columns = &self.columns;
        let agreement: f64 = columns.x_um.iter().zip(&columns.x_deg).map(|(um, deg)| um * deg).sum();
        let shapes = ConeShapes {
            start: columns.polygon_start.clone(),
            corners: columns.polygon_xy.chunks_exact(2).map(|c| [c[0], c[1]]).collect(),
            cone_type: columns.cone_type.clone(),
            aperture_um2: columns.aperture_um2.clone(),
            mirrored: agreement < 0.0,
        };
        let view = View::new(&shapes, side_px).map_err(|e| e.to_string())?;
        Ok(view.image(&shapes, &self.counts[frame]))
    }
}
