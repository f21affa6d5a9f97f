//! Drawn pictures: each pixel holds the value whose light is the pattern's mean there (gratings, sweeps and squares are sampled at
//! pixel centres, letters by coverage).

use glam::DVec2;
use rayon::prelude::*;

use super::chart::{Layout, layouts, on_sheet};
use super::sloan::LETTERS;
use super::{Picture, ScreenView};
use crate::display::MOST_SIDE_PX;
use crate::experiment::{ChartRow, Pattern, RangeError, SizesHold, SloanChart, check_range};

/// Draws a pattern as large as it is to be seen.
pub fn draw(pattern: &Pattern, view: &ScreenView) -> Picture {
    let display = view.display;
    let (width, height) = (display.width_px, display.height_px);
    let charts = match pattern {
        Pattern::SloanChart(chart) => layouts(chart, view),
        _ => Vec::new(),
    };
    let mut rgb = vec![0.0_f32; 3 * width as usize * height as usize];
    rgb.par_chunks_exact_mut(3 * width as usize).zip(0..height).for_each(|(line, row)| {
        for (rgb, column) in line.chunks_exact_mut(3).zip(0..width) {
            let colour = match pattern {
                Pattern::SloanChart(chart) => chart_pixel(chart, &charts, view, [column, row]),
                _ => pixel(pattern, view, [column, row]),
            };
            rgb.copy_from_slice(&colour.map(|v| v as f32));
        }
    });
    Picture { width, height, rgb }
}

fn pixel(pattern: &Pattern, view: &ScreenView, [column, row]: [u32; 2]) -> [f64; 3] {
    let display = view.display;
    let middle = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
    match pattern {
        Pattern::Uniform { rgb } => *rgb,
        Pattern::Grating { cycles_per_degree, contrast, orientation_deg, phase_deg, sizes_hold } => {
            let at = match sizes_hold {
                SizesHold::AtGaze => view.linear_deg(middle),
                SizesHold::Everywhere => view.visual_deg(middle),
            };
            let (sin, cos) = orientation_deg.to_radians().sin_cos();
            let cycles = cycles_per_degree * (at.x * cos + at.y * sin);
            let light =
                0.5 * (1.0 + contrast * (std::f64::consts::TAU * cycles + phase_deg.to_radians()).cos());
            [display.curve().value(light.clamp(0.0, 1.0)); 3]
        }
        Pattern::Sweep { from_cycles_per_degree, to_cycles_per_degree, contrast, rgb, sizes_hold } => {
            // The phase is the integral of the frequency from the left edge.
            let [left, width] = view.edge_and_width_deg(*sizes_hold);
            let x = view.across_deg(middle, *sizes_hold) - left;
            let rise = (to_cycles_per_degree - from_cycles_per_degree) / width;
            let cycles = from_cycles_per_degree * x + 0.5 * rise * x * x;
            let light = 0.5 * (1.0 + contrast * (std::f64::consts::TAU * cycles).cos());
            let curve = display.curve();
            curve.values(curve.lights(*rgb).map(|of_colour| (light * of_colour).clamp(0.0, 1.0)))
        }
        Pattern::Checkerboard { square_px } => {
            let white = (column / square_px + row / square_px).is_multiple_of(2);
            [if white { 1.0 } else { 0.0 }; 3]
        }
        Pattern::Point { at_px, rgb } => {
            if *at_px == [column, row] {
                *rgb
            } else {
                [0.0; 3]
            }
        }
        // Drawn by `chart_pixel`.
        Pattern::SloanChart(chart) => chart.paper_rgb,
    }
}

fn chart_pixel(
    chart: &SloanChart,
    charts: &[Layout],
    view: &ScreenView,
    [column, row]: [u32; 2],
) -> [f64; 3] {
    let display = view.display;
    let lower = 2 * row >= display.height_px;
    let (layout, paper) = match chart.lower_paper_rgb {
        Some(paper) if lower => (charts.last(), paper),
        _ => (charts.first(), chart.paper_rgb),
    };
    let ink = layout.map_or(0.0, |l| l.coverage(column, row, |px| on_sheet(chart, view, px)));
    if ink <= 0.0 {
        return paper;
    }
    if ink >= 1.0 {
        return chart.ink_rgb;
    }
    let curve = display.curve();
    let (bright, dark) = (curve.lights(paper), curve.lights(chart.ink_rgb));
    curve.values(std::array::from_fn(|i| bright[i] * (1.0 - ink) + dark[i] * ink))
}

fn check_rgb(field: &str, rgb: [f64; 3]) -> Result<(), RangeError> {
    (0..3).try_for_each(|i| check_range(&format!("{field}[{i}]"), rgb[i], 0.0, 1.0))
}

impl Pattern {
    /// Whether red, green and blue are the same everywhere.
    pub fn is_gray(&self) -> bool {
        let gray = |rgb: &[f64; 3]| rgb.iter().all(|v| v.to_bits() == rgb[0].to_bits());
        match self {
            Self::Grating { .. } | Self::Checkerboard { .. } => true,
            Self::Uniform { rgb } | Self::Point { rgb, .. } | Self::Sweep { rgb, .. } => gray(rgb),
            Self::SloanChart(chart) => {
                gray(&chart.paper_rgb) && gray(&chart.ink_rgb) && chart.lower_paper_rgb.iter().all(gray)
            }
        }
    }

    /// Checks ranges for a display of columns and rows.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self, size_px: [u32; 2]) -> Result<(), RangeError> {
        match self {
            Self::Uniform { rgb } => check_rgb("video.pattern.uniform.rgb", *rgb),
            Self::Grating { cycles_per_degree, contrast, orientation_deg, phase_deg, .. } => {
                check_range("video.pattern.grating.cycles_per_degree", *cycles_per_degree, 0.0, 1000.0)?;
                check_range("video.pattern.grating.contrast", *contrast, 0.0, 1.0)?;
                check_range("video.pattern.grating.orientation_deg", *orientation_deg, -360.0, 360.0)?;
                check_range("video.pattern.grating.phase_deg", *phase_deg, -360.0, 360.0)
            }
            Self::Sweep { from_cycles_per_degree, to_cycles_per_degree, contrast, rgb, .. } => {
                check_range(
                    "video.pattern.sweep.from_cycles_per_degree",
                    *from_cycles_per_degree,
                    0.0,
                    1000.0,
                )?;
                check_range("video.pattern.sweep.to_cycles_per_degree", *to_cycles_per_degree, 0.0, 1000.0)?;
                check_range("video.pattern.sweep.contrast", *contrast, 0.0, 1.0)?;
                check_rgb("video.pattern.sweep.rgb", *rgb)
            }
            Self::Checkerboard { square_px } => check_range(
                "video.pattern.checkerboard.square_px",
                f64::from(*square_px),
                1.0,
                f64::from(MOST_SIDE_PX),
            ),
            Self::Point { at_px, rgb } => {
                for axis in 0..2 {
                    let field = format!("video.pattern.point.at_px[{axis}]");
                    check_range(&field, f64::from(at_px[axis]), 0.0, f64::from(size_px[axis] - 1))?;
                }
                check_rgb("video.pattern.point.rgb", *rgb)
            }
            Self::SloanChart(chart) => chart.validate(),
        }
    }
}

impl SloanChart {
    fn validate(&self) -> Result<(), RangeError> {
        let path = "video.pattern.sloan_chart";
        if self.rows.is_empty() || self.rows.len() > 64 {
            return Err(RangeError::new(&format!("{path}.rows"), self.rows.len(), "1 to 64 rows"));
        }
        for (i, ChartRow { letters, stroke_arcmin }) in self.rows.iter().enumerate() {
            check_range(&format!("{path}.rows[{i}].stroke_arcmin"), *stroke_arcmin, 1e-3, 600.0)?;
            if letters.is_empty() || letters.len() > 100 || letters.chars().any(|c| !LETTERS.contains(c)) {
                let allowed = format!("1 to 100 letters of {LETTERS}");
                return Err(RangeError::new(&format!("{path}.rows[{i}].letters"), letters, &allowed));
            }
        }
        check_rgb(&format!("{path}.paper_rgb"), self.paper_rgb)?;
        check_rgb(&format!("{path}.ink_rgb"), self.ink_rgb)?;
        self.lower_paper_rgb.map_or(Ok(()), |rgb| check_rgb(&format!("{path}.lower_paper_rgb"), rgb))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{
        Channel, Display, EmissionLaw, Panel, Placement, Primary, Transfer, Waveform, White,
    };
    use crate::experiment::Gaze;
    use crate::spectrum::Spectrum;
    use crate::video::{logmar_rows, paper_rows};

    /// A print of 1200 dpi at 50 cm.
    fn display(width_px: u32, height_px: u32) -> Display {
        Display {
            width_px,
            height_px,
            pixel_pitch_cm: 2.54 / 1200.0,
            distance_cm: 50.0,
            placement: Placement::Frontal,
            white: White::LuminanceCdM2(100.0),
            frame_rate_hz: 60.0,
            transfer: Transfer::Linear,
            black: 0.0,
            panel: Panel::default(),
            emission_law: EmissionLaw::Lambertian,
            primaries: vec![Primary {
                channel: Channel::White,
                spectrum: Spectrum::EqualEnergy,
                power: 1.0,
                rects: vec![[0.0, 0.0, 1.0, 1.0]],
                offset_px: [0.0; 2],
                spot_sd_px: 0.0,
                waveform: Waveform::Steady,
            }],
        }
    }

    /// Red of a picture, `[row][column]`.
    fn red(pattern: &Pattern, display: &Display) -> Vec<Vec<f32>> {
        let centre = [0.5 * f64::from(display.width_px), 0.5 * f64::from(display.height_px)];
        let picture = draw(pattern, &ScreenView::frontal(display, &Gaze::still(centre)));
        picture
            .rgb
            .chunks_exact(3 * display.width_px as usize)
            .map(|r| r.iter().step_by(3).copied().collect())
            .collect()
    }

    fn chart(rows: Vec<ChartRow>, lower_paper_rgb: Option<[f64; 3]>) -> Pattern {
        Pattern::SloanChart(SloanChart {
            rows,
            paper_rgb: [1.0; 3],
            ink_rgb: [0.0; 3],
            lower_paper_rgb,
            sizes_hold: SizesHold::AtGaze,
        })
    }

    /// A sweep from 0 to f over a width w has f·w/2 cycles.
    #[test]
    fn a_sweep_has_its_cycles() {
        let display = display(720, 3);
        let pattern = Pattern::Sweep {
            from_cycles_per_degree: 0.0,
            to_cycles_per_degree: 40.0,
            contrast: 1.0,
            rgb: [1.0; 3],
            sizes_hold: SizesHold::AtGaze,
        };
        let row = &red(&pattern, &display)[1];
        let crossings = row.windows(2).filter(|p| (p[0] - 0.5) * (p[1] - 0.5) < 0.0).count();
        let width_deg = 720.0 * display.pixel_radians().to_degrees();
        assert!((crossings as f64 - 40.0 * width_deg).abs() <= 1.0, "{crossings}");
        assert!(row[0] > 0.99, "a maximum at the left edge");
    }

    /// An E of 20/20 strokes of 10 arcmin at this distance: rows of ink where bars are, size in pixels, light by area.
    #[test]
    fn letters_have_their_size() {
        let display = display(500, 500);
        let stroke_px = (10.0_f64 / 60.0).to_radians().tan() * 50.0 / (2.54 / 1200.0);
        let rows = vec![ChartRow { letters: "E".into(), stroke_arcmin: 10.0 }];
        let picture = red(&chart(rows, None), &display);
        let ink: f64 = picture.iter().flatten().map(|v| 1.0 - f64::from(*v)).sum();
        assert!((ink / (17.0 * stroke_px * stroke_px) - 1.0).abs() < 2e-3, "{ink}");
        // Down a column through the bars: ink, paper, ink, paper, ink.
        let column: Vec<bool> = picture.iter().map(|row| row[250] < 0.5).collect();
        let runs: Vec<usize> = column.chunk_by(|a, b| a == b).map(<[bool]>::len).collect();
        assert_eq!(runs.len(), 7);
        assert!(runs[1..6].iter().all(|run| (*run as f64 - stroke_px).abs() <= 1.0), "{runs:?}");
    }

    /// A row of letters of 20.8°: at the gaze's scale it is even in pixels, everywhere its end is at the
    /// tangent of 10.4°.
    #[test]
    fn letters_have_their_size_everywhere() {
        let mut display = display(2400, 64);
        display.pixel_pitch_cm = 0.03;
        let row = |sizes_hold| {
            let rows = vec![ChartRow { letters: "EEEEEEEEEEEEE".into(), stroke_arcmin: 10.0 }];
            let chart = SloanChart {
                rows,
                paper_rgb: [1.0; 3],
                ink_rgb: [0.0; 3],
                lower_paper_rgb: None,
                sizes_hold,
            };
            // The upper bar of the letters, 1.5 to 2.5 strokes above the gaze.
            red(&Pattern::SloanChart(chart), &display)[32 - 9].clone()
        };
        let distance_px = display.distance_cm / display.pixel_pitch_cm;
        let last_ink = |row: &[f32]| row.iter().rposition(|v| *v < 0.5).unwrap() as f64 + 1.0 - 1200.0;
        // Thirteen letters and twelve gaps are 125 strokes, of which half are on the right.
        let right_deg = 62.5 * 10.0 / 60.0;
        let flat = distance_px * (10.0_f64 / 60.0).to_radians().tan() * right_deg * 6.0;
        assert!((last_ink(&row(SizesHold::AtGaze)) - flat).abs() < 1.5, "{flat}");
        let everywhere = distance_px * right_deg.to_radians().tan();
        let found = last_ink(&row(SizesHold::Everywhere));
        assert!((found - everywhere).abs() < 1.5 && everywhere > flat + 2.0, "{found} {everywhere} {flat}");
    }

    /// The standard chart: the largest letters at 50 arcmin, each row smaller by 10^0.1; the paper's chart twice on one sheet.
    #[test]
    fn charts_are_laid_out() {
        let rows = logmar_rows();
        assert_eq!(rows.len(), 14);
        assert!(
            (rows[0].stroke_arcmin - 10.0).abs() < 1e-12 && (rows[13].stroke_arcmin - 0.501_187).abs() < 1e-6
        );
        for row in &rows {
            let distinct: std::collections::BTreeSet<char> = row.letters.chars().collect();
            assert_eq!(distinct.len(), 5, "{}", row.letters);
        }
        let display = display(720, 720);
        let twice = red(&chart(paper_rows(), Some([0.5; 3])), &display);
        let inked = |rows: std::ops::Range<usize>, paper: f32| {
            twice[rows].iter().flatten().map(|v| f64::from((paper - v) / paper)).sum::<f64>()
        };
        let (upper, lower) = (inked(0..360, 1.0), inked(360..720, 0.5));
        assert!(upper > 1e4 && (upper / lower - 1.0).abs() < 0.02, "{upper} {lower}");
        assert!(twice[0][0] > 0.99 && (twice[719][0] - 0.5).abs() < 1e-6);
    }
}
