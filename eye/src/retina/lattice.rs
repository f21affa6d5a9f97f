//! Birth places of the cones: patches of hexagonal lattice, each with its own turn and offset.
//!
//! Patch centres lie on rings of the chart about the foveal centre, 0.87·q spacings apart and as many on a ring as q spacings fit
//! (jittered by a quarter of that). A patch owns the points nearer to its centre than to any other. Inside, lattice point ζ (plane across
//! the cones, complex) is placed at f(ζ) = ζ + α·ζ²/2 with α = conj(∇ ln s): |f'| = s/s0 to first order, so hexagons grow with the
//! spacing s and stay hexagons. The lattice constant is corrected by the mean of (spacing of f / s)² over the patch, which takes
//! out what the first order misses.
//!
//! Of a few random offsets the one is taken that puts the wanted number of cones into the patch, so counts vary far less than at random.
//!
//! Everything is keyed by the global numbers of ring, patch and lattice point: any region gives the same cones.

use std::f64::consts::FRAC_PI_3;

use glam::DVec2;

use super::clip::{Convex, area, centroid, directions};
use super::field::Field;
use super::grid::Grid;
use super::local::Frame;
use super::tile::RegionUm;
use crate::math;
use crate::rng::{Purpose, Stream};

/// Distance of rings in patch widths: rows of a hexagonal arrangement.
const RING_STEP: f64 = 0.87;
/// Jitter of a patch centre along and across its ring, in patch widths.
const JITTER: f64 = 0.25;
/// Lattice indices run from -HALF to HALF - 1.
const HALF: i32 = 256;
/// Lattice offsets tried to get the right number of cones into a patch.
const OFFSETS: usize = 6;
/// Most rings from the fovea to the ora; bounds the loop.
const MAX_RINGS: usize = 60_000;
/// `b` of the random stream of a patch.
const PATCH_STREAM: u64 = 1;

/// One ring of patches.
struct Ring {
    number: u64,
    rho: f64,
    pitch: f64,
    count: u64,
}

/// One patch of lattice.
struct Patch {
    id: u64,
    at: DVec2,
    pitch: f64,
    turn: f64,
    /// What is left of the patch's random numbers.
    stream: Stream,
}

/// Birth places, sorted by id. An id packs ring (16 bits), patch on the ring (18 bits) and lattice point (2 x 9 bits).
#[derive(Debug, Default)]
pub(super) struct Births {
    pub(super) id: Vec<u64>,
    pub(super) at: Vec<DVec2>,
}

/// All birth places inside `region` (closed).
pub(super) fn births(field: &Field, region: &RegionUm) -> Births {
    let patches = patches(field, region);
    let square = directions(4);
    let mut cell = Convex::default();
    let mut out = Births::default();
    let at: Vec<DVec2> = patches.iter().map(|p| p.at).collect();
    let grid = Grid::new(&at, 2.0 * patches.iter().map(|p| p.pitch).fold(0.0, f64::max));
    let mut near = Vec::new();
    for (i, patch) in patches.iter().enumerate() {
        if !region.grown(1.6 * patch.pitch).contains_closed(patch.at) {
            continue;
        }
        // The patch's own cell among its neighbours, cut in the order of their ids.
        cell.reset_regular(&square, 1.8 * patch.pitch);
        near.clear();
        grid.near(patch.at, 3.2 * patch.pitch, |n| near.push(n));
        near.sort_unstable();
        for &n in near.iter().filter(|&&n| n as usize != i) {
            let d = patches[n as usize].at - patch.at;
            if d.length_squared() < (3.2 * patch.pitch).powi(2) {
                cell.cut(d, 0.5 * d.length_squared(), 0);
            }
        }
        fill(field, patch, &cell, region, &mut out);
    }
    out
}

/// The patches that can matter to the region, by ascending id.
fn patches(field: &Field, region: &RegionUm) -> Vec<Patch> {
    let far = region.farthest_from_origin();
    let close = region.distance_to_origin();
    let (mut rho, mut patches) = (0.0, Vec::new());
    for number in 0..MAX_RINGS as u64 {
        let pitch = field.texture(DVec2::new(rho, 0.0)).patch * field.mean_spacing(rho);
        if rho - 5.0 * pitch > far || rho > field.density.ora_um() + 5.0 * pitch {
            break;
        }
        if rho + 5.0 * pitch > close {
            let radius = field.params.geometry.radius_um;
            let around = std::f64::consts::TAU * radius * math::sin_cos(rho / radius).0;
            let count = (around / pitch).round().max(1.0) as u64;
            ring_patches(field, &Ring { number, rho, pitch, count }, region, &mut patches);
        }
        rho += RING_STEP * pitch;
    }
    patches
}

/// Patches of one ring with centres near the region, in order of their number.
fn ring_patches(field: &Field, ring: &Ring, region: &RegionUm, out: &mut Vec<Patch>) {
    let seed = field.params.seed;
    let phase = Stream::new(seed, Purpose::Mosaic, ring.number << 36, PATCH_STREAM).uniform();
    let near = region.grown(5.0 * ring.pitch);
    let step = std::f64::consts::TAU / ring.count as f64;
    let first = out.len();
    for j in numbers_near(&near, ring.count, phase, step) {
        let id = (ring.number << 36) | (j << 18);
        let mut s = Stream::new(seed, Purpose::Mosaic, id | 1, PATCH_STREAM);
        let along = JITTER * (2.0 * s.uniform() - 1.0) * if ring.count > 1 { 1.0 } else { 0.0 };
        let rho = ring.rho + JITTER * ring.pitch * (2.0 * s.uniform() - 1.0);
        let at = math::unit(step * (j as f64 + phase + along)) * rho;
        let turn = FRAC_PI_3 * s.uniform();
        if near.contains_closed(at) {
            out.push(Patch { id, at, pitch: ring.pitch, turn, stream: s });
        }
    }
    out[first..].sort_unstable_by_key(|p| p.id);
}

/// Numbers of the ring's patches inside the angle that the region spans; all of them when it holds the origin.
fn numbers_near(near: &RegionUm, count: u64, phase: f64, step: f64) -> Vec<u64> {
    let corners = near.corners();
    let middle = 0.5 * (near.min + near.max);
    let half = corners
        .iter()
        .map(|&c| math::angle(DVec2::new(middle.dot(c), middle.perp_dot(c))).abs())
        .fold(0.0, f64::max);
    let span = 2.0 * (half / step).ceil() + 6.0;
    if near.contains_closed(DVec2::ZERO) || span >= count as f64 {
        return (0..count).collect();
    }
    let first = ((math::angle(middle) - half) / step - phase).floor() as i64 - 2;
    (first..first + span as i64).map(|j| j.rem_euclid(count as i64) as u64).collect()
}

/// The lattice of one patch, before its offset is chosen.
struct Lattice {
    frame: Frame,
    /// conj(∇ ln s), per µm of the plane.
    alpha: DVec2,
    /// Lattice constant at the patch centre, µm.
    constant: f64,
    e1: DVec2,
    e2: DVec2,
    /// Largest distance of the cell's corners in the plane, with room for the grading, µm.
    reach: f64,
}

impl Lattice {
    fn new(field: &Field, patch: &Patch, cell: &Convex) -> Self {
        let here = field.local(patch.at);
        let frame = here.metric.frame();
        let spacing = field.spacing_with(patch.at, here.cos_tilt);
        let h = 0.5 * spacing;
        let ln = |d: DVec2| math::ln(field.spacing(patch.at + d));
        let (x, y) = (DVec2::new(h, 0.0), DVec2::new(0.0, h));
        let chart = DVec2::new(ln(x) - ln(-x), ln(y) - ln(-y)) / (2.0 * h);
        let gradient = frame.plane_gradient(chart).clamp_length_max(0.3 / patch.pitch);
        let reach =
            cell.corner.iter().map(|&c| frame.plane_from_chart(c).length()).fold(0.0, f64::max) * 1.25;
        let mut lattice = Self {
            frame,
            alpha: DVec2::new(gradient.x, -gradient.y),
            constant: spacing,
            e1: math::unit(patch.turn),
            e2: math::unit(patch.turn + FRAC_PI_3),
            reach,
        };
        // Correct the constant over the patch: the centre and six points whose mean square radius is that of the patch.
        let mut ratio = 1.0;
        for k in 0..6 {
            let u = math::unit(f64::from(k) * FRAC_PI_3) * 0.405 * patch.pitch;
            let stretch = (DVec2::X + product(lattice.alpha, u)).length_squared();
            ratio += stretch * (spacing / field.spacing(patch.at + lattice.warp(u))).powi(2);
        }
        lattice.constant = spacing / (ratio / 7.0).sqrt();
        lattice
    }

    /// The chart step of an ungraded plane step: f(u) = u + α·u²/2.
    fn warp(&self, u: DVec2) -> DVec2 {
        self.frame.chart_from_plane(u + 0.5 * product(self.alpha, product(u, u)))
    }

    /// Calls `f` with the indices and the chart step of every lattice point inside the walls.
    fn points(&self, offset: DVec2, walls: &[(DVec2, f64)], mut f: impl FnMut(i32, i32, DVec2)) {
        let rows = ((self.reach / (self.constant * 0.75_f64.sqrt())) as i32 + 2).min(HALF - 1);
        for b in -rows..rows {
            let row = f64::from(b) + offset.y;
            let across = (row * self.constant).powi(2) * 0.75;
            let side = (self.reach * self.reach - across).max(0.0).sqrt() / self.constant;
            let middle = -0.5 * row - offset.x;
            let (low, high) = ((middle - side).ceil() as i32, (middle + side).floor() as i32);
            for a in low.max(-HALF)..=high.min(HALF - 1) {
                let zeta = self.constant * (self.e1 * (f64::from(a) + offset.x) + self.e2 * row);
                let step = self.warp(zeta);
                if walls.iter().all(|&(normal, end)| normal.dot(step) <= end) {
                    f(a, b, step);
                }
            }
        }
    }
}

/// Cones that the target asks for in a patch: its area on the sphere times the mean density over seven points.
fn wanted_cones(field: &Field, patch: &Patch, cell: &Convex) -> f64 {
    let size = area(&cell.corner);
    let middle = patch.at + centroid(&cell.corner);
    let ring = 0.764 * (size / std::f64::consts::PI).sqrt();
    let around = (0..6).map(|k| middle + math::unit(f64::from(k) * FRAC_PI_3) * ring);
    let density: f64 = around.chain([middle]).map(|p| field.density.per_mm2(p)).sum();
    let here = field.local(middle);
    let births = field.texture(patch.at).births;
    births * 1e-6 * size * here.metric.area_factor() / here.cos_tilt * density / 7.0
}

/// The lattice points of one patch: those inside its cell and the region.
fn fill(field: &Field, patch: &Patch, cell: &Convex, region: &RegionUm, out: &mut Births) {
    let lattice = Lattice::new(field, patch, cell);
    let walls = cell.walls();
    // Of a few offsets, the one with the number of cones nearest to the target (rounded up or down at random).
    let mut stream = patch.stream.clone();
    let wanted = (wanted_cones(field, patch, cell) + stream.uniform()).floor();
    let (mut offset, mut best) = (DVec2::ZERO, f64::INFINITY);
    for _ in 0..OFFSETS {
        let tried = DVec2::new(stream.uniform(), stream.uniform());
        let mut count = 0.0;
        lattice.points(tried, &walls, |_, _, _| count += 1.0);
        if (count - wanted).abs() < best {
            (offset, best) = (tried, (count - wanted).abs());
        }
        if best < 0.5 {
            break;
        }
    }
    lattice.points(offset, &walls, |a, b, step| {
        let at = patch.at + step;
        if region.contains_closed(at) {
            out.id.push(patch.id | (((a + HALF) as u64) << 9) | (b + HALF) as u64);
            out.at.push(at);
        }
    });
}

/// Complex product.
fn product(a: DVec2, b: DVec2) -> DVec2 {
    DVec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)
}
