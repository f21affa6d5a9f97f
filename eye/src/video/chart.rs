//! Letter charts: rows of Sloan letters, sized in visual minutes, drawn as coverage of each pixel.
//!
//! Rows are centred, the gap between letters is one letter, the gap between rows is the height of the lower row (Bailey & Lovie 1976;
//! ETDRS). A letter is 5 strokes high; a stroke of 1 arcmin is logMAR 0, 20/20. The paper's chart is not printed with its sizes; the layout
//! here has a row of E and rows of ten letters from 20/40 to 20/10 that hold its lines 20/15 and 20/12.

use glam::DVec2;

use super::ScreenView;
use super::sloan;
use crate::experiment::{ChartRow, SizesHold, SloanChart};

/// Samples across a pixel for its coverage.
const SAMPLES: u32 = 4;

/// Rows from logMAR +1.0 to -0.3 in steps of 0.1, five letters each, no letter twice in a row.
pub fn logmar_rows() -> Vec<ChartRow> {
    let letters = [
        "NCKZO", "RHSDK", "DOVHR", "CZRHS", "ONHRC", "DKSNV", "ZSOKN", "CKDNR", "SRZKD", "HZOVC", "NVDOK",
        "VHCNO", "SVHCZ", "OZDVK",
    ];
    let row = |(i, letters): (i32, &str)| ChartRow {
        letters: letters.into(),
        stroke_arcmin: 10_f64.powf(1.0 - 0.1 * f64::from(i)),
    };
    (0..).zip(letters).map(row).collect()
}

/// The rows of Figures 13 and 15: large E, then 20/30 to 20/10.
pub fn paper_rows() -> Vec<ChartRow> {
    let rows = [
        ("EEEEE", 30.0),
        ("NCKZO", 25.0),
        ("RHSDK", 20.0),
        ("DOVHR", 15.0),
        ("CZRHS", 12.0),
        ("ONHRC", 10.0),
    ];
    rows.iter()
        .map(|(letters, snellen)| ChartRow { letters: (*letters).into(), stroke_arcmin: snellen / 20.0 })
        .collect()
}

/// A row as it lies on the sheet of the chart: pixels, y down. The sheet is the screen, or where sizes hold
/// everywhere that of visual angles with the gaze centre in the same place.
struct Placed<'a> {
    letters: Vec<char>,
    row: &'a ChartRow,
    /// Left and top.
    corner: DVec2,
    stroke_px: f64,
}

/// A chart on the screen.
pub struct Layout<'a> {
    rows: Vec<Placed<'a>>,
}

impl<'a> Layout<'a> {
    /// Places the rows around a point of the screen (pixels).
    pub fn new(chart: &'a SloanChart, view: &ScreenView, centre_px: DVec2) -> Self {
        let arcmin_px = view.px_per_arcmin();
        let centre_px = on_sheet(chart, view, centre_px);
        let letter = |row: &ChartRow| 5.0 * row.stroke_arcmin * arcmin_px;
        let gaps: f64 = chart.rows.iter().skip(1).map(letter).sum();
        let height: f64 = chart.rows.iter().map(letter).sum::<f64>() + gaps;
        let mut top = centre_px.y - 0.5 * height;
        let mut rows: Vec<Placed> = Vec::with_capacity(chart.rows.len());
        for row in &chart.rows {
            if !rows.is_empty() {
                top += letter(row);
            }
            let letters: Vec<char> = row.letters.chars().collect();
            let width = (2 * letters.len()).saturating_sub(1) as f64 * letter(row);
            let corner = DVec2::new(centre_px.x - 0.5 * width, top);
            rows.push(Placed { letters, row, corner, stroke_px: letter(row) / 5.0 });
            top += letter(row);
        }
        Self { rows }
    }

    /// Share of a pixel that is ink; `sheet` gives the place on the sheet of a point of the screen (pixels).
    pub fn coverage(&self, column: u32, row: u32, sheet: impl Fn(DVec2) -> DVec2) -> f64 {
        let pixel = DVec2::new(f64::from(column), f64::from(row));
        let corners =
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|c| sheet(pixel + DVec2::from_array(c)));
        let [min, max] = [DVec2::min, DVec2::max].map(|f| corners.into_iter().fold(corners[0], f));
        let near = |p: &&Placed| {
            let (top, bottom) = (p.corner.y - 1.0, p.corner.y + 5.0 * p.stroke_px + 1.0);
            min.y >= top && min.y <= bottom && !p.row.letters.is_empty()
        };
        let Some(placed) = self.rows.iter().find(near) else {
            return 0.0;
        };
        // Beside all letters, or between two: nothing to look at.
        let [left, right] = [min.x, max.x].map(|x| (x - placed.corner.x) / placed.stroke_px);
        let begins = 10.0 * (left / 10.0).floor();
        let between = left - begins >= 5.0 && right <= begins + 10.0;
        if right <= 0.0 || left >= 10.0 * placed.letters.len() as f64 || between {
            return 0.0;
        }
        let mut inked = 0;
        for i in 0..SAMPLES * SAMPLES {
            let part =
                DVec2::new(f64::from(i % SAMPLES) + 0.5, f64::from(i / SAMPLES) + 0.5) / f64::from(SAMPLES);
            let at = (sheet(pixel + part) - placed.corner) / placed.stroke_px;
            // Letters stand every ten strokes.
            let letter = (at.x / 10.0).floor();
            if at.x < 0.0 || letter as usize >= placed.letters.len() {
                continue;
            }
            let inside = DVec2::new(at.x - 10.0 * letter, 5.0 - at.y);
            if inside.x >= 5.0 {
                continue;
            }
            inked += u32::from(sloan::ink(placed.letters[letter as usize], inside));
        }
        f64::from(inked) / f64::from(SAMPLES * SAMPLES)
    }
}

/// Where a point of the screen (pixels) is on the sheet of a chart.
pub fn on_sheet(chart: &SloanChart, view: &ScreenView, px: DVec2) -> DVec2 {
    match chart.sizes_hold {
        SizesHold::AtGaze => px,
        SizesHold::Everywhere => {
            let seen_deg = view.visual_deg(px);
            view.gaze_px + 60.0 * view.px_per_arcmin() * DVec2::new(seen_deg.x, -seen_deg.y)
        }
    }
}

/// The chart or charts of a pattern: one around the gaze centre, or one in each half of the screen.
pub fn layouts<'a>(chart: &'a SloanChart, view: &ScreenView) -> Vec<Layout<'a>> {
    if chart.lower_paper_rgb.is_none() {
        return vec![Layout::new(chart, view, view.gaze_px)];
    }
    let size = DVec2::new(f64::from(view.display.width_px), f64::from(view.display.height_px));
    [0.25, 0.75].map(|part| Layout::new(chart, view, size * DVec2::new(0.5, part))).into()
}

/// A letter as the viewer sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedLetter {
    /// The letter.
    pub letter: char,
    /// Its row of the chart, from 0 at the top; rows of a second chart follow those of the first.
    pub row: usize,
    /// Its lower left corner, degrees right and up from the gaze centre.
    pub corner_deg: DVec2,
    /// Width of a stroke, degrees.
    pub stroke_deg: f64,
}

/// Where the letters of a chart, or of its two charts, are seen.
pub fn placed_letters(chart: &SloanChart, view: &ScreenView) -> Vec<PlacedLetter> {
    let [_, px_deg] = view.pixel_deg();
    let mut letters = Vec::new();
    let rows = layouts(chart, view).into_iter().flat_map(|layout| layout.rows);
    for (row, placed) in rows.enumerate() {
        for (i, letter) in placed.letters.iter().enumerate() {
            let corner_px = placed.corner + placed.stroke_px * DVec2::new(10.0 * i as f64, 5.0);
            letters.push(PlacedLetter {
                letter: *letter,
                row,
                corner_deg: match chart.sizes_hold {
                    SizesHold::AtGaze => view.linear_deg(corner_px),
                    SizesHold::Everywhere => {
                        let seen = (corner_px - view.gaze_px) / (60.0 * view.px_per_arcmin());
                        DVec2::new(seen.x, -seen.y)
                    }
                },
                stroke_deg: placed.stroke_px * px_deg,
            });
        }
    }
    letters
}
