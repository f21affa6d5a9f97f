//! The eye's optics (§8, §9, §12, §16): prescription, surfaces, rays, chief rays, screen ↔ retina.
//!
//! Frame: mm, origin at the corneal apex, +z into the eye, right-handed. The image of the fovea lies at +y (the
//! temporal retina); a plane wave from field angle th travels along (0, sin th, cos th). The stop centre is at
//! y = −decentre. In a right eye +y is the subject's right and −x is up; in a left eye −y is right and +x is up.
//!
//! Wavelengths are vacuum wavelengths in nm. A ray ends in a [`RayFate`], never in a NaN.

pub mod accommodation;
pub mod aim;
pub mod beam;
pub mod beam_field;
pub mod bundle;
pub mod cardinal;
pub mod dispersion;
pub mod error;
pub mod field_fit;
pub mod field_rays;
pub mod fixation;
pub mod gradient;
pub mod object;
pub mod population;
pub mod prescription;
pub mod projection;
pub mod projection_fit;
pub mod pupil;
pub mod retina_frame;
pub mod schematic_eye;
pub mod screen;
pub mod shells;
pub mod surface;
pub mod toric;
pub mod trace;
pub mod zernike;

pub use beam_field::BeamField;
pub use bundle::{PupilBundle, PupilNodes, PupilRay};
pub use cardinal::Cardinal;
pub use dispersion::Dispersion;
pub use error::OpticsError;
pub use field_fit::FieldFit;
pub use field_rays::{FieldRay, field_ray, field_rays};
pub use fixation::{Fixation, ScreenPose};
pub use object::Object;
pub use prescription::{Prescription, Side};
pub use projection::Projection;
pub use projection_fit::ProjectionFit;
pub use retina_frame::Fovea;
pub use schematic_eye::{EyeState, SchematicEye};
pub use screen::Screen;
pub use trace::{Ray, RayFate, Traced};
