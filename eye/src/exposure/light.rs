//! Light of one frame in layers: what each pixel of a primary gives, and when in the frame, with the movement of the eye meanwhile.
//!
//! A layer is light per pixel times a common course in time. A still eye needs one layer a primary; behind a moving eye earlier pictures'
//! light, black and each bit plane are layers of their own (their times differ).

use glam::DVec2;
use rayon::prelude::*;
#[cfg(test)]
use rustfft::num_complex::Complex64;

use crate::display::{
    Channel, Display, Emitter, Levels, MAX_HISTORY, Part, Place, Timing, light_until, step,
};
use crate::movement::Gaze;
use crate::video::Picture;

/// What is shown in a frame: its picture and those before it.
#[derive(Clone, Debug)]
pub struct Shown<'a> {
    /// Number of the frame.
    pub index: u32,
    /// The frame's picture, then the one before it, and so on; before the first one, the first one was shown.
    pub pictures: Vec<&'a Picture>,
}

impl<'a> Shown<'a> {
    /// A frame's picture and its earlier ones, the latest first.
    pub fn new(index: u32, picture: &'a Picture, earlier: &[&'a Picture]) -> Self {
        let pictures = std::iter::once(picture).chain(earlier.iter().copied()).collect();
        Self { index, pictures }
    }
}

/// What a layer shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shows {
    /// The frame's picture.
    Now,
    /// What earlier pictures left; each leaves this share of what the one after it leaves.
    Past(f64),
    /// The black of the panel.
    Black,
    /// One bit of the picture's light, with its weight.
    Bit(u32),
}

/// A stretch of a layer's time during which the line of sight goes along a straight line; the light falls as `e^{-decay·x}`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Share of the layer's light.
    pub share: f64,
    /// e-folds over the segment.
    pub decay: f64,
    /// Line of sight at its start and end, pixels (x right, y down) from the gaze centre.
    pub sight: [DVec2; 2],
}

/// A layer of light of one primary.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// What it shows.
    pub shows: Shows,
    /// When.
    pub parts: Vec<Part>,
}

/// The layers of an emitter in a frame. Their light sums to the frame's. Of a scanned screen those of its last pixel, see [`courses_at`].
pub fn courses(emitter: &Emitter, display: &Display, index: u32) -> Vec<Course> {
    courses_of(emitter, display, timing(emitter, display, index))
}

/// The layers of the pixels of a scanned screen whose turn comes `delay` of a frame after the frame's start.
pub fn courses_at(emitter: &Emitter, display: &Display, index: u32, delay: f64) -> Vec<Course> {
    let frame_s = 1.0 / display.frame_rate_hz;
    courses_of(emitter, display, emitter.waveform.timing_at(index, frame_s, display.panel.lag_ms, delay))
}

fn courses_of(emitter: &Emitter, display: &Display, timing: Timing) -> Vec<Course> {
    let Levels::Planes { bits, .. } = display.panel.levels else {
        let mut courses = vec![Course { shows: Shows::Now, parts: timing.now }];
        if !timing.past.is_empty() {
            courses.push(Course { shows: Shows::Past(timing.memory), parts: timing.past });
        }
        return courses;
    };
    if emitter.channel == Channel::Room {
        return vec![Course { shows: Shows::Now, parts: timing.now }];
    }
    let steps = f64::from((1_u32 << bits) - 1);
    let plane = |bit: u32| {
        let (from, to) = (f64::from((1_u32 << bit) - 1) / steps, f64::from((1_u32 << (bit + 1)) - 1) / steps);
        let inside = |p: &Part| {
            let length = p.end - p.start;
            Part { start: p.start + from * length, end: p.start + to * length, ..*p }
        };
        Course { shows: Shows::Bit(bit), parts: timing.now.iter().map(inside).collect() }
    };
    let mut courses: Vec<Course> = (0..bits).map(plane).collect();
    courses.push(Course { shows: Shows::Black, parts: timing.now });
    courses
}

fn timing(emitter: &Emitter, display: &Display, index: u32) -> Timing {
    let lag_ms = if emitter.channel == Channel::Room { 0.0 } else { display.panel.lag_ms };
    emitter.waveform.timing(index, 1.0 / display.frame_rate_hz, lag_ms)
}

/// Earlier pictures that a frame of a display needs.
pub fn history(emitters: &[Emitter], display: &Display) -> u32 {
    emitters.iter().map(|e| timing(e, display, 0).history()).max().unwrap_or(0).min(MAX_HISTORY)
}

/// Relative light of one pixel of the display in a layer.
pub fn light(
    display: &Display,
    emitter: &Emitter,
    shows: Shows,
    shown: &Shown,
    [column, row]: [u32; 2],
) -> f64 {
    let channel = emitter.channel;
    let of_picture = |age: usize| {
        let picture = shown.pictures[age.min(shown.pictures.len() - 1)];
        let at = 3 * (row as usize * picture.width as usize + column as usize);
        let place = Place { column, row, frame: shown.index.saturating_sub(age as u32) };
        (&picture.rgb[at..at + 3], place)
    };
    match shows {
        Shows::Now => {
            let (rgb, place) = of_picture(0);
            display.light(channel, rgb, place)
        }
        Shows::Past(memory) => {
            let mut weight = 1.0;
            let mut sum = 0.0;
            for age in 1..shown.pictures.len() {
                let (rgb, place) = of_picture(age);
                sum += weight * (1.0 - memory) * display.light(channel, rgb, place);
                weight *= memory;
            }
            let (rgb, place) = of_picture(shown.pictures.len());
            sum + weight * display.light(channel, rgb, place)
        }
        Shows::Black => display.black,
        Shows::Bit(bit) => {
            let (rgb, place) = of_picture(0);
            (1.0 - display.black) * bit_light(display, channel, rgb, place, bit)
        }
    }
}

/// The same for pixels of a row, the first of them given.
fn light_row(
    display: &Display,
    emitter: &Emitter,
    shows: Shows,
    shown: &Shown,
    [column, row]: [u32; 2],
    values: &mut [f64],
) {
    let of_picture = |age: usize, values: &mut [f64]| {
        let picture = shown.pictures[age.min(shown.pictures.len() - 1)];
        let at = 3 * (row as usize * picture.width as usize + column as usize);
        let place = Place { column, row, frame: shown.index.saturating_sub(age as u32) };
        display.light_row(emitter.channel, &picture.rgb[at..at + 3 * values.len()], place, values);
    };
    match shows {
        Shows::Now => of_picture(0, values),
        Shows::Past(memory) => {
            let mut weight = 1.0;
            let mut past = vec![0.0; values.len()];
            values.fill(0.0);
            // As in `light`: each picture before, and the first for all that were before it.
            for age in 1..=shown.pictures.len() {
                let share = if age < shown.pictures.len() { weight * (1.0 - memory) } else { weight };
                of_picture(age, &mut past);
                for (value, past) in values.iter_mut().zip(&past) {
                    *value += share * past;
                }
                weight *= memory;
            }
        }
        Shows::Black | Shows::Bit(_) => {
            for (value, column) in values.iter_mut().zip(column..) {
                *value = light(display, emitter, shows, shown, [column, row]);
            }
        }
    }
}

/// Light of one bit of a pixel in its channel.
fn bit_light(display: &Display, channel: Channel, rgb: &[f32], place: Place, bit: u32) -> f64 {
    let Levels::Planes { bits, dither } = display.panel.levels else {
        return 0.0;
    };
    let weight = f64::from(1_u32 << bit) / f64::from((1_u32 << bits) - 1);
    let values = std::array::from_fn(|i| f64::from(rgb[i]).clamp(0.0, 1.0));
    let of_bit = |light: f64| if step(light, bits, dither, place) >> bit & 1 == 1 { weight } else { 0.0 };
    let lights = display.curve().lights(values).map(of_bit);
    channel.of(|i| lights[i])
}

/// Light of one pixel over the whole frame, all layers.
pub fn frame_light(
    display: &Display,
    emitter: &Emitter,
    courses: &[Course],
    shown: &Shown,
    at: [u32; 2],
) -> f64 {
    match courses {
        // Bits and black together are the picture's light.
        [Course { shows: Shows::Bit(_), .. }, ..] => {
            let share = courses[courses.len() - 1].share();
            share * light(display, emitter, Shows::Now, shown, at)
        }
        // Where earlier pictures matter, how much depends on the pixel's turn.
        [_, _, ..] if let Some(scan) = emitter.waveform.scan() => {
            courses_at(emitter, display, shown.index, scan.delay(display, at))
                .iter()
                .map(|course| course.share() * light(display, emitter, course.shows, shown, at))
                .sum()
        }
        _ => courses
            .iter()
            .map(|course| course.share() * light(display, emitter, course.shows, shown, at))
            .sum(),
    }
}

/// Pixels of a window from which on it is worth more than one thread.
const PARALLEL_PIXELS: usize = 1 << 16;

/// A rectangle of pixels: first column and row, columns and rows.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// First column and row.
    pub first: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

impl Window {
    /// Rows of values, `[row][column]`; `fill` takes the first pixel of a row and its values.
    fn rows(&self, fill: impl Fn([u32; 2], &mut [f64]) + Sync) -> Vec<f64> {
        let [width, height] = self.size.map(|s| s as usize);
        let mut values = vec![0.0; width * height];
        let one = |(row, line): (usize, &mut [f64])| fill([self.first[0], self.first[1] + row as u32], line);
        // All threads share a large window.
        if values.len() < PARALLEL_PIXELS {
            values.chunks_exact_mut(width.max(1)).enumerate().for_each(one);
        } else {
            values.par_chunks_exact_mut(width.max(1)).enumerate().for_each(one);
        }
        values
    }

    /// [`light`] of its pixels.
    pub fn light(&self, display: &Display, emitter: &Emitter, shows: Shows, shown: &Shown) -> Vec<f64> {
        self.rows(|at, line| light_row(display, emitter, shows, shown, at, line))
    }

    /// [`frame_light`] of its pixels.
    pub fn frame_light(
        &self,
        display: &Display,
        emitter: &Emitter,
        courses: &[Course],
        shown: &Shown,
    ) -> Vec<f64> {
        if let Some(share) = share_of_now(courses) {
            let mut light = self.light(display, emitter, Shows::Now, shown);
            for light in &mut light {
                *light *= share;
            }
            return light;
        }
        let layers_of_pixels = emitter.waveform.scan().is_some() && courses.len() > 1;
        self.rows(|[column, row], line| {
            if layers_of_pixels {
                for (value, column) in line.iter_mut().zip(column..) {
                    *value = frame_light(display, emitter, courses, shown, [column, row]);
                }
                return;
            }
            // As in `frame_light`, a row at a time.
            let mut layer = vec![0.0; line.len()];
            for course in courses {
                light_row(display, emitter, course.shows, shown, [column, row], &mut layer);
                for (value, light) in line.iter_mut().zip(&layer) {
                    *value += course.share() * light;
                }
            }
        })
    }
}

/// What the light of a frame's picture is to be multiplied with for that of the whole frame; `None` where other pictures or the pixel's turn count.
pub fn share_of_now(courses: &[Course]) -> Option<f64> {
    match courses {
        // Bits and black together are the picture's light.
        [Course { shows: Shows::Bit(_), .. }, .., black] => Some(black.share()),
        [only] if only.shows == Shows::Now => Some(only.share()),
        _ => None,
    }
}

impl Course {
    /// Light of the whole frame.
    pub fn share(&self) -> f64 {
        self.parts.iter().map(|p| p.share).sum()
    }

    /// The layer's segments for an eye that moves; `tangent_per_px` is a pixel pitch in unit tangents.
    pub fn segments(&self, gaze: &Gaze, index: u32, frame_s: f64, tangent_per_px: f64) -> Vec<Segment> {
        let at = |tangent: DVec2| DVec2::new(tangent.x, -tangent.y) / tangent_per_px;
        let mut segments = Vec::new();
        for part in &self.parts {
            let time = |u: f64| (f64::from(index) + u) * frame_s;
            let (from_s, to_s) = (time(part.start), time(part.end));
            let path = gaze.path(from_s, to_s);
            for pair in path.windows(2) {
                // Whole parts keep their share to the bit.
                let place = |t_s: f64| {
                    if t_s <= from_s {
                        0.0
                    } else if t_s >= to_s {
                        1.0
                    } else {
                        (t_s - from_s) / (to_s - from_s)
                    }
                };
                let (from, to) = (place(pair[0].0), place(pair[1].0));
                let share = if path.len() == 2 { part.share } else { part.share_between(from, to) };
                let sight = [at(pair[0].1), at(pair[1].1)];
                segments.push(Segment { share, decay: part.decay * (to - from), sight });
            }
        }
        segments
    }

    /// When a photon of the layer leaves, 0 to 1 over the frame, for a uniform number: the inverse of its light's distribution.
    pub fn time(&self, uniform: f64) -> f64 {
        if let [part] = self.parts.as_slice()
            && part.decay <= 0.0
        {
            return part.start + uniform * (part.end - part.start);
        }
        let wanted = uniform * self.share();
        let (mut from, mut to) = (0.0, 1.0);
        // 40 halvings: 1e-12 of a frame.
        for _ in 0..40 {
            let middle = 0.5 * (from + to);
            if light_until(&self.parts, middle) < wanted { from = middle } else { to = middle }
        }
        0.5 * (from + to)
    }
}

/// The readable form of [`super::drive`]'s tables: transform of a movement at cycles per pixel (y down), the sum of shares at 0: a pixel at p is seen at p - sight,
/// `Σ share ∫ λ e^{-λx}/(1-e^{-λ}) e^{2πi ν·s(x)} dx`.
#[cfg(test)]
pub fn movement(segments: &[Segment], cycles: DVec2) -> Complex64 {
    segments.iter().map(|s| s.share * segment(s, cycles)).sum()
}

#[cfg(test)]
fn segment(segment: &Segment, cycles: DVec2) -> Complex64 {
    let [from, to] = segment.sight;
    let decay = segment.decay;
    if from == DVec2::ZERO && to == DVec2::ZERO {
        return Complex64::ONE;
    }
    if decay < 1e-9 {
        let middle = std::f64::consts::TAU * cycles.dot(0.5 * (from + to));
        return Complex64::from_polar(super::source::sinc(cycles.dot(to - from)), middle);
    }
    let start = Complex64::cis(std::f64::consts::TAU * cycles.dot(from));
    let turn = Complex64::new(-decay, std::f64::consts::TAU * cycles.dot(to - from));
    start * decay / -(-decay).exp_m1() * mean_exp(turn)
}

/// `(e^z - 1)/z`.
#[cfg(test)]
fn mean_exp(z: Complex64) -> Complex64 {
    if z.norm() < 1e-3 {
        return 1.0 + z * (0.5 + z * (1.0 / 6.0 + z / 24.0));
    }
    (z.exp() - 1.0) / z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::{Panel, Waveform};

    /// Windows are their pixels, bit for bit: continuous levels, steps, bit planes; now and before.
    #[test]
    fn light_of_a_window_is_that_of_its_pixels() {
        let rgb: Vec<f32> =
            (0..3 * 7 * 5).map(|i| ((i * 37) % 256) as f32 / 255.0 + (i % 4) as f32 * 1e-4).collect();
        let picture = Picture { width: 7, height: 5, rgb };
        let shown = Shown { index: 3, pictures: vec![&picture, &picture] };
        let window = Window { first: [2, 1], size: [4, 3] };
        let levels = [
            Levels::Continuous,
            Levels::Values { bits: 6, dither: true },
            Levels::Planes { bits: 5, dither: false },
        ];
        let channels =
            [Channel::Red, Channel::Green, Channel::Blue, Channel::White, Channel::Least, Channel::Room];
        for (levels, lag_ms) in levels.into_iter().flat_map(|l| [(l, 0.0), (l, 4.0)]) {
            let display = Display { panel: Panel { lag_ms, levels }, ..Display::for_test() };
            for channel in channels {
                let (rects, waveform) = (vec![([0.0, 0.0, 1.0, 1.0], 1.0)], Waveform::Steady);
                let emitter = Emitter { channel, photons: Vec::new(), rects, spot_sd_px: 0.0, waveform };
                let courses = courses(&emitter, &display, shown.index);
                let whole = window.frame_light(&display, &emitter, &courses, &shown);
                for course in &courses {
                    let made = window.light(&display, &emitter, course.shows, &shown);
                    for (i, (made, whole)) in (0_u32..).zip(made.iter().zip(&whole)) {
                        let at = [2 + i % 4, 1 + i / 4];
                        let exact = light(&display, &emitter, course.shows, &shown, at);
                        assert_eq!(made.to_bits(), exact.to_bits());
                        let exact = frame_light(&display, &emitter, &courses, &shown, at);
                        assert_eq!(whole.to_bits(), exact.to_bits());
                    }
                }
            }
        }
    }

    /// The closed form of a decaying light on a straight path against a sum over time.
    #[test]
    fn decaying_light_on_a_moving_eye_is_exact() {
        let sight = [DVec2::new(0.2, -0.1), DVec2::new(3.0, 0.7)];
        for decay in [0.0, 1e-7, 1e-3, 0.4, 5.0, 60.0] {
            let one = Segment { share: 0.7, decay, sight };
            for cycles in [DVec2::ZERO, DVec2::new(1e-6, 0.0), DVec2::new(0.4, -0.9), DVec2::new(3.0, 2.0)] {
                let n = 200_000;
                let (mut sum, mut weights) = (Complex64::ZERO, 0.0);
                for i in 0..n {
                    let x = (f64::from(i) + 0.5) / f64::from(n);
                    let weight = (-decay * x).exp();
                    let at = sight[0].lerp(sight[1], x);
                    sum += weight * Complex64::cis(std::f64::consts::TAU * cycles.dot(at));
                    weights += weight;
                }
                let exact = movement(&[one], cycles);
                assert!((exact - 0.7 * sum / weights).norm() < 1e-7, "{decay} {cycles} {exact}");
            }
        }
    }
}
