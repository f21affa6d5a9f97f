//! Light scattered in the eye against the whole glare function of the CIE (report 135/1:1999; Vos & van den
//! Berg 1999), 1/sr, θ in degrees.
//!
//! A cone counts of a pixel of area A that sends N photons into the pupil `C N ω mean_A f(θ)` (1): ω is the
//! solid angle of a pixel at the cone, C what the cone counts of an even screen over the photons of one of
//! its pixels into the pupil. C is measured without scattered light; N is that of the photon budget; the mean
//! of f is a direct sum over the pixel's area. Beside f itself the sum over the scattered part is checked, f
//! less the skirt of a round pupil's edge, `λ e/(π³ d θ³)`, below 0.5° as its own parabola.

use std::f64::consts::PI;
use std::sync::OnceLock;
use std::time::Instant;

use photoneye_eye::display::{Channel, White};
use photoneye_eye::experiment::{Engine, Experiment, Gaze, Pattern, StrayLight};
use photoneye_eye::exposure::audit::verdict;
use photoneye_eye::exposure::{Frame, FrameCounts};
use photoneye_eye::retina::ConeType;
use photoneye_eye::spectrum::Spectrum;

use crate::support::{WHITE, cached_exposure, cached_retina, figure_12, primary};

/// The wavelength of the test's light and the pupil, mm; Stiles-Crawford ρ, base 10, 1/mm².
const NM: f64 = 555.0;
const PUPIL_MM: f64 = 3.0;
const RHO: f64 = 0.05;
const PIGMENTATION: f64 = 0.5;

fn narrow(age: f64, theta: f64) -> f64 {
    let term = |peak: f64, width: f64| peak * (1.0 + (theta / width).powi(2)).powf(-1.5);
    (1.0 - 0.08 * (age / 70.0).powi(4)) * (term(9.2e6, 0.0046) + term(1.5e5, 0.045))
}

fn wide(age: f64, theta: f64) -> f64 {
    let fall = 1.0 + (theta / 0.1).powi(2);
    let wall = PIGMENTATION * (1300.0 * fall.powf(-1.5) + 0.8 * fall.powf(-0.5));
    (1.0 + 1.6 * (age / 70.0).powi(4)) * (400.0 / fall + 3e-8 * theta * theta + wall) + 2.5e-3 * PIGMENTATION
}

/// The CIE's function.
fn glare(age: f64, theta: f64) -> f64 {
    narrow(age, theta) + wide(age, theta)
}

/// The skirt of the pupil's edge, all light in the image.
fn skirt(theta: f64) -> f64 {
    let x = 10_f64.ln() * RHO * (0.5 * PUPIL_MM).powi(2);
    NM * 1e-6 / (PI.powi(3) * PUPIL_MM) * x / x.exp_m1() / theta.to_radians().powi(3)
}

/// The scattered part of light of which a fraction is kept in the image.
fn scattered(age: f64, kept: f64, theta: f64) -> f64 {
    let beyond = |theta: f64| narrow(age, theta) - kept * skirt(theta);
    let slope = (beyond(0.5001) - beyond(0.5)) / 1e-4;
    let inside = theta < 0.5;
    wide(age, theta) + if inside { beyond(0.5) + slope * (theta * theta - 0.25) } else { beyond(theta) }
}

/// The fraction that is kept, 1 less the integral of what is scattered, by midpoints in ln(θ + 0.01°).
fn kept(age: f64) -> f64 {
    let mut kept = 0.85;
    for _ in 0..10 {
        let step = (90.01_f64.ln() - 0.01_f64.ln()) / 4000.0;
        let at = |i: u32| (0.01_f64.ln() + (f64::from(i) + 0.5) * step).exp();
        let ring = |theta: f64, at: f64| 2.0 * PI * theta.to_radians().sin() * at.to_radians() * step;
        let sum: f64 = (0..4000).map(at).map(|a| scattered(age, kept, a - 0.01) * ring(a - 0.01, a)).sum();
        kept = 1.0 - sum;
    }
    kept
}

/// Pixels of a pitch (degrees), wholly lit.
#[derive(Clone, Copy)]
struct Screen {
    pitch_deg: f64,
    size: [u32; 2],
    gaze_px: [f64; 2],
}

impl Screen {
    fn per_px(self) -> f64 {
        self.pitch_deg.to_radians().tan()
    }

    fn experiment(self, pattern: Pattern) -> Experiment {
        let mut experiment = figure_12(pattern);
        let display = &mut experiment.display;
        [display.width_px, display.height_px] = self.size;
        display.distance_cm = 100.0;
        display.pixel_pitch_cm = 100.0 * self.per_px();
        display.primaries = vec![primary(Channel::White, Spectrum::Line { nm: NM, fwhm_nm: 40.0 })];
        display.primaries[0].rects = vec![[0.0, 0.0, 1.0, 1.0]];
        experiment.eye.focus_distance_cm = 100.0;
        experiment.eye.pupil_mm = PUPIL_MM;
        experiment.gaze = Gaze::still(self.gaze_px);
        experiment.counts.poisson = false;
        // Dim places beside a bright pixel: the image's own error must be small against them.
        experiment.accuracy_target = 0.001;
        experiment.retina.region_deg = Some([-0.04, 0.04, -0.04, 0.04]);
        experiment
    }

    /// Mean over a pixel of a function of its angle from a direction (unit tangents), by cells a twelfth of
    /// their distance wide.
    fn mean_over(self, [column, row]: [u32; 2], from: [f64; 2], f: &dyn Fn(f64) -> f64) -> f64 {
        let place = |px: f64, axis: usize| (px - self.gaze_px[axis]) * self.per_px();
        self.cell([f64::from(column), f64::from(row)], 1.0, &|x, y| {
            let there = [place(x, 0), -place(y, 1)];
            let dot = 1.0 + there[0] * from[0] + there[1] * from[1];
            let cross = [there[1] - from[1], from[0] - there[0], there[0] * from[1] - there[1] * from[0]];
            let theta = cross.iter().map(|c| c * c).sum::<f64>().sqrt().atan2(dot).to_degrees();
            (theta, f(theta))
        })
    }

    fn cell(self, at: [f64; 2], side: f64, f: &dyn Fn(f64, f64) -> (f64, f64)) -> f64 {
        let (theta, value) = f(at[0] + 0.5 * side, at[1] + 0.5 * side);
        if side * self.pitch_deg <= (theta / 12.0).max(0.006) {
            return value;
        }
        let half = 0.5 * side;
        let parts = [[0.0, 0.0], [half, 0.0], [0.0, half], [half, half]];
        0.25 * parts.map(|p| self.cell([at[0] + p[0], at[1] + p[1]], half, f)).iter().sum::<f64>()
    }
}

fn means(frame: &Frame) -> Vec<f64> {
    match &frame.counts {
        FrameCounts::Means(means) => means.iter().map(|mean| f64::from(*mean)).collect(),
        FrameCounts::Counts(counts) => counts.iter().map(|count| f64::from(*count)).collect(),
    }
}

fn frame(experiment: &Experiment) -> Frame {
    cached_exposure(experiment).frame(0, None).unwrap()
}

fn aged(mut experiment: Experiment, age_years: f64) -> Experiment {
    experiment.eye.stray_light = Some(StrayLight { age_years, pigmentation: PIGMENTATION });
    experiment
}

/// What the cones count of an even screen, over the photons of a pixel at the gaze centre: C of each cone.
fn catch(pitch_deg: f64, region: Option<[f64; 4]>) -> Vec<f64> {
    let width = (2 * (4.0 / pitch_deg) as u32).max(8);
    let screen = Screen { pitch_deg, size: [width; 2], gaze_px: [0.5 * f64::from(width); 2] };
    let mut white = screen.experiment(WHITE);
    white.retina.region_deg = region.or(white.retina.region_deg);
    let one = Screen { pitch_deg, size: [1; 2], gaze_px: [0.5; 2] }.experiment(WHITE);
    let photons = frame(&one).budget.into_pupil();
    means(&frame(&white)).iter().map(|mean| mean / photons).collect()
}

/// A pixel whose nearer edge is so many degrees from the fovea, on a screen that reaches from one to the
/// other.
fn beside(pitch_deg: f64, theta_deg: f64) -> Screen {
    let across = theta_deg.to_radians().tan() / pitch_deg.to_radians().tan();
    let columns = across.ceil() as u32 + 2;
    Screen { pitch_deg, size: [columns, 1], gaze_px: [f64::from(columns - 1) - across, 0.5] }
}

fn lit(screen: Screen) -> [u32; 2] {
    [screen.size[0] - 1, 0]
}

/// All the light of a lit pixel, its image's skirt and what is scattered, is the CIE's function within 3 %
/// from 0.5° to 30°, for pixels from 0.5′ to 2° and eyes of 20 and 70 years.
#[test]
fn a_lit_pixel_is_seen_as_the_cie_says() {
    let mut worst = 0.0_f64;
    for pitch in [0.5 / 60.0, 2.5 / 60.0, 0.5, 2.0] {
        let catch: f64 = catch(pitch, None).iter().sum();
        for theta in [0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 30.0] {
            for age in [20.0, 70.0] {
                let screen = beside(pitch, theta);
                let at = lit(screen);
                let made = frame(&aged(screen.experiment(Pattern::Point { at_px: at, rgb: [1.0; 3] }), age));
                let f = screen.mean_over(at, [0.0; 2], &|theta| glare(age, theta));
                let exact = catch * made.budget.into_pupil() * screen.per_px().powi(2) * f; // (1)
                let ratio = means(&made).iter().sum::<f64>() / exact;
                println!("pixel {pitch:.4}, {theta} degrees, {age} years: {ratio:.4}");
                worst = worst.max((ratio - 1.0).abs());
            }
        }
    }
    println!("worst {worst:.4}");
    assert!(worst < 0.03, "{worst}");
}

/// From where its chief ray lands, degrees of the visual field, to where the light of a point at the gaze
/// centre lies: the centroid of the image of a small pixel. Angles of scattered light count from there.
fn image_offset_deg() -> [f64; 2] {
    let pitch = 0.5 / 60.0;
    let region = [-0.2, 0.2, -0.2, 0.2];
    let mut dot = Screen { pitch_deg: pitch, size: [1; 2], gaze_px: [0.5; 2] }.experiment(WHITE);
    dot.retina.region_deg = Some(region);
    let (image, catch) = (means(&frame(&dot)), catch(pitch, Some(region)));
    let retina = cached_retina(&dot);
    let columns = photoneye_eye::exposure::cone_columns(&dot, &retina).unwrap();
    let (mut sum, mut total) = ([0.0; 2], 0.0);
    for i in (0..image.len()).filter(|i| retina.cone_type[*i] != ConeType::S) {
        let light = image[i] / catch[i] * f64::from(columns.aperture_um2[i]);
        sum = [sum[0] + light * columns.x_deg[i], sum[1] + light * columns.y_deg[i]];
        total += light;
    }
    sum.map(|s| s / total)
}

/// V at every cone of a strip from the edge of lit pixels to 2.2° beside them, within 1 %; there is no step in
/// it, and what the image loses is what is scattered.
#[test]
fn what_is_scattered_is_smooth_and_complete() {
    let age = 70.0;
    let kept = kept(age);
    let [right, up] = image_offset_deg();
    println!("images lie {right:.4}, {up:.4} degrees from their chief rays");
    for (pitch, pixels) in [(0.5 / 60.0, 10), (2.5 / 60.0, 2), (0.5, 1), (2.0_f64, 1)] {
        let region = [0.0, 3.0, -0.01, 0.01];
        // A white screen that ends at the gaze centre.
        let middle = 0.5 * f64::from(pixels);
        let screen = Screen { pitch_deg: pitch, size: [pixels; 2], gaze_px: [2.0 * middle, middle] };
        let mut dark = screen.experiment(WHITE);
        dark.retina.region_deg = Some(region);
        let without = frame(&dark);
        let with = means(&frame(&aged(dark.clone(), age)));
        let (catch, retina) = (catch(pitch, Some(region)), cached_retina(&dark));
        let columns = photoneye_eye::exposure::cone_columns(&dark, &retina).unwrap();
        let photons = without.budget.into_pupil() / f64::from(pixels * pixels);
        let (mut worst, mut ratios) = (0.0_f64, Vec::new());
        for (i, (with, without)) in with.iter().zip(means(&without)).enumerate() {
            let (x, y) =
                ((columns.x_deg[i] - right).to_radians().tan(), (columns.y_deg[i] - up).to_radians().tan());
            // A mean of 0 is one that rounding had made negative; S cones see nothing of this light. Farther away
            // the skirts of the image's copies matter, which are taken away less closely without scattered light.
            let compared = without > 0.0 && retina.cone_type[i] != ConeType::S && columns.x_deg[i] < 2.2;
            if !compared {
                continue;
            }
            let all = (0..pixels).flat_map(|row| (0..pixels).map(move |column| [column, row]));
            let f: f64 =
                all.map(|at| screen.mean_over(at, [x, y], &|theta| scattered(age, kept, theta))).sum();
            let area = screen.per_px().powi(2) / (1.0 + x * x + y * y).powf(1.5);
            // The obliquity at the cone's own place is in C.
            let exact = catch[i] / obliquity([x, y]) * photons * area * f; // (1)
            // In the image itself the difference of two large numbers says nothing of V.
            if without > 50.0 * exact {
                continue;
            }
            let ratio = (with - kept * without) / exact;
            if (ratio - 1.0).abs() > 0.01 {
                println!("{:.4} degrees: {ratio:.4}, image {without:.6}", columns.x_deg[i]);
            }
            worst = worst.max((ratio - 1.0).abs());
            ratios.push(ratio);
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        println!("pixel {pitch:.4}: {} cones, mean {mean:.4}, worst {worst:.4}", ratios.len());
        // The centroid of the image is known to 0.0005°, by which V changes by 0.3 % beside an edge.
        assert!(worst < 0.01 && (mean - 1.0).abs() < 4e-3, "pixel {pitch}: {worst}");
    }
}

/// A screen of 80° in even light: each cone keeps its own part and gets what the others lose, as a direct sum
/// over directions says. So does a cone 20° from the axis, where the screen's obliquity factor falls across
/// the light that it gets.
#[test]
fn what_the_image_loses_is_what_is_spread() {
    let pitch = 0.5;
    let half = 96_u32;
    let screen = Screen { pitch_deg: pitch, size: [2 * half; 2], gaze_px: [f64::from(half); 2] };
    for (age, x_deg) in [(20.0, 0.0), (70.0, 0.0), (70.0, 20.0_f64)] {
        let mut white = screen.experiment(WHITE);
        white.retina.region_deg = Some([x_deg - 0.03, x_deg + 0.03, -0.03, 0.03]);
        let without: f64 = means(&frame(&white)).iter().sum();
        let with: f64 = means(&frame(&aged(white.clone(), age))).iter().sum();
        let kept = kept(age);
        let from = [x_deg.to_radians().tan(), 0.0];
        let area = screen.per_px().powi(2) / (1.0 + from[0] * from[0]).powf(1.5);
        let own = obliquity(from);
        let mut sum = 0.0;
        for row in 0..2 * half {
            for column in 0..2 * half {
                let place = |px: u32| (f64::from(px) + 0.5 - f64::from(half)) * screen.per_px();
                let there = [place(column), -place(row)];
                let f = screen.mean_over([column, row], from, &|theta| scattered(age, kept, theta));
                sum += f * obliquity(there) / own;
            }
        }
        let exact = kept + sum * area;
        println!("{age} years, {x_deg} degrees: {:.5} of the light, {exact:.5}", with / without);
        assert!((with / without / exact - 1.0).abs() < 2e-3, "{} {exact}", with / without);
    }
}

/// A Lambertian screen's light into the pupil by place (unit tangents), over that at the gaze centre: cos³
/// times a biquadratic through the photon budgets of nine pixels.
fn obliquity(tangent: [f64; 2]) -> f64 {
    const AWAY: f64 = 0.8;
    static KNOWN: OnceLock<[[f64; 3]; 3]> = OnceLock::new();
    let cos3 = |t: [f64; 2]| (1.0 + t[0] * t[0] + t[1] * t[1]).powf(-1.5);
    let known = KNOWN.get_or_init(|| {
        let places = [-AWAY, 0.0, AWAY];
        let middle = single(0.0, 0.0);
        places.map(|y| places.map(|x| single(x, y) / middle / cos3([x, y])))
    });
    let weights = tangent.map(|t| {
        let u = t / AWAY;
        [0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0)]
    });
    let row = |row: &[f64; 3]| row.iter().zip(weights[0]).map(|(value, w)| value * w).sum::<f64>();
    cos3(tangent) * known.iter().zip(weights[1]).map(|(values, w)| w * row(values)).sum::<f64>()
}

/// Photons into the pupil of a small pixel of a screen, at a place.
fn single(x: f64, y: f64) -> f64 {
    let (pitch_deg, half) = (0.5, 100_u32);
    let screen = Screen { pitch_deg, size: [2 * half; 2], gaze_px: [f64::from(half); 2] };
    let at_px = [x, -y].map(|t| (f64::from(half) + t / screen.per_px()) as u32);
    // To the middle of the pixel.
    let gaze_px = [0, 1].map(|i| f64::from(at_px[i]) + 0.5 - [x, -y][i] / screen.per_px());
    let moved = Screen { gaze_px, ..screen };
    frame(&moved.experiment(Pattern::Point { at_px, rgb: [1.0; 3] })).budget.into_pupil()
}

/// Squares of 4°, the fovea in the middle of a dark one: light comes there scattered.
fn dark_place(luminance: f64) -> Experiment {
    let pitch_deg = 5.0 / 60.0;
    let screen = Screen { pitch_deg, size: [144; 2], gaze_px: [72.0, 24.0] };
    let mut experiment = screen.experiment(Pattern::Checkerboard { square_px: 48 });
    experiment.display.white = White::LuminanceCdM2(luminance);
    experiment.retina.region_deg = Some([-0.15, 0.15, -0.15, 0.15]);
    experiment
}

/// Counts of some frames and the means of `EXPECTED` as one number by group of cones: all within five
/// standard deviations (alpha 6e-7 a number, 17 of them).
fn within_chance(experiment: &Experiment, means: &[f64], frames: u32) {
    let exposure = cached_exposure(experiment);
    let mut groups = [[0.0; 2]; 16];
    for index in 0..frames {
        let frame = exposure.frame(index, None).unwrap();
        let budget = frame.budget;
        assert!((budget.fates() / budget.emitted - 1.0).abs() < 1e-9, "{budget:?}");
        for (i, (count, mean)) in self::means(&frame).into_iter().zip(means).enumerate() {
            let group = &mut groups[i * 16 / means.len()];
            *group = [group[0] + count, group[1] + mean];
        }
    }
    let all = groups.iter().fold([0.0; 2], |sum, g| [sum[0] + g[0], sum[1] + g[1]]);
    let off = (all[0] - all[1]) / all[1].sqrt();
    println!("{:?}: {} counted, mean {:.1}, {off:.2} sd", experiment.counts.engine, all[0], all[1]);
    for [counted, mean] in groups.into_iter().chain([all]) {
        assert!(mean > 100.0 && (counted - mean).abs() < 5.0 * mean.sqrt(), "{counted} {mean}");
    }
}

/// `EVENTS` counts what `EXPECTED` expects, with a list or without; `PAPER`, whose spreads have no skirt,
/// what is scattered of it.
#[test]
fn engines_count_scattered_light() {
    let age = 70.0;
    let mut experiment = aged(dark_place(100.0), age);
    let expected = means(&frame(&experiment));
    let mut without = experiment.clone();
    without.eye.stray_light = None;
    let image = means(&frame(&without));
    experiment.counts.poisson = true;
    experiment.counts.engine = Engine::Events;
    within_chance(&experiment, &expected, 40);
    experiment.counts.engine = Engine::Paper;
    let scattered: Vec<f64> =
        expected.iter().zip(image).map(|(all, image)| all - kept(age) * image).collect();
    within_chance(&experiment, &scattered, 4);

    let mut dim = aged(dark_place(2.0), age);
    (dim.counts.poisson, dim.counts.engine) = (true, Engine::Events);
    let counts = means(&frame(&dim));
    dim.counts.photon_list = true;
    let listed = frame(&dim);
    assert_eq!(means(&listed), counts);
    let mut again = vec![0.0; counts.len()];
    for photon in listed.photons.as_ref().unwrap() {
        again[photon.cone as usize] += 1.0;
        assert!((0.0..1.0 / 60.0).contains(&photon.time_s) && (photon.wavelength_nm - 555.0).abs() < 150.0);
    }
    assert_eq!(again, counts);
}

/// Where the image's light and its edges are, `EVENTS` with fewer of its photons counts as `EXPECTED`.
#[test]
fn the_image_is_thinned() {
    let screen = Screen { pitch_deg: 2.5 / 60.0, size: [61; 2], gaze_px: [30.5; 2] };
    let mut experiment = aged(screen.experiment(Pattern::Checkerboard { square_px: 5 }), 20.0);
    experiment.display.white = White::LuminanceCdM2(20.0);
    let expected = means(&frame(&experiment));
    (experiment.counts.poisson, experiment.counts.engine) = (true, Engine::Events);
    within_chance(&experiment, &expected, 6);
}

/// The audit's sum over pixels, which shares the function of the angle alone, finds the engine within its
/// target: for small pixels, for large ones, and in the dark.
#[test]
fn the_audit_agrees() {
    for (pitch_deg, square_px) in [(1.0 / 60.0, 7), (0.05, 5)] {
        let screen = Screen { pitch_deg, size: [100; 2], gaze_px: [53.0, 53.7] };
        let mut experiment = aged(screen.experiment(Pattern::Checkerboard { square_px }), 70.0);
        (experiment.accuracy_target, experiment.audit_cones) = (0.001, 6);
        let exposure = cached_exposure(&experiment);
        let made = exposure.frame(0, None).unwrap();
        let samples = exposure.audit(0, None, &[], &made).unwrap();
        for s in &samples {
            println!("{:.6} {:.6} {:.1e}", s.value, s.reference, s.value / s.reference - 1.0);
        }
        let found = verdict(&samples, false).unwrap();
        println!("{found:?}");
        assert!(found.relative_error < experiment.accuracy_target, "{found:?}");
    }
}

/// A projector's picture of 1280 x 1024 pixels before some 50,000 cones: seconds to prepare, and of a frame.
#[test]
#[ignore = "a minute, prints seconds only"]
fn seconds_of_a_large_screen() {
    let screen = Screen { pitch_deg: 2.5 / 60.0, size: [1280, 1024], gaze_px: [640.0, 512.0] };
    let mut experiment = screen.experiment(Pattern::Checkerboard { square_px: 3 });
    experiment.display.primaries = figure_12(WHITE).display.primaries;
    experiment.display.primaries.truncate(2);
    experiment.display.primaries[1].rects[0][2] *= 0.9;
    experiment.retina.region_deg = Some([-1.7, 1.7, -1.7, 1.7]);
    experiment.frames = 3;
    for experiment in [experiment.clone(), aged(experiment, 70.0)] {
        let exposure = cached_exposure(&experiment);
        let started = Instant::now();
        let again = cached_exposure(&experiment);
        let prepared = started.elapsed().as_secs_f64();
        exposure.frame(0, None).unwrap();
        let started = Instant::now();
        again.frame(1, None).unwrap();
        again.frame(2, None).unwrap();
        let frame_s = 0.5 * started.elapsed().as_secs_f64();
        println!("{} cones: {prepared:.2} s to prepare, {frame_s:.3} s a frame", exposure.len());
    }
}
