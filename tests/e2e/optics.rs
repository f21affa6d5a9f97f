//! `psf` and `trace`: the commands that ask the optics alone.

use std::fs;

use serde_json::Value;
use tempfile::tempdir;

use crate::support::{photoneye, succeed};

#[test]
fn a_point_spread_is_an_array_with_its_figures() {
    let place = tempdir().unwrap();
    let said = succeed(photoneye(place.path()).args([
        "psf",
        "--json",
        // The stop of the packages, 3 mm over the paraxial magnification, is that of this entrance pupil.
        "--pupil-mm",
        "2.979",
        "--dispersion",
        "polyline",
        "--amplitude",
        "uniform",
        "--samples",
        "64",
        "--out",
        "p.npy",
    ]));
    let said: Value = serde_json::from_str(&said).unwrap();
    // Two public optics packages give 0.9075 for this eye, pupil and wavelength.
    assert!((said["strehl"].as_f64().unwrap() - 0.9075).abs() < 2e-4, "{said}");
    let bytes = fs::read(place.path().join("p.npy")).unwrap();
    assert!(bytes.starts_with(b"\x93NUMPY") && bytes.len() > 64 * 64 * 8);
    succeed(photoneye(place.path()).args(["psf", "--accommodation-a=-0.05", "--out", "q.npy"]));
    let wrong = photoneye(place.path()).args(["psf", "--pupil-mm", "99", "--out", "r.npy"]).output().unwrap();
    assert_eq!(wrong.status.code(), Some(2));
    assert!(!place.path().join("r.npy").exists());
}

#[test]
fn eyes_are_listed_and_can_be_asked_for() {
    let place = tempdir().unwrap();
    let said: Value =
        serde_json::from_str(&succeed(photoneye(place.path()).args(["eyes", "--json"]))).unwrap();
    let power = |name: &str| {
        let eyes = said["eyes"].as_array().unwrap();
        eyes.iter().find(|eye| eye["name"] == name).unwrap()["power_d"].as_f64().unwrap()
    };
    assert!((power("liou-brennan-1997") - 60.35).abs() < 0.01);
    assert!(succeed(photoneye(place.path()).arg("eyes")).contains("navarro-1985"));
    let args = ["psf", "--json", "--side", "left", "--samples", "8", "--out", "p.npy", "--eye"];
    let strehl = |eye: &str| -> f64 {
        let said = succeed(photoneye(place.path()).args(args).arg(eye));
        serde_json::from_str::<Value>(&said).unwrap()["strehl"].as_f64().unwrap()
    };
    let liou = strehl("liou-brennan-1997");
    // 3 mm as seen from the front: the stop is 0.7 % wider than by the paraxial magnification, with which
    // this was 0.71.
    assert!((0.68..0.72).contains(&liou), "{liou}");
    // An eye of one's own is a file of the same form.
    let text = photoneye_eye::catalog::text("eyes", "liou-brennan-1997").unwrap();
    fs::write(place.path().join("mine.json"), text).unwrap();
    assert!((strehl("mine.json") - liou).abs() < 1e-15);
    for eye in ["cyclops", "none.json"] {
        let wrong = photoneye(place.path()).args(args).arg(eye).output().unwrap();
        assert_eq!(wrong.status.code(), Some(2), "{eye}");
    }
}

#[test]
fn rays_come_out_in_their_order_with_their_fate() {
    let place = tempdir().unwrap();
    let rays = "px,py,pz,sx,sy,sz,wavelength_nm,dispersion\n\
                0,0,-30,0,0,1,543,polyline\n\
                0,3.9,-30,0,0,1,543,polyline\n\
                0,30,-30,0,0,1,543,herzberger\n";
    fs::write(place.path().join("rays.csv"), rays).unwrap();
    succeed(photoneye(place.path()).args(["trace", "--rays", "rays.csv", "--out", "hits.csv"]));
    let table = fs::read_to_string(place.path().join("hits.csv")).unwrap();
    let fates: Vec<&str> = table.lines().skip(1).filter_map(|line| line.rsplit(',').next()).collect();
    assert_eq!(fates, ["arrived", "stopped_by_iris", "missed_cornea_front"]);
    // Optical path along the axis with the published thicknesses: 30 mm of air and the four media.
    let first: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    assert!(first[first.len() - 2].parse::<f64>().unwrap() > 60.0);
}
