//! What there is for each primary: its kernels and its light. Primaries that always send the same picture from the same places at the same
//! times are as good as one: red, green and blue of a three-chip projector before a gray picture.

use super::kernel::{Group, Kernels};
use super::pixel_light::FirstShown;
use super::source::Projector;
use crate::display::Emitter;

/// Error of the basis that is chosen anew over that of the kernels.
pub const BASIS_SHARE: f64 = 0.25;

/// Kernels and light, by primary.
#[derive(Clone, Debug)]
pub struct Primaries {
    /// The optical kernels.
    pub kernels: Kernels,
    /// Light and movement.
    pub projector: Projector,
}

/// Numbers of the emitters that gray pictures drive together, by the first of each group.
pub fn groups(emitters: &[Emitter]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (number, emitter) in emitters.iter().enumerate() {
        match groups.iter_mut().find(|group| emitters[group[0]].shines_with(emitter)) {
            Some(group) => group.push(number),
            None => groups.push(vec![number]),
        }
    }
    groups
}

impl Primaries {
    /// Those of gray pictures, one for all that shine together; `None` where each differs from the others. The kernels' basis leaves a relative
    /// error of `tolerance` more.
    pub fn together(&self, tolerance: f64) -> Option<Self> {
        let emitters = &self.projector.emitters;
        let groups = groups(emitters);
        if groups.len() == emitters.len() {
            return None;
        }
        let one = |group: &Vec<usize>| {
            let others: Vec<&Emitter> = group[1..].iter().map(|&number| &emitters[number]).collect();
            emitters[group[0]].together(&others)
        };
        let joined: Vec<Emitter> = groups.iter().map(one).collect();
        let spectrum = |emitter: &Emitter| {
            let all = emitter.emitted().max(f64::MIN_POSITIVE);
            emitter.photons.iter().map(|p| (p.nm, p.emitted / all)).collect()
        };
        let spectra = joined.iter().map(spectrum).collect();
        let shares = |group: &Vec<usize>| -> Group {
            let of = |&number: &usize| emitters[number].emitted();
            let all: f64 = group.iter().map(of).sum();
            let share = |number: &usize| (*number, if all > 0.0 { of(number) / all } else { 0.0 });
            group.iter().map(share).collect()
        };
        let by_group: Vec<Group> = groups.iter().map(shares).collect();
        Some(Self {
            kernels: self.kernels.together(&by_group, spectra, tolerance),
            projector: Projector {
                emitters: joined,
                first_shown: FirstShown::default(),
                ..self.projector.clone()
            },
        })
    }
}
