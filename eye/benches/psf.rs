//! Cost of the point spread and the transfer function against the direct Huygens sum of 1024 rays.
//!
//! `cargo bench -p photoneye-eye --bench psf`

use glam::DVec2;
use photoneye_eye::optics::{
    Dispersion, EyeState, Object, OpticsError, Prescription, Projection, SchematicEye, Side,
};
use photoneye_eye::psf::{
    FieldTableSpec, HuygensOptions, Otf, PsfGrid, Wavefront, WavefrontOptions, WavefrontTable, huygens, psf,
};
use std::hint::black_box;
use std::time::Instant;

/// Shortest of `rounds` times of `f`, seconds.
fn best<T>(rounds: usize, mut f: impl FnMut() -> T) -> f64 {
    (0..rounds)
        .map(|_| {
            let start = Instant::now();
            black_box(f());
            start.elapsed().as_secs_f64()
        })
        .fold(f64::MAX, f64::min)
}

#[allow(clippy::print_stdout)] // a bench prints its table
fn main() -> Result<(), OpticsError> {
    let p = Prescription::preset("escudero-sanz-navarro")?;
    let options = WavefrontOptions::default();
    println!(
        "{:>9} {:>9} {:>13} {:>11} {:>13} {:>10}",
        "pupil mm", "defocus D", "wavefront µs", "PSF ms", "OTF new µs", "OTF µs/ν"
    );
    for (pupil_mm, vergence) in [(2.0, 0.0), (3.0, 0.0), (3.0, 1.0), (6.0, 0.0), (8.0, 0.0)] {
        let state = EyeState {
            pupil_mm,
            decentre_mm: 0.4,
            accommodation_a: 0.0,
            dispersion: Dispersion::Herzberger,
            side: Side::Right,
        };
        let eye = SchematicEye::new(&p, &state)?;
        let object = Object::field(5.0, vergence)?;
        let w = Wavefront::new(&eye, object, 543.0, &options)?;
        let otf = Otf::new(&w);
        let nus: Vec<f64> = (1..=32).map(|k| otf.cutoff(0.5) * f64::from(k) / 33.0).collect();
        let grid = PsfGrid::new(128, 10.0);
        let fast = best(20, || psf(&w, &grid));
        println!(
            "{pupil_mm:>9} {vergence:>9} {:>13.0} {:>11.3} {:>13.1} {:>10.2}",
            1e6 * best(20, || Wavefront::new(&eye, object, 543.0, &options)),
            1e3 * fast,
            1e6 * best(20, || Otf::new(&w)),
            1e6 / 32.0 * best(50, || otf.radial(0.5, &nus)),
        );
        if pupil_mm < 3.5 && vergence < 0.5 {
            let rays = HuygensOptions { radial: 16, azimuth: 64, exact_distance: true };
            let slow = best(2, || huygens::psf(&eye, object, 543.0, &options, &rays, &grid));
            println!(
                "  direct Huygens sum, 1024 rays, all cores: {:.0} ms; the matrix form is {:.0} times faster",
                1e3 * slow,
                slow / fast
            );
        }
    }
    tables(&p)?;
    projection(&p)
}

/// Images of 45 wavelengths at one field point with their wavefronts, beside the direct sum; and wavefronts of a field.
#[allow(clippy::print_stdout)] // a bench prints its table
fn tables(p: &Prescription) -> Result<(), OpticsError> {
    let options = WavefrontOptions::default();
    let wavelengths: Vec<f64> = (0..45).map(|i| 390.0 + 10.0 * f64::from(i)).collect();
    for pupil_mm in [3.0, 6.0] {
        for dispersion in [Dispersion::Polyline, Dispersion::Herzberger] {
            let state =
                EyeState { pupil_mm, decentre_mm: 0.4, accommodation_a: 0.0, dispersion, side: Side::Right };
            let eye = SchematicEye::new(p, &state)?;
            let object = Object::field(5.0, 0.0)?;
            let grid = PsfGrid::new(128, 10.0);
            let waves = || WavefrontTable::spectrum(&eye, object, &wavelengths, &options);
            let table = || waves().map(|waves| waves.iter().map(|w| psf(w, &grid)).collect::<Vec<_>>());
            let (fast, wavefronts) = (best(3, table), best(5, waves));
            println!(
                "{pupil_mm} mm, {dispersion:?}: 45 wavelengths, wavefronts {:.1} ms, with images 128 x 128 {:.1} ms",
                1e3 * wavefronts,
                1e3 * fast
            );
            if dispersion == Dispersion::Herzberger {
                let rays = HuygensOptions { radial: 16, azimuth: 64, exact_distance: true };
                let slow = best(1, || huygens::psf(&eye, object, 543.0, &options, &rays, &grid));
                println!("  direct sum, 1024 rays, all cores, times 45: {:.0} ms", 45e3 * slow);
            }
            for reach_deg in [2.0, 10.0, 30.0] {
                let Some((half_deg, nodes)) = FieldTableSpec::field(reach_deg, pupil_mm) else { continue };
                let spec = FieldTableSpec {
                    prescription: p.clone(),
                    state,
                    distance_mm: 2400.0,
                    half_deg,
                    nodes,
                    stiles_crawford_rho10_per_mm2: photoneye_eye::cone::directional::DEFAULT_RHO10_PER_MM2,
                };
                let made = spec.build()?;
                let one = best(20, || made.at(DVec2::splat(0.3 * half_deg.to_radians())));
                println!(
                    "  field of ±{half_deg}°, {} wavefronts, {} kB: {:.1} ms on all cores; the wavelengths of a point of it {:.0} µs",
                    spec.traced()?,
                    made.to_bytes().map_or(0, |bytes| bytes.len() / 1000),
                    1e3 * best(5, || spec.build()),
                    1e6 * one
                );
            }
        }
    }
    Ok(())
}

#[allow(clippy::print_stdout)] // a bench prints its table
fn projection(p: &Prescription) -> Result<(), OpticsError> {
    let state = EyeState {
        pupil_mm: 3.0,
        decentre_mm: 0.4,
        accommodation_a: 0.0,
        dispersion: Dispersion::Herzberger,
        side: Side::Right,
    };
    let eye = SchematicEye::new(p, &state)?;
    let screen = Projection::new(&eye, 2400.0)?;
    let um = DVec2::new(1500.0, -700.0);
    let fit = screen.fit(DVec2::splat(-2000.0), DVec2::splat(2000.0))?;
    println!(
        "focusing {:.2} ms",
        1e3 * best(5, || SchematicEye::accommodation_for(p, &state, 2400.0, 543.0))
    );
    println!(
        "chief ray to the retina {:.2} µs",
        1e6 * best(200, || screen.retina_um(DVec2::new(0.1, 0.2), 543.0))
    );
    println!("retina to screen, exact {:.1} µs", 1e6 * best(200, || screen.screen_tangent(um)));
    println!(
        "fit over ±2 mm {:.2} ms, error {:.1e}; evaluation {:.0} ns",
        1e3 * best(5, || screen.fit(DVec2::splat(-2000.0), DVec2::splat(2000.0))),
        fit.max_error(),
        1e6 * best(20, || (0..1000).map(|k| fit.screen_tangent(um + f64::from(k)).x).sum::<f64>())
    );
    Ok(())
}
