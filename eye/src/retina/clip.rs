//! A convex polygon cut by half-planes, with a label on every edge.

use glam::DVec2;

use crate::math;

/// Label of an edge that no cut made.
pub(super) const LIMIT: u32 = u32::MAX;

/// Counter-clockwise polygon; edge m runs from corner m to corner m + 1 and carries `label[m]`.
#[derive(Clone, Debug, Default)]
pub(super) struct Convex {
    pub(super) corner: Vec<DVec2>,
    pub(super) label: Vec<u32>,
    next_corner: Vec<DVec2>,
    next_label: Vec<u32>,
}

impl Convex {
    /// Starts anew with a regular polygon about the origin.
    pub(super) fn reset_regular(&mut self, directions: &[DVec2], radius: f64) {
        self.corner.clear();
        self.label.clear();
        self.corner.extend(directions.iter().map(|&d| d * radius));
        self.label.resize(directions.len(), LIMIT);
    }

    /// Outer normal n and offset o of every edge: the inside is n·x <= o.
    pub(super) fn walls(&self) -> Vec<(DVec2, f64)> {
        let n = self.corner.len();
        let wall = |m: usize| {
            let normal = -(self.corner[(m + 1) % n] - self.corner[m]).perp();
            (normal, normal.dot(self.corner[m]))
        };
        (0..n).map(wall).collect()
    }

    /// Largest distance of a corner from the origin.
    pub(super) fn reach(&self) -> f64 {
        self.corner.iter().map(|c| c.length_squared()).fold(0.0, f64::max).sqrt()
    }

    /// Keeps the part with `normal`·x <= `offset`; the new edge gets `label`. True when something was cut off.
    pub(super) fn cut(&mut self, normal: DVec2, offset: f64, label: u32) -> bool {
        let n = self.corner.len();
        if self.corner.iter().all(|c| normal.dot(*c) <= offset) {
            return false;
        }
        self.next_corner.clear();
        self.next_label.clear();
        for m in 0..n {
            let (a, b) = (self.corner[m], self.corner[(m + 1) % n]);
            let (da, db) = (normal.dot(a) - offset, normal.dot(b) - offset);
            if da <= 0.0 {
                self.next_corner.push(a);
                self.next_label.push(self.label[m]);
            }
            if (da <= 0.0) != (db <= 0.0) {
                self.next_corner.push(a + (b - a) * (da / (da - db)));
                self.next_label.push(if da <= 0.0 { label } else { self.label[m] });
            }
        }
        std::mem::swap(&mut self.corner, &mut self.next_corner);
        std::mem::swap(&mut self.label, &mut self.next_label);
        true
    }
}

/// Unit vectors of a regular polygon.
pub(super) fn directions(n: usize) -> Vec<DVec2> {
    (0..n).map(|i| math::unit(std::f64::consts::TAU * (i as f64 + 0.5) / n as f64)).collect()
}

/// Area of a counter-clockwise polygon.
pub(super) fn area(corner: &[DVec2]) -> f64 {
    let n = corner.len();
    (0..n).map(|m| corner[m].perp_dot(corner[(m + 1) % n])).sum::<f64>() / 2.0
}

/// Centroid of a polygon with some area.
pub(super) fn centroid(corner: &[DVec2]) -> DVec2 {
    let n = corner.len();
    let sum: DVec2 =
        (0..n).map(|m| (corner[m], corner[(m + 1) % n])).map(|(a, b)| (a + b) * a.perp_dot(b)).sum();
    sum / (6.0 * area(corner)).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_cut_to_a_corner() {
        let mut p = Convex::default();
        p.reset_regular(&directions(4), 2.0_f64.sqrt());
        assert!((area(&p.corner) - 4.0).abs() < 1e-12);
        assert!(p.cut(DVec2::X, 0.0, 7));
        assert!(!p.cut(DVec2::X, 0.5, 8));
        assert!(p.cut(DVec2::Y, 0.0, 9));
        assert!((area(&p.corner) - 1.0).abs() < 1e-12);
        assert!((centroid(&p.corner) - DVec2::splat(-0.5)).length() < 1e-12);
        assert_eq!(p.label.iter().filter(|l| **l == LIMIT).count(), 2);
        assert!(p.label.contains(&7) && p.label.contains(&9));
        assert!(p.cut(DVec2::X, -5.0, 1));
        assert!(p.corner.is_empty());
    }
}
