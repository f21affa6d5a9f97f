//! One chart in its rectangle: title, legend, axes with numbers, reference bands, curves.

use super::canvas::{Canvas, Colour, Rect};
use super::scale::Scale;
use super::text::{Font, width_of};
use super::ticks::{Tick, ticks};
use super::{Band, Chart, DARK, Series, Style};

const FRAME: Colour = [120; 3];
const GRID: Colour = [232; 3];
const GREY: Colour = [110; 3];
/// Lines of curves, pixels.
const LINE: f64 = 1.8;
const DOT: f64 = 2.9;
/// Strokes and gaps of a broken line, pixels.
const DASH: [f64; 2] = [6.0, 4.0];
/// Height of a row of the legend, width of its samples, pixels.
const LEGEND: [i32; 2] = [19, 22];
/// Room at the right and at the upper edge of a panel, pixels.
const PAD: [i32; 2] = [22, 8];
/// Pixels per number on an axis.
const PER_TICK: [i32; 2] = [75, 45];
/// Least room for the numbers of the vertical axis, so that panels above each other align, and about all the room beside a plot, pixels.
const NUMBERS: i32 = 49;
const SIDES: i32 = 110;

/// The rectangle of the curves and the two axes.
struct Plot {
    area: Rect,
    x: Scale,
    y: Scale,
}

impl Plot {
    fn column(&self, place: f64) -> f64 {
        f64::from(self.area.x) + place * f64::from(self.area.width)
    }

    fn row(&self, place: f64) -> f64 {
        f64::from(self.area.bottom()) - place * f64::from(self.area.height)
    }

    /// Pixel of a point; `None` when it cannot be shown.
    fn pixel(&self, point: (f64, f64)) -> Option<[f64; 2]> {
        Some([self.column(self.x.place(point.0)?), self.row(self.y.place(point.1)?)])
    }
}

/// Draws a chart.
pub fn draw(canvas: &mut Canvas, chart: &Chart, area: Rect) {
    let (x, y) = scales(chart);
    let entries = legend_rows(chart, area.width - SIDES);
    let below = area.y + PAD[1] + Font::Bold.height() + 4 + LEGEND[0] * entries.len().max(1) as i32 + 6;
    let bottom = area.bottom() - 12 - 2 * Font::Small.height() - 10;
    let y_ticks = ticks(y.from, y.to, y.log, ((bottom - below) / PER_TICK[1]) as usize);
    let widest = y_ticks.iter().map(|tick| width_of(Font::Small, &tick.label)).fold(NUMBERS, i32::max);
    let left = area.x + Font::Small.height() + 10 + widest + 8;
    let plot = Plot {
        area: Rect { x: left, y: below, width: area.right() - PAD[0] - left, height: bottom - below },
        x,
        y,
    };
    let x_ticks = ticks(x.from, x.to, x.log, (plot.area.width / PER_TICK[0]) as usize);
    for band in chart.bands.iter().filter(|band| !is_mark(band)) {
        draw_band(canvas, &plot, band);
    }
    draw_axes(canvas, &plot, &x_ticks, &y_ticks);
    for mark in chart.bands.iter().filter(|band| is_mark(band)) {
        draw_band(canvas, &plot, mark);
    }
    draw_titles(canvas, chart, &plot, area);
    for (row, entries) in entries.iter().enumerate() {
        draw_legend(
            canvas,
            entries,
            left,
            area.y + PAD[1] + Font::Bold.height() + 5 + row as i32 * LEGEND[0],
        );
    }
    let mut any = false;
    for series in &chart.series {
        any |= draw_series(canvas, &plot, series);
    }
    if !any {
        let text = "no data";
        let x = plot.area.x + (plot.area.width - width_of(Font::Small, text)) / 2;
        canvas.text(Font::Small, text, x, plot.area.y + plot.area.height / 2 - 8, GREY);
    }
}

/// Axes that hold all that can be shown; bands count along y only.
fn scales(chart: &Chart) -> (Scale, Scale) {
    let points = || chart.series.iter().flat_map(|series| series.points.iter());
    let shown = |value: f64, log: bool| value.is_finite() && (!log || value > 0.0);
    let both = |p: &&(f64, f64)| shown(p.0, chart.x.log) && shown(p.1, chart.y.log);
    let bars = chart.series.iter().flat_map(|series| {
        series.points.iter().zip(&series.error).flat_map(|(p, error)| [p.1 - error, p.1 + error])
    });
    let bands = chart.bands.iter().flat_map(|band| [band.from, band.to]);
    let x = Scale::new(&chart.x, points().filter(both).map(|p| p.0));
    let y = Scale::new(&chart.y, points().filter(both).map(|p| p.1).chain(bars).chain(bands));
    (x, y)
}

fn draw_band(canvas: &mut Canvas, plot: &Plot, band: &Band) {
    if band.from.is_nan() || band.to.is_nan() {
        return;
    }
    // An end that the axis cannot show lies beyond the axis.
    let place = |scale: &Scale, value: f64| {
        scale.place(value).unwrap_or(if value > 0.0 { 1.0 } else { 0.0 }).clamp(0.0, 1.0)
    };
    let (from, to) = band.x.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
    let [left, right] = [from, to].map(|value| plot.column(place(&plot.x, value)));
    let [low, high] = [band.from, band.to].map(|value| plot.row(place(&plot.y, value)));
    if is_mark(band) {
        let inside = plot.y.place(band.from).is_some_and(|place| (0.0..=1.0).contains(&place));
        if inside && left < right {
            broken(canvas, plot.area, &[[left, low], [right, low]], 1.4, band.colour);
        }
    } else {
        canvas.fill(plot.area, [left, high], [right, low], band.colour);
    }
}

fn is_mark(band: &Band) -> bool {
    band.from.total_cmp(&band.to).is_eq()
}

fn draw_axes(canvas: &mut Canvas, plot: &Plot, x_ticks: &[Tick], y_ticks: &[Tick]) {
    let area = plot.area;
    let page = canvas.area();
    let [left, top, right, bottom] = [area.x, area.y, area.right(), area.bottom()].map(f64::from);
    let placed = |scale: &Scale, tick: &Tick| scale.place(tick.at).map(|place| place.clamp(0.0, 1.0));
    let mut free_from = i32::MIN;
    for tick in x_ticks {
        let Some(column) = placed(&plot.x, tick).map(|place| plot.column(place)) else { continue };
        let long = if tick.label.is_empty() { 3.0 } else { 6.0 };
        if !tick.label.is_empty() {
            canvas.fill(area, [column - 0.5, top], [column + 0.5, bottom], GRID);
        }
        canvas.fill(page, [column - 0.5, bottom], [column + 0.5, bottom + long], FRAME);
        let width = width_of(Font::Small, &tick.label);
        let x = column as i32 - width / 2;
        if x >= free_from {
            canvas.text(Font::Small, &tick.label, x, area.bottom() + 7, DARK);
            free_from = if width > 0 { x + width + 8 } else { free_from };
        }
    }
    let mut free_above = i32::MAX;
    for tick in y_ticks {
        let Some(row) = placed(&plot.y, tick).map(|place| plot.row(place)) else { continue };
        let long = if tick.label.is_empty() { 3.0 } else { 6.0 };
        if !tick.label.is_empty() {
            canvas.fill(area, [left, row - 0.5], [right, row + 0.5], GRID);
        }
        canvas.fill(page, [left - long, row - 0.5], [left, row + 0.5], FRAME);
        let y = row as i32 - Font::Small.height() / 2;
        if y + Font::Small.height() <= free_above {
            let x = area.x - 9 - width_of(Font::Small, &tick.label);
            canvas.text(Font::Small, &tick.label, x, y, DARK);
            free_above = if tick.label.is_empty() { free_above } else { y };
        }
    }
    for (a, b) in [
        ([left - 0.5, top], [left + 0.5, bottom + 0.5]),
        ([left, bottom - 0.5], [right, bottom + 0.5]),
        ([right - 0.5, top], [right + 0.5, bottom]),
        ([left, top - 0.5], [right, top + 0.5]),
    ] {
        canvas.fill(page, a, b, FRAME);
    }
}

fn draw_titles(canvas: &mut Canvas, chart: &Chart, plot: &Plot, area: Rect) {
    canvas.text(Font::Bold, &chart.title, plot.area.x, area.y + PAD[1], DARK);
    let x = plot.area.x + (plot.area.width - width_of(Font::Small, &chart.x.title)) / 2;
    canvas.text(Font::Small, &chart.x.title, x, plot.area.bottom() + 9 + Font::Small.height(), DARK);
    let long = width_of(Font::Small, &chart.y.title);
    let y = plot.area.y + i32::midpoint(plot.area.height, long);
    canvas.text_upwards(Font::Small, &chart.y.title, area.x + 2, y, DARK);
}

/// What stands before a name in the legend.
enum Sample<'a> {
    Series(&'a Series),
    Band(&'a Band),
}

struct Entry<'a> {
    sample: Sample<'a>,
    label: &'a str,
}

/// Entries of the legend in rows no wider than given.
fn legend_rows(chart: &Chart, width: i32) -> Vec<Vec<Entry<'_>>> {
    let series = chart.series.iter().map(|s| Entry { sample: Sample::Series(s), label: &s.label });
    let bands = chart.bands.iter().map(|b| Entry { sample: Sample::Band(b), label: &b.label });
    let mut rows: Vec<Vec<Entry>> = Vec::new();
    let mut used = 0;
    for entry in series.chain(bands).filter(|entry| !entry.label.is_empty()) {
        let wide = entry_width(entry.label);
        used += wide;
        if let Some(row) = rows.last_mut().filter(|_| used <= width) {
            row.push(entry);
        } else {
            used = wide;
            rows.push(vec![entry]);
        }
    }
    rows
}

fn entry_width(label: &str) -> i32 {
    LEGEND[1] + 6 + width_of(Font::Small, label) + 12
}

fn draw_legend(canvas: &mut Canvas, entries: &[Entry], left: i32, y: i32) {
    let page = canvas.area();
    let mut x = left;
    for entry in entries {
        let middle = f64::from(y) + 0.5 * f64::from(Font::Small.height());
        let ends = [[f64::from(x), middle], [f64::from(x + LEGEND[1]), middle]];
        match entry.sample {
            Sample::Series(series) => {
                line_of(canvas, page, &ends, series);
                if matches!(series.style, Style::Points | Style::Both) {
                    canvas.dot(page, [f64::from(x) + 0.5 * f64::from(LEGEND[1]), middle], DOT, series.colour);
                }
            }
            Sample::Band(band) if is_mark(band) => broken(canvas, page, &ends, 1.4, band.colour),
            Sample::Band(band) => {
                let [a, b] = ends;
                canvas.fill(page, [a[0], middle - 6.0], [b[0], middle + 6.0], band.colour);
            }
        }
        canvas.text(Font::Small, entry.label, x + LEGEND[1] + 6, y, DARK);
        x += entry_width(entry.label);
    }
}

/// Whether any point could be shown.
fn draw_series(canvas: &mut Canvas, plot: &Plot, series: &Series) -> bool {
    let pixels: Vec<Option<[f64; 2]>> = series.points.iter().map(|point| plot.pixel(*point)).collect();
    for (point, error) in series.points.iter().zip(&series.error) {
        draw_error(canvas, plot, *point, *error, series.colour);
    }
    for part in pixels.split(Option::is_none) {
        let part: Vec<[f64; 2]> = part.iter().flatten().copied().collect();
        line_of(canvas, plot.area, &part, series);
    }
    let dots = matches!(series.style, Style::Points | Style::Both);
    for pixel in pixels.iter().flatten().filter(|_| dots) {
        canvas.dot(plot.area, *pixel, DOT, series.colour);
    }
    pixels.iter().any(Option::is_some)
}

fn line_of(canvas: &mut Canvas, clip: Rect, pixels: &[[f64; 2]], series: &Series) {
    match series.style {
        Style::Points => {}
        Style::Dashed => broken(canvas, clip, pixels, LINE, series.colour),
        Style::Line | Style::Both => {
            for ends in pixels.windows(2) {
                canvas.line(clip, ends[0], ends[1], LINE, series.colour);
            }
        }
    }
}

fn draw_error(canvas: &mut Canvas, plot: &Plot, point: (f64, f64), error: f64, colour: Colour) {
    if !(error.is_finite() && error > 0.0) {
        return;
    }
    let Some([column, top]) = plot.pixel((point.0, point.1 + error)) else { return };
    // On a logarithmic axis the lower end may be nowhere.
    let bottom = plot.pixel((point.0, point.1 - error)).map_or(f64::from(plot.area.bottom()), |p| p[1]);
    for (from, to) in [
        ([column, top], [column, bottom]),
        ([column - 3.0, top], [column + 3.0, top]),
        ([column - 3.0, bottom], [column + 3.0, bottom]),
    ] {
        canvas.line(plot.area, from, to, 1.0, colour);
    }
}

/// A broken line through points; strokes go on round corners. What is far outside is not followed.
fn broken(canvas: &mut Canvas, clip: Rect, pixels: &[[f64; 2]], width: f64, colour: Colour) {
    let period = DASH[0] + DASH[1];
    let mut walked = 0.0;
    for ends in pixels.windows(2) {
        let along = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
        let length = along[0].hypot(along[1]);
        if length > 20_000.0 || length <= 0.0 {
            continue;
        }
        let at = |t: f64| [ends[0][0] + along[0] * t / length, ends[0][1] + along[1] * t / length];
        let mut from = -(walked % period);
        while from < length {
            let (a, b) = (from.max(0.0), (from + DASH[0]).min(length));
            if a < b {
                canvas.line(clip, at(a), at(b), width, colour);
            }
            from += period;
        }
        walked += length;
    }
}
