//! What the model leaves out of the spread: the lens is thinner towards the edge of the pupil and absorbs less there (§17).
//!
//! The model takes the mean of the transmission over the pupil. Its shape over the pupil acts as an apodization: with D the lens's axial
//! density and r the height in the lens, path = thickness − r²/2·(1/R_front + 1/|R_back|), so the transmission is 10^(−D + ρ r²), which is
//! the Stiles–Crawford form with a negative coefficient.

use photoneye_eye::media::Media;
use photoneye_eye::optics::Object;
use photoneye_eye::psf::{PsfGrid, StilesCrawfordApodization, Wavefront, WavefrontOptions, psf};

use super::super::page::{Page, Table};
use super::{FOVEA_DEG, eye, failed, methods, prescription};
use crate::failure::Failure;
use crate::row;

/// Adds the table.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Absorption over the pupil");
    let p = prescription()?;
    let media = Media::new(1.0, 0.35).map_err(Failure::failed)?;
    let bending = 0.5 * (1.0 / p.lens_front.radius_mm + 1.0 / p.lens_back.radius_mm.abs());
    let mut table = Table::new(
        "absorption",
        "What the mean transmission leaves out of the spread (the model's omission)",
        &[
            "pupil_mm",
            "wavelength_nm",
            "lens density",
            "rho, 1/mm² of entrance pupil",
            "L1 change of the spread",
        ],
    );
    for pupil in [3.0, 6.0] {
        let eye = eye(pupil)?;
        let entrance_mm = eye.entrance_radius_mm().map_err(failed)?;
        for nm in [420.0, 450.0, 500.0, 550.0, 600.0] {
            let density = media.lens_density(nm);
            let rho = -density * bending
                / (p.lens_front.thickness_mm * (entrance_mm / eye.stop_radius_mm()).powi(2));
            let object = Object::field(FOVEA_DEG, 0.0).map_err(failed)?;
            let spread = |rho: f64| {
                let stiles_crawford = Some(StilesCrawfordApodization { rho_base10_per_mm2: rho });
                let options = WavefrontOptions { stiles_crawford, ..WavefrontOptions::default() };
                let w = Wavefront::new(&eye, object, nm, &options).map_err(failed)?;
                let factor = w.density_per_um2() / w.throughput();
                let image = psf(&w, &PsfGrid::new(128, 20.0));
                Ok::<_, Failure>(image.into_iter().map(|v| factor * v).collect::<Vec<f64>>())
            };
            let changed = methods::error(&spread(rho)?, &spread(0.0)?);
            table.push(row![pupil, nm, density, rho, changed]);
        }
    }
    page.table(table);
    Ok(())
}
