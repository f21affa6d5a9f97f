//! Pictures of results: every cone's aperture filled with its count per area, as in Figures 12 to 16.
//!
//! The picture is upright as the viewer sees the screen. Cone types are white-balanced (each type's bright level becomes the same grey,
//! up to a gain of 50) and lightly tinted: L reddish, M greenish, S bluish. Cone ids are rasterized once per view; a frame is a look-up.
//!
//! `mosaic` draws the cones themselves, without counts (Figures 1, 8, 9).

mod image;
mod mosaic;
mod raster;

use rayon::prelude::*;

use crate::experiment::RangeError;

pub use image::{RgbImage, encode_srgb, srgb_light};
pub use mosaic::{Meridian, MosaicView, Strip, draw_each};

/// Outlines and types of cones in retinal coordinates.
#[derive(Clone, Debug, Default)]
pub struct ConeShapes {
    /// First corner of each cone in `corners`, and the total at the end: cones + 1 values.
    pub start: Vec<u32>,
    /// Corners (x, y), µm of arc from the foveal centre.
    pub corners: Vec<[f32; 2]>,
    /// 0 L, 1 M, 2 S.
    pub cone_type: Vec<u8>,
    /// Light-collecting area, µm².
    pub aperture_um2: Vec<f32>,
    /// The visual field's right is the retina's -x (a left eye).
    pub mirrored: bool,
}

/// A view: which cone is under each sample of the picture.
pub struct View {
    width: usize,
    height: usize,
    /// Cone + 1 under each of 2x2 samples of a pixel, 0 for none; `[2·height][2·width]`.
    owners: Vec<u32>,
}

/// Most pixels along a side.
pub const MAX_SIDE_PX: u32 = 8192;
/// Share of cones that may be brighter than full white.
const CLIPPED: f64 = 0.002;
/// How far a type may be brightened to match the brightest: beyond, single photons would look like light (S cones at 543 nm).
const MOST_BALANCE: f64 = 50.0;
/// Tint by type, linear light.
const TINT: [[f32; 3]; 3] = [[1.0, 0.86, 0.80], [0.82, 1.0, 0.84], [0.74, 0.82, 1.0]];

impl View {
    /// The whole patch, `side_px` pixels along its longer side.
    ///
    /// # Errors
    /// When the side is 0 or above [`MAX_SIDE_PX`].
    pub fn new(shapes: &ConeShapes, side_px: u32) -> Result<Self, RangeError> {
        if side_px == 0 || side_px > MAX_SIDE_PX {
            return Err(RangeError::new("side_px", side_px, &format!("1 to {MAX_SIDE_PX}")));
        }
        let (mut min, mut max) = ([f32::MAX; 2], [f32::MIN; 2]);
        for corner in &shapes.corners {
            for axis in 0..2 {
                min[axis] = min[axis].min(corner[axis]);
                max[axis] = max[axis].max(corner[axis]);
            }
        }
        if shapes.corners.is_empty() {
            (min, max) = ([0.0; 2], [1.0; 2]);
        }
        let extent = [(max[0] - min[0]).max(1e-3), (max[1] - min[1]).max(1e-3)];
        let per_um = side_px as f32 / extent[0].max(extent[1]);
        let size = extent.map(|e| ((e * per_um).ceil() as usize).max(1));
        let mut owners = vec![0; 4 * size[0] * size[1]];
        for cone in 0..shapes.cone_type.len() {
            let corners = &shapes.corners[shapes.start[cone] as usize..shapes.start[cone + 1] as usize];
            // Up in the visual field is down on the retina, so +y_um runs down the picture.
            let sample = |c: &[f32; 2]| {
                let x = if shapes.mirrored { max[0] - c[0] } else { c[0] - min[0] };
                [2.0 * x * per_um, 2.0 * (c[1] - min[1]) * per_um]
            };
            raster::fill(corners.iter().map(sample), 2 * size[0], 2 * size[1], |at| {
                owners[at] = cone as u32 + 1;
            });
        }
        Ok(Self { width: size[0], height: size[1], owners })
    }

    /// One frame; `counts` by cone.
    pub fn image(&self, shapes: &ConeShapes, counts: &[f64]) -> RgbImage {
        let colours = colours(shapes, counts);
        let mut rgb = Vec::with_capacity(3 * self.width * self.height);
        for row in 0..self.height {
            for column in 0..self.width {
                let mut sum = [0.0_f32; 3];
                for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let owner = self.owners[(2 * row + dy) * 2 * self.width + 2 * column + dx];
                    if let Some(colour) = owner.checked_sub(1).map(|cone| colours[cone as usize]) {
                        (0..3).for_each(|i| sum[i] += 0.25 * colour[i]);
                    }
                }
                rgb.extend(sum.map(encode_srgb));
            }
        }
        RgbImage { width: self.width as u32, height: self.height as u32, rgb }
    }

    /// Some frames, each with its PNG, which carries warnings; `counts[frame]` by cone.
    ///
    /// # Errors
    /// When the PNG encoder refuses.
    pub fn images(
        &self,
        shapes: &ConeShapes,
        counts: &[Vec<f64>],
        warnings: &[String],
    ) -> Result<Vec<(RgbImage, Vec<u8>)>, png::EncodingError> {
        let drawn = |counts: &Vec<f64>| {
            let image = self.image(shapes, counts);
            let png = image.png_with(warnings)?;
            Ok((image, png))
        };
        counts.par_iter().map(drawn).collect()
    }

    /// A PNG of one frame; `counts` by cone.
    ///
    /// # Errors
    /// When the PNG encoder refuses.
    pub fn png(&self, shapes: &ConeShapes, counts: &[f64]) -> Result<Vec<u8>, png::EncodingError> {
        self.image(shapes, counts).png()
    }
}

/// Linear colours of the cones: count per area over the brightest, balanced and tinted by type.
fn colours(shapes: &ConeShapes, counts: &[f64]) -> Vec<[f32; 3]> {
    let mut light: Vec<f64> =
        counts.iter().zip(&shapes.aperture_um2).map(|(n, area)| n / f64::from(*area).max(1e-9)).collect();
    // A type's bright level is its 90th percentile: the mean would depend on how much of the patch is dark.
    let mut by_type = [const { Vec::new() }; 3];
    for (value, kind) in light.iter().zip(&shapes.cone_type) {
        by_type[usize::from(*kind).min(2)].push(*value);
    }
    let levels = by_type.map(|values| percentile(values, 0.9));
    let least = levels.iter().fold(0.0_f64, |most, level| most.max(*level)) / MOST_BALANCE;
    let levels = levels.map(|level| Some(level.max(least)).filter(|level| *level > 0.0).unwrap_or(1.0));
    for (value, kind) in light.iter_mut().zip(&shapes.cone_type) {
        *value /= levels[usize::from(*kind).min(2)];
    }
    let white = Some(percentile(light.clone(), 1.0 - CLIPPED)).filter(|white| *white > 0.0).unwrap_or(1.0);
    light
        .iter()
        .zip(&shapes.cone_type)
        .map(|(value, kind)| TINT[usize::from(*kind).min(2)].map(|tint| tint * (value / white) as f32))
        .collect()
}

/// The value below which a share of the values lies; 0 for none.
fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (values.len() as f64 * share) as usize;
    values.get(at).or(values.last()).copied().unwrap_or(0.0)
}

/// An 8-bit RGB PNG.
///
/// # Errors
/// When the encoder refuses.
pub fn encode_png(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    encode_png_with(width, height, rgb, &[])
}

/// An 8-bit RGB PNG with a text `Warning` (iTXt: UTF-8) for each warning.
fn encode_png_with(
    width: u32,
    height: u32,
    rgb: &[u8],
    warnings: &[String],
) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    // A tenth larger than the default, twenty times as fast.
    encoder.set_compression(png::Compression::Fast);
    for warning in warnings {
        encoder.add_itxt_chunk("Warning".into(), warning.clone())?;
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four squares; the bright one is at +x, +y of the retina.
    fn squares(mirrored: bool) -> ConeShapes {
        let mut shapes = ConeShapes { start: vec![0], mirrored, ..ConeShapes::default() };
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            shapes.corners.extend([[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]]);
            shapes.start.push(shapes.corners.len() as u32);
            shapes.cone_type.push(0);
            shapes.aperture_um2.push(1.0);
        }
        shapes
    }

    fn brightest_corner(shapes: &ConeShapes) -> (bool, bool) {
        let view = View::new(shapes, 8).unwrap();
        let bytes = view.png(shapes, &[1.0, 1.0, 1.0, 9.0]).unwrap();
        let picture = crate::video::decode_png(&bytes, crate::video::Limits::default()).unwrap();
        assert_eq!((picture.width, picture.height), (8, 8));
        let at = |column: usize, row: usize| picture.rgb[3 * (8 * row + column)];
        let corners = [(1, 1), (6, 1), (1, 6), (6, 6)];
        let best = corners.into_iter().max_by(|a, b| at(a.0, a.1).total_cmp(&at(b.0, b.1))).unwrap();
        (best.0 > 4, best.1 > 4)
    }

    #[test]
    fn pictures_are_upright_for_both_eyes() {
        assert_eq!(brightest_corner(&squares(false)), (true, true));
        assert_eq!(brightest_corner(&squares(true)), (false, true));
    }

    #[test]
    fn types_are_balanced_but_a_single_photon_stays_dark() {
        let mut shapes = squares(false);
        shapes.cone_type = vec![0, 0, 2, 2];
        let grey =
            |counts: [f64; 4]| colours(&shapes, &counts).iter().map(|colour| colour[2]).collect::<Vec<_>>();
        let bright = grey([400.0, 400.0, 40.0, 40.0]);
        assert!((bright[0] / TINT[0][2] - bright[2] / TINT[2][2]).abs() < 1e-6);
        let dark = grey([400.0, 400.0, 0.0, 1.0]);
        assert!((dark[3] / TINT[2][2] - 50.0 / 400.0).abs() < 1e-6 && dark[2] == 0.0);
    }

    #[test]
    fn a_picture_carries_its_warnings() {
        let image = RgbImage::filled(2, 2, [1, 2, 3]);
        let texts = |bytes: &[u8]| -> Vec<String> {
            let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
            let texts = &reader.info().utf8_text;
            assert!(texts.iter().all(|text| text.keyword == "Warning"));
            texts.iter().map(|text| text.get_text().unwrap()).collect()
        };
        let warnings = ["above the target".to_owned(), "5 µm".to_owned()];
        assert_eq!(texts(&image.png_with(&warnings).unwrap()), warnings);
        assert_eq!(image.png_with(&[]).unwrap(), image.png().unwrap());
    }

    #[test]
    fn no_cones_give_a_black_picture() {
        let none = ConeShapes { start: vec![0], ..ConeShapes::default() };
        assert!(View::new(&none, 16).unwrap().png(&none, &[]).is_ok());
        assert!(View::new(&none, 0).is_err());
    }
}
