//! Point spreads from rays through sampled points of the stop (§21), to be compared with the fitted form in error and time.
//!
//! field(ξ) = Σ over rays of w·a·exp(i k' (W − q·ξ)). The exponential of each ray is a product of one along i and one along j, so a
//! point spread of n × n samples takes 2n exponentials and n² multiplications a ray instead of n² exponentials.
//!
//! # As printed
//! "1024 randomly perturbed primary paths": read as `Random` (independent places), the error falls as the root of the number of rays and
//! what is far from the core is noise; read as `Stratified` (one ray jittered in each cell of equal area) it is a fair quadrature.

use super::huygens::weights;
use super::matrix::PsfGrid;
use super::wavefront::{WavefrontOptions, meridional_angle_of};
use crate::optics::{Object, OpticsError, PupilBundle, PupilNodes, SchematicEye};
use crate::rng::{Purpose, Stream};
use glam::DVec2;
use std::f64::consts::{PI, TAU};

/// Where the rays cross the stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PupilSampling {
    /// Independent, uniform over the area.
    Random,
    /// One in each of as many cells of equal area, anywhere in it.
    Stratified,
    /// A square lattice.
    Grid,
    /// Gauss–Legendre in r², uniform azimuth.
    Gauss,
}

impl PupilSampling {
    /// About `rays` (at least 4) points of the unit stop with weights that sum to π.
    pub fn points(self, rays: usize, seed: u64) -> Vec<(DVec2, f64)> {
        let rays = rays.max(4);
        let mut stream = Stream::new(seed, Purpose::Study, 0, 0);
        let points: Vec<DVec2> = match self {
            Self::Random => (0..rays).map(|_| in_cell([0.0, 1.0], [0.0, 1.0], &mut stream)).collect(),
            Self::Stratified => {
                // Three times as many spokes as rings: cells about as wide as long.
                let rings = (rays as f64 / 3.0).sqrt().round().max(1.0);
                let spokes = (rays as f64 / rings).round();
                let cells = (0..rings as usize).flat_map(|r| (0..spokes as usize).map(move |s| (r, s)));
                let part = |k: usize, of: f64| [k as f64 / of, (k + 1) as f64 / of];
                cells.map(|(r, s)| in_cell(part(r, rings), part(s, spokes), &mut stream)).collect()
            }
            Self::Grid => {
                let half = (rays as f64 / PI).sqrt();
                let reach = half.ceil() as i64;
                let line = || (-reach..reach).map(|k| (k as f64 + 0.5) / half);
                let square = line().flat_map(|x| line().map(move |y| DVec2::new(x, y)));
                square.filter(|p| p.length_squared() <= 1.0).collect()
            }
            Self::Gauss => {
                let radial = ((rays as f64 / 3.0 + 1.0).sqrt() - 1.0).round().max(1.0) as usize;
                return PupilNodes { radial, azimuth: rays / radial, edge: 0 }.points();
            }
        };
        let weight = PI / points.len().max(1) as f64;
        points.into_iter().map(|p| (p, weight)).collect()
    }
}

/// A point of equal chance in a cell: ranges of r² and of the azimuth in turns.
fn in_cell(squared: [f64; 2], turns: [f64; 2], stream: &mut Stream) -> DVec2 {
    let within = |[a, b]: [f64; 2], u: f64| a + u * (b - a);
    let (u, v) = (stream.uniform(), stream.uniform());
    DVec2::from_angle(TAU * within(turns, v)) * within(squared, u).sqrt()
}

/// The point spread, row-major, as [`super::matrix::psf`]: 1 = the same rays with no path difference, at the centre.
///
/// # Errors
/// As [`super::Wavefront::new`].
pub fn psf(
    eye: &SchematicEye,
    object: Object,
    wavelength_nm: f64,
    wavefront: &WavefrontOptions,
    points: &[(DVec2, f64)],
    grid: &PsfGrid,
) -> Result<Vec<f64>, OpticsError> {
    let bundle = PupilBundle::trace_points(eye, object, wavelength_nm, points, &[])?;
    let weights = weights(eye, object, &bundle, wavefront)?;
    let total: f64 = weights.iter().sum();
    let (e_i, e_j) = grid.axes_of(meridional_angle_of(eye, &bundle));
    let turns_per_um = 1.0 / (bundle.wavelength_mm() * 1e3);
    let n = grid.samples;
    let offsets: Vec<f64> = (0..n).map(|i| grid.offset(i)).collect();
    let (mut re, mut im) = (vec![0.0; n * n], vec![0.0; n * n]);
    let (mut cos_j, mut sin_j) = (vec![0.0; n], vec![0.0; n]);
    for (ray, weight) in bundle.rays.iter().zip(&weights) {
        let (q_i, q_j) = (ray.q.dot(e_i), ray.q.dot(e_j));
        let start = ray.opd_mm * 1e3 - ray.q.dot(grid.centre_um);
        for ((s, c), offset) in sin_j.iter_mut().zip(&mut cos_j).zip(&offsets) {
            (*s, *c) = (-TAU * turns_per_um * q_j * offset).sin_cos();
        }
        for (i, offset) in offsets.iter().enumerate() {
            let (sin, cos) = (TAU * turns_per_um * (start - q_i * offset)).sin_cos();
            let (a, b) = (weight * cos, weight * sin);
            let row = i * n..(i + 1) * n;
            let sums = re[row.clone()].iter_mut().zip(&mut im[row]);
            for ((r, m), (c, s)) in sums.zip(cos_j.iter().zip(&sin_j)) {
                *r += a * c - b * s;
                *m += a * s + b * c;
            }
        }
    }
    let scale = 1.0 / (total * total);
    Ok(re.iter().zip(&im).map(|(r, m)| scale * (r * r + m * m)).collect())
}

#[cfg(test)]
mod tests {
    use super::PupilSampling;
    use std::f64::consts::PI;

    /// Area, centroid and second moment of the unit disc.
    #[test]
    fn points_cover_the_disc_evenly() {
        for (sampling, tolerance) in [
            // Five standard deviations of the mean of 40,000 independent r² (variance 1/12): alpha 6e-7.
            (PupilSampling::Random, 5.0 * (1.0 / 12.0_f64 / 40_000.0).sqrt()),
            (PupilSampling::Stratified, 1e-3),
            (PupilSampling::Grid, 1e-3),
            (PupilSampling::Gauss, 1e-12),
        ] {
            let points = sampling.points(40_000, 3);
            let count = points.len() as f64 / 40_000.0;
            assert!((count - 1.0).abs() < 0.01, "{sampling:?} {count}");
            let sum: f64 = points.iter().map(|(_, w)| w).sum();
            assert!((sum - PI).abs() < 1e-9, "{sampling:?} {sum}");
            let square: f64 = points.iter().map(|(p, w)| w / PI * p.length_squared()).sum();
            assert!((square - 0.5).abs() < tolerance, "{sampling:?} {square}");
            assert!(points.iter().all(|(p, _)| p.length() <= 1.0 + 1e-12));
        }
    }

    #[test]
    fn few_rays_are_enough_to_ask() {
        for sampling in
            [PupilSampling::Random, PupilSampling::Stratified, PupilSampling::Grid, PupilSampling::Gauss]
        {
            assert!(!sampling.points(0, 1).is_empty(), "{sampling:?}");
        }
    }
}
