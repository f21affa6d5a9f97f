//! Sums over a cone's polygon of a band-limited image that is known on a coarse periodic grid (a non-uniform FFT of type 2 with
//! the polygon's integral in the weights).
//!
//! With the spreading kernel `φ(z) = exp(β(√(1-z²) - 1))`, |z| <= 1, of width w samples (Barnett, Magland & af Klinteberg 2019)
//! and the image's Fourier coefficients divided by φ's transform, `I(x) = Σ_g φ(x - g) Ĩ_g`. A cone's count is
//! `∫ I dA = Σ_g Ĩ_g ∫ φ(x - g) dA`: its weights are the polygon integrals of φ, by a fan of triangles with the seven-point
//! rule of degree 5 (Radon 1948).

use glam::DVec2;
use multiversion::multiversion;

/// Columns that are summed at a time.
pub const COLUMNS: usize = 2;

/// The spreading kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Width in samples.
    pub width: usize,
    beta: f64,
}

/// Where the weights of one cone are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stencil {
    /// First column and row, inside the grid; the stencil wraps around its edges.
    pub first: [u32; 2],
    /// Columns (a multiple of [`COLUMNS`], the last ones with weights of 0) and rows.
    pub size: [u32; 2],
    /// Place of the first weight, `[row][column]`, among those of all cones.
    pub offset: usize,
}

/// A point of a polygon's quadrature: position and weight (area).
pub type Node = (DVec2, f64);

impl Spread {
    /// A kernel of a width (samples) for a grid that has `oversampling` times the samples that the band limit needs (> 1).
    pub fn new(width: usize, oversampling: f64) -> Self {
        let beta = 0.98 * std::f64::consts::PI * width as f64 * (1.0 - 0.5 / oversampling);
        Self { width, beta }
    }

    /// Its value at a distance in samples; 0 beyond half its width.
    pub fn value(&self, samples: f64) -> f64 {
        let z = 2.0 * samples / self.width as f64;
        let inside = 1.0 - z * z;
        if inside <= 0.0 { 0.0 } else { (self.beta * (inside.sqrt() - 1.0)).exp() }
    }

    /// The kernel's transform at a frequency in cycles per sample, by the midpoint rule in the arc sine of z.
    pub fn transform(&self, cycles_per_sample: f64) -> f64 {
        const NODES: usize = 200;
        let half = self.width as f64 / 2.0;
        let step = std::f64::consts::PI / NODES as f64;
        // Both halves are the same.
        (0..NODES / 2)
            .map(|i| {
                let (z, root) = ((i as f64 + 0.5) * step).sin_cos();
                let phase = std::f64::consts::TAU * cycles_per_sample * half * z;
                2.0 * (self.beta * (root - 1.0)).exp() * phase.cos() * root * half * step
            })
            .sum()
    }
}

/// The spreading kernel at the samples that it reaches, at equal steps of their places, to be read linearly between: within 1e-6 of it.
pub struct SpreadTable {
    width: usize,
    /// Samples, filled up with zeros to whole [`LANES`].
    reached: usize,
    /// `[step][sample]`.
    values: Vec<f64>,
}

/// Steps of the table in a sample.
const STEPS: usize = 1024;
/// Numbers that are added up side by side.
const LANES: usize = 4;
/// Most samples that a kernel reaches.
const MOST: usize = 16;

impl SpreadTable {
    /// Of a kernel.
    pub fn new(spread: &Spread) -> Self {
        let (width, reached) = (spread.width, spread.width.next_multiple_of(LANES));
        let value = |step: usize, sample: usize| {
            let at = sample as f64 + step as f64 / STEPS as f64 - 0.5 * width as f64;
            if sample < width { spread.value(at) } else { 0.0 }
        };
        let line = |step: usize| (0..reached).map(move |sample| value(step, sample));
        Self { width, reached, values: (0..=STEPS).flat_map(line).collect() }
    }

    /// The first sample within reach of a place, and the kernel there and at the next ones, times a factor.
    #[inline(always)]
    #[allow(clippy::inline_always)] // in the caller's vector code only when inlined
    fn read(&self, at: f64, factor: f64, values: &mut [f64]) -> f64 {
        let edge = at - 0.5 * self.width as f64;
        let first = edge.ceil();
        let place = (first - edge) * STEPS as f64;
        let below = (place as usize).min(STEPS - 1);
        let (part, lines) = (place - below as f64, &self.values[below * self.reached..][..2 * self.reached]);
        let (a, b) = lines.split_at(self.reached);
        let (a, b) = (a.as_chunks::<LANES>().0, b.as_chunks::<LANES>().0);
        for ((value, a), b) in values.as_chunks_mut::<LANES>().0.iter_mut().zip(a).zip(b) {
            for lane in 0..LANES {
                value[lane] = factor * (a[lane] + part * (b[lane] - a[lane]));
            }
        }
        first
    }

    /// The weights of quadrature nodes given in samples, on a grid of `grid` columns and rows, put behind those before.
    pub fn weights(&self, nodes: &[Node], grid: [usize; 2], values: &mut Vec<f32>) -> Stencil {
        let (mut min, mut max) = (DVec2::MAX, DVec2::MIN);
        for (at, _) in nodes {
            (min, max) = (min.min(*at), max.max(*at));
        }
        let half = self.width as f64 / 2.0;
        let first = (min - half).ceil();
        let size = ((max + half).floor() - first + 1.0).max(DVec2::ZERO);
        let (columns, rows) = ((size.x as usize).next_multiple_of(COLUMNS), size.y as usize);
        // Whole lanes go on behind the last sample with zeros.
        let line = columns + self.reached;
        let mut sums = vec![0.0; line * rows];
        add_up(self, nodes, first, line, &mut sums);
        let offset = values.len();
        for line in sums.chunks_exact(line.max(1)) {
            values.extend(line[..columns].iter().map(|v| *v as f32));
        }
        let wrap = |value: f64, samples: usize| (value as i64).rem_euclid(samples as i64) as u32;
        let first = [wrap(first.x, grid[0]), wrap(first.y, grid[1])];
        Stencil { first, size: [columns as u32, rows as u32], offset }
    }
}

/// Adds the kernel at all nodes to lines of samples, the first of which stands at `first`.
#[multiversion(targets("x86_64+avx2"))]
fn add_up(table: &SpreadTable, nodes: &[Node], first: DVec2, line: usize, sums: &mut [f64]) {
    let reached = table.reached;
    let mut values = [0.0; 2 * MOST];
    let (across, down) = values.split_at_mut(MOST);
    let (across, down) = (&mut across[..reached], &mut down[..reached]);
    for (at, area) in nodes {
        let left = (table.read(at.x, *area, across) - first.x) as usize;
        let top = (table.read(at.y, 1.0, down) - first.y) as usize;
        for (row, factor) in down[..table.width].iter().enumerate() {
            let sums = &mut sums[(top + row) * line + left..][..reached];
            let sums = sums.as_chunks_mut::<LANES>().0.iter_mut();
            for (sum, value) in sums.zip(across.as_chunks::<LANES>().0) {
                for lane in 0..LANES {
                    sum[lane] += factor * value[lane];
                }
            }
        }
    }
}

/// Quadrature nodes of a convex polygon, exact to degree 5 on each triangle of a fan around its mean corner.
pub fn polygon_nodes(corners: &[DVec2]) -> Vec<Node> {
    let centre = corners.iter().sum::<DVec2>() / corners.len().max(1) as f64;
    let mut nodes = Vec::with_capacity(7 * corners.len());
    for (i, &a) in corners.iter().enumerate() {
        triangle_nodes([centre, a, corners[(i + 1) % corners.len()]], &mut nodes);
    }
    nodes
}

fn triangle_nodes([a, b, c]: [DVec2; 3], nodes: &mut Vec<Node>) {
    // Radon's rule: the centroid and two rings of three points.
    let root = 15_f64.sqrt();
    let area = 0.5 * (b - a).perp_dot(c - a).abs();
    nodes.push(((a + b + c) / 3.0, 0.225 * area));
    for (near, weight) in
        [((6.0 - root) / 21.0, (155.0 - root) / 1200.0), ((6.0 + root) / 21.0, (155.0 + root) / 1200.0)]
    {
        let far = 1.0 - 2.0 * near;
        for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
            nodes.push((p * far + (q + r) * near, weight * area));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygon_nodes_integrate_polynomials() {
        let corners =
            [DVec2::new(0.0, 0.0), DVec2::new(2.0, 0.0), DVec2::new(2.0, 1.0), DVec2::new(0.0, 1.0)];
        let nodes = polygon_nodes(&corners);
        let integral = |f: fn(DVec2) -> f64| nodes.iter().map(|(p, w)| w * f(*p)).sum::<f64>();
        assert!((integral(|_| 1.0) - 2.0).abs() < 1e-12);
        assert!((integral(|p| p.x.powi(3) * p.y * p.y) - 4.0 / 3.0).abs() < 1e-12);
    }

    /// Largest error of a plane wave's integral over squares of a half side, relative to the area.
    fn wave_error(cycles: DVec2, half: f64) -> f64 {
        let spread = Spread::new(8, 1.6);
        let samples = 64;
        let nu = cycles / samples as f64;
        let correction = spread.transform(nu.x) * spread.transform(nu.y);
        let wave = |at: DVec2| (std::f64::consts::TAU * nu.dot(at)).cos();
        let image: Vec<f64> = (0..samples * samples)
            .map(|i| wave(DVec2::new((i % samples) as f64, (i / samples) as f64)) / correction)
            .collect();
        let mut worst = 0.0_f64;
        for centre in [DVec2::new(20.3, 31.7), DVec2::new(63.9, 0.2)] {
            let square =
                [DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0), DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0)]
                    .map(|c| centre + half * c);
            let mut weights = Vec::new();
            let table = SpreadTable::new(&spread);
            let stencil = table.weights(&polygon_nodes(&square), [samples; 2], &mut weights);
            let mut sum = 0.0;
            for (i, w) in weights.iter().enumerate() {
                let column = (stencil.first[0] as usize + i % stencil.size[0] as usize) % samples;
                let row = (stencil.first[1] as usize + i / stencil.size[0] as usize) % samples;
                sum += f64::from(*w) * image[row * samples + column];
            }
            let sinc = |n: f64| (std::f64::consts::TAU * n * half).sin() / (std::f64::consts::PI * n);
            let exact = wave(centre) * sinc(nu.x) * sinc(nu.y);
            worst = worst.max((sum - exact).abs() / (4.0 * half * half));
        }
        worst
    }

    /// High frequency over a small square tests the spreading, low frequency over a large one the quadrature.
    #[test]
    fn waves_are_integrated() {
        let (spreading, quadrature) =
            (wave_error(DVec2::new(13.0, -17.0), 0.05), wave_error(DVec2::new(5.0, -7.0), 0.8));
        assert!(spreading < 3e-6, "{spreading}");
        assert!(quadrature < 3e-6, "{quadrature}");
    }
}
