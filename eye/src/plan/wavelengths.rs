//! Which wavelengths a scene needs: those that a primary emits and a cone can catch.

use super::{Numerics, Rule};
use crate::display::{Emitter, photon_shares};
use crate::experiment::Experiment;
use crate::exposure::spectral::{Absorbers, KINDS, Kind, Paths, wavelength_nodes};

/// The wavelength of a display that has none, nm.
const DARK_NM: f64 = 555.0;

/// Wavelength nodes and what was left out.
#[derive(Clone, Debug)]
pub struct Wavelengths {
    /// Nodes, nm.
    pub nodes_nm: Vec<f64>,
    /// Largest share of any cone type's catch from any primary that lies outside the nodes' range (it is kept at the end nodes).
    pub outside: f64,
    /// Spacing, nm.
    pub step_nm: f64,
    /// Density of the lens, base 10, the mean over the light that cones catch.
    pub lens_density: f64,
}

/// Chooses nodes for the emitters of a display, of which only the `lit` ones count.
pub fn choose(
    experiment: &Experiment,
    emitters: &[Emitter],
    lit: &[bool],
    absorbers: &Absorbers,
) -> Wavelengths {
    let Numerics { wavelength_step_nm: step_nm, wavelength_tail: tail, .. } = Numerics::new(experiment);
    let paths = Paths { cornea: 1.0, lens: 1.0 };
    // Share of the catch of each cone type from each primary, by wavelength; the largest over both decides.
    let mut catches: Vec<(f64, f64)> = Vec::new();
    // Density of the lens times catch, and catch.
    let mut density = [0.0; 2];
    // A dark primary has its spectrum still.
    let spectra: Vec<_> = experiment.display.primaries.iter().map(|p| p.spectrum.clone()).collect();
    let dark = photon_shares(&spectra);
    for ((emitter, shares), _) in emitters.iter().zip(&dark).zip(lit).filter(|(_, lit)| **lit) {
        let lit = emitter.emitted() > 0.0;
        let photons: Vec<(f64, f64)> =
            if lit { emitter.photons.iter().map(|p| (p.nm, p.emitted)).collect() } else { shares.clone() };
        let per_kind: Vec<Vec<f64>> = KINDS
            .iter()
            .filter(|kind| !matches!(kind, Kind::Arriving))
            .map(|kind| {
                let caught = |(nm, n): &(f64, f64)| n * absorbers.caught_at(*kind, *nm, 0.0, paths);
                photons.iter().map(caught).collect()
            })
            .collect();
        let totals: Vec<f64> = per_kind.iter().map(|c: &Vec<f64>| c.iter().sum()).collect();
        let most = totals.iter().copied().fold(0.0, f64::max);
        for (i, (nm, _)) in photons.iter().enumerate() {
            let caught: f64 = per_kind.iter().map(|c| c[i]).sum();
            density = [density[0] + caught * absorbers.media.lens_density(*nm), density[1] + caught];
            let seen = per_kind.iter().zip(&totals).filter(|(_, total)| **total > 1e-4 * most);
            let share = seen.map(|(c, total)| c[i] / total).fold(0.0, f64::max);
            catches.push((*nm, share));
        }
    }
    catches.sort_by(|a, b| a.0.total_cmp(&b.0));
    let cut = |shares: &mut dyn Iterator<Item = f64>| {
        let mut sum = 0.0;
        shares
            .take_while(|s| {
                sum += s;
                sum <= tail
            })
            .count()
    };
    let from = cut(&mut catches.iter().map(|c| c.1));
    let to = catches.len()
        - cut(&mut catches.iter().rev().map(|c| c.1)).min(catches.len().saturating_sub(from + 1));
    let outside = catches[..from].iter().chain(&catches[to..]).map(|c| c.1).sum::<f64>();
    // A sum of nothing is -0.
    let outside = outside + 0.0;
    let mut lit: Vec<f64> = catches[from.min(to)..to].iter().map(|c| c.0).collect();
    // A display without light has no share anywhere: one wavelength, so that there are kernels to multiply it with.
    if lit.is_empty() {
        lit.push(catches.get(catches.len() / 2).map_or(DARK_NM, |c| c.0));
    }
    let mut nodes_nm = wavelength_nodes(lit, step_nm);
    if !Rule::Wavelengths.applies(experiment) {
        fill(&mut nodes_nm, step_nm);
    }
    let lens_density = if density[1] > 0.0 { density[0] / density[1] } else { 0.0 };
    Wavelengths { nodes_nm, outside, step_nm, lens_density }
}

/// Adds nodes over the whole visible range where there are none.
fn fill(nodes_nm: &mut Vec<f64>, step_nm: f64) {
    let (from, to) = (crate::spectrum::MIN_NM, crate::spectrum::MAX_NM);
    let steps = ((to - from) / step_nm).ceil();
    let even = (0..=steps as usize).map(|i| from + (to - from) * i as f64 / steps);
    let far = |nm: &f64| nodes_nm.iter().all(|node| (node - nm).abs() >= 0.5 * step_nm);
    let added: Vec<f64> = even.filter(far).collect();
    nodes_nm.extend(added);
    nodes_nm.sort_by(f64::total_cmp);
}
