//! Cell walls (§15.3): a power diagram of limited cells with shared corners.
//!
//! Cone n bounds cone p at (n - p)·x = (|n - p|² + w_p - w_n)/2, w = r²/2, in the plane across the cones. Half of r² lets larger cones have
//! larger cells and yet keeps every centre inside its cell. No cell reaches beyond 1.25 spacings (a void).
//!
//! Which cones meet at a corner is found cell by cell; where the corner lies is computed once for the sorted set of the cones that
//! meet there, so all of them get the same bits. Corners joined by a wall shorter than 0.1 spacing are one corner of four or
//! five cones (§15.3), unless a cell would turn concave by that: then they stay apart. One cell in a
//! million is concave even so (corners almost in line); it loses that corner and is counted.
//!
//! # Cost
//! A fifth of the generator's time.

use glam::DVec2;

use super::clip::{Convex, LIMIT, directions};
use super::grid::Grid;
use super::relax::{Relaxed, quantized};

/// Weight of the power diagram in squared radii.
const WEIGHT: f64 = 0.5;
/// Largest distance of a wall from the centre, in spacings.
const LARGEST: f64 = 1.25;
/// Shortest wall, in spacings.
const SHORTEST: f64 = 0.1;
/// Corners joined into one, at most.
const MAX_JOINED: usize = 8;
/// Rounds in which corners may be taken apart again.
const ROUNDS: usize = 3;
/// Pairs closer than this D are counted as degenerate (§15.4).
const CLOSE: f64 = 0.6;

/// The cells of all cones near a tile; cones farther out have none.
#[derive(Debug, Default)]
pub(super) struct Cells {
    start: Vec<u32>,
    label: Vec<u32>,
    corner: Vec<DVec2>,
    short: Vec<bool>,
    blocked: Vec<bool>,
    polygon_start: Vec<u32>,
    polygon: Vec<DVec2>,
    /// The cone has a neighbour closer than `CLOSE`.
    pub(super) close: Vec<bool>,
    /// The cell reaches its size limit.
    pub(super) void: Vec<bool>,
    /// The cell was not convex and lost a corner.
    pub(super) concave: Vec<bool>,
}

impl Cells {
    /// Corners of a cell, absolute, counter-clockwise.
    pub(super) fn polygon(&self, i: usize) -> &[DVec2] {
        &self.polygon[self.polygon_start[i] as usize..self.polygon_start[i + 1] as usize]
    }

    fn slots(&self, i: u32) -> std::ops::Range<usize> {
        self.start[i as usize] as usize..self.start[i as usize + 1] as usize
    }

    /// Slot of the wall between cone `i` and cone `n`.
    fn wall(&self, i: u32, n: u32) -> Option<usize> {
        self.slots(i).find(|&s| self.label[s] == n)
    }
}

/// Cells of the cones born within `rows` of the tile.
pub(super) fn build_cells(cones: &Relaxed, rows: f64) -> Cells {
    let mut cells = diagram(cones, |i| cones.rows[i] <= rows);
    place_corners(cones, &mut cells);
    cells.blocked = vec![false; cones.at.len()];
    for _ in 0..ROUNDS {
        join_corners(cones, &mut cells, false);
        let mut changed = false;
        for i in 0..cones.at.len() {
            if cells.concave[i] && !cells.blocked[i] {
                cells.blocked[i] = true;
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    if cells.concave.contains(&true) {
        join_corners(cones, &mut cells, true);
    }
    cells
}

/// The neighbours of each wanted cone in counter-clockwise order, by cutting.
pub(super) fn diagram(cones: &Relaxed, wanted: impl Fn(usize) -> bool) -> Cells {
    let n = cones.at.len();
    let mean = cones.spacing.iter().sum::<f64>() / n.max(1) as f64;
    let grid = Grid::new(&cones.at, mean);
    let circle = directions(12);
    let mut cells = Cells { start: vec![0], close: vec![false; n], void: vec![false; n], ..Cells::default() };
    let (mut cell, mut near) = (Convex::default(), Vec::new());
    for i in 0..n {
        if wanted(i) {
            cut_cell(cones, &grid, i, &circle, &mut cell, &mut near);
            let frame = cones.metric[i].frame();
            cells.close[i] = near.first().is_some_and(|&(d2, j, _): &(f64, u32, DVec2)| {
                d2.sqrt() < CLOSE * (cones.radius[i] + cones.radius[j as usize])
            });
            cells.void[i] = cell.label.contains(&LIMIT);
            for (&label, &corner) in cell.label.iter().zip(&cell.corner) {
                cells.label.push(label);
                cells.corner.push(cones.at[i] + frame.chart_from_plane(corner));
            }
        }
        cells.start.push(cells.label.len() as u32);
    }
    cells
}

/// Cuts the cell of cone `i` out of its size limit; `near` gets (squared distance, cone, plane step) in ascending order.
fn cut_cell(
    cones: &Relaxed,
    grid: &Grid,
    i: usize,
    circle: &[DVec2],
    cell: &mut Convex,
    near: &mut Vec<(f64, u32, DVec2)>,
) {
    let (p, metric, spacing) = (cones.at[i], cones.metric[i], cones.spacing[i]);
    let frame = metric.frame();
    let weight = |k: usize| WEIGHT * cones.radius[k] * cones.radius[k];
    let (mut radius, mut heaviest) = (1.7 * spacing, 0.0);
    // Most cells end within 0.85 spacings; a second pass looks farther for those that do not.
    for _ in 0..2 {
        near.clear();
        heaviest = 0.0_f64;
        grid.near(p, radius / metric.shortest(), |j| {
            let d = cones.at[j as usize] - p;
            let l2 = metric.length2(d);
            if l2 < radius * radius && j as usize != i {
                near.push((l2, j, frame.plane_from_chart(d)));
                heaviest = heaviest.max(weight(j as usize));
            }
        });
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        cell.reset_regular(circle, LARGEST * spacing);
        let mut reach = cell.reach();
        for &(l2, j, d) in near.iter() {
            if l2 + weight(i) - heaviest > 2.0 * reach * l2.sqrt() {
                break;
            }
            if cell.cut(d, 0.5 * (l2 + weight(i) - weight(j as usize)), j) {
                reach = cell.reach();
            }
        }
        if 2.0 * reach < 0.95 * radius {
            break;
        }
        radius = (2.1 * LARGEST + 0.3) * spacing;
    }
    let _ = heaviest;
}

/// Replaces corners by those of the sorted sets of cones, and marks short walls.
fn place_corners(cones: &Relaxed, cells: &mut Cells) {
    cells.short = vec![false; cells.label.len()];
    for i in 0..cones.at.len() as u32 {
        let slots = cells.slots(i);
        let count = slots.len();
        let slot = |m: usize| slots.start + m % count;
        for m in 0..count {
            let (before, after) = (cells.label[slot(m + count - 1)], cells.label[slot(m)]);
            if before != LIMIT && after != LIMIT {
                let mut set = [i, before, after];
                set.sort_unstable();
                cells.corner[slot(m)] = meeting_point(cones, &set).unwrap_or(cells.corner[slot(m)]);
            }
        }
        for m in 0..count {
            let n = cells.label[slot(m)];
            if n != LIMIT {
                let wall = cells.corner[slot(m + 1)] - cells.corner[slot(m)];
                let shortest = SHORTEST * 0.5 * (cones.spacing[i as usize] + cones.spacing[n as usize]);
                let metric = cones.metric[i as usize].plus(&cones.metric[n as usize]);
                cells.short[slot(m)] = 0.5 * metric.length2(wall) < shortest * shortest;
            }
        }
    }
}

/// The point of equal power distance from a sorted set of cones (least squares for more than three); `None` when they are in line.
fn meeting_point(cones: &Relaxed, set: &[u32]) -> Option<DVec2> {
    let first = set[0] as usize;
    let mut metric = cones.metric[first];
    for &k in &set[1..] {
        metric = metric.plus(&cones.metric[k as usize]);
    }
    let share = 1.0 / set.len() as f64;
    let weight = |k: usize| WEIGHT * cones.radius[k] * cones.radius[k];
    let equation = |k: u32| {
        let d = cones.at[k as usize] - cones.at[first];
        let v = metric.lower(d) * share;
        (v, 0.5 * (v.dot(d) + weight(first) - weight(k as usize)))
    };
    let (xx, xy, yy, right) = if set.len() == 3 {
        // Two equations: solve them as they are, xx..yy being the rows.
        let ((v, b), (w, c)) = (equation(set[1]), equation(set[2]));
        let det = v.perp_dot(w);
        let x = DVec2::new(b * w.y - c * v.y, c * v.x - b * w.x) / det;
        return (det.abs() > 1e-9 * v.length() * w.length()).then(|| cones.at[first] + x);
    } else {
        let (mut xx, mut xy, mut yy, mut right) = (0.0, 0.0, 0.0, DVec2::ZERO);
        for &k in &set[1..] {
            let (v, b) = equation(k);
            xx += v.x * v.x;
            xy += v.x * v.y;
            yy += v.y * v.y;
            right += b * v;
        }
        (xx, xy, yy, right)
    };
    let det = xx * yy - xy * xy;
    let x = DVec2::new(yy * right.x - xy * right.y, xx * right.y - xy * right.x) / det;
    (det > 1e-9 * xx * yy).then(|| cones.at[first] + x)
}

/// Final polygons: corners at the ends of short walls joined where allowed. `mend` drops the corners that leave a cell concave.
fn join_corners(cones: &Relaxed, cells: &mut Cells, mend: bool) {
    let n = cones.at.len();
    let mut polygon: Vec<DVec2> = Vec::with_capacity(cells.corner.len());
    let mut starts = Vec::with_capacity(n + 1);
    let mut concave = vec![false; n];
    starts.push(0);
    for i in 0..n as u32 {
        let first = polygon.len();
        let slots = cells.slots(i);
        let count = slots.len();
        for m in 0..count {
            let here = slots.start + m;
            let before = slots.start + (m + count - 1) % count;
            let corner =
                quantized(shared_corner(cones, cells, i, before, here).unwrap_or(cells.corner[here]));
            if polygon.len() == first || polygon[polygon.len() - 1] != corner {
                polygon.push(corner);
            }
        }
        while polygon.len() > first + 1 && polygon[polygon.len() - 1] == polygon[first] {
            polygon.pop();
        }
        concave[i as usize] = count > 0 && !is_convex(&polygon[first..]);
        while mend && let Some(m) = reflex(&polygon[first..]) {
            polygon.remove(first + m);
        }
        starts.push(polygon.len() as u32);
    }
    (cells.polygon, cells.polygon_start, cells.concave) = (polygon, starts, concave);
}

/// The corner of cone `i` between the walls in slots `before` and `here`, joined with others; `None` when it stands alone.
fn shared_corner(cones: &Relaxed, cells: &Cells, i: u32, before: usize, here: usize) -> Option<DVec2> {
    let (a, b) = (cells.label[before], cells.label[here]);
    if a == LIMIT || b == LIMIT {
        return None;
    }
    let far = cells.wall(a, b).or_else(|| cells.wall(b, a));
    if !cells.short[before] && !cells.short[here] && !far.is_some_and(|s| cells.short[s]) {
        return None;
    }
    // Walk over short walls from corner to corner.
    let mut first = [i, a, b];
    first.sort_unstable();
    let (mut corners, mut set) = (vec![first], first.to_vec());
    let mut next = 0;
    while next < corners.len() && corners.len() < MAX_JOINED {
        let [p, q, r] = corners[next];
        next += 1;
        for (x, y, z) in [(p, q, r), (p, r, q), (q, r, p)] {
            if let Some(third) = across_short_wall(cells, x, y, z) {
                let mut corner = [x, y, third];
                corner.sort_unstable();
                let blocked = [x, y, z, third].iter().any(|&k| cells.blocked[k as usize]);
                if !blocked && !corners.contains(&corner) {
                    corners.push(corner);
                    set.push(third);
                }
            }
        }
    }
    set.sort_unstable();
    set.dedup();
    if set.len() > 3 { meeting_point(cones, &set) } else { None }
}

/// The third cone at the other end of the wall between `x` and `y`, seen from the corner with `z`, when that wall is short.
fn across_short_wall(cells: &Cells, x: u32, y: u32, z: u32) -> Option<u32> {
    let (cone, slot) = cells.wall(x, y).map(|s| (x, s)).or_else(|| cells.wall(y, x).map(|s| (y, s)))?;
    if !cells.short[slot] {
        return None;
    }
    let slots = cells.slots(cone);
    let count = slots.len();
    let m = slot - slots.start;
    let after = cells.label[slots.start + (m + 1) % count];
    let before = cells.label[slots.start + (m + count - 1) % count];
    let third = if before == z { after } else { before };
    (third != LIMIT && (before == z || after == z) && third != z).then_some(third)
}

fn is_convex(corner: &[DVec2]) -> bool {
    corner.len() >= 3 && reflex(corner).is_none()
}

/// The first corner at which the polygon turns right.
fn reflex(corner: &[DVec2]) -> Option<usize> {
    let n = corner.len();
    (0..n).find(|&m| {
        let (a, b, c) = (corner[(m + n - 1) % n], corner[m], corner[(m + 1) % n]);
        (b - a).perp_dot(c - b) < 0.0
    })
}

/// Neighbours of each cone, counter-clockwise, and whether its cell closed within the size limit.
pub(super) fn neighbours(cells: &Cells, i: usize) -> (&[u32], bool) {
    (&cells.label[cells.slots(i as u32)], !cells.void[i])
}
