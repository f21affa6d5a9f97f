//! Spectral weights of the kernels: what share of a primary's photons, at each wavelength node, is caught by each kind of cone.
//!
//! For primary k, wavelength node m, kind T and eccentricity e:
//! `w = Σ_i share_k(λ_i) hat_m(λ_i) τ_cornea(λ_i) τ_lens(λ_i) τ_macula(λ_i, e) q_T(λ_i, e)` over the samples of the spectrum,
//! with `q = J·2/3` for L, M, S and 1 for [`Kind::Arriving`]. hat_m interpolates between nodes, so only the optical transfer is
//! interpolated in wavelength, never the spectra: linearly where weights are probabilities ([`Absorbers::weights`]), by the
//! polynomial through up to six nodes around where they are coefficients ([`Absorbers::smooth_weights`]).

use serde::{Deserialize, Serialize};

use crate::cone::{ISOMERIZATION, pigment::Pigments};
use crate::media::Media;
use crate::psf::Wavefront;
use crate::retina::ConeType;

/// What a kernel counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Isomerizations in a cone of this type.
    Isomerized(ConeType),
    /// Photons that arrive at the cones, whatever becomes of them.
    Arriving,
}

/// The kinds, in the order of all tables.
pub const KINDS: [Kind; 4] = [
    Kind::Isomerized(ConeType::L),
    Kind::Isomerized(ConeType::M),
    Kind::Isomerized(ConeType::S),
    Kind::Arriving,
];

/// Index of the kind that counts arriving photons: the last one.
pub const ARRIVING: usize = KINDS.len() - 1;

/// Share of a primary's photons at a wavelength.
pub type Share = (f64, f64);

/// What absorbs on the way.
#[derive(Clone, Debug)]
pub struct Absorbers {
    /// Cornea, lens and macula.
    pub media: Media,
    /// Cone pigments.
    pub pigments: Pigments,
}

/// Path lengths relative to the axial thicknesses: of all rays of a pupil one pair that lets the same share of light through.
///
/// Mean over rays of 10^(-D·l) = 10^(-D·l'), l' = mean - ln(10)·D·variance/2 to second order.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Paths {
    /// In the cornea.
    pub cornea: f64,
    /// In the lens.
    pub lens: f64,
}

impl Paths {
    /// The paths of a wavefront.
    pub fn new(wavefront: &Wavefront, media: &Media) -> Self {
        let density = std::f64::consts::LN_10 * media.lens_density(wavefront.wavelength_nm);
        let lens = wavefront.path_lens - 0.5 * density * wavefront.path_lens_variance;
        Self { cornea: wavefront.path_cornea, lens }
    }
}

impl Absorbers {
    /// Share of photons of a wavelength that passes all media.
    pub fn passed(&self, nm: f64, ecc_deg: f64, paths: Paths) -> f64 {
        self.media.cornea(nm, paths.cornea) * self.media.lens(nm, paths.lens) * self.media.macula(nm, ecc_deg)
    }

    fn caught(&self, kind: Kind, nm: f64, ecc_deg: f64) -> f64 {
        match kind {
            Kind::Isomerized(cone) => ISOMERIZATION * self.pigments.absorptance(cone, nm, ecc_deg),
            Kind::Arriving => 1.0,
        }
    }

    /// Share of photons of a wavelength that passes the media and is caught.
    pub fn caught_at(&self, kind: Kind, nm: f64, ecc_deg: f64, paths: Paths) -> f64 {
        self.passed(nm, ecc_deg, paths) * self.caught(kind, nm, ecc_deg)
    }

    /// Weights `[node]` of one primary, kind and eccentricity, with the same paths for all wavelengths.
    pub fn weights(
        &self,
        shares: &[Share],
        nodes_nm: &[f64],
        kind: Kind,
        ecc_deg: f64,
        paths: Paths,
    ) -> Vec<f64> {
        self.weights_along(shares, nodes_nm, kind, ecc_deg, &vec![paths; nodes_nm.len()])
    }

    /// The same with the paths at each wavelength node; between them they are interpolated.
    pub fn weights_along(
        &self,
        shares: &[Share],
        nodes_nm: &[f64],
        kind: Kind,
        ecc_deg: f64,
        paths: &[Paths],
    ) -> Vec<f64> {
        let mut weights = vec![0.0; nodes_nm.len()];
        for &(nm, share) in shares {
            let at = paths_at(nodes_nm, paths, nm);
            let caught = share * self.caught_at(kind, nm, ecc_deg, at);
            linear(nodes_nm, nm, |node, weight| weights[node] += weight * caught);
        }
        weights
    }

    /// As [`Absorbers::weights`] for a transfer that is smooth between nodes but for kinks at `kinks_nm`; a weight may be negative.
    pub fn smooth_weights(
        &self,
        shares: &[Share],
        (nodes_nm, kinks_nm): (&[f64], &[f64]),
        kind: Kind,
        ecc_deg: f64,
        paths: &[Paths],
    ) -> Vec<f64> {
        let mut weights = vec![0.0; nodes_nm.len()];
        for &(nm, share) in shares {
            let caught = share * self.caught_at(kind, nm, ecc_deg, paths_at(nodes_nm, paths, nm));
            smooth(nodes_nm, kinks_nm, nm, |node, weight| weights[node] += weight * caught);
        }
        weights
    }
}

/// Nodes of the interpolating polynomial.
const POINTS: usize = 6;
/// A node farther away than so many times the interval around a wavelength says little about it.
const REACH: f64 = 5.0;

/// Weights of linear interpolation at a wavelength; the end's value beyond the ends.
fn linear(nodes_nm: &[f64], nm: f64, mut put: impl FnMut(usize, f64)) {
    let above = nodes_nm.partition_point(|&node| node < nm).min(nodes_nm.len() - 1);
    let below = above.saturating_sub(1);
    let span = nodes_nm[above] - nodes_nm[below];
    let t = if span > 0.0 { ((nm - nodes_nm[below]) / span).clamp(0.0, 1.0) } else { 1.0 };
    put(below, 1.0 - t);
    put(above, t);
}

/// Weights of the polynomial through the nodes around a wavelength, three on either side where there are; none beyond a kink.
fn smooth(nodes_nm: &[f64], kinks_nm: &[f64], nm: f64, mut put: impl FnMut(usize, f64)) {
    let above = nodes_nm.partition_point(|&node| node < nm).min(nodes_nm.len() - 1);
    let below = above.saturating_sub(1);
    let (from, to) = (nodes_nm[below], nodes_nm[above]);
    let kinked = kinks_nm.iter().any(|kink| *kink > from && *kink < to);
    if nm <= from || nm >= to || kinked {
        return linear(nodes_nm, nm, put);
    }
    let joins = |node: f64| {
        let (a, b) = (node.min(from), node.max(to));
        (node - nm).abs() <= REACH * (to - from) && kinks_nm.iter().all(|kink| *kink <= a || *kink >= b)
    };
    let usable = |i: &usize| joins(nodes_nm[*i]);
    let first = (0..below).rev().take(POINTS - 2).take_while(usable).last().unwrap_or(below);
    let last = (above + 1..nodes_nm.len()).take(POINTS - 2).take_while(usable).last().unwrap_or(above);
    // Of those the six nearest, as even on both sides as can be.
    let start = (above.saturating_sub(POINTS / 2)).min((last + 1).saturating_sub(POINTS)).max(first);
    let end = (start + POINTS).min(last + 1);
    for i in start..end {
        let others = (start..end).filter(|&j| j != i);
        put(i, others.map(|j| (nm - nodes_nm[j]) / (nodes_nm[i] - nodes_nm[j])).product());
    }
}

/// Paths between those of two nodes.
fn between(a: Paths, b: Paths, t: f64) -> Paths {
    Paths { cornea: a.cornea + t * (b.cornea - a.cornea), lens: a.lens + t * (b.lens - a.lens) }
}

/// Paths at a wavelength from those at the nodes.
pub fn paths_at(nodes_nm: &[f64], paths: &[Paths], nm: f64) -> Paths {
    let Some(last) = nodes_nm.len().min(paths.len()).checked_sub(1) else {
        return Paths { cornea: 1.0, lens: 1.0 };
    };
    let above = nodes_nm.partition_point(|&node| node < nm).min(last);
    let below = above.saturating_sub(1);
    let span = nodes_nm[above] - nodes_nm[below];
    let t = if span > 0.0 { ((nm - nodes_nm[below]) / span).clamp(0.0, 1.0) } else { 1.0 };
    between(paths[below], paths[above], t)
}

/// Wavelength nodes: both ends of every stretch of light, and equal steps of at most `step_nm` between. A single line gets one
/// node.
pub fn wavelength_nodes(mut lit_nm: Vec<f64>, step_nm: f64) -> Vec<f64> {
    lit_nm.sort_by(f64::total_cmp);
    let mut nodes = Vec::new();
    let mut start = 0;
    for i in 0..lit_nm.len() {
        let last = i + 1 == lit_nm.len();
        if !last && lit_nm[i + 1] - lit_nm[i] <= step_nm {
            continue;
        }
        let (from, to) = (lit_nm[start], lit_nm[i]);
        let steps = ((to - from) / step_nm - 1e-9).ceil().max(0.0) as usize;
        nodes.extend((0..=steps).map(|s| from + (to - from) * s as f64 / steps.max(1) as f64));
        start = i + 1;
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_exact_and_bands_are_stepped() {
        assert_eq!(wavelength_nodes(vec![543.0], 10.0), vec![543.0]);
        assert_eq!(wavelength_nodes(vec![630.0, 467.0, 532.0], 10.0), vec![467.0, 532.0, 630.0]);
        let band: Vec<f64> = (0..=40).map(|i| 400.0 + 0.5 * f64::from(i)).collect();
        assert_eq!(wavelength_nodes(band, 10.0), vec![400.0, 410.0, 420.0]);
        assert!(wavelength_nodes(Vec::new(), 10.0).is_empty());
    }

    #[test]
    fn weights_sum_to_the_direct_integral() {
        let absorbers =
            Absorbers { media: Media::new(1.0, 0.4).unwrap(), pigments: Pigments::new().unwrap() };
        let paths = Paths { cornea: 1.0, lens: 1.0 };
        let shares: Vec<Share> = (0..=300).map(|i| (400.0 + f64::from(i), 1.0 / 301.0)).collect();
        let nodes = wavelength_nodes(shares.iter().map(|s| s.0).collect(), 10.0);
        for kind in KINDS {
            let weights = absorbers.weights(&shares, &nodes, kind, 0.3, paths);
            let direct: f64 =
                shares.iter().map(|&(nm, s)| s * absorbers.caught_at(kind, nm, 0.3, paths)).sum();
            assert!((weights.iter().sum::<f64>() / direct - 1.0).abs() < 1e-12);
            let along = vec![paths; nodes.len()];
            let smooth = absorbers.smooth_weights(&shares, (&nodes, &[555.0]), kind, 0.3, &along);
            assert!((smooth.iter().sum::<f64>() / direct - 1.0).abs() < 1e-12);
        }
    }

    /// Polynomials of degree 5 are exact, also at the ends, and on either side of a kink; across it and over gaps lower degrees.
    #[test]
    fn smooth_weights_interpolate() {
        let nodes: Vec<f64> = (0..20).map(|i| 400.0 + 10.0 * f64::from(i)).collect();
        let kinked = |nm: f64| if nm < 500.0 { (nm / 100.0).powi(5) } else { 3625.0 - nm };
        let made = |nodes: &[f64], kinks: &[f64], f: &dyn Fn(f64) -> f64, nm: f64| {
            let mut sum = 0.0;
            smooth(nodes, kinks, nm, |i, w| sum += w * f(nodes[i]));
            sum
        };
        for nm in [400.0, 401.0, 433.3, 495.0, 499.0, 500.0, 502.0, 586.0, 590.0] {
            let error = made(&nodes, &[500.0], &kinked, nm) / kinked(nm) - 1.0;
            assert!(error.abs() < 1e-12, "{nm}: {error}");
        }
        // A kink between nodes: linear there.
        let straight = |nm: f64| 2.0 * nm;
        assert!((made(&nodes, &[505.0], &straight, 503.0) - 1006.0).abs() < 1e-9);
        // Far nodes are not asked.
        let apart = [400.0, 410.0, 420.0, 600.0, 610.0];
        assert!((made(&apart, &[], &|nm| nm * nm, 403.0) / 403.0_f64.powi(2) - 1.0).abs() < 1e-12);
        assert!((made(&apart, &[], &straight, 604.0) - 1208.0).abs() < 1e-9);
        assert!((made(&[543.0], &[], &straight, 543.0) - 1086.0).abs() < 1e-9);
    }
}
