//! Square bins over points, for all searches of neighbours. Items of a bin are in ascending order.

use glam::DVec2;

/// Most bins along one side; coarser bins are used beyond.
const MAX_SIDE: f64 = 2_048.0;

/// Points sorted into square bins.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    min: DVec2,
    size: f64,
    nx: usize,
    ny: usize,
    start: Vec<u32>,
    item: Vec<u32>,
    /// The points in the order of the items.
    point: Vec<DVec2>,
}

/// Items of neighbouring bins, and the box that they were looked up for.
pub(super) struct Run<'a> {
    pub(super) item: &'a [u32],
    point: &'a [DVec2],
    about: DVec2,
    reach: DVec2,
}

impl Run<'_> {
    /// Whether item number `k` of the run lies in the box.
    #[inline]
    pub(super) fn holds(&self, k: usize) -> bool {
        let d = self.point[k] - self.about;
        (d.x.abs() <= self.reach.x) & (d.y.abs() <= self.reach.y)
    }
}

impl Grid {
    /// Bins of at least `size` on a side.
    pub(super) fn new(points: &[DVec2], size: f64) -> Self {
        let (mut min, mut max) = (DVec2::splat(f64::MAX), DVec2::splat(f64::MIN));
        for &p in points {
            (min, max) = (min.min(p), max.max(p));
        }
        let extent = (max - min).max(DVec2::ZERO);
        let size = size.max(extent.max_element() / MAX_SIDE).max(1e-9);
        let (nx, ny) = ((extent.x / size) as usize + 1, (extent.y / size) as usize + 1);
        let mut grid = Self {
            min,
            size,
            nx,
            ny,
            start: vec![0; nx * ny + 1],
            item: vec![0; points.len()],
            point: vec![DVec2::ZERO; points.len()],
        };
        for &p in points {
            let bin = grid.bin(p);
            grid.start[bin + 1] += 1;
        }
        for b in 1..grid.start.len() {
            grid.start[b] += grid.start[b - 1];
        }
        let mut next = grid.start.clone();
        for (i, &p) in points.iter().enumerate() {
            let slot = &mut next[grid.bin(p)];
            grid.item[*slot as usize] = i as u32;
            grid.point[*slot as usize] = p;
            *slot += 1;
        }
        grid
    }

    fn cell(&self, p: DVec2) -> (usize, usize) {
        let c = (p - self.min) / self.size;
        // A negative or NaN quotient saturates to 0.
        ((c.x as usize).min(self.nx - 1), (c.y as usize).min(self.ny - 1))
    }

    fn bin(&self, p: DVec2) -> usize {
        let (x, y) = self.cell(p);
        y * self.nx + x
    }

    /// Calls `f` with the items of the bins that touch the square of half side `reach` about `p`, row by row.
    #[inline]
    pub(super) fn near_slices(&self, p: DVec2, reach: f64, mut f: impl FnMut(&[u32])) {
        let (x0, y0) = self.cell(p - DVec2::splat(reach));
        let (x1, y1) = self.cell(p + DVec2::splat(reach));
        for y in y0..=y1 {
            let (a, b) = (self.start[y * self.nx + x0], self.start[y * self.nx + x1 + 1]);
            f(&self.item[a as usize..b as usize]);
        }
    }

    /// For every item i in the order of the bins, calls `f` with i and runs of items that come after it in that order and whose bins meet
    /// the box of half sides `reach(i)` about it. Two items within both their boxes meet exactly once.
    #[inline]
    pub(super) fn each_with_later(&self, reach: impl Fn(u32) -> DVec2, mut f: impl FnMut(u32, Run)) {
        for (slot, (&i, &p)) in self.item.iter().zip(&self.point).enumerate() {
            let reach = reach(i);
            let (_, y) = self.cell(p);
            let (x0, _) = self.cell(p - reach);
            let (x1, y1) = self.cell(p + reach);
            for row in y..=y1 {
                let from = if row == y { slot + 1 } else { self.start[row * self.nx + x0] as usize };
                let to = self.start[row * self.nx + x1 + 1] as usize;
                f(i, Run { item: &self.item[from..to], point: &self.point[from..to], about: p, reach });
            }
        }
    }

    /// Calls `f` with every item in the bins that touch the square of half side `reach` about `p`.
    #[inline]
    pub(super) fn near(&self, p: DVec2, reach: f64, mut f: impl FnMut(u32)) {
        self.near_slices(p, reach, |items| items.iter().for_each(|&i| f(i)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_all_within_reach() {
        let points: Vec<DVec2> =
            (0..500).map(|i| DVec2::new(f64::from(i * 37 % 101), f64::from(i * 53 % 97))).collect();
        let grid = Grid::new(&points, 3.0);
        let (p, reach) = (DVec2::new(40.0, 40.0), 9.0);
        let mut found = Vec::new();
        grid.near(p, reach, |i| found.push(i));
        for (i, q) in points.iter().enumerate() {
            if (*q - p).abs().max_element() <= reach {
                assert!(found.contains(&(i as u32)));
            }
        }
        assert!(found.len() < 100);
        Grid::new(&[], 1.0).near(p, reach, |_| panic!("empty"));
    }
}
