//! The far tail of the spread: what the copies of a periodic image add is taken away, and what comes from beyond the window is added.
//!
//! A pupil with a sharp edge throws a little light very far. Its transfer leaves frequency 0 with a slope, K(ν) = K(0) + S(φ)·|ν| + …, and
//! the spread ends as the slope's transform: with S(φ) = S₀ + S_c cos 2φ + S_s sin 2φ, at distance r in direction θ
//! `t = −(S₀ + 3 S_c cos 2θ + 3 S_s sin 2θ)/(4π² r³)` (in two dimensions |ν| has the transform −1/(4π² r³); a second harmonic, three times
//! that). A cone at x counts too much from the copies, `Σ_{n≠0} ∫ L(y) t(x − y − nP) dy`, and misses the screen beyond the window.
//!
//! The light is taken in blocks at most a third (beyond the window half) as wide as they, or their nearest copies, are far. The sum over copies is direct for the nearest, the rest an integral.
//! The correction is made at Chebyshev nodes over the cones, read out on a fine grid and interpolated linearly at each cone. Movement within
//! a frame is small against the distances and left out.
//!
//! # Accuracy
//! What is left of 3e-4 (copies 300 µm away, 3 mm of pupil) is some 1e-5 of the mean over cones; see `tests/exposure_tail.rs`.

use glam::DVec2;
use rayon::prelude::*;

use super::bounds;
use super::cones::ConeTable;
use super::expected::Means;
use super::grid::dot;
use super::kernel::Kernels;
use super::light::{Shown, Window, courses, frame_light};
use super::nodes::{chebyshev, lagrange};
use super::primaries::Primaries;
use super::scene::Scene;
use super::source::{Projector, Source};
use super::spectral::{ARRIVING, KINDS};

/// Chebyshev nodes along each side of the cones' rectangle, and points of the grid that is read.
const NODES: usize = 9;
const POINTS: usize = 49;
/// Copies along each axis and direction that are summed one by one.
const COPIES: i32 = 2;
/// Angular terms: 1, cos 2θ, sin 2θ.
const TERMS: usize = 3;
/// Pixels along each side of a block beyond the window that are looked at, at most: enough for what is 3e-4 of the mean.
const LOOKS: u32 = 4;

/// How closely the light is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Looks {
    /// At some pixels of wide blocks: enough for what is 3e-4 of the mean.
    Few,
    /// At all pixels of narrow blocks: beside scattered light the skirt of a single bright pixel matters far from it. A sixteenth of the
    /// distance leaves 9 % of the skirt, 0.5 % of all the light there.
    All,
}

impl Looks {
    /// Widest block of the window and beyond it, parts of the distance of its nearest copy or of itself.
    fn widest(self) -> [f64; 2] {
        match self {
            Self::Few => [1.0 / 3.0, 0.5],
            Self::All => [1.0 / 16.0; 2],
        }
    }

    /// Most pixels along a side of a block.
    fn pixels(self) -> u32 {
        match self {
            Self::Few => LOOKS,
            Self::All => u32::MAX,
        }
    }
}

/// One cone, where it reads the correction.
struct Reader {
    /// Place in the grid, points.
    at: [f32; 2],
    kind: u32,
    /// Area in pixels times the cone's factors.
    factor: f32,
}

/// First column and row of a block of pixels, and those behind its last.
type Block = [u32; 4];

/// A block of the screen beyond the window, with a few of its pixels.
struct Beyond {
    /// Pixels of the display that are looked at.
    pixels: Vec<[u32; 2]>,
    /// Pixels that each stands for.
    each: f64,
}

/// The correction of a scene.
pub struct Tail {
    /// Blocks of the window.
    blocks: Vec<Block>,
    /// Columns of the window.
    width_px: usize,
    beyond: Vec<Beyond>,
    looks: Looks,
    /// `[term][node][block]`: tails at the nodes of a photon a block; blocks of the window (their copies, negative), then those beyond.
    responses: Vec<Vec<f32>>,
    /// `[kind][primary][term]`: factors of the terms.
    slopes: Vec<Vec<[f64; TERMS]>>,
    /// `[point][node]` along an axis.
    weights: Vec<Vec<f64>>,
    readers: Vec<Reader>,
    /// Arriving and guided photons by node.
    arriving: Vec<[f64; 2]>,
}

impl Tail {
    /// Prepares the correction over a tile's cones, with few or all pixels looked at; `None` when it has none.
    pub fn new(scene: &Scene, primaries: &Primaries, cones: &ConeTable, looks: Looks) -> Option<Self> {
        let Primaries { kernels, projector } = primaries;
        if cones.cones.is_empty() || scene.size_px.contains(&0) {
            return None;
        }
        let (min, max) = bounds(cones.cones.iter().flat_map(|c| c.polygon_px.iter().copied()));
        let period = DVec2::new(scene.period_px[0] as f64, scene.period_px[1] as f64);
        let blocks = blocks(scene, period, [min, max], looks.widest()[0]);
        let middles: Vec<DVec2> = blocks.iter().map(|block| middle(corners(block))).collect();
        let (beyond, places) = beyond(projector, scene, [min, max], looks);
        let [xs, ys] = [0, 1].map(|axis| chebyshev(min[axis], max[axis].max(min[axis] + 1e-9), NODES));
        let nodes: Vec<DVec2> = ys.iter().flat_map(|y| xs.iter().map(move |x| DVec2::new(*x, *y))).collect();
        let tails: Vec<Vec<[f64; TERMS]>> = nodes
            .par_iter()
            .map(|node| {
                let copies = middles.iter().map(|y| copies(*node - *y, period).map(|t| -t));
                copies.chain(places.iter().map(|y| tail(*node - *y))).collect()
            })
            .collect();
        let term = |t: usize| tails.iter().flatten().map(|tail| tail[t] as f32).collect();
        let point =
            |i: usize| lagrange(&chebyshev(-1.0, 1.0, NODES), 2.0 * i as f64 / (POINTS - 1) as f64 - 1.0);
        let step = (max - min).max(DVec2::splat(1e-9)) / (POINTS - 1) as f64;
        let middle = cones.cones.iter().min_by(|a, b| {
            let off = |c: &super::cones::MappedCone| {
                (c.polygon_px.first().copied().unwrap_or_default() - 0.5 * (min + max)).length()
            };
            off(a).total_cmp(&off(b))
        })?;
        let slopes = (0..KINDS.len())
            .map(|kind| slopes(kernels, kind, (middle.um, middle.ecc_deg), scene.tangent_per_px))
            .collect();
        let mut arriving = vec![[0.0; 2]; nodes.len()];
        let readers = cones
            .cones
            .iter()
            .map(|cone| {
                let (centre, factor) = centroid(&cone.polygon_px);
                let (across, down) = (lagrange(&xs, centre.x), lagrange(&ys, centre.y));
                for (sum, (v, u)) in
                    arriving.iter_mut().zip(down.iter().flat_map(|v| across.iter().map(move |u| (v, u))))
                {
                    *sum = [sum[0] + factor * u * v, sum[1] + factor * cone.pointing * u * v];
                }
                let at = ((centre - min) / step).to_array().map(|a| a as f32);
                Reader { at, kind: cone.cone_type as u32, factor: (factor * cone.pointing) as f32 }
            })
            .collect();
        Some(Self {
            blocks,
            width_px: scene.size_px[0] as usize,
            beyond,
            looks,
            responses: (0..TERMS).map(term).collect(),
            slopes,
            weights: (0..POINTS).map(point).collect(),
            readers,
            arriving,
        })
    }

    /// Corrects the means of a frame.
    pub fn correct(&self, means: &mut Means, (shown, source): (&Shown, &Source), projector: &Projector) {
        // `[kind][node]`.
        let mut by_kind = vec![vec![0.0; NODES * NODES]; KINDS.len()];
        for (primary, slopes) in (0..source.primaries.len()).zip(0..) {
            let light = self.light(primary, shown, source, projector);
            for (term, responses) in self.responses.iter().enumerate() {
                for (node, line) in responses.chunks_exact(light.len().max(1)).enumerate() {
                    let sum = dot(line, &light);
                    for (kind, nodes) in by_kind.iter_mut().enumerate() {
                        nodes[node] += self.slopes[kind][slopes][term] * sum;
                    }
                }
            }
        }
        for (node, [arrived, guided]) in by_kind[ARRIVING].iter().zip(&self.arriving) {
            means.arrived += node * arrived;
            means.guided += node * guided;
        }
        let grids: Vec<Vec<f32>> = by_kind[..ARRIVING].iter().map(|nodes| self.grid(nodes)).collect();
        for (mean, reader) in means.isomerized.iter_mut().zip(&self.readers) {
            *mean += f64::from(reader.factor * reader.read(&grids[reader.kind as usize]));
        }
    }

    /// A primary's light by block: of the window, then beyond.
    fn light(&self, primary: usize, shown: &Shown, source: &Source, projector: &Projector) -> Vec<f64> {
        let mut light = vec![0.0; self.blocks.len()];
        for layer in &source.primaries[primary].layers {
            let (sent, blocks) = (layer.sent(), layer.light.blocks(|light| self.by_block(light)));
            light.iter_mut().zip(blocks).for_each(|(light, block)| *light += sent * block);
        }
        let emitter = &projector.emitters[primary];
        let display = &projector.display;
        let courses = courses(emitter, display, shown.index);
        let photons = emitter.emitted() * projector.pupil_share;
        // All pixels are faster in rows.
        let size = [display.width_px, display.height_px];
        let rows = (self.looks == Looks::All && !self.beyond.is_empty())
            .then(|| Window { first: [0; 2], size }.frame_light(display, emitter, &courses, shown));
        light.par_extend(self.beyond.par_iter().map(|block| {
            let of = |at: &[u32; 2]| match &rows {
                Some(rows) => rows[at[1] as usize * display.width_px as usize + at[0] as usize],
                None => frame_light(display, emitter, &courses, shown, *at),
            };
            block.each * photons * block.pixels.iter().map(of).sum::<f64>()
        }));
        light
    }

    /// Sums over the blocks of the window of its pixels' values.
    fn by_block(&self, values: &[f64]) -> Vec<f64> {
        let sum = |block: &Block| {
            let [x0, y0, x1, y1] = block.map(|at| at as usize);
            let rows = values[y0 * self.width_px..y1 * self.width_px].chunks_exact(self.width_px);
            rows.map(|row| row[x0..x1].iter().sum::<f64>()).sum()
        };
        self.blocks.iter().map(sum).collect()
    }

    /// Values at the nodes on the fine grid, `[y][x]`.
    fn grid(&self, nodes: &[f64]) -> Vec<f32> {
        let rows: Vec<Vec<f64>> = nodes
            .chunks_exact(NODES)
            .map(|row| self.weights.iter().map(|w| w.iter().zip(row).map(|(w, v)| w * v).sum()).collect())
            .collect();
        let at = |w: &Vec<f64>, x: usize| w.iter().zip(&rows).map(|(w, row)| w * row[x]).sum::<f64>() as f32;
        self.weights.iter().flat_map(|w| (0..POINTS).map(move |x| (w, x))).map(|(w, x)| at(w, x)).collect()
    }
}

impl Reader {
    /// The grid at its place, linear between points.
    fn read(&self, grid: &[f32]) -> f32 {
        let [x, y] = self.at.map(|a| (a.max(0.0) as usize).min(POINTS - 2));
        let (tx, ty) = (self.at[0] - x as f32, self.at[1] - y as f32);
        let row = |y: usize| grid[y * POINTS + x] * (1.0 - tx) + grid[y * POINTS + x + 1] * tx;
        row(y) * (1.0 - ty) + row(y + 1) * ty
    }
}

/// 1/r³, cos 2θ/r³ and sin 2θ/r³ of a displacement in pixels (y down; θ counts with y up).
fn tail(d: DVec2) -> [f64; TERMS] {
    let square = d.length_squared().max(1e-12);
    let cube = 1.0 / (square * square.sqrt());
    [cube, cube * (d.x * d.x - d.y * d.y) / square, -cube * 2.0 * d.x * d.y / square]
}

/// The sum of the tails of all copies but the first.
fn copies(d: DVec2, period: DVec2) -> [f64; TERMS] {
    let mut sum = [0.0; TERMS];
    for i in -COPIES..=COPIES {
        for j in -COPIES..=COPIES {
            if (i, j) != (0, 0) {
                let one = tail(d - period * DVec2::new(f64::from(i), f64::from(j)));
                sum.iter_mut().zip(one).for_each(|(s, t)| *s += t);
            }
        }
    }
    // The others as an even density outside a rectangle of half sides a, b: ∫ dA/r³ = 4 √(a² + b²)/(ab).
    let half = period * (f64::from(COPIES) + 0.5);
    sum[0] += 4.0 * half.length() / (half.x * half.y * period.x * period.y);
    sum
}

/// `[primary]`: the factors of [`tail`]'s terms for a kind at a place (µm, degrees): photons counted per pixel² and photon.
fn slopes(
    kernels: &Kernels,
    kind: usize,
    (um, ecc_deg): (DVec2, f64),
    tangent_per_px: f64,
) -> Vec<[f64; TERMS]> {
    let shape = kernels.shape();
    let step = shape.radius / (shape.radial - 1) as f64;
    let own = kernels.coefficients(kind, um, ecc_deg);
    let of_primary = |primary: usize| {
        let mut harmonics = [0.0; TERMS];
        for azimuth in 0..shape.azimuthal {
            let f = |k: usize| {
                let values = own.iter().enumerate();
                values
                    .map(|(r, c)| c * kernels.table(kind, r, primary)[azimuth * shape.radial + k].re)
                    .sum::<f64>()
            };
            // One-sided, exact to third degree.
            let slope = (-11.0 * f(0) + 18.0 * f(1) - 9.0 * f(2) + 2.0 * f(3)) / (6.0 * step);
            let turn = std::f64::consts::TAU * azimuth as f64 / shape.azimuthal as f64;
            let parts = [1.0, 2.0 * turn.cos(), 2.0 * turn.sin()];
            harmonics.iter_mut().zip(parts).for_each(|(h, p)| *h += slope * p / shape.azimuthal as f64);
        }
        // Per unit tangent² at tangents -> per pixel² at pixels.
        let scale = -1.0 / (4.0 * std::f64::consts::PI.powi(2) * tangent_per_px);
        [scale * harmonics[0], 3.0 * scale * harmonics[1], 3.0 * scale * harmonics[2]]
    };
    (0..kernels.shares().len()).map(of_primary).collect()
}

/// Blocks of the window, each no wider than a part of the distance of its nearest copy from the cones.
fn blocks(scene: &Scene, period: DVec2, [min, max]: [DVec2; 2], widest: f64) -> Vec<Block> {
    let [width, height] = scene.size_px;
    let gap = |[from, to]: [DVec2; 2]| {
        let copies = (-1..=1).flat_map(|x| (-1..=1).map(move |y| (x, y))).filter(|copy| *copy != (0, 0));
        let of = |(x, y): (i32, i32)| {
            let moved = period * DVec2::new(f64::from(x), f64::from(y));
            (min - to - moved).max(from + moved - max).max(DVec2::ZERO).length()
        };
        copies.map(of).fold(f64::MAX, f64::min)
    };
    halved(vec![[0, 0, width, height]], |corners| widest * gap(corners))
}

/// Rectangles, halved until none is wider than `most` of its corners, pixels, or a pixel.
fn halved(mut open: Vec<Block>, most: impl Fn([DVec2; 2]) -> f64) -> Vec<Block> {
    let mut done = Vec::new();
    while let Some(block) = open.pop() {
        let [x0, y0, x1, y1] = block;
        let size = [x1.saturating_sub(x0), y1.saturating_sub(y0)];
        if size.contains(&0) {
            continue;
        }
        if f64::from(size[0].max(size[1])) <= most(corners(&block)).max(1.0) {
            done.push(block);
        } else if size[0] >= size[1] {
            let x = x0.midpoint(x1);
            open.extend([[x0, y0, x, y1], [x, y0, x1, y1]]);
        } else {
            let y = y0.midpoint(y1);
            open.extend([[x0, y0, x1, y], [x0, y, x1, y1]]);
        }
    }
    done
}

/// Two corners of a block.
fn corners(block: &Block) -> [DVec2; 2] {
    let [x0, y0, x1, y1] = block.map(f64::from);
    [DVec2::new(x0, y0), DVec2::new(x1, y1)]
}

fn middle([from, to]: [DVec2; 2]) -> DVec2 {
    0.5 * (from + to)
}

/// Blocks of the screen beyond the window, with their middles in pixels from the window's corner.
fn beyond(
    projector: &Projector,
    scene: &Scene,
    [min, max]: [DVec2; 2],
    looks: Looks,
) -> (Vec<Beyond>, Vec<DVec2>) {
    let [width, height] = [projector.display.width_px, projector.display.height_px];
    let ([left, top], [across, down]) = (scene.first_px, scene.size_px);
    let (right, bottom) = (left + across, top + down);
    let around = vec![
        [0, 0, width, top],
        [0, bottom, width, height],
        [0, top, left, bottom],
        [right, top, width, bottom],
    ];
    let corner = DVec2::new(f64::from(left), f64::from(top));
    let gap = |[from, to]: [DVec2; 2]| (min - to).max(from - max).max(DVec2::ZERO).length();
    let seen = |block: [DVec2; 2]| block.map(|at| at - corner);
    let (mut blocks, mut places) = (Vec::new(), Vec::new());
    for block in halved(around, |corners| looks.widest()[1] * gap(seen(corners))) {
        let [x0, y0, x1, y1] = block;
        let (columns, rows) = ((x1 - x0).min(looks.pixels()), (y1 - y0).min(looks.pixels()));
        // Odd steps through the pixels: a regular pattern is not met always at the same phase.
        let place = |i: u32, n: u32, size: u32, other: u32| {
            (i * size / n + (other * 7 + i * 3) % (size / n)).min(size - 1)
        };
        let pixels: Vec<[u32; 2]> = (0..rows)
            .flat_map(|j| (0..columns).map(move |i| (i, j)))
            .map(|(i, j)| [x0 + place(i, columns, x1 - x0, j), y0 + place(j, rows, y1 - y0, i)])
            .collect();
        blocks.push(Beyond { each: f64::from(x1 - x0) * f64::from(y1 - y0) / pixels.len() as f64, pixels });
        places.push(middle(seen(corners(&block))));
    }
    (blocks, places)
}

/// Centre and area of a polygon.
fn centroid(polygon: &[DVec2]) -> (DVec2, f64) {
    let Some(first) = polygon.first() else { return (DVec2::ZERO, 0.0) };
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        let (a, b) = (*a - *first, *b - *first);
        let twice = a.perp_dot(b);
        area += 0.5 * twice;
        moment += (a + b) * (twice / 6.0);
    }
    if area.abs() < 1e-300 { (*first, 0.0) } else { (*first + moment / area, area.abs()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rest of the lattice as an integral against many more copies one by one.
    #[test]
    fn the_sum_over_copies() {
        let period = DVec2::new(3.0, 2.0);
        let d = DVec2::new(0.4, -0.3);
        let mut exact = 0.0;
        for i in -400..=400 {
            for j in -400..=400 {
                if (i, j) != (0, 0) {
                    exact += tail(d - period * DVec2::new(f64::from(i), f64::from(j)))[0];
                }
            }
        }
        let half = period * 400.5;
        exact += 4.0 * half.length() / (half.x * half.y * period.x * period.y);
        let made = copies(d, period)[0];
        assert!((made / exact - 1.0).abs() < 0.01, "{made} {exact}");
    }

    #[test]
    fn area_and_centre_of_a_triangle() {
        let (centre, area) = centroid(&[DVec2::new(1.0, 1.0), DVec2::new(4.0, 1.0), DVec2::new(1.0, 3.0)]);
        assert!((area - 3.0).abs() < 1e-12 && (centre - DVec2::new(2.0, 5.0 / 3.0)).length() < 1e-12);
    }
}
