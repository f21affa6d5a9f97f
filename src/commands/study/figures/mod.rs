//! `study figures`: the paper's Figures 12 to 16, drawn large, with what can be read off them: the cut-off of the sweep, the letters that an
//! observer without knowledge of the eye reads, and how much better the mean of five frames shows them.

mod run;

use glam::DVec2;
use photoneye_eye::experiment::{Pattern, Video};
use photoneye_eye::video::reader::read_row;
use photoneye_eye::video::{Limits, PlacedLetter, ScreenView, decode_png, placed_letters, sweep};
use serde_json::{Value, json};

use super::Task;
use super::page::{Page, Table};
use crate::failure::Failure;
use crate::row;
use run::Figure;

const FACE: (&str, &[u8]) = (
    include_str!("../../../../data/experiments/face.json"),
    include_bytes!("../../../../data/experiments/face.png"),
);
const FIG_13: &str = include_str!("../../../../data/experiments/fig13.json");
const FIG_14: &str = include_str!("../../../../data/experiments/fig14.json");
const FIG_15: &str = include_str!("../../../../data/experiments/fig15.json");
const FIG_16: &str = include_str!("../../../../data/experiments/fig16.json");

/// Fills the page.
///
/// # Errors
/// When an experiment cannot be computed or drawn.
pub fn study(task: &mut Task, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "Figures 12 to 16",
        "Each cone is filled with its count per area; the picture stands as the viewer sees the screen. Letters are read by correlation with \
         sharp drawings of the eleven letters, at the nearest cone's signal (count over the usual count of its type and aperture).",
    );
    let side = task.pick(1400, 300);
    let mut figure = |name: &str, text: &str| -> Result<Figure, Failure> {
        task.say(name);
        Figure::new(parsed(text)?, None).map_err(Failure::failed)
    };
    let mut face = parsed(FACE.0)?;
    face["video"] = json!({"pattern": {"uniform": {"rgb": [0, 0, 0]}}});
    let picture = decode_png(FACE.1, Limits::default()).map_err(Failure::failed)?;
    let face = Figure::new(face, Some(picture)).map_err(Failure::failed)?;
    let thirteen = figure("Figure 13", FIG_13)?;
    let fourteen = figure("Figure 14", FIG_14)?;
    let fifteen = figure("Figure 15", FIG_15)?;
    let sixteen = figure("Figure 16", FIG_16)?;
    let mut still = parsed(FIG_16)?;
    still["gaze"] = json!({"movement": {"still": {}}});
    let still = Figure::new(still, None).map_err(Failure::failed)?;

    let mut draw = |name: &str, caption: &str, figure: &Figure, frame: usize| -> Result<(), Failure> {
        page.picture(name, caption, figure.image(frame, side).map_err(Failure::failed)?);
        Ok(())
    };
    draw("figure12", "Figure 12: a face of 30 x 30 pixels, fill factor 0.8, for 1/60 s.", &face, 0)?;
    draw("figure13", "Figure 13: the chart, upper half 543 nm, lower half broadband.", &thirteen, 0)?;
    draw("figure14", &cut_off(&fourteen), &fourteen, 0)?;
    draw(
        "figure15",
        "Figure 15: the chart under a vertical drift of 2 degrees per second, 543 nm.",
        &fifteen,
        0,
    )?;
    for frame in 0..5 {
        let caption =
            format!("Figure 16, frame {}: the 20/12 row under a drift of 30 arcmin per second.", frame + 1);
        draw(&format!("figure16-{}", frame + 1), &caption, &sixteen, frame)?;
    }
    draw("figure16-still", "Figure 16: one frame of an eye at rest.", &still, 0)?;
    page.table(rows_read(&thirteen, &fifteen));
    page.table(mean_of_five(&sixteen, &still));
    Ok(())
}

fn parsed(text: &str) -> Result<Value, Failure> {
    serde_json::from_str(text).map_err(Failure::failed)
}

fn letters(figure: &Figure) -> Vec<PlacedLetter> {
    match &figure.experiment.video {
        Video::Pattern(Pattern::SloanChart(chart)) => ScreenView::of(&figure.experiment)
            .map_or_else(|_| Vec::new(), |view| placed_letters(chart, &view)),
        Video::Pattern(_) | Video::Clip(_) => Vec::new(),
    }
}

/// Figure 14's caption with the cut-off in it.
fn cut_off(figure: &Figure) -> String {
    let Video::Pattern(Pattern::Sweep { from_cycles_per_degree, to_cycles_per_degree, .. }) =
        figure.experiment.video
    else {
        return "Figure 14".into();
    };
    let size = figure.size_deg();
    let range = [from_cycles_per_degree, to_cycles_per_degree];
    let contrasts = sweep::contrasts(&figure.signals(0, |_, _| true), -0.5 * size.x, size.x, range);
    let at = |level| sweep::cut_off(&contrasts, level).map_or("-".to_owned(), |cpd| format!("{cpd:.1}"));
    format!(
        "Figure 14: sweep from 0 to 80 cycles per degree at 543 nm; contrast 0.5 is left at {}, 0.2 at {}, 0.1 at {} cycles per degree.",
        at(0.5),
        at(0.2),
        at(0.1)
    )
}

/// Letters read in each row of Figures 13 and 15.
fn rows_read(thirteen: &Figure, fifteen: &Figure) -> Table {
    let columns = ["chart", "row", "letters", "read right", "correlation with the right letters"];
    let mut table = Table::new("letters", "Letters read", &columns);
    let all = letters(thirteen);
    let rows = all.iter().map(|l| l.row + 1).max().unwrap_or(0);
    // Each chart's signals are those of its half: its light is its own.
    let charts = [
        ("Figure 13, 543 nm", thirteen, 0..rows / 2, thirteen.seen(0, |_, y| y > 0.0)),
        ("Figure 13, broadband", thirteen, rows / 2..rows, thirteen.seen(0, |_, y| y < 0.0)),
        ("Figure 15, 2 degrees/s", fifteen, 0..rows / 2, fifteen.seen(0, |_, _| true)),
    ];
    for (name, figure, rows, seen) in charts {
        let all = letters(figure);
        for row in rows {
            let of_row: Vec<PlacedLetter> = all.iter().filter(|l| l.row == row).copied().collect();
            let snellen = of_row.first().map_or(f64::NAN, |l| 20.0 * 60.0 * l.stroke_deg);
            let (right, correlation) = read_row(std::slice::from_ref(&seen), &of_row);
            table.push(row![name, format!("20/{snellen:.0}"), of_row.len(), right, correlation]);
        }
    }
    table
}

/// Figure 16 in numbers.
fn mean_of_five(moving: &Figure, still: &Figure) -> Table {
    let mut table = Table::new(
        "mean-of-five",
        "Figure 16",
        &["what", "read right", "correlation with the right letters"],
    );
    let letters = letters(moving);
    let frames: Vec<_> = (0..moving.frames()).map(|frame| moving.seen(frame, |_, _| true)).collect();
    for (i, frame) in frames.iter().enumerate() {
        let (right, correlation) = read_row(std::slice::from_ref(frame), &letters);
        table.push(row![format!("frame {}", i + 1), right, correlation]);
    }
    let (right, correlation) = read_row(&frames, &letters);
    table.push(row!["mean of five, moved back", right, correlation]);
    let (right, correlation) = read_row(&[still.seen(0, |_, _| true)], &letters);
    table.push(row!["one frame of an eye at rest", right, correlation]);
    table
}

/// Degrees of a tangent on each axis.
fn degrees(tangent: DVec2) -> DVec2 {
    DVec2::new(tangent.x.atan(), tangent.y.atan()) * 1_f64.to_degrees()
}
