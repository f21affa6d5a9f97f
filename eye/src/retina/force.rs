//! The force between cones, equations (2) to (5) of §15.1 and §15.2; the one kernel of every generator.
//!
//! (2) D = |p - n|/(p.r + n.r). (4) p' = p + K1·r·toward + K2·r·random - K3·r·Σ spline(D)·(n - p)/|n - p|. (5) spline: 3.2·(1 - D) for 0.75 < D <= 1,
//! 0.266·(3.75 - D) below, 0 above 1. Lengths are across the cone (see `local`); K1, K2, K3 are in units of the cone's own radius r.
//!
//! # As printed
//! (3) prints N = D >= 1.5; a neighbour is D <= 1.5.
//!
//! # Stability
//! Steps are simultaneous. Six neighbours each push with slope 3.2·K3/2 per radius, so the stiffest mode of the hexagonal lattice overshoots
//! when K3 > 0.208 (`K3_LIMIT`); the generators use 0.19. The slope falls twelve-fold below D = 0.75: keep the radius
//! factor below 1.1, or over-compressed cones collapse onto each other. Coincident cones part along a hashed direction.

use glam::DVec2;

/// Drive towards the centre; the domain generator needs none.
pub const K1: f64 = 0.0;
/// Strength of the random kicks at the first sub-cycle; it falls linearly to 0.
pub const K2: f64 = 0.2;
/// Strength of the repulsion.
pub const K3: f64 = 0.19;
/// Largest strength at which simultaneous steps are stable.
pub const K3_LIMIT: f64 = 0.208;
/// Cone radius in units of half the spacing of the hexagonal lattice of the target density.
pub const RADIUS_FACTOR: f64 = 1.05;
/// Longest step of one sub-cycle, in radii.
pub const STEP_LIMIT: f64 = 0.2;
/// Largest D of a neighbour, equation (3).
pub const NEIGHBOUR: f64 = 1.5;

/// Equation (2): distance in units of the sum of the radii.
pub fn normalized_distance(distance_um: f64, radius_p_um: f64, radius_n_um: f64) -> f64 {
    distance_um / (radius_p_um + radius_n_um)
}

/// Equation (5).
#[inline]
pub fn spline(x: f64) -> f64 {
    if x > 1.0 {
        0.0
    } else if x > 0.75 {
        (1.0 - x) * 3.2
    } else {
        (3.75 - x) * 0.266
    }
}

/// Pairs closer than this D are degenerate (§15.4).
pub const DEGENERATE: f64 = 0.6;

/// spline(D)·(n - p)/|n - p| of one pair as a chart vector, given the chart step `d` = n - p, its squared length across the
/// cones and the sum of the radii; `None` for a coincident pair.
#[inline]
pub fn push(d: DVec2, length2: f64, reach: f64) -> Option<DVec2> {
    // spline(length/reach)/length with one division, and no branch on the slope: the branches of (5) cross where it changes.
    let length = length2.sqrt();
    if length < 1e-9 * reach {
        return None;
    }
    let near = 3.75 * 0.266 * reach - 0.266 * length;
    let far = 3.2 * (reach - length);
    let slope = if length > 0.75 * reach { far } else { near };
    Some(d * (slope.max(0.0) / (length * reach)))
}

/// The step cut to the limit, given its squared length across the cone.
#[inline]
pub fn limited(step: DVec2, length2: f64, radius: f64) -> (DVec2, bool) {
    let limit = STEP_LIMIT * radius;
    if length2 > limit * limit { (step * (limit / length2.sqrt()), true) } else { (step, false) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_2_and_5() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(normalized_distance(3.0, 1.0, 2.0), 1.0);
        close(spline(1.2), 0.0);
        close(spline(1.0), 0.0);
        close(spline(0.9), 0.32);
        close(spline(0.75), 0.798);
        close(spline(0.0), 0.9975);
        // The two branches meet within 0.3 %.
        assert!((spline(0.75 + 1e-12) - spline(0.75)).abs() < 0.003);
    }

    #[test]
    fn two_cones_part_to_touching() {
        let (mut p, mut n) = (DVec2::new(-0.3, 0.1), DVec2::new(0.2, 0.0));
        for _ in 0..200 {
            let d = n - p;
            let f = push(d, d.length_squared(), 2.0).unwrap() * K3;
            (p, n) = (p - f, n + f);
        }
        assert!(((n - p).length() - 2.0).abs() < 1e-9);
        assert!(push(DVec2::ZERO, 0.0, 2.0).is_none());
    }

    /// The stiffest mode of a periodic hexagonal lattice, compressed to D = 0.95: it decays below the limit and grows above.
    #[test]
    fn stability_limit() {
        let (n, spacing) = (12_i32, 1.9);
        let run = |k3: f64| {
            let home = |a: i32, b: i32| {
                DVec2::new(f64::from(a) + 0.5 * f64::from(b), f64::from(b) * 0.75_f64.sqrt()) * spacing
            };
            let near = [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)];
            let at = |a: i32, b: i32| (a.rem_euclid(n) * n + b.rem_euclid(n)) as usize;
            let mut off: Vec<DVec2> = (0..n * n)
                .map(|i| {
                    DVec2::new(f64::from((i * 7919) % 13) - 6.0, f64::from((i * 104_729) % 11) - 5.0) * 1e-7
                })
                .collect();
            let mut last = 0.0;
            for _ in 0..400 {
                let old = off.clone();
                last = 0.0_f64;
                for a in 0..n {
                    for b in 0..n {
                        let mut force = DVec2::ZERO;
                        for (da, db) in near {
                            let d = home(da, db) + old[at(a + da, b + db)] - old[at(a, b)];
                            force += push(d, d.length_squared(), 2.0).unwrap();
                        }
                        off[at(a, b)] -= force * k3;
                        last = last.max((force * k3).length());
                    }
                }
            }
            last
        };
        assert!(run(K3) < 1e-9);
        assert!(run(0.25) > 1e-3);
        const { assert!(K3 < K3_LIMIT) };
    }
}
