//! What each of the paper's settings (§21, §22) costs in accuracy, one at a time: number of rays, window, wavelength steps, nodes.
//!
//! Error: ∫|PSF − right one| over the plane, for densities that hold the same light. A window that is cut and made to hold all light is
//! wrong by the light outside and by as much inside.

use photoneye_eye::optics::Object;
use photoneye_eye::psf::{PsfGrid, PupilSampling, Wavefront, WavefrontOptions, psf, sampled};

use super::super::Task;
use super::super::page::{Page, Table};
use super::methods::error;
use super::{FOVEA_DEG, NM, eye, failed};
use crate::failure::Failure;
use crate::row;

/// Window in which differences are summed, µm.
const WIDE_UM: f64 = 80.0;
/// The paper's window, µm.
const WINDOW_UM: f64 = 20.0;
/// Half of the paper's spacing of point spreads, 300 µm, in visual degrees of 287 µm.
const HALF_NODE_DEG: f64 = 150.0 / 287.0;

/// Adds the table.
pub fn study(task: &Task, page: &mut Page) -> Result<(), Failure> {
    page.heading("What the paper's settings cost");
    let mut table = Table::new(
        "papers-settings",
        "Error of a point spread by each setting of the paper alone (L1; worst place and wavelength of a step)",
        &[
            "pupil_mm",
            "object_D",
            "1,024 stratified rays",
            "1,024 random rays",
            "20 µm window made whole",
            "10 nm steps (5 nm off)",
            "300 µm nodes (150 µm off)",
        ],
    );
    let cases: &[(f64, f64)] =
        task.pick(&[(2.0, 0.0), (3.0, 0.0), (6.0, 0.0), (3.0, 0.5), (6.0, 0.5)], &[(3.0, 0.0)]);
    for (pupil, vergence) in cases {
        let eye = eye(*pupil)?;
        let options = WavefrontOptions::default();
        let grid = PsfGrid::new(task.pick(320, 160), 0.5 * WIDE_UM);
        let at = |field: f64, nm: f64| -> Result<(Vec<f64>, f64), Failure> {
            let w = Wavefront::new(&eye, Object::field(field, *vergence).map_err(failed)?, nm, &options)
                .map_err(failed)?;
            let density = w.density_per_um2() * grid.pitch_um().powi(2);
            Ok((psf(&w, &grid).iter().map(|v| v * density).collect(), density))
        };
        let (right, density) = at(FOVEA_DEG, NM)?;
        let object = Object::field(FOVEA_DEG, *vergence).map_err(failed)?;
        let rays = |sampling: PupilSampling| -> Result<f64, Failure> {
            // Within the paper's window, as the paper has it.
            let small = PsfGrid::new(128, 0.5 * WINDOW_UM);
            let got = sampled::psf(&eye, object, NM, &options, &sampling.points(1024, 1), &small)
                .map_err(failed)?;
            let w = Wavefront::new(&eye, object, NM, &options).map_err(failed)?;
            Ok(error(&got, &psf(&w, &small)))
        };
        let small = PsfGrid::new(256, 0.5 * WINDOW_UM);
        let w = Wavefront::new(&eye, object, NM, &options).map_err(failed)?;
        let inside =
            psf(&w, &small).iter().sum::<f64>() * density * (small.pitch_um() / grid.pitch_um()).powi(2);
        table.push(row![
            *pupil,
            *vergence,
            rays(PupilSampling::Stratified)?,
            rays(PupilSampling::Random)?,
            2.0 * (1.0 - inside),
            error(&at(FOVEA_DEG, NM + 5.0)?.0, &right),
            error(&at(FOVEA_DEG + HALF_NODE_DEG, NM)?.0, &right)
        ]);
    }
    page.table(table);
    Ok(())
}
