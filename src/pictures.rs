//! Draws the pictures of a result: one a frame and, of several frames, their movement-compensated mean (Figure 16).

use std::fs;
use std::path::Path;

use photoneye_eye::experiment::Experiment;
use photoneye_eye::movement::Gaze;
use photoneye_eye::optics::Screen;
use photoneye_eye::picture::{ConeShapes, RgbImage, View, encode_srgb, srgb_light};
use photoneye_eye::plan::setup::{fixation, gaze};
use photoneye_store::table::{ConeColumns, read_cones_file};
use serde_json::Value;

use crate::cli::PictureArgs;
use crate::counts_file::CountsFile;
use crate::failure::{Failure, plain};

/// Frames that are drawn together.
const TOGETHER: usize = 16;

/// Draws `frames/` of a result folder from its cones.arrow and counts.npy; gives the number of frames drawn.
///
/// # Errors
/// When a file is missing or damaged, or the disk refuses.
pub fn draw(folder: &Path, args: PictureArgs) -> Result<usize, Failure> {
    let cones = read_cones(&folder.join("cones.arrow"))?;
    let mut counts = CountsFile::open(&folder.join("counts.npy"))?;
    if counts.cones != cones.len() {
        return Err(Failure::usage(format!(
            "{}: cones.arrow has {} cones, counts.npy {}",
            folder.display(),
            cones.len(),
            counts.cones
        )));
    }
    let drawn = counts.frames.min(args.pictures as usize);
    if drawn == 0 {
        return Ok(0);
    }
    let frames = folder.join("frames");
    fs::create_dir_all(&frames).map_err(|e| Failure::file("make", &frames, &e))?;
    let shapes = shapes(&cones);
    let view = View::new(&shapes, args.picture_px).map_err(Failure::usage)?;
    let report = read_report(folder);
    let warnings = warnings(&report);
    let mut mean = Mean::new(&report, &cones, &shapes, args.picture_px);
    for first in (0..drawn).step_by(TOGETHER) {
        let some = first..drawn.min(first + TOGETHER);
        let values: Vec<_> = some.clone().map(|index| counts.frame(index)).collect::<Result<_, _>>()?;
        let images = view.images(&shapes, &values, &warnings).map_err(Failure::failed)?;
        for ((image, png), index) in images.iter().zip(some) {
            if let Some(mean) = mean.as_mut().filter(|_| drawn > 1) {
                mean.add(index, image);
            }
            write(&frames.join(format!("{index:04}.png")), png)?;
        }
    }
    if let Some(png) = mean.filter(|_| drawn > 1).and_then(|mean| mean.png(&warnings)) {
        write(&frames.join("mean.png"), &png)?;
    }
    Ok(drawn)
}

/// report.json of a result; null when it is missing or damaged.
pub fn read_report(folder: &Path) -> Value {
    let text = fs::read_to_string(folder.join("report.json")).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or(Value::Null)
}

/// The warnings of a report.json.
pub fn warnings(report: &Value) -> Vec<String> {
    let texts = report["warnings"].as_array().map_or(&[][..], Vec::as_slice);
    texts.iter().filter_map(|text| text.as_str().map(str::to_owned)).collect()
}

/// The cones of a result.
///
/// # Errors
/// When the file is missing or damaged.
pub fn read_cones(path: &Path) -> Result<ConeColumns, Failure> {
    let bytes = fs::read(path).map_err(|e| Failure::usage(format!("{}: {}", path.display(), plain(&e))))?;
    read_cones_file(&bytes).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    fs::write(path, bytes).map_err(|e| Failure::file("write", path, &e))
}

/// Outlines for the model's painter. The visual field is mirrored when x_um and x_deg have opposite signs (a left eye).
fn shapes(cones: &ConeColumns) -> ConeShapes {
    let agreement: f64 = cones.x_um.iter().zip(&cones.x_deg).map(|(um, deg)| um * deg).sum();
    ConeShapes {
        start: cones.polygon_start.iter().map(|start| start / 2).collect(),
        corners: cones.polygon.chunks_exact(2).map(|c| [c[0], c[1]]).collect(),
        cone_type: cones.kind.clone(),
        aperture_um2: cones.aperture_um2.clone(),
        mirrored: agreement < 0.0,
    }
}

/// The mean of frames after each was moved back by the eye's movement, as a PNG viewer sees them.
struct Mean {
    gaze: Gaze,
    screen: Screen,
    frame_rate_hz: f64,
    /// Picture pixels per visual degree.
    px_per_deg: f64,
    size: Option<[usize; 2]>,
    /// `[row][column]`: linear light, and the number of frames.
    sum: Vec<[f32; 4]>,
}

impl Mean {
    /// `None` when the report does not say how the eye moved.
    fn new(report: &Value, cones: &ConeColumns, shapes: &ConeShapes, picture_px: u32) -> Option<Self> {
        let spec: Experiment = serde_json::from_value(report.get("resolved")?.clone()).ok()?;
        let fixation = fixation(&spec).ok()?;
        Some(Self {
            gaze: gaze(&spec, &fixation).ok()?,
            screen: fixation.screen,
            frame_rate_hz: spec.display.frame_rate_hz,
            px_per_deg: um_per_deg(cones)? * f64::from(picture_px) / extent_um(shapes),
            size: None,
            sum: Vec::new(),
        })
    }

    /// Adds a frame. The eye moved right means that the scene moved left in the eye's own picture.
    fn add(&mut self, index: usize, image: &RgbImage) {
        let [width, height] = [image.width as usize, image.height as usize];
        if self.size.is_none() {
            self.size = Some([width, height]);
            self.sum = vec![[0.0; 4]; width * height];
        }
        let tangent = self.gaze.screen_tangent((index as f64 + 0.5) / self.frame_rate_hz);
        let moved_deg = self.screen.visual_deg(tangent);
        let shift = [moved_deg.x * self.px_per_deg, -moved_deg.y * self.px_per_deg];
        let light = srgb_light().map(|light| light as f32);
        for (row, sums) in self.sum.chunks_exact_mut(width).enumerate() {
            for (column, sum) in sums.iter_mut().enumerate() {
                let at = [column as f64 - shift[0], row as f64 - shift[1]];
                if let Some([red, green, blue]) = sample(image, &light, at) {
                    sum.iter_mut().zip([red, green, blue, 1.0]).for_each(|(sum, value)| *sum += value);
                }
            }
        }
    }

    fn png(&self, warnings: &[String]) -> Option<Vec<u8>> {
        let [width, height] = self.size?.map(|side| side as u32);
        let mean = |[red, green, blue, frames]: &[f32; 4]| {
            [red, green, blue].map(|sum| encode_srgb(sum / frames.max(1.0)))
        };
        RgbImage { width, height, rgb: self.sum.iter().flat_map(mean).collect() }.png_with(warnings).ok()
    }
}

/// Linear light at a point between pixels; `None` outside.
fn sample(image: &RgbImage, light: &[f32; 256], at: [f64; 2]) -> Option<[f32; 3]> {
    let (width, height) = (image.width as usize, image.height as usize);
    let (x, y) = (at[0].floor(), at[1].floor());
    if x < 0.0 || y < 0.0 || x as usize + 1 >= width || y as usize + 1 >= height {
        return None;
    }
    let (u, v) = ((at[0] - x) as f32, (at[1] - y) as f32);
    let pixel = |dx: usize, dy: usize, i: usize| {
        light[usize::from(image.rgb[3 * ((y as usize + dy) * width + x as usize + dx) + i])]
    };
    Some(std::array::from_fn(|i| {
        let top = pixel(0, 0, i) * (1.0 - u) + pixel(1, 0, i) * u;
        let bottom = pixel(0, 1, i) * (1.0 - u) + pixel(1, 1, i) * u;
        top * (1.0 - v) + bottom * v
    }))
}

/// Slope of retinal arc against visual angle, by least squares over the cones.
fn um_per_deg(cones: &ConeColumns) -> Option<f64> {
    let n = cones.len() as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / n;
    let (um, deg) = (mean(&cones.x_um), mean(&cones.x_deg));
    let pairs = || cones.x_um.iter().map(move |x| x - um).zip(cones.x_deg.iter().map(move |x| x - deg));
    let (cross, square) = pairs().fold((0.0, 0.0), |(c, s), (a, b)| (c + a * b, s + b * b));
    (square > 0.0).then(|| (cross / square).abs())
}

/// The longer side of all outlines, which a picture's longer side shows.
fn extent_um(shapes: &ConeShapes) -> f64 {
    let side = |axis: usize| {
        let values = shapes.corners.iter().map(|corner| f64::from(corner[axis]));
        let (min, max) = values.fold((f64::MAX, f64::MIN), |(min, max), v| (min.min(v), max.max(v)));
        max - min
    };
    side(0).max(side(1)).max(1e-3)
}
