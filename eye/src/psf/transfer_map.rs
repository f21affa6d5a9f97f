//! The transfer function at very many frequencies at once, by two fast Fourier transforms.
//!
//! In pupil coordinates s, with turns t(s) = W(s)/λ' and a shift δ = axes⁻¹ λ' ν,
//! field(η) = ∫ A(s) exp(2πi (t(s) − s·η)) ds, OTF(δ) = (1/E) ∫ T(η) |field(η)|² exp(−2πi δ·η) dη.
//! The first integral runs over the chord nodes of [`super::matrix`], put on a lattice by [`super::gridding`], so the pupil's edge
//! is exact; the second is a transform of the sampled intensity, read between its lattice points by the same kernel.
//!
//! T is 1 out to beyond the geometric spot and falls smoothly to 0: what it cuts off is light scattered by the pupil's edge, of
//! which the transform is confined to the cone-shaped tip of the transfer at δ = 0 and to its end at the cutoff. There
//! ([`TransferMap::least`], [`TransferMap::most`]) [`super::Otf`] is to be used, which needs few nodes just there.
//!
//! # Cost
//! Some 10 ms for a pupil of 9 mm, where one frequency of [`super::Otf`] takes 0.2 ms; independent of the number of frequencies
//! but for 0.1 µs each.

use super::chords::Chords;
use super::gridding::{Gridding, OVERSAMPLING, WIDTH};
use super::quadrature::gauss_legendre;
use super::sincos::sin_cos_turns;
use super::wavefront::Wavefront;
use glam::{DMat2, DVec2};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;
use std::f64::consts::PI;

/// Where T begins to fall, beyond the spot, and over which width it falls (with a share of the spot); cycles per pupil coordinate.
/// With these and [`TIP`] the error is below 3e-5 of the peak at every pupil (measured, see the test).
const FLAT: f64 = 2.0;
const FALL: f64 = 8.0;
const FALL_PER_SPOT: f64 = 0.3;
/// The tip's transform has faded at this number over the width of the fall.
const TIP: f64 = 2.0;
/// Nodes along a chord come in blocks of this many, for vector code.
const LANES: usize = 4;
/// Largest lattice; a wavefront that needs more is left to [`super::Otf`].
const MOST: usize = 4096;

/// The transfer function on a lattice of shifts.
#[derive(Clone, Debug)]
pub struct TransferMap {
    shift_per_nu: DMat2,
    /// Middle of the spot, taken out of the lattice.
    middle: DVec2,
    /// Shift of a lattice step.
    step: f64,
    /// Lattice points from −reach to reach in x, from −WIDTH to reach in y.
    reach: i64,
    columns: usize,
    lattice: Vec<Complex64>,
    gridding: Gridding,
    least: f64,
    most: f64,
}

/// What decides the lattice.
struct Size {
    /// Side of the square transforms.
    n: usize,
    /// Distance of two intensity samples, cycles per pupil coordinate.
    pitch: f64,
    /// Where T begins to fall and where it is 0.
    flat: f64,
    end: f64,
}

impl TransferMap {
    /// The map of a wavefront for shifts up to `band` (pupil coordinates); `None` when it would be too large.
    pub fn new(w: &Wavefront, band: f64) -> Option<Self> {
        let turns = w.opd_um.scaled(1.0 / w.wavelength_um());
        let [gx, gy] = turns.gradient();
        let (min, max) = w
            .samples()
            .map(|s| DVec2::new(gx.at(s), gy.at(s)))
            .fold((DVec2::MAX, DVec2::MIN), |(min, max), g| (min.min(g), max.max(g)));
        let middle = 0.5 * (min + max);
        let spot = 1.05
            * w.samples().map(|s| (DVec2::new(gx.at(s), gy.at(s)) - middle).length()).fold(0.0, f64::max);
        let chords = Chords::new(&w.outline);
        let (_, longest) = chords.longest();
        let cutoff = longest.max(2.0 * chords.half_height());
        let size = Size::new(spot, cutoff, band.min(cutoff))?;
        let gridding = Gridding::default();
        let pupil = Pupil { w, middle, chords: &chords, nodes: nodes(cutoff, spot + size.end) };
        let intensity = size.intensity(&pupil, &gridding);
        let step = 1.0 / (size.n as f64 * size.pitch);
        let reach = ((band.min(cutoff) / step).ceil() as i64 + WIDTH as i64).min(size.n as i64 / 2 - 1);
        let columns = (2 * reach + 1) as usize;
        let tip = TIP / (size.end - size.flat);
        let scale = size.pitch * size.pitch / w.energy_open;
        let lattice = size.transform(&intensity, reach, scale);
        Some(Self {
            shift_per_nu: w.axes.inverse() * w.wavelength_um(),
            middle,
            step,
            reach,
            columns,
            lattice,
            gridding,
            least: tip,
            most: longest.min(2.0 * chords.half_height()) - tip,
        })
    }

    /// Shifts below this (pupil coordinates) are not served.
    pub fn least(&self) -> f64 {
        self.least
    }

    /// Shifts above this (pupil coordinates) are not served.
    pub fn most(&self) -> f64 {
        self.most
    }

    /// Shift (pupil coordinates) per frequency (cycles/µm).
    pub fn shift_per_nu(&self) -> DMat2 {
        self.shift_per_nu
    }

    /// The transfer at a frequency (cycles/µm along x_um, y_um) whose shift is within [`TransferMap::least`] and
    /// [`TransferMap::most`]; 0 beyond the lattice.
    pub fn value(&self, nu_cycles_per_um: DVec2) -> Complex64 {
        let shift = self.shift_per_nu * nu_cycles_per_um;
        // The lattice holds the half plane y ≥ 0; the other half is its conjugate.
        let flip = shift.y < 0.0;
        let at = (if flip { -shift } else { shift }) / self.step;
        let (x, across) = self.gridding.at(at.x);
        let (y, down) = self.gridding.at(at.y);
        let (column, row) = (x + self.reach, y + WIDTH as i64);
        if column < 0 || row < 0 || column as usize + WIDTH > self.columns || y + WIDTH as i64 > self.reach {
            return Complex64::ZERO;
        }
        let mut sum = Complex64::ZERO;
        for (j, weight) in down.iter().enumerate() {
            let start = (row as usize + j) * self.columns + column as usize;
            let line = &self.lattice[start..start + WIDTH];
            let inner: Complex64 = line.iter().zip(&across).map(|(z, a)| z * *a).sum();
            sum += inner * *weight;
        }
        let value = if flip { sum.conj() } else { sum };
        let (sin, cos) = sin_cos_turns(-shift.dot(self.middle));
        value * Complex64::new(cos, sin)
    }
}

/// Nodes per diameter for rays that land up to `reach` away: the rule of [`super::matrix::nodes_needed`].
fn nodes(diameter: f64, reach: f64) -> usize {
    (0.5 * PI * diameter * reach + 12.0).ceil() as usize
}

impl Size {
    fn new(spot: f64, cutoff: f64, band: f64) -> Option<Self> {
        let flat = spot + FLAT;
        let end = flat + FALL + FALL_PER_SPOT * spot;
        // The intensity's own transform ends at the cutoff and repeats with 1/pitch: its copies stay out of the band.
        let range = 1.02 * (cutoff + band);
        let n = even_smooth((2.0 * OVERSAMPLING * end * range).ceil() + 2.0 * WIDTH as f64);
        let spread = WIDTH as f64 / n as f64;
        (n <= MOST).then_some(Self { n, pitch: (1.0 - spread) / range, flat, end })
    }

    /// T.
    fn taper(&self, eta: f64) -> f64 {
        let x = ((eta - self.flat) / (self.end - self.flat)).clamp(0.0, 1.0);
        // The smooth step with three continuous derivatives.
        let y = 1.0 - x;
        y.powi(4) * (35.0 + y * (-84.0 + y * (70.0 - 20.0 * y)))
    }

    /// T |field|² over φ's transform once more, `[x][y]` for lattice points −last to last.
    fn intensity(&self, pupil: &Pupil, gridding: &Gridding) -> Vec<f64> {
        let n = self.n;
        let (first_row, mut rows) = pupil.on_lattice(self.pitch * n as f64, n, gridding);
        let mut planner = FftPlanner::new();
        let fft = planner.plan_fft_forward(n);
        let mut scratch = vec![Complex64::ZERO; fft.get_inplace_scratch_len()];
        rows.chunks_exact_mut(n).for_each(|row| fft.process_with_scratch(row, &mut scratch));
        let last = self.last();
        let side = (2 * last + 1) as usize;
        let spread: Vec<f64> = (0..=last).map(|m| gridding.transform(m as f64 / n as f64)).collect();
        let mut out = vec![0.0; side * side];
        let mut column = vec![Complex64::ZERO; n];
        for (x, line) in (-last..=last).zip(out.chunks_exact_mut(side)) {
            let at = wrap(x, n);
            column.fill(Complex64::ZERO);
            for (k, row) in rows.chunks_exact(n).enumerate() {
                column[wrap(first_row + k as i64, n)] = row[at];
            }
            fft.process_with_scratch(&mut column, &mut scratch);
            for (y, value) in (-last..=last).zip(line) {
                let taper = self.taper(DVec2::new(x as f64, y as f64).length() * self.pitch);
                if taper > 0.0 {
                    let phi = spread[x.unsigned_abs() as usize] * spread[y.unsigned_abs() as usize];
                    *value = taper * column[wrap(y, n)].norm_sqr() / (phi * phi * phi);
                }
            }
        }
        out
    }

    /// Lattice points from the middle to where T ends.
    fn last(&self) -> i64 {
        (self.end / self.pitch).floor() as i64
    }

    /// Transform of the intensity at the lattice points of the half plane, `[y][x]`.
    fn transform(&self, intensity: &[f64], reach: i64, scale: f64) -> Vec<Complex64> {
        let (n, last) = (self.n, self.last());
        let side = (2 * last + 1) as usize;
        let mut planner = FftPlanner::new();
        let fft = planner.plan_fft_forward(n);
        let mut scratch = vec![Complex64::ZERO; fft.get_inplace_scratch_len()];
        let ys: Vec<usize> = (-(WIDTH as i64)..=reach).map(|y| wrap(y, n)).collect();
        let mut by_row = vec![Complex64::ZERO; ys.len() * n];
        // Two real columns in one transform: their spectra are its even and odd parts.
        let mut line = vec![Complex64::ZERO; n];
        let columns: Vec<(i64, &[f64])> = (-last..=last).zip(intensity.chunks_exact(side)).collect();
        for pair in columns.chunks(2) {
            line.fill(Complex64::ZERO);
            for (part, (_, values)) in pair.iter().enumerate() {
                for (y, value) in (-last..=last).zip(*values) {
                    let at = &mut line[wrap(y, n)];
                    if part == 0 { at.re = *value } else { at.im = *value }
                }
            }
            fft.process_with_scratch(&mut line, &mut scratch);
            for (row, &y) in ys.iter().enumerate() {
                let (z, mirrored) = (line[y], line[(n - y) % n].conj());
                by_row[row * n + wrap(pair[0].0, n)] = 0.5 * (z + mirrored);
                if let Some((x, _)) = pair.get(1) {
                    by_row[row * n + wrap(*x, n)] = Complex64::new(0.0, -0.5) * (z - mirrored);
                }
            }
        }
        let mut lattice = Vec::with_capacity(ys.len() * (2 * reach + 1) as usize);
        for row in by_row.chunks_exact_mut(n) {
            fft.process_with_scratch(row, &mut scratch);
            lattice.extend((-reach..=reach).map(|x| row[wrap(x, n)] * scale));
        }
        lattice
    }
}

/// The pupil as nodes.
struct Pupil<'a> {
    w: &'a Wavefront,
    middle: DVec2,
    chords: &'a Chords,
    nodes: usize,
}

impl Pupil<'_> {
    /// Spreads w A exp(2πi (t − middle·s)) over a lattice of step 1/`period`: the first row and the rows that are not 0.
    fn on_lattice(&self, period: f64, n: usize, gridding: &Gridding) -> (i64, Vec<Complex64>) {
        let turns = self.w.opd_um.scaled(1.0 / self.w.wavelength_um());
        let outer = self.chords.rule(self.nodes);
        let inner = gauss_legendre(self.nodes);
        let place = |y: f64| gridding.at(y * period);
        let (low, high) = outer
            .iter()
            .fold((f64::MAX, f64::MIN), |(low, high), (chord, _)| (low.min(chord.y), high.max(chord.y)));
        let first = place(low).0;
        let count = ((place(high).0 - first) as usize + WIDTH).min(n);
        let mut rows = vec![Complex64::ZERO; count * n];
        // The line holds the lattice points that a chord can reach, the first at `left`.
        let reach = outer.iter().map(|(c, _)| c.middle.abs() + 0.5 * c.length).fold(0.0, f64::max);
        let left = gridding.at(-reach * period).0;
        let mut line =
            vec![Complex64::ZERO; ((gridding.at(reach * period).0 - left) as usize + WIDTH).min(n)];
        let (mut t_line, mut a_line) =
            (vec![0.0; turns.degree() + 1], vec![0.0; self.w.amplitude.degree() + 1]);
        for (chord, across) in &outer {
            turns.along_x(chord.y, &mut t_line);
            self.w.amplitude.along_x(chord.y, &mut a_line);
            // The tilt that brings the middle of the spot to 0; what it leaves depends on the chord only.
            if let Some(slope) = t_line.get_mut(1) {
                *slope -= self.middle.x;
            }
            t_line[0] -= self.middle.y * chord.y;
            line.fill(Complex64::ZERO);
            let half = 0.5 * chord.length;
            for block in inner.chunks(LANES) {
                let v: [f64; LANES] = std::array::from_fn(|l| block.get(l).map_or(0.0, |b| b.0));
                let x = v.map(|v| chord.middle + half * v);
                let (t, a) = (horners(&t_line, x), horners(&a_line, x));
                let wave = t.map(sin_cos_turns);
                for (l, (_, along)) in block.iter().enumerate() {
                    let weight = across * along * half * a[l];
                    let value = Complex64::new(weight * wave[l].1, weight * wave[l].0);
                    let (at, spread) = gridding.at(x[l] * period);
                    let start = (at - left) as usize;
                    line[start..start + WIDTH].iter_mut().zip(spread).for_each(|(z, phi)| *z += value * phi);
                }
            }
            let (y, spread) = place(chord.y);
            let split = wrap(left, n).min(n);
            let (before, after) = line.split_at((n - split).min(line.len()));
            for (j, phi) in spread.iter().enumerate() {
                let row = (y - first) as usize + j;
                let row = &mut rows[row * n..(row + 1) * n];
                row[split..].iter_mut().zip(before).for_each(|(sum, z)| *sum += z * *phi);
                row.iter_mut().zip(after).for_each(|(sum, z)| *sum += z * *phi);
            }
        }
        (first, rows)
    }
}

/// Σ c_k x^k for a few x at a time.
fn horners(c: &[f64], x: [f64; LANES]) -> [f64; LANES] {
    let mut sum = [0.0; LANES];
    for c in c.iter().rev() {
        for l in 0..LANES {
            sum[l] = sum[l] * x[l] + c;
        }
    }
    sum
}

fn wrap(at: i64, n: usize) -> usize {
    at.rem_euclid(n as i64) as usize
}

/// The next even size whose only prime factors are 2, 3 and 5.
pub(super) fn even_smooth(at_least: f64) -> usize {
    let smooth = |mut n: usize| {
        for p in [2, 3, 5] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    let start = (at_least.min(1e6) as usize).next_multiple_of(2);
    (start..).step_by(2).find(|&n| smooth(n)).unwrap_or(start)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Dispersion, EyeState, Object, Prescription, SchematicEye, Side};
    use crate::psf::{Otf, WavefrontOptions};

    /// Largest distance to the quadrature over the served shifts in units of the peak, for a pupil and a defocus.
    fn worst(pupil_mm: f64, vergence_d: f64, field_deg: f64) -> f64 {
        let prescription = Prescription::preset("escudero-sanz-navarro").unwrap();
        let state = EyeState {
            pupil_mm,
            decentre_mm: 0.4,
            accommodation_a: 0.0,
            dispersion: Dispersion::Herzberger,
            side: Side::Right,
        };
        let eye = SchematicEye::new(&prescription, &state).unwrap();
        let object = Object::field(field_deg, vergence_d).unwrap();
        let w = Wavefront::new(&eye, object, 543.0, &WavefrontOptions::default()).unwrap();
        let map = TransferMap::new(&w, 2.1).unwrap();
        let otf = Otf::new(&w);
        let to_nu = map.shift_per_nu().inverse();
        let mut worst = 0.0_f64;
        for k in 0..60 {
            let radius = map.least() + (map.most() - map.least()) * f64::from(k) / 59.0;
            let nu = to_nu * (DVec2::from_angle(2.4 * f64::from(k)) * radius);
            worst = worst.max((map.value(nu) - otf.value(nu)).norm());
        }
        worst
    }

    #[test]
    fn the_map_is_the_transfer_function() {
        for (pupil_mm, vergence_d, field_deg) in
            [(2.0, 0.0, 5.0), (3.0, 0.0, 5.0), (3.0, 2.0, 5.0), (6.0, 0.0, 15.0), (8.0, 0.5, 5.0)]
        {
            let error = worst(pupil_mm, vergence_d, field_deg);
            assert!(error < 3e-5, "{pupil_mm} mm, {vergence_d} D, {field_deg} degrees: {error:.1e}");
        }
    }
}
