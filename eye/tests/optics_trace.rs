//! The traced eye against two public optics packages and its published cardinal values.

#![allow(clippy::unwrap_used)] // helpers of tests, too, stop at the first error

use glam::{DVec2, DVec3};
use photoneye_eye::optics::{
    Dispersion, EyeState, Object, OpticsError, Prescription, Projection, PupilBundle, PupilNodes, Ray,
    RayFate, SchematicEye, Side,
};

const RAYS: &str = include_str!("data/optics_rays.csv");

fn state() -> EyeState {
    EyeState {
        pupil_mm: 3.0,
        decentre_mm: 0.4,
        accommodation_a: 0.0,
        dispersion: Dispersion::Polyline,
        side: Side::Right,
    }
}

fn prescription() -> Prescription {
    Prescription::preset("escudero-sanz-navarro").unwrap()
}

fn eye(state: EyeState) -> SchematicEye {
    // As in the packages: the stop by the paraxial magnification of the cornea.
    SchematicEye::with_stop(&prescription(), &state, state.pupil_mm / 1.133_406_1).unwrap()
}

fn close(a: f64, b: f64, tolerance: f64, what: &str) {
    assert!((a - b).abs() <= tolerance, "{what}: {a} is not {b} to {tolerance}");
}

#[test]
fn rays_agree_with_two_public_packages() {
    let eye = eye(EyeState { pupil_mm: 9.0, ..state() });
    let mut rows = 0;
    for line in RAYS.lines().skip(2) {
        let v: Vec<f64> = line.split(',').map(|x| x.parse().unwrap()).collect();
        let at = |k: usize| DVec3::new(v[k], v[k + 1], v[k + 2]);
        for (n, wanted) in eye.indices(v[0])[1..].iter().zip(&v[3..7]) {
            close(*n, *wanted, 1e-12, "index");
        }
        let traced = eye.trace(&Ray::new(at(7), at(10)).unwrap(), v[0]);
        for (hit, k) in traced.hits.iter().zip([13, 16, 22, 25, 28]) {
            assert!((hit.unwrap() - at(k)).length() < 1e-9, "row {rows} surface at column {k}");
        }
        assert!((traced.stop.unwrap() - at(19)).length() < 1e-9);
        assert!((traced.direction - at(31)).length() < 1e-12 || v.len() < 35, "direction");
        close(traced.optical_path_mm, *v.last().unwrap(), 1e-9, "path");
        rows += 1;
    }
    assert_eq!(rows, 27);
}

#[test]
fn cardinal_values() {
    let eye = eye(state());
    let c = eye.cardinal(543.0);
    close(c.power_d, 60.7242, 5e-5, "power");
    close(c.entrance_pupil_z_mm, 3.0401, 5e-5, "entrance pupil");
    close(c.exit_pupil_z_mm, 3.6825, 5e-5, "exit pupil");
    close(c.first_nodal_z_mm, 7.1437, 5e-5, "N");
    close(c.second_nodal_z_mm, 7.4524, 5e-5, "N'");
    close(eye.stop_magnification(), 1.1334061, 5e-8, "stop magnification");
    close(eye.stop_radius_mm(), 1.5 / 1.1334061, 1e-6, "stop radius");
}

#[test]
fn foveal_centre_and_eccentricities() {
    let fovea = eye(state()).fovea();
    assert!((fovea.position - DVec3::new(0.0, 1.43280, 23.83445)).length() < 1e-5, "{fovea:?}");
    let centred = eye(EyeState { decentre_mm: 0.0, ..state() });
    for (field, ecc) in [(10.0, 13.706), (20.0, 27.307), (40.0, 53.732), (60.0, 78.138), (80.0, 98.704)] {
        let landing =
            centred.chief_ray(Object::field(field, 0.0).unwrap(), 543.0).unwrap().landing().unwrap();
        let arm = landing - centred.retina_centre();
        close(arm.x.hypot(arm.y).atan2(arm.z).to_degrees(), ecc, 5e-4, "eccentricity");
    }
    let far = centred.chief_ray(Object::field(95.0, 0.0).unwrap(), 543.0).unwrap().landing().unwrap();
    let arm = far - centred.retina_centre();
    let ecc = arm.y.atan2(arm.z).to_degrees();
    assert!((109.0..110.5).contains(&ecc), "95° lands at {ecc}");
}

#[test]
fn decentred_stop_cancels_the_coma_of_the_fovea() {
    for (decentre, rms) in [(0.4, 0.0494), (0.0, 0.0970), (-0.4, 0.228)] {
        let eye = eye(EyeState { decentre_mm: decentre, ..state() });
        let nodes = PupilNodes { radial: 8, azimuth: 24, edge: 0 };
        let bundle = PupilBundle::trace(&eye, Object::field(5.0, 0.0).unwrap(), 543.0, nodes).unwrap();
        let waves = bundle.variance_mm2().sqrt() / bundle.wavelength_mm();
        // Reference figures of three digits; the last one agrees to 0.3 %.
        close(waves, rms, if rms > 0.1 { 1e-3 } else { 6e-5 }, "wavefront error");
    }
}

#[test]
fn accommodation_focuses_on_the_fovea() {
    let p = prescription();
    for (distance, a, front) in [
        (f64::INFINITY, -0.050, 10.290),
        (2400.0, 0.253, 9.805),
        (1000.0, 0.757, 9.214),
        (500.0, 1.797, 8.400),
        (333.333, 2.981, 7.782),
    ] {
        let found = SchematicEye::accommodation_for(&p, &state(), distance, 543.0).unwrap();
        close(found, a, 2e-3, "nominal accommodation");
        close(10.2 - 1.75 * found.ln_1p(), front, 2e-3, "lens front radius");
    }
    assert!(matches!(
        SchematicEye::accommodation_for(&p, &state(), 60.0, 543.0),
        Err(OpticsError::OutOfRange { .. })
    ));
}

#[test]
fn projection_orientation() {
    for (side, sign) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
        for distance in [400.0, 8000.0, f64::INFINITY] {
            let p = Projection::new(&eye(EyeState { side, ..state() }), distance).unwrap();
            assert!(p.retina_um(DVec2::ZERO, 543.0).unwrap().length() < 1e-8, "the fixated point");
            let right = p.retina_um(DVec2::new(0.01, 0.0), 543.0).unwrap();
            assert!(right.x * sign > 100.0 && right.y.abs() < 1e-6, "{side:?} right lands at {right}");
            let up = p.retina_um(DVec2::new(0.0, 0.01), 543.0).unwrap();
            assert!(up.y < -100.0 && up.x.abs() < 1.0, "{side:?} up lands at {up}");
            // The model's 287 µm per visual degree.
            let degree =
                p.retina_um(DVec2::new(0.5_f64.to_radians().tan(), 0.0), 543.0).unwrap().length() * 2.0;
            assert!((degree - 287.0).abs() < 2.0 || distance < 1e3, "{degree} µm per degree");
        }
    }
}

#[test]
fn projection_inverts() {
    let p = Projection::new(&eye(EyeState { side: Side::Left, ..state() }), 1500.0).unwrap();
    for t in [
        DVec2::ZERO,
        DVec2::new(0.3, -0.2),
        DVec2::new(-1.2, 0.9),
        DVec2::new(2.5, 1.0),
        DVec2::new(-5.5, 0.3),
        DVec2::new(0.1, -6.0),
    ] {
        let um = p.retina_um(t, 543.0).unwrap();
        let back = p.screen_tangent(um).unwrap();
        assert!((back - t).length() < 1e-10 * (1.0 + t.length_squared()), "{t} -> {um} -> {back}");
        let seen = p.visual_deg(um).unwrap();
        close(seen.length(), t.length().atan().to_degrees(), 1e-8, "visual angle");
    }
    assert!(matches!(p.screen_tangent(DVec2::new(36e3, 0.0)), Err(OpticsError::OutsideField { .. })));
    assert!(matches!(p.screen_tangent(DVec2::new(f64::NAN, 0.0)), Err(OpticsError::OutsideField { .. })));
}

#[test]
fn projection_fit_is_close_to_the_exact_one() {
    let p = Projection::new(&eye(state()), 8000.0).unwrap();
    for half in [50.0, 1000.0, 5000.0] {
        let fit = p.fit(DVec2::new(-half, -0.5 * half), DVec2::new(half, 0.7 * half)).unwrap();
        let um = DVec2::new(0.33 * half, -0.21 * half);
        let t = p.screen_tangent(um).unwrap();
        assert!((fit.screen_tangent(um) - t).length() <= 1e-8, "half {half}: {}", fit.max_error());
        let slope = fit.jacobian_tangent_per_um(um) * p.jacobian_um_per_tangent(t).unwrap();
        assert!((slope.x_axis - DVec2::X).length() + (slope.y_axis - DVec2::Y).length() < 1e-5);
        let exit = p.exit_pupil_direction(um).unwrap();
        assert!((fit.exit_pupil_direction(um) - exit).length() < 1e-6);
        println!("half width {half} µm: largest error {:.2e}", fit.max_error());
    }
    // 20° out the exit pupil lies some 10° off the normal, forward, where the tangent away from the fovea points.
    let um = p.retina_um(DVec2::new(20.0_f64.to_radians().tan(), 0.0), 543.0).unwrap();
    let tilt = p.exit_pupil_direction(um).unwrap();
    assert!(tilt.x > 0.0 && (0.1..0.3).contains(&tilt.x.hypot(tilt.y)), "{tilt}");
}

#[test]
fn extremes_end_in_a_result_or_a_typed_error() {
    let nodes = PupilNodes { radial: 4, azimuth: 8, edge: 8 };
    let (mut arrived, mut lost) = (0, 0);
    for pupil_mm in [0.5, 9.0] {
        for accommodation_a in [-2.0, 0.0, 12.0] {
            for dispersion in [Dispersion::Polyline, Dispersion::Herzberger] {
                let eye = eye(EyeState { pupil_mm, accommodation_a, dispersion, ..state() });
                for field in [-105.0, -60.0, 0.0, 5.0, 40.0, 85.0, 95.0, 105.0, 140.0, 180.0] {
                    for vergence in [-20.0, 0.0, 20.0] {
                        for nm in [390.0, 830.0] {
                            match PupilBundle::trace(&eye, Object::field(field, vergence).unwrap(), nm, nodes)
                            {
                                Ok(b) => {
                                    arrived += 1;
                                    assert!(
                                        b.rays
                                            .iter()
                                            .chain(&b.edge)
                                            .all(|r| r.q.is_finite() && r.opd_mm.is_finite())
                                    );
                                }
                                Err(OpticsError::NoRay { .. }) => lost += 1,
                                Err(e) => panic!("{e}"),
                            }
                        }
                    }
                }
            }
        }
    }
    println!("{arrived} bundles traced, {lost} refused");
    assert!(arrived > 300);
}

#[test]
fn chief_rays_reach_105_degrees() {
    let eye = eye(EyeState { decentre_mm: 0.0, ..state() });
    for field in 0..=105 {
        let object = Object::field(f64::from(field), 0.0).unwrap();
        assert!(eye.chief_ray(object, 543.0).is_ok(), "{field}°");
    }
}

#[test]
fn fates_are_named() {
    let eye = eye(state());
    let fate = |p: DVec3, d: DVec3| {
        let traced = eye.trace(&Ray::new(p, d).unwrap(), 543.0);
        assert!(traced.direction.is_finite() && traced.optical_path_mm.is_finite());
        traced.fate
    };
    assert_eq!(fate(DVec3::new(0.0, 0.0, -30.0), DVec3::Z), RayFate::Arrived);
    assert_eq!(fate(DVec3::new(0.0, 3.0, -30.0), DVec3::Z), RayFate::StoppedByIris);
    assert_eq!(fate(DVec3::new(0.0, 20.0, -30.0), DVec3::Z), RayFate::MissedSurface(0));
    assert_eq!(fate(DVec3::new(0.0, 0.0, -30.0), DVec3::NEG_Z), RayFate::MissedSurface(0));
    assert!(Ray::new(DVec3::ZERO, DVec3::ZERO).is_err());
    assert!(Ray::new(DVec3::NAN, DVec3::Z).is_err());
}

#[test]
fn errors_name_the_field() {
    let p = prescription();
    let e = SchematicEye::new(&p, &EyeState { pupil_mm: 0.2, ..state() }).unwrap_err();
    assert_eq!(e.to_string(), "pupil_mm: 0.2 is outside 0.5 to 9");
    assert!(SchematicEye::new(&p, &EyeState { accommodation_a: f64::NAN, ..state() }).is_err());
    let e = Prescription::preset("cyclops").unwrap_err().to_string();
    assert!(e.contains("escudero-sanz-navarro"), "{e}");
}
