//! Light spreads from its source: means of cones against a direct sum of Huygens' wavelets from every source point.
//!
//! For a lit pixel the reference takes Gauss nodes over its area; each node is a source point of its own. Its rays are traced
//! through nodes of the real stop, with neighbours for the Jacobians of the ray map; the field at a point P of the retina is
//! `E(P) = ∫ √(dΦ/ds · dq/ds) exp(2πi (w + |PQ| − R)/λ) ds`, s over the stop, Q the ray's point of the reference sphere (radius R
//! about the landing point of the chief ray), q its direction cosines, w its path difference; `|E|²/λ²` is the flux per area. No
//! fit, no transform, no linear map of the screen, no interpolation over the field. The aperture of a cone is cut into
//! triangles with seven points each; its mean is the sum over source points of the flux into it.
//!
//! Light of one wavelength; media are clear, the Stiles-Crawford effect is off: what is left is J·2/3.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use photoneye_eye::artifact::ArtifactSpec;
use photoneye_eye::cone::{ISOMERIZATION, pigment::Pigments};
use photoneye_eye::display::{Channel, emitters};
use photoneye_eye::experiment::{ChartRow, Experiment, Gaze, Pattern, SizesHold, SloanChart, Video};
use photoneye_eye::exposure::audit::verdict;
use photoneye_eye::exposure::{Exposure, FrameCounts};
use photoneye_eye::optics::{Fovea, Projection, PupilBundle, PupilRay, SchematicEye};
use photoneye_eye::plan::{Plan, plan};
use photoneye_eye::retina::Retina;
use photoneye_eye::spectrum::Spectrum;
use photoneye_eye::video::{ScreenView, draw};
use rayon::prelude::*;

use crate::support::{build, figure_12, primary};

const NM: f64 = 543.0;
/// Step of the Jacobians, stop radii.
const STEP: f64 = 2e-4;

/// A scene of one wavelength: a pattern on 30 x 30 pixels of 2.5', seen at `ecc_deg` to the left of the gaze.
pub fn scene(pattern: Pattern, pupil_mm: f64, ecc_deg: f64, target: f64) -> Experiment {
    let mut experiment = figure_12(pattern);
    experiment.display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: NM, fwhm_nm: 0.0 })];
    experiment.display.primaries[0].rects = vec![[0.0, 0.0, 1.0, 1.0]];
    let eye = &mut experiment.eye;
    eye.pupil_mm = pupil_mm;
    (eye.lens_density_scale, eye.cornea_density_scale, eye.macular_peak_density) = (0.0, 0.0, 0.0);
    (eye.stiles_crawford_rho10_per_mm2, eye.pointing_sd_deg) = (0.0, 0.0);
    let per_px = experiment.display.pixel_pitch_cm / experiment.display.distance_cm;
    experiment.gaze = Gaze::still([15.0 + ecc_deg.to_radians().tan() / per_px, 15.0]);
    experiment.counts.poisson = false;
    experiment.accuracy_target = target;
    experiment
}

pub const POINT: Pattern = Pattern::Point { at_px: [15, 15], rgb: [1.0; 3] };

/// A prepared scene with what the reference needs of it.
pub struct Prepared {
    pub experiment: Experiment,
    pub plan: Plan,
    pub exposure: Exposure,
    pub retina: Retina,
    projection: Projection,
}

impl Prepared {
    pub fn new(experiment: &Experiment) -> Self {
        let plan = plan(experiment).unwrap();
        let built = build(&plan);
        let [cones, kernels] = plan.tile_artifacts[0][..] else { panic!("cones and kernels") };
        let artifacts = [&built[&cones], &built[&kernels]];
        let of_kernels = plan.artifacts.iter().find(|a| a.key == kernels).unwrap();
        let ArtifactSpec::Kernels(spec) = &of_kernels.spec else { panic!("kernels") };
        let eye = SchematicEye::new(&spec.prescription, &spec.state).unwrap();
        let projection = Projection::of(&eye, spec.screen).unwrap();
        let exposure = Exposure::new(experiment, &artifacts).unwrap();
        let retina = Retina::from_bytes(artifacts[0]).unwrap();
        Self { experiment: experiment.clone(), plan, exposure, retina, projection }
    }

    pub fn means(&self) -> Vec<f64> {
        let FrameCounts::Means(means) = self.exposure.frame(0, None).unwrap().counts else { panic!("means") };
        means.into_iter().map(f64::from).collect()
    }

    /// Reference means of some cones; `nodes` per pixel side, `rings` of rays.
    pub fn reference(&self, cones: &[usize], nodes: usize, rings: usize) -> Vec<f64> {
        let display = &self.experiment.display;
        let Video::Pattern(pattern) = &self.experiment.video else { panic!("a pattern") };
        let picture = draw(pattern, &ScreenView::frontal(display, &self.experiment.gaze));
        let emitter = &emitters(display).unwrap()[0];
        let apertures: Vec<Vec<(DVec3, f64)>> = cones.iter().map(|i| self.aperture(*i)).collect();
        // Source points with their photons per steradian and area of the pupil: I = N/π cos θ, over the squared distance.
        let per_px = display.pixel_pitch_cm / display.distance_cm;
        let distance_mm = 10.0 * display.distance_cm;
        let centre = DVec2::from_array(self.experiment.gaze.center_px);
        let rule = gauss(nodes);
        let mut sources = Vec::new();
        for (pixel, rgb) in picture.rgb.chunks_exact(3).enumerate() {
            let light = display.curve().light(f64::from(rgb[0]));
            if light <= 0.0 {
                continue;
            }
            let corner = DVec2::new(
                (pixel % display.width_px as usize) as f64,
                (pixel / display.width_px as usize) as f64,
            );
            for (u, wu) in &rule {
                for (v, wv) in &rule {
                    let from = (corner + DVec2::new(*u, *v) - centre) * per_px;
                    let tangent = DVec2::new(from.x, -from.y);
                    let cos = 1.0 / 1.0_f64.hypot(tangent.length());
                    let photons =
                        light * emitter.emitted() * wu * wv / PI * cos.powi(3) / distance_mm.powi(2);
                    sources.push((tangent, photons));
                }
            }
        }
        let of_source = |(tangent, photons): &(DVec2, f64)| -> Vec<f64> {
            let wave = Wavelets::new(&self.projection, *tangent, rings);
            apertures
                .iter()
                .map(|a| photons * a.iter().map(|(p, area)| area * wave.flux(*p)).sum::<f64>())
                .collect()
        };
        let sums = sources.par_iter().map(of_source).collect::<Vec<_>>();
        let pigments = Pigments::new().unwrap();
        let caught = |i: usize| {
            let ecc = self.projection.visual_deg(self.retina.center(i)).unwrap().length();
            ISOMERIZATION * pigments.absorptance(self.retina.cone_type[i], NM, ecc)
        };
        (0..cones.len()).map(|k| caught(cones[k]) * sums.iter().map(|s| s[k]).sum::<f64>()).collect()
    }

    /// Points (mm, eye frame) of a cone's aperture with areas (µm²).
    fn aperture(&self, cone: usize) -> Vec<(DVec3, f64)> {
        let fovea: Fovea = self.projection.eye().fovea();
        let corners: Vec<DVec2> = self.retina.polygon(cone).collect();
        let middle = corners.iter().sum::<DVec2>() / corners.len() as f64;
        let mut points = Vec::new();
        for (i, a) in corners.iter().enumerate() {
            let triangle = [middle, *a, corners[(i + 1) % corners.len()]];
            let [p, q, r] = triangle.map(|um| fovea.point_from_um(um));
            let area = 0.5e6 * (q - p).cross(r - p).length();
            points.extend(radon(triangle).map(|(um, w)| (fovea.point_from_um(um), w * area)));
        }
        points
    }
}

/// The brightest cones.
fn brightest(means: &[f64], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..means.len()).collect();
    order.sort_by(|a, b| means[*b].total_cmp(&means[*a]));
    order.truncate(count);
    order
}

/// Radon's rule of degree 5 on a triangle: points and weights that sum to 1.
fn radon([a, b, c]: [DVec2; 3]) -> [(DVec2, f64); 7] {
    let root = 15_f64.sqrt();
    let [near, far] = [(6.0 - root) / 21.0, (6.0 + root) / 21.0];
    let [light, heavy] = [(155.0 - root) / 1200.0, (155.0 + root) / 1200.0];
    let at = |p: DVec2, q: DVec2, r: DVec2, n: f64| p * (1.0 - 2.0 * n) + (q + r) * n;
    [
        ((a + b + c) / 3.0, 0.225),
        (at(a, b, c, near), light),
        (at(b, c, a, near), light),
        (at(c, a, b, near), light),
        (at(a, b, c, far), heavy),
        (at(b, c, a, far), heavy),
        (at(c, a, b, far), heavy),
    ]
}

/// Gauss–Legendre nodes and weights on [0, 1], by Newton's method.
fn gauss(n: usize) -> Vec<(f64, f64)> {
    let legendre = |x: f64| {
        let (mut p, mut q) = (1.0, 0.0);
        for k in 0..n {
            (p, q) = (((2 * k + 1) as f64 * x * p - k as f64 * q) / (k + 1) as f64, p);
        }
        (p, n as f64 * (x * p - q) / (x * x - 1.0))
    };
    let node = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        for _ in 0..50 {
            let (p, slope) = legendre(x);
            x -= p / slope;
        }
        let slope = legendre(x).1;
        (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(node).collect()
}

/// The rays of one source point: wavelets on the reference sphere.
struct Wavelets {
    landing: DVec3,
    radius_mm: f64,
    wavelength_mm: f64,
    /// Point of the sphere from its centre, mm; path difference, mm; amplitude.
    rays: Vec<(DVec3, f64, f64)>,
}

impl Wavelets {
    fn new(projection: &Projection, tangent: DVec2, rings: usize) -> Self {
        // Gauss nodes in r², even azimuths; each with four neighbours.
        let azimuths = 2 * rings + 2;
        let mut points = Vec::new();
        for (square, weight) in gauss(rings) {
            for k in 0..azimuths {
                let s = square.sqrt() * DVec2::from_angle((k as f64 + 0.5) * 2.0 * PI / azimuths as f64);
                points.push((s, weight * PI / azimuths as f64));
                let beside = [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y];
                points.extend(beside.map(|e| (s + STEP * e, 0.0)));
            }
        }
        let object = projection.object(tangent);
        let bundle = PupilBundle::trace_points(projection.eye(), object, NM, &points, &[]).unwrap();
        let of_stop = |r: &[PupilRay], f: fn(&PupilRay) -> DVec2| {
            let (x, y) = ((f(&r[1]) - f(&r[2])) / (2.0 * STEP), (f(&r[3]) - f(&r[4])) / (2.0 * STEP));
            x.perp_dot(y).abs()
        };
        let ray = |r: &[PupilRay]| {
            let flux = r[0].irradiance * of_stop(r, |r| r.launch);
            let amplitude = r[0].weight * (flux * of_stop(r, |r| r.q)).sqrt();
            let [x, y, normal] = bundle.frame;
            let at = bundle.radius_mm * (r[0].q.x * x + r[0].q.y * y + r[0].q_normal * normal);
            (at, r[0].opd_mm, amplitude)
        };
        Self {
            landing: bundle.landing,
            radius_mm: bundle.radius_mm,
            wavelength_mm: bundle.wavelength_mm(),
            rays: bundle.rays.chunks_exact(5).map(ray).collect(),
        }
    }

    /// Flux per µm² at a point of the retina, for unit irradiance (1/mm²) at the apex.
    fn flux(&self, point: DVec3) -> f64 {
        let p = point - self.landing;
        let (mut re, mut im) = (0.0, 0.0);
        for (q, path, amplitude) in &self.rays {
            // |PQ| − R without cancellation: (p² − 2 p·q)/(|PQ| + R).
            let distance = (q - p).length();
            let more = (p.length_squared() - 2.0 * p.dot(*q)) / (distance + self.radius_mm);
            let (sin, cos) = (2.0 * PI * ((path + more) / self.wavelength_mm)).sin_cos();
            re += amplitude * cos;
            im += amplitude * sin;
        }
        (re * re + im * im) / self.wavelength_mm.powi(2) * 1e-6
    }
}

/// Relative L1 difference, and that of the sums.
fn compare(made: &[f64], reference: &[f64]) -> (f64, f64) {
    let total: f64 = reference.iter().sum();
    let l1 = made.iter().zip(reference).map(|(m, r)| (m - r).abs()).sum::<f64>() / total;
    (l1, made.iter().sum::<f64>() / total - 1.0)
}

/// Rays enough for a pupil.
fn rings(pupil_mm: f64) -> usize {
    (10.0 + 6.0 * pupil_mm + 0.6 * pupil_mm * pupil_mm) as usize
}

pub fn letter() -> Pattern {
    Pattern::SloanChart(SloanChart {
        rows: vec![ChartRow { letters: "K".into(), stroke_arcmin: 7.5 }],
        paper_rgb: [1.0; 3],
        ink_rgb: [0.0; 3],
        lower_paper_rgb: None,
        sizes_hold: SizesHold::AtGaze,
    })
}

/// L1 difference of the brightest cones from the reference, one lit pixel.
fn one_pixel(pupil_mm: f64, ecc_deg: f64, cones: usize, nodes: usize) -> f64 {
    let prepared = Prepared::new(&scene(POINT, pupil_mm, ecc_deg, 1e-3));
    let means = prepared.means();
    let bright = brightest(&means, cones);
    let reference = prepared.reference(&bright, nodes, rings(pupil_mm));
    let made: Vec<f64> = bright.iter().map(|i| means[*i]).collect();
    let (l1, sum) = compare(&made, &reference);
    println!("one pixel, {pupil_mm} mm, {ecc_deg}°: L1 {l1:.1e}, sum {sum:+.1e}");
    l1
}

#[test]
fn one_lit_pixel_at_three_millimetres() {
    let found = one_pixel(3.0, 0.0, 12, 12);
    assert!(found < 1e-3, "{found}");
}

/// Every pupil and eccentricity whose target the plan accepts; PUPIL in the environment takes one pupil.
#[test]
#[ignore = "an hour; a pupil of 3 mm some minutes"]
fn one_lit_pixel_behind_all_pupils() {
    let only = std::env::var("PUPIL").ok().and_then(|p| p.parse::<f64>().ok());
    for pupil_mm in [3.0, 4.0, 6.0, 8.0].into_iter().filter(|p| only.is_none_or(|o| (o - p).abs() < 0.1)) {
        for ecc_deg in [0.0, 10.0, 20.0] {
            if let Err(refused) = plan(&scene(POINT, pupil_mm, ecc_deg, 1e-3)) {
                println!("{pupil_mm} mm, {ecc_deg}°: refused, {refused}");
                continue;
            }
            let found = one_pixel(pupil_mm, ecc_deg, 25, 20);
            assert!(found < 1e-3, "{pupil_mm} {ecc_deg}: {found}");
        }
    }
}

/// A number from the environment.
pub fn number(name: &str, or: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(or)
}

/// L1 differences of the engine and of the audit from the reference, on cones that the audit drew and that
/// have more than `least` of the most light.
fn audited(experiment: &Experiment, least: f64, nodes: usize, rings: usize) -> [f64; 2] {
    let prepared = Prepared::new(experiment);
    let frame = prepared.exposure.frame(0, None).unwrap();
    let samples = prepared.exposure.audit(0, None, &[], &frame).unwrap();
    let most = prepared.means().into_iter().fold(0.0, f64::max);
    let lit: Vec<_> = samples.iter().filter(|s| s.value > least * most).collect();
    let index = |cone: u64| prepared.retina.id.iter().position(|id| *id == cone).unwrap();
    let cones: Vec<usize> = lit.iter().map(|s| index(s.cone)).collect();
    let reference = prepared.reference(&cones, nodes, rings);
    for (s, r) in lit.iter().zip(&reference) {
        println!("{r:10.4}: engine {:+.1e}, audit {:+.1e}", s.value / r - 1.0, s.reference / r - 1.0);
    }
    let of_audit: Vec<f64> = lit.iter().map(|s| s.reference).collect();
    let of_engine: Vec<f64> = lit.iter().map(|s| s.value).collect();
    let [engine, audit] = [&of_engine, &of_audit].map(|values| compare(values, &reference).0);
    println!("engine {engine:.1e}, audit {audit:.1e}");
    [engine, audit]
}

/// One lit pixel, 3 mm: at the fovea the audit is exact to 6e-5 (with PSFs that were moved but kept their
/// form it was 7e-4 off), at 10° to 4e-4.
#[test]
fn the_audit_at_three_millimetres() {
    for (ecc_deg, most) in [(0.0, 2e-4), (10.0, 6e-4)] {
        let experiment = Experiment { audit_cones: 16, ..scene(POINT, 3.0, ecc_deg, 1e-3) };
        let [_, audit] = audited(&experiment, 0.1, 12, rings(3.0));
        assert!(audit < most, "{ecc_deg}: {audit}");
    }
}

/// The same with PUPIL, ECC, CONES, NODES, RINGS and LEAST from the environment: few rings give wrong tails.
/// One setting is made by hand, so that the plan does not refuse what only the audit is asked about.
#[test]
#[ignore = "some minutes"]
fn audited_cones_against_the_reference() {
    let pupil_mm = number("PUPIL", 6.0);
    let mut experiment = scene(POINT, pupil_mm, number("ECC", 0.0), 1e-3);
    experiment.audit_cones = number("CONES", 16.0) as u32;
    experiment.counts.knobs.double_precision = Some(true);
    let rings = number("RINGS", rings(pupil_mm) as f64) as usize;
    let [_, audit] = audited(&experiment, number("LEAST", 0.1), number("NODES", 20.0) as usize, rings);
    assert!(audit < 1e-3, "{audit}");
}

/// Even fields about 10°, where the law of the cones' pigment has a kink, and about 5°, where the macula ends
/// (460 nm): interpolated across it, lit cones were off by 1.3e-3 and 8.2e-3 (L1).
#[test]
fn even_fields_across_the_kinks_of_pigments() {
    for (ecc_deg, nm, macula) in [(10.0, NM, 0.0), (5.0, 460.0, 0.35)] {
        let mut experiment = scene(Pattern::Uniform { rgb: [1.0; 3] }, 3.0, ecc_deg, 1e-3);
        experiment.audit_cones = 12;
        experiment.eye.macular_peak_density = macula;
        experiment.display.primaries[0].spectrum = Spectrum::Line { nm, fwhm_nm: 0.0 };
        let prepared = Prepared::new(&experiment);
        let frame = prepared.exposure.frame(0, None).unwrap();
        let samples = prepared.exposure.audit(0, None, &[], &frame).unwrap();
        let most = prepared.means().into_iter().fold(0.0, f64::max);
        let lit: Vec<_> = samples.iter().filter(|s| s.value > 0.4 * most).collect();
        let values: Vec<f64> = lit.iter().map(|s| s.value).collect();
        let audited: Vec<f64> = lit.iter().map(|s| s.reference).collect();
        let (l1, _) = compare(&values, &audited);
        println!("{ecc_deg}°: {} lit cones, L1 {l1:.1e}", lit.len());
        assert!(l1 < experiment.accuracy_target, "{ecc_deg}: {l1}");
    }
}

/// A patch inside the picture, behind a pupil whose coma displaces images: light of the cones at its edges
/// comes from places beyond it. They were off by up to 0.22 of the brightest.
#[test]
fn cones_at_the_edge_of_a_patch() {
    let mut experiment = scene(Pattern::Checkerboard { square_px: 4 }, 6.0, 10.0, 1e-3);
    experiment.retina.region_deg = Some([-10.1, -9.9, -0.1, 0.1]);
    experiment.audit_cones = 60;
    let prepared = Prepared::new(&experiment);
    let frame = prepared.exposure.frame(0, None).unwrap();
    let samples = prepared.exposure.audit(0, None, &[], &frame).unwrap();
    let most = prepared.means().into_iter().fold(0.0, f64::max);
    let worst = samples.iter().map(|s| (s.value - s.reference).abs() / most).fold(0.0, f64::max);
    println!("{} samples of {} cones, {worst:.1e} of the brightest", samples.len(), prepared.retina.len());
    assert!(worst < 2e-3, "{worst}");
}

/// Audits of pictures behind pupils over the field, one wavelength, target 1e-3: a table of error and
/// estimate. Where the plan does not refuse the target no audit's lower bound is above it. PUPIL and ECC in
/// the environment take one of each, CONES more cones. BY_HAND=1 gives one setting by hand, so that what the
/// plan refuses is computed too, and prints the table only: the constants of `plan/error.rs` come from there.
#[test]
#[ignore = "some ten minutes"]
fn targets_are_kept_behind_all_pupils() {
    let squares = |square_px: u32| Pattern::Checkerboard { square_px };
    let pictures = [
        ("even", Pattern::Uniform { rgb: [1.0; 3] }),
        ("edges", squares(15)),
        ("checks", squares(10)),
        ("fine", squares(2)),
        ("finest", squares(1)),
        ("letter", letter()),
        ("point", POINT),
    ];
    let only = |name: &str, all: &[f64]| -> Vec<f64> {
        let one = std::env::var(name).ok().and_then(|v| v.parse().ok());
        one.map_or(all.to_vec(), |v| vec![v])
    };
    let by_hand = number("BY_HAND", 0.0) > 0.0;
    let mut missed = Vec::new();
    for pupil_mm in only("PUPIL", &[2.0, 3.0, 4.0, 6.0, 8.0]) {
        for ecc_deg in only("ECC", &[0.0, 10.0, 20.0, 30.0]) {
            for (name, picture) in pictures.clone() {
                let audit_cones = number("CONES", 8.0) as u32;
                let mut experiment = Experiment { audit_cones, ..scene(picture, pupil_mm, ecc_deg, 1e-3) };
                experiment.counts.knobs.double_precision = by_hand.then_some(true);
                if let Err(refused) = plan(&experiment) {
                    println!("{pupil_mm} mm, {ecc_deg:2}°, {name:6}: refused, {refused}");
                    continue;
                }
                let prepared = Prepared::new(&experiment);
                let frame = prepared.exposure.frame(0, None).unwrap();
                let samples = prepared.exposure.audit(0, None, &[], &frame).unwrap();
                let found = verdict(&samples, false).unwrap();
                let estimate: f64 = prepared.plan.error_estimate.iter().map(|p| p.relative).sum();
                let error = found.relative_error;
                let lower = found.lower_bound_95.unwrap();
                println!(
                    "{pupil_mm} mm, {ecc_deg:2}°, {name:6}: audit {error:.1e} (at least {lower:.1e}), estimate \
                     {estimate:.1e}, ratio {:.2}",
                    estimate / error
                );
                if lower > 1e-3 {
                    missed.push((pupil_mm, ecc_deg, name));
                }
            }
        }
    }
    assert!(by_hand || missed.is_empty(), "{missed:?}");
}
