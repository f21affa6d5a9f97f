//! A measured mosaic as a retina: places and types from a table, cells grown here.
//!
//! `table` reads the text. Ids are the table's, else the numbers of its rows (from 0).
//!
//! Spacing of a cone: mean distance across the cone to its six nearest, then the median of that over the cone
//! and those six, so that cones at the rim get the spacing of their inner neighbours. Cells are plain Voronoi
//! cells (equal weights) limited at 1.25 spacings, by the builder of `cells`. Apertures (`aperture`): with
//! `CELL` the table's fraction of the cell; with `INNER_SEGMENT` each cell is shrunk to π/4·d²·cos(tilt)
//! across the cone's direction, whatever its size, but never beyond itself: every cone at an eccentricity has
//! the same inner segment. Pointing errors are drawn from the seed by cone.
//!
//! Beside a gap and at the rim a cell has corners far away. Its cone is as large as the median cell of its neighbours
//! inside: the gap stays a gap. It is marked as one at an edge. Apertures of the table are taken as they are.
//!
//! # Cost
//! Measured: 4 µs a cone, one thread; 16 µs for a strip from the fovea to 45°, over which the density falls fifty times.

use glam::DVec2;

use super::cells::{Cells, build_cells};
use super::clip::area;
use super::field::Field;
use super::force::RADIUS_FACTOR;
use super::grid::Grid;
use super::mosaic::{ConeType, Cones, Retina};
use super::params::RetinaParams;
use super::relax::Relaxed;
use super::table::{ImportError, LEAST_DISTANCE_UM, Table};
use super::tile::RegionUm;
use super::types::Kind;
use crate::rng::{Purpose, Stream};

/// Pairs closer than this share of their spacing are counted (D < 0.6, as in `cells`).
const CLOSE: f64 = 0.6 * RADIUS_FACTOR;
/// Side of the largest bin of a search, µm.
const LARGEST_BIN_UM: f64 = 25.0;
/// Distance of a corner of a cell from the cone, spacings, beyond which the cell is open: at the rim or
/// beside a gap. Corners of a hexagon are 0.58 away.
const OPEN: f64 = 0.95;
/// Nearest cones that give the spacing.
const NEAREST: usize = 6;

/// Cones in a table, each row checked as [`import`] does, but not their distances.
///
/// # Errors
/// As [`import`].
pub fn check_mosaic(
    csv: &str,
    params: &RetinaParams,
    type_unknown: Option<ConeType>,
) -> Result<usize, ImportError> {
    params.validate()?;
    Ok(Table::read(csv, &Field::new(params), type_unknown)?.at.len())
}

/// The retina of a table; its region is the smallest rectangle that holds the cones, with a spacing round it. `params` give seed, geometry,
/// aperture and pointing; cones that were not classified are of the type `type_unknown`.
///
/// # Errors
/// [`ImportError`] with the first thing wrong: its line, column and value, and what is allowed.
pub fn import(
    csv: &str,
    params: &RetinaParams,
    type_unknown: Option<ConeType>,
) -> Result<Retina, ImportError> {
    params.validate()?;
    let field = Field::new(params);
    let table = Table::read(csv, &field, type_unknown)?;
    let (relaxed, near) = as_relaxed(&field, &table)?;
    let mut cells = build_cells(&relaxed, 0.0);
    let inner = inner_areas(&relaxed, &cells, &near);
    mark_close(&relaxed, &mut cells.close);
    let mut cones = Cones::default();
    let (mut min, mut max, mut margin) = (DVec2::INFINITY, DVec2::NEG_INFINITY, 0.0_f64);
    for (i, (&at, &cone_type)) in relaxed.at.iter().zip(&table.cone_type).enumerate() {
        let id = relaxed.id[i];
        let (x, y) = Stream::new(params.seed, Purpose::Pointing, id, 0).normal_pair();
        let sd = params.pointing_sd_deg.to_radians();
        let kind = Kind { cone_type, pointing: [(x * sd) as f32, (y * sd) as f32] };
        let factor = relaxed.metric[i].area_factor();
        let cell = cells.polygon(i);
        let mut coverage = field.density.coverage_of(at, || field.local(at).cos_tilt / (area(cell) * factor));
        if let Some(apertures_um2) = &table.aperture_um2 {
            // A measured aperture is what it is.
            coverage = apertures_um2[i] / (area(cell) * factor);
        } else if let Some(inner_um2) = inner[i].um2 {
            coverage *= (inner_um2 / (area(cell) * factor)).min(1.0);
        }
        cones.push(id, at, kind, cell, factor, coverage);
        if let Some(edge) = cones.edge.last_mut() {
            *edge = inner[i].is_edge;
        }
        cones.counts.close_pairs += u64::from(cells.close[i]);
        cones.counts.voids += u64::from(cells.void[i]);
        cones.counts.concave += u64::from(cells.concave[i]);
        (min, max) = (min.min(at), max.max(at));
        margin = margin.max(relaxed.spacing[i]);
    }
    let region = RegionUm { min: min - margin, max: max + margin };
    Ok(Retina::gather(&[&cones], &region, params))
}

/// Distance and number of the nearest cones of a cone.
type Nearest = Vec<(f64, u32)>;

/// What is known of a cone by the cells inside.
#[derive(Clone, Copy)]
struct Inner {
    /// Whether its own cell is open: at the rim or beside a gap.
    is_edge: bool,
    /// Of such a cone, the median area of the cells of those of its nearest cones that are inside, µm²; where
    /// none is, the median of what they get; where they know none, `None`.
    um2: Option<f64>,
}

/// What the cells inside say of each cone.
fn inner_areas(cones: &Relaxed, cells: &Cells, near: &[Nearest]) -> Vec<Inner> {
    let n = near.len();
    let of_cell = |i: usize| area(cells.polygon(i)) * cones.metric[i].area_factor();
    let is_edge = |i: usize| {
        // A cone at a straight rim has four neighbours at their spacing; where there are fewer the cell
        // reaches its limit.
        let spacing = near[i].get(3).map_or(cones.spacing[i], |(distance, _)| *distance);
        let across = |corner: &DVec2| cones.metric[i].length2(*corner - cones.at[i]).sqrt();
        let far = |corner: &DVec2| across(corner) > OPEN * spacing;
        cells.void[i] || cells.polygon(i).iter().any(far)
    };
    let edge: Vec<bool> = (0..n).map(is_edge).collect();
    let mut known: Vec<Option<f64>> = (0..n).map(|i| (!edge[i]).then(|| of_cell(i))).collect();
    // Go outwards from the cones inside, a row a round.
    loop {
        let median = |i: usize| -> Option<f64> {
            let mut areas: Vec<f64> = near[i].iter().filter_map(|(_, j)| known[*j as usize]).collect();
            areas.sort_unstable_by(f64::total_cmp);
            areas.get((areas.len().max(1) - 1) / 2).copied()
        };
        let found: Vec<(usize, f64)> =
            (0..n).filter(|i| known[*i].is_none()).filter_map(|i| Some((i, median(i)?))).collect();
        if found.is_empty() {
            break;
        }
        for (i, area) in found {
            known[i] = Some(area);
        }
    }
    (0..n).map(|i| Inner { is_edge: edge[i], um2: known[i].filter(|_| edge[i]) }).collect()
}

/// The cones as the cell builder takes them, all of equal weight, with the measured spacing; and the nearest of each.
fn as_relaxed(field: &Field, table: &Table) -> Result<(Relaxed, Vec<Nearest>), ImportError> {
    let n = table.at.len();
    let mut cones = Relaxed::default();
    cones.at.extend(&table.at);
    cones.metric.extend(table.at.iter().map(|&at| field.local(at).metric));
    cones.id.extend(&table.id);
    cones.rows.resize(n, 0.0);
    cones.radius.resize(n, 0.0);
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for &at in &table.at {
        (low, high) = (low.min(at), high.max(at));
    }
    // Bins for some three cones, were they spread evenly, and never so large that a crowd falls into one.
    let size = (high - low).max(DVec2::splat(LEAST_DISTANCE_UM));
    let grid = Grid::new(&table.at, (3.0 * size.x * size.y / n as f64).sqrt().min(LARGEST_BIN_UM));
    let mut near = Vec::with_capacity(n);
    let mut mean = Vec::with_capacity(n);
    let mut reach = 2.0 * (size.x * size.y / n as f64).sqrt();
    for (i, &at) in table.at.iter().enumerate() {
        let nearest = nearest(&cones, &grid, i, &mut reach, size.length());
        for &(_, j) in &nearest {
            let distance_um = at.distance(table.at[j as usize]);
            if distance_um < LEAST_DISTANCE_UM {
                let (a, b) = (table.line[i], table.line[j as usize]);
                return Err(ImportError::TooClose { line: a.max(b), other: a.min(b), distance_um });
            }
        }
        let sum: f64 = nearest.iter().map(|&(d, _)| d).sum();
        // A cone alone gets the spacing of the density law.
        mean.push(if nearest.is_empty() { field.spacing(at) } else { sum / nearest.len() as f64 });
        near.push(nearest);
    }
    for (i, nearest) in near.iter().enumerate() {
        let mut around: Vec<f64> = nearest.iter().map(|&(_, j)| mean[j as usize]).collect();
        around.push(mean[i]);
        around.sort_unstable_by(f64::total_cmp);
        cones.spacing.push(around[around.len() / 2]);
    }
    Ok((cones, near))
}

/// (Distance across the cone, cone) of the six nearest, ascending; fewer when there are no more. `reach` is where the search starts and
/// becomes a good start for the next cone.
fn nearest(cones: &Relaxed, grid: &Grid, i: usize, reach: &mut f64, largest: f64) -> Vec<(f64, u32)> {
    let (at, metric) = (cones.at[i], cones.metric[i]);
    let shortest = metric.shortest();
    let mut found: Vec<(f64, u32)> = Vec::new();
    loop {
        found.clear();
        grid.near(at, *reach, |j| {
            if j as usize != i {
                found.push((metric.length2(cones.at[j as usize] - at).sqrt(), j));
            }
        });
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(NEAREST);
        let sure = found.len() == NEAREST && found[NEAREST - 1].0 <= *reach * shortest;
        if sure {
            *reach = 1.3 * found[NEAREST - 1].0 / shortest;
            return found;
        }
        if *reach > largest {
            return found;
        }
        *reach *= 2.0;
    }
}

/// Marks cones with a neighbour closer than D = 0.6.
fn mark_close(cones: &Relaxed, close: &mut [bool]) {
    let size = cones.spacing.iter().copied().fold(LEAST_DISTANCE_UM, f64::max);
    let grid = Grid::new(&cones.at, size.min(LARGEST_BIN_UM));
    for (i, (&at, metric)) in cones.at.iter().zip(&cones.metric).enumerate() {
        let least = CLOSE * cones.spacing[i];
        grid.near(at, least / metric.shortest(), |j| {
            close[i] |= j as usize != i && metric.length2(cones.at[j as usize] - at) < least * least;
        });
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::super::graph::tests::patch;
    use super::super::mosaic::ConeType;
    use super::*;

    fn table(retina: &Retina) -> String {
        let mut text = String::from("x_um,y_um,type\n");
        for i in 0..retina.len() {
            writeln!(text, "{},{},{:?}", retina.x_um[i], retina.y_um[i], retina.cone_type[i]).unwrap();
        }
        text
    }

    /// Out and in again: places and types are the same bits, the sums of areas agree to 1 %. Cells were a power diagram of unequal cones
    /// and become a plain one; a cone whose radius is δ off had a cell 0.55·δ off. In the fovea, where radii spread by 0.08, 94 % of
    /// the cells agree to 10 % (5 % rms); where they spread by 0.18, 57 % do (14 % rms).
    #[test]
    fn round_trip() {
        for (at, half, margin, allowed_rms, share) in
            [(DVec2::ZERO, 80.0, 12.0, 0.06, 0.93), (DVec2::new(3_000.0, -2_000.0), 250.0, 50.0, 0.15, 0.55)]
        {
            let made = patch(at, half);
            let read = import(&table(&made), &made.params, None).unwrap();
            assert_eq!(made.len(), read.len());
            let inner = RegionUm { min: at - (half - margin), max: at + (half - margin) };
            let (mut sums, mut squares, mut count, mut near) = ([0.0; 2], 0.0, 0.0, 0.0);
            for i in 0..read.len() {
                let row = read.id[i] as usize;
                assert_eq!((read.center(i), read.cone_type[i]), (made.center(row), made.cone_type[row]));
                if inner.contains(read.center(i)) {
                    let (a, b) = (f64::from(made.cell_area_um2[row]), f64::from(read.cell_area_um2[i]));
                    sums = [sums[0] + a, sums[1] + b];
                    squares += (b / a - 1.0).powi(2);
                    count += 1.0;
                    near += f64::from(u8::from((b / a - 1.0).abs() < 0.1));
                    let apertures = made.aperture_um2[row] / made.cell_area_um2[row];
                    assert!((read.aperture_um2[i] / read.cell_area_um2[i] - apertures).abs() < 1e-6);
                }
            }
            let rms = f64::sqrt(squares / count);
            assert!(rms < allowed_rms && near > share * count, "{at} {rms} {}", near / count);
            assert!((sums[1] / sums[0] - 1.0).abs() < 0.01, "{at} {sums:?}");
        }
    }

    /// Lattices of any density get hexagonal cells in the middle and limited ones at the rim.
    #[test]
    fn spacing_is_measured() {
        for spacing in [1.5, 4.0, 40.0] {
            let mut text = String::from("type,y_um,x_um\n");
            for k in 0..81 {
                let (a, b) = (f64::from(k % 9 - 4), f64::from(k / 9 - 4));
                let (x, y) = (spacing * (a + 0.5 * (b.abs() % 2.0)), spacing * 0.75_f64.sqrt() * b);
                writeln!(text, "L,{y},{x}").unwrap();
            }
            let retina = import(&text, &RetinaParams::default(), None).unwrap();
            let hexagon = 0.75_f64.sqrt() * spacing * spacing;
            for i in 0..retina.len() {
                let area = f64::from(retina.cell_area_um2[i]) / hexagon;
                let inside = retina.center(i).abs().max_element() < 2.6 * spacing;
                // A cell with no neighbour at all is a 12-gon of 1.25 spacings: 5.4 hexagons.
                assert!(if inside { (area - 1.0).abs() < 5e-3 } else { area < 5.4 }, "{spacing} {area}");
                // Apertures at the rim are those of the inside, where the whole cell collects light.
                let aperture = f64::from(retina.aperture_um2[i]) / hexagon;
                assert!(aperture < 1.01 && (spacing > 10.0 || aperture > 0.99), "{spacing} {aperture}");
            }
        }
        let one = import("x_um,y_um,type\n5,5,S", &RetinaParams::default(), None).unwrap();
        assert_eq!((one.len(), one.polygon(0).len(), one.cone_type[0]), (1, 12, ConeType::S));
    }
}
