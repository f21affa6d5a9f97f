//! Between a screen and the retina, by exact chief rays at the reference wavelength (543 nm).
//!
//! A point of the screen is named by coordinates t, see [`super::screen`]: of a flat screen across the line of sight
//! tangents of its direction. t = 0 is fixated and lands on the foveal centre by definition.

use super::error::{OpticsError, in_range};
use super::object::Object;
use super::projection_fit::ProjectionFit;
use super::schematic_eye::SchematicEye;
use super::screen::Screen;
use glam::{DMat2, DVec2, DVec3};

/// A screen before an eye.
#[derive(Clone, Debug, PartialEq)]
pub struct Projection {
    eye: SchematicEye,
    screen: Screen,
    axes: [DVec3; 3],
    centre_slope: DMat2,
}

/// Step of the finite differences in tangent units.
const STEP: f64 = 1e-4;

impl Projection {
    /// The projection of a flat screen across the line of sight at `distance_mm` (50 mm to ∞), as
    /// [`Projection::of`].
    ///
    /// # Errors
    /// As [`Projection::of`].
    pub fn new(eye: &SchematicEye, distance_mm: f64) -> Result<Self, OpticsError> {
        Self::of(eye, Screen::frontal(distance_mm))
    }

    /// The projection of a screen. The foveal centre is taken anew for the distance of the fixated point: use
    /// [`Projection::eye`] for wavefronts that belong to it.
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] for the distance, [`OpticsError::NoRay`] when the fixated point is not seen.
    pub fn of(eye: &SchematicEye, screen: Screen) -> Result<Self, OpticsError> {
        in_range("screen distance (mm)", screen.fixated_mm(), 50.0, f64::INFINITY)?;
        let eye = eye.clone().at_distance(screen.fixated_mm())?;
        let axes = eye.view_axes();
        let mut projection = Self { eye, screen, axes, centre_slope: DMat2::IDENTITY };
        projection.centre_slope = projection.jacobian_um_per_tangent(DVec2::ZERO)?;
        Ok(projection)
    }

    /// The eye, its foveal centre taken for this distance.
    pub fn eye(&self) -> &SchematicEye {
        &self.eye
    }

    /// The screen.
    pub fn screen(&self) -> &Screen {
        &self.screen
    }

    /// The object at the point `t` of the screen.
    pub fn object(&self, t: DVec2) -> Object {
        let (direction, length) = self.screen.light_from(t, self.axes);
        Object::from_parts(direction, 1.0 / (self.screen.nominal_mm() * length))
    }

    /// The ray of object space that goes to the retina where the point `t` is imaged, in the view frame: the point,
    /// over the nominal distance, and the direction from the entrance pupil's centre to it.
    pub fn line_to(&self, t: DVec2) -> [DVec3; 2] {
        let pupil = self.eye.in_view(self.eye.entrance_pupil) / self.screen.nominal_mm();
        let way = self.screen.way(t);
        [way, way - pupil]
    }

    /// Where the chief ray from `t` lands: (x_um, y_um).
    ///
    /// # Errors
    /// [`OpticsError::NoRay`] when no chief ray gets to the retina; [`OpticsError::OutOfRange`] for the wavelength.
    pub fn retina_um(&self, t: DVec2, wavelength_nm: f64) -> Result<DVec2, OpticsError> {
        let object = self.object(t);
        let chief = self.eye.chief_ray(object, wavelength_nm)?;
        let landing = chief.landing().ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })?;
        Ok(self.eye.fovea().um_from_point(landing))
    }

    /// d(x_um, y_um)/dt at the reference wavelength; columns are the derivatives by t.x and t.y.
    ///
    /// # Errors
    /// As [`Projection::retina_um`].
    pub fn jacobian_um_per_tangent(&self, t: DVec2) -> Result<DMat2, OpticsError> {
        let nm = self.eye.prescription().reference_wavelength_nm;
        let h = STEP * (1.0 + t.length());
        let column = |e: DVec2| -> Result<DVec2, OpticsError> {
            Ok((self.retina_um(t + e, nm)? - self.retina_um(t - e, nm)?) / (2.0 * h))
        };
        Ok(DMat2::from_cols(column(DVec2::new(h, 0.0))?, column(DVec2::new(0.0, h))?))
    }

    /// The tangent coordinates imaged on (x_um, y_um) at the reference wavelength, to 1e-9 µm.
    ///
    /// # Errors
    /// [`OpticsError::OutsideField`] when no point of the flat screen is.
    pub fn screen_tangent(&self, um: DVec2) -> Result<DVec2, OpticsError> {
        let outside = OpticsError::OutsideField { x_um: um.x, y_um: um.y };
        let nm = self.eye.prescription().reference_wavelength_nm;
        if !um.is_finite() {
            return Err(outside);
        }
        // Start from the foveal magnification taken as an angle, which bends as the retina does.
        let linear = self.centre_slope.inverse() * um;
        let angle = linear.length().min(1.4);
        let mut t = if angle > 0.0 { linear.normalize_or_zero() * angle.tan() } else { linear };
        if !self.screen.is_frontal() {
            let Some(guess) = self.first_guess(um) else { return Err(outside) };
            t = guess;
        }
        let mut miss = match self.retina_um(t, nm) {
            Ok(um_at) => um_at - um,
            Err(_) => return Err(outside),
        };
        for _ in 0..40 {
            if miss.length() <= 1e-9 {
                return Ok(t);
            }
            let Ok(slope) = self.jacobian_um_per_tangent(t) else {
                return Err(outside);
            };
            if slope.determinant().abs() < 1e-9 {
                return Err(outside);
            }
            let step = slope.inverse() * miss;
            let mut part = 1.0;
            let better = loop {
                let next = t - part * step;
                match self.retina_um(next, nm).map(|at| at - um) {
                    Ok(m) if m.length() < miss.length() => break Some((next, m)),
                    Ok(_) | Err(_) => part *= 0.5,
                }
                if part < 1e-6 {
                    break None;
                }
            };
            let Some((next, m)) = better else {
                // As near as rounding lets it come, or beyond the edge of the field.
                return if miss.length() < 1e-6 { Ok(t) } else { Err(outside) };
            };
            (t, miss) = (next, m);
        }
        if miss.length() < 1e-6 { Ok(t) } else { Err(outside) }
    }

    /// A point of a placed screen near the one imaged on (x_um, y_um): that of the foveal magnification taken as an
    /// angle; `None` when no point of the screen is there.
    fn first_guess(&self, um: DVec2) -> Option<DVec2> {
        let degrees = |axis: DVec2| self.screen.visual_deg(STEP * axis) / STEP;
        let degrees =
            DMat2::from_cols(degrees(DVec2::X), degrees(DVec2::Y)) * self.centre_slope.inverse() * um;
        self.screen.at_visual_deg(degrees.clamp_length_max(80.0))
    }

    /// Visual field angles (x_deg right, y_deg up, as the viewer sees the screen) of (x_um, y_um): the angle between its
    /// direction and the line of sight, along the direction on the screen.
    ///
    /// # Errors
    /// As [`Projection::screen_tangent`].
    pub fn visual_deg(&self, um: DVec2) -> Result<DVec2, OpticsError> {
        Ok(self.screen.visual_deg(self.screen_tangent(um)?))
    }

    /// Unit vector from (x_um, y_um) towards the exit pupil, that is, back along the chief ray that lands there at the
    /// reference wavelength: components along the local x_um tangent, y_um tangent and the normal into the eye.
    ///
    /// # Errors
    /// As [`Projection::screen_tangent`].
    pub fn exit_pupil_direction(&self, um: DVec2) -> Result<DVec3, OpticsError> {
        self.exit_direction_at(self.screen_tangent(um)?)
    }

    pub(super) fn exit_direction_at(&self, t: DVec2) -> Result<DVec3, OpticsError> {
        let object = self.object(t);
        let chief = self.eye.chief_ray(object, self.eye.prescription().reference_wavelength_nm)?;
        let landing = chief.landing().ok_or(OpticsError::NoRay { angle_deg: object.angle_deg() })?;
        let frame = self.eye.fovea().local_frame(landing);
        Ok(DVec3::from_array(frame.map(|axis| -chief.direction.dot(axis))))
    }

    /// Polynomials for the inverse over a rectangle of the retina, (x_um, y_um) from `min_um` to `max_um`.
    ///
    /// # Errors
    /// [`OpticsError::OutsideField`] when a part of the rectangle sees no screen; [`OpticsError::OutOfRange`] for an
    /// empty rectangle.
    pub fn fit(&self, min_um: DVec2, max_um: DVec2) -> Result<ProjectionFit, OpticsError> {
        ProjectionFit::new(self, min_um, max_um)
    }
}
