//! Where on the retina a point of the window is imaged at the reference wavelength: a polynomial through chief rays, and its affine form
//! inside a pixel.

use glam::{DMat2, DVec2};

use crate::exposure::scene::Scene;
use crate::optics::Projection;
use crate::psf::least_squares::LeastSquares;
use crate::psf::polynomial::Polynomial2;

/// Degree of the polynomial.
const DEGREE: usize = 7;
/// Points along a side through which it is fitted.
const POINTS: usize = 14;
/// Wavelength of the mapping, nm; others are shifts from it.
pub(super) const REFERENCE_NM: f64 = 543.0;
/// Largest distance from its middle at which a pixel's affine form stands for the polynomial, unit tangents: a curvature of 8 mm per unit
/// tangent squared moves a photon by 0.02 µm there.
const AFFINE: f64 = 0.0022;

/// The mapping reaches this far beyond the cones, unit tangents (300 µm): what is seen beyond sends nothing to them that counts.
const BEYOND: f64 = 0.018;

/// The mapping.
#[derive(Clone, Debug)]
pub(super) struct Landing {
    middle: DVec2,
    half: DVec2,
    um: [Polynomial2; 2],
    slope: [[Polynomial2; 2]; 2],
}

/// A pixel during a frame.
pub(super) struct Patch {
    /// Screen tangent of its corner, and per pixel unit.
    corner: DVec2,
    per_px: DVec2,
    /// Its middle as it is seen, pixel units from the corner, and how steps about it are stretched.
    middle_px: DVec2,
    stretch: DMat2,
    /// Image of the corner and change per pixel unit. `None`: too large, ask the polynomial.
    affine: Option<(DVec2, DMat2)>,
    /// Whether all of it is seen near the cones.
    near: bool,
}

impl Landing {
    /// Fits what is seen of the window of a scene near its cones, whose rectangle on the screen is given.
    ///
    /// # Errors
    /// When a part of the window is not seen.
    pub(super) fn new(projection: &Projection, scene: &Scene, cones: [DVec2; 2]) -> Result<Self, String> {
        let size = DVec2::new(f64::from(scene.size_px[0]), f64::from(scene.size_px[1]));
        let (a, b) = (scene.tangent(DVec2::ZERO), scene.tangent(size));
        let (low, high) = (a.min(b).min(cones[0] - BEYOND), a.max(b).max(cones[1] + BEYOND));
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low) + 2.0 * AFFINE);
        let nodes = super::super::nodes::chebyshev(-1.0, 1.0, POINTS);
        let (mut points, mut images) = (Vec::new(), Vec::new());
        for &y in &nodes {
            for &x in &nodes {
                let at = DVec2::new(x, y);
                points.push(at);
                images
                    .push(projection.retina_um(middle + half * at, REFERENCE_NM).map_err(|e| e.to_string())?);
            }
        }
        let fit = LeastSquares::new(DEGREE, &points, &vec![1.0; points.len()]);
        let um = [fit.fit(images.iter().map(|p| p.x)), fit.fit(images.iter().map(|p| p.y))];
        let slope = [um[0].gradient(), um[1].gradient()];
        Ok(Self { middle, half, um, slope })
    }

    /// Whether a point of the screen is inside what was fitted.
    fn holds(&self, tangent: DVec2) -> bool {
        (tangent - self.middle).abs().cmple(self.half).all()
    }

    /// Image of a point of the screen (unit tangents), µm.
    pub(super) fn um(&self, tangent: DVec2) -> DVec2 {
        let at = (tangent - self.middle) / self.half;
        DVec2::new(self.um[0].at(at), self.um[1].at(at))
    }

    /// Change of the image, µm per unit tangent.
    pub(super) fn jacobian(&self, tangent: DVec2) -> DMat2 {
        let at = (tangent - self.middle) / self.half;
        let by = |axis: usize| DVec2::new(self.slope[0][axis].at(at), self.slope[1][axis].at(at));
        DMat2::from_cols(by(0) / self.half.x, by(1) / self.half.y)
    }

    /// The corners of the window on the screen, unit tangents: least and most.
    pub(super) fn bounds(&self) -> [DVec2; 2] {
        [self.middle - self.half, self.middle + self.half]
    }

    /// The pixel whose top left corner is given, while the line of sight moves within bounds (pixels from the
    /// gaze centre); about its middle it is stretched.
    pub(super) fn patch(
        &self,
        scene: &Scene,
        (corner_px, stretch): (DVec2, DMat2),
        [low, high]: [DVec2; 2],
    ) -> Patch {
        let corner = scene.tangent(corner_px);
        let per_px = scene.tangent(corner_px + 1.0) - corner;
        let middle = corner + per_px * (0.5 - 0.5 * (low + high));
        let reach = (0.5 + 0.5 * (high - low)).length() * scene.tangent_per_px;
        let affine = (reach < AFFINE && self.holds(middle)).then(|| {
            let by = self.jacobian(middle) * DMat2::from_diagonal(per_px) * stretch;
            (self.um(middle) - by * (0.5 - 0.5 * (low + high)), by)
        });
        // A pixel of room for misregistered rectangles and spots.
        let near = self.holds(corner + per_px * (-1.0 - high)) && self.holds(corner + per_px * (2.0 - low));
        let middle_px = 0.5 - 0.5 * (low + high);
        Patch { corner, per_px, middle_px, stretch, affine, near }
    }
}

impl Patch {
    /// Image of its corner at rest, and change per pixel unit: all of it, however the eye moves. `None`: ask for each place.
    pub(super) fn straight(&self) -> Option<(DVec2, DMat2)> {
        self.affine.filter(|_| self.near)
    }

    /// Image of a place (pixel units from the corner) less the line of sight (pixels from the gaze centre), µm; not a number when it
    /// is seen far from all cones.
    pub(super) fn landing(&self, landing: &Landing, from_sight: DVec2) -> DVec2 {
        let stretched = self.middle_px + self.stretch * (from_sight - self.middle_px);
        let seen = self.corner + self.per_px * stretched;
        if !self.near && !landing.holds(seen) {
            return DVec2::NAN;
        }
        self.affine.map_or_else(|| landing.um(seen), |(um, by)| um + by * from_sight)
    }
}
