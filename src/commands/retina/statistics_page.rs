//! One page of charts that compares a mosaic with its targets and with living mosaics.
//!
//! Living mosaics (adaptive-optics patches of two eyes, see `eye/tests/retina_living.rs`): share of cones with six neighbours
//! 0.48 to 0.66 beyond 1° and 0.70 in the foveola; nearest neighbour over the median of the six nearest 0.80, standard
//! deviation 0.09; |psi6| 0.52 to 0.55. The paper (§15.4) has 6.25 cones within D <= 1.5 on average.

use photoneye_eye::picture::RgbImage;
use photoneye_eye::retina::{Band as Ring, SECTORS, Sector};

use crate::chart::{Axis, BAND, Band, Chart, DARK, LIVING, PALETTE, Series, Style, page};

/// x: visual degrees; y: the quantity.
pub type Curve = Vec<(f64, f64)>;

/// Charts on a row of the page.
const COLUMNS: usize = 3;
/// Inside this many degrees a mosaic is compared with living foveolas, outside the other one with those of the periphery.
const FOVEOLA_DEG: f64 = 0.5;
const PERIPHERY_DEG: f64 = 1.0;
/// Mean of the cones within D <= 1.5.
const PAPER_WITHIN: f64 = 6.25;

/// Density along one meridian.
#[derive(Clone, Debug, Default)]
pub struct MeridianColumns {
    /// Such as `nasal`.
    pub name: String,
    /// Cones per mm².
    pub density: Curve,
    /// What the target asks for, cones per mm².
    pub target: Curve,
}

/// What the page shows. Columns are curves over eccentricity in visual degrees; an empty one leaves its chart without it.
#[derive(Clone, Debug, Default)]
pub struct StatisticsColumns {
    /// Title of the page.
    pub title: String,
    /// Density by meridian.
    pub meridians: Vec<MeridianColumns>,
    /// Density over target.
    pub density_ratio: Curve,
    /// Share of cones with six neighbours.
    pub six_share: Curve,
    /// Nearest neighbour over the median of the six nearest: mean.
    pub nearest_mean: Curve,
    /// Its standard deviation, in the order of `nearest_mean`.
    pub nearest_sd: Vec<f64>,
    /// Mean |psi6|.
    pub psi6: Curve,
    /// Mean number of cones with D <= 1.5.
    pub within_1_5: Curve,
    /// Share of S cones.
    pub s_share: Curve,
    /// Share of S cones that the target asks for.
    pub s_target: Curve,
    /// Nyquist limit of the mosaic, cycles per visual degree.
    pub nyquist: Curve,
    /// Aperture over cell area.
    pub coverage: Curve,
    /// Distance from an S cone to the nearest other one, in units of 1/sqrt(S density).
    pub s_nearest: Curve,
    /// Cells at the size limit, share of cones.
    pub open_cells: Curve,
}

impl StatisticsColumns {
    /// What rings of eccentricity give.
    pub fn from_rings(title: &str, rings: &[Ring]) -> Self {
        let curve = |value: &dyn Fn(&Ring) -> f64| -> Curve {
            rings.iter().map(|ring| (middle_deg(ring.from_deg, ring.to_deg), value(ring))).collect()
        };
        // What needs neighbours is unknown when no cone of the ring has all of them.
        let inner =
            |value: fn(&Ring) -> f64| curve(&|ring| if ring.interior > 0 { value(ring) } else { f64::NAN });
        Self {
            title: title.into(),
            density_ratio: curve(&Ring::density_ratio),
            six_share: inner(|ring| ring.six_share),
            nearest_mean: inner(|ring| ring.nearest_mean),
            nearest_sd: rings.iter().map(|ring| ring.nearest_sd).collect(),
            psi6: inner(|ring| ring.psi6),
            within_1_5: inner(|ring| ring.within_1_5),
            s_share: curve(&Ring::s_share),
            s_target: curve(&|ring| ring.target_s / ring.target_cones),
            coverage: curve(&|ring| ring.coverage),
            nyquist: curve(&Ring::nyquist_cpd),
            s_nearest: curve(&|ring| if ring.s_interior > 0 { ring.s_nearest } else { f64::NAN }),
            open_cells: inner(|ring| ring.open as f64 / (ring.open + ring.interior) as f64),
            meridians: (0..SECTORS.len()).map(|sector| meridian(rings, sector)).collect(),
        }
    }
}

/// Density and target of one sector, cones per mm².
fn meridian(rings: &[Ring], sector: usize) -> MeridianColumns {
    let known = || rings.iter().filter(|ring| ring.sectors[sector].area_mm2 > 0.0);
    let curve = |value: fn(&Sector) -> f64| -> Curve {
        known()
            .map(|ring| (middle_deg(ring.from_deg, ring.to_deg), &ring.sectors[sector]))
            .map(|(deg, s)| (deg, value(s) / s.area_mm2))
            .collect()
    };
    MeridianColumns {
        name: SECTORS[sector].into(),
        density: curve(|s| s.cones as f64),
        target: curve(|s| s.target_cones),
    }
}

/// Where a ring stands on a logarithmic axis: the geometric mean of its edges, and half of its edge for the innermost.
pub fn middle_deg(from_deg: f64, to_deg: f64) -> f64 {
    if from_deg > 0.0 { (from_deg * to_deg).sqrt() } else { 0.5 * to_deg }
}

/// Draws the page.
pub fn statistics_page(columns: &StatisticsColumns) -> RgbImage {
    let mut charts = vec![
        density(columns),
        density_ratio(columns),
        nyquist(columns),
        six_share(columns),
        nearest(columns),
        psi6(columns),
        within(columns),
        s_share(columns),
        coverage(columns),
    ];
    let spacing = one("S cones: distance to the nearest S cone", "1/sqrt(S density)", &columns.s_nearest);
    let open = with_room(one("cells at the size limit", "share of cones", &columns.open_cells), 0.0, 1e-3);
    charts.extend([spacing, open].into_iter().filter(|chart| !chart.series[0].points.is_empty()));
    share_x(&mut charts);
    page(&columns.title, &charts, COLUMNS)
}

/// All charts show the same eccentricities.
fn share_x(charts: &mut [Chart]) {
    let all = charts.iter().flat_map(|chart| chart.series.iter().flat_map(|s| s.points.iter()));
    let shown = all.filter(|p| p.0.is_finite() && p.0 > 0.0 && p.1.is_finite());
    let (low, high) = shown.fold((f64::MAX, 0.0_f64), |(low, high), p| (low.min(p.0), high.max(p.0)));
    if low < high {
        for chart in charts {
            chart.x.range = Some((0.9 * low, 1.1 * high));
        }
    }
}

fn eccentricity() -> Axis {
    Axis::log("eccentricity, visual degrees")
}

/// A chart over eccentricity with a linear axis.
fn chart(title: &str, y: &str, series: Vec<Series>, bands: Vec<Band>) -> Chart {
    Chart { title: title.into(), x: eccentricity(), y: Axis::linear(y), series, bands }
}

/// A chart of one curve.
fn one(title: &str, y: &str, curve: &Curve) -> Chart {
    chart(title, y, vec![Series::new("", curve.clone(), Style::Both, PALETTE[0])], Vec::new())
}

fn density(columns: &StatisticsColumns) -> Chart {
    let mut series = Vec::new();
    let coloured = || columns.meridians.iter().zip(PALETTE.iter().cycle());
    for (meridian, colour) in coloured() {
        series.push(Series::new("", meridian.target.clone(), Style::Dashed, *colour));
    }
    for (meridian, colour) in coloured() {
        series.push(Series::new(&meridian.name, meridian.density.clone(), Style::Points, *colour));
    }
    series.push(Series::new("target", Vec::new(), Style::Dashed, DARK));
    let mut chart = chart("density", "cones per mm²", series, Vec::new());
    chart.y.log = true;
    chart
}

fn density_ratio(columns: &StatisticsColumns) -> Chart {
    let series = vec![Series::new("", columns.density_ratio.clone(), Style::Both, PALETTE[0])];
    let bands = vec![Band::new("±2 %", 0.98, 1.02, BAND), Band::new("", 1.0, 1.0, DARK)];
    with_room(chart("density over target", "ratio", series, bands), 0.95, 1.05)
}

fn nyquist(columns: &StatisticsColumns) -> Chart {
    let mut chart = one("Nyquist limit of the mosaic", "cycles per visual degree", &columns.nyquist);
    chart.y.log = true;
    chart
}

fn six_share(columns: &StatisticsColumns) -> Chart {
    let series = vec![Series::new("mosaic", columns.six_share.clone(), Style::Both, PALETTE[0])];
    let bands = vec![
        Band::new("living, beyond 1°", 0.48, 0.66, LIVING).over(PERIPHERY_DEG, f64::INFINITY),
        Band::new("living foveola", 0.70, 0.70, PALETTE[1]).over(0.0, FOVEOLA_DEG),
    ];
    with_room(chart("cones with six neighbours", "share of cones", series, bands), 0.4, 0.9)
}

fn nearest(columns: &StatisticsColumns) -> Chart {
    let mut series = Series::new("mosaic, mean ± sd", columns.nearest_mean.clone(), Style::Both, PALETTE[0]);
    series.error.clone_from(&columns.nearest_sd);
    let bands = vec![
        Band::new("living, ± sd", 0.80 - 0.09, 0.80 + 0.09, LIVING),
        Band::new("living, mean", 0.80, 0.80, PALETTE[1]),
    ];
    with_room(chart("nearest neighbour", "distance / median of six nearest", vec![series], bands), 0.6, 1.0)
}

fn psi6(columns: &StatisticsColumns) -> Chart {
    let series = vec![Series::new("mosaic", columns.psi6.clone(), Style::Both, PALETTE[0])];
    let bands = vec![Band::new("living", 0.52, 0.55, LIVING)];
    with_room(chart("six-fold order", "mean |psi6|", series, bands), 0.4, 0.8)
}

fn within(columns: &StatisticsColumns) -> Chart {
    let series = vec![Series::new("mosaic", columns.within_1_5.clone(), Style::Both, PALETTE[0])];
    let bands = vec![Band::new("paper, 6.25", PAPER_WITHIN, PAPER_WITHIN, PALETTE[1])];
    with_room(chart("cones with D <= 1.5", "mean number", series, bands), 6.0, 6.5)
}

fn s_share(columns: &StatisticsColumns) -> Chart {
    let series = vec![
        Series::new("target", columns.s_target.clone(), Style::Dashed, DARK),
        Series::new("mosaic", columns.s_share.clone(), Style::Both, PALETTE[0]),
    ];
    with_room(chart("S cones", "share of cones", series, Vec::new()), 0.0, 0.1)
}

fn coverage(columns: &StatisticsColumns) -> Chart {
    with_room(one("light-collecting aperture", "share of cell area", &columns.coverage), 0.0, 1.0)
}

/// The vertical axis shows at least these values.
fn with_room(mut chart: Chart, low: f64, high: f64) -> Chart {
    chart.y.least = Some((low, high));
    chart
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_follow_the_rings() {
        let ring = Ring {
            from_deg: 1.0,
            to_deg: 4.0,
            cones: 90,
            target_cones: 100.0,
            target_s: 8.0,
            types: [60, 21, 9],
            ..Ring::default()
        };
        let columns = StatisticsColumns::from_rings("", &[ring, Ring { interior: 5, psi6: 0.5, ..ring }]);
        assert!(
            (columns.density_ratio[0].0 - 2.0).abs() < 1e-12
                && (columns.density_ratio[0].1 - 0.9).abs() < 1e-12
        );
        assert!((columns.s_share[0].1 - 0.1).abs() < 1e-12 && (columns.s_target[0].1 - 0.08).abs() < 1e-12);
        assert!(columns.psi6[0].1.is_nan() && (columns.psi6[1].1 - 0.5).abs() < 1e-12);
        assert!((middle_deg(0.0, 0.125) - 0.0625).abs() < 1e-12);
    }

    #[test]
    fn extra_charts_come_with_their_columns() {
        let page = |columns: &StatisticsColumns| statistics_page(columns).height;
        let none = StatisticsColumns::default();
        let more =
            StatisticsColumns { open_cells: vec![(1.0, 0.001), (2.0, 0.0)], ..StatisticsColumns::default() };
        assert_eq!(page(&more) - page(&none), 400);
    }
}
