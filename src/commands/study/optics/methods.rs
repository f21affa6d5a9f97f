//! Six ways to a point spread by error and CPU time: random, stratified, lattice and Gauss rays, the Fourier transform of the pupil, the
//! fitted matrix form; with §21's literal sum (1,024 rays to each of 128 × 128 points) as the anchor.
//!
//! Error: Σ|value − reference|/Σ reference over the window; reference: Gauss rays until twice as many change nothing. Time: everything
//! from tracing on, CPU seconds of all threads.

use photoneye_eye::optics::{Object, SchematicEye};
use photoneye_eye::psf::{
    PsfGrid, PupilSampling, Wavefront, WavefrontOptions, huygens, psf, sampled, sampled_fft,
};

use super::super::Task;
use super::super::clock::{kind, measure};
use super::super::page::{Page, Table};
use super::{FOVEA_DEG, NM, eye, failed};
use crate::chart::{Axis, Chart, DARK, PALETTE, Series, Style, page as chart_page};
use crate::failure::Failure;
use crate::row;

/// A point spread to compute.
struct Case {
    pupil_mm: f64,
    vergence_d: f64,
    eye: SchematicEye,
    object: Object,
    grid: PsfGrid,
    reference: Vec<f64>,
    /// The same error of the reference with half its rays, and of its linear distances against exact ones.
    reference_error: [f64; 2],
}

/// A way with its knob.
#[derive(Clone, Copy)]
enum Way {
    Rays(PupilSampling, usize),
    Fft(usize),
    Fit(usize),
    Literal(PupilSampling),
}

const NAMES: [&str; 6] = [
    "random rays",
    "stratified rays",
    "lattice of rays",
    "Gauss rays",
    "Fourier transform",
    "fitted matrix form",
];

/// Adds charts and tables.
pub fn study(task: &mut Task, page: &mut Page) -> Result<(), Failure> {
    page.heading("Error against time of six ways to a point spread");
    let mut all = Table::new(
        "methods",
        "Error (L1 over the window) and time of every method and setting",
        &["pupil_mm", "object_D", "window_um", "method", "rays_or_setting", "seconds", "error"],
    )
    .long();
    let mut best = Table::new(
        "methods-best",
        &format!("Least {} for an error below a bound; -: not reached", kind()),
        &["pupil_mm", "object_D", "method", "error < 0.1", "error < 0.01", "error < 1e-4"],
    );
    let mut anchors = Table::new(
        "methods-paper",
        "The paper's sum: 1,024 rays to each sample of a 128 x 128 window; and what the reference is worth",
        &[
            "pupil_mm",
            "object_D",
            "window_um",
            "seconds",
            "error, stratified",
            "error, random",
            "reference, half the rays",
            "linear distances",
        ],
    );
    let mut charts = Vec::new();
    let cases: &[(f64, f64)] = task.pick(
        &[(2.0, 0.0), (3.0, 0.0), (6.0, 0.0), (2.0, 1.0), (3.0, 1.0), (6.0, 1.0)],
        &[(3.0, 0.0), (3.0, 1.0)],
    );
    for (pupil_mm, vergence_d) in cases {
        task.say(&format!("methods, {pupil_mm} mm, {vergence_d} D"));
        let case = Case::new(task, *pupil_mm, *vergence_d)?;
        charts.push(case.compare(task, &mut all, &mut best, &mut anchors)?);
    }
    page.picture(
        "methods",
        "Error (L1 over the window) against time, one point spread with everything from tracing on. Points of a curve: 64 to 65,536 rays, \
         16 to 2,048 samples across the pupil, polynomials of degree 4 to 16.",
        chart_page("Ways to a point spread, 543 nm, 5°", &charts, task.pick(3, 2)),
    );
    page.table(best);
    page.table(anchors);
    page.table(all);
    Ok(())
}

impl Case {
    fn new(task: &Task, pupil_mm: f64, vergence_d: f64) -> Result<Self, Failure> {
        let eye = eye(pupil_mm)?;
        let object = Object::field(FOVEA_DEG, vergence_d).map_err(failed)?;
        // The paper's window: at least 20 µm, and all landing points: a dioptre spreads a pupil of d mm over d·16.4 µm.
        let width = (20.0_f64).max(1.15 * vergence_d.abs() * pupil_mm * 16.44);
        let grid = PsfGrid::new(task.pick(128, 32), 0.5 * width);
        let strong = (pupil_mm / 3.0).powi(2).max(1.0);
        let radial = ((14.0 + 0.65 * 0.5 * width) * strong).min(260.0);
        let rays = (3.0 * radial * radial) as usize;
        let options = WavefrontOptions::default();
        let sum = |rays: usize, grid: &PsfGrid| {
            sampled::psf(&eye, object, NM, &options, &PupilSampling::Gauss.points(rays, 0), grid)
                .map_err(failed)
        };
        let reference = sum(rays, &grid)?;
        // What exact distances change, on a coarser grid.
        let coarse = PsfGrid { samples: 16, ..grid };
        let points = PupilSampling::Gauss.points(rays, 0);
        let exact =
            huygens::psf_of_points(&eye, object, NM, &options, &points, true, &coarse).map_err(failed)?;
        let reference_error =
            [error(&sum(rays / 2, &grid)?, &reference), error(&sum(rays, &coarse)?, &exact)];
        Ok(Self { pupil_mm, vergence_d, eye, object, grid, reference, reference_error })
    }

    fn values(&self, way: Way, seed: u64) -> Result<Vec<f64>, Failure> {
        let (eye, object, grid) = (&self.eye, self.object, &self.grid);
        let options = WavefrontOptions::default();
        match way {
            Way::Rays(sampling, rays) => {
                sampled::psf(eye, object, NM, &options, &sampling.points(rays, seed), grid).map_err(failed)
            }
            Way::Literal(sampling) => {
                huygens::psf_of_points(eye, object, NM, &options, &sampling.points(1024, seed), true, grid)
                    .map_err(failed)
            }
            Way::Fft(across) => {
                let w = Wavefront::new(eye, object, NM, &options).map_err(failed)?;
                Ok(sampled_fft::psf(&w, grid, across, sampled_fft::Edge::Staircase))
            }
            Way::Fit(degree) => {
                let options = WavefrontOptions { degree: Some(degree), ..options };
                Ok(psf(&Wavefront::new(eye, object, NM, &options).map_err(failed)?, grid))
            }
        }
    }

    /// Mean error over `seeds`, and seconds.
    fn judge(&self, way: Way, seeds: u64) -> Result<(f64, f64), Failure> {
        let (values, seconds) = measure(0.04, || self.values(way, 1));
        let mut sum = error(&values?, &self.reference);
        for seed in 2..=seeds {
            sum += error(&self.values(way, seed)?, &self.reference);
        }
        Ok((sum / seeds as f64, seconds))
    }

    fn compare(
        &self,
        task: &Task,
        all: &mut Table,
        best: &mut Table,
        anchors: &mut Table,
    ) -> Result<Chart, Failure> {
        let rays: Vec<usize> = (6..=task.pick(16, 12)).step_by(2).map(|k| 1 << k).collect();
        let mut series = Vec::new();
        for (k, name) in NAMES.into_iter().enumerate() {
            let of_rays = |sampling| rays.iter().map(|n| Way::Rays(sampling, *n)).collect();
            let ways: Vec<Way> = match k {
                0 => of_rays(PupilSampling::Random),
                1 => of_rays(PupilSampling::Stratified),
                2 => of_rays(PupilSampling::Grid),
                3 => of_rays(PupilSampling::Gauss),
                4 => (4..=task.pick(11, 8)).map(|k| Way::Fft(1 << k)).collect(),
                _ => [4, 6, 8, 10, 12, 14, 16].map(Way::Fit).to_vec(),
            };
            let mut points = Vec::new();
            for way in ways {
                let chance = matches!(way, Way::Rays(PupilSampling::Random | PupilSampling::Stratified, _));
                let (error, seconds) = self.judge(way, if chance { task.pick(3, 1) } else { 1 })?;
                let (Way::Rays(_, setting) | Way::Fft(setting) | Way::Fit(setting)) = way else { continue };
                all.push(row![self.pupil_mm, self.vergence_d, self.width(), name, setting, seconds, error]);
                points.push((seconds, error));
            }
            let within = |bound: f64| {
                let times = points.iter().filter(|p| p.1 < bound).map(|p| p.0);
                times.reduce(f64::min).map_or("-".to_owned(), super::super::page::figures)
            };
            best.push(row![self.pupil_mm, self.vergence_d, name, within(0.1), within(0.01), within(1e-4)]);
            series.push(Series::new(name, points, Style::Both, PALETTE[k]));
        }
        let (stratified, seconds) = self.judge(Way::Literal(PupilSampling::Stratified), 1)?;
        let (random, _) = self.judge(Way::Literal(PupilSampling::Random), task.pick(2, 1))?;
        let [half, linear] = self.reference_error;
        anchors.push(row![
            self.pupil_mm,
            self.vergence_d,
            self.width(),
            seconds,
            stratified,
            random,
            half,
            linear
        ]);
        let paper = vec![(seconds, stratified), (seconds, random)];
        series.push(Series::new("paper: 1,024 rays, stratified and random", paper, Style::Points, DARK));
        Ok(Chart {
            title: format!("{} mm, {} D, {:.0} µm window", self.pupil_mm, self.vergence_d, self.width()),
            x: Axis::log(kind()),
            y: Axis::log("relative error, L1"),
            series,
            bands: Vec::new(),
        })
    }

    fn width(&self) -> f64 {
        2.0 * self.grid.half_width_um
    }
}

/// Σ|a − b|/Σb.
pub(super) fn error(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / b.iter().sum::<f64>()
}
