//! The Sloan letters (Sloan 1959; NAS-NRC 1980) as strokes on a grid of 5 x 5 stroke widths, x to the right, y up.
//!
//! Own construction after the published rules: every stroke is one unit wide, diagonals measured across; C is a Landolt ring with a gap of
//! one unit. E, the plain 5 x 5 letter, is not one of the ten.

use glam::DVec2;

/// A part of a letter.
#[derive(Clone, Copy, Debug)]
enum Stroke {
    /// Corners x0, y0, x1, y1.
    Rect(f64, f64, f64, f64),
    /// A rectangle that is taken away.
    Gap(f64, f64, f64, f64),
    /// Centre x, y, outer and inner radius, from and to degrees, counter-clockwise from +x.
    Ring(f64, f64, f64, f64, f64, f64),
    /// Corners of a convex or simple polygon.
    Poly(&'static [[f64; 2]]),
}

use Stroke::{Gap, Poly, Rect, Ring};

/// Letters that can be drawn.
pub const LETTERS: &str = "CDEHKNORSVZ";

fn strokes(letter: char) -> &'static [Stroke] {
    match letter {
        'C' => &[Ring(2.5, 2.5, 2.5, 1.5, 0.0, 360.0), Gap(2.5, 2.0, 5.5, 3.0)],
        'D' => &[
            Rect(0.0, 0.0, 1.0, 5.0),
            Rect(0.0, 0.0, 3.0, 1.0),
            Rect(0.0, 4.0, 3.0, 5.0),
            Ring(3.0, 2.0, 2.0, 1.0, 270.0, 360.0),
            Ring(3.0, 3.0, 2.0, 1.0, 0.0, 90.0),
            Rect(4.0, 2.0, 5.0, 3.0),
        ],
        'E' => &[
            Rect(0.0, 0.0, 1.0, 5.0),
            Rect(1.0, 0.0, 5.0, 1.0),
            Rect(1.0, 2.0, 5.0, 3.0),
            Rect(1.0, 4.0, 5.0, 5.0),
        ],
        'H' => &[Rect(0.0, 0.0, 1.0, 5.0), Rect(4.0, 0.0, 5.0, 5.0), Rect(1.0, 2.0, 4.0, 3.0)],
        'K' => &[
            Rect(0.0, 0.0, 1.0, 5.0),
            Poly(&[[1.0, 2.0], [5.0, 5.0], [3.3333, 5.0], [1.0, 3.25]]),
            Poly(&[[2.0694, 2.8021], [2.8723, 3.4043], [5.0, 0.0], [3.8208, 0.0]]),
        ],
        'N' => &[
            Rect(0.0, 0.0, 1.0, 5.0),
            Rect(4.0, 0.0, 5.0, 5.0),
            Poly(&[[1.0, 5.0], [1.0, 3.4708], [4.0, 0.0], [4.0, 1.5292]]),
        ],
        'O' => &[Ring(2.5, 2.5, 2.5, 1.5, 0.0, 360.0)],
        'R' => &[
            Rect(0.0, 0.0, 1.0, 5.0),
            Rect(1.0, 4.0, 3.5, 5.0),
            Rect(1.0, 2.0, 3.5, 3.0),
            Ring(3.5, 3.5, 1.5, 0.5, -90.0, 90.0),
            Poly(&[[5.0, 0.0], [3.9134, 0.0], [2.9784, 2.2], [4.065, 2.2]]),
        ],
        'S' => &[
            Ring(1.5, 3.5, 1.5, 0.5, 90.0, 270.0),
            Rect(1.5, 4.0, 3.5, 5.0),
            Rect(1.5, 2.0, 3.5, 3.0),
            Ring(3.5, 3.5, 1.5, 0.5, 0.0, 90.0),
            Ring(3.5, 1.5, 1.5, 0.5, -90.0, 90.0),
            Rect(1.5, 0.0, 3.5, 1.0),
            Ring(1.5, 1.5, 1.5, 0.5, 180.0, 270.0),
        ],
        'V' => &[Poly(&[
            [0.0, 5.0],
            [1.077, 5.0],
            [2.5, 1.4425],
            [3.923, 5.0],
            [5.0, 5.0],
            [3.0, 0.0],
            [2.0, 0.0],
        ])],
        'Z' => &[
            Rect(0.0, 0.0, 5.0, 1.0),
            Rect(0.0, 4.0, 5.0, 5.0),
            Poly(&[[0.0, 1.0], [1.5292, 1.0], [5.0, 4.0], [3.4708, 4.0]]),
        ],
        _ => &[],
    }
}

/// Whether a point of the 5 x 5 box is ink.
pub fn ink(letter: char, at: DVec2) -> bool {
    let within = |x0: f64, y0: f64, x1: f64, y1: f64| at.x >= x0 && at.x < x1 && at.y >= y0 && at.y < y1;
    let strokes = strokes(letter);
    let inked = strokes.iter().any(|stroke| match *stroke {
        Rect(x0, y0, x1, y1) => within(x0, y0, x1, y1),
        Gap(..) => false,
        Ring(x, y, outer, inner, from, to) => {
            let v = at - DVec2::new(x, y);
            let r = v.length();
            let angle = || (v.y.atan2(v.x).to_degrees() - from).rem_euclid(360.0);
            r < outer && r >= inner && angle() <= to - from
        }
        Poly(corners) => inside(corners, at),
    });
    inked && !strokes.iter().any(|s| matches!(*s, Gap(x0, y0, x1, y1) if within(x0, y0, x1, y1)))
}

/// Even-odd rule.
fn inside(corners: &[[f64; 2]], at: DVec2) -> bool {
    let mut odd = false;
    for (i, [x1, y1]) in corners.iter().enumerate() {
        let [x0, y0] = corners[(i + corners.len() - 1) % corners.len()];
        if (y0 > at.y) != (*y1 > at.y) && at.x < x0 + (at.y - y0) / (y1 - y0) * (x1 - x0) {
            odd = !odd;
        }
    }
    odd
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(letter: char) -> f64 {
        let n = 500_u32;
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(n) * 5.0;
        let inked = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
        inked.filter(|(i, j)| ink(letter, DVec2::new(at(*i), at(*j)))).count() as f64 * 25.0
            / f64::from(n * n)
    }

    /// Areas in closed form: rings π(R² - r²), bars by count.
    #[test]
    fn letters_have_their_areas() {
        let ring = std::f64::consts::PI * (2.5 * 2.5 - 1.5 * 1.5);
        // The gap of C cuts a strip of height 1 from r = 1.5 to 2.5: its area by the two circular segments.
        let strip = |r: f64| 0.5 * (r * r - 0.25).sqrt() + r * r * (0.5 / r).asin();
        for (letter, expected) in [
            ('O', ring),
            ('C', ring - (strip(2.5) - strip(1.5))),
            ('H', 13.0),
            ('E', 17.0),
            ('Z', 10.0 + 3.0 * 1.5292),
            ('N', 10.0 + 3.0 * 1.5292),
            ('D', 5.0 + 2.0 * 2.0 + 2.0 * std::f64::consts::PI * 3.0 / 4.0 + 1.0),
        ] {
            assert!((area(letter) - expected).abs() < 0.02, "{letter} {} {expected}", area(letter));
        }
        for letter in LETTERS.chars() {
            assert!(area(letter) > 8.0 && area(letter) < 18.0, "{letter} {}", area(letter));
        }
    }

    /// Every letter comes within a tenth of a stroke of all four sides of its box (C has its gap on the right).
    #[test]
    fn letters_fill_their_box() {
        for letter in LETTERS.chars() {
            let along = |fixed: f64, x: bool| {
                (0..500).any(|i| {
                    let free = (f64::from(i) + 0.5) / 100.0;
                    ink(letter, if x { DVec2::new(fixed, free) } else { DVec2::new(free, fixed) })
                })
            };
            assert!(
                along(0.1, true) && along(4.9, true) && along(0.1, false) && along(4.9, false),
                "{letter}"
            );
        }
    }
}
