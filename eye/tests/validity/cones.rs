//! The number of cones and the size of their apertures against what was measured.
//!
//! Curcio, Sloan, Kalina & Hendrickson 1990 (J Comp Neurol 292:497): 4.6 million cones in the mean eye, 4.08
//! to 5.29 million in single eyes; densities (1/mm²) along four meridians on a sphere of 11.402 mm, here
//! integrated over rings of retinal degrees:
//!
//! N = R²·Σ 2π sin θ·mean over meridians of ρ(θ)·dθ.     (1)
//!
//! Inner segments: 2.3 µm across at the centre (Rodieck 1998), then 5.9 to 8.0 µm in Curcio's
//! photomicrographs (11.402 mm sphere); Banks, Sekuler & Anderson 1991 (JOSA A 8:1775), in arcmin, for
//! comparison.

use std::f64::consts::{FRAC_PI_4, TAU};

use glam::DVec2;
use photoneye_eye::catalog;
use photoneye_eye::retina::{Aperture, Density, RegionUm, RetinaParams, build_region, local};

/// Radii of Curcio's sphere and of the retina, mm.
const CURCIO_MM: f64 = 11.402;
const RETINA_MM: f64 = 12.0;
/// Degrees between the table's outer rows.
const ROW_DEG: f64 = 5.0;
/// Curcio's cones of the mean eye, and the least and the most, millions.
const MEAN: f64 = 4.6;
const RANGE: [f64; 2] = [4.08, 5.29];

/// (retinal degrees, cones per mm²) along one meridian of Curcio's table: 1 nasal, 2 superior, 3 temporal, 4
/// inferior.
fn meridian(column: usize) -> Vec<(f64, f64)> {
    let text = catalog::text("spectra", "cone-density-curcio").unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        Some((fields[0].parse().unwrap(), fields[column].parse().ok()?))
    };
    rows.filter_map(row).collect()
}

/// The table at an eccentricity: between rows a power of the eccentricity (from the centre to the first row
/// an exponential); from the last row a straight line to zero at where the next one would be.
fn interpolated(table: &[(f64, f64)], deg: f64) -> f64 {
    let above = table.partition_point(|row| row.0 <= deg);
    let (low_deg, low) = table[above - 1];
    let Some(&(high_deg, high)) = table.get(above) else {
        return low * (1.0 - (deg - low_deg) / ROW_DEG).max(0.0);
    };
    let t = if low_deg > 0.0 { (deg / low_deg).ln() / (high_deg / low_deg).ln() } else { deg / high_deg };
    low * (high / low).powf(t)
}

/// Equation (1) between two eccentricities (retinal degrees), millions.
fn integrated(radius_mm: f64, from_deg: f64, to_deg: f64, ring_mean: impl Fn(f64) -> f64) -> f64 {
    let steps = (200.0 * (to_deg - from_deg)).ceil().min(2_000.0);
    let step = (to_deg - from_deg) / steps;
    let ring = |k: u32| {
        let deg = from_deg + (f64::from(k) + 0.5) * step;
        TAU * deg.to_radians().sin() * step.to_radians() * ring_mean(deg)
    };
    1e-6 * radius_mm.powi(2) * (0..steps as u32).map(ring).sum::<f64>()
}

/// The mean of the project's density around a ring, inside the retina; the optic disc filled or not.
fn ours(density: &Density, deg: f64) -> f64 {
    const DIRECTIONS: u32 = 180;
    let at = |k: u32| {
        let turn = TAU * (f64::from(k) + 0.5) / f64::from(DIRECTIONS);
        DVec2::from_angle(turn) * (1e3 * RETINA_MM * deg.to_radians())
    };
    let cones = (0..DIRECTIONS).map(at).filter(|p| density.is_retina(*p)).map(|p| density.per_mm2(p));
    cones.sum::<f64>() / f64::from(DIRECTIONS)
}

/// Band by band the density law holds Curcio's cones, and in all as many as her eyes have.
#[test]
fn as_many_cones_as_curcio_counted() {
    let tables = [1, 2, 3, 4].map(meridian);
    let table_mean = |deg: f64| tables.iter().map(|table| interpolated(table, deg)).sum::<f64>() / 4.0;
    // Her table with its own peak, and no hole: she interpolates through the disc.
    let params =
        RetinaParams { peak_density_per_mm2: 196_890.0, optic_disc: None, ..RetinaParams::default() };
    let density = Density::new(&params);
    let edges =
        [0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 128.0];
    let (mut table_total, mut total) = (0.0, 0.0);
    println!("retinal degrees: Curcio's table, ours (thousands of cones)");
    for edge in edges.windows(2) {
        let table = integrated(CURCIO_MM, edge[0], edge[1], table_mean);
        let here = integrated(RETINA_MM, edge[0], edge[1], |deg| ours(&density, deg));
        println!("{:3} to {:3}: {:7.1} {:7.1}", edge[0], edge[1], 1e3 * table, 1e3 * here);
        // All four meridians have data to 90°.
        assert!(edge[1] > 90.0 || (here / table - 1.0).abs() < 0.02, "{edge:?}: {here} {table}");
        (table_total, total) = (table_total + table, total + here);
    }
    println!(
        "in all: table {table_total:.3} million, ours {total:.3} million, Curcio's eyes {RANGE:?}, mean {MEAN}"
    );
    assert!((table_total / MEAN - 1.0).abs() < 0.01, "{table_total}");
    assert!((RANGE[0]..RANGE[1]).contains(&total) && (total / MEAN - 1.0).abs() < 0.01, "{total}");
    // The retina that the mosaic has, disc and default peak.
    let mosaic = Density::new(&RetinaParams::default());
    let mosaic = integrated(RETINA_MM, 0.0, 128.0, |deg| ours(&mosaic, deg));
    println!("without the optic disc: {mosaic:.3} million");
    assert!((RANGE[0]..RANGE[1]).contains(&mosaic), "{mosaic}");
}

/// The mean aperture of cones at an eccentricity (retinal degrees), µm² in the plane of the retina, over four
/// directions.
fn aperture_um2(aperture: Aperture, deg: f64) -> f64 {
    // At the centre, where 4 µm change the area by 2 %, a few cones of many mosaics.
    let half = if deg > 0.0 { 90.0 } else { 2.0 };
    let directions = if deg > 0.0 { 4_u32 } else { 60 };
    let mut sum = 0.0;
    for k in 0..directions {
        let params = RetinaParams { aperture, seed: k.into(), ..RetinaParams::default() };
        let out = DVec2::from_angle(TAU * (f64::from(k) + 0.5) / f64::from(directions));
        let at = out * (1e3 * RETINA_MM * deg.to_radians());
        let region = RegionUm { min: at - half, max: at + half };
        let retina = build_region(&params, &region).unwrap();
        let flat = |i: usize| {
            let cos_tilt = local(&params.geometry, retina.center(i)).cos_tilt;
            f64::from(retina.aperture_um2[i]) / cos_tilt
        };
        sum += (0..retina.len()).map(flat).sum::<f64>() / retina.len() as f64;
    }
    sum / f64::from(directions)
}

/// Where inner segments were measured, both options against them.
#[test]
fn apertures_against_measured_inner_segments() {
    // (mm on Curcio's sphere, µm); the centre is Rodieck's, of an eye of our scale.
    let frames = [(0.66, 5.9), (1.35, 6.5), (5.0, 7.0), (8.0, 7.5), (16.0, 8.0)];
    let scale = RETINA_MM / CURCIO_MM;
    let curcio = frames.map(|(mm, um): (f64, f64)| ((mm / CURCIO_MM).to_degrees(), um * scale));
    println!("retinal degrees: measured µm², CELL and INNER_SEGMENT over it");
    for (deg, um) in std::iter::once((0.0, 2.3)).chain(curcio) {
        let measured = FRAC_PI_4 * um * um;
        let [cell, inner] = [Aperture::Cell, Aperture::InnerSegment].map(|a| aperture_um2(a, deg) / measured);
        println!("{deg:5.2}: {measured:6.2} {cell:.3} {inner:.3}");
        assert!((inner - 1.0).abs() < 0.03, "{deg}: {inner}");
        // The paper's apertures: a third larger at the centre, 6 to 39 % larger elsewhere.
        assert!(deg > 0.0 || (cell - 1.34).abs() < 0.03, "{cell}");
        assert!((1.0..1.45).contains(&cell), "{deg}: {cell}");
    }
}

/// Diameters of other eyes, Banks et al. 1991, from 2 to 20 visual degrees. Curcio's eyes differ in density
/// by 16 % at 2 to 3 retinal degrees and by 12 % farther out (standard deviation): two of these are 12 to 16
/// % in diameter.
#[test]
fn inner_segments_as_wide_as_banks_have_them() {
    // (visual degrees, arcmin).
    for (deg, arcmin) in [(2.042, 1.10), (5.075, 1.33), (9.921, 1.58), (19.948, 1.63)] {
        // 287 µm a degree at the fovea, as the default geometry has everywhere.
        let um = 287.0;
        let area = aperture_um2(Aperture::InnerSegment, (um * deg * 1e-3 / RETINA_MM).to_degrees());
        let (diameter, banks) = ((area / FRAC_PI_4).sqrt(), um * arcmin / 60.0);
        println!("{deg:6.2}°: {diameter:.2} µm, Banks {banks:.2} µm");
        assert!((diameter / banks - 1.0).abs() < 0.15, "{deg}: {diameter} {banks}");
    }
}
