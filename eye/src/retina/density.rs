//! Cone density, inner-segment coverage and S share as functions of place (§13).
//!
//! Density. Curcio et al. 1990 along four retinal meridians (nasal, superior, temporal, inferior), indexed by RETINAL degrees.
//! Along a meridian: monotone cubic (Fritsch and Carlson 1980) in (retinal degrees, ln density), ends one-sided; past the
//! last datum of a meridian linear in density to `ora_density_per_mm2` at the ora. Between meridians: ln density is mixed with weights
//! cos²φ and sin²φ of the two meridians beside the point, which is smooth round the circle. The peak is a parameter: the
//! table is multiplied by 1 + (peak/196,890 - 1)·exp(-θ²), θ in retinal degrees, because eyes differ in the foveola
//! (standard deviation 46 % at the centre, 38 % at 0.5°, 20 % at 1°, about 12 % from 1.5° on). Last, the factor (11.402/12)² = 0.903 keeps cones
//! per retinal degree on a 12 mm sphere those of the source's 11.402 mm sphere. Unit: cones per mm² of retinal surface.
//!
//! Coverage. Share of the cell that an inner segment fills: diameters read from the micrographs of Curcio et al. 1990 (π/4·d²·density,
//! table below), 1 where there are no rods, monotone cubic in eccentricity.
//!
//! # As printed
//! Equation (1) gives 2.24e6 cones/mm² at 1°: θ there is in µm at 300 µm per degree. It is not used.
//!
//! # Cost
//! `Density::new` reads the table; `per_mm2` is two cubics and two exponentials.

use glam::DVec2;

use super::params::RetinaParams;
use crate::catalog;

/// Radius of the sphere that Curcio's table is scaled to, µm.
const CURCIO_RADIUS_UM: f64 = 11_402.0;
/// Table value at the foveal centre, cones/mm².
const CURCIO_PEAK: f64 = 196_890.0;
/// (eccentricity µm on the 11.402 mm sphere, share of the cell area inside the inner segment).
const COVERAGE: [(f64, f64); 7] = [
    (0.0, 1.0),
    (100.0, 1.0),
    (660.0, 0.802),
    (1_350.0, 0.621),
    (5_000.0, 0.312),
    (8_000.0, 0.268),
    (16_000.0, 0.204),
];
/// No S cones inside this eccentricity, and their full share from the second on, visual degrees (§13).
const S_RAMP_DEG: [f64; 2] = [0.175, 1.5];

/// A monotone cubic through points with ascending abscissae; constant outside.
#[derive(Clone, Debug, Default)]
pub(super) struct Cubic {
    x: Vec<f64>,
    y: Vec<f64>,
    slope: Vec<f64>,
}

impl Cubic {
    /// Through the given points (Fritsch-Carlson slopes: weighted harmonic mean, zero at an extremum).
    pub(super) fn new(points: &[(f64, f64)]) -> Self {
        let (x, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        let n = x.len();
        let secant: Vec<f64> = (1..n).map(|i| (y[i] - y[i - 1]) / (x[i] - x[i - 1])).collect();
        let slope = (0..n)
            .map(|i| {
                if i == 0 || i + 1 == n {
                    return secant.get(i.min(n.saturating_sub(2))).copied().unwrap_or(0.0);
                }
                let (a, b) = (secant[i - 1], secant[i]);
                if a * b <= 0.0 {
                    return 0.0;
                }
                let (h, g) = (x[i] - x[i - 1], x[i + 1] - x[i]);
                3.0 * (h + g) / ((2.0 * g + h) / a + (g + 2.0 * h) / b)
            })
            .collect();
        Self { x, y, slope }
    }

    /// The value at `x`.
    pub(super) fn at(&self, x: f64) -> f64 {
        let (Some(&first), Some(&last)) = (self.y.first(), self.y.last()) else {
            return 0.0;
        };
        let i = self.x.partition_point(|&k| k <= x);
        if i == 0 {
            return first;
        }
        if i == self.x.len() {
            return last;
        }
        let h = self.x[i] - self.x[i - 1];
        let t = (x - self.x[i - 1]) / h;
        let (a, b) = (self.y[i - 1], self.y[i]);
        let (p, q) = (self.slope[i - 1] * h, self.slope[i] * h);
        let c = 3.0 * (b - a) - 2.0 * p - q;
        let d = 2.0 * (a - b) + p + q;
        a + t * (p + t * (c + t * d))
    }

    fn end(&self) -> f64 {
        self.x.last().copied().unwrap_or(0.0)
    }
}

/// The density of one set of parameters.
#[derive(Clone, Debug)]
pub struct Density {
    /// ln(cones/mm²) over retinal degrees: nasal, superior, temporal, inferior.
    meridian: [Cubic; 4],
    coverage: Cubic,
    peak_excess: f64,
    scale: f64,
    deg_per_um: f64,
    ora_deg: f64,
    ora_end: f64,
    visual_deg_per_um: f64,
    s_share: f64,
}

impl Density {
    /// Reads the embedded table `cone-density-curcio`.
    pub fn new(p: &RetinaParams) -> Self {
        let text = catalog::text("spectra", "cone-density-curcio").unwrap_or_default();
        let g = &p.geometry;
        Self {
            meridian: [1, 2, 3, 4].map(|column| Cubic::new(&column_of(text, column))),
            coverage: Cubic::new(&COVERAGE),
            peak_excess: p.peak_density_per_mm2 / CURCIO_PEAK - 1.0,
            scale: (CURCIO_RADIUS_UM / g.radius_um).powi(2),
            deg_per_um: (1.0 / g.radius_um).to_degrees(),
            ora_deg: g.ora_retinal_deg,
            ora_end: g.ora_density_per_mm2,
            visual_deg_per_um: g.visual_deg_per_um,
            s_share: p.cone_ratio[2],
        }
    }

    /// ln density along one meridian, on Curcio's scale.
    fn along(&self, meridian: usize, deg: f64) -> f64 {
        let curve = &self.meridian[meridian];
        let end = curve.end();
        if deg <= end {
            return curve.at(deg);
        }
        let last = curve.at(end).exp();
        let t = ((deg - end) / (self.ora_deg - end).max(1.0)).min(1.0);
        (last + t * (self.ora_end - last)).ln()
    }

    /// Target density at a point of the chart, cones per mm² of retina.
    pub fn per_mm2(&self, at_um: DVec2) -> f64 {
        let rho2 = at_um.length_squared();
        let deg = rho2.sqrt() * self.deg_per_um;
        let horizontal = self.along(if at_um.x < 0.0 { 2 } else { 0 }, deg);
        let vertical = self.along(if at_um.y < 0.0 { 3 } else { 1 }, deg);
        let cos2 = if rho2 > 0.0 { at_um.x * at_um.x / rho2 } else { 1.0 };
        let table = (cos2 * horizontal + (1.0 - cos2) * vertical).exp();
        self.scale * table * (1.0 + self.peak_excess * (-deg * deg).exp())
    }

    /// Share of its cell that a cone's light-collecting aperture fills, 0 to 1.
    pub fn coverage(&self, at_um: DVec2) -> f64 {
        let arc_on_source = at_um.length() * self.deg_per_um.to_radians() * CURCIO_RADIUS_UM;
        self.coverage.at(arc_on_source).min(1.0)
    }

    /// Share of S cones: 0 inside 0.175 visual degrees, linear to the full share at 1.5.
    pub fn s_share(&self, at_um: DVec2) -> f64 {
        let deg = at_um.length() * self.visual_deg_per_um;
        let [from, to] = S_RAMP_DEG;
        self.s_share * ((deg - from) / (to - from)).clamp(0.0, 1.0)
    }

    /// Eccentricity of a point, visual degrees (with the constant of the fovea).
    pub fn visual_deg(&self, at_um: DVec2) -> f64 {
        at_um.length() * self.visual_deg_per_um
    }

    /// Eccentricity of the ora, µm of arc.
    pub fn ora_um(&self) -> f64 {
        self.ora_deg / self.deg_per_um
    }
}

/// (retinal degrees, ln density) of one column; rows without a number are left out.
fn column_of(text: &str, column: usize) -> Vec<(f64, f64)> {
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| {
            let mut fields = line.split(',');
            let deg: f64 = fields.next()?.trim().parse().ok()?;
            let density: f64 = fields.nth(column - 1)?.trim().parse().ok()?;
            (density > 0.0).then(|| (deg, density.ln()))
        })
        .collect()
}

/// Target density at (`x_um`, `y_um`) of the chart, cones per mm² of retina, after the factor (11.402/12)².
///
/// Reads the table anew at each call; keep a [`Density`] for many points.
pub fn density_per_mm2(p: &RetinaParams, x_um: f64, y_um: f64) -> f64 {
    Density::new(p).per_mm2(DVec2::new(x_um, y_um))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curcio() -> Density {
        Density::new(&RetinaParams { peak_density_per_mm2: CURCIO_PEAK, ..RetinaParams::default() })
    }

    fn at_deg(deg: f64, meridian_deg: f64) -> DVec2 {
        DVec2::from_angle(meridian_deg.to_radians()) * deg.to_radians() * 12_000.0
    }

    #[test]
    fn knots_of_the_table_are_met() {
        let d = curcio();
        let scale = (11_402.0_f64 / 12_000.0).powi(2);
        let close = |p: DVec2, v: f64| assert!((d.per_mm2(p) / (scale * v) - 1.0).abs() < 1e-9);
        close(DVec2::ZERO, 196_890.0);
        close(at_deg(5.0, 0.0), 20_961.9);
        close(at_deg(5.0, 90.0), 15_863.0);
        close(at_deg(5.0, 180.0), 19_698.6);
        close(at_deg(5.0, 270.0), 16_993.4);
        close(at_deg(120.0, 90.0), 4_000.0);
    }

    #[test]
    fn peak_acts_at_the_centre_only() {
        let high = Density::new(&RetinaParams { peak_density_per_mm2: 324_100.0, ..RetinaParams::default() });
        assert!(
            (high.per_mm2(DVec2::ZERO) / curcio().per_mm2(DVec2::ZERO) - 324_100.0 / CURCIO_PEAK).abs()
                < 1e-9
        );
        assert!((high.per_mm2(at_deg(3.0, 33.0)) / curcio().per_mm2(at_deg(3.0, 33.0)) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn total_of_the_retina_is_curcios() {
        // Integral over the sphere to 120 retinal degrees; 4.57 million to the end of the data, more with the linear tail.
        let d = curcio();
        let mut total = 0.0;
        for ring in 0..1_200 {
            let theta = (f64::from(ring) + 0.5) * 0.1;
            let area = theta.to_radians().sin() * 144.0 * 0.1_f64.to_radians() * std::f64::consts::TAU / 72.0;
            total += (0..72).map(|m| d.per_mm2(at_deg(theta, f64::from(m) * 5.0)) * area).sum::<f64>();
        }
        assert!((4.9e6..5.7e6).contains(&total), "{total}");
    }

    #[test]
    fn coverage_and_s_share() {
        let d = curcio();
        assert!((d.coverage(DVec2::new(60.0, 0.0)) - 1.0).abs() < 1e-12);
        assert!((d.coverage(DVec2::new(660.0 * 12.0 / 11.402, 0.0)) - 0.802).abs() < 1e-9);
        assert!(d.s_share(DVec2::new(0.17 * 287.0, 0.0)).abs() < 1e-15);
        assert!((d.s_share(DVec2::new(0.0, 1.5 * 287.0)) - 0.08).abs() < 1e-12);
    }
}
