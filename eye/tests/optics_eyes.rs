//! Every eye of the catalogue: published cardinal values, colour, focus, astigmatism, measured wavefronts, extremes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test stops at the first error")]

use glam::{DVec2, DVec3};
use photoneye_eye::catalog;
use photoneye_eye::optics::prescription::ToricData;
use photoneye_eye::optics::surface::{Conic, refract};
use photoneye_eye::optics::zernike::{ExtraWavefront, zernike};
use photoneye_eye::optics::{
    Dispersion, EyeState, Object, OpticsError, Prescription, Projection, PupilBundle, PupilNodes, Ray,
    SchematicEye, Side,
};
use photoneye_eye::plan::setup::retina_geometry;
use photoneye_eye::psf::{HuygensOptions, PsfGrid, Wavefront, WavefrontOptions, huygens, psf};
use photoneye_eye::retina::RetinaParams;

fn state_of(p: &Prescription) -> EyeState {
    let (decentre_mm, dispersion) = (p.stop_decentre_mm, p.default_dispersion());
    EyeState { pupil_mm: 3.0, decentre_mm, accommodation_a: 0.0, dispersion, side: Side::Right }
}

fn eye(name: &str, dispersion: Dispersion) -> SchematicEye {
    let p = Prescription::preset(name).unwrap();
    SchematicEye::new(&p, &EyeState { dispersion, ..state_of(&p) }).unwrap()
}

fn all() -> Vec<(&'static str, Prescription)> {
    catalog::names("eyes").into_iter().map(|name| (name, Prescription::preset(name).unwrap())).collect()
}

fn close(a: f64, b: f64, tolerance: f64, what: &str) {
    assert!((a - b).abs() <= tolerance, "{what}: {a} is not {b} to {tolerance}");
}

/// Power, axial length and focus on the retina as published. Of the last eye, what its published surfaces give.
#[test]
fn cardinal_values_of_the_literature() {
    for (name, law, nm, power_d, length_mm, focus_mm) in [
        ("escudero-sanz-navarro", Dispersion::Polyline, 543.0, 60.724, 23.9203, 2e-5),
        ("navarro-1985", Dispersion::Polyline, 589.3, 60.416, 24.004, 1e-5),
        ("liou-brennan-1997", Dispersion::Quadratic, 555.0, 60.35, 23.95, 2e-3),
        ("atchison-2006", Dispersion::Quadratic, 555.0, 61.51, 23.58, 1e-2),
    ] {
        let eye = eye(name, law);
        let c = eye.cardinal(nm);
        let length = eye.prescription().axial_length_mm();
        close(length, length_mm, 1e-4, name);
        close(c.power_d, power_d, 2e-3, name);
        // The second nodal point lies 1/P before the focus in the vitreous.
        close(c.second_nodal_z_mm + 1e3 / c.power_d, length, focus_mm, name);
    }
}

/// Chromatic difference of refraction between 400 and 700 nm. Water in every medium (Liou & Brennan) gives half of it.
#[test]
fn chromatic_aberration() {
    for (name, law, wanted_d) in [
        ("escudero-sanz-navarro", Dispersion::Herzberger, 2.47),
        ("escudero-sanz-navarro", Dispersion::Polyline, 2.00),
        ("navarro-1985", Dispersion::Herzberger, 2.47),
        ("navarro-1985", Dispersion::Polyline, 2.00),
        ("liou-brennan-1997", Dispersion::Quadratic, 1.03),
        ("atchison-2006", Dispersion::Quadratic, 1.02),
    ] {
        let eye = eye(name, law);
        let refraction = |nm: f64| {
            let (c, n) = (eye.cardinal(nm), eye.indices(nm)[4]);
            let second_principal = c.second_nodal_z_mm - (n - 1.0) * 1e3 / c.power_d;
            n * 1e3 / (eye.prescription().axial_length_mm() - second_principal) - c.power_d
        };
        close(refraction(700.0) - refraction(400.0), wanted_d, 0.006, name);
        // And so do real rays through a small pupil, near the axis.
        let p = eye.prescription();
        let small = EyeState { pupil_mm: 1.0, ..eye.state() };
        let small = SchematicEye::new(p, &small).unwrap();
        let real = small.focus_vergence_d(400.0).unwrap() - small.focus_vergence_d(700.0).unwrap();
        close(real, wanted_d, 0.12, name);
    }
}

#[test]
fn a_law_that_the_eye_has_no_table_for_is_refused() {
    let p = Prescription::preset("liou-brennan-1997").unwrap();
    let e =
        SchematicEye::new(&p, &EyeState { dispersion: Dispersion::Herzberger, ..state_of(&p) }).unwrap_err();
    assert_eq!(
        e.to_string(),
        "dispersion: this eye has no table for `HERZBERGER`, expected one of `QUADRATIC`"
    );
}

/// Every eye is emmetropic enough for the depth of focus and sharp: Strehl ratio at 3 mm, reference wavelength, best focus.
#[test]
fn the_eyes_are_sharp() {
    for (name, p) in all() {
        let eye = SchematicEye::new(&p, &state_of(&p)).unwrap();
        let nm = p.reference_wavelength_nm;
        let focus_d = eye.focus_vergence_d(nm).unwrap();
        assert!(focus_d.abs() < 0.25, "{name}: {focus_d}");
        let object = Object::field(p.fovea_angle_deg, focus_d).unwrap();
        let w = Wavefront::new(&eye, object, nm, &WavefrontOptions::default()).unwrap();
        println!("{name}: focus {focus_d:.3} D, Strehl {:.3}, rms {:.3} waves", w.strehl(), w.rms_waves());
        assert!(w.strehl() > 0.5, "{name}: {}", w.strehl());
    }
}

#[test]
fn accommodation_follows_the_law_or_is_refused() {
    let distances = [f64::INFINITY, 8000.0, 2000.0, 500.0, 250.0];
    let navarro = Prescription::preset("navarro-1985").unwrap();
    let mut before = -1.0;
    for distance in distances {
        let a = SchematicEye::accommodation_for(&navarro, &state_of(&navarro), distance, 589.3).unwrap();
        assert!(a > before, "{distance}: {a}");
        let eye =
            SchematicEye::new(&navarro, &EyeState { accommodation_a: a, ..state_of(&navarro) }).unwrap();
        close(eye.focus_vergence_d(589.3).unwrap(), 1e3 / distance, 0.02, "focus");
        before = a;
    }
    let near = SchematicEye::accommodation_for(&navarro, &state_of(&navarro), 70.0, 543.0);
    assert!(matches!(near, Err(OpticsError::OutOfRange { .. })), "{near:?}");
    for name in ["liou-brennan-1997", "atchison-2006"] {
        let p = Prescription::preset(name).unwrap();
        assert_eq!(SchematicEye::accommodation_for(&p, &state_of(&p), 8000.0, 543.0), Ok(0.0));
        let e = SchematicEye::accommodation_for(&p, &state_of(&p), 500.0, 543.0).unwrap_err();
        assert!(
            matches!(e, OpticsError::CannotFocus { .. }) && e.to_string().contains("focus.relaxed"),
            "{e}"
        );
        assert!(SchematicEye::new(&p, &EyeState { accommodation_a: 0.5, ..state_of(&p) }).is_err());
    }
}

/// The iris rides on the lens: a plane of the stop at its front vertex, in every state.
#[test]
fn the_iris_moves_with_the_lens() {
    let p = Prescription::preset("navarro-1985").unwrap();
    for (a, depth) in [(0.0, 3.05), (4.0, 2.96953), (10.0, 2.93011)] {
        let eye = SchematicEye::new(&p, &EyeState { accommodation_a: a, ..state_of(&p) }).unwrap();
        close(eye.stop_centre().z, 0.55 + depth, 6e-6, "iris");
        close(eye.thickness_mm().iter().sum::<f64>(), 24.00398, 1e-12, "length");
    }
}

/// Zernike coefficients (standard sign, clinician's axes) of an eye on its axis with a centred pupil, µm.
fn coefficients(p: &Prescription, side: Side) -> [f64; 3] {
    let eye = SchematicEye::new(p, &EyeState { decentre_mm: 0.0, side, ..state_of(p) }).unwrap();
    let nodes = PupilNodes { radial: 8, azimuth: 24, edge: 0 };
    let bundle = PupilBundle::trace(&eye, Object::field(0.0, 0.0).unwrap(), 543.0, nodes).unwrap();
    let [right, up] = side.clinician_axes();
    [3, 4, 5].map(|j| {
        let sum = bundle.rays.iter().map(|r| {
            let at = DVec2::new(r.stop.dot(right), r.stop.dot(up));
            r.weight * zernike(j, at) * r.opd_mm
        });
        -1e3 * bundle.n_vitreous * sum.sum::<f64>() / std::f64::consts::PI
    })
}

/// A toric cornea of so many dioptres at an axis has the power vector that clinicians expect, and the wavefront of the same
/// coefficients undoes it.
#[test]
fn toric_corneas_have_the_power_vector_of_their_axis() {
    let round = Prescription::preset("escudero-sanz-navarro").unwrap();
    let radius_mm: f64 = 1.5;
    for side in [Side::Right, Side::Left] {
        for axis_deg in [0.0, 30.0, 90.0, 135.0] {
            let mut toric = round.clone();
            let flat = 7.72;
            let steep = 1.0 / (1.0 / flat + 1e-3 / 0.3777);
            let conic = round.cornea_front.conic;
            toric.cornea_front.toric = Some(ToricData { radius_mm: steep, conic, axis_deg });
            toric.validate().unwrap();
            let (with, without) = (coefficients(&toric, side), coefficients(&round, side));
            let [c3, c4, c5] = [0, 1, 2].map(|k| with[k] - without[k]);
            // 1 D more power across the axis: sphere 0, cylinder −1 D at that axis.
            let two = 2.0 * f64::to_radians(axis_deg);
            let per = radius_mm * radius_mm;
            let power = [-2.0 * 6.0_f64.sqrt() * c5 / per, -2.0 * 6.0_f64.sqrt() * c3 / per];
            close(power[0], 0.5 * two.cos(), 0.01, "J0");
            close(power[1], 0.5 * two.sin(), 0.01, "J45");
            close(-4.0 * 3.0_f64.sqrt() * c4 / per, -0.5, 0.01, "mean sphere");
            let mut undone = toric.clone();
            let coefficients_um = vec![0.0, 0.0, 0.0, -c3, -c4, -c5];
            undone.wavefront = Some(ExtraWavefront { pupil_mm: 3.0, coefficients_um });
            for (a, b) in coefficients(&undone, side).iter().zip(without) {
                close(*a, b, 1e-12, "undone");
            }
        }
    }
}

/// A measured c_4 of −1 D of refraction (a myope) moves the far point to 1 m.
#[test]
fn a_myopic_wavefront_focuses_near() {
    let p = Prescription::preset("escudero-sanz-navarro").unwrap();
    let c4 = 2.0_f64.powi(2) / (4.0 * 3.0_f64.sqrt());
    let myope = Prescription {
        wavefront: Some(ExtraWavefront { pupil_mm: 4.0, coefficients_um: vec![0.0, 0.0, 0.0, 0.0, c4] }),
        ..p.clone()
    };
    let focus = |p: &Prescription, pupil_mm: f64, decentre_mm: f64| {
        let state = EyeState { pupil_mm, decentre_mm, ..state_of(p) };
        SchematicEye::new(p, &state).unwrap().focus_vergence_d(543.0).unwrap()
    };
    let moved = |on_axis: bool, pupil_mm: f64, decentre_mm: f64| {
        let angle = if on_axis { 0.0 } else { 5.0 };
        let [with, without] = [&myope, &p]
            .map(|p| focus(&Prescription { fovea_angle_deg: angle, ..p.clone() }, pupil_mm, decentre_mm));
        with - without
    };
    // On the axis through a small pupil: 1 D at the pupil is a little more at the apex, 3.04 mm before it.
    close(moved(true, 0.5, 0.0), 1.0 / (1.0 - 3.04e-3), 1e-3, "far point on the axis");
    // At the fovea, slant and the real entrance pupil (1 % smaller than the nominal one that coefficients are meant in) add 1.5 %.
    close(moved(false, 3.0, 0.4), 1.0, 0.02, "far point");
    let e = SchematicEye::new(&myope, &EyeState { pupil_mm: 5.0, ..state_of(&myope) }).unwrap_err();
    assert!(e.to_string().starts_with("pupil_mm (with a measured wavefront): 5 is outside"), "{e}");
}

/// The myopic eyes of Atchison 2006: cornea, length and retina by spectacle refraction. An axial myope's far point is where the
/// spectacles (14 mm before the cornea) put infinity.
#[test]
fn long_eyes_of_the_literature_are_myopic() {
    for spectacles_d in [-2.0, -5.0, -8.0] {
        let mut p = Prescription::preset("atchison-2006").unwrap();
        let relaxed = SchematicEye::new(&p, &state_of(&p)).unwrap().focus_vergence_d(555.0).unwrap();
        p.cornea_front.radius_mm += 0.022 * spectacles_d;
        p.lens_back.thickness_mm -= 0.299 * spectacles_d;
        let focus_d = SchematicEye::new(&p, &state_of(&p)).unwrap().focus_vergence_d(555.0).unwrap();
        let at_cornea_d = -spectacles_d / (1.0 - 0.014 * spectacles_d);
        // The source's fits to a group of eyes meet their refractions to some 0.3 D.
        close(focus_d - relaxed, at_cornea_d, 0.3, "far point");
        println!("{spectacles_d} D: {focus_d} {at_cornea_d}");
    }
}

/// The fitted wavefront carries measured errors of high order: its point spread is that of Huygens' sum.
#[test]
fn measured_wavefronts_are_fitted() {
    let mut p = Prescription::preset("escudero-sanz-navarro").unwrap();
    let mut coefficients_um = vec![0.0; 45];
    for (j, c) in
        [(3, 0.12), (6, -0.08), (7, 0.09), (11, 0.05), (14, -0.04), (24, 0.03), (30, -0.02), (44, 0.02)]
    {
        coefficients_um[j] = c;
    }
    p.wavefront = Some(ExtraWavefront { pupil_mm: 6.0, coefficients_um });
    for (pupil_mm, worst) in [(3.0, 1e-4), (6.0, 3e-3)] {
        let eye = SchematicEye::new(&p, &EyeState { pupil_mm, ..state_of(&p) }).unwrap();
        let object = Object::field(5.0, 0.0).unwrap();
        let options = WavefrontOptions::default();
        let grid = PsfGrid::new(24, 8.0);
        let fitted = psf(&Wavefront::new(&eye, object, 543.0, &options).unwrap(), &grid);
        let rays = HuygensOptions { radial: 40, azimuth: 126, exact_distance: true };
        let exact = huygens::psf(&eye, object, 543.0, &options, &rays, &grid).unwrap();
        let peak = exact.iter().copied().fold(0.0, f64::max);
        let error = fitted.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / peak;
        println!("{pupil_mm} mm: largest difference {error:.1e} of the peak");
        assert!(error < worst, "{error}");
    }
}

/// Pupil, field, focus, colour, side, every eye: numbers or a typed error.
#[test]
fn extremes_end_in_numbers_or_a_typed_error() {
    let nodes = PupilNodes { radial: 2, azimuth: 6, edge: 4 };
    for (name, p) in all() {
        let (mut arrived, mut lost) = (0, 0);
        for pupil_mm in [0.5, 3.0, 9.0] {
            for side in [Side::Right, Side::Left] {
                let eye = SchematicEye::new(&p, &EyeState { pupil_mm, side, ..state_of(&p) }).unwrap();
                for field in [-110.0, -95.0, -60.0, -20.0, 0.0, 5.0, 40.0, 80.0, 95.0, 105.0, 110.0] {
                    for vergence in [-20.0, -3.0, 0.0, 20.0] {
                        for nm in [390.0, 543.0, 830.0] {
                            let object = Object::field(field, vergence).unwrap();
                            match PupilBundle::trace(&eye, object, nm, nodes) {
                                Ok(b) => {
                                    arrived += 1;
                                    let rays = b.rays.iter().chain(&b.edge);
                                    let finite = |x: &[f64]| x.iter().all(|v| v.is_finite());
                                    assert!(rays.clone().all(|r| r.q.is_finite() && r.opd_mm.is_finite()));
                                    assert!(
                                        rays.clone().all(|r| r.landing.is_finite() && finite(&r.path_mm))
                                    );
                                }
                                Err(OpticsError::NoRay { .. }) => lost += 1,
                                Err(e) => panic!("{name}: {e}"),
                            }
                        }
                    }
                }
            }
        }
        println!("{name}: {arrived} bundles traced, {lost} refused");
        assert!(arrived > 400, "{name}: {arrived}");
    }
}

/// The field of every eye: chief rays to 90° on both sides, landing ever farther out.
#[test]
fn chief_rays_reach_90_degrees() {
    for (name, p) in all() {
        let eye = SchematicEye::new(&p, &state_of(&p)).unwrap();
        let mut before = -3.0;
        for field in -90..=90 {
            let chief = eye.chief_ray(Object::field(f64::from(field), 0.0).unwrap(), 543.0);
            let arm = chief.unwrap().landing().unwrap() - eye.retina_centre();
            let angle = arm.y.atan2(arm.z);
            assert!(angle > before, "{name} {field}°");
            before = angle;
        }
    }
}

/// A ray sent back from the retina leaves the eye where it came in.
#[test]
fn rays_are_reversible() {
    for name in ["escudero-sanz-navarro", "navarro-1985"] {
        let p = Prescription::preset(name).unwrap();
        let eye = SchematicEye::new(&p, &EyeState { pupil_mm: 8.0, ..state_of(&p) }).unwrap();
        let n = eye.indices(600.0);
        let mut z = 0.0;
        let surfaces = [p.cornea_front, p.cornea_back, p.lens_front, p.lens_back].map(|s| {
            let conic = Conic { vertex_z: z, radius: s.radius_mm, conic: s.conic };
            z += s.thickness_mm;
            conic
        });
        let mut arrived = 0;
        for k in 0..200 {
            let (a, slant) = (0.37 * f64::from(k), 0.004 * f64::from(k));
            let d = DVec3::new(slant * a.sin(), slant * a.cos(), 1.0);
            let aim = DVec3::new(2.0 * (1.7 * a).cos(), 1.5 * (2.3 * a).sin(), 3.0);
            let ray = Ray::new(aim - 30.0 * d, d).unwrap();
            let there = eye.trace(&ray, 600.0);
            let Some(landing) = there.hits[4] else { continue };
            let (mut point, mut way) = (landing, -there.direction);
            for (k, surface) in surfaces.iter().enumerate().rev() {
                // Of a closed surface the ray coming from behind meets the vertex half last or first: the one it came by.
                point += (there.hits[k].unwrap() - point).dot(way) * way;
                point += surface.nearest(point, way).unwrap() * way;
                way = refract(way, surface.normal_against(point, way), n[k + 1], n[k]).unwrap();
            }
            assert!((way + ray.direction()).length() < 1e-12, "{name} {k}");
            assert!((point - there.hits[0].unwrap()).length() < 1e-11, "{name} {k}");
            arrived += 1;
        }
        assert!(arrived > 100, "{arrived}");
    }
}

/// Astigmatism at an oblique axis takes the fovea off the plane of symmetry: right stays right and up stays up.
#[test]
fn oblique_astigmatism_keeps_the_orientation() {
    let mut p = Prescription::preset("escudero-sanz-navarro").unwrap();
    p.cornea_front.toric = Some(ToricData { radius_mm: 7.2, conic: -0.26, axis_deg: 35.0 });
    for (side, sign) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
        let eye = SchematicEye::new(&p, &EyeState { side, ..state_of(&p) }).unwrap();
        assert!(eye.fovea().position.x.abs() > 1e-3, "{:?}", eye.fovea());
        let screen = Projection::new(&eye, 2000.0).unwrap();
        assert!(screen.retina_um(DVec2::ZERO, 543.0).unwrap().length() < 1e-8);
        let right = screen.retina_um(DVec2::new(0.01, 0.0), 543.0).unwrap();
        let up = screen.retina_um(DVec2::new(0.0, 0.01), 543.0).unwrap();
        assert!(
            right.x * sign > 150.0 && right.y.abs() < 10.0 && up.y < -150.0 && up.x.abs() < 10.0,
            "{right} {up}"
        );
        let t = DVec2::new(0.2, -0.1);
        let back = screen.screen_tangent(screen.retina_um(t, 543.0).unwrap()).unwrap();
        assert!((back - t).length() < 1e-9, "{back}");
    }
}

/// A mosaic can be made on the retina of every eye, of either side, of people of many sizes.
#[test]
fn every_eye_has_a_retina() {
    for (name, p) in all() {
        for eye in [p.clone(), p.scaled_to(22.0).unwrap(), p.scaled_to(27.0).unwrap(), p.person(3).unwrap()] {
            for side in [Side::Right, Side::Left] {
                let geometry = retina_geometry(&eye, &EyeState { side, ..state_of(&eye) }).unwrap();
                close(geometry.radius_um, -1e3 * eye.retina_radius_mm, 1e-2, name);
                let params = RetinaParams { geometry, ..RetinaParams::default() };
                assert_eq!(params.validate(), Ok(()), "{name} {}", eye.axial_length_mm());
            }
        }
    }
}

/// A change of an eye's data.
type Change<'a> = &'a dyn Fn(&mut Prescription);

#[test]
fn what_is_no_eye_is_refused_by_field() {
    let p = Prescription::preset("liou-brennan-1997").unwrap();
    let refused = |change: &dyn Fn(&mut Prescription)| {
        let mut eye = p.clone();
        change(&mut eye);
        eye.validate().unwrap_err().to_string()
    };
    let cases: [(Change, &str); 8] = [
        (&|p| p.cornea_back.conic = f64::NAN, "cornea_back.conic: NaN is outside -20 to 20"),
        (&|p| p.lens_back.radius_mm = 8.0, "lens_back.radius_mm: 8 is outside -60 to -3"),
        (&|p| p.lens_front.thickness_mm = 1.5, "lens_gradient.parts.from_mm: 1.59 is outside"),
        (&|p| p.quadratic = None, "indices: an eye needs one of"),
        (&|p| p.quadratic.as_mut().unwrap().lens = 2.0, "quadratic (index): 2"),
        (&|p| p.retina_radius_mm = 12.0, "retina_radius_mm: 12 is outside -20 to -8"),
        (
            &|p| p.lens_gradient.as_mut().unwrap().parts[0].from_mm = 0.1,
            "lens_gradient.parts.from_mm: 0.1 is outside 0 to 0",
        ),
        (
            &|p| p.wavefront = Some(ExtraWavefront { pupil_mm: 6.0, coefficients_um: vec![0.0; 46] }),
            "wavefront.coefficients_um (how many): 46 is outside 0 to 45",
        ),
    ];
    for (change, expected) in cases {
        let error = refused(change);
        assert!(error.starts_with(expected), "{error}");
    }
    let e = Prescription::from_json("mine", "{\"x\": 1}").unwrap_err().to_string();
    assert!(e.contains("mine") && e.contains("unknown field `x`"), "{e}");
}
