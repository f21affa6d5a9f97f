//! Bins over a ring of cones: sectors about the foveal centre, in each the cones by eccentricity.
//!
//! A square grid would have to span the disc inside the ring. Sectors are equal steps of t, a stand-in for the angle φ that needs no
//! trigonometry: t = y/(|x| + |y|) continued round the circle from 0 to 4. 1/2 <= dt/dφ <= 1, so a range ±δ of angle lies in ±δ of t.
//!
//! # Cost
//! A sort of the ring to build; memory and searches are proportional to the cones of the ring.

use glam::DVec2;

/// Narrowest sectors, in spacings.
const WIDTH: f64 = 1.2;

/// The stand-in for the angle, 0 to 4; 0 at the origin.
pub(super) fn turn(p: DVec2) -> f64 {
    let sum = p.x.abs() + p.y.abs();
    if sum <= 0.0 {
        return 0.0;
    }
    let t = p.y / sum;
    if p.x < 0.0 {
        2.0 - t
    } else if t < 0.0 {
        4.0 + t
    } else {
        t
    }
}

/// Points sorted by sector and eccentricity.
#[derive(Debug, Default)]
pub(super) struct Sectors {
    per_turn: f64,
    start: Vec<u32>,
    rho: Vec<f64>,
    item: Vec<u32>,
}

impl Sectors {
    /// Bins of points that are `spacing` apart on average, µm of the chart.
    pub(super) fn new(points: &[DVec2], spacing: f64) -> Self {
        let mean_rho = points.iter().map(|p| p.length()).sum::<f64>() / points.len().max(1) as f64;
        let count = ((4.0 * mean_rho / (WIDTH * spacing)) as usize).clamp(1, points.len().max(1));
        let mut sectors = Self { per_turn: count as f64 / 4.0, ..Self::default() };
        let mut order: Vec<(u32, u64, u32)> = points
            .iter()
            .enumerate()
            // Bits of positive numbers sort as the numbers do.
            .map(|(i, &p)| (sectors.sector(turn(p), count), p.length().to_bits(), i as u32))
            .collect();
        order.sort_unstable();
        sectors.start = vec![0; count + 1];
        for &(sector, rho, item) in &order {
            sectors.start[sector as usize + 1] += 1;
            sectors.rho.push(f64::from_bits(rho));
            sectors.item.push(item);
        }
        for s in 0..count {
            sectors.start[s + 1] += sectors.start[s];
        }
        sectors
    }

    fn sector(&self, turn: f64, count: usize) -> u32 {
        ((turn * self.per_turn) as u32).min(count as u32 - 1)
    }

    /// The points in the order of the bins.
    pub(super) fn order(&self) -> &[u32] {
        &self.item
    }

    /// Calls `f` with slices of points that hold all within `reach` µm of the chart of `p`.
    #[inline]
    pub(super) fn near(&self, p: DVec2, reach: f64, mut f: impl FnMut(&[u32])) {
        let count = self.start.len() - 1;
        let rho = p.length();
        let (mut first, mut found) = (0, count);
        if reach < 0.5 * rho {
            // arcsin(x) < 1.05 x up to 1/2.
            let (t, half) = (turn(p), 1.05 * reach / rho);
            let low = ((t - half) * self.per_turn).floor() as i64;
            let high = ((t + half) * self.per_turn).floor() as i64;
            if high - low + 1 < count as i64 {
                (first, found) = (low.rem_euclid(count as i64) as usize, (high - low + 1) as usize);
            }
        }
        for k in 0..found {
            let s = if first + k < count { first + k } else { first + k - count };
            let (a, b) = (self.start[s] as usize, self.start[s + 1] as usize);
            let rhos = &self.rho[a..b];
            let low = rhos.partition_point(|&r| r < rho - reach);
            let high = low + rhos[low..].partition_point(|&r| r <= rho + reach);
            f(&self.item[a + low..a + high]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    #[test]
    fn turn_grows_with_the_angle_and_no_faster() {
        for k in 0..400 {
            let (a, b) = (f64::from(k) * 0.0157, f64::from(k + 1) * 0.0157);
            let step = turn(math::unit(b)) - turn(math::unit(a));
            assert!(step > 0.49 * (b - a) && step < 1.0001 * (b - a), "{k}");
        }
    }

    #[test]
    fn near_finds_all() {
        for inner in [0.0, 20.0, 300.0] {
            let points: Vec<DVec2> = (0..900)
                .map(|i| math::unit(f64::from(i) * 2.399_963) * (inner + f64::from(i).sqrt()))
                .collect();
            let sectors = Sectors::new(&points, 2.0);
            for (i, p) in points.iter().enumerate().step_by(7) {
                let mut found = Vec::new();
                sectors.near(*p, 5.0, |items| found.extend_from_slice(items));
                found.sort_unstable();
                for (j, q) in points.iter().enumerate() {
                    let listed = found.binary_search(&(j as u32)).is_ok();
                    assert!(listed || q.distance(*p) > 5.0, "{i} {j}");
                }
            }
        }
        Sectors::new(&[], 1.0).near(DVec2::X, 1.0, |items| assert!(items.is_empty()));
    }
}
