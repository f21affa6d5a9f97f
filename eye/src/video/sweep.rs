//! What is left of a frequency sweep (Figure 14): contrast against frequency, from the cones' counts.
//!
//! Weighted least squares of `a + b cos φ + c sin φ` in windows of 4 cycles per degree, with the sweep's own phase φ at each cone; contrast
//! `√(b²+c²)/a`, standard error `√(2/N)` for N counts.

use super::reader::Signal;

/// Width of a window, cycles per degree.
const WINDOW_CPD: f64 = 4.0;

/// Contrast that is left around a frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// Middle of the window.
    pub cycles_per_degree: f64,
    /// Contrast that is left.
    pub left: f64,
    /// Its standard error.
    pub error: f64,
}

/// Contrasts of a sweep that begins `left_deg` from the gaze centre, is `width_deg` wide and goes from one frequency to another (cycles per
/// degree). Windows with less than a cycle are left out: they fit anything.
pub fn contrasts(signals: &[Signal], left_deg: f64, width_deg: f64, [from, to]: [f64; 2]) -> Vec<Contrast> {
    let rise = (to - from) / width_deg;
    let windows = ((to - from).abs() / WINDOW_CPD).ceil().max(1.0) as usize;
    let mut moments = vec![[[0.0; 4]; 3]; windows];
    let mut counts = vec![0.0; windows];
    for signal in signals {
        let x = signal.x_deg - left_deg;
        let window = ((rise * x).abs() / WINDOW_CPD) as usize;
        let Some(moment) = moments.get_mut(window) else { continue };
        let (sin, cos) = (std::f64::consts::TAU * (from * x + 0.5 * rise * x * x)).sin_cos();
        let basis = [1.0, cos, sin];
        for (row, a) in moment.iter_mut().zip(basis) {
            (0..3).for_each(|j| row[j] += signal.usual * a * basis[j]);
            row[3] += a * signal.count;
        }
        counts[window] += signal.count;
    }
    let fit = |(i, (moment, count)): (usize, (&[[f64; 4]; 3], &f64))| {
        let cycles_per_degree = from + (to - from).signum() * WINDOW_CPD * (i as f64 + 0.5);
        if cycles_per_degree * WINDOW_CPD < rise.abs() {
            return None;
        }
        let [a, b, c] = solve(*moment)?;
        Some(Contrast { cycles_per_degree, left: b.hypot(c) / a, error: (2.0 / count).sqrt() })
    };
    moments.iter().zip(&counts).enumerate().filter_map(fit).collect()
}

/// Frequency at which the contrast falls below a level for good, by linear interpolation.
pub fn cut_off(contrasts: &[Contrast], level: f64) -> Option<f64> {
    let last = contrasts.iter().rposition(|c| c.left >= level)?;
    let (a, b) = (contrasts[last], contrasts.get(last + 1)?);
    let part = (a.left - level) / (a.left - b.left);
    Some(a.cycles_per_degree + part * (b.cycles_per_degree - a.cycles_per_degree))
}

/// Solves three equations; `None` when they do not determine the answer.
fn solve(mut m: [[f64; 4]; 3]) -> Option<[f64; 3]> {
    for i in 0..3 {
        let pivot = (i..3).max_by(|&a, &b| m[a][i].abs().total_cmp(&m[b][i].abs()))?;
        m.swap(i, pivot);
        if m[i][i].abs() < 1e-12 {
            return None;
        }
        for k in (0..3).filter(|k| *k != i) {
            let factor = m[k][i] / m[i][i];
            let row = m[i];
            m[k].iter_mut().zip(row).for_each(|(value, above)| *value -= factor * above);
        }
    }
    Some([m[0][3] / m[0][0], m[1][3] / m[1][1], m[2][3] / m[2][2]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_equations_are_solved() {
        let [a, b, c] = solve([[2.0, 1.0, 0.0, 4.0], [0.0, 0.0, 3.0, 9.0], [1.0, -1.0, 1.0, 2.0]]).unwrap();
        assert!((a - 1.0).abs() < 1e-12 && (b - 2.0).abs() < 1e-12 && (c - 3.0).abs() < 1e-12);
        assert!(solve([[1.0, 2.0, 3.0, 4.0]; 3]).is_none());
    }

    #[test]
    fn the_cut_off_is_the_last_fall_below_the_level() {
        let at = |cycles_per_degree: f64, left: f64| Contrast { cycles_per_degree, left, error: 0.0 };
        let curve = [at(10.0, 0.9), at(20.0, 0.4), at(30.0, 0.6), at(40.0, 0.2)];
        assert!((cut_off(&curve, 0.5).unwrap() - 32.5).abs() < 1e-9);
        assert!(cut_off(&curve, 0.1).is_none());
    }
}
