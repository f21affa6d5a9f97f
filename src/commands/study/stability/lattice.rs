//! The stiff iteration of the retina (§15.1): a hexagonal lattice under simultaneous steps of the force between cones.
//!
//! Small displacements u of a lattice with spacing d·(r + r) grow or die as u' = (1 − K3·M) u. With radii 1, f = spline(D) and its slope
//! s = −f'/2, M(q) = Σ over neighbours (1 − cos q·x)·[s n nᵀ − f/|x| (1 − n nᵀ)]. The growth factor of a mode is |1 − K3·µ| with µ an
//! eigenvalue of M, the limit of K3 is 2/µmax, and µmax/µmin is the condition number: how many sub-cycles the softest mode needs. A negative µ
//! is a mode that buckles: the lattice is over-compressed.

use std::f64::consts::TAU;

use glam::DVec2;
use photoneye_eye::retina::{
    K3, K3_LIMIT, LEAST_DISTANCE_UM, RegionUm, RetinaParams, build_region, import, spline,
};

use super::super::page::{Page, Table};
use super::{Cases, Found};
use crate::chart::{Axis, Band, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::row;

const GROUP: &str = "retina";
/// Cones along a side of the periodic lattice.
const SIDE: i32 = 12;
/// Steps of the lattice.
const STEPS: usize = 300;
/// Spacing of the lattice in sums of radii.
const SPACING: f64 = 0.95;
const NEAR: [(i32, i32); 6] = [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)];

/// Adds the cases.
pub fn cases(cases: &mut Cases) {
    for k3 in [0.05, 0.15, K3, 0.205] {
        cases.add(GROUP, &format!("K3 {k3}, below the limit {K3_LIMIT}: the lattice comes to rest"), || {
            Ok(Found::new("growth factor a step", growth(k3), 1.0))
        });
    }
    for k3 in [0.215, 0.25, 0.4] {
        cases.add(GROUP, &format!("K3 {k3}, above the limit: it must not come to rest"), || {
            Ok(Found::new("1 / growth factor a step", 1.0 / growth(k3), 1.0))
        });
    }
    cases.add(GROUP, "stated limit against 2/µmax at D = 1", || {
        Ok(Found::new("relative difference", (K3_LIMIT / (2.0 / modes(0.999_999).1) - 1.0).abs(), 0.01))
    });
    cases.add(GROUP, "K3 in use leaves a margin", || Ok(Found::new("K3 / limit", K3 / K3_LIMIT, 0.95)));
    cases.add(GROUP, "two cones in one place are refused", || {
        let table = "x_um,y_um,type\n0,0,L\n0,0,M\n3,0,L\n";
        let why = import(table, &RetinaParams::default(), None)
            .err()
            .map(|e| e.to_string())
            .ok_or("it was accepted")?;
        Ok(Found::new(why.clone(), if why.contains("line") { 0.0 } else { 1.0 }, 0.0))
    });
    cases.add(GROUP, "two cones at the least distance and a third far away", || {
        let table = format!("x_um,y_um,type\n0,0,L\n{},0,M\n300,0,L\n", 1.01 * LEAST_DISTANCE_UM);
        let retina = import(&table, &RetinaParams::default(), None).map_err(|e| e.to_string())?;
        let wrong = retina.cones.aperture_um2.iter().filter(|a| !(a.is_finite() && **a >= 0.0)).count();
        Ok(Found::new("apertures that are no numbers", wrong as f64, 0.0))
    });
    if !cases.is_quick() {
        cases.add(GROUP, "300,000 cones as one region", || {
            let region = RegionUm { min: DVec2::splat(-2340.0), max: DVec2::splat(2340.0) };
            let cones = build_region(&RetinaParams::default(), &region).map_err(|e| e.to_string())?.len();
            Ok(Found::new("|cones / 300,000 - 1|", (cones as f64 / 3e5 - 1.0).abs(), 0.05))
        });
    }
    cases.add(GROUP, "a measured mosaic of one cone", || {
        let retina =
            import("x_um,y_um,type\n5,5,L\n", &RetinaParams::default(), None).map_err(|e| e.to_string())?;
        let area = f64::from(retina.cones.aperture_um2.first().copied().unwrap_or(f32::NAN));
        Ok(Found::new("|cones - 1|, aperture a number", (retina.len() as f64 - 1.0).abs() + 0.0 * area, 0.0))
    });
}

/// Adds the growth factors and the stiffness of the lattice.
pub fn figures(page: &mut Page) {
    page.heading("The stiff iteration of the retina");
    page.text(
        "Growth factor a step of small displacements in a periodic lattice of 144 cones, compressed to D = 0.95, measured and by the \
         largest eigenvalue; and how stiffness and condition depend on compression.",
    );
    let (smallest, largest) = modes(SPACING);
    let values: Vec<f64> = (2..=60).map(|k| 0.005 * f64::from(k)).collect();
    let measured: Vec<(f64, f64)> = values.iter().map(|k3| (*k3, growth(*k3))).collect();
    let soft = values.iter().map(|k3| (*k3, (1.0 - k3 * smallest).abs())).collect();
    let theory = values.iter().map(|k3| (*k3, (1.0 - k3 * largest).abs())).collect();
    let mut growth = Table::new("growth", "Growth factor", &["K3", "measured", "stiffest_mode"]).long();
    for (k3, factor) in &measured {
        growth.push(row![*k3, *factor, (1.0 - k3 * largest).abs()]);
    }
    let chart = Chart {
        title: format!("Lattice of cones, D = {SPACING}"),
        x: Axis::linear("strength of the repulsion K3, cone radii"),
        y: Axis { range: Some((0.0, 1.5)), ..Axis::linear("growth factor a step") },
        series: vec![
            Series::new("measured", measured, Style::Points, PALETTE[0]),
            Series::new("stiffest mode |1 - K3·µ|", theory, Style::Line, PALETTE[1]),
            Series::new("softest mode", soft, Style::Line, PALETTE[4]),
            Series::new(&format!("K3 in use, {K3}"), vec![(K3, 0.0), (K3, 1.5)], Style::Dashed, PALETTE[2]),
            Series::new(
                &format!("limit at D = 1, {K3_LIMIT}"),
                vec![(K3_LIMIT, 0.0), (K3_LIMIT, 1.5)],
                Style::Dashed,
                DARK,
            ),
        ],
        bands: vec![Band::new("", 1.0, 1.0, DARK)],
    };
    let caption = "Below 1 the lattice comes to rest, above 1 it never does. What is measured is the slowest mode: the softest below the limit, the stiffest above it.";
    page.picture("growth", caption, chart_page("", &[chart], 1));
    page.table(growth);
    let mut table = Table::new(
        "condition",
        "Stiffness of the lattice against compression (µ per K3; negative: a mode buckles; no limit when all do)",
        &["D", "µ_max", "limit of K3 = 2/µ_max", "µ_min", "condition µ_max/|µ_min|"],
    );
    for d in [0.70, 0.76, 0.80, 0.85, 0.90, 0.95, 0.98, 0.999] {
        let (least, most) = modes(d);
        // Where even the stiffest mode buckles, no step is small enough.
        let stiff = if most > 0.0 { most } else { f64::NAN };
        table.push(row![d, most, 2.0 / stiff, least, stiff / least.abs()]);
    }
    page.table(table);
}

/// Place of a lattice point in radii.
fn home(a: i32, b: i32, spacing: f64) -> DVec2 {
    DVec2::new(f64::from(a) + 0.5 * f64::from(b), f64::from(b) * 0.75_f64.sqrt()) * (2.0 * spacing)
}

/// Measured growth of small displacements per step, from the last half of the steps.
fn growth(k3: f64) -> f64 {
    let at = |a: i32, b: i32| (a.rem_euclid(SIDE) * SIDE + b.rem_euclid(SIDE)) as usize;
    let mut off: Vec<DVec2> = (0..SIDE * SIDE)
        .map(|i| DVec2::new(f64::from((i * 7919) % 13) - 6.0, f64::from((i * 104_729) % 11) - 5.0) * 1e-7)
        .collect();
    let mean = off.iter().sum::<DVec2>() / off.len() as f64;
    for o in &mut off {
        *o -= mean;
    }
    let mut logarithm = 0.0;
    for step in 0..STEPS {
        let old = off.clone();
        for a in 0..SIDE {
            for b in 0..SIDE {
                let force: DVec2 = NEAR
                    .iter()
                    .map(|(da, db)| {
                        let d = home(*da, *db, SPACING) + old[at(a + da, b + db)] - old[at(a, b)];
                        d * (spline(d.length() / 2.0) / d.length())
                    })
                    .sum();
                off[at(a, b)] -= k3 * force;
            }
        }
        // Kept small, so that the force stays linear.
        let size = |all: &[DVec2]| all.iter().map(|o| o.length_squared()).sum::<f64>().sqrt();
        let factor = size(&off) / size(&old);
        for o in &mut off {
            *o /= factor;
        }
        if step >= STEPS / 2 {
            logarithm += factor.ln();
        }
    }
    (logarithm / (STEPS - STEPS / 2) as f64).exp()
}

/// Least and largest eigenvalue of M over the modes of the periodic lattice but the uniform shift.
fn modes(spacing: f64) -> (f64, f64) {
    const STEP: f64 = 1e-7;
    let force = spline(spacing);
    let stiffness = (spline(spacing - STEP) - spline(spacing + STEP)) / (2.0 * STEP) / 2.0;
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for (a, b) in (0..SIDE).flat_map(|a| (0..SIDE).map(move |b| (a, b))).skip(1) {
        // Sum of the symmetric matrix [[xx, xy], [xy, yy]].
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (da, db) in NEAR {
            let n = home(da, db, spacing) / (2.0 * spacing);
            let phase = TAU * (f64::from(a * da) + f64::from(b * db)) / f64::from(SIDE);
            let (along, across) =
                ((1.0 - phase.cos()) * stiffness, (1.0 - phase.cos()) * force / (2.0 * spacing));
            xx += along * n.x * n.x - across * n.y * n.y;
            yy += along * n.y * n.y - across * n.x * n.x;
            xy += (along + across) * n.x * n.y;
        }
        let (mean, spread) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        (least, most) = (least.min(mean - spread), most.max(mean + spread));
    }
    (least, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without compression and with springs of stiffness s alone: at the corner of the zone 1 − cos is 3/2 for all six neighbours, and half
    /// of Σ n nᵀ = 3 is 1.5·3·s; at the edge's middle four neighbours have 2: n nᵀ sums give 6 s. The largest is 6 s.
    #[test]
    fn stiffest_mode_of_a_free_lattice() {
        let (_, most) = modes(1.0 - 1e-6);
        assert!((most / (6.0 * 1.6) - 1.0).abs() < 1e-3, "{most}");
        assert!((2.0 / most - K3_LIMIT).abs() < 0.002);
    }

    #[test]
    fn measured_growth_is_that_of_the_stiffest_mode() {
        let largest = modes(SPACING).1;
        for k3 in [0.23, 0.26, 0.3] {
            assert!((growth(k3) - (k3 * largest - 1.0)).abs() < 2e-3, "{k3}: {}", growth(k3));
        }
    }
}
