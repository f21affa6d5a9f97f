//! The paper's Figures 13, 14 and 16 in small: what the cones' counts hold of letters and stripes, by an observer without knowledge of the
//! eye's optics (`video::reader`) and by a fit (`video::sweep`).

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "tests fail by panicking")]

mod support;

use glam::DVec2;
use photoneye_eye::display::{Channel, Levels, Panel, Transfer, White};
use photoneye_eye::experiment::{ChartRow, Experiment, Gaze, Movement, Pattern, SizesHold, SloanChart};
use photoneye_eye::exposure::{ConeColumns, FrameCounts, cone_columns};
use photoneye_eye::plan::setup;
use photoneye_eye::spectrum::Spectrum;
use photoneye_eye::video::reader::{Cones, Seen, Signal, read_row, signals};
use photoneye_eye::video::{PlacedLetter, ScreenView, placed_letters, sweep};
use support::{cached_exposure as exposure, cached_retina as retina, figure_12, primary};

/// A laser print of 1200 dpi under room light, in one spectrum.
fn print(pattern: Pattern, spectrum: Spectrum, [width, height]: [u32; 2]) -> Experiment {
    let mut experiment = figure_12(pattern);
    let display = &mut experiment.display;
    (display.width_px, display.height_px) = (width, height);
    display.pixel_pitch_cm = 2.54 / 1200.0;
    display.distance_cm = 50.0;
    display.white = White::LuminanceCdM2(135.3);
    display.transfer = Transfer::Linear;
    display.black = 1.0 / 21.25;
    display.panel = Panel { lag_ms: 0.0, levels: Levels::Values { bits: 1, dither: false } };
    display.primaries = vec![primary(Channel::White, spectrum)];
    display.primaries[0].rects = vec![[0.0, 0.0, 1.0, 1.0]];
    experiment.eye.focus_distance_cm = 50.0;
    experiment.gaze = Gaze::still([0.5 * f64::from(width), 0.5 * f64::from(height)]);
    experiment
}

const LASER: Spectrum = Spectrum::Line { nm: 543.0, fwhm_nm: 0.0 };

fn chart(rows: &[(&str, f64)]) -> SloanChart {
    let row = |(letters, snellen): &(&str, f64)| ChartRow {
        letters: (*letters).into(),
        stroke_arcmin: snellen / 20.0,
    };
    SloanChart {
        rows: rows.iter().map(row).collect(),
        paper_rgb: [1.0; 3],
        ink_rgb: [0.0; 3],
        lower_paper_rgb: None,
        sizes_hold: SizesHold::AtGaze,
    }
}

fn frame_signals(experiment: &Experiment, columns: &ConeColumns, index: u32) -> Vec<Signal> {
    let counts: Vec<f64> = match exposure(experiment).frame(index, None).unwrap().counts {
        FrameCounts::Counts(counts) => counts.into_iter().map(f64::from).collect(),
        FrameCounts::Means(means) => means.into_iter().map(f64::from).collect(),
    };
    let cones = Cones {
        x_deg: &columns.x_deg,
        y_deg: &columns.y_deg,
        kind: &columns.cone_type,
        aperture_um2: &columns.aperture_um2,
    };
    let pixel_deg = experiment.display.pixel_radians().to_degrees();
    let half = 0.5
        * pixel_deg
        * DVec2::new(f64::from(experiment.display.width_px), f64::from(experiment.display.height_px));
    signals(&cones, &counts, |x, y| x.abs() < half.x && y.abs() < half.y)
}

/// Letters right of five, and correlation with the right letters, in each row: means over the frames.
fn rows_read(experiment: &Experiment, letters: &[PlacedLetter], rows: usize, frames: u32) -> Vec<[f64; 2]> {
    let columns = cone_columns(experiment, &retina(experiment)).unwrap();
    let mut read = vec![[0.0; 2]; rows];
    for index in 0..frames {
        let seen = [Seen::new(&frame_signals(experiment, &columns, index), DVec2::ZERO)];
        for (row, sum) in read.iter_mut().enumerate() {
            let of_row: Vec<PlacedLetter> = letters.iter().filter(|l| l.row == row).copied().collect();
            let (right, correlation) = read_row(&seen, &of_row);
            sum[0] += right as f64 / f64::from(frames);
            sum[1] += correlation / f64::from(frames);
        }
    }
    read
}

/// Figure 13: in the wavelength in focus the 20/12 row is read; broadband light of the same luminance shows every row
/// with less contrast, and letters are read no better.
#[test]
fn figure_13_acuity_in_one_wavelength_and_in_broadband_light() {
    let rows =
        [("DOVHR", 15.0), ("CZRHS", 12.0), ("ONHRC", 10.0), ("DKSNV", 8.0), ("ZSOKN", 6.0), ("CKDNR", 5.0)];
    let chart = chart(&rows);
    let read = |spectrum: Spectrum| {
        let mut experiment = print(Pattern::SloanChart(chart.clone()), spectrum, [260, 190]);
        experiment.frames = 4;
        let letters = placed_letters(&chart, &ScreenView::frontal(&experiment.display, &experiment.gaze));
        assert_eq!(letters.len(), 30);
        rows_read(&experiment, &letters, rows.len(), 4)
    };
    let (laser, broad) = (read(LASER), read(Spectrum::named("room-light/fl11").unwrap()));
    println!(
        "letters of five and correlation, rows 20/15 to 20/5: 543 nm {laser:.2?}, broadband {broad:.2?}"
    );
    assert!(laser[0][0] >= 4.5 && laser[1][0] >= 4.0, "20/15 and 20/12 are read: {laser:?}");
    assert!(laser[5][0] < 4.0, "20/5 is not: the observer is no oracle: {laser:?}");
    // Blur takes contrast from every row that can be read, and letters as far as 120 readings tell (three standard deviations of their sum).
    for (row, (broad, laser)) in broad.iter().zip(&laser).enumerate().take(4) {
        assert!(broad[1] < laser[1], "row {row}: {broad:?} {laser:?}");
    }
    let sum = |of: &[[f64; 2]]| of.iter().map(|row| row[0]).sum::<f64>();
    let variance: f64 = laser.iter().map(|row| row[0] * (1.0 - row[0] / 5.0)).sum();
    assert!(sum(&broad) <= sum(&laser) + 3.0 * (2.0 * variance / 4.0).sqrt(), "{broad:?} {laser:?}");
}

/// Figure 14: the contrast of a 543 nm sweep falls to 0.2 and to 0.1 between 40 and 60 cycles per degree.
#[test]
fn figure_14_cut_off() {
    let pattern = Pattern::Sweep {
        from_cycles_per_degree: 0.0,
        to_cycles_per_degree: 80.0,
        contrast: 1.0,
        rgb: [1.0; 3],
        sizes_hold: SizesHold::AtGaze,
    };
    let mut experiment = print(pattern, LASER, [720, 120]);
    experiment.display.panel.levels = Levels::Values { bits: 16, dither: false };
    experiment.display.black = 0.0;
    let columns = cone_columns(&experiment, &retina(&experiment)).unwrap();
    let seen = frame_signals(&experiment, &columns, 0);
    let width_deg = 720.0 * experiment.display.pixel_radians().to_degrees();
    let contrasts = sweep::contrasts(&seen, -0.5 * width_deg, width_deg, [0.0, 80.0]);
    let (at_20, at_10) = (sweep::cut_off(&contrasts, 0.2).unwrap(), sweep::cut_off(&contrasts, 0.1).unwrap());
    println!("{} cones: contrast 0.2 at {at_20:.1}, 0.1 at {at_10:.1} cycles per degree", seen.len());
    assert!((40.0..60.0).contains(&at_20), "{at_20}");
    assert!((45.0..64.0).contains(&at_10), "{at_10}");
}

/// Figure 16: under a drift of 30 arcmin/s the mean of five frames, each moved back, shows the 20/12 letters better than any one of them and
/// better than one frame of an eye at rest: correlation with the sharp drawing, over ten letters and four repetitions.
#[test]
fn figure_16_the_mean_of_five_frames_beats_one() {
    let chart = chart(&[("CZRHS", 12.0), ("NKDVO", 12.0)]);
    let mut still = print(Pattern::SloanChart(chart.clone()), LASER, [240, 90]);
    still.retina.region_deg = Some([-0.31, 0.31, -0.13, 0.13]);
    still.frames = 20;
    let mut moving = still.clone();
    moving.gaze.movement = Movement::Drift { speed_arcmin_per_s: 30.0, direction_deg: 30.0 };
    let letters = placed_letters(&chart, &ScreenView::frontal(&still.display, &still.gaze));
    let columns = cone_columns(&still, &retina(&still)).unwrap();
    let gaze = setup::gaze(&moving, &setup::fixation(&moving).unwrap()).unwrap();
    let (mut rest, mut single, mut mean, mut right) = (0.0, 0.0, 0.0, [0; 2]);
    for group in 0..2 {
        let frames: Vec<Seen> = (5 * group..5 * group + 5)
            .map(|index| {
                let sight = gaze.screen_tangent((f64::from(index) + 0.5) / 60.0);
                let sight_deg = DVec2::new(sight.x.atan(), sight.y.atan()) * 1_f64.to_degrees();
                Seen::new(&frame_signals(&moving, &columns, index), sight_deg)
            })
            .collect();
        for frame in &frames {
            single += read_row(std::slice::from_ref(frame), &letters).1 / 10.0;
        }
        let (letters_right, correlation) = read_row(&frames, &letters);
        mean += correlation / 2.0;
        right[0] += letters_right;
        let one = [Seen::new(&frame_signals(&still, &columns, group), DVec2::ZERO)];
        let (letters_right, correlation) = read_row(&one, &letters);
        rest += correlation / 2.0;
        right[1] += letters_right;
    }
    println!(
        "correlation: one frame of five {single:.3}, one at rest {rest:.3}, mean of five {mean:.3}; letters of 20: mean {}, at rest {}",
        right[0], right[1]
    );
    assert!(mean > single + 0.02 && mean > rest + 0.01, "{single} {rest} {mean}");
    assert!(right[0] >= right[1], "{right:?}");
}
