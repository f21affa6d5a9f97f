//! Pictures of the mosaic itself (Figures 1, 8, 9): every cone's aperture from above, coloured by its type.
//!
//! L cones are white, M cones a little darker and slightly greenish, S cones darker still and slightly bluish; what lies between
//! apertures is dark. Where apertures fill their cells a thin dark wall is drawn, half on either side, so that single cells
//! can be seen; where the gap is already as wide as the wall an aperture keeps its true outline.
//!
//! # Orientation
//! With [`Meridian::Nasal`] to the right, x_um (towards the optic disc) runs right and y_um (superior retina) up: a right eye's retina
//! as it is seen from inside the eye, or from outside through the pupil. A left eye's is the mirror image of its picture.
//! Other meridians to the right turn that picture and do not mirror it.
//!
//! # Cost
//! 3 x 3 samples a pixel: about 0.1 s for a million pixels.

use glam::{DVec2, Vec2};

use super::image::{RgbImage, encode_srgb};
use super::{MAX_SIDE_PX, raster};
use crate::experiment::{RangeError, check_range};
use crate::retina::{Cones, RegionUm};

/// Samples along the side of a pixel.
const SAMPLES: u32 = 3;
/// Width of a wall as a share of the side of a square as large as the cell.
const WALL: f32 = 0.1;
/// Least width of a wall, pixels.
const WALL_PX: f32 = 0.8;
/// No cell reaches farther from its centre than this, µm.
const REACH_UM: f64 = 20.0;
/// Linear light of L, M and S cones.
const LIGHT: [[f32; 3]; 3] = [[0.93, 0.93, 0.91], [0.44, 0.58, 0.43], [0.22, 0.29, 0.49]];
/// Linear light of what is between apertures.
const BETWEEN: [f32; 3] = [0.006, 0.006, 0.008];

/// The four directions out of the fovea along which densities are tabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meridian {
    /// Towards the optic disc, +x_um.
    Nasal,
    /// Upper retina, +y_um.
    Superior,
    /// -x_um.
    Temporal,
    /// -y_um.
    Inferior,
}

impl Meridian {
    /// All of them, counter-clockwise from nasal.
    pub const ALL: [Self; 4] = [Self::Nasal, Self::Superior, Self::Temporal, Self::Inferior];

    /// The unit vector out of the fovea.
    pub fn direction(self) -> DVec2 {
        match self {
            Self::Nasal => DVec2::X,
            Self::Superior => DVec2::Y,
            Self::Temporal => DVec2::NEG_X,
            Self::Inferior => DVec2::NEG_Y,
        }
    }

    /// In lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nasal => "nasal",
            Self::Superior => "superior",
            Self::Temporal => "temporal",
            Self::Inferior => "inferior",
        }
    }
}

/// A rectangle of the chart, drawn at a scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MosaicView {
    centre_um: DVec2,
    right: Meridian,
    um_per_px: f64,
    size_px: [u32; 2],
}

impl MosaicView {
    /// The chart point in the middle, µm; the meridian that runs to the right; µm per pixel (0.001 to 100); width and height.
    ///
    /// # Errors
    /// When the scale is out of range, a side is 0 or above [`MAX_SIDE_PX`], or the centre is not within 1 m.
    pub fn new(
        centre_um: DVec2,
        right: Meridian,
        um_per_px: f64,
        size_px: [u32; 2],
    ) -> Result<Self, RangeError> {
        check_range("um_per_px", um_per_px, 1e-3, 100.0)?;
        check_range("centre_um.x", centre_um.x, -1e6, 1e6)?;
        check_range("centre_um.y", centre_um.y, -1e6, 1e6)?;
        for side in size_px {
            check_range("size_px", f64::from(side), 1.0, f64::from(MAX_SIDE_PX))?;
        }
        Ok(Self { centre_um, right, um_per_px, size_px })
    }

    /// A square of a side in µm at a place, nasal to the right (Figures 8, 9).
    ///
    /// # Errors
    /// As [`MosaicView::new`].
    pub fn patch(centre_um: DVec2, side_um: f64, side_px: u32) -> Result<Self, RangeError> {
        Self::new(centre_um, Meridian::Nasal, side_um / f64::from(side_px.max(1)), [side_px; 2])
    }

    /// µm a pixel.
    pub fn um_per_px(&self) -> f64 {
        self.um_per_px
    }

    /// Which cones to draw: those whose centre is in the picture or so near that their cell may reach into it.
    pub fn region(&self) -> RegionUm {
        let across = DVec2::new(f64::from(self.size_px[0]), f64::from(self.size_px[1])) * self.um_per_px;
        let lies = matches!(self.right, Meridian::Nasal | Meridian::Temporal);
        let half = 0.5 * if lies { across } else { DVec2::new(across.y, across.x) } + REACH_UM;
        RegionUm { min: self.centre_um - half, max: self.centre_um + half }
    }

    /// The cones that reach into the picture; others do no harm.
    pub fn draw(&self, cones: &Cones) -> RgbImage {
        let [width, height] = self.size_px.map(|side| side as usize);
        let samples = SAMPLES as usize;
        let mut light = vec![[0.0_f32; 3]; width * height];
        for cone in 0..cones.len() {
            let corners = self.corners(cones, cone);
            let edges = self.edges(cones, cone, &corners);
            let tint = LIGHT[cones.cone_type[cone] as usize];
            let colour: [f32; 3] = std::array::from_fn(|i| tint[i] - BETWEEN[i]);
            let outline = corners.iter().map(Vec2::to_array);
            raster::fill(outline, samples * width, samples * height, |at| {
                let (row, column) = (at / (samples * width), at % (samples * width));
                let share = lit(&edges, Vec2::new(column as f32 + 0.5, row as f32 + 0.5));
                let pixel = &mut light[row / samples * width + column / samples];
                (0..3).for_each(|i| pixel[i] += share * colour[i]);
            });
        }
        let each = 1.0 / (SAMPLES * SAMPLES) as f32;
        let rgb = light
            .iter()
            .flat_map(|pixel| std::array::from_fn::<u8, 3, _>(|i| encode_srgb(BETWEEN[i] + each * pixel[i])));
        RgbImage { width: self.size_px[0], height: self.size_px[1], rgb: rgb.collect() }
    }

    /// Corners of a cone in samples, from the picture's upper left corner.
    fn corners(&self, cones: &Cones, cone: usize) -> Vec<Vec2> {
        cones.polygon(cone).map(|corner| self.sample(corner)).collect()
    }

    /// A point of the chart in samples from the picture's upper left corner.
    fn sample(&self, at: DVec2) -> Vec2 {
        let right = self.right.direction();
        let per_um = f64::from(SAMPLES) / self.um_per_px;
        let middle = 0.5 * f64::from(SAMPLES) * DVec2::new(self.size_px[0].into(), self.size_px[1].into());
        let from_centre = at - self.centre_um;
        let up = right.perp_dot(from_centre);
        (middle + per_um * DVec2::new(right.dot(from_centre), -up)).as_vec2()
    }

    /// The edges of an aperture that need a wall. The aperture is its cell shrunk towards the cone's centre, so the gap at an edge is in
    /// proportion to the edge's distance from the centre.
    fn edges(&self, cones: &Cones, cone: usize, corners: &[Vec2]) -> Vec<Edge> {
        let per_um = SAMPLES as f32 / self.um_per_px as f32;
        let cell = cones.cell_area_um2[cone].max(1e-9);
        let coverage = (cones.aperture_um2[cone] / cell).clamp(1e-3, 1.0);
        let wall = 0.5 * (WALL * cell.sqrt()).max(WALL_PX * self.um_per_px as f32) * per_um;
        let centre = self.sample(cones.center(cone));
        let edge = |(i, &a): (usize, &Vec2)| {
            let along = (corners[(i + 1) % corners.len()] - a).normalize_or_zero();
            let gap = along.perp_dot(centre - a).abs() * (coverage.sqrt().recip() - 1.0);
            (along != Vec2::ZERO && wall > gap).then_some(Edge { from: a, along, wall: wall - gap })
        };
        corners.iter().enumerate().filter_map(edge).collect()
    }
}

/// A side of an aperture and what the wall takes from it, samples.
struct Edge {
    from: Vec2,
    along: Vec2,
    wall: f32,
}

/// How much of a sample in an aperture lies within all its walls, 0 to 1.
fn lit(edges: &[Edge], at: Vec2) -> f32 {
    let inside = |edge: &Edge| edge.along.perp_dot(at - edge.from).abs() - edge.wall + 0.5;
    edges.iter().map(inside).fold(1.0, f32::min).max(0.0)
}

/// A band of retina from the foveal centre outwards, cut into rows (Figure 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// The meridian, which runs to the right in every row.
    pub along: Meridian,
    /// Where the first row begins, µm from the foveal centre.
    pub from_um: f64,
    /// Length of a row, µm.
    pub row_um: f64,
    /// Number of rows (1 to 200).
    pub rows: u32,
    /// Width of the band, µm.
    pub width_um: f64,
    /// Scale, µm per pixel.
    pub um_per_px: f64,
}

impl Strip {
    /// The rows, from the fovea outwards; each begins where the one before ends.
    ///
    /// # Errors
    /// As [`MosaicView::new`], or too many rows.
    pub fn views(&self) -> Result<Vec<MosaicView>, RangeError> {
        check_range("rows", f64::from(self.rows), 1.0, 200.0)?;
        let size_px = [self.row_um, self.width_um].map(|side| (side / self.um_per_px).round() as u32);
        (0..self.rows)
            .map(|row| {
                let middle = self.from_um + self.row_um * (f64::from(row) + 0.5);
                MosaicView::new(self.along.direction() * middle, self.along, self.um_per_px, size_px)
            })
            .collect()
    }
}

/// Draws views one by one with cones that are made for each, so that no more of them exist at a time than one view shows.
///
/// # Errors
/// When `cones_of` has none.
pub fn draw_each<E>(
    views: &[MosaicView],
    mut cones_of: impl FnMut(&RegionUm) -> Result<Cones, E>,
) -> Result<Vec<RgbImage>, E> {
    views.iter().map(|view| Ok(view.draw(&cones_of(&view.region())?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retina::ConeType;

    /// Squares with a side of 4 µm whose apertures fill them.
    fn squares(places: &[(f64, f64, ConeType)]) -> Cones {
        let mut cones = Cones { polygon_start: vec![0], ..Cones::default() };
        for (i, &(x, y, cone_type)) in places.iter().enumerate() {
            cones.id.push(i as u64);
            cones.x_um.push(x);
            cones.y_um.push(y);
            cones.cone_type.push(cone_type);
            cones.polygon_xy.extend([-2.0, -2.0, 2.0, -2.0, 2.0, 2.0, -2.0, 2.0]);
            cones.polygon_start.push(4 * (i as u32 + 1));
            cones.cell_area_um2.push(16.0);
            cones.aperture_um2.push(16.0);
            cones.pointing.push([0.0; 2]);
        }
        cones
    }

    /// L nasal, M superior, S temporal, none inferior.
    fn cross() -> Cones {
        squares(&[(6.0, 0.0, ConeType::L), (0.0, 6.0, ConeType::M), (-6.0, 0.0, ConeType::S)])
    }

    fn brightness(image: &RgbImage, column: u32, row: u32) -> u32 {
        image.pixel(column, row).unwrap().iter().map(|v| u32::from(*v)).sum()
    }

    #[test]
    fn nasal_is_right_and_superior_up() {
        let image = MosaicView::patch(DVec2::ZERO, 20.0, 40).unwrap().draw(&cross());
        let [right, top, left, bottom] =
            [(32, 20), (20, 8), (8, 20), (20, 32)].map(|(x, y)| brightness(&image, x, y));
        assert!(right > top && top > left && left > bottom, "{right} {top} {left} {bottom}");
        let [red, green, blue] = image.pixel(20, 8).unwrap();
        assert!(green > red && green > blue);
        let [red, green, blue] = image.pixel(8, 20).unwrap();
        assert!(blue > red && blue > green);
    }

    #[test]
    fn a_meridian_to_the_right_turns_the_picture() {
        for (right, want) in [
            (Meridian::Superior, [(32, 20), (8, 20)]),
            (Meridian::Temporal, [(20, 32), (20, 8)]),
            (Meridian::Inferior, [(8, 20), (32, 20)]),
        ] {
            let image = MosaicView::new(DVec2::ZERO, right, 0.5, [40, 40]).unwrap().draw(&cross());
            let [green, dark] = want.map(|(x, y)| image.pixel(x, y).unwrap());
            assert!(green[1] > green[0] && green[1] > 100, "{right:?} {green:?}");
            assert!(right == Meridian::Temporal || dark != green);
        }
    }

    #[test]
    fn cells_that_touch_are_parted_by_a_wall() {
        let cones = squares(&[(-2.0, 0.0, ConeType::L), (2.0, 0.0, ConeType::L)]);
        let image = MosaicView::patch(DVec2::ZERO, 8.0, 80).unwrap().draw(&cones);
        assert!(brightness(&image, 40, 40) < 100);
        assert!(brightness(&image, 36, 40) > 650 && brightness(&image, 60, 40) > 650);
        // Half of 10 % of 4 µm at 10 pixels a µm: 2 pixels on each side.
        assert!(brightness(&image, 38, 40) < 500 && brightness(&image, 41, 40) < 500);
    }

    #[test]
    fn apertures_with_a_wide_gap_keep_their_size() {
        let mut cones = squares(&[(0.0, 0.0, ConeType::L)]);
        cones.cell_area_um2[0] = 25.0;
        let image = MosaicView::patch(DVec2::ZERO, 8.0, 80).unwrap().draw(&cones);
        let lit = (0..80).flat_map(|row| (0..80).map(move |column| (column, row)));
        assert_eq!(lit.filter(|(column, row)| brightness(&image, *column, *row) > 700).count(), 40 * 40);
    }

    #[test]
    fn rows_of_a_strip_follow_each_other() {
        let strip = Strip {
            along: Meridian::Superior,
            from_um: 0.0,
            row_um: 100.0,
            rows: 3,
            width_um: 20.0,
            um_per_px: 0.5,
        };
        let views = strip.views().unwrap();
        assert_eq!(views.len(), 3);
        for (row, view) in views.iter().enumerate() {
            let region = view.region();
            assert!((region.min.y + REACH_UM - 100.0 * row as f64).abs() < 1e-9);
            assert!((region.max.y - REACH_UM - 100.0 * (row + 1) as f64).abs() < 1e-9);
            assert!((region.max.x - REACH_UM - 10.0).abs() < 1e-9);
        }
        let mut asked = 0;
        let images: Vec<RgbImage> = draw_each(&views, |_| {
            asked += 1;
            Ok::<_, RangeError>(cross())
        })
        .unwrap();
        assert_eq!((asked, images.len(), images[0].width, images[0].height), (3, 3, 200, 40));
        assert!(Strip { rows: 0, ..strip }.views().is_err());
        assert!(Strip { um_per_px: f64::NAN, ..strip }.views().is_err());
        assert!(Strip { row_um: 0.0, ..strip }.views().is_err());
    }
}
