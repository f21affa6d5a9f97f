//! Media and pigments against the cone fundamentals of Stockman & Sharpe 2000 (2°, quantal, peak 1 for each cone), 390 to 780 nm.
//!
//! `F(λ) = T_cornea(λ) T_lens(λ) T_macula(λ) J(λ)`, divided by its peak over 0.1 nm: what is flat over wavelength drops out.
//! The fundamentals are for a macular peak of 0.35, the mean over 2°, and peak densities of 0.50, 0.50 and 0.40 (the fovea's here).

use photoneye_eye::cone::pigment::Pigments;
use photoneye_eye::exposure::spectral::{Absorbers, Kind, Paths};
use photoneye_eye::media::Media;
use photoneye_eye::optics::{EyeState, Object, Prescription, SchematicEye, Side};
use photoneye_eye::psf::{Wavefront, WavefrontOptions};
use photoneye_eye::retina::ConeType;

const CONES: [ConeType; 3] = [ConeType::L, ConeType::M, ConeType::S];
/// Macular peak density of the 2° observer.
const MACULA_2_DEG: f64 = 0.35;
/// Last wavelength with data, nm.
const LAST_NM: [f64; 3] = [780.0, 780.0, 615.0];

/// Rows of wavelength, L, M, S.
fn published() -> Vec<[f64; 4]> {
    let rows = include_str!("../data/cone-fundamentals-2deg.csv").lines().skip(3);
    rows.map(|row| {
        let cells: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
        cells.try_into().unwrap()
    })
    .collect()
}

fn absorbers() -> Absorbers {
    Absorbers { media: Media::new(1.0, MACULA_2_DEG).unwrap(), pigments: Pigments::new().unwrap() }
}

/// Relative deviation of ours from the published fundamentals: wavelength, cone, deviation.
fn deviations(paths: impl Fn(f64) -> Paths) -> Vec<(f64, usize, f64)> {
    let absorbers = absorbers();
    let at = |cone: usize, nm: f64| absorbers.caught_at(Kind::Isomerized(CONES[cone]), nm, 0.0, paths(nm));
    let peak = |cone: usize| (3900..7800).map(|i| at(cone, 0.1 * f64::from(i))).fold(0.0, f64::max);
    let peaks = [0, 1, 2].map(peak);
    let mut rows = Vec::new();
    for [nm, published @ ..] in published() {
        for cone in 0..3 {
            if nm <= LAST_NM[cone] {
                rows.push((nm, cone, at(cone, nm) / peaks[cone] / published[cone] - 1.0));
            }
        }
    }
    rows
}

fn largest(rows: &[(f64, usize, f64)]) -> (f64, usize, f64) {
    rows.iter().copied().fold((0.0, 0, 0.0), |a, b| if b.2.abs() > a.2.abs() { b } else { a })
}

/// Along the axis ours are the published fundamentals. What is left is the spline through 5 nm about the peaks (S 5.7e-4, L and M 2.6e-4).
#[test]
fn fundamentals_along_the_axis() {
    let rows = deviations(|_| Paths { cornea: 1.0, lens: 1.0 });
    let (nm, cone, most) = largest(&rows);
    println!("{} values, largest deviation {most:+.2e} at {nm} nm of cone {cone}", rows.len());
    assert_eq!(rows.len(), 2 * 79 + 46);
    assert!(most.abs() < 6e-4, "{most:e} at {nm} nm");
}

/// Paths of the light that reaches the foveal centre through a pupil, relative to the axis.
fn foveal_paths(pupil_mm: f64, nm: f64) -> Paths {
    let p = Prescription::preset("escudero-sanz-navarro").unwrap();
    let (decentre_mm, dispersion) = (p.stop_decentre_mm, p.default_dispersion());
    let state = EyeState { pupil_mm, decentre_mm, accommodation_a: 0.0, dispersion, side: Side::Right };
    let eye = SchematicEye::new(&p, &state).unwrap();
    let object = Object::field(p.fovea_angle_deg, 0.0).unwrap();
    let wave = Wavefront::new(&eye, object, nm, &WavefrontOptions::default()).unwrap();
    Paths::new(&wave, &absorbers().media)
}

/// The published density of the lens is for small pupils. On the line of sight the path is the axial one; the mean over a wide pupil is
/// shorter, as the lens is thinner at its edge: over 7 mm by the factor 0.862 of CIE 170-1:2006 (1/1.16, Pokorny, Smith & Lutze 1987).
#[test]
fn the_lens_absorbs_less_through_a_wide_pupil() {
    let [small, usual, wide] = [0.5, 3.0, 7.0].map(|pupil_mm| foveal_paths(pupil_mm, 555.0).lens);
    println!("path in the lens over the axial one: 0.5 mm {small:.4}, 3 mm {usual:.4}, 7 mm {wide:.4}");
    assert!((small - 1.0).abs() < 2e-3, "{small}");
    assert!((wide / small - 0.862).abs() < 0.02, "{wide}");
}

/// Fundamentals through a pupil of 3 mm: the published ones within 9 % from 400 nm on, where the lens has a density of 1.7 and its mean path is
/// 2.1 % shorter than that of a small pupil, and within 1.5 % from 450 to 780 nm: the peak of S at 441 nm, to which all S are relative, gains
/// 10^(0.021 x 0.28) = 1.4 %, and the peaks of L and M 0.3 %.
#[test]
fn fundamentals_through_a_pupil_of_3_mm() {
    let waves: Vec<Paths> = (0..=39).map(|i| foveal_paths(3.0, 390.0 + 10.0 * f64::from(i))).collect();
    let rows = deviations(|nm| waves[(((nm - 390.0) / 10.0).round() as usize).min(waves.len() - 1)]);
    for (from, to, band) in [(450.0, 780.0, 0.015), (400.0, 445.0, 0.09), (390.0, 395.0, 0.13)] {
        let inside: Vec<_> = rows.iter().copied().filter(|r| (from..=to).contains(&r.0)).collect();
        let (nm, cone, most) = largest(&inside);
        println!("{from} to {to} nm: largest deviation {most:+.4} at {nm} nm of cone {cone}");
        assert!(most.abs() < band, "{most} at {nm} nm");
    }
}
