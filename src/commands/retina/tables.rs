//! Tables of the `retina` command: cones, and statistics as text and JSON.

use std::ops::RangeInclusive;

use photoneye_eye::optics::Side;
use photoneye_eye::retina::{Band, Cones, Counts, SECTORS, Statistics, VisualMap};
use photoneye_store::table::ConeColumns;
use serde_json::{Map, Value, json};

/// The cones between two eccentricities, with their visual angles by the traced eye at rest.
pub fn columns(cones: &Cones, visual: &VisualMap, side: Side, ecc_deg: RangeInclusive<f64>) -> ConeColumns {
    // The image is upside down, and mirrored: nasal retina sees the temporal field.
    let x_sign = match side {
        Side::Right => 1.0,
        Side::Left => -1.0,
    };
    let mut table = ConeColumns { polygon_start: vec![0], ..ConeColumns::default() };
    for cone in 0..cones.len() {
        let at = cones.center(cone);
        let seen = visual.visual_deg(at);
        if !ecc_deg.contains(&seen.length()) {
            continue;
        }
        table.id.push(cones.id[cone]);
        table.x_um.push(at.x);
        table.y_um.push(at.y);
        table.x_deg.push(x_sign * seen.x);
        table.y_deg.push(-seen.y);
        table.ecc_deg.push(seen.length());
        table.meridian_deg.push(at.y.atan2(at.x).to_degrees().rem_euclid(360.0));
        table.kind.push(cones.cone_type[cone] as u8);
        table.aperture_um2.push(cones.aperture_um2[cone]);
        table.edge.push(cones.edge[cone]);
        for corner in cones.polygon(cone) {
            table.polygon.extend([corner.x as f32, corner.y as f32]);
        }
        table.polygon_start.push(table.polygon.len() as u32);
    }
    table
}

/// Statistics as JSON.
pub fn json(statistics: &Statistics) -> Value {
    let events: Map<String, Value> = Counts::NAMES
        .iter()
        .zip(statistics.counts.to_array())
        .map(|(name, count)| (name.replace(' ', "_"), json!(count)))
        .collect();
    json!({
        "all": band(&statistics.all),
        "bands": statistics.bands.iter().map(band).collect::<Vec<_>>(),
        "events": events,
    })
}

fn band(band: &Band) -> Value {
    let sectors: Map<String, Value> = SECTORS
        .iter()
        .zip(&band.sectors)
        .map(|(name, s)| {
            let value = json!({"cones": s.cones, "target_cones": s.target_cones, "area_mm2": s.area_mm2});
            ((*name).to_owned(), value)
        })
        .collect();
    json!({
        "from_deg": band.from_deg,
        "to_deg": band.to_deg,
        "cones": band.cones,
        "target_cones": band.target_cones,
        "density_ratio": band.density_ratio(),
        "meridians": sectors,
        "area_deg2": band.area_deg2,
        "nyquist_cycles_per_deg": band.nyquist_cpd(),
        "types": band.types,
        "s_share": band.s_share(),
        "target_s_share": band.target_s_share(),
        "s_nearest": band.s_nearest,
        "cones_looked_at": band.interior + band.open,
        "open_cells": band.open,
        "six_share": band.six_share,
        "within_1_5": band.within_1_5,
        "nearest_mean": band.nearest_mean,
        "nearest_sd": band.nearest_sd,
        "psi6": band.psi6,
        "coverage": band.coverage,
    })
}

/// Statistics as lines of text.
pub fn lines(statistics: &Statistics) -> Vec<String> {
    let mut lines = vec![
        "visual degrees     cones  density/target  S share (target)  six neighbours  D<=1.5  nearest/spacing  |psi6|  Nyquist c/deg"
            .to_owned(),
    ];
    for band in &statistics.bands {
        lines.push(format!(
            "{:>6.3}-{:<7.3} {:>8}  {:>14.4}  {:>7.4} ({:.4})  {:>14.3}  {:>6.2}  {:>6.3} ± {:.3}   {:>6.3}  {:>13.1}",
            band.from_deg,
            band.to_deg,
            band.cones,
            band.density_ratio(),
            band.s_share(),
            band.target_s_share(),
            band.six_share,
            band.within_1_5,
            band.nearest_mean,
            band.nearest_sd,
            band.psi6,
            band.nyquist_cpd(),
        ));
    }
    lines.push(format!("all: density/target {:.4}", statistics.all.density_ratio()));
    let events = Counts::NAMES.iter().zip(statistics.counts.to_array());
    let events: Vec<String> = events.map(|(name, count)| format!("{count} {name}")).collect();
    lines.push(format!("events in the tiles: {}", events.join(", ")));
    lines
}
