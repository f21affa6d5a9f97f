//! The screen about one cone: where sources beside its own place are imaged, how much of their light enters the pupil, and
//! between which source points PSFs are interpolated.

use glam::{DMat2, DVec2};

use super::super::cones::entering;
use super::super::transfer::FieldPoint;
use super::optics::Optics;

/// Step of the map's second derivatives, unit tangents.
const STEP: f64 = 2e-3;
/// Offsets up to which light and image are taken to second order, unit tangents (1.7°).
const NEAR: f64 = 0.03;
/// Largest geometric spot over which PSFs change in proportion to the place, radius in unit tangents (41 µm).
const LINEAR: f64 = 2.5e-3;
/// Distance of the source points beside a cone's own place over the radius of the geometric spot, and its range, unit tangents.
const PART: f64 = 0.5;
const RANGE: [f64; 2] = [4e-4, 3e-2];

/// The screen about a cone.
pub struct Local {
    tangent: DVec2,
    /// Offset on the retina (µm along its tangents) from an offset on the screen (tangents), and its second derivatives xx, xy, yy.
    pub to_retina: DMat2,
    curved: [DVec2; 3],
    /// Light that enters at the cone's own place, its slope and second derivatives; of any place when it is far.
    near: [f64; 6],
    far: Box<dyn Fn(DVec2) -> f64 + Send + Sync>,
}

impl Local {
    /// About a point of the field.
    ///
    /// # Errors
    /// When the screen beside it is not seen.
    pub fn new(optics: &Optics, point: &FieldPoint) -> Result<Self, String> {
        let at = |t: DVec2| optics.projection.jacobian_um_per_tangent(t).map_err(|e| e.to_string());
        let to_retina = point.frequency_map.inverse().transpose();
        // From the chart to the retina's tangents, the same for all nearby.
        let chart = to_retina * at(point.tangent)?.inverse();
        let by = |axis: DVec2| -> Result<DMat2, String> {
            Ok((at(point.tangent + STEP * axis)? - at(point.tangent - STEP * axis)?) * (0.5 / STEP))
        };
        let (by_x, by_y) = (by(DVec2::X)?, by(DVec2::Y)?);
        let curved = [by_x.x_axis, 0.5 * (by_x.y_axis + by_y.x_axis), by_y.y_axis].map(|c| chart * c);
        let (law, beams) = (optics.emission_law, optics.beams.clone());
        let far = move |t: DVec2| entering(law, &beams, t);
        let near = expanded(|d| far(point.tangent + d));
        Ok(Self { tangent: point.tangent, to_retina, curved, near, far: Box::new(far) })
    }

    /// µm of retina per unit tangent, the longer way.
    pub fn um_per_tangent(&self) -> f64 {
        self.to_retina.x_axis.length().max(self.to_retina.y_axis.length())
    }

    /// Image of a source at an offset on the screen (tangents) from the cone's own place, µm from the cone.
    pub fn image_um(&self, offset: DVec2) -> DVec2 {
        let [xx, xy, yy] = self.curved;
        let (x, y) = (offset.x, offset.y);
        let bend = 0.5 * x * x * xx + x * y * xy + 0.5 * y * y * yy;
        // From afar the direction is what counts, and the series ends.
        let part = if offset.length() > NEAR { 0.0 } else { 1.0 };
        self.to_retina * offset + part * bend
    }

    /// Light that enters the pupil from there, over that of the nominal pupil from the gaze centre.
    pub fn light(&self, offset: DVec2) -> f64 {
        if offset.length() > NEAR {
            return (self.far)(self.tangent + offset);
        }
        let (x, y) = (offset.x, offset.y);
        let [here, by_x, by_y, xx, xy, yy] = self.near;
        here + by_x * x + by_y * y + 0.5 * xx * x * x + xy * x * y + 0.5 * yy * y * y
    }
}

/// Value, slope and second derivatives (xx, xy, yy) at 0.
fn expanded(f: impl Fn(DVec2) -> f64) -> [f64; 6] {
    let h = 0.3 * NEAR;
    let at = |x: f64, y: f64| f(h * DVec2::new(x, y));
    let here = at(0.0, 0.0);
    let [right, left, above, below] = [at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0), at(0.0, -1.0)];
    let mixed = at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0);
    let square = h * h;
    [
        here,
        (right - left) / (2.0 * h),
        (above - below) / (2.0 * h),
        (right - 2.0 * here + left) / square,
        mixed / (4.0 * square),
        (above - 2.0 * here + below) / square,
    ]
}

/// Source points beside a cone's own place.
pub struct Stencil {
    step: f64,
    quadratic: bool,
}

impl Stencil {
    /// For the radius of the geometric spot on the screen (unit tangents).
    pub fn new(spot: f64) -> Self {
        let step = (PART * spot).clamp(RANGE[0], RANGE[1]);
        Self { step, quadratic: spot > LINEAR }
    }

    /// The offsets of the points, unit tangents.
    pub fn offsets(&self) -> Vec<DVec2> {
        let h = self.step;
        let beside = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]];
        beside[..if self.quadratic { 5 } else { 2 }].iter().map(|p| h * DVec2::from_array(*p)).collect()
    }

    /// Weight of each point's difference for a source at an offset.
    pub fn weights(&self, offset: DVec2) -> [f64; 5] {
        let (x, y) = (offset.x / self.step, offset.y / self.step);
        if !self.quadratic {
            return [x, y, 0.0, 0.0, 0.0];
        }
        // Polynomials of the second degree that are 1 at one point and 0 at the others and at the middle.
        [
            0.5 * x * (x + 1.0) - x * y,
            0.5 * y * (y + 1.0) - x * y,
            0.5 * x * (x - 1.0),
            0.5 * y * (y - 1.0),
            x * y,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_through_the_points() {
        for (spot, f) in [
            (1e-3, (|p: DVec2| 2.0 * p.x - p.y) as fn(DVec2) -> f64),
            (3e-3, |p| p.x - 3.0 * p.y + 2.0 * p.x * p.x - p.x * p.y + 0.5 * p.y * p.y),
        ] {
            let stencil = Stencil::new(spot);
            let at = DVec2::new(1.3e-3, -2.1e-3);
            let weights = stencil.weights(at);
            let made: f64 = stencil.offsets().iter().zip(weights).map(|(p, w)| w * f(*p)).sum();
            assert!((made - f(at)).abs() < 1e-12, "{made} {}", f(at));
        }
    }
}
