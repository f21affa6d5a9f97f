//! The point spread as a fast Fourier transform of the pupil function on a square lattice of direction cosines: the textbook method, to
//! be compared with the others in error and time.
//!
//! With q = q0 + k·dq and ξ = ξ0 + i·pitch the exponent q·ξ/λ' is k·i/N + (terms of k alone and of i alone) when N·dq·pitch = λ'. The
//! pupil fills pitch·diameter/λ' of the lattice; outside it is 0. Its edge is a staircase, which is what limits the accuracy: the
//! error falls a little faster than the number of samples across the pupil rises.
//!
//! # Cost
//! Only rows that meet the pupil and columns that are wanted are transformed: (pupil rows + n)·N·log N.

use super::chords::Chords;
use super::matrix::PsfGrid;
use super::polynomial::horner;
use super::sincos::sin_cos_turns;
use super::transfer_map::even_smooth;
use super::wavefront::Wavefront;
use glam::{DMat2, DVec2};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;

/// What a lattice point at the edge of the pupil weighs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// 1 inside and 0 outside: a staircase, as in textbooks.
    Staircase,
    /// The fraction of its cell along the row that is inside.
    Covered,
}

/// Rows that are transformed before they are turned.
const TOGETHER: usize = 8;
/// Largest transform along a side.
const MOST: usize = 1 << 16;

/// The point spread, row-major, as [`super::matrix::psf`], from at least `across` samples along the pupil's diameter.
pub fn psf(w: &Wavefront, grid: &PsfGrid, across: usize, edge: Edge) -> Vec<f64> {
    let n = grid.samples.min(8192);
    let wavelength = w.wavelength_um();
    let (e_i, e_j) = grid.axes_of(w.meridional_angle);
    let to_grid = DMat2::from_cols(e_i, e_j).transpose();
    let chords = Chords::new(&w.outline.mapped(to_grid * w.axes, to_grid * w.centre));
    // The lattice: fine enough across the pupil, and with the grid's pitch as its dual.
    let (_, longest) = chords.longest();
    let diameter = longest.max(2.0 * chords.half_height());
    let wanted = across.max(4) as f64 * wavelength / (grid.pitch_um() * diameter);
    let size = even_smooth(wanted.ceil().max(n as f64)).min(MOST);
    let step = wavelength / (grid.pitch_um() * size as f64);
    let mut rows = pupil_rows(w, grid, &chords, (step, size, edge));
    // Along i within each row of the lattice (constant q_j), then along j for the wanted columns.
    let mut planner = FftPlanner::new();
    let transform = planner.plan_fft_forward(size);
    let mut scratch = vec![Complex64::ZERO; transform.get_inplace_scratch_len()];
    let mut along = vec![Complex64::ZERO; size * n];
    // Some rows together: their samples lie side by side along j.
    for rows in rows.chunks_mut(TOGETHER) {
        for (_, row) in rows.iter_mut() {
            transform.process_with_scratch(row, &mut scratch);
        }
        for (i, column) in along.chunks_exact_mut(size).enumerate() {
            for (k, row) in rows.iter() {
                column[*k] += row[i];
            }
        }
    }
    let norm = w.amplitude_sum * w.axes.determinant().abs() / (step * step);
    let mut out = vec![0.0; n * n];
    for (line, column) in out.chunks_exact_mut(n).zip(along.chunks_exact_mut(size)) {
        transform.process_with_scratch(column, &mut scratch);
        for (o, value) in line.iter_mut().zip(column.iter()) {
            *o = value.norm_sqr() / (norm * norm);
        }
    }
    out
}

/// The lattice's rows that meet the pupil: (index along j, values along i). A pupil wider than the lattice is folded into it, which is
/// exact for the samples of the point spread.
fn pupil_rows(
    w: &Wavefront,
    grid: &PsfGrid,
    chords: &Chords,
    (step, size, edge): (f64, usize, Edge),
) -> Vec<(usize, Vec<Complex64>)> {
    let (e_i, e_j) = grid.axes_of(w.meridional_angle);
    let (inverse, wavelength) = (w.axes.inverse(), w.wavelength_um());
    let (middle, half) = (chords.at(0.0).y, chords.half_height());
    let first = grid.offset(0);
    let index = |k: i64| k.rem_euclid(size as i64) as usize;
    // Polynomials in coordinates along the rows: those of one row have one variable.
    let angle = (inverse * e_i).to_angle();
    let (turns_of, amplitude_of) =
        (w.opd_um.scaled(1.0 / wavelength).rotated(angle), w.amplitude.rotated(angle));
    let to_row = DMat2::from_angle(-angle) * inverse;
    let lines = ((middle - half) / step).ceil() as i64..=((middle + half) / step).floor() as i64;
    lines
        .map(|kj| {
            let q_j = kj as f64 * step;
            let chord = chords.at(((q_j - middle) / half).clamp(-1.0, 1.0).asin());
            let ends = [-0.5, 0.5].map(|side| (chord.middle + side * chord.length) / step);
            let mut row = vec![Complex64::ZERO; size];
            let across = (to_row * (q_j * e_j - w.centre)).y;
            let mut turns = vec![0.0; turns_of.degree() + 1];
            let mut amplitude = vec![0.0; amplitude_of.degree() + 1];
            turns_of.along_x(across, &mut turns);
            amplitude_of.along_x(across, &mut amplitude);
            // Cells of the lattice along the row that the chord meets.
            let room = if edge == Edge::Covered { 0.5 } else { 0.0 };
            for ki in (ends[0] - room).ceil() as i64..=(ends[1] + room).floor() as i64 {
                let covered = (ki as f64 + 0.5).min(ends[1]) - (ki as f64 - 0.5).max(ends[0]);
                let weight = if edge == Edge::Covered { covered.clamp(0.0, 1.0) } else { 1.0 };
                let q: DVec2 = ki as f64 * step * e_i + q_j * e_j;
                let along = (to_row * (q - w.centre)).x;
                // ξ = centre + (first + i·pitch) along i and j.
                let shift = q.dot(grid.centre_um) + (ki + kj) as f64 * step * first;
                let (sin, cos) = sin_cos_turns(horner(&turns, along) - shift / wavelength);
                row[index(ki)] += Complex64::new(cos, sin) * (weight * horner(&amplitude, along));
            }
            (index(kj), row)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{Edge, psf};
    use crate::psf::polynomial::Polynomial2;
    use crate::psf::{PsfGrid, Wavefront, matrix};
    use glam::DVec2;

    /// Against the matrix form, for a defocused disc, an even and an odd grid, off the centre, and a pupil that must be folded.
    #[test]
    fn agrees_with_the_matrix_form() {
        let opd = Polynomial2::new(2, vec![0.0, 0.02, 0.2, 0.01, 0.0, 0.2]);
        let w = Wavefront::disc(0.075, 543.0, 1.336, opd);
        for (samples, half_width, centre) in [(32, 10.0, 0.0), (31, 10.0, 1.3), (8, 16.0, 0.0)] {
            let grid =
                PsfGrid { centre_um: DVec2::new(centre, -centre), ..PsfGrid::new(samples, half_width) };
            let want = matrix::psf(&w, &grid);
            let peak = want.iter().copied().fold(0.0, f64::max);
            let error = |across: usize, edge: Edge| {
                let got = psf(&w, &grid, across, edge);
                got.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / peak
            };
            // What the staircase of the pupil's edge leaves.
            assert!(error(64, Edge::Staircase) < 0.02, "{samples} {}", error(64, Edge::Staircase));
            assert!(error(1024, Edge::Staircase) < 0.002, "{samples} {}", error(1024, Edge::Staircase));
            // With covered cells the error falls with a higher power.
            assert!(error(64, Edge::Covered) < 4e-3, "{samples} {}", error(64, Edge::Covered));
            assert!(error(512, Edge::Covered) < 3e-4, "{samples} {}", error(512, Edge::Covered));
        }
    }
}
