//! `study optics`: the schematic eye and its images (§8, §12, §16, §21), and six ways to a point spread by error and time.

mod absorption;
mod checks;
mod chromatic;
mod drawing;
mod fan;
mod focus;
mod methods;
mod papers_settings;
mod spots;
mod spread;
mod transfer;

use photoneye_eye::optics::{Dispersion, EyeState, OpticsError, Prescription, SchematicEye, Side};

use super::Task;
use super::page::Page;
use crate::failure::Failure;

/// The eye that is looked into.
const EYE: &str = "escudero-sanz-navarro";
/// Wavelength at which the eye is emmetropic, nm.
const NM: f64 = 543.0;
/// Angle between the optical axis and the fovea, degrees.
const FOVEA_DEG: f64 = 5.0;

/// Fills the page.
pub fn study(task: &mut Task, page: &mut Page) -> Result<(), Failure> {
    page.begin(
        "Optics of the schematic eye",
        "Escudero-Sanz and Navarro (1999) with the pupil 0.4 mm off the axis and the fovea at 5 degrees (Deering 2005, sections 8 \
         to 21). 543 nm, Herzberger's dispersion, no accommodation, flux-true amplitudes, where nothing else is said.",
    );
    task.say("rays");
    drawing::study(page)?;
    fan::study(page)?;
    task.say("spots and point spreads");
    spots::study(page)?;
    spread::study(task, page)?;
    task.say("transfer");
    transfer::study(page)?;
    task.say("focus and colour");
    focus::study(page)?;
    chromatic::study(page)?;
    task.say("closed forms");
    checks::study(page)?;
    absorption::study(page)?;
    methods::study(task, page)?;
    papers_settings::study(task, page)
}

/// The eye's data.
fn prescription() -> Result<Prescription, Failure> {
    Prescription::preset(EYE).map_err(Failure::failed)
}

/// State of the eye with a pupil (mm) and nominal accommodation.
fn state(pupil_mm: f64, accommodation_a: f64) -> EyeState {
    let dispersion = Dispersion::Herzberger;
    EyeState { pupil_mm, decentre_mm: 0.4, accommodation_a, dispersion, side: Side::Right }
}

/// The unaccommodated eye with a pupil, mm.
fn eye(pupil_mm: f64) -> Result<SchematicEye, Failure> {
    SchematicEye::new(&prescription()?, &state(pupil_mm, 0.0)).map_err(failed)
}

/// The optics' refusal of what a study asks.
fn failed(error: OpticsError) -> Failure {
    Failure::failed(error)
}
