//! Cone density, apertures' fraction of the cells and S share as functions of place (§13).
//!
//! Density. Curcio et al. 1990 along four retinal meridians (nasal, superior, temporal, inferior), indexed by RETINAL degrees.
//! Along a meridian: monotone cubic (Fritsch and Carlson 1980) in (retinal degrees, ln density), ends one-sided; past the
//! last datum of a meridian linear in density to `ora_density_per_mm2` at the ora. Between meridians: ln density is mixed with weights
//! cos²φ and sin²φ of the two meridians beside the point, which is smooth round the circle. The peak is a parameter: the
//! table is multiplied by 1 + (peak/196,890 - 1)·exp(-θ²), θ in retinal degrees, because eyes differ in the foveola
//! (standard deviation 46 % at the centre, 38 % at 0.5°, 20 % at 1°, about 12 % from 1.5° on). Last, the factor (11.402/12)² = 0.903 keeps cones
//! per retinal degree on a 12 mm sphere those of the source's 11.402 mm sphere. Unit: cones per mm² of retinal surface.
//!
//! Coverage: the fraction of its cell that a cone's aperture fills, see `aperture`.
//!
//! `Tyler`: 50,000·v^(-2/3) cones/mm² for v visual degrees from 1 to 20, then linear in v to the value at the ora; Curcio's table inside 1°
//! (mixed in from 0.75° to 1.25°) and Curcio's change by meridian, which fades from 20° to the ora. These are cones/mm² on the 12 mm sphere, as in the paper.
//!
//! A wished total of cones scales the density by 1 + (k - 1)·(1 - exp(-(θ/3°)²)): the fovea stays, k follows from the integral.
//!
//! The ora lies at `ora_retinal_deg`·(1 - `ora_dip`·cos φ), φ = 0 nasal. By default it is 102° and -0.09:
//! where Curcio's counts end (111° nasal, 93° temporal). The law then integrates to 4.59 million cones; her
//! eyes hold 4.6 (4.08 to 5.29) million.
//!
//! # As printed
//! Equation (1) gives 2.24e6 cones/mm² at 1°: θ there is in µm at 300 µm per degree; with θ in degrees and no 300 it gives 50,000, which
//! meets Curcio's 50,700 (on 12 mm). §13 puts the ora near 120°, 6 % nearer on the nasal side. Curcio's table held to there has 5.51 million
//! cones, and her counts go on to 110° on the nasal side, to 90° on the temporal one.
//!
//! # Cost
//! `Density::new` reads the table, and integrates over the retina (2 ms) when a total is wished; `per_mm2` is two cubics and two
//! exponentials, with `Tyler` six times that.

use glam::DVec2;

use super::aperture::ApertureLaw;
use super::params::{DensityLaw, OpticDisc, RetinaParams};
use super::visual::VisualMap;
use crate::{catalog, math};

/// Radius of the sphere that Curcio's table is scaled to, µm.
pub(super) const CURCIO_RADIUS_UM: f64 = 11_402.0;
/// Table value at the foveal centre, cones/mm².
const CURCIO_PEAK: f64 = 196_890.0;
/// Visual degrees between which Curcio's fovea goes over to Tyler's law, and the last of the power law.
const TYLER_FROM_DEG: [f64; 2] = [0.75, 1.25];
const TYLER_TO_DEG: f64 = 20.0;
/// Tyler's density at 1 visual degree, cones/mm², and its exponent.
const TYLER: (f64, f64) = (50_000.0, -2.0 / 3.0);
/// Retinal degrees from which a wished total of cones acts.
const TOTAL_FROM_DEG: f64 = 3.0;

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
    aperture: ApertureLaw,
    law: DensityLaw,
    peak_excess: f64,
    scale: f64,
    radius_um: f64,
    deg_per_um: f64,
    ora_deg: f64,
    ora_dip: f64,
    ora_end: f64,
    visual: VisualMap,
    s_share: f64,
    s_ramp_deg: [f64; 2],
    /// k - 1 of a wished total.
    periphery_excess: f64,
    optic_disc: Option<OpticDisc>,
    /// Centre and radius of a circle of the chart that holds the optic disc.
    disc_within: (DVec2, f64),
}

impl Density {
    /// Reads the embedded table `cone-density-curcio`.
    pub fn new(p: &RetinaParams) -> Self {
        let text = catalog::text("spectra", "cone-density-curcio").unwrap_or_default();
        let g = &p.geometry;
        let mut density = Self {
            meridian: [1, 2, 3, 4].map(|column| Cubic::new(&column_of(text, column))),
            aperture: ApertureLaw::new(p),
            law: p.density,
            peak_excess: p.peak_density_per_mm2 / CURCIO_PEAK - 1.0,
            scale: (CURCIO_RADIUS_UM / g.radius_um).powi(2),
            radius_um: g.radius_um,
            deg_per_um: (1.0 / g.radius_um).to_degrees(),
            ora_deg: g.ora_retinal_deg,
            ora_dip: g.ora_dip,
            ora_end: g.ora_density_per_mm2,
            visual: g.visual.clone(),
            s_share: p.cone_ratio[2],
            s_ramp_deg: p.s_ramp_deg,
            periphery_excess: 0.0,
            optic_disc: p.optic_disc,
            disc_within: p.optic_disc.map_or((DVec2::ZERO, 0.0), |disc| circle_of(&disc, &g.visual)),
        };
        if let Some(total) = p.total_cones {
            let [all, scaled] = density.integrals();
            density.periphery_excess = (total - all) / scaled;
        }
        density
    }

    /// ∫ density and ∫ density·(share that a wished total scales) over the retina without its optic disc, cones.
    fn integrals(&self) -> [f64; 2] {
        const MERIDIANS: u32 = 72;
        const STEP_DEG: f64 = 0.2;
        let mut sums = [0.0; 2];
        let rings = (self.ora_deg * (1.0 + self.ora_dip.abs()) / STEP_DEG).ceil() as u32;
        for ring in 0..rings {
            let deg = (f64::from(ring) + 0.5) * STEP_DEG;
            let (sin, _) = math::sin_cos(deg.to_radians());
            let turn = std::f64::consts::TAU / f64::from(MERIDIANS);
            let area_mm2 = sin * STEP_DEG.to_radians() * turn * (1e-3 * self.radius_um).powi(2);
            for m in 0..MERIDIANS {
                let at = math::unit(turn * (f64::from(m) + 0.5)) * (deg / self.deg_per_um);
                if self.is_retina(at) {
                    let cones = self.per_mm2(at) * area_mm2;
                    sums[0] += cones;
                    sums[1] += cones * periphery(deg);
                }
            }
        }
        sums
    }

    /// Eccentricity of the ora in a direction of which the cosine with the nasal one is given, retinal degrees.
    fn ora_at(&self, cos_nasal: f64) -> f64 {
        self.ora_deg * (1.0 - self.ora_dip * cos_nasal)
    }

    /// ln density along one meridian, on Curcio's scale.
    fn along(&self, meridian: usize, deg: f64) -> f64 {
        let curve = &self.meridian[meridian];
        let end = curve.end();
        if deg <= end {
            return curve.at(deg);
        }
        let last = math::exp(curve.at(end));
        let ora = self.ora_at([1.0, 0.0, -1.0, 0.0][meridian]);
        let t = ((deg - end) / (ora - end).max(1.0)).min(1.0);
        math::ln(last + t * (self.ora_end - last))
    }

    /// ln density of Tyler's law at a place, given that of Curcio's there and its mean over the meridians.
    fn tyler(&self, at_um: DVec2, cos_nasal: f64, here: f64, mean: f64) -> f64 {
        let v = self.visual.eccentricity_deg(at_um);
        let [from, to] = TYLER_FROM_DEG;
        if v <= from {
            return here;
        }
        let (at_one, exponent) = TYLER;
        let law = |v: f64| at_one * math::pow(v, exponent);
        let (value, fade) = if v <= TYLER_TO_DEG {
            (law(v), 0.0)
        } else {
            let edge = at_um * (self.ora_at(cos_nasal) / self.deg_per_um / at_um.length());
            let last = self.visual.eccentricity_deg(edge).max(TYLER_TO_DEG + 1.0);
            let t = ((v - TYLER_TO_DEG) / (last - TYLER_TO_DEG)).min(1.0);
            (law(TYLER_TO_DEG) + t * (self.ora_end - law(TYLER_TO_DEG)), t)
        };
        let tyler = math::ln(value) + (1.0 - fade) * (here - mean);
        let t = ((v - from) / (to - from)).min(1.0);
        here + t * t * (3.0 - 2.0 * t) * (tyler - here)
    }

    /// Target density at a point of the chart, cones per mm² of retina.
    pub fn per_mm2(&self, at_um: DVec2) -> f64 {
        let rho = at_um.length();
        let deg = rho * self.deg_per_um;
        let cos = if rho > 0.0 { at_um.x / rho } else { 1.0 };
        let horizontal = self.along(if at_um.x < 0.0 { 2 } else { 0 }, deg);
        let vertical = self.along(if at_um.y < 0.0 { 3 } else { 1 }, deg);
        let mut table = cos * cos * horizontal + (1.0 - cos * cos) * vertical;
        if self.law == DensityLaw::Tyler {
            // Tyler's figures are for the 12 mm sphere, the table's for its own.
            let scale = math::ln(self.scale);
            let mean = (0..4).map(|m| self.along(m, deg)).sum::<f64>() / 4.0;
            table = self.tyler(at_um, cos, table + scale, mean + scale) - scale;
        }
        let mut density = self.scale * math::exp(table);
        // exp(-deg²) is below 1e-16 from 6.1° on.
        if deg < 6.1 {
            density *= 1.0 + self.peak_excess * math::exp(-deg * deg);
        }
        if self.periphery_excess == 0.0 {
            density
        } else {
            density * (1.0 + self.periphery_excess * periphery(deg))
        }
    }

    /// Fraction of its cell that a cone's light-collecting aperture fills, 0 to 1, where cells are those of
    /// the target density.
    pub fn coverage(&self, at_um: DVec2) -> f64 {
        self.coverage_of(at_um, || 1e-6 * self.per_mm2(at_um))
    }

    /// The same where `per_um2` cones stand on 1 µm² of retina (asked only where it matters).
    pub(super) fn coverage_of(&self, at_um: DVec2, per_um2: impl FnOnce() -> f64) -> f64 {
        let on_source_um = at_um.length() * self.deg_per_um.to_radians() * CURCIO_RADIUS_UM;
        self.aperture.fraction(on_source_um, per_um2)
    }

    /// Share of S cones: 0 inside the first eccentricity of the ramp (0.175 visual degrees), linear to the full share at the second (1.5).
    pub fn s_share(&self, at_um: DVec2) -> f64 {
        let [from, to] = self.s_ramp_deg;
        // Far out nothing need be looked up: within 50° the scale stays within a fifth of the fovea's.
        if at_um.length() * self.visual.deg_per_um() > 1.5 * to {
            return self.s_share;
        }
        self.s_share * ((self.visual_deg(at_um) - from) / (to - from)).clamp(0.0, 1.0)
    }

    /// Eccentricity of a point, visual degrees.
    pub fn visual_deg(&self, at_um: DVec2) -> f64 {
        self.visual.eccentricity_deg(at_um)
    }

    /// Largest eccentricity of the ora, µm of arc.
    pub fn ora_um(&self) -> f64 {
        self.ora_at(-1.0).max(self.ora_at(1.0)) / self.deg_per_um
    }

    /// Eccentricity of the ora in the direction of a point, µm of arc.
    pub(super) fn ora_toward_um(&self, at_um: DVec2) -> f64 {
        let rho = at_um.length();
        self.ora_at(if rho > 0.0 { at_um.x / rho } else { 1.0 }) / self.deg_per_um
    }

    /// Whether cones live here: inside the ora and outside the optic disc.
    pub fn is_retina(&self, at_um: DVec2) -> bool {
        let rho = at_um.length();
        let cos_nasal = if rho > 0.0 { at_um.x / rho } else { 1.0 };
        rho * self.deg_per_um <= self.ora_at(cos_nasal) && !self.is_optic_disc(at_um)
    }

    fn is_optic_disc(&self, at_um: DVec2) -> bool {
        let (middle, radius) = self.disc_within;
        self.optic_disc.is_some_and(|disc| {
            if (at_um - middle).length_squared() > radius * radius {
                return false;
            }
            let from_centre = self.visual.visual_deg(at_um) - DVec2::from_array(disc.centre_deg);
            // An ellipse without size holds nothing.
            (2.0 * from_centre / DVec2::from_array(disc.size_deg).max(DVec2::splat(1e-9))).length_squared()
                < 1.0
        })
    }
}

/// A circle of the chart that holds an optic disc: its centre by fixed-point iteration, its radius with room for the change of scale.
fn circle_of(disc: &OpticDisc, visual: &VisualMap) -> (DVec2, f64) {
    let (centre, scale) = (DVec2::from_array(disc.centre_deg), visual.deg_per_um());
    let mut at = centre / scale;
    for _ in 0..40 {
        at += (centre - visual.visual_deg(at)) / scale;
    }
    (at, disc.size_deg[0].max(disc.size_deg[1]) / scale)
}

/// Share of a wished change of the total that acts at an eccentricity, retinal degrees.
fn periphery(deg: f64) -> f64 {
    -libm::expm1(-(deg / TOTAL_FROM_DEG).powi(2))
}

/// (retinal degrees, ln density) of one column; rows without a number are left out.
fn column_of(text: &str, column: usize) -> Vec<(f64, f64)> {
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| {
            let mut fields = line.split(',');
            let deg: f64 = fields.next()?.trim().parse().ok()?;
            let density: f64 = fields.nth(column - 1)?.trim().parse().ok()?;
            (density > 0.0).then(|| (deg, math::ln(density)))
        })
        .collect()
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
        // 4.6 million (4.08 to 5.29) in seven eyes; the disc takes 0.03 million.
        let [total, periphery] = curcio().integrals();
        assert!((total / 4.6e6 - 1.0).abs() < 0.02 && periphery > 0.9 * total, "{total}");
    }

    #[test]
    fn a_wished_total_is_met_and_spares_the_fovea() {
        for total in [4e6, 6.5e6] {
            let wished = Density::new(&RetinaParams { total_cones: Some(total), ..RetinaParams::default() });
            assert!((wished.integrals()[0] / total - 1.0).abs() < 1e-12);
            let usual = Density::new(&RetinaParams::default());
            assert!(
                (wished.per_mm2(at_deg(0.2, 40.0)) / usual.per_mm2(at_deg(0.2, 40.0)) - 1.0).abs() < 0.01
            );
        }
    }

    /// §13: 50,000 cones/mm² at 1 visual degree, falling with the power -2/3; the mean over the meridians.
    #[test]
    fn tylers_law() {
        let d = Density::new(&RetinaParams {
            density: DensityLaw::Tyler,
            peak_density_per_mm2: CURCIO_PEAK,
            ..RetinaParams::default()
        });
        for (v, want) in [(2.0_f64, 50_000.0 / 2.0_f64.powf(2.0 / 3.0)), (8.0, 12_500.0), (20.0, 6_786.0)] {
            let got = (0..4)
                .map(|m| {
                    d.per_mm2(DVec2::from_angle(f64::from(m) * std::f64::consts::FRAC_PI_2) * v * 287.0).ln()
                })
                .sum::<f64>();
            assert!(((got / 4.0).exp() / want - 1.0).abs() < 1e-3, "{v}");
        }
        assert!((d.per_mm2(at_deg(120.0, 90.0)) / 4_000.0 - 1.0).abs() < 0.01);
    }

    #[test]
    fn ora_and_optic_disc() {
        let d = curcio();
        assert!(d.is_retina(at_deg(111.1, 0.0)) && !d.is_retina(at_deg(111.3, 0.0)));
        assert!(d.is_retina(at_deg(92.7, 180.0)) && !d.is_retina(at_deg(92.9, 180.0)));
        let visual = |x: f64, y: f64| DVec2::new(x, y) * 287.0;
        for (x, y, hole) in
            [(15.0, 2.0, true), (17.4, 2.0, true), (17.6, 2.0, false), (15.0, -1.4, true), (15.0, 5.6, false)]
        {
            assert_eq!(!d.is_retina(visual(x, y)), hole, "{x} {y}");
        }
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
