//! Charts for scientific reports: panels with linear or logarithmic axes on one page, drawn into an RGB picture.
//!
//! `ticks` chooses numbers, `scale` places values on an axis, `canvas` draws shapes and letters, `panel` draws one chart with
//! them, `sheet` square pictures side by side. Shapes are antialiased at twice the final size; letters come ready-made at their final size from a font inside the
//! program, so no file or library of the system is needed.
//!
//! Points that are not finite, or not positive on a logarithmic axis, are left out and part their line. A chart without
//! points says so.

mod canvas;
mod panel;
mod scale;
mod sheet;
mod text;
mod ticks;

use photoneye_eye::picture::RgbImage;

pub use canvas::{Canvas, Colour, Rect};
pub use sheet::{Content, Tile, sheet};
pub use text::{Font, width_of};
pub use ticks::number;

/// Colours that differ in lightness as well as hue, told apart by most eyes (Okabe and Ito 2008); dark ones first.
pub const PALETTE: [Colour; 6] =
    [[0, 114, 178], [213, 94, 0], [0, 158, 115], [170, 80, 140], [230, 159, 0], [86, 180, 233]];
/// Colour of a target or reference curve.
pub const DARK: Colour = [45, 45, 45];
/// Colour of a band where values are expected.
pub const BAND: Colour = [222, 234, 222];
/// Colour of a mark or band from measurements on living eyes.
pub const LIVING: Colour = [245, 222, 196];

/// Width and height of a panel, pixels.
const PANEL: [i32; 2] = [560, 400];
/// White around the panels, pixels.
const MARGIN: i32 = 16;
/// Height of the page's title line, pixels.
const TITLE: i32 = 40;
/// Most panels on a page.
const MAX_PANELS: usize = 64;

/// One panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chart {
    /// Above the panel.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Curves, drawn in order.
    pub series: Vec<Series>,
    /// Reference ranges behind the curves.
    pub bands: Vec<Band>,
}

/// An axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// Quantity and unit.
    pub title: String,
    /// Logarithmic.
    pub log: bool,
    /// Ends; `None`: what curves and bands need.
    pub range: Option<(f64, f64)>,
    /// Values that show at least, so that a quiet curve does not look wild; without effect when `range` is given.
    pub least: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(title: &str) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// A logarithmic axis.
    pub fn log(title: &str) -> Self {
        Self { title: title.into(), log: true, ..Self::default() }
    }
}

/// How points are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// A line through the points.
    #[default]
    Line,
    /// A broken line.
    Dashed,
    /// A dot a point.
    Points,
    /// Line and dots.
    Both,
}

/// A curve or a cloud of points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// In the legend; an empty one is not listed.
    pub label: String,
    /// (x, y).
    pub points: Vec<(f64, f64)>,
    /// Half the length of each point's error bar; fewer than points: the rest have none.
    pub error: Vec<f64>,
    /// How points are shown.
    pub style: Style,
    /// sRGB.
    pub colour: Colour,
}

impl Series {
    /// Without error bars.
    pub fn new(label: &str, points: Vec<(f64, f64)>, style: Style, colour: Colour) -> Self {
        Self { label: label.into(), points, error: Vec::new(), style, colour }
    }
}

/// A range of y that is marked; equal ends make a broken line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Band {
    /// In the legend; an empty one is not listed.
    pub label: String,
    /// Lower end.
    pub from: f64,
    /// Upper end.
    pub to: f64,
    /// The part of the x axis where it holds; `None`: all of it.
    pub x: Option<(f64, f64)>,
    /// sRGB.
    pub colour: Colour,
}

impl Band {
    /// Over the whole width.
    pub fn new(label: &str, from: f64, to: f64, colour: Colour) -> Self {
        Self { label: label.into(), from, to, x: None, colour }
    }

    /// Over a part of the x axis.
    pub fn over(self, from: f64, to: f64) -> Self {
        Self { x: Some((from, to)), ..self }
    }
}

/// Draws charts row by row in so many columns (at least one), under a title that may be empty. At most 64 are drawn.
pub fn page(title: &str, charts: &[Chart], columns: usize) -> RgbImage {
    let charts = &charts[..charts.len().min(MAX_PANELS)];
    let columns = columns.clamp(1, charts.len().max(1));
    let rows = charts.len().div_ceil(columns);
    let top = if title.is_empty() { MARGIN } else { MARGIN + TITLE };
    let width = 2 * MARGIN + PANEL[0] * columns as i32;
    let mut canvas = Canvas::new(width, top + MARGIN + PANEL[1] * rows as i32);
    canvas.text(Font::Large, title, MARGIN + 4, MARGIN, DARK);
    for (i, chart) in charts.iter().enumerate() {
        let (column, row) = ((i % columns) as i32, (i / columns) as i32);
        let (x, y) = (MARGIN + column * PANEL[0], top + row * PANEL[1]);
        panel::draw(&mut canvas, chart, Rect { x, y, width: PANEL[0], height: PANEL[1] });
    }
    canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, f64)>, log: bool) -> Chart {
        let axis = Axis { title: "axis".into(), log, ..Axis::default() };
        Chart {
            title: "chart".into(),
            x: axis.clone(),
            y: axis,
            series: vec![Series::new("curve", points, Style::Both, PALETTE[0])],
            bands: vec![Band::new("band", 1.0, 2.0, BAND)],
        }
    }

    fn count(image: &RgbImage, colour: Colour) -> usize {
        image.rgb.chunks_exact(3).filter(|pixel| *pixel == colour).count()
    }

    #[test]
    fn odd_data_are_drawn_without_a_crash() {
        let nan = f64::NAN;
        for points in [
            vec![],
            vec![(nan, nan), (1.0, nan), (f64::INFINITY, 1.0)],
            vec![(1.0, 1.0)],
            vec![(0.0, 0.0), (0.0, 0.0)],
            vec![(-1e300, 1e300), (1e300, -1e300)],
            vec![(1e-300, 1e-300), (1.0, 1.0 + 1e-16)],
        ] {
            for log in [false, true] {
                let mut chart = chart(points.clone(), log);
                let image = page("", &[chart.clone()], 3);
                assert_eq!([image.width, image.height], [592, 432]);
                chart.bands = vec![Band::new("", nan, 1.0, BAND), Band::new("", 1.0, f64::INFINITY, BAND)];
                chart.series[0].error = vec![nan, -1.0, f64::INFINITY];
                chart.x.range = Some((nan, 1.0));
                chart.y.range = Some((2.0, 1.0));
                page("title", &[chart], 0);
            }
        }
        assert_eq!(page("", &[], 2).width, 592);
    }

    #[test]
    fn curves_and_bands_show_in_their_colour() {
        let image = page("", &[chart(vec![(1.0, 1.0), (10.0, 3.0)], false)], 1);
        assert!(count(&image, PALETTE[0]) > 300, "{}", count(&image, PALETTE[0]));
        assert!(count(&image, BAND) > 20_000);
        let none = page("", &[chart(vec![(f64::NAN, 1.0)], false)], 1);
        assert!(count(&none, PALETTE[0]) < 100);
    }

    #[test]
    fn larger_values_are_higher_up() {
        for log in [false, true] {
            let points = vec![(1.0, 1.0), (2.0, 1.0), (3.0, 9.0)];
            let mut chart = chart(points, log);
            chart.series[0].style = Style::Points;
            chart.series[0].label = String::new();
            let image = page("", &[chart], 1);
            let rows = |columns: std::ops::Range<u32>| {
                let blue = |row: &u32| columns.clone().any(|c| image.pixel(c, *row) == Some(PALETTE[0]));
                (0..image.height).find(blue).unwrap()
            };
            assert!(rows(0..400) > rows(400..592) + 150);
        }
    }
}
