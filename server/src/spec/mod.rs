//! From the schema's experiment, as it came in through either door, to the model's: defaults filled in, every field checked.

pub mod display;
mod read;
mod scene;

use photoneye_eye::catalog;
use photoneye_eye::experiment::{Counts, Engine, Experiment, Eye, PaperSettings, Retina, StrayLight, Video};
use photoneye_eye::optics::{Dispersion, Side};
use photoneye_eye::retina::{CellWalls, DensityLaw, Dropout, Generator};
use photoneye_proto::{FieldError, v1};

pub use read::field_error;
use read::{choice, in_range, needed, number};

/// The eye that is taken when none is named.
pub const DEFAULT_EYE: &str = "escudero-sanz-navarro";

/// The model's experiment.
///
/// # Errors
/// The first field that is missing, unknown or out of range.
pub fn experiment(spec: &v1::Experiment) -> Result<Experiment, FieldError> {
    let display = display::display(spec.display.as_ref())?;
    let gaze = scene::gaze(spec.gaze.as_ref(), &display)?;
    let video = scene::video(spec.video.as_ref(), &gaze, &display)?;
    let frames = spec.frames.as_ref().and_then(|frames| frames.count);
    let frames = frames.unwrap_or_else(|| match &video {
        Video::Clip(blobs) => (blobs.len() as u32).max(1),
        Video::Pattern(_) => 1,
    });
    let experiment = Experiment {
        eye: eye(spec.eye.as_ref(), display.distance_cm)?,
        retina: retina(spec.retina.as_ref())?,
        display,
        video,
        gaze,
        counts: counts(spec.counts.as_ref())?,
        accuracy_target: number(spec.accuracy.as_ref().and_then(|accuracy| accuracy.target), 0.01),
        frames,
    };
    experiment.validate().map_err(field_error)?;
    Ok(experiment)
}

fn eye(spec: Option<&v1::Eye>, distance_cm: f64) -> Result<Eye, FieldError> {
    use v1::eye::{Dispersion as D, Side as S};
    let spec = spec.cloned().unwrap_or_default();
    let preset = spec.preset.unwrap_or_else(|| DEFAULT_EYE.to_owned());
    if preset != DEFAULT_EYE && catalog::text("eyes", &preset).is_none() {
        let names = catalog::names("eyes").join("`, `");
        let message = format!("unknown eye `{preset}`, expected one of `{names}`");
        return Err(FieldError::new("eye.preset", message));
    }
    let focus = spec.focus.unwrap_or_default();
    let (rho10, pointing_sd_deg) = stiles_crawford(spec.stiles_crawford.as_ref())?;
    Ok(Eye {
        preset,
        side: match choice("eye.side", spec.side, S::Right, S::as_str_name)? {
            S::Right => Side::Right,
            S::Left => Side::Left,
        },
        pupil_mm: number(spec.pupil_mm, 3.0),
        decentre_mm: number(spec.pupil_decentre_mm, 0.4),
        focus_distance_cm: number(focus.distance_cm, distance_cm),
        focus_wavelength_nm: number(focus.wavelength_nm, 543.0),
        dispersion: match choice("eye.dispersion", spec.dispersion, D::Herzberger, D::as_str_name)? {
            D::Herzberger => Dispersion::Herzberger,
            D::Polyline => Dispersion::Polyline,
        },
        macular_peak_density: number(spec.macular_peak_density, 0.404),
        lens_density_scale: number(spec.lens_density_scale, 1.0),
        stiles_crawford_rho10_per_mm2: rho10,
        reflection_losses: spec.reflection_losses.unwrap_or(false),
        stray_light: spec.stray_light.as_ref().map(|stray| StrayLight {
            age_years: number(stray.age_years, 30.0),
            pigmentation: number(stray.pigmentation, 0.5),
        }),
        pointing_sd_deg,
    })
}

/// Coefficient for base 10, and the pointing error.
fn stiles_crawford(spec: Option<&v1::StilesCrawford>) -> Result<(f64, f64), FieldError> {
    use v1::stiles_crawford::Base as B;
    let spec = spec.copied().unwrap_or_default();
    let rho = in_range("eye.stiles_crawford.rho_per_mm2", number(spec.rho_per_mm2, 0.05), 0.0, 0.2)?;
    let rho10 = match choice("eye.stiles_crawford.base", spec.base, B::Ten, B::as_str_name)? {
        B::Ten => rho,
        B::E => rho * std::f64::consts::LOG10_E,
    };
    Ok((rho10, number(spec.perturbation_deg, 1.0)))
}

fn retina(spec: Option<&v1::Retina>) -> Result<Retina, FieldError> {
    use v1::retina::{CellWalls as W, Density as D, Generator as G};
    let spec = spec.copied().unwrap_or_default();
    let default = Retina::default();
    let region_deg = match spec.region_deg {
        None => None,
        Some(region) => Some([
            needed("retina.region_deg.x_min", region.x_min)? + 0.0,
            needed("retina.region_deg.x_max", region.x_max)? + 0.0,
            needed("retina.region_deg.y_min", region.y_min)? + 0.0,
            needed("retina.region_deg.y_max", region.y_max)? + 0.0,
        ]),
    };
    Ok(Retina {
        seed: spec.seed.unwrap_or(default.seed),
        generator: match choice("retina.generator", spec.generator, G::Domain, G::as_str_name)? {
            G::Domain => Generator::Domain,
            G::Ring => Generator::Ring,
        },
        density: match choice("retina.density", spec.density, D::Curcio, D::as_str_name)? {
            D::Curcio => DensityLaw::Curcio,
            D::Tyler => DensityLaw::Tyler,
        },
        cell_walls: match choice("retina.cell_walls", spec.cell_walls, W::Power, W::as_str_name)? {
            W::Power => CellWalls::Power,
            W::Averaging => CellWalls::Averaging,
        },
        peak_density_per_mm2: number(spec.peak_density_per_mm2, default.peak_density_per_mm2),
        total_cones: spec.total_cones.map(|total| total + 0.0),
        cycles: spec.cycles,
        cone_ratio: cone_ratio(spec.cone_ratio.unwrap_or_default())?,
        s_repulsion: number(spec.s_repulsion, default.s_repulsion),
        s_ramp_deg: [
            number(spec.s_free_deg, default.s_ramp_deg[0]),
            number(spec.s_full_deg, default.s_ramp_deg[1]),
        ],
        dropout: spec
            .dropout
            .map(|d| Dropout { fraction: number(d.fraction, 0.0), seed: d.seed.unwrap_or(1) }),
        optic_disc: spec.optic_disc.unwrap_or(default.optic_disc),
        region_deg,
    })
}

/// Shares that sum to 1.
fn cone_ratio(spec: v1::ConeRatio) -> Result<[f64; 3], FieldError> {
    let share = |name: &str, value, default| {
        in_range(&format!("retina.cone_ratio.{name}"), number(value, default), 0.0, 1e6)
    };
    let shares = [share("l", spec.l, 0.62)?, share("m", spec.m, 0.30)?, share("s", spec.s, 0.08)?];
    let sum: f64 = shares.iter().sum();
    if sum < 1e-9 {
        return Err(FieldError::new("retina.cone_ratio", "the shares are all 0"));
    }
    // Shares that sum to 1 but for rounding stay as they are written.
    let scale = if (sum - 1.0).abs() < 1e-12 { 1.0 } else { sum };
    Ok(shares.map(|share| share / scale))
}

fn counts(spec: Option<&v1::Counts>) -> Result<Counts, FieldError> {
    use v1::counts::{Engine as E, Noise as N};
    let spec = spec.copied().unwrap_or_default();
    let settings = spec.settings.unwrap_or_default();
    let paper = PaperSettings::default();
    Ok(Counts {
        engine: match choice("counts.engine", spec.engine, E::Auto, E::as_str_name)? {
            E::Auto | E::Expected => Engine::Expected,
            E::Paper => Engine::Paper,
            E::Events => {
                let message = "`EVENTS` is not built yet, take `AUTO`, `EXPECTED` or `PAPER`";
                return Err(FieldError::new("counts.engine", message));
            }
        },
        poisson: choice("counts.noise", spec.noise, N::Poisson, N::as_str_name)? == N::Poisson,
        seed: spec.seed.unwrap_or(1),
        wavelength_step_nm: settings.wavelength_step_nm,
        paper: PaperSettings {
            rays: settings.paper_rays.unwrap_or(paper.rays),
            samples: settings.paper_samples.unwrap_or(paper.samples),
            window_um: number(settings.paper_window_um, paper.window_um),
            node_um: number(settings.paper_node_um, paper.node_um),
        },
    })
}
