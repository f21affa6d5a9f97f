//! Sums over a cone's polygon of a band-limited image that is known on a coarse periodic grid (a non-uniform FFT of type 2 with
//! the polygon's integral in the weights).
//!
//! With the spreading kernel `φ(z) = exp(β(√(1-z²) - 1))`, |z| <= 1, of width w samples (Barnett, Magland & af Klinteberg 2019)
//! and the image's Fourier coefficients divided by φ's transform, `I(x) = Σ_g φ(x - g) Ĩ_g`. A cone's count is
//! `∫ I dA = Σ_g Ĩ_g ∫ φ(x - g) dA`: its weights are the polygon integrals of φ, by a fan of triangles with the seven-point
//! rule of degree 5 (Radon 1948).

use glam::DVec2;

/// Columns that are summed at a time.
pub const COLUMNS: usize = 2;

/// The spreading kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Width in samples.
    pub width: usize,
    beta: f64,
}

/// The weights of one cone on the grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConeWeights {
    /// First column and row, inside the grid; the stencil wraps around its edges.
    pub first: [u32; 2],
    /// Columns (a multiple of [`COLUMNS`], the last ones with weights of 0) and rows.
    pub size: [u32; 2],
    /// `[row][column]`.
    pub values: Vec<f32>,
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
        (0..NODES)
            .map(|i| {
                let angle = (i as f64 + 0.5) * step - std::f64::consts::FRAC_PI_2;
                let (z, root) = angle.sin_cos();
                let phase = std::f64::consts::TAU * cycles_per_sample * half * z;
                (self.beta * (root - 1.0)).exp() * phase.cos() * root * half * step
            })
            .sum()
    }
}

/// The spreading kernel at equal steps, to be read linearly between them: within 1e-6 of it.
pub struct SpreadTable {
    width: usize,
    per_sample: f64,
    /// From the middle outwards, and two zeros.
    values: Vec<f64>,
}

/// Steps of the table from the middle to the edge.
const STEPS: usize = 4096;

impl SpreadTable {
    /// Of a kernel.
    pub fn new(spread: &Spread) -> Self {
        let per_sample = STEPS as f64 / (0.5 * spread.width as f64);
        let value = |i: usize| spread.value(i as f64 / per_sample);
        Self { width: spread.width, per_sample, values: (0..STEPS).map(value).chain([0.0; 2]).collect() }
    }

    /// The kernel at a distance in samples.
    fn value(&self, samples: f64) -> f64 {
        let at = (samples.abs() * self.per_sample).min(STEPS as f64);
        let below = at as usize;
        let [a, b] = [self.values[below], self.values[below + 1]];
        a + (b - a) * (at - below as f64)
    }

    /// The weights of quadrature nodes given in samples, on a grid of `grid` columns and rows.
    pub fn weights(&self, nodes: &[Node], grid: [usize; 2]) -> ConeWeights {
        let (mut min, mut max) = (DVec2::MAX, DVec2::MIN);
        for (at, _) in nodes {
            (min, max) = (min.min(*at), max.max(*at));
        }
        let half = self.width as f64 / 2.0;
        let first = (min - half).ceil();
        let size = ((max + half).floor() - first + 1.0).max(DVec2::ZERO);
        let (used, rows) = (size.x as usize, size.y as usize);
        let columns = used.next_multiple_of(COLUMNS);
        let mut values = vec![0.0_f64; columns * rows];
        let mut across = vec![0.0; columns];
        for (at, area) in nodes {
            let start = ((at.x - half).ceil() - first.x) as usize;
            let end = (start + self.width + 1).min(used);
            for (i, value) in across.iter_mut().enumerate().take(end).skip(start) {
                *value = area * self.value(first.x + i as f64 - at.x);
            }
            let top = ((at.y - half).ceil() - first.y) as usize;
            for row in top..(top + self.width + 1).min(rows) {
                let down = self.value(first.y + row as f64 - at.y);
                let line = &mut values[row * columns + start..row * columns + end];
                line.iter_mut().zip(&across[start..end]).for_each(|(v, a)| *v += down * a);
            }
        }
        let wrap = |value: f64, samples: usize| (value as i64).rem_euclid(samples as i64) as u32;
        ConeWeights {
            first: [wrap(first.x, grid[0]), wrap(first.y, grid[1])],
            size: [columns as u32, rows as u32],
            values: values.into_iter().map(|v| v as f32).collect(),
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
            let weights = SpreadTable::new(&spread).weights(&polygon_nodes(&square), [samples; 2]);
            let mut sum = 0.0;
            for (i, w) in weights.values.iter().enumerate() {
                let column = (weights.first[0] as usize + i % weights.size[0] as usize) % samples;
                let row = (weights.first[1] as usize + i / weights.size[0] as usize) % samples;
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
