//! Which cone's aperture owns a point of the chart.
//!
//! A point on a wall belongs to exactly one of the two cones: the side of a wall is computed from its end points in lexicographic order, with the same
//! bits for both, and a point on it counts as left of it.

use glam::DVec2;

use super::grid::Grid;
use super::mosaic::Retina;

/// Point location in the apertures of a retina.
#[derive(Clone, Debug)]
pub struct ConeIndex {
    grid: Grid,
    reach: f64,
    /// Centre of each cone and the square of its farthest corner's distance.
    disc: Vec<(DVec2, f64)>,
    start: Vec<u32>,
    corner: Vec<DVec2>,
}

impl ConeIndex {
    /// An index over the cones of a retina.
    pub fn new(retina: &Retina) -> Self {
        let centers: Vec<DVec2> = (0..retina.len()).map(|i| retina.center(i)).collect();
        let mut corner = Vec::with_capacity(retina.polygon_xy.len() / 2);
        let (mut start, mut reach) = (vec![0], 0.0_f64);
        let mut disc = Vec::with_capacity(centers.len());
        for (i, &c) in centers.iter().enumerate() {
            let mut farthest = 0.0_f64;
            for p in retina.polygon(i) {
                farthest = farthest.max((p - c).length());
                corner.push(p);
            }
            reach = reach.max(farthest);
            // A hair more than the farthest corner, so that rounding excludes nothing.
            disc.push((c, farthest * farthest * (1.0 + 1e-9)));
            start.push(corner.len() as u32);
        }
        Self { grid: Grid::new(&centers, reach), reach, disc, start, corner }
    }

    /// The cone whose aperture owns `p`, µm of the chart; `None` between apertures and outside.
    pub fn owner(&self, p: DVec2) -> Option<u32> {
        let mut found = None;
        self.grid.near(p, self.reach, |i| {
            if found.is_none() && self.owns(i as usize, p) {
                found = Some(i);
            }
        });
        found
    }

    fn owns(&self, i: usize, p: DVec2) -> bool {
        let (centre, radius2) = self.disc[i];
        if (p - centre).length_squared() > radius2 {
            return false;
        }
        let corner = &self.corner[self.start[i] as usize..self.start[i + 1] as usize];
        let n = corner.len();
        n >= 3 && (0..n).all(|m| is_left(corner[m], corner[(m + 1) % n], p))
    }
}

/// Whether `p` is left of the wall from `a` to `b`; for the wall from `b` to `a` it is exactly the opposite.
#[inline]
fn is_left(a: DVec2, b: DVec2, p: DVec2) -> bool {
    if (a.x, a.y) < (b.x, b.y) { (b - a).perp_dot(p - a) >= 0.0 } else { (a - b).perp_dot(p - b) < 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_on_a_wall_has_one_side() {
        let (a, b) = (DVec2::new(0.1, 0.7), DVec2::new(2.3, -0.4));
        for k in 0..1_000 {
            let p = a + (b - a) * (f64::from(k) / 999.0);
            assert_ne!(is_left(a, b, p), is_left(b, a, p));
        }
    }
}
