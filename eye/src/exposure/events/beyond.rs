//! Light of the screen beyond the window: a Poisson number more, of the mean of `tail`, on cones by their shares of it. A Poisson process
//! may be split by where its photons come from, so counts keep their distribution.
//!
//! In a list these photons, some 4e-4 of all, have the times of their primary's light in the window, or its first course where that is
//! dark, and the wavelengths that their cone counts of the primary.

use super::dice::{Words, above};
use super::list::Lister;
use super::tables::Tables;
use crate::exposure::cones::ConeTable;
use crate::exposure::expected::Means;
use crate::exposure::light::{Course, Shown, courses};
use crate::exposure::primaries::Primaries;
use crate::exposure::scene::Scene;
use crate::exposure::source::{Layer, Projector, Source, SourcePrimary};
use crate::exposure::tail::{Looks, Tail};
use crate::exposure::{Photon, poisson};
use crate::rng::Stream;

/// The light from beyond a window, when there is a screen.
pub(super) struct Beyond {
    tail: Tail,
}

/// What is drawn of it in a frame.
pub(super) struct More<'a> {
    pub(super) counts: &'a mut [u32],
    pub(super) means: &'a mut Means,
    /// When photons are listed.
    pub(super) list: Option<&'a mut Vec<Photon>>,
}

impl Beyond {
    /// Over the cones of a tile; `None` when the window is the whole screen.
    pub(super) fn new(
        scene: &Scene,
        primaries: &Primaries,
        cones: &ConeTable,
        scatters: bool,
    ) -> Option<Self> {
        let display = &primaries.projector.display;
        if scene.size_px == [display.width_px, display.height_px] {
            return None;
        }
        let looks = if scatters { Looks::All } else { Looks::Few };
        Some(Self { tail: Tail::new(scene, primaries, cones, looks)? })
    }

    /// Draws a frame's photons, the fraction of them that is kept.
    pub(super) fn count(
        &self,
        (shown, source): (&Shown, &Source),
        (projector, kept): (&Projector, f64),
        tables: &Tables,
        stream: &mut Stream,
        more: &mut More,
    ) {
        let cones = more.counts.len();
        let none = Means { isomerized: vec![0.0; cones], arrived: 0.0, guided: 0.0, clamped: 0 };
        // A window without light, of one primary more at a time.
        let mut dark = Source { primaries: Vec::new(), covers_display: false };
        let mut before = none.clone();
        for (primary, light) in source.primaries.iter().enumerate() {
            dark.primaries.push(SourcePrimary { layers: Vec::new() });
            let mut until = none.clone();
            self.tail.correct(&mut until, (shown, &dark), projector);
            let mut total = 0.0;
            let shares = until.isomerized.iter().zip(&before.isomerized).map(|(until, before)| {
                total += kept * (until - before).max(0.0);
                total
            });
            let shares: Vec<f64> = shares.collect();
            before = until;
            let photons = poisson::from_stream(stream, total) as u64;
            let words = Words { key: stream.bits() };
            let courses = courses(&projector.emitters[primary], &projector.display, shown.index);
            let lights: Vec<f64> =
                if more.list.is_some() { light.layers.iter().map(sent).collect() } else { Vec::new() };
            for photon in 0..photons {
                let wanted = above(words.of(photon, 0)) * total;
                let cone = shares.partition_point(|share| *share <= wanted).min(cones - 1);
                more.counts[cone] = more.counts[cone].saturating_add(1);
                let Some(list) = &mut more.list else { continue };
                let Some(course) =
                    course((&light.layers, &lights), above(words.of(photon, 1))).or(courses.first())
                else {
                    continue;
                };
                let caught = tables.caught(cone as u32);
                let wave = tables.wave(primary, &caught, above(words.of(photon, 3)));
                let Some(wavelengths) = tables.wavelengths(primary, wave) else { continue };
                let frame_s = 1.0 / projector.display.frame_rate_hz;
                let lister = Lister { wavelengths, course, frame: shown.index, frame_s };
                let time = words.of(photon, 2) as u32;
                list.push(lister.photon(time, (words, photon), cone as u32, &caught));
            }
        }
        more.means.arrived += kept * before.arrived;
        more.means.guided += kept * before.guided;
    }
}

/// Light of a layer over the frame.
fn sent(layer: &Layer) -> f64 {
    layer.sent() * layer.light.iter().sum::<f64>()
}

/// The course of one of some layers, by their light.
fn course<'a>((layers, lights): (&'a [Layer], &[f64]), uniform: f64) -> Option<&'a Course> {
    let mut left = uniform * lights.iter().sum::<f64>();
    let chosen = layers.iter().zip(lights).find(|(_, light)| {
        left -= **light;
        left < 0.0
    });
    chosen.map(|(layer, _)| layer).or(layers.last()).and_then(|layer| layer.course.as_ref())
}
