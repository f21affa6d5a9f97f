//! Rays and point spreads at the ends of their ranges.

use glam::DVec3;
use photoneye_eye::optics::{
    Dispersion, EyeState, Object, OpticsError, Prescription, Ray, RayFate, SchematicEye, Side,
};
use photoneye_eye::psf::{Otf, PsfGrid, PupilSampling, Wavefront, WavefrontOptions, psf, sampled};
use photoneye_eye::rng::{Purpose, Stream};

use super::{Cases, Found};

const GROUP: &str = "optics";

/// Adds the cases.
pub fn cases(cases: &mut Cases) {
    for nm in [390.0, 543.0, 830.0] {
        for (pupil, vergence) in [
            (0.5, 0.0),
            (0.5, 20.0),
            (0.5, -20.0),
            (3.0, 20.0),
            (3.0, -20.0),
            (9.0, 0.0),
            (9.0, 20.0),
            (9.0, -20.0),
        ] {
            let name = format!("{pupil} mm, {vergence:+} D, {nm} nm");
            cases.add(GROUP, &name, || spread(pupil, vergence, nm));
        }
    }
    for (pupil, vergence, window) in [(0.5, 20.0, 40.0), (3.0, 20.0, 60.0), (3.0, -20.0, 60.0)] {
        cases.add(GROUP, &format!("{pupil} mm, {vergence:+} D: middle against geometry"), || {
            geometry(pupil, vergence, window)
        });
    }
    for (pupil, vergence) in [(0.5, 20.0), (9.0, 0.0), (3.0, 5.0)] {
        cases.add(GROUP, &format!("{pupil} mm, {vergence:+} D: fitted form against rays"), || {
            fit(pupil, vergence)
        });
    }
    cases.add(GROUP, "fields from -110° to 110°", fields);
    cases.add(GROUP, "20,000 rays from anywhere to anywhere", anywhere);
    for (field, value) in
        [("pupil_mm", 0.49), ("pupil_mm", 9.1), ("pupil_mm", f64::NAN), ("accommodation_a", 13.0)]
    {
        cases.add(GROUP, &format!("{field} {value} is refused"), || refused(field, value));
    }
    cases.add(GROUP, "a vergence of 21 D is refused", || named(Object::field(5.0, 21.0).err(), "vergence"));
    cases.add(GROUP, "a wavelength of 200 nm is refused", || {
        let object = Object::field(5.0, 0.0).map_err(text)?;
        named(Wavefront::new(&eye(3.0)?, object, 200.0, &WavefrontOptions::default()).err(), "wavelength_nm")
    });
}

fn text(error: OpticsError) -> String {
    error.to_string()
}

fn state(pupil_mm: f64, accommodation_a: f64) -> EyeState {
    EyeState {
        pupil_mm,
        decentre_mm: 0.4,
        accommodation_a,
        dispersion: Dispersion::Herzberger,
        side: Side::Right,
    }
}

fn eye(pupil_mm: f64) -> Result<SchematicEye, String> {
    let p = Prescription::preset("escudero-sanz-navarro").map_err(text)?;
    SchematicEye::new(&p, &state(pupil_mm, 0.0)).map_err(text)
}

fn wavefront(pupil_mm: f64, vergence_d: f64, nm: f64) -> Result<Wavefront, String> {
    let object = Object::field(5.0, vergence_d).map_err(text)?;
    Wavefront::new(&eye(pupil_mm)?, object, nm, &WavefrontOptions::default()).map_err(text)
}

/// Values that are no numbers or below 0, and a transfer above 1.
fn spread(pupil_mm: f64, vergence_d: f64, nm: f64) -> Result<Found, String> {
    let w = wavefront(pupil_mm, vergence_d, nm)?;
    let values = psf(&w, &PsfGrid::new(24, 10.0));
    let wrong = values.iter().filter(|v| !(v.is_finite() && **v >= 0.0)).count();
    let otf = Otf::new(&w).radial(0.3, &[0.0, 0.01, 0.05, 0.2, 0.5, 5.0]);
    let most =
        otf.iter().map(|v| if v.re.is_finite() && v.im.is_finite() { v.norm() } else { f64::INFINITY });
    let excess = most.fold(0.0, f64::max) - 1.0;
    Ok(Found::new(
        "wrong values of the spread + excess of |transfer| over 1",
        wrong as f64 + excess.max(0.0),
        1e-6,
    ))
}

/// Far out of focus the mean in the middle is the density of rays there, by geometry.
fn geometry(pupil_mm: f64, vergence_d: f64, window_um: f64) -> Result<Found, String> {
    let w = wavefront(pupil_mm, vergence_d, 543.0)?;
    let grid = PsfGrid::new(160, 0.5 * window_um);
    let values = psf(&w, &grid);
    let mean = values.iter().sum::<f64>() / values.len() as f64 * w.density_per_um2();
    // The same by rays that land in the window.
    let object = Object::field(5.0, vergence_d).map_err(text)?;
    let points = PupilSampling::Stratified.points(60_000, 1);
    let eye = eye(pupil_mm)?;
    let bundle =
        photoneye_eye::optics::PupilBundle::trace_points(&eye, object, 543.0, &points, &[]).map_err(text)?;
    let [x, y, _] = bundle.frame;
    let radius = 0.5 * window_um;
    let inside = |r: &&photoneye_eye::optics::PupilRay| {
        let off = 1e3 * (r.landing - bundle.landing);
        off.dot(x).hypot(off.dot(y)) < radius
    };
    let density = bundle.rays.iter().filter(inside).count() as f64
        / bundle.rays.len() as f64
        / (std::f64::consts::PI * radius * radius);
    Ok(Found::new("|wave / geometry - 1|, mean of the middle", (mean / density - 1.0).abs(), 0.1))
}

/// The fitted matrix form against Huygens' sum over traced rays, L1.
fn fit(pupil_mm: f64, vergence_d: f64) -> Result<Found, String> {
    let object = Object::field(5.0, vergence_d).map_err(text)?;
    let (eye, grid) = (eye(pupil_mm)?, PsfGrid::new(16, 10.0));
    let options = WavefrontOptions::default();
    let fitted = psf(&Wavefront::new(&eye, object, 543.0, &options).map_err(text)?, &grid);
    let points = PupilSampling::Gauss.points(60_000, 0);
    let rays = sampled::psf(&eye, object, 543.0, &options, &points, &grid).map_err(text)?;
    let off: f64 = fitted.iter().zip(&rays).map(|(a, b)| (a - b).abs()).sum();
    Ok(Found::new("L1 difference of the spreads", off / rays.iter().sum::<f64>(), 1e-3))
}

/// Chief rays and wavefronts over the field: numbers or a refusal.
fn fields() -> Result<Found, String> {
    let eye = eye(3.0)?;
    let (mut wrong, mut lost) = (0, Vec::new());
    for angle in (-110..=110).step_by(5) {
        let object = Object::field(f64::from(angle), 0.0).map_err(text)?;
        match eye.chief_ray(object, 543.0) {
            Ok(chief) => wrong += usize::from(!chief.landing().is_some_and(DVec3::is_finite)),
            Err(OpticsError::NoRay { .. }) => lost.push(angle),
            Err(error) => return Err(text(error)),
        }
        if let Ok(w) = Wavefront::new(&eye, object, 543.0, &WavefrontOptions::default()) {
            wrong += usize::from(!(w.rms_waves().is_finite() && w.strehl().is_finite()));
        }
    }
    let ends = (lost.iter().filter(|a| **a < 0).max(), lost.iter().filter(|a| **a > 0).min());
    Ok(Found::new(format!("answers that are no numbers; no chief ray beyond {ends:?}"), wrong as f64, 0.0))
}

/// Random rays: every fate has finite points.
fn anywhere() -> Result<Found, String> {
    let eye = eye(6.0)?;
    let mut stream = Stream::new(1, Purpose::Study, 1, 0);
    let mut fates = [0_u32; 4];
    let mut wrong = 0;
    for _ in 0..20_000 {
        let mut point = |scale: f64| {
            let mut one = || scale * (2.0 * stream.uniform() - 1.0);
            DVec3::new(one(), one(), one())
        };
        let (from, to) = (point(12.0) - DVec3::new(0.0, 0.0, 14.0), point(6.0));
        let ray = Ray::new(from, to - from).map_err(text)?;
        let traced = eye.trace(&ray, 543.0);
        fates[match traced.fate {
            RayFate::Arrived => 0,
            RayFate::MissedSurface(_) => 1,
            RayFate::TotalInternalReflection(_) => 2,
            RayFate::StoppedByIris => 3,
        }] += 1;
        let finite =
            traced.hits.iter().flatten().all(|h| h.is_finite()) && traced.optical_path_mm.is_finite();
        wrong += usize::from(!(finite && traced.direction.is_finite()));
    }
    let [arrived, missed, reflected, iris] = fates;
    let what =
        format!("no numbers; {arrived} arrived, {missed} missed, {reflected} reflected, {iris} met the iris");
    Ok(Found::new(what, wrong as f64, 0.0))
}

fn refused(field: &str, value: f64) -> Result<Found, String> {
    let p = Prescription::preset("escudero-sanz-navarro").map_err(text)?;
    let state = if field == "pupil_mm" { state(value, 0.0) } else { state(3.0, value) };
    named(SchematicEye::new(&p, &state).err(), field)
}

/// 0 when there is an error that names the field.
fn named(error: Option<OpticsError>, field: &str) -> Result<Found, String> {
    let error = error.map(text).ok_or("it was accepted")?;
    Ok(Found::new(error.clone(), if error.contains(field) { 0.0 } else { 1.0 }, 0.0))
}
