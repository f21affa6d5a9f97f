//! The mosaic of the domain generator: the same from any tile, thread and order; densities, types and order as in life.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::BTreeMap;

use glam::DVec2;
use photoneye_eye::retina::{
    ConeIndex, ConeType, RegionUm, Retina, RetinaError, RetinaParams, RetinaTile, TileId, build_region,
    build_tile, statistics, statistics_in_bands, tiles_for,
};
use photoneye_eye::rng::{Purpose, Stream};

fn square(x: f64, y: f64, half: f64) -> RegionUm {
    RegionUm { min: DVec2::new(x - half, y - half), max: DVec2::new(x + half, y + half) }
}

fn made_tiles(p: &RetinaParams, region: &RegionUm) -> Vec<RetinaTile> {
    tiles_for(region).into_iter().map(|t| build_tile(p, t).unwrap()).collect()
}

fn on_threads<T: Send>(n: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(work)
}

#[test]
fn same_bytes_for_any_threads_order_and_parts() {
    let (p, region) = (RetinaParams::default(), square(200.0, -50.0, 350.0));
    let one = on_threads(1, || build_region(&p, &region).unwrap());
    let two = on_threads(2, || build_region(&p, &region).unwrap());
    let five = on_threads(5, || build_region(&p, &region).unwrap());
    // Not assert_eq: a failure would print all bytes.
    assert!(one.to_bytes() == two.to_bytes());
    assert!(one.to_bytes() == five.to_bytes());
    let mut made = made_tiles(&p, &region);
    let forward = Retina::assemble(&made, &region);
    made.reverse();
    made.push(made[0].clone());
    let backward = Retina::assemble(&made, &region);
    let without_counts = |mut r: Retina| {
        r.cones.counts = photoneye_eye::retina::Counts::default();
        r
    };
    let forward = without_counts(forward);
    assert!(forward == without_counts(backward));
    assert!(forward == without_counts(one));
}

/// Seams of tiles at the fovea and far out: walls of both sides meet in the same corners, no cone twice, no gap.
#[test]
fn seams_are_exact() {
    let p = RetinaParams::default();
    for (at, count) in [(DVec2::ZERO, 4), (DVec2::new(-1_024.0, 1_024.0), 4), (DVec2::new(2_048.0, 512.0), 2)]
    {
        let region = RegionUm { min: at - DVec2::splat(60.0), max: at + DVec2::splat(60.0) };
        let tiles = made_tiles(&p, &region);
        assert_eq!(tiles.len(), count);
        let retina = Retina::assemble(&tiles, &region);
        let mut id = retina.id.clone();
        id.sort_unstable();
        id.dedup();
        assert_eq!(id.len(), retina.len());
        // Away from the seams, the same as cones made in one piece.
        let whole = build_region(&p, &region).unwrap();
        assert_eq!(whole.id, retina.id);
        assert_eq!(whole.polygon_xy, retina.polygon_xy);
        assert_eq!(whole.cone_type, retina.cone_type);
    }
}

/// In the foveola the apertures tile the plane: every inner corner belongs to three cones or more, with the same bits.
#[test]
fn corners_are_shared_and_areas_add_up() {
    let region = square(0.0, 0.0, 60.0);
    let retina = build_region(&RetinaParams::default(), &region).unwrap();
    let inner = square(0.0, 0.0, 45.0);
    let mut owners: BTreeMap<(u64, u64), u32> = BTreeMap::new();
    let mut area = 0.0;
    for i in 0..retina.len() {
        let corners: Vec<DVec2> = retina.polygon(i).collect();
        for c in &corners {
            *owners.entry((c.x.to_bits(), c.y.to_bits())).or_default() += 1;
        }
        if inner.contains(retina.center(i)) {
            area += f64::from(retina.cell_area_um2[i]);
        }
    }
    let (mut shared, mut alone) = (0, 0);
    for ((x, y), n) in owners {
        if inner.contains(DVec2::new(f64::from_bits(x), f64::from_bits(y))) {
            (shared, alone) = if n >= 3 { (shared + 1, alone) } else { (shared, alone + 1) };
        }
    }
    assert!(shared > 2_000);
    assert_eq!(alone, 0);
    assert!((area / (90.0 * 90.0) - 1.0).abs() < 0.02, "{area}");
}

#[test]
fn polygons_are_convex_and_hold_their_centre() {
    for region in [square(0.0, 0.0, 150.0), square(600.0, 0.0, 200.0), square(0.0, -9_000.0, 500.0)] {
        let retina = build_region(&RetinaParams::default(), &region).unwrap();
        assert_eq!(retina.counts.concave, 0);
        for i in 0..retina.len() {
            let c: Vec<DVec2> = retina.polygon(i).collect();
            let (n, center) = (c.len(), retina.center(i));
            assert!((3..=12).contains(&n));
            for m in 0..n {
                let (a, b, d) = (c[m], c[(m + 1) % n], c[(m + 2) % n]);
                // f32 corners of a shrunken polygon: an angle may be off by 1e-5.
                assert!(
                    (b - a).perp_dot(d - b) > -1e-5 * (b - a).length() * (d - b).length(),
                    "cone {i}: {c:?}"
                );
                assert!((b - a).perp_dot(center - a) > 0.0, "cone {i}: centre outside");
            }
            assert!(retina.aperture_um2[i] <= retina.cell_area_um2[i] && retina.aperture_um2[i] > 0.0);
        }
    }
}

#[test]
fn every_point_has_at_most_one_owner() {
    for (region, inner, least) in [
        (square(0.0, 0.0, 110.0), square(0.0, 0.0, 90.0), 0.999),
        (square(700.0, 0.0, 120.0), square(700.0, 0.0, 90.0), 0.70),
    ] {
        let retina = build_region(&RetinaParams::default(), &region).unwrap();
        let index = ConeIndex::new(&retina);
        let mut s = Stream::new(4, Purpose::Study, 0, 0);
        let mut owned = 0;
        let n = 20_000;
        for _ in 0..n {
            let p = inner.min + DVec2::new(s.uniform(), s.uniform()) * (inner.max - inner.min);
            let Some(i) = index.owner(p) else { continue };
            owned += 1;
            // Strictly inside another polygon would be an overlap.
            let overlap = (0..retina.len())
                .filter(|&k| k != i as usize && (retina.center(k) - p).length() < 20.0)
                .any(|k| {
                    let c: Vec<DVec2> = retina.polygon(k).collect();
                    (0..c.len()).all(|m| {
                        let wall = c[(m + 1) % c.len()] - c[m];
                        wall.perp_dot(p - c[m]) > 1e-4 * wall.length()
                    })
                });
            assert!(!overlap);
        }
        assert!(f64::from(owned) / f64::from(n) > least, "{owned}");
        // Every corner is owned by at most one, and centres by their own cone.
        for i in 0..retina.len() {
            assert_eq!(index.owner(retina.center(i)), Some(i as u32));
        }
    }
}

#[test]
fn density_types_and_order_meet_their_targets() {
    let region = square(0.0, 0.0, 900.0);
    for seed in [1, 0, u64::MAX] {
        let p = RetinaParams { seed, ..RetinaParams::default() };
        let retina = build_region(&p, &region).unwrap();
        let s = statistics(&retina);
        for b in &s.bands {
            // The innermost band has 648 cones: 2 % are 13, about two and a half standard deviations.
            let allowed = if b.target_cones < 1_000.0 { 0.03 } else { 0.02 };
            assert!((b.density_ratio() - 1.0).abs() < allowed, "{b:?}");
            // S cones are spread more evenly than at random: five standard deviations of a binomial are generous.
            let sd = b.target_s.max(1.0).sqrt();
            assert!(
                (b.types[2] as f64 - b.target_s).abs() < (5.0 * sd).min(3.0 + 0.12 * b.target_s + 2.0 * sd),
                "{b:?}"
            );
            let lm = (b.types[0] + b.types[1]) as f64;
            let l = 0.62 / 0.92;
            assert!((b.types[0] as f64 - l * lm).abs() < 4.5 * (lm * l * (1.0 - l)).sqrt(), "{b:?}");
            if b.from_deg >= 1.0 && b.interior > 1_000 {
                assert!((0.48..0.68).contains(&b.six_share), "{b:?}");
                assert!((0.48..0.66).contains(&b.psi6), "{b:?}");
            }
        }
        assert_eq!(s.bands[0].types[2], 0);
        let foveola = statistics_in_bands(&retina, &[0.0, 0.3]).all;
        assert!((0.62..0.78).contains(&foveola.six_share), "{foveola:?}");
    }
}

#[test]
fn s_cones_keep_apart() {
    let region = square(700.0, 0.0, 200.0);
    let retina = build_region(&RetinaParams::default(), &region).unwrap();
    let s: Vec<DVec2> =
        (0..retina.len()).filter(|&i| retina.cone_type[i] == ConeType::S).map(|i| retina.center(i)).collect();
    let density = s.len() as f64 / 160_000.0;
    let core = 0.5 / density.sqrt();
    let nearest =
        |p: DVec2| s.iter().map(|q| (*q - p).length()).filter(|d| *d > 0.0).fold(f64::MAX, f64::min);
    // The core follows the local density, so the mean one is a little off.
    assert!(s.iter().all(|p| nearest(*p) > 0.8 * core));
    let free = RetinaParams { s_repulsion: 0.0, ..RetinaParams::default() };
    let free = build_region(&free, &region).unwrap();
    let count = free.cone_type.iter().filter(|t| **t == ConeType::S).count() as f64;
    assert!((count / s.len() as f64 - 1.0).abs() < 0.3);
}

#[test]
fn stored_form_round_trips_and_damage_is_an_error() {
    let p = RetinaParams::default();
    let region = square(10.0, 20.0, 25.0);
    let retina = build_region(&p, &region).unwrap();
    let bytes = retina.to_bytes();
    assert!(Retina::from_bytes(&bytes).unwrap() == retina);
    let tile = RetinaTile { tile: TileId { i: -3, j: 7 }, params: p, cones: retina.cones.clone() };
    assert!(RetinaTile::from_bytes(&tile.to_bytes()).unwrap() == tile);
    assert!(matches!(RetinaTile::from_bytes(&bytes), Err(RetinaError::Bytes(_))));
    for cut in (0..200).chain((200..bytes.len()).step_by(97)) {
        assert!(Retina::from_bytes(&bytes[..cut]).is_err());
    }
    for at in (0..200).chain((200..bytes.len()).step_by(97)) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(Retina::from_bytes(&damaged).is_err());
    }
    // Damage with a right digest: lengths are still checked before use.
    for at in (0..260).chain((260..bytes.len() - 32).step_by(997)) {
        let mut damaged = bytes[..bytes.len() - 32].to_vec();
        damaged[at] = 0xFF;
        let digest = *blake3::hash(&damaged).as_bytes();
        damaged.extend(digest);
        let _ = Retina::from_bytes(&damaged);
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(Retina::from_bytes(&longer).is_err());
}

#[test]
fn extremes_hold() {
    // One cone.
    let p = RetinaParams { seed: u64::MAX, ..RetinaParams::default() };
    let few = build_region(&p, &square(3.0, 4.0, 1.5)).unwrap();
    assert!((1..=4).contains(&few.len()));
    assert_eq!(statistics(&few).all.cones as usize, few.len());
    assert!(build_region(&p, &square(0.0, 0.0, -1.0)).unwrap().is_empty());
    assert!(build_region(&p, &square(f64::NAN, 0.0, 1.0)).unwrap().is_empty());
    // The ends of the density range, only S cones that are allowed, none at all, no pointing error.
    for (peak, ratio) in [(98_200.0, [0.5, 0.0, 0.5]), (324_100.0, [1.0, 0.0, 0.0])] {
        let p = RetinaParams { peak_density_per_mm2: peak, cone_ratio: ratio, ..RetinaParams::default() };
        let retina = build_region(&p, &square(0.0, 0.0, 120.0)).unwrap();
        let all = statistics(&retina).all;
        assert!((all.density_ratio() - 1.0).abs() < 0.02, "{all:?}");
        assert!(retina.polygon_xy.iter().all(|v| v.is_finite()));
    }
    let nonsense = RetinaParams { peak_density_per_mm2: 1e9, ..RetinaParams::default() };
    assert!(matches!(build_region(&nonsense, &square(0.0, 0.0, 5.0)), Err(RetinaError::Parameter { .. })));
    // Near the ora, beyond it, and where no tile starts.
    let ora = (102.0_f64 * 0.91).to_radians() * 12_000.0;
    let edge = build_region(&p, &square(-ora, 0.0, 400.0)).unwrap();
    assert!(!edge.is_empty() && edge.cell_area_um2.iter().all(|a| a.is_finite() && *a > 0.0));
    let farthest = 102.0_f64.to_radians() * 12_000.0;
    assert!(edge.x_um.iter().zip(&edge.y_um).all(|(x, y)| x.hypot(*y) <= farthest));
    let beyond = build_region(&p, &square(-ora - 300.0, 0.0, 290.0)).unwrap();
    assert!(beyond.is_empty());
    assert!(build_tile(&p, TileId { i: 64, j: 0 }).unwrap().is_empty());
    assert!(matches!(build_tile(&p, TileId { i: 65, j: 0 }), Err(RetinaError::NotATile { .. })));
}

#[test]
fn pointing_errors_are_normal() {
    let retina = build_region(&RetinaParams::default(), &square(0.0, 0.0, 200.0)).unwrap();
    let sd = 1.0_f64.to_radians();
    for axis in 0..2 {
        let values: Vec<f64> = retina.pointing.iter().map(|v| f64::from(v[axis]) / sd).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / n;
        assert!(mean.abs() < 4.5 / n.sqrt());
        assert!((variance - 1.0).abs() < 4.5 * (2.0 / n).sqrt());
    }
}
