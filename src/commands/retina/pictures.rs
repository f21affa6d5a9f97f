//! Pictures of the mosaic with scale bars and captions: patches as in Figures 8 and 9, the strip of Figure 1.
//!
//! x_um (nasal) runs right and y_um (superior) up: a right eye's retina seen through its pupil. In the strip the meridian runs right.

use std::path::Path;

use glam::DVec2;
use photoneye_eye::picture::{Meridian, MosaicView, RgbImage, Strip, draw_each};
use photoneye_eye::retina::{Cones, Density, RegionUm, RetinaParams};

use crate::chart::{Canvas, Colour, DARK, Font, Rect, number, width_of};
use crate::failure::Failure;
use crate::result_folder::write_file;

const GREY: Colour = [90; 3];
/// White around and between pictures, pixels.
const GAP: i32 = 16;
/// Height of the lines of a caption, pixels.
const CAPTION: i32 = 40;
/// Side of a patch on the sheet and of the fovea's own picture, pixels.
const PATCH_PX: u32 = 520;
const FOVEA_PX: u32 = 1_200;
/// Side of the fovea's own picture, visual degrees (Figure 8).
const FOVEA_DEG: f64 = 0.5;
/// A row of the strip: length and width in pixels.
const ROW_PX: [f64; 2] = [1_600.0, 110.0];
/// Scale of the strip, µm per pixel: 5 pixels for a cone of the foveal centre.
const STRIP_UM_PER_PX: f64 = 0.45;
const MAX_ROWS: u32 = 60;
const TOWARDS: &str = "Right: nasal. Up: superior (a right eye seen through its pupil).";
const TYPES: &str = "L white, M greenish, S bluish; dark: between apertures.";

/// What to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct MosaicRequest {
    /// The meridian of patches and strip.
    pub along: Meridian,
    /// Eccentricities of the patches, visual degrees.
    pub patches_deg: Vec<f64>,
    /// Side of a patch, µm.
    pub patch_um: f64,
    /// End of the strip, visual degrees.
    pub strip_to_deg: f64,
}

impl Default for MosaicRequest {
    fn default() -> Self {
        Self {
            along: Meridian::Temporal,
            patches_deg: vec![0.0, 0.5, 1.0, 2.0, 5.0, 10.0],
            patch_um: 60.0,
            strip_to_deg: 13.0,
        }
    }
}

/// A picture and the name of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedPicture {
    /// With the ending.
    pub name: &'static str,
    /// The picture.
    pub image: RgbImage,
}

/// `patches.png`, `fovea.png` and `strip.png`; `cones_of` makes the cones of a rectangle, and no more than it are ever held.
///
/// # Errors
/// When `cones_of` fails, or the request cannot be drawn.
pub fn mosaic_pictures(
    params: &RetinaParams,
    request: &MosaicRequest,
    mut cones_of: impl FnMut(&RegionUm) -> Result<Cones, Failure>,
) -> Result<Vec<NamedPicture>, Failure> {
    let patches = patches(params, request, &mut cones_of)?;
    let fovea = fovea(params, &mut cones_of)?;
    let strip = strip(params, request, &mut cones_of)?;
    let named = [("patches.png", patches), ("fovea.png", fovea), ("strip.png", strip)];
    Ok(named.map(|(name, image)| NamedPicture { name, image }).into())
}

/// Writes a picture.
///
/// # Errors
/// When the encoder refuses or the place cannot be written.
pub fn write_png(path: &Path, image: &RgbImage) -> Result<(), Failure> {
    write_file(path, &image.png().map_err(Failure::failed)?)
}

/// µm from the foveal centre along a meridian to an eccentricity in visual degrees.
fn um_at(density: &Density, along: Meridian, deg: f64) -> f64 {
    let (mut low, mut high) = (0.0, density.ora_um());
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if density.visual_deg(along.direction() * middle) < deg { low = middle } else { high = middle }
    }
    low
}

/// Patches along a meridian on one sheet, all at one scale.
fn patches(
    params: &RetinaParams,
    request: &MosaicRequest,
    mut cones_of: impl FnMut(&RegionUm) -> Result<Cones, Failure>,
) -> Result<RgbImage, Failure> {
    let density = Density::new(params);
    let columns = request.patches_deg.len().clamp(1, 3) as i32;
    let rows = (request.patches_deg.len() as i32 + columns - 1) / columns;
    let step = [PATCH_PX as i32 + GAP, PATCH_PX as i32 + CAPTION + GAP];
    let mut canvas = Canvas::new(GAP + columns * step[0], GAP + rows * step[1] + 20);
    for (i, &deg) in request.patches_deg.iter().enumerate() {
        let centre = request.along.direction() * um_at(&density, request.along, deg);
        let view = MosaicView::patch(centre, request.patch_um, PATCH_PX).map_err(Failure::usage)?;
        let x = GAP + i as i32 % columns * step[0];
        let y = GAP + i as i32 / columns * step[1];
        framed(&mut canvas, &view.draw(&cones_of(&view.region())?), x, y);
        let (place, bottom) = (place(request.along, deg), y + PATCH_PX as i32);
        let cones = number(100.0 * (density.per_mm2(centre) / 100.0).round(), 0.0);
        canvas.text(Font::Bold, &place, x, bottom + 6, DARK);
        canvas.text(Font::Small, &format!("target {cones} cones per mm²"), x, bottom + 22, GREY);
        scale_bar(&mut canvas, x + PATCH_PX as i32, bottom + 6, 10.0, view.um_per_px());
    }
    let y = canvas.area().bottom() - 24;
    canvas.text(Font::Small, &format!("{TOWARDS} {TYPES}"), GAP, y, GREY);
    Ok(canvas.finish())
}

/// Half a degree around the foveal centre (Figure 8).
fn fovea(
    params: &RetinaParams,
    mut cones_of: impl FnMut(&RegionUm) -> Result<Cones, Failure>,
) -> Result<RgbImage, Failure> {
    let side_um = FOVEA_DEG / params.geometry.visual.deg_per_um();
    let view = MosaicView::patch(DVec2::ZERO, side_um, FOVEA_PX).map_err(Failure::usage)?;
    let side = FOVEA_PX as i32;
    let mut canvas = Canvas::new(side + 2 * GAP, side + 2 * GAP + CAPTION);
    framed(&mut canvas, &view.draw(&cones_of(&view.region())?), GAP, GAP);
    let y = GAP + side + 6;
    canvas.text(Font::Bold, &format!("{FOVEA_DEG}° around the foveal centre"), GAP, y, DARK);
    canvas.text(Font::Small, &format!("{TOWARDS} {TYPES}"), GAP, y + 16, GREY);
    scale_bar(&mut canvas, GAP + side, y, 20.0, view.um_per_px());
    Ok(canvas.finish())
}

/// From the foveal centre outwards in rows (Figure 1).
fn strip(
    params: &RetinaParams,
    request: &MosaicRequest,
    cones_of: impl FnMut(&RegionUm) -> Result<Cones, Failure>,
) -> Result<RgbImage, Failure> {
    let density = Density::new(params);
    let end_um = um_at(&density, request.along, request.strip_to_deg);
    let rows = ((end_um / (ROW_PX[0] * STRIP_UM_PER_PX)).ceil() as u32).clamp(1, MAX_ROWS);
    // Full rows that end where the strip does.
    let row_px = (end_um / f64::from(rows) / STRIP_UM_PER_PX).round().clamp(1.0, ROW_PX[0]);
    let row_um = row_px * STRIP_UM_PER_PX;
    let strip = Strip {
        along: request.along,
        from_um: 0.0,
        row_um,
        rows,
        width_um: ROW_PX[1] * STRIP_UM_PER_PX,
        um_per_px: STRIP_UM_PER_PX,
    };
    let views = strip.views().map_err(Failure::usage)?;
    let images = draw_each(&views, cones_of)?;
    let step = ROW_PX[1] as i32 + 26;
    let mut canvas = Canvas::new(row_px as i32 + 2 * GAP, GAP + step * images.len() as i32 + CAPTION);
    for (row, image) in images.iter().enumerate() {
        let y = GAP + row as i32 * step;
        framed(&mut canvas, image, GAP, y);
        let from_um = row_um * row as f64;
        let deg_at = |um: f64| density.visual_deg(request.along.direction() * um);
        degree_marks(&mut canvas, y + ROW_PX[1] as i32, from_um, row_um, deg_at);
    }
    let y = canvas.area().bottom() - CAPTION + 2;
    let text = format!(
        "From the foveal centre outwards; right: {}, up: {}; numbers are visual degrees. {TYPES}",
        request.along.name(),
        up_of(request.along)
    );
    canvas.text(Font::Small, &text, GAP, y + 4, GREY);
    scale_bar(&mut canvas, GAP + row_px as i32, y, 50.0, STRIP_UM_PER_PX);
    Ok(canvas.finish())
}

/// A picture within a thin dark line.
fn framed(canvas: &mut Canvas, image: &RgbImage, x: i32, y: i32) {
    let [width, height] = [image.width as i32 + 2, image.height as i32 + 2];
    canvas.rectangle(Rect { x: x - 1, y: y - 1, width, height }, DARK);
    canvas.picture(image, x, y);
}

/// What is up when a meridian runs right.
fn up_of(right: Meridian) -> &'static str {
    let up = right.direction().perp();
    Meridian::ALL.into_iter().find(|other| other.direction().dot(up) > 0.5).map_or("", Meridian::name)
}

/// A mark every quarter of a degree, with its number, under a row that begins at `from_um`.
fn degree_marks(canvas: &mut Canvas, y: i32, from_um: f64, row_um: f64, deg_at: impl Fn(f64) -> f64) {
    let page = canvas.area();
    let pixels = (row_um / STRIP_UM_PER_PX) as i32;
    let quarter = |pixel: i32| (4.0 * deg_at(from_um + f64::from(pixel) * STRIP_UM_PER_PX)).floor();
    // The foveal centre itself is a mark; others lie where a quarter begins.
    let begins = |pixel: &i32| {
        from_um + f64::from(*pixel) <= 0.0 || *pixel > 0 && quarter(*pixel) > quarter(pixel - 1)
    };
    for pixel in (0..pixels).filter(begins) {
        let x = f64::from(GAP + pixel);
        canvas.fill(page, [x - 0.5, f64::from(y) + 1.0], [x + 0.5, f64::from(y) + 5.0], DARK);
        let label = format!("{}°", 0.25 * quarter(pixel));
        let left = (GAP + pixel - width_of(Font::Small, &label) / 2).max(GAP);
        canvas.text(Font::Small, &label, left, y + 5, DARK);
    }
}

/// A bar of a length in µm with its number, its right end at `right`.
fn scale_bar(canvas: &mut Canvas, right: i32, y: i32, length_um: f64, um_per_px: f64) {
    let pixels = (length_um / um_per_px).round() as i32;
    canvas.rectangle(Rect { x: right - pixels, y: y + 4, width: pixels, height: 4 }, DARK);
    let label = format!("{length_um} µm");
    canvas.text(Font::Small, &label, right - width_of(Font::Small, &label), y + 12, DARK);
}

fn place(along: Meridian, deg: f64) -> String {
    if deg > 0.0 { format!("{deg}° {}", along.name()) } else { "foveal centre".into() }
}

#[cfg(test)]
mod tests {
    use photoneye_eye::retina::build_region;

    use super::*;

    #[test]
    fn degrees_become_places() {
        let params = RetinaParams::default();
        let density = Density::new(&params);
        for along in Meridian::ALL {
            assert!((um_at(&density, along, 5.0) - 5.0 * 287.0).abs() < 1e-6);
            assert!(um_at(&density, along, 0.0) < 1e-6);
        }
        assert_eq!((up_of(Meridian::Nasal), up_of(Meridian::Temporal)), ("superior", "inferior"));
    }

    #[test]
    fn pictures_ask_for_what_they_show() {
        let mut largest = 0.0_f64;
        let request =
            MosaicRequest { patches_deg: vec![0.0, 1.0], strip_to_deg: 3.0, ..MosaicRequest::default() };
        let pictures = mosaic_pictures(&RetinaParams::default(), &request, |region| {
            let size = region.max - region.min;
            largest = largest.max(size.x * size.y);
            Ok(Cones { polygon_start: vec![0], ..Cones::default() })
        })
        .unwrap();
        assert_eq!(
            pictures.iter().map(|p| p.name).collect::<Vec<_>>(),
            ["patches.png", "fovea.png", "strip.png"]
        );
        assert!(largest < 1e5, "{largest} µm²");
    }

    /// Draws everything of a real mosaic into the folder that `PHOTONEYE_LOOK` names, for a person to look at.
    #[test]
    #[ignore = "takes half a minute; for looking at"]
    fn pictures_to_look_at() {
        let folder = std::env::var("PHOTONEYE_LOOK").unwrap_or_else(|_| "/tmp/view".into());
        let folder = Path::new(&folder);
        let params = RetinaParams::default();
        let cones_of = |region: &RegionUm| Ok(build_region(&params, region).map_err(Failure::usage)?.cones);
        for picture in mosaic_pictures(&params, &MosaicRequest::default(), cones_of).unwrap() {
            write_png(&folder.join(picture.name), &picture.image).unwrap();
        }
    }
}
