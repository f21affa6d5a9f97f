//! The production point spread: Fraunhofer's integral as two matrix products over chord Gauss nodes.
//!
//! With p the direction cosines along the grid's axes i and j, the integral over p_i runs along chords of the pupil
//! (Gauss–Legendre), that over p_j over chords (trapezoidal in τ, see [`super::chords`]):
//! field(ξ_i, ξ_j) = Σ_b exp(−i k' p_b ξ_j) Σ_a P_ab exp(−i k' p_ab ξ_i).
//! Samples come in pairs ±ξ whose exponentials are conjugate: each product is taken once for both.
//!
//! # Distance to second order
//! From a point of the reference sphere (radius R) to ξ it is R − p·ξ + (|ξ|² − (p·ξ)²)/2R + …. With p = m + d, m the pupil's middle, what
//! changes over the pupil is ε = (m·ξ)(d·ξ)/R + (d·ξ)²/2R, some 0.2/k' at 25° from the line of sight in a spread 80 µm wide. There
//! exp(−ik'ε) is expanded: field = Σ_ab c_ab(ξ) M_ab, M_ab the same integral with the weight d_i^a d_j^b, a + b ≤ 2. Where the light of
//! the spread sees less than `LEAST_EPSILON` of it, M_00 is all.
//!
//! # Cost
//! N = 0.95·ω/2 + 9 nodes per diameter (1.05·ω/2 + 12 for strong phases), ω/2 = half-width/λ'·π·(slope + reach):
//! N²·n + N·n² multiplications, with the second order 3 N²·n + 6 N·n². 10 % fewer nodes fall off a cliff (4e-3 → 0.2); a test compares
//! N with 1.25 N.

use super::chords::Chords;
use super::quadrature::gauss_legendre;
use super::sincos::sin_cos_turns;
use super::wavefront::Wavefront;
use glam::{DMat2, DVec2};
use multiversion::multiversion;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Which way the grid's first index runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum GridAxes {
    /// i along the retina's tangent away from the optical axis, j a quarter turn further (from x_um to y_um).
    #[default]
    Meridional,
    /// i along x_um, j along y_um.
    Retina,
}

/// Sample points of a point spread: square, row-major `[i][j]`, sample centres at (i + ½ − n/2)·2·half_width/n.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PsfGrid {
    /// Samples along a side.
    pub samples: usize,
    /// Half of the side, µm.
    pub half_width_um: f64,
    /// Middle of the grid from the landing point of the chief ray, µm along x_um, y_um.
    pub centre_um: DVec2,
    /// Orientation.
    pub axes: GridAxes,
    /// Nodes per pupil diameter; by default as many as the phase asks.
    pub nodes: Option<usize>,
    /// Take distances to first order in ξ everywhere: the spread whose transform is [`super::Otf`], the same at any place.
    pub fraunhofer: bool,
}

impl PsfGrid {
    /// A grid about the landing point of the chief ray, first index away from the optical axis.
    pub fn new(samples: usize, half_width_um: f64) -> Self {
        Self {
            samples,
            half_width_um,
            centre_um: DVec2::ZERO,
            axes: GridAxes::Meridional,
            nodes: None,
            fraunhofer: false,
        }
    }

    /// Distance of two samples, µm.
    pub fn pitch_um(&self) -> f64 {
        2.0 * self.half_width_um / self.samples.max(1) as f64
    }

    /// Offset of sample i from the middle, µm.
    pub fn offset(&self, i: usize) -> f64 {
        (i as f64 + 0.5 - 0.5 * self.samples as f64) * self.pitch_um()
    }

    /// Unit vectors of the two indices in (x_um, y_um).
    pub fn axes_of(&self, meridional_angle: f64) -> (DVec2, DVec2) {
        let e_i = match self.axes {
            GridAxes::Meridional => DVec2::from_angle(meridional_angle),
            GridAxes::Retina => DVec2::X,
        };
        (e_i, e_i.perp())
    }
}

/// Nodes per diameter for a pupil of half-width `half` (direction cosines) and rays that land up to `reach_um` away.
pub fn nodes_needed(half: f64, wavelength_um: f64, reach_um: f64) -> usize {
    let half_omega = PI * half / wavelength_um * reach_um;
    let nodes = if half_omega < 60.0 { 0.95 * half_omega + 9.0 } else { 1.05 * half_omega + 12.0 };
    (nodes.ceil() as usize).clamp(8, 4096)
}

/// Largest k'ε (radians) that is left out.
const LEAST_EPSILON: f64 = 5e-3;
/// Exponents (a, b) of the moments M_ab; the first is all there is to first order.
const MOMENTS: [(usize, usize); 6] = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];

/// Samples that are computed together: across the chords and along them.
const LANES: usize = 8;
const LANES_ALONG: usize = 4;

/// One chord of the pupil: its place across and the sums along it at the positive offsets.
struct Strip {
    turns_per_um: f64,
    /// Direction cosine across, from the pupil's middle.
    across: f64,
    /// Field along i at +ξ and −ξ (real and imaginary parts), for each power of the direction cosine along.
    plus: Vec<Vec<[f64; 2]>>,
    minus: Vec<Vec<[f64; 2]>>,
}

/// What the second order needs: m, 1/R and k'.
struct Curved {
    middle: DVec2,
    per_radius: f64,
    wavenumber: f64,
}

impl Curved {
    /// The coefficients c_ab at a sample, each times a power of i: real for a + b even in the second order's part.
    fn coefficients(&self, xi: DVec2) -> [(f64, f64); 6] {
        let k = self.wavenumber;
        let tilt = self.middle.dot(xi) * self.per_radius;
        // exp(−ik'ε) = 1 − ik'ε − (k'ε)²/2, ε = tilt (d·ξ) + (d·ξ)²/2R.
        let linear = -k * tilt;
        let (re, im) = (-0.5 * (k * tilt).powi(2), -0.5 * k * self.per_radius);
        let square = |x: f64| (re * x, im * x);
        [
            (1.0, 0.0),
            (0.0, linear * xi.x),
            (0.0, linear * xi.y),
            square(xi.x * xi.x),
            square(2.0 * xi.x * xi.y),
            square(xi.y * xi.y),
        ]
    }
}

/// The point spread on the grid: 1 = the same pupil with no path difference, at its centre. Times
/// [`Wavefront::density_per_um2`] it is a probability density. At most 8192 samples a side are computed.
pub fn psf(w: &Wavefront, grid: &PsfGrid) -> Vec<f64> {
    let n = grid.samples.min(8192);
    let (strips, curved) = strips(w, grid, n.div_ceil(2));
    let across = exponentials(&strips, grid, n);
    let norm = w.amplitude_sum * w.axes.determinant().abs();
    let scale = 1.0 / (norm * norm);
    let moments = if curved.is_some() { &MOMENTS[..] } else { &MOMENTS[..1] };
    let (e_i, e_j) = grid.axes_of(w.meridional_angle);
    let centre = DVec2::new(grid.centre_um.dot(e_i), grid.centre_um.dot(e_j));
    let mut out = vec![0.0; n * n];
    let (mut fields, mut moment) = (vec![[0.0; 2]; n], vec![[0.0; 2]; n]);
    let mut along = Vec::with_capacity(strips.len());
    for (i, row) in out.chunks_exact_mut(n.max(1)).enumerate() {
        // Row i: offset +ξ for the upper half of the rows, −ξ for the lower.
        let upper = 2 * i >= n;
        let h = if upper { i - n / 2 } else { (n - 1 - i) - n / 2 };
        fields.fill([0.0; 2]);
        for (which, &(a, b)) in moments.iter().enumerate() {
            along.clear();
            along.extend(strips.iter().map(|s| {
                let [re, im] = if upper { s.plus[a][h] } else { s.minus[a][h] };
                let factor = s.across.powi(b as i32);
                [factor * re, factor * im]
            }));
            moment_row(&along, &across, &mut moment);
            match &curved {
                None => fields.copy_from_slice(&moment),
                Some(curved) => {
                    for (j, (field, [re, im])) in fields.iter_mut().zip(&moment).enumerate() {
                        let xi = centre + DVec2::new(grid.offset(i), grid.offset(j));
                        let (c, s) = curved.coefficients(xi)[which];
                        field[0] += c * re - s * im;
                        field[1] += c * im + s * re;
                    }
                }
            }
        }
        row.iter_mut().zip(&fields).for_each(|(v, [re, im])| *v = scale * (re * re + im * im));
    }
    out
}

/// Cosines, then sines, of 2π·turns·ξ for `LANES` offsets from the middle up.
type Factors = [[f64; LANES]; 2];

/// `Σ_b G_b exp(−2πi turns_b ξ_j)` for a row of samples, each exponential used for +ξ and −ξ;
/// `across[block][b]`.
fn moment_row(fields: &[[f64; 2]], across: &[Vec<Factors>], row: &mut [[f64; 2]]) {
    let n = row.len();
    for (block, factors) in across.iter().enumerate() {
        let [rc, is, ic, rs] = moment_block(fields, factors);
        for l in 0..LANES.min(n.div_ceil(2) - block * LANES) {
            let h = block * LANES + l;
            // exp(−iφ) = cos − i sin at +ξ, the conjugate at −ξ.
            row[n / 2 + h] = [rc[l] + is[l], ic[l] - rs[l]];
            row[n - 1 - (n / 2 + h)] = [rc[l] - is[l], ic[l] + rs[l]];
        }
    }
}

/// Sums of re·cos, im·sin, im·cos and re·sin over the nodes.
#[multiversion(targets("x86_64+avx2"))]
fn moment_block(fields: &[[f64; 2]], factors: &[Factors]) -> [[f64; LANES]; 4] {
    let mut sums = [[0.0; LANES]; 4];
    for ([re, im], [cos, sin]) in fields.iter().zip(factors) {
        for l in 0..LANES {
            sums[0][l] += re * cos[l];
            sums[1][l] += im * sin[l];
            sums[2][l] += im * cos[l];
            sums[3][l] += re * sin[l];
        }
    }
    sums
}

/// `[block][node]`: the exponentials across the chords at the offsets from the middle up.
fn exponentials(strips: &[Strip], grid: &PsfGrid, n: usize) -> Vec<Vec<Factors>> {
    let of = |block: usize| {
        let factors = |strip: &Strip| {
            let at = |l: usize| sin_cos_turns(strip.turns_per_um * grid.offset(n / 2 + block * LANES + l));
            let both: [(f64, f64); LANES] = std::array::from_fn(at);
            [both.map(|(_, cos)| cos), both.map(|(sin, _)| sin)]
        };
        strips.iter().map(factors).collect()
    };
    (0..n.div_ceil(2).div_ceil(LANES)).map(of).collect()
}

fn strips(w: &Wavefront, grid: &PsfGrid, half_samples: usize) -> (Vec<Strip>, Option<Curved>) {
    let wavelength = w.wavelength_um();
    let (e_i, e_j) = grid.axes_of(w.meridional_angle);
    let to_grid = DMat2::from_cols(e_i, e_j).transpose();
    let middle = to_grid * w.centre;
    let chords = Chords::new(&w.outline.mapped(to_grid * w.axes, middle));
    let from_grid = (to_grid * w.axes).inverse();
    let offset = from_grid * middle;
    // Nodes: the rays land up to `reach` from the samples.
    let [gx, gy] = w.opd_um.gradient();
    let pull = w.axes.inverse().transpose();
    let landings = w.samples().map(|s| pull * DVec2::new(gx.at(s), gy.at(s)));
    let (spot, lit) = landings.fold((0.0_f64, 0.0_f64), |(spot, lit), landing| {
        (spot.max((landing - grid.centre_um).length()), lit.max(landing.length()))
    });
    let reach = spot + std::f64::consts::SQRT_2 * grid.half_width_um;
    let half = chords.half_height().max(chords.longest().1 / 2.0);
    // The light lies within the rays' landing places and a few rings, and the grid ends.
    let extent = (lit + 2.0 * wavelength / half)
        .min(grid.centre_um.length() + std::f64::consts::SQRT_2 * grid.half_width_um);
    let epsilon = half * extent * extent / w.radius_um * (middle.length() + 0.5 * half);
    let wavenumber = std::f64::consts::TAU / wavelength;
    let curved = (!grid.fraunhofer && wavenumber * epsilon > LEAST_EPSILON).then_some(Curved {
        middle,
        per_radius: 1.0 / w.radius_um,
        wavenumber,
    });
    let powers = if curved.is_some() { 3 } else { 1 };
    let count = |half: f64| grid.nodes.unwrap_or_else(|| nodes_needed(half, wavelength, reach));
    let outer = chords.rule(count(chords.half_height()));
    let inner = gauss_legendre(count(chords.longest().1 / 2.0));
    let turns = w.opd_um.scaled(1.0 / wavelength);
    let strips = outer
        .iter()
        .map(|&(chord, wu)| {
            let mut sums = vec![vec![[[0.0; LANES_ALONG]; 4]; half_samples.div_ceil(LANES_ALONG)]; powers];
            for &(v, wv) in &inner {
                let p = DVec2::new(chord.middle + 0.5 * chord.length * v, chord.y);
                let s = from_grid * p - offset;
                let weight = w.amplitude.at(s) * wu * wv * 0.5 * chord.length;
                let shift = (p.x * e_i + p.y * e_j).dot(grid.centre_um) / wavelength;
                let (sin, cos) = sin_cos_turns(turns.at(s) - shift);
                accumulate(&mut sums, [weight * cos, weight * sin], p.x, p.x - middle.x, wavelength, grid);
            }
            let side = |sign: f64| -> Vec<Vec<[f64; 2]>> {
                let of_power = |power: &Vec<[[f64; LANES_ALONG]; 4]>| {
                    let at = |h: usize| {
                        let [rc, is, ic, rs] = power[h / LANES_ALONG].map(|sum| sum[h % LANES_ALONG]);
                        [rc + sign * is, ic - sign * rs]
                    };
                    (0..half_samples).map(at).collect()
                };
                sums.iter().map(of_power).collect()
            };
            Strip {
                turns_per_um: chord.y / wavelength,
                across: chord.y - middle.y,
                plus: side(1.0),
                minus: side(-1.0),
            }
        })
        .collect();
    (strips, curved)
}

/// Adds (re + i im)·d^a·{cos, sin}(2π·p/λ'·ξ) at the positive offsets to the sums of each power a; the exponential steps four samples at
/// a time.
fn accumulate(
    sums: &mut [Vec<[[f64; LANES_ALONG]; 4]>],
    [re, im]: [f64; 2],
    p: f64,
    d: f64,
    wavelength_um: f64,
    grid: &PsfGrid,
) {
    let turns_per_um = p / wavelength_um;
    let first = grid.samples.min(8192) / 2;
    let step = sin_cos_turns(LANES_ALONG as f64 * turns_per_um * grid.pitch_um());
    let start: [(f64, f64); LANES_ALONG] =
        std::array::from_fn(|l| sin_cos_turns(turns_per_um * grid.offset(first + l)));
    let (mut re, mut im) = (re, im);
    for sums in sums {
        add_wave(sums, [re, im], start.map(|s| s.0), start.map(|s| s.1), step);
        (re, im) = (re * d, im * d);
    }
}

/// Adds one wave to the sums of its real and imaginary part times cosine and sine.
#[multiversion(targets("x86_64+avx2"))]
fn add_wave(
    sums: &mut [[[f64; LANES_ALONG]; 4]],
    [re, im]: [f64; 2],
    mut sin: [f64; LANES_ALONG],
    mut cos: [f64; LANES_ALONG],
    (step_sin, step_cos): (f64, f64),
) {
    for [rc, is, ic, rs] in sums {
        for l in 0..LANES_ALONG {
            rc[l] += re * cos[l];
            is[l] += im * sin[l];
            ic[l] += im * cos[l];
            rs[l] += re * sin[l];
        }
        for l in 0..LANES_ALONG {
            (sin[l], cos[l]) = (sin[l] * step_cos + cos[l] * step_sin, cos[l] * step_cos - sin[l] * step_sin);
        }
    }
}
