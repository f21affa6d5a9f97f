//! Where the next ring is placed, and how its spacing is held to the target density.
//!
//! The edge of the retina is the last ring, its eccentricity averaged over nine cones. The new ring runs 0.87 spacings outside it, measured across
//! the cones, so rings are not circles: spacings differ by meridian and tilt. Along it the cones are one spacing apart, from a random start, and each is moved at random by up to half a
//! spacing along the ring and 0.3 across; an even ring would grow into a lattice with hardly a fault.
//!
//! Feedback. The drive towards the centre and the disorder change the density that a nominal radius leads to by a few per cent. Let S be the area that
//! the target allots to the cones born so far and A the area inside the edge, both on the chart. The next ring's spacing and radii are multiplied by
//! factor = 1 + ½·(S - A)/(area of 10 rows), kept within ±6 %: the surplus is worked off over 10 rows.
//! It stops when the first part of the edge has reached the ora.

use glam::DVec2;

use super::super::field::Field;
use super::super::local::Metric;
use super::cone::Cone;
use super::sectors::turn;
use crate::math;
use crate::rng::{Purpose, Stream};

/// Distance of the new ring from the last, in spacings.
const ROW: f64 = 0.87;
/// Largest random change of a place along and across the ring, in spacings.
const JITTER: [f64; 2] = [0.5, 0.3];
/// Cones on either side over which the edge is averaged.
const WINDOW: usize = 4;
/// A wider gap between cones of the last ring, in spacings, is not bridged.
const GAP: f64 = 6.0;
/// Rows that are grown beyond the ora, for the cells inside it.
const ROWS_BEYOND: f64 = 12.0;
/// The cones born so far fill the area up to this many rows outside the last ring, once settled: the outer rows are still loose.
const EDGE_ROWS: f64 = -0.1;
/// Rows over which a surplus is worked off, and the largest change of spacing.
const REPAIR_ROWS: f64 = 10.0;
const LARGEST_CHANGE: f64 = 0.06;
/// `b` of the random stream of a ring's start.
const RING_STREAM: u64 = 4;
/// `b` of the random stream of a place on a ring.
const JITTER_STREAM: u64 = 5;
/// Cones of the seed.
pub(super) const SEED_CONES: usize = 7;

/// The growing edge.
#[derive(Debug)]
pub(super) struct Front {
    /// Multiplies spacing and radius of the next ring.
    pub(super) factor: f64,
    /// Area that the target allots to frozen cones, µm² of the chart.
    settled_um2: f64,
    /// Mean eccentricity of the last ring, µm.
    pub(super) rho: f64,
    /// The whole edge is short of the ora.
    closed: bool,
}

/// One point of the curve on which the new ring is placed.
struct Vertex {
    at: DVec2,
    metric: Metric,
    spacing: f64,
    /// Distance from the edge, µm of the chart.
    row: f64,
    /// Short of the ora.
    inside: bool,
}

impl Front {
    pub(super) fn new() -> Self {
        Self { factor: 1.0, settled_um2: 0.0, rho: 0.0, closed: true }
    }

    /// The places of the seed: one cone and a hexagon.
    pub(super) fn seed(field: &Field) -> [DVec2; SEED_CONES] {
        let start = Stream::new(field.params.seed, Purpose::Mosaic, 0, RING_STREAM).uniform();
        let frame = field.local(DVec2::ZERO).metric.frame();
        let spacing = field.spacing(DVec2::ZERO);
        std::array::from_fn(|k| {
            let u = math::unit((start + k as f64) * std::f64::consts::FRAC_PI_3) * spacing;
            if k == 0 { DVec2::ZERO } else { frame.chart_from_plane(u) }
        })
    }

    /// The places of ring `number`, outside the cones of the last one; none once the ora is passed all round.
    pub(super) fn next_ring(&mut self, field: &Field, last: &[&Cone], number: u32) -> Vec<DVec2> {
        let edge = smooth_edge(last);
        self.rho = edge.iter().map(|e| e.length()).sum::<f64>() / edge.len().max(1) as f64;
        let vertices: Vec<Vertex> = edge.iter().map(|&e| self.vertex(field, e)).collect();
        self.closed &= vertices.iter().all(|v| v.inside);
        let lengths: Vec<f64> =
            (0..edge.len()).map(|i| self.length(&vertices[i], &vertices[(i + 1) % vertices.len()])).collect();
        let total = lengths.iter().sum::<f64>();
        let count = total.round();
        if count < 1.0 {
            return Vec::new();
        }
        let step = total / count;
        let start = Stream::new(field.params.seed, Purpose::Mosaic, u64::from(number), RING_STREAM).uniform();
        let (mut passed, mut next) = (0.0, start * step);
        let mut places = Vec::with_capacity(count as usize + 1);
        for (i, &length) in lengths.iter().enumerate() {
            let (a, b) = (vertices[i].at, vertices[(i + 1) % vertices.len()].at);
            while next < passed + length {
                let t = (next - passed) / length;
                let chord = a + (b - a) * t;
                let rho = a.length() + (b.length() - a.length()) * t;
                let place = chord * (rho / chord.length());
                let id = (u64::from(number) << 32) | places.len() as u64;
                let mut stream = Stream::new(field.params.seed, Purpose::Mosaic, id, JITTER_STREAM);
                let [along, out] = JITTER.map(|j| j * (2.0 * stream.uniform() - 1.0));
                let row = vertices[i].row / (ROW * place.length());
                places.push(place + (b - a) * (along / length) + place * (out * row));
                next += step;
            }
            passed += length;
        }
        places
    }

    fn vertex(&self, field: &Field, edge: DVec2) -> Vertex {
        let here = field.local(edge);
        let spacing = self.factor * field.spacing_with(edge, here.cos_tilt);
        let (rho, out) = (edge.length(), edge / edge.length());
        let row = ROW * spacing / here.metric.length2(out).sqrt();
        let inside = rho < field.density.ora_toward_um(edge) + ROWS_BEYOND * row;
        Vertex { at: out * (rho + row), metric: here.metric, spacing, row, inside }
    }

    /// Length of the curve between two vertices in spacings; 0 where no cones are wanted.
    fn length(&self, a: &Vertex, b: &Vertex) -> f64 {
        let chord = 0.5 * a.metric.plus(&b.metric).length2(b.at - a.at);
        let between = angle_between(a.at, b.at);
        let length = chord.sqrt() * (1.0 + between * between / 24.0) / (0.5 * (a.spacing + b.spacing));
        if a.inside && b.inside && (length < GAP || self.rho < GAP * a.spacing) { length } else { 0.0 }
    }

    /// Counts a cone that has been frozen at its final place.
    pub(super) fn add_frozen(&mut self, cone: &Cone) {
        self.settled_um2 += allotted_um2(cone);
    }

    /// Corrects the factor after a growth cycle, from the cones that move and the last ring.
    pub(super) fn correct(&mut self, live: &[Cone], last: &[&Cone]) {
        if !self.closed || last.len() < SEED_CONES {
            return;
        }
        let moving: f64 = live.iter().filter(|c| !c.frozen).map(allotted_um2).sum();
        let edge = smooth_edge(last);
        let (mut area, mut row_area) = (0.0, 0.0);
        for (i, cone) in last.iter().enumerate() {
            let (a, b) = (edge[i], edge[(i + 1) % edge.len()]);
            let row = ROW * cone.spacing / cone.metric.length2(a / a.length()).sqrt();
            let rho = 0.5 * (a.length() + b.length()) + EDGE_ROWS * row;
            let angle = angle_between(a, b);
            area += 0.5 * rho * rho * angle;
            row_area += rho * row * angle;
        }
        let surplus = self.settled_um2 + moving - area;
        self.factor = 1.0 + (0.5 * surplus / (REPAIR_ROWS * row_area)).clamp(-LARGEST_CHANGE, LARGEST_CHANGE);
    }
}

/// Area of the chart that the target allots to a cone. The area across the cone, √3/2·spacing², is that on the chart times the metric's factor.
fn allotted_um2(cone: &Cone) -> f64 {
    0.75_f64.sqrt() * cone.spacing * cone.spacing / cone.metric.area_factor()
}

/// The angle from a to b.
fn angle_between(a: DVec2, b: DVec2) -> f64 {
    math::angle(DVec2::new(a.dot(b), a.perp_dot(b)))
}

/// The last ring sorted by angle.
pub(super) fn last_ring(cones: &[Cone], number: u32) -> Vec<&Cone> {
    let mut last: Vec<&Cone> = cones.iter().filter(|c| c.ring == Some(number)).collect();
    last.sort_by(|a, b| turn(a.at).total_cmp(&turn(b.at)).then(a.id.cmp(&b.id)));
    last
}

/// Places of the last ring with their eccentricities averaged over neighbours, on as many cones on either side as there are before a gap.
fn smooth_edge(last: &[&Cone]) -> Vec<DVec2> {
    let n = last.len();
    let most = WINDOW.min(n.saturating_sub(1) / 2);
    // Cone m - 1 and cone m of the ring are the ends of two arcs.
    let parted = |m: usize| {
        let (a, b) = (last[(m + n - 1) % n], last[m % n]);
        a.metric.length2(b.at - a.at) > (GAP * a.spacing).powi(2)
    };
    (0..n)
        .map(|i| {
            let half = (0..most).find(|&h| parted(i + n - h) || parted(i + h + 1)).unwrap_or(most);
            let sum: f64 = (0..=2 * half).map(|k| last[(i + n + k - half) % n].at.length()).sum();
            last[i].at * (sum / (2 * half + 1) as f64 / last[i].at.length())
        })
        .collect()
}
