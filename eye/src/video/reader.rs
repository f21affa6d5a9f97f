//! A simple observer: reads Sloan letters from the cones' counts by template matching (Figures 13 and 16).
//!
//! A cone's signal is its count over what a cone of its type and aperture counts on the average. The observer sees a picture in which every
//! point has the signal of the nearest cone, knows where a letter stands and how large it is, and takes the letter whose sharp drawing
//! correlates best with the picture. It knows nothing of the eye's optics. Frames of an eye that moves are laid over each other, each moved
//! back by the movement (the compensated mean of Figure 16).

use std::collections::BTreeMap;

use glam::DVec2;

use super::chart::PlacedLetter;
use super::sloan::{LETTERS, ink};

/// Points across a stroke.
const PER_STROKE: u32 = 4;
/// Strokes of paper around a letter that are looked at.
const MARGIN: f64 = 1.0;
/// Cones that usually count less than this share of those that count most see nothing.
const LEAST: f64 = 0.1;
/// Side of the squares in which cones are looked up, degrees.
const SQUARE_DEG: f64 = 1.0 / 60.0;

/// A cone: degrees from the gaze centre (right, up), its count, and the count of an average cone of its type and aperture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Right, degrees.
    pub x_deg: f64,
    /// Up, degrees.
    pub y_deg: f64,
    /// Its count.
    pub count: f64,
    /// What it counts usually.
    pub usual: f64,
}

/// Columns of the cone table that an observer needs.
#[derive(Clone, Copy, Debug)]
pub struct Cones<'a> {
    /// Right, degrees.
    pub x_deg: &'a [f64],
    /// Up, degrees.
    pub y_deg: &'a [f64],
    /// 0 L, 1 M, 2 S.
    pub kind: &'a [u8],
    /// Light-collecting area, µm².
    pub aperture_um2: &'a [f32],
}

/// Signals of the cones for which `inside` holds (degrees right and up).
pub fn signals(cones: &Cones, counts: &[f64], inside: impl Fn(f64, f64) -> bool) -> Vec<Signal> {
    let kept: Vec<usize> = (0..counts.len()).filter(|&i| inside(cones.x_deg[i], cones.y_deg[i])).collect();
    let mut rates = [[0.0; 2]; 3];
    for &i in &kept {
        let rate = &mut rates[usize::from(cones.kind[i].min(2))];
        rate[0] += counts[i];
        rate[1] += f64::from(cones.aperture_um2[i]);
    }
    let signal = |i: usize| {
        let [count, area] = rates[usize::from(cones.kind[i].min(2))];
        let usual = if area > 0.0 { count / area * f64::from(cones.aperture_um2[i]) } else { 0.0 };
        Signal { x_deg: cones.x_deg[i], y_deg: cones.y_deg[i], count: counts[i], usual }
    };
    kept.into_iter().map(signal).filter(|s| s.usual > 0.0).collect()
}

/// What one frame shows.
#[derive(Clone, Debug)]
pub struct Seen {
    squares: BTreeMap<(i64, i64), Vec<(DVec2, f64)>>,
    /// Where the line of sight was, degrees from where it began.
    sight_deg: DVec2,
}

impl Seen {
    /// A frame's signals, with the line of sight's place (degrees right and up from the start) in the middle of the frame.
    pub fn new(signals: &[Signal], sight_deg: DVec2) -> Self {
        let most = signals.iter().map(|s| s.usual).fold(0.0, f64::max);
        let mut squares: BTreeMap<(i64, i64), Vec<(DVec2, f64)>> = BTreeMap::new();
        for s in signals.iter().filter(|s| s.usual > LEAST * most) {
            let at = DVec2::new(s.x_deg, s.y_deg);
            squares.entry(square(at)).or_default().push((at, s.count / s.usual));
        }
        Self { squares, sight_deg }
    }

    /// Signal of the cone nearest to a place of the screen (degrees from the gaze centre at the start), if one is within two squares.
    pub fn at(&self, place_deg: DVec2) -> Option<f64> {
        let at = place_deg - self.sight_deg;
        let (x, y) = square(at);
        let near = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy)));
        let cones = near.filter_map(|key| self.squares.get(&key)).flatten();
        cones.min_by(|a, b| a.0.distance_squared(at).total_cmp(&b.0.distance_squared(at))).map(|c| c.1)
    }
}

fn square(at: DVec2) -> (i64, i64) {
    ((at.x / SQUARE_DEG).floor() as i64, (at.y / SQUARE_DEG).floor() as i64)
}

/// What was made of one letter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The letter that fits best.
    pub letter: char,
    /// Correlation with the letter that stands there.
    pub right: f64,
    /// Best correlation with another letter.
    pub wrong: f64,
}

/// Reads one letter from the mean of frames.
pub fn read(frames: &[Seen], placed: &PlacedLetter) -> Reading {
    let side = ((5.0 + 2.0 * MARGIN) * f64::from(PER_STROKE)) as u32;
    let stroke = |i: u32| (f64::from(i) + 0.5) / f64::from(PER_STROKE) - MARGIN;
    let points: Vec<DVec2> =
        (0..side * side).map(|i| DVec2::new(stroke(i % side), stroke(i / side))).collect();
    let seen: Vec<Option<f64>> = points
        .iter()
        .map(|at| {
            let place = placed.corner_deg + *at * placed.stroke_deg;
            let values: Vec<f64> = frames.iter().filter_map(|frame| frame.at(place)).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        })
        .collect();
    let fit = |letter: char| {
        let pairs = points.iter().zip(&seen).filter_map(|(at, seen)| {
            Some((seen.as_ref().copied()?, if ink(letter, *at) { 0.0 } else { 1.0 }))
        });
        correlation(&pairs.collect::<Vec<_>>())
    };
    let mut reading = Reading { letter: ' ', right: -1.0, wrong: -1.0 };
    let mut best = f64::NEG_INFINITY;
    for letter in LETTERS.chars() {
        let value = fit(letter);
        if letter == placed.letter {
            reading.right = value;
        } else {
            reading.wrong = reading.wrong.max(value);
        }
        if value > best {
            (best, reading.letter) = (value, letter);
        }
    }
    reading
}

/// Reads a row; gives how many letters were right and the mean correlation with the letters that stand there.
pub fn read_row(frames: &[Seen], letters: &[PlacedLetter]) -> (usize, f64) {
    let readings: Vec<Reading> = letters.iter().map(|letter| read(frames, letter)).collect();
    let right = readings.iter().zip(letters).filter(|(r, l)| r.letter == l.letter).count();
    (right, readings.iter().map(|r| r.right).sum::<f64>() / readings.len().max(1) as f64)
}

/// Pearson's correlation; 0 when one of both does not vary.
pub fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len().max(1) as f64;
    let (mx, my) = pairs.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (x, y) in pairs {
        xx += (x - mx) * (x - mx);
        yy += (y - my) * (y - my);
        xy += (x - mx) * (y - my);
    }
    if xx > 0.0 && yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From a fine grid of cones without noise every letter is read; from cones coarser than a letter it is not.
    #[test]
    fn letters_are_read_when_cones_are_fine_enough() {
        for (step, readable) in [(0.2, true), (3.0, false)] {
            let mut right = 0;
            for letter in LETTERS.chars() {
                let placed =
                    PlacedLetter { letter, row: 0, corner_deg: DVec2::new(-0.02, 0.03), stroke_deg: 0.01 };
                let side = (9.0 / step) as i32;
                let cones: Vec<Signal> = (0..side * side)
                    .map(|i| {
                        let at =
                            DVec2::new(f64::from(i % side), f64::from(i / side)) * step - 2.0 + 0.37 * step;
                        let place = placed.corner_deg + at * placed.stroke_deg;
                        let count = if ink(letter, at) { 20.0 } else { 100.0 };
                        Signal { x_deg: place.x, y_deg: place.y, count, usual: 60.0 }
                    })
                    .collect();
                right += usize::from(read(&[Seen::new(&cones, DVec2::ZERO)], &placed).letter == letter);
            }
            assert_eq!(right == LETTERS.len(), readable, "{step}: {right}");
        }
    }

    #[test]
    fn correlation_of_a_line_is_one() {
        let line: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), 3.0 - 2.0 * f64::from(i))).collect();
        assert!((correlation(&line) + 1.0).abs() < 1e-12);
        assert!(correlation(&[(1.0, 2.0), (1.0, 3.0)]).abs() < 1e-12);
    }
}
