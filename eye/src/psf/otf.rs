//! The optical transfer function as the autocorrelation of the pupil: no window, no truncated tail.
//!
//! OTF(ν) = (1/E) ∫ P(q − λ'ν) P*(q) dq over the part of the pupil where both lie inside, P = A exp(i k' W), E = ∫A² of
//! the pupil without apodization; OTF(0) = throughput. Coordinates are turned so that the shift δ runs along a: on each
//! chord (constant b) the overlap is [left end + δ, right end]. Gauss–Legendre along the chord and, in τ
//! ([`super::chords`]), across; on each chord the two polynomials shrink to one variable, and one sine and cosine of the
//! phase DIFFERENCE is taken a node.
//!
//! # Cost
//! A few µs per ν in focus at 3 mm when a direction is taken in one call ([`Otf::radial`]); nodes grow with defocus.

use super::chords::Chords;
use super::outline::Outline;
use super::polynomial::{Polynomial2, horner};
use super::quadrature::Rules;
use super::sincos::sin_cos_turns;
use super::wavefront::Wavefront;
use glam::{DMat2, DVec2};
use multiversion::multiversion;
use rustfft::num_complex::Complex64;
use std::f64::consts::PI;

/// Most nodes along or across. A phase difference that needs more swings through some thousand radians over the pupil:
/// the transfer is below about 1/1000 there and is returned as 0.
const MOST_NODES: usize = 1024;
/// Nodes along a chord come in blocks of this many, for vector code.
const LANES: usize = 4;
/// Nodes along and across for a phase that does not swing; these and the factors of the swing are measured, see the test
/// `node_rule_has_a_margin`.
const FLOOR_ALONG: f64 = 6.0;
const FLOOR_ACROSS: f64 = 9.0;

/// Swing from which the phase difference is sampled, because its bound is too wide.
const MEASURE_ABOVE: f64 = 8.0;
/// Samples of it along and across.
const PROBES: usize = 14;

/// The transfer function of one wavefront.
#[derive(Clone, Debug)]
pub struct Otf {
    wavelength_um: f64,
    /// Pupil coordinates per direction cosine.
    pupil_from_cosines: DMat2,
    /// Path difference in waves.
    turns: Polynomial2,
    amplitude: Polynomial2,
    outline: Outline,
    energy: f64,
    throughput: f64,
    /// Second derivatives of the path difference on a sample of the pupil, waves per squared pupil coordinate.
    bends: Vec<DMat2>,
    /// Nodes for an amplitude that falls towards the edge: none when it is even, 10 when it vanishes there.
    fading: f64,
    /// More nodes than needed by this factor, for tests.
    margin: f64,
}

/// The pupil turned so that the shift runs along its first coordinate.
struct Turned {
    chords: Chords,
    turns: Polynomial2,
    amplitude: Polynomial2,
    peak: f64,
    longest: f64,
    /// Largest second derivatives by a twice, and by a and b.
    bend_along: f64,
    bend_across: f64,
}

impl Otf {
    /// The transfer function of a wavefront.
    pub fn new(w: &Wavefront) -> Self {
        let turns = w.opd_um.scaled(1.0 / w.wavelength_um());
        let [gx, gy] = turns.gradient();
        let ([xx, xy], [_, yy]) = (gx.gradient(), gy.gradient());
        let bends =
            w.samples().map(|s| DMat2::from_cols_array(&[xx.at(s), xy.at(s), xy.at(s), yy.at(s)])).collect();
        let (least, most) = w
            .samples()
            .map(|s| w.amplitude.at(s))
            .fold((f64::MAX, 0.0_f64), |(least, most), a| (least.min(a), most.max(a)));
        Self {
            wavelength_um: w.wavelength_um(),
            pupil_from_cosines: w.axes.inverse(),
            turns,
            amplitude: w.amplitude.clone(),
            outline: w.outline.clone(),
            energy: w.energy_open,
            throughput: w.throughput(),
            fading: if most > 0.0 { 10.0 * (1.0 - least.max(0.0) / most) } else { 0.0 },
            bends,
            margin: 1.0,
        }
    }

    /// The same with `margin` times as many nodes: how a caller learns what the rule costs in accuracy.
    pub fn with_margin(mut self, margin: f64) -> Self {
        self.margin = margin.clamp(0.5, 8.0);
        self
    }

    /// ∫ PSF(ξ) exp(−2πi ν·ξ) dξ, ν in cycles/µm along x_um, y_um at the landing point; 0 beyond the cutoff and for a ν
    /// that is not finite.
    pub fn value(&self, nu_cycles_per_um: DVec2) -> Complex64 {
        let length = nu_cycles_per_um.length();
        if !length.is_finite() {
            return Complex64::ZERO;
        }
        let direction = nu_cycles_per_um.y.atan2(nu_cycles_per_um.x);
        self.radial(direction, &[length]).first().copied().unwrap_or(Complex64::ZERO)
    }

    /// The values at frequencies `nus` (cycles/µm; a negative one lies the other way) along one direction, radians from
    /// x_um towards y_um.
    pub fn radial(&self, direction_rad: f64, nus: &[f64]) -> Vec<Complex64> {
        self.along(direction_rad, &mut Rules::default(), |_| nus.to_vec())
    }

    /// The same for frequencies that are chosen when the cutoff in that direction (cycles/µm) is known; `rules` serve the next
    /// direction too.
    pub fn along(
        &self,
        direction_rad: f64,
        rules: &mut Rules,
        nus: impl FnOnce(f64) -> Vec<f64>,
    ) -> Vec<Complex64> {
        let (turned, per_nu) = self.turned(direction_rad);
        nus(turned.longest / per_nu)
            .into_iter()
            .map(|nu| {
                let shift = nu.abs() * per_nu;
                if shift <= 0.0 {
                    return Complex64::new(self.throughput, 0.0);
                }
                let value = self.overlap(&turned, rules, shift) / self.energy;
                if nu < 0.0 { value.conj() } else { value }
            })
            .collect()
    }

    /// The frequency beyond which the transfer in a direction (radians) is 0, cycles/µm.
    pub fn cutoff(&self, direction_rad: f64) -> f64 {
        let (turned, per_nu) = self.turned(direction_rad);
        turned.longest / per_nu
    }

    fn turned(&self, direction_rad: f64) -> (Turned, f64) {
        let shift = self.pupil_from_cosines * DVec2::from_angle(direction_rad) * self.wavelength_um;
        let angle = shift.y.atan2(shift.x);
        let chords = Chords::new(&self.outline.mapped(DMat2::from_angle(-angle), DVec2::ZERO));
        let (peak, longest) = chords.longest();
        let (a, b) = (DVec2::from_angle(angle), DVec2::from_angle(angle).perp());
        let largest = |v: DVec2| self.bends.iter().map(|m| (*m * a).dot(v).abs()).fold(0.0, f64::max);
        let turned = Turned {
            bend_along: largest(a),
            bend_across: largest(b),
            chords,
            turns: self.turns.rotated(angle),
            amplitude: self.amplitude.rotated(angle),
            peak,
            longest,
        };
        (turned, shift.length())
    }

    /// ∫ P(a − δ, b) P*(a, b) over the overlap.
    fn overlap(&self, t: &Turned, rules: &mut Rules, delta: f64) -> Complex64 {
        if delta >= t.longest || delta.is_nan() {
            return Complex64::ZERO;
        }
        let (low, high) = t.chords.ends(t.peak, t.longest, delta);
        let (tau_mid, tau_half) = (f64::midpoint(low, high), (high - low) / 2.0);
        // Half the swing of the phase difference over the overlap, along a chord and across the chords; what is left
        // of a chord's own swing after the sum along it varies across them too.
        let height = (t.chords.at(high).y - t.chords.at(low).y) / 2.0;
        let mut swing_along = PI * t.bend_along * delta * (t.longest - delta) / 2.0;
        let mut swing_across = 1.3 * PI * t.bend_across * delta * height + swing_along;
        if swing_along.max(swing_across) > MEASURE_ABOVE {
            let (a, b) = t.measured_swings(delta, tau_mid, tau_half);
            (swing_along, swing_across) = (swing_along.min(a), swing_across.min(b + 0.2 * a));
        }
        let along = self.nodes(LANES, FLOOR_ALONG + self.fading + 1.05 * swing_along);
        let across = self.nodes(2, FLOOR_ACROSS + self.fading + swing_across);
        if along.max(across) > MOST_NODES {
            return Complex64::ZERO;
        }
        let (inner, outer) = rules.pair(along, across);
        let mut turns = [0.0; 24];
        let mut amplitude = [0.0; 24];
        let (turns, amplitude) =
            (&mut turns[..=t.turns.degree().min(23)], &mut amplitude[..=t.amplitude.degree().min(23)]);
        let (mut re, mut im) = (0.0, 0.0);
        for &(u, wu) in outer {
            let chord = t.chords.at(tau_mid + tau_half * u);
            let half = (chord.length - delta).max(0.0) / 2.0;
            t.turns.along_x(chord.y, turns);
            t.amplitude.along_x(chord.y, amplitude);
            let (r, i) = along_chord(inner, chord.middle, half, delta, turns, amplitude);
            let weight = wu * tau_half * chord.slope * half;
            re += weight * r;
            im += weight * i;
        }
        Complex64::new(re, im)
    }

    fn nodes(&self, step: usize, wanted: f64) -> usize {
        // Many nodes come in coarser steps, so that fewer rules are needed.
        let step = if wanted > 40.0 { 8 } else { step };
        (self.margin * wanted / step as f64).ceil().min(1e6) as usize * step
    }
}

impl Turned {
    /// Half the swing of the phase difference, along the chords and across them at a fixed part of the chord. Gauss
    /// nodes are dense at the ends: what counts is the slope by the angle θ of x = cos θ, between Gauss probes.
    fn measured_swings(&self, delta: f64, tau_mid: f64, tau_half: f64) -> (f64, f64) {
        let theta = |k: usize| PI * (k as f64 + 0.75) / (PROBES as f64 + 0.5);
        let mut line = vec![0.0; self.turns.degree() + 1];
        let mut last = [0.0; PROBES];
        let (mut along, mut across) = (0.0_f64, 0.0_f64);
        for j in 0..PROBES {
            let chord = self.chords.at(tau_mid + tau_half * theta(j).cos());
            let half = (chord.length - delta).max(0.0) / 2.0;
            self.turns.along_x(chord.y, &mut line);
            let phase: [f64; PROBES] = std::array::from_fn(|k| {
                let far = chord.middle + 0.5 * delta + half * theta(k).cos();
                horner(&line, far - delta) - horner(&line, far)
            });
            for k in 1..PROBES {
                along = along.max((phase[k] - phase[k - 1]).abs());
            }
            if j > 0 {
                across = phase.iter().zip(&last).fold(across, |m, (p, l)| m.max((p - l).abs()));
            }
            last = phase;
        }
        // Turns a probe step, to half the radians a unit of θ; half as much again for what lies between the probes.
        let scale = 1.5 * PI / (theta(1) - theta(0));
        (along * scale, across * scale)
    }
}

/// Σ w A(a−δ)A(a) exp(2πi (W(a−δ) − W(a))) at a = middle + δ/2 + half·x.
#[multiversion(targets("x86_64+avx2"))]
fn along_chord(
    rule: &[(f64, f64)],
    middle: f64,
    half: f64,
    delta: f64,
    turns: &[f64],
    amplitude: &[f64],
) -> (f64, f64) {
    let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
    for block in rule.chunks_exact(LANES) {
        let (mut far, mut near, mut phase) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            far[l] = middle + 0.5 * delta + half * block[l].0;
            near[l] = far[l] - delta;
        }
        let (mut w_far, mut w_near) = ([0.0; LANES], [0.0; LANES]);
        for c in turns.iter().skip(1).rev() {
            for l in 0..LANES {
                w_far[l] = w_far[l] * far[l] + c;
                w_near[l] = w_near[l] * near[l] + c;
            }
        }
        let (mut a_far, mut a_near) = ([0.0; LANES], [0.0; LANES]);
        for c in amplitude.iter().rev() {
            for l in 0..LANES {
                a_far[l] = a_far[l] * far[l] + c;
                a_near[l] = a_near[l] * near[l] + c;
            }
        }
        for l in 0..LANES {
            phase[l] = w_near[l] * near[l] - w_far[l] * far[l];
        }
        for l in 0..LANES {
            let (sin, cos) = sin_cos_turns(phase[l]);
            let weight = block[l].1 * a_far[l] * a_near[l];
            re[l] += weight * cos;
            im[l] += weight * sin;
        }
    }
    debug_assert!(horner(amplitude, middle).is_finite());
    ((re[0] + re[2]) + (re[1] + re[3]), (im[0] + im[2]) + (im[1] + im[3]))
}
