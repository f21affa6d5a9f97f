//! A prescription in a state (pupil, accommodation, dispersion, side): the eye that rays are traced through.

use super::accommodation::LEAST_A;
use super::cardinal::Cardinal;
use super::dispersion::Dispersion;
use super::error::{OpticsError, in_range};
use super::gradient::GradientLens;
use super::object::Object;
use super::prescription::{Prescription, Side, SurfaceData};
use super::retina_frame::Fovea;
use super::surface::{Conic, Surface};
use super::toric::Toric;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What changes from moment to moment, or from question to question.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EyeState {
    /// Entrance pupil diameter as seen along the line of sight from afar, mm, 0.5 to 9: the stop is such that the beam of
    /// parallel light from there has the area π d²/4 at the reference wavelength ([`super::beam`]).
    pub pupil_mm: f64,
    /// Decentre of the stop towards −y (nasal pupil), mm, −1 to 1.
    pub decentre_mm: f64,
    /// Nominal accommodation within the range of the eye's law; 0 is unaccommodated, and all there is without a law.
    pub accommodation_a: f64,
    /// Dispersion law.
    pub dispersion: Dispersion,
    /// Which eye.
    pub side: Side,
}

/// An eye ready to trace.
#[derive(Clone, Debug, PartialEq)]
pub struct SchematicEye {
    pub(super) prescription: Prescription,
    pub(super) state: EyeState,
    pub(super) surfaces: [Surface; 5],
    pub(super) gradient: Option<GradientLens>,
    pub(super) stop_z: f64,
    pub(super) stop_radius_mm: f64,
    stop_magnification: f64,
    lens_index_shift: f64,
    thickness_mm: [f64; 4],
    pub(super) exit_pupil: DVec3,
    pub(super) entrance_pupil: DVec3,
    object_distance_mm: f64,
    fovea: Fovea,
}

/// A surface with its vertex, radius and conic constant in this state (`along`); the second meridian of a toric one keeps its
/// differences to the first.
fn placed(data: &SurfaceData, along: Conic, side: Side) -> Surface {
    let Some(toric) = data.toric else { return Surface { conic: along, toric: None } };
    let radius = along.radius + (toric.radius_mm - data.radius_mm);
    let conic = along.conic + (toric.conic - data.conic);
    let curvature = [1.0 / along.radius, 1.0 / radius];
    let [right, up] = side.clinician_axes();
    let (sin, cos) = crate::math::sin_cos(toric.axis_deg.to_radians());
    let axis = cos * right + sin * up;
    let mean =
        Conic { radius: 2.0 / (curvature[0] + curvature[1]), conic: 0.5 * (along.conic + conic), ..along };
    let toric = Toric { vertex_z: along.vertex_z, axis, curvature, conic: [along.conic, conic] };
    Surface { conic: mean, toric: Some(toric) }
}

impl SchematicEye {
    /// The eye of a prescription in a state, with its foveal centre for objects at infinity; see
    /// [`SchematicEye::at_distance`].
    ///
    /// # Errors
    /// [`OpticsError::OutOfRange`] names the field; [`OpticsError::NoRay`] when no chief ray reaches the retina.
    pub fn new(p: &Prescription, s: &EyeState) -> Result<Self, OpticsError> {
        p.validate()?;
        let stop_magnification = Self::relaxed_magnification(p, s);
        Self::with_stop(p, s, s.pupil_mm / stop_magnification)?.with_pupil(s.pupil_mm)
    }

    /// The same eye with a stop of a given diameter (mm), whatever entrance pupil that gives: for comparison with packages in
    /// which the stop's size is an input. `pupil_mm` of the state still scales what is given over the entrance pupil (the
    /// Stiles-Crawford effect, a measured wavefront).
    ///
    /// # Errors
    /// As [`SchematicEye::new`].
    pub fn with_stop(p: &Prescription, s: &EyeState, stop_mm: f64) -> Result<Self, OpticsError> {
        p.validate()?;
        in_range("pupil_mm", s.pupil_mm, 0.5, 9.0)?;
        in_range("decentre_mm", s.decentre_mm, -1.0, 1.0)?;
        let law = p.accommodation;
        let (least, most) = law.map_or((0.0, 0.0), |law| (LEAST_A, law.most_a));
        in_range("accommodation_a", s.accommodation_a, least, most)?;
        p.check_dispersion(s.dispersion)?;
        if let Some(wavefront) = &p.wavefront {
            in_range("pupil_mm (with a measured wavefront)", s.pupil_mm, 0.5, wavefront.pupil_mm + 1e-9)?;
        }
        let (front, back, depth, thickness, _) = p.accommodated(s.accommodation_a);
        in_range("lens front radius, accommodated (mm)", front.0, 1.0, 100.0)?;
        in_range("lens back radius, accommodated (mm)", back.0, -100.0, -1.0)?;
        in_range("aqueous depth, accommodated (mm)", depth, 0.5, 7.0)?;
        in_range("lens thickness, accommodated (mm)", thickness, 0.5, 9.0)?;
        let stop_magnification = Self::relaxed_magnification(p, s);
        in_range("stop diameter (mm)", stop_mm, 0.1, 10.0)?;
        Self::build(p, s, 0.5 * stop_mm, stop_magnification).at_distance(f64::INFINITY)
    }

    /// The same eye with its foveal centre defined by an object at `distance_mm` from the corneal apex (50 mm to ∞).
    ///
    /// # Errors
    /// As [`SchematicEye::new`].
    pub fn at_distance(mut self, distance_mm: f64) -> Result<Self, OpticsError> {
        in_range("object distance (mm)", distance_mm, 50.0, f64::INFINITY)?;
        let object = Object::field(self.prescription.fovea_angle_deg, 1e3 / distance_mm)?;
        let chief = self.chief_ray(object, self.prescription.reference_wavelength_nm)?;
        let landing =
            chief.landing().ok_or(OpticsError::NoRay { angle_deg: self.prescription.fovea_angle_deg })?;
        self.object_distance_mm = distance_mm;
        self.fovea = Fovea::new(landing, self.retina_centre(), self.state.side);
        Ok(self)
    }

    fn relaxed_magnification(p: &Prescription, s: &EyeState) -> f64 {
        let dispersion = if p.polyline.is_some() { Dispersion::Polyline } else { s.dispersion };
        let relaxed = EyeState { accommodation_a: 0.0, dispersion, ..*s };
        Self::build(p, &relaxed, 1.0, 1.0).cardinal(p.reference_wavelength_nm).stop_magnification
    }

    pub(super) fn build(
        p: &Prescription,
        s: &EyeState,
        stop_radius_mm: f64,
        stop_magnification: f64,
    ) -> Self {
        let (lens_front, lens_back, depth, lens_thickness, lens_index_shift) =
            p.accommodated(s.accommodation_a);
        let cornea = p.cornea_front.thickness_mm;
        let length = p.axial_length_mm();
        let stop_z = cornea + depth;
        let back_z = stop_z + lens_thickness;
        // Place the surfaces from the corneal apex on.
        let conic = |vertex_z, radius, conic| Conic { vertex_z, radius, conic };
        let surface = |data: &SurfaceData, base: Conic| placed(data, base, s.side);
        let surfaces = [
            surface(&p.cornea_front, conic(0.0, p.cornea_front.radius_mm, p.cornea_front.conic)),
            surface(&p.cornea_back, conic(cornea, p.cornea_back.radius_mm, p.cornea_back.conic)),
            surface(&p.lens_front, conic(stop_z, lens_front.0, lens_front.1)),
            surface(&p.lens_back, conic(back_z, lens_back.0, lens_back.1)),
            Surface { conic: conic(length, p.retina_radius_mm, 0.0), toric: None },
        ];
        let gradient = p.lens_gradient.as_ref().filter(|g| !g.parts.is_empty());
        let gradient = gradient.map(|g| GradientLens::new(g, stop_z, lens_thickness));
        let centre = DVec3::new(0.0, 0.0, length + p.retina_radius_mm);
        let mut eye = Self {
            prescription: p.clone(),
            state: *s,
            surfaces,
            gradient,
            stop_z,
            stop_radius_mm,
            stop_magnification,
            lens_index_shift,
            thickness_mm: [cornea, depth, lens_thickness, length - back_z],
            exit_pupil: DVec3::ZERO,
            entrance_pupil: DVec3::ZERO,
            object_distance_mm: f64::INFINITY,
            fovea: Fovea::new(centre + DVec3::new(0.0, 0.0, -p.retina_radius_mm), centre, s.side),
        };
        // The pupils are images of the stop.
        let cardinal: Cardinal = eye.cardinal(p.reference_wavelength_nm);
        let pupil = |m: f64, z| DVec3::new(0.0, -s.decentre_mm * m, z);
        eye.entrance_pupil = pupil(cardinal.stop_magnification, cardinal.entrance_pupil_z_mm);
        eye.exit_pupil = pupil(cardinal.exit_magnification, cardinal.exit_pupil_z_mm);
        eye
    }

    /// Indices of air, cornea, aqueous, lens and vitreous at a vacuum wavelength (nm), in this state.
    pub fn indices(&self, wavelength_nm: f64) -> [f64; 5] {
        let mut n = self.prescription.indices(self.state.dispersion, wavelength_nm);
        n[3] += self.lens_index_shift;
        n
    }

    /// The foveal centre: where the chief ray at the reference wavelength lands that comes from the fovea's angle and
    /// the object distance in use; with the frame of retinal positions.
    pub fn fovea(&self) -> Fovea {
        self.fovea
    }

    /// The object distance in use, mm from the corneal apex.
    pub fn object_distance_mm(&self) -> f64 {
        self.object_distance_mm
    }

    /// The prescription.
    pub fn prescription(&self) -> &Prescription {
        &self.prescription
    }

    /// The state.
    pub fn state(&self) -> EyeState {
        self.state
    }

    /// Centre of the stop, mm.
    pub fn stop_centre(&self) -> DVec3 {
        DVec3::new(0.0, -self.state.decentre_mm, self.stop_z)
    }

    /// Radius of the physical stop, mm.
    pub fn stop_radius_mm(&self) -> f64 {
        self.stop_radius_mm
    }

    /// Paraxial entrance pupil diameter / stop diameter (unaccommodated, reference wavelength).
    pub fn stop_magnification(&self) -> f64 {
        self.stop_magnification
    }

    /// Axial thickness of cornea, aqueous, lens and vitreous in this state, mm.
    pub fn thickness_mm(&self) -> [f64; 4] {
        self.thickness_mm
    }

    /// Centre of the paraxial exit pupil at the reference wavelength, mm.
    pub fn exit_pupil_centre(&self) -> DVec3 {
        self.exit_pupil
    }

    /// Centre of the retinal sphere, mm.
    pub fn retina_centre(&self) -> DVec3 {
        DVec3::new(0.0, 0.0, self.surfaces[4].conic.vertex_z + self.surfaces[4].conic.radius)
    }

    /// Centre of rotation of the eye, mm: behind the apex and towards the nose (nasal is −y in either eye).
    pub fn rotation_centre(&self) -> DVec3 {
        DVec3::new(
            0.0,
            -self.prescription.rotation_centre_nasal_mm,
            self.prescription.rotation_centre_behind_apex_mm,
        )
    }

    /// Components of a vector of the eye frame along the axes of the view frame ([`super::screen`]).
    pub fn in_view(&self, v: DVec3) -> DVec3 {
        DVec3::from_array(self.view_axes().map(|axis| v.dot(axis)))
    }

    /// Unit vectors of the viewer's right, the viewer's up and the way the light of the fixated point travels, in the
    /// eye frame.
    pub fn view_axes(&self) -> [DVec3; 3] {
        let (sin, cos) = self.prescription.fovea_angle_deg.to_radians().sin_cos();
        let temporal = DVec3::new(0.0, cos, -sin);
        let forward = DVec3::new(0.0, sin, cos);
        match self.state.side {
            Side::Right => [temporal, DVec3::NEG_X, forward],
            Side::Left => [-temporal, DVec3::X, forward],
        }
    }
}
