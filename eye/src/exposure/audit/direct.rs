//! The mean of one cone as the sum that it is: over the pixels of the whole display, their rectangles, the time of the frame and the cone's
//! aperture, of the spread of a point's light. No period, no grid of frequencies, no basis, no segments but those of the movement.

use std::f64::consts::PI;

use glam::{DMat2, DVec2};
use rayon::prelude::*;

use super::super::light::{Course, Shown, Window, courses, courses_at, light};
use super::super::source::Projector;
use super::super::stray::angle::Scatter;
use super::collection::Collection;
use super::optics::Optics;
use super::scattered::Seen;
use crate::display::Emitter;
use crate::experiment::Experiment;
use crate::exposure::spectral::Kind;
use crate::psf::quadrature::gauss_legendre;
use crate::retina::ConeType;

/// Side of a block of pixels that is taken as one point from afar, µm of retina about.
const BLOCK_UM: f64 = 15.0;
/// µm of retina per unit tangent, for sizes only.
const UM_PER_TANGENT: f64 = 16_440.0;
/// Distance from a cone from which light counts as coming from afar, µm, and how much coarser it is summed.
const CORE_UM: f64 = 20.0;
const AFAR: f64 = 2.5;
/// Half width of a spot of light that is counted, standard deviations.
const SPOT: f64 = 5.0;
/// Step of the derivatives of what the eye's turn changes, units of the screen.
const BESIDE: f64 = 1e-4;

/// A cone as the mosaic has it.
pub struct Cone {
    /// Centre, µm.
    pub um: DVec2,
    /// Corners of the aperture, µm.
    pub polygon_um: Vec<DVec2>,
    /// Its type.
    pub kind: ConeType,
    /// Factor from its pointing error.
    pub pointing: f64,
}

/// Point and weight.
type Node = (DVec2, f64);

/// The light of a frame: sums over blocks of pixels, by primary.
pub struct Lights {
    block_px: u32,
    columns: u32,
    sums: Vec<Vec<f64>>,
    /// By primary: photons of a fully driven pixel into the pupil, and its courses.
    photons: Vec<f64>,
    courses: Vec<Vec<Course>>,
}

impl Lights {
    /// The light of a frame.
    pub fn new(projector: &Projector, shown: &Shown) -> Self {
        let display = &projector.display;
        let px_um = UM_PER_TANGENT * display.pixel_pitch_cm / display.distance_cm;
        let block_px = ((BLOCK_UM / px_um) as u32).max(1);
        let [columns, rows] = [display.width_px, display.height_px].map(|n| n.div_ceil(block_px));
        let mut made = Self { block_px, columns, sums: Vec::new(), photons: Vec::new(), courses: Vec::new() };
        for emitter in &projector.emitters {
            let courses = courses(emitter, display, shown.index);
            let mut sums = vec![0.0; (columns * rows) as usize];
            // A row of blocks at a time, on all threads.
            sums.par_chunks_mut(columns as usize).zip(0..rows).for_each(|(sums, block_row)| {
                let first = block_row * block_px;
                for row in first..(first + block_px).min(display.height_px) {
                    let line = Window { first: [0, row], size: [display.width_px, 1] };
                    let light = line.frame_light(display, emitter, &courses, shown);
                    for (sum, pixels) in sums.iter_mut().zip(light.chunks(block_px as usize)) {
                        *sum = pixels.iter().fold(*sum, |sum, light| sum + light);
                    }
                }
            });
            made.sums.push(sums);
            made.photons.push(emitter.emitted() * projector.pupil_share);
            made.courses.push(courses);
        }
        made
    }
}

/// Where the line of sight is on average while a primary's light leaves, pixels.
fn mean_sight(projector: &Projector, courses: &[Course], index: u32) -> DVec2 {
    let nodes = courses.iter().flat_map(|c| times(projector, c, index, 1.0));
    let (at, shares) = nodes.fold((DVec2::ZERO, 0.0), |(at, sum), (s, w)| (at + w * s, sum + w));
    if shares > 0.0 { at / shares } else { DVec2::ZERO }
}

/// The mean of a cone in a frame.
///
/// # Errors
/// When the cone sees no screen or the pupil cannot be traced.
pub fn mean(
    experiment: &Experiment,
    optics: &Optics,
    projector: &Projector,
    (shown, lights): (&Shown, &Lights),
    cone: &Cone,
) -> Result<f64, String> {
    let display = &projector.display;
    let tangent = optics.projection.screen_tangent(cone.um).map_err(|e| e.to_string())?;
    // The screen moves before this cone as the eye turns, not as the middle of its tile sees it.
    let own_projector;
    let (mut to_rest, mut brighter) = (DMat2::IDENTITY, 1.0);
    let projector = if projector.gaze.is_still() {
        projector
    } else {
        let gaze = projector.gaze.seen_along(optics.projection.line_to(tangent));
        let middle_s = (f64::from(shown.index) + 0.5) / display.frame_rate_hz;
        let turn = gaze.turn(middle_s);
        // A place beside the cone's moves by more or less: to the screen at rest from the screen that is seen.
        let beside = |axis: DVec2| {
            let line = optics.projection.line_to(tangent + BESIDE * axis);
            axis + (projector.gaze.seen_along(line).moved_by(turn) - gaze.moved_by(turn)) / BESIDE
        };
        to_rest = DMat2::from_cols(beside(DVec2::X), beside(DVec2::Y)).inverse();
        brighter = gaze.light(display.emission_law, turn);
        own_projector = Projector { gaze, ..projector.clone() };
        &own_projector
    };
    let sight = lights.courses.iter().map(|c| mean_sight(projector, c, shown.index)).collect();
    let ecc_deg = optics.projection.screen().eccentricity_deg(tangent);
    let kind = Kind::Isomerized(cone.kind);
    let place = (cone.um, width_um(&cone.polygon_um));
    let collection = Collection::new(optics, &projector.emitters, kind, place, ecc_deg)?;
    let mut corners = Vec::with_capacity(cone.polygon_um.len());
    for um in &cone.polygon_um {
        let corner = optics.projection.screen_tangent(*um).map_err(|e| e.to_string())?;
        corners.push(collection.local.image_um(corner - tangent));
    }
    let aperture = aperture(&corners, 0.5 * collection.period_um());
    let per_px = display.pixel_pitch_cm / display.distance_cm;
    let centre_px = DVec2::from_array(experiment.gaze.center_px) + flip(tangent) / per_px;
    let mut sum =
        Sum { projector, shown, lights, sight, to_rest, collection, per_px, centre_px, nodes: Vec::new() };
    let period_px = sum.collection.period_um() / sum.longer_px_um();
    let of_emitter = |emitter: &Emitter| [period_px, AFAR * period_px].map(|px| pixel_nodes(emitter, px));
    sum.nodes = projector.emitters.iter().map(of_emitter).collect();
    let lit = sum.lit_offsets();
    sum.collection = sum.collection.over(&aperture, lit);
    let mut mean: f64 = (0..projector.emitters.len()).map(|primary| sum.primary(primary)).sum();
    mean *= brighter;
    if let Some(stray) = experiment.eye.stray_light {
        let scatter = Scatter::new(experiment, stray)?;
        mean *= 1.0 - scatter.fraction();
        mean += (0..projector.emitters.len())
            .map(|p| sum.scattered(optics, experiment, p, &scatter))
            .sum::<f64>();
    }
    Ok(mean * cone.pointing)
}

/// Diameter of a disc with the polygon's area.
fn width_um(corners: &[DVec2]) -> f64 {
    let next = |i: usize| corners[(i + 1) % corners.len()];
    let twice: f64 = corners.iter().enumerate().map(|(i, a)| a.perp_dot(next(i))).sum();
    (2.0 * twice.abs() / PI).sqrt()
}

/// Screen y is up, pixel y is down.
fn flip(v: DVec2) -> DVec2 {
    DVec2::new(v.x, -v.y)
}

struct Sum<'a> {
    projector: &'a Projector,
    shown: &'a Shown<'a>,
    lights: &'a Lights,
    /// By primary: where the line of sight is on average, pixels.
    sight: Vec<DVec2>,
    /// From the screen as it is seen in the middle of the frame to the screen at rest.
    to_rest: DMat2,
    /// What the cone's aperture counts by the offset of its centre.
    collection: Collection,
    per_px: f64,
    /// The cone's centre on the display, pixels.
    centre_px: DVec2,
    /// By primary: points of a pixel from which light comes that is near, or far.
    nodes: Vec<[Vec<Node>; 2]>,
}

impl Sum<'_> {
    /// Counts from all pixels of a primary.
    fn primary(&self, primary: usize) -> f64 {
        let (lights, display) = (self.lights, &self.projector.display);
        let emitter = &self.projector.emitters[primary];
        let block = f64::from(lights.block_px);
        let reach = self.collection.window_um() / self.px_um() + 2.0 * block + 2.0;
        let moves = self.longest_path(primary);
        let of_block = |(index, light): (usize, &f64)| {
            if *light <= 0.0 {
                return 0.0;
            }
            let first =
                [index as u32 % lights.columns, index as u32 / lights.columns].map(|n| n * lights.block_px);
            let last = [
                (first[0] + lights.block_px).min(display.width_px),
                (first[1] + lights.block_px).min(display.height_px),
            ];
            let middle = 0.5 * DVec2::new(f64::from(first[0] + last[0]), f64::from(first[1] + last[1]));
            let away = (middle - self.sight[primary] - self.centre_px).abs().max_element();
            if away > reach + moves {
                return light * self.collected(primary, middle - self.sight[primary]);
            }
            let rows = first[1]..last[1];
            let of_row = |row| {
                (first[0]..last[0]).map(|column| self.pixel(primary, emitter, [column, row])).sum::<f64>()
            };
            rows.map(of_row).sum()
        };
        // Collected before it is summed: the order of the sum is that of the blocks.
        let of_blocks: Vec<f64> = lights.sums[primary].par_iter().enumerate().map(of_block).collect();
        of_blocks.iter().sum::<f64>() * lights.photons[primary]
    }

    /// The same of one pixel that is near, over its time and its rectangles.
    fn pixel(&self, primary: usize, emitter: &Emitter, at: [u32; 2]) -> f64 {
        let Projector { display, .. } = self.projector;
        let period_px = self.collection.period_um() / self.longer_px_um();
        let corner = DVec2::new(f64::from(at[0]), f64::from(at[1]));
        // From afar only the mean over several periods matters.
        let far = (corner + 0.5 - self.sight[primary] - self.centre_px).length()
            - std::f64::consts::FRAC_1_SQRT_2
            - self.longest_path(primary);
        let follow = if far * self.px_um() > CORE_UM { AFAR * period_px } else { period_px };
        let points = &self.nodes[primary][usize::from(far * self.px_um() > CORE_UM)];
        let own: Vec<Course>;
        let courses = if let Some(scan) = emitter.waveform.scan() {
            own = courses_at(emitter, display, self.shown.index, scan.delay(display, at));
            &own
        } else {
            &self.lights.courses[primary]
        };
        let mut sum = 0.0;
        for course in courses {
            let lit = light(display, emitter, course.shows, self.shown, at);
            if lit <= 0.0 {
                continue;
            }
            for (sight, share) in times(self.projector, course, self.shown.index, follow) {
                let seen = corner - sight;
                sum += lit
                    * share
                    * points.iter().map(|(p, w)| w * self.collected(primary, seen + *p)).sum::<f64>();
            }
        }
        sum
    }

    /// Share of the photons from a point of the display, as the eye at rest would see it, that the cone counts.
    fn collected(&self, primary: usize, seen_px: DVec2) -> f64 {
        self.collection.at(primary, self.to_rest * flip((seen_px - self.centre_px) * self.per_px))
    }

    /// Corners of the rectangle of offsets (unit tangents) of all lit pixels from the cone, however the line of sight moves.
    fn lit_offsets(&self) -> [DVec2; 2] {
        let (mut low, mut high) = (DVec2::MAX, DVec2::MIN);
        for (primary, sums) in self.lights.sums.iter().enumerate() {
            let block = f64::from(self.lights.block_px);
            // A pixel of room for misregistered rectangles and spots.
            let around =
                self.longest_path(primary) + 2.0 + SPOT * self.projector.emitters[primary].spot_sd_px;
            for (index, _) in sums.iter().enumerate().filter(|(_, light)| **light > 0.0) {
                let columns = self.lights.columns as usize;
                let first = DVec2::new((index % columns) as f64, (index / columns) as f64) * block;
                let seen = first - self.sight[primary] - self.centre_px;
                (low, high) = (low.min(seen - around), high.max(seen + block + around));
            }
        }
        if low.x > high.x {
            return [DVec2::ZERO; 2];
        }
        let (a, b) = (flip(low * self.per_px), flip(high * self.per_px));
        [a.min(b), a.max(b)]
    }

    /// A pixel pitch on the retina, the shorter way, µm.
    fn px_um(&self) -> f64 {
        let to_retina = self.collection.local.to_retina;
        // Area over the longer way.
        let longer = to_retina.x_axis.length().max(to_retina.y_axis.length());
        self.per_px * to_retina.determinant().abs() / longer
    }

    /// The same, the longer way.
    fn longer_px_um(&self) -> f64 {
        let to_retina = self.collection.local.to_retina;
        self.per_px * to_retina.x_axis.length().max(to_retina.y_axis.length())
    }

    /// How far the line of sight goes from its mean, pixels.
    fn longest_path(&self, primary: usize) -> f64 {
        let gaze = |c: &Course| {
            let seconds = 1.0 / self.projector.display.frame_rate_hz;
            c.segments(&self.projector.gaze, self.shown.index, seconds, self.per_px)
        };
        let from_mean = |p: DVec2| (p - self.sight[primary]).length();
        let ends = self.lights.courses[primary].iter().flat_map(gaze).flat_map(|s| s.sight.map(from_mean));
        ends.fold(0.0, f64::max)
    }

    /// Counts from scattered light.
    fn scattered(&self, optics: &Optics, experiment: &Experiment, primary: usize, scatter: &Scatter) -> f64 {
        let seen = Seen {
            projector: self.projector,
            beams: optics.beams,
            shown: self.shown,
            gaze_px: DVec2::from_array(experiment.gaze.center_px),
            cone_px: self.centre_px,
            sight_px: self.sight[primary],
        };
        let emitter = &self.projector.emitters[primary];
        let light = seen.light(emitter, &self.lights.courses[primary], scatter);
        let to_um = self.collection.local.to_retina.determinant().abs() * self.per_px.powi(2);
        light * self.lights.photons[primary] / to_um * self.collection.total(primary)
    }
}

/// Gauss nodes that follow a wave of a period over a length.
fn nodes_for(length: f64, period: f64) -> usize {
    let quarter_turns = 0.5 * PI * length / period;
    (quarter_turns.ceil() as usize + if quarter_turns < 0.5 { 2 } else { 4 }).min(200)
}

/// Where the line of sight is while a course's light leaves, pixels, with shares of the light.
fn times(projector: &Projector, course: &Course, index: u32, period_px: f64) -> Vec<Node> {
    let display = &projector.display;
    let (seconds, per_px) = (1.0 / display.frame_rate_hz, display.pixel_pitch_cm / display.distance_cm);
    if projector.gaze.is_still() {
        return vec![(DVec2::ZERO, course.share())];
    }
    let mut nodes = Vec::new();
    for segment in course.segments(&projector.gaze, index, seconds, per_px) {
        let [from, to] = segment.sight;
        let rule =
            gauss_legendre(nodes_for((to - from).length(), period_px) + segment.decay.min(60.0) as usize);
        let falls = |x: f64| (-segment.decay * x).exp();
        let whole: f64 = rule.iter().map(|(u, w)| w * falls(0.5 + 0.5 * u)).sum();
        for (u, w) in rule {
            let x = 0.5 + 0.5 * u;
            nodes.push((from.lerp(to, x), segment.share * w * falls(x) / whole));
        }
    }
    nodes
}

/// Points of a pixel from which its light comes, from its corner, and their shares.
fn pixel_nodes(emitter: &Emitter, period_px: f64) -> Vec<Node> {
    let mut nodes = Vec::new();
    for ([x0, y0, x1, y1], share) in &emitter.rects {
        let along = |from: f64, to: f64| -> Vec<(f64, f64)> {
            let rule = gauss_legendre(nodes_for(to - from, period_px));
            let line: Vec<_> =
                rule.into_iter().map(|(u, w)| (0.5 * (from + to) + 0.5 * u * (to - from), 0.5 * w)).collect();
            blurred(line, emitter.spot_sd_px, period_px)
        };
        let (xs, ys) = (along(*x0, *x1), along(*y0, *y1));
        for (x, wx) in &xs {
            nodes.extend(ys.iter().map(|(y, wy)| (DVec2::new(*x, *y), share * wx * wy)));
        }
    }
    nodes
}

/// Points along a line, each spread as a Gaussian.
fn blurred(line: Vec<(f64, f64)>, sd: f64, period_px: f64) -> Vec<(f64, f64)> {
    if sd <= 0.0 {
        return line;
    }
    let rule: Vec<(f64, f64)> = gauss_legendre(nodes_for(2.0 * SPOT * sd, period_px) + 12)
        .into_iter()
        .map(|(u, w)| (SPOT * sd * u, w * (-0.5 * (SPOT * u).powi(2)).exp()))
        .collect();
    let whole: f64 = rule.iter().map(|r| r.1).sum();
    line.iter().flat_map(|(x, w)| rule.iter().map(move |(u, v)| (x + u, w * v / whole))).collect()
}

/// Points of a polygon with their areas: a fan of triangles, cut until they are small, by the rule of degree 5 with seven points
/// (Radon 1948).
fn aperture(corners: &[DVec2], side: f64) -> Vec<Node> {
    let centre = corners.iter().sum::<DVec2>() / corners.len().max(1) as f64;
    let mut nodes = Vec::new();
    for (i, a) in corners.iter().enumerate() {
        cut([centre, *a, corners[(i + 1) % corners.len()]], side, 6, &mut nodes);
    }
    nodes
}

fn cut([a, b, c]: [DVec2; 3], side: f64, most: u32, nodes: &mut Vec<Node>) {
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    if longest > side && most > 0 {
        let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
        for part in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            cut(part, side, most - 1, nodes);
        }
        return;
    }
    let (root, area) = (15_f64.sqrt(), 0.5 * (b - a).perp_dot(c - a).abs());
    nodes.push(((a + b + c) / 3.0, 0.225 * area));
    for sign in [-1.0, 1.0] {
        let (near, weight) = ((6.0 + sign * root) / 21.0, (155.0 + sign * root) / 1200.0);
        for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
            nodes.push((p * (1.0 - 2.0 * near) + (q + r) * near, weight * area));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_aperture_has_its_area_and_second_moment() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(DVec2::from_array);
        let nodes = aperture(&square, 1.0);
        assert!((nodes.iter().map(|n| n.1).sum::<f64>() - 4.0).abs() < 1e-12);
        assert!((nodes.iter().map(|(p, w)| w * p.x * p.x).sum::<f64>() - 4.0 / 3.0).abs() < 1e-12);
    }
}
