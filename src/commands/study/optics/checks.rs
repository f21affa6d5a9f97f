//! Published values, closed forms and sums: cardinal points, the Airy disc, the light in growing windows, single against double precision.

use std::f64::consts::{PI, TAU};

use photoneye_eye::optics::{Object, PupilBundle, PupilNodes};
use photoneye_eye::psf::polynomial::Polynomial2;
use photoneye_eye::psf::{PsfGrid, Wavefront, WavefrontOptions, psf, sampled_fft};

use super::super::page::{Page, Table};
use super::{FOVEA_DEG, NM, eye, failed};
use crate::failure::Failure;
use crate::row;

/// Adds the tables.
pub fn study(page: &mut Page) -> Result<(), Failure> {
    page.heading("Published values, closed forms and sums");
    page.table(cardinal()?);
    page.table(airy());
    page.table(windows()?);
    page.table(precision()?);
    Ok(())
}

/// Paraxial values at 543 nm beside those that follow from the published eye (Escudero-Sanz and Navarro 1999; "1.13" is Deering's §16).
fn cardinal() -> Result<Table, Failure> {
    let found = eye(3.0)?.cardinal(NM);
    let mut table = Table::new(
        "cardinal",
        "Cardinal values at 543 nm; places in mm from the corneal apex",
        &["value", "traced", "published eye", "difference"],
    );
    for (name, traced, published) in [
        ("power, D", found.power_d, 60.7242),
        ("entrance pupil", found.entrance_pupil_z_mm, 3.0401),
        ("entrance pupil / stop", found.stop_magnification, 1.13341),
        ("exit pupil", found.exit_pupil_z_mm, 3.6825),
        ("first nodal point", found.first_nodal_z_mm, 7.1437),
        ("second nodal point", found.second_nodal_z_mm, 7.4524),
    ] {
        table.push(row![name, traced, published, traced - published]);
    }
    Ok(table)
}

/// Bessel's J1: (1/π)∫cos(t − x sin t) dt over 0 to π; the trapezoidal rule is exact to rounding for x below the number of nodes.
fn j1(x: f64) -> f64 {
    const NODES: u32 = 256;
    let f = |k: u32| {
        let t = PI * f64::from(k) / f64::from(NODES);
        (t - x * t.sin()).cos()
    };
    ((1..NODES).map(f).sum::<f64>() + 0.5 * (f(0) + f(NODES))) / f64::from(NODES)
}

/// Largest difference from (2 J1(x)/x)² for a disc of direction cosines without path differences.
fn airy() -> Table {
    let (sine, index) = (0.075, 1.336);
    let w = Wavefront::disc(sine, NM, index, Polynomial2::new(0, vec![0.0]));
    let grid = PsfGrid::new(128, 10.0);
    let exact: Vec<f64> = (0..128 * 128)
        .map(|k| {
            let r = grid.offset(k / 128).hypot(grid.offset(k % 128));
            let x = TAU * sine * r / w.wavelength_um();
            (2.0 * j1(x) / x).powi(2)
        })
        .collect();
    let worst = |values: &[f64]| values.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let mut table = Table::new(
        "airy",
        "Airy disc against its closed form, 20 µm, 128 x 128",
        &["method", "largest difference / peak"],
    );
    table.push(row!["matrix form", worst(&psf(&w, &grid))]);
    for across in [64, 256, 1024] {
        table.push(row![
            format!("Fourier transform, {across} samples across"),
            worst(&sampled_fft::psf(&w, &grid, across, sampled_fft::Edge::Staircase))
        ]);
    }
    table
}

/// Light in square windows about the chief ray.
fn windows() -> Result<Table, Failure> {
    let mut table = Table::new(
        "windows",
        "Light inside a square window, 543 nm (the paper's 20 µm window, made to hold all light, moves the rest inside)",
        &["pupil_mm", "object_D", "10 µm", "20 µm", "40 µm", "80 µm", "160 µm", "320 µm"],
    );
    for (pupil, vergence) in [(2.0, 0.0), (3.0, 0.0), (6.0, 0.0), (3.0, 0.55), (3.0, 1.0), (6.0, 1.0)] {
        let object = Object::field(FOVEA_DEG, vergence).map_err(failed)?;
        let w = Wavefront::new(&eye(pupil)?, object, NM, &WavefrontOptions::default()).map_err(failed)?;
        let mut row = row![pupil, vergence];
        for width in [10.0, 20.0, 40.0, 80.0, 160.0, 320.0] {
            // Samples no farther apart than half the finest fringe.
            let samples =
                (width / (0.25 * w.wavelength_um() / (2.0 * 0.0285 * pupil))).ceil().clamp(64.0, 640.0);
            let grid = PsfGrid::new(samples as usize, 0.5 * width);
            let sum: f64 = psf(&w, &grid).iter().sum();
            row.push((sum * w.density_per_um2() * grid.pitch_um().powi(2)).into());
        }
        table.push(row);
    }
    Ok(table)
}

/// The same sum over the same rays with numbers rounded to single precision.
fn precision() -> Result<Table, Failure> {
    let mut table = Table::new(
        "precision",
        "Huygens' sum over 1,320 rays: what single precision costs (33 x 33 samples, 20 µm)",
        &["pupil_mm", "object_D", "path differences and sums in f32", "whole path lengths in f32"],
    );
    for (pupil, vergence) in [(3.0, 0.0), (6.0, 1.0)] {
        let object = Object::field(FOVEA_DEG, vergence).map_err(failed)?;
        let nodes = PupilNodes { radial: 20, azimuth: 66, edge: 0 };
        let bundle = PupilBundle::trace(&eye(pupil)?, object, NM, nodes).map_err(failed)?;
        let double = spread(&bundle, |opd, tilt| (opd + tilt) / (bundle.wavelength_mm() * 1e3));
        let wave = (bundle.wavelength_mm() * 1e3) as f32;
        let differences = spread(&bundle, |opd, tilt| f64::from((opd as f32 + tilt as f32) / wave));
        // The path from 25 mm before the pupil to the retina, as a ray tracer in single precision would hold it.
        let whole = bundle.chief.optical_path_mm * 1e3 / bundle.n_vitreous;
        let absolute = spread(&bundle, |opd, tilt| {
            f64::from(((whole + opd) as f32 - whole as f32 + tilt as f32) / wave)
        });
        let error = |a: &[f64]| {
            let off: f64 = a.iter().zip(&double).map(|(x, y)| (x - y).abs()).sum();
            off / double.iter().sum::<f64>()
        };
        table.push(row![pupil, vergence, error(&differences), error(&absolute)]);
    }
    Ok(table)
}

/// |Σ w·exp(2πi·turns)|² on a small grid, µm in, turns out.
fn spread(bundle: &PupilBundle, turns: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let grid = PsfGrid::new(33, 10.0);
    (0..33 * 33)
        .map(|k| {
            let (x, y) = (grid.offset(k / 33), grid.offset(k % 33));
            let (re, im) = bundle.rays.iter().fold((0.0, 0.0), |(re, im), ray| {
                let (sin, cos) = (TAU * turns(ray.opd_mm * 1e3, -ray.q.x * x - ray.q.y * y)).sin_cos();
                (re + ray.weight * cos, im + ray.weight * sin)
            });
            (re * re + im * im) / (PI * PI)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bessel_and_airy() {
        // Abramowitz & Stegun, table 9.1: J1(1), J1(10); first zero 3.8317059702.
        for (x, value) in
            [(1.0, 0.440_050_585_744_933_5), (10.0, 0.043_472_746_168_861_44), (3.831_705_970_207_512, 0.0)]
        {
            assert!((j1(x) - value).abs() < 1e-13, "{x}: {}", j1(x));
        }
        assert!(matches!(airy().rows[0][1], super::super::super::page::Cell::Number(worst) if worst < 1e-9));
    }
}
