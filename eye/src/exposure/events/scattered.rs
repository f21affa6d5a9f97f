//! Light scattered in the eye: a Poisson number more a cone and primary, of the mean of `stray`; of the
//! photons that are drawn for the image only the fraction that stays there is drawn. A Poisson process may be
//! split by what becomes of its photons, and light that comes to a cone from all the screen is a sum of
//! Poisson numbers, so counts keep their distribution.
//!
//! In a list these photons have the wavelengths that their cone counts of the primary, and the time of a
//! pixel of the display, drawn by its light: on a scanned screen not the nearest pixels' time.

use rayon::prelude::*;

use super::beyond::More;
use super::dice::{Words, above};
use super::list::Lister;
use super::tables::Tables;
use crate::exposure::light::{Course, Shown, Window, courses, courses_at, light};
use crate::exposure::poisson;
use crate::exposure::source::Projector;
use crate::exposure::stray::{Received, Veil};
use crate::rng::{Purpose, Stream};

/// The scattered light of a tile.
pub(super) struct Scattered {
    pub(super) veil: Veil,
    pub(super) seed: u64,
    /// Stable numbers of the cones: a cone counts the same in any tile.
    pub(super) ids: Vec<u64>,
}

/// Photons of one primary that a cone counts, and the key of their words.
#[derive(Clone, Copy, Default)]
struct Drawn {
    photons: u32,
    key: u64,
}

impl Scattered {
    /// Draws a frame's photons.
    pub(super) fn count(&self, shown: &Shown, projector: &Projector, tables: &Tables, more: &mut More) {
        let received = self.veil.received(shown, projector);
        more.means.arrived += received.arrived;
        more.means.guided += received.guided;
        let drawn = self.drawn(u64::from(shown.index), &received);
        let primaries = projector.emitters.len();
        for (count, drawn) in more.counts.iter_mut().zip(drawn.chunks(primaries)) {
            *count = drawn.iter().fold(*count, |sum, of_primary| sum.saturating_add(of_primary.photons));
        }
        let Some(list) = &mut more.list else { return };
        let frame_s = 1.0 / projector.display.frame_rate_hz;
        for primary in 0..primaries {
            let times = Times::new(projector, shown, primary);
            for (cone, drawn) in (0_u32..).zip(drawn.iter().skip(primary).step_by(primaries)) {
                let caught = tables.caught(cone);
                let words = Words { key: drawn.key };
                for photon in 0..u64::from(drawn.photons) {
                    let uniform = [0, 1].map(|purpose| above(words.of(photon, purpose)));
                    let Some(course) = times.course(uniform) else { continue };
                    let wave = tables.wave(primary, &caught, above(words.of(photon, 3)));
                    let Some(wavelengths) = tables.wavelengths(primary, wave) else { continue };
                    let lister = Lister { wavelengths, course: &course, frame: shown.index, frame_s };
                    let time = words.of(photon, 2) as u32;
                    list.push(lister.photon(time, (words, photon), cone, &caught));
                }
            }
        }
    }

    /// `[cone][primary]`, from a stream a cone.
    fn drawn(&self, frame: u64, received: &Received) -> Vec<Drawn> {
        let primaries = received.isomerized.len();
        let mut drawn = vec![Drawn::default(); primaries * self.ids.len()];
        let cones = drawn.par_chunks_mut(primaries).with_min_len(256).zip(&self.ids).enumerate();
        cones.for_each(|(cone, (drawn, id))| {
            let mut stream = Stream::new(self.seed, Purpose::Scattered, frame, *id);
            for (drawn, means) in drawn.iter_mut().zip(&received.isomerized) {
                let photons = poisson::from_stream(&mut stream, means[cone]).min(f64::from(u32::MAX));
                *drawn = Drawn { photons: photons as u32, key: stream.bits() };
            }
        });
        drawn
    }
}

/// When light of one primary leaves the display.
struct Times<'a> {
    projector: &'a Projector,
    shown: &'a Shown<'a>,
    primary: usize,
    courses: Vec<Course>,
    /// Sums of the pixels' light over the frame.
    until: Vec<f64>,
}

impl<'a> Times<'a> {
    fn new(projector: &'a Projector, shown: &'a Shown<'a>, primary: usize) -> Self {
        let (display, emitter) = (&projector.display, &projector.emitters[primary]);
        let courses = courses(emitter, display, shown.index);
        let window = Window { first: [0; 2], size: [display.width_px, display.height_px] };
        let mut sum = 0.0;
        let mut until = window.frame_light(display, emitter, &courses, shown);
        for light in &mut until {
            sum += *light;
            *light = sum;
        }
        Self { projector, shown, primary, courses, until }
    }

    /// The course of a photon for two uniform numbers.
    fn course(&self, [pixel, which]: [f64; 2]) -> Option<Course> {
        let (display, emitter) = (&self.projector.display, &self.projector.emitters[self.primary]);
        let wanted = pixel * self.until.last()?;
        let number = self.until.partition_point(|sum| *sum <= wanted).min(self.until.len() - 1) as u32;
        let at = [number % display.width_px, number / display.width_px];
        let own = emitter
            .waveform
            .scan()
            .map(|scan| courses_at(emitter, display, self.shown.index, scan.delay(display, at)));
        let courses = own.as_ref().unwrap_or(&self.courses);
        let of = |course: &Course| course.share() * light(display, emitter, course.shows, self.shown, at);
        let mut left = which * courses.iter().map(of).sum::<f64>();
        let chosen = courses.iter().find(|course| {
            left -= of(course);
            left < 0.0
        });
        chosen.or(courses.last()).cloned()
    }
}
