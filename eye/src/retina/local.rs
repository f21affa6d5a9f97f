//! The metric of a cone: distances in the plane across its direction (§15.2, last paragraph).
//!
//! A point of the chart is (x, y) = ρ·(cos φ, sin φ), ρ the arc from the foveal centre on a sphere of radius R, θ = ρ/R.
//! In the foveal frame (nasal, superior, inward) it is R·(sin θ cos φ, sin θ sin φ, 1 - cos θ). A chart step (dρ, ρ·dφ) is a step
//! (dρ, k·ρ·dφ) on the sphere, k = sin θ/θ. A cone looks along the unit vector a to the centre of the exit pupil, so a step δ of the
//! surface has length² |δ|² - (δ·a)² in the plane across a. The metric G of the chart is that quadratic form; sqrt(det G) = k·cos τ, τ
//! the tilt between a and the surface normal (1.6° at the fovea of the default eye, 11° at 20°, 43° at the ora). Unit: µm.

use glam::{DVec2, DVec3};

use super::params::RetinaGeometry;
use crate::math;

/// A symmetric positive quadratic form on chart steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Coefficient of dx².
    pub xx: f64,
    /// Half the coefficient of dx·dy.
    pub xy: f64,
    /// Coefficient of dy².
    pub yy: f64,
}

impl Metric {
    /// Squared length of the chart step `d`, µm².
    #[inline]
    pub fn length2(&self, d: DVec2) -> f64 {
        self.xx * d.x * d.x + 2.0 * self.xy * d.x * d.y + self.yy * d.y * d.y
    }

    /// The covector G·d.
    #[inline]
    pub fn lower(&self, d: DVec2) -> DVec2 {
        DVec2::new(self.xx * d.x + self.xy * d.y, self.xy * d.x + self.yy * d.y)
    }

    /// The sum of two forms.
    #[inline]
    pub fn plus(&self, o: &Self) -> Self {
        Self { xx: self.xx + o.xx, xy: self.xy + o.xy, yy: self.yy + o.yy }
    }

    /// Area across the cone per area of the chart.
    pub fn area_factor(&self) -> f64 {
        (self.xx * self.yy - self.xy * self.xy).sqrt()
    }

    /// The smallest length of a chart step of length 1.
    pub fn shortest(&self) -> f64 {
        let mean = 0.5 * (self.xx + self.yy);
        (mean - (0.25 * (self.xx - self.yy).powi(2) + self.xy * self.xy).sqrt()).max(1e-6).sqrt()
    }

    /// Half sides of the box that holds all chart steps of at most `length`, with a hundredth to spare for the next cone's metric.
    #[inline]
    pub fn box_of(&self, length: f64) -> DVec2 {
        let scale = 1.01 * length / self.area_factor();
        DVec2::new(self.yy.sqrt() * scale, self.xx.sqrt() * scale)
    }

    /// Cholesky factor of the form.
    pub fn frame(&self) -> Frame {
        let a = self.xx.sqrt();
        let b = self.xy / a;
        Frame { a, b, c: (self.yy - b * b).sqrt() }
    }
}

/// Orthonormal coordinates u of the plane across a cone: u = (a·dx + b·dy, c·dy), |u|² = length².
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    a: f64,
    b: f64,
    c: f64,
}

impl Frame {
    /// Plane coordinates of a chart step.
    #[inline]
    pub fn plane_from_chart(&self, d: DVec2) -> DVec2 {
        DVec2::new(self.a * d.x + self.b * d.y, self.c * d.y)
    }

    /// Chart step of plane coordinates.
    #[inline]
    pub fn chart_from_plane(&self, u: DVec2) -> DVec2 {
        let y = u.y / self.c;
        DVec2::new((u.x - self.b * y) / self.a, y)
    }

    /// Gradient over plane coordinates from the gradient over chart coordinates.
    pub fn plane_gradient(&self, g: DVec2) -> DVec2 {
        DVec2::new(g.x / self.a, (g.y - self.b * g.x / self.a) / self.c)
    }
}

/// What the geometry says about one point of the chart.
#[derive(Clone, Copy, Debug)]
pub struct Local {
    /// Metric across the cone's direction.
    pub metric: Metric,
    /// Cosine of the tilt between the cone and the surface normal.
    pub cos_tilt: f64,
}

/// Metric and tilt at a point of the chart, µm.
pub fn local(g: &RetinaGeometry, at_um: DVec2) -> Local {
    let rho = at_um.length();
    let out = if rho > 0.0 { at_um / rho } else { DVec2::X };
    let theta = rho / g.radius_um;
    let (sin, cos) = math::sin_cos(theta);
    let k = if theta > 1e-9 { sin / theta } else { 1.0 };
    let aim = aim(g, DVec3::new(sin * out.x, sin * out.y, -cos));
    // Components of the aim along the radial and the tangential direction of the chart.
    let radial = cos * (out.x * aim.x + out.y * aim.y) + sin * aim.z;
    let across = out.x * aim.y - out.y * aim.x;
    let (rr, rt, tt) = (1.0 - radial * radial, -radial * across * k, k * k * (1.0 - across * across));
    let metric = Metric {
        xx: rr * out.x * out.x - 2.0 * rt * out.x * out.y + tt * out.y * out.y,
        xy: (rr - tt) * out.x * out.y + rt * (out.x * out.x - out.y * out.y),
        yy: rr * out.y * out.y + 2.0 * rt * out.x * out.y + tt * out.x * out.x,
    };
    let cos_tilt = (1.0 - radial * radial - across * across).max(0.0).sqrt();
    Local { metric, cos_tilt }
}

/// Unit vector from the place that is `arm` (a unit vector of the foveal frame) from the sphere's centre to the exit pupil seen there.
fn aim(g: &RetinaGeometry, arm: DVec3) -> DVec3 {
    let pupil = &g.exit_pupil;
    let c = 1.0 - DVec3::from_array(pupil.axis).dot(arm);
    let [p0, p1, p2, p3] = pupil.at_um.map(DVec3::from_array);
    let at = p0 + c * (p1 + c * (p2 + c * p3));
    let aim = at - (arm + DVec3::Z) * g.radius_um;
    // The pupil is millimetres from the retina for all allowed parameters.
    aim / aim.length()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metric_is_the_length_across_the_aim() {
        let g = RetinaGeometry::default();
        for (at, tilt_deg) in [(DVec2::new(3.0, 4.0), 1.62), (DVec2::new(0.0, 5_864.0), 11.4)] {
            let here = local(&g, at);
            assert!((here.cos_tilt.acos().to_degrees() - tilt_deg).abs() < 0.2, "{here:?}");
            // Against two points of the sphere, projected across the aim.
            let place = |p: DVec2| {
                let t = p.length() / g.radius_um;
                let o = p / p.length();
                DVec3::new(t.sin() * o.x, t.sin() * o.y, 1.0 - t.cos()) * g.radius_um
            };
            let aim = (DVec3::from_array(g.exit_pupil.at_um[0]) - place(at)).normalize();
            for d in [DVec2::new(1e-3, 0.0), DVec2::new(0.4e-3, -1e-3)] {
                let step = place(at + d) - place(at - d);
                let want = step.length_squared() - step.dot(aim).powi(2);
                assert!((here.metric.length2(2.0 * d) / want - 1.0).abs() < 1e-5);
                let f = here.metric.frame();
                assert!(
                    (f.plane_from_chart(d).length_squared() / here.metric.length2(d) - 1.0).abs() < 1e-12
                );
                assert!((f.chart_from_plane(f.plane_from_chart(d)) - d).length() < 1e-15);
            }
        }
    }

    #[test]
    fn tilt_at_the_ora() {
        let here = local(&RetinaGeometry::default(), DVec2::new(0.0, 119.0_f64.to_radians() * 12_000.0));
        assert!((here.cos_tilt.acos().to_degrees() - 42.0).abs() < 2.5);
        assert!((here.metric.area_factor() / here.cos_tilt / 0.421 - 1.0).abs() < 0.01);
    }
}
