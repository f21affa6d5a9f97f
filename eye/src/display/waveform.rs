//! When a primary gives its light (§7): flashes, pulses, settling pixels; lowered to parts of a frame with exact integrals.
//!
//! Time u runs from 0 to 1 over a frame of T seconds. The light of a frame is `target·now(u) + S·past(u)`: `target` is this
//! picture's light, S what earlier pictures left, `S = Σ_{j>=1} (1-m) m^(j-1) target_{n-j}`, with
//! * a phosphor that flashes at u0 and decays in τ, k = T/τ: `now = k e^{-k(u-u0)}` from u0 on, `past = k e^{-k(u+1-u0)}/(1-e^{-k})`,
//!   m = e^{-k};
//! * a pixel that settles in τ, κ = T/τ, before a light b(u): `now = b (1 - e^{-κu})`, `past = b e^{-κu}`, m = e^{-κ}.
//!
//! For a still picture both sum to one frame of light. A scanned screen gives each pixel its waveform a delay later ([`super::scan`]).

use serde::{Deserialize, Serialize};

use super::scan::Scan;
use crate::experiment::{RangeError, check_range};

/// Most pulses of a frame.
const MAX_PULSES: usize = 64;
/// Most PWM periods in a frame.
const MAX_PWM: f64 = 1000.0;
/// What earlier pictures may leave without being looked at, relative to their light.
pub const FORGOTTEN: f64 = 1e-5;
/// Most earlier pictures that a frame looks at.
pub const MAX_HISTORY: u32 = 256;

/// Light against time. The light of a frame is that of a steady source, except for PWM out of step with the frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Waveform {
    /// Constant.
    Steady,
    /// On during parts `[start, end]` of the frame, with the same intensity.
    Pulses(Vec<[f64; 2]>),
    /// Switched on and off regularly, from time 0 on, whatever the frame rate.
    Pwm {
        /// Periods per second.
        hz: f64,
        /// Part of the period that is on.
        duty: f64,
    },
    /// A flash that decays exponentially.
    Phosphor {
        /// Time to 1/e, µs.
        decay_us: f64,
        /// When it flashes, part of the frame.
        start: f64,
    },
    /// Each pixel in its turn, from the top left to the bottom right.
    Scanned {
        /// What a pixel does from its turn on; not scanned, not PWM.
        pixel: Box<Waveform>,
        /// The turns.
        scan: Scan,
    },
}

/// A part of the frame with light that falls as `e^{-decay·x}`, x from 0 to 1 over the part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Start, in frames from the frame's start.
    pub start: f64,
    /// End.
    pub end: f64,
    /// Light in it; may be negative where it is taken from another part.
    pub share: f64,
    /// e-folds over the part.
    pub decay: f64,
}

/// When a frame's light comes.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// Light of this picture.
    pub now: Vec<Part>,
    /// Light that earlier pictures left; empty without memory.
    pub past: Vec<Part>,
    /// m of the module's formula, 0 to 1.
    pub memory: f64,
}

impl Part {
    /// Light between two places (0 to 1) of the part.
    pub fn share_between(&self, from: f64, to: f64) -> f64 {
        if self.decay < 1e-9 {
            return self.share * (to - from);
        }
        self.share * (-self.decay * from).exp() * -(-self.decay * (to - from)).exp_m1()
            / -(-self.decay).exp_m1()
    }
}

/// Light of parts from the frame's start to u.
pub fn light_until(parts: &[Part], u: f64) -> f64 {
    let until = |p: &Part| {
        let place = if u >= p.end { 1.0 } else { ((u - p.start) / (p.end - p.start)).max(0.0) };
        p.share_between(0.0, place)
    };
    parts.iter().map(until).sum()
}

impl Waveform {
    /// Checks ranges. `path` is the field's path in the schema.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self, path: &str, frame_rate_hz: f64) -> Result<(), RangeError> {
        match self {
            Self::Steady => Ok(()),
            Self::Pulses(pulses) => {
                if pulses.is_empty() || pulses.len() > MAX_PULSES {
                    let allowed = format!("1 to {MAX_PULSES} parts");
                    return Err(RangeError::new(&format!("{path}.pulses.parts"), pulses.len(), &allowed));
                }
                let mut last = 0.0;
                for (i, [start, end]) in pulses.iter().copied().enumerate() {
                    let place = if pulses.len() == 1 {
                        format!("{path}.pulse")
                    } else {
                        format!("{path}.pulses.parts[{i}]")
                    };
                    check_range(&format!("{place}.start"), start, last, 1.0)?;
                    check_range(&format!("{place}.end"), end, start + 1e-6, 1.0)?;
                    last = end;
                }
                Ok(())
            }
            Self::Pwm { hz, duty } => {
                check_range(&format!("{path}.pwm.hz"), *hz, 1.0, MAX_PWM * frame_rate_hz)?;
                check_range(&format!("{path}.pwm.duty"), *duty, 1e-3, 1.0)
            }
            Self::Phosphor { decay_us, start } => {
                check_range(&format!("{path}.phosphor.decay_us"), *decay_us, 1e-3, 1e6)?;
                check_range(&format!("{path}.phosphor.start"), *start, 0.0, 1.0 - 1e-6)
            }
            Self::Scanned { pixel, scan } => {
                scan.validate(path, pixel)?;
                pixel.validate(path, frame_rate_hz)
            }
        }
    }

    /// The turns of a scanned screen.
    pub fn scan(&self) -> Option<&Scan> {
        match self {
            Self::Scanned { scan, .. } => Some(scan),
            Self::Steady | Self::Pulses(_) | Self::Pwm { .. } | Self::Phosphor { .. } => None,
        }
    }

    /// Parts of the source's own light in frame `index`, without what a pixel does with it.
    fn source(&self, index: u32, frame_s: f64) -> Vec<Part> {
        let part = |start: f64, end: f64, share: f64| Part { start, end, share, decay: 0.0 };
        match self {
            Self::Steady => vec![part(0.0, 1.0, 1.0)],
            Self::Pulses(pulses) => {
                let lit: f64 = pulses.iter().map(|[start, end]| end - start).sum();
                pulses.iter().map(|[start, end]| part(*start, *end, (end - start) / lit)).collect()
            }
            Self::Pwm { hz, duty } => {
                let (period, from) = (1.0 / (hz * frame_s), f64::from(index));
                let first = (from / period).floor() as u64;
                let last = ((from + 1.0) / period).ceil() as u64;
                let on = |k: u64| {
                    let start = (k as f64 * period - from).max(0.0);
                    let end = ((k as f64 + duty) * period - from).min(1.0);
                    (end > start).then(|| part(start, end, (end - start) / duty))
                };
                (first..last).filter_map(on).collect()
            }
            Self::Phosphor { decay_us, start } => {
                let decay = frame_s / (decay_us * 1e-6) * (1.0 - start);
                vec![Part { start: *start, end: 1.0, share: -(-decay).exp_m1(), decay }]
            }
            Self::Scanned { pixel, .. } => pixel.source(index, frame_s),
        }
    }

    /// The timing of a pixel whose turn comes `delay` of a frame after the frame's start; without a scan, as [`Waveform::timing`].
    pub fn timing_at(&self, index: u32, frame_s: f64, lag_ms: f64, delay: f64) -> Timing {
        let Self::Scanned { pixel, .. } = self else {
            return self.timing(index, frame_s, lag_ms);
        };
        if let Self::Phosphor { decay_us, start } = **pixel {
            return Self::Phosphor { decay_us, start: start + delay }.timing(index, frame_s, 0.0);
        }
        // What is late for its frame falls into the next one.
        let (mut now, mut past) = (Vec::new(), Vec::new());
        for part in pixel.source(index, frame_s) {
            let (start, end) = (part.start + delay, part.end + delay);
            let piece = |from: f64, to: f64, shift: f64| {
                let share = part.share * (to - from) / (end - start);
                (to > from).then_some(Part { start: from - shift, end: to - shift, share, decay: 0.0 })
            };
            now.extend(piece(start.min(1.0), end.min(1.0), 0.0));
            past.extend(piece(start.max(1.0), end.max(1.0), 1.0));
        }
        Timing { now, past, memory: 0.0 }
    }

    /// The timing of frame `index` behind pixels that settle in `lag_ms` (0: at once); of a scanned screen that of its last pixel.
    pub fn timing(&self, index: u32, frame_s: f64, lag_ms: f64) -> Timing {
        if let Self::Scanned { scan, .. } = self {
            return self.timing_at(index, frame_s, lag_ms, scan.share);
        }
        let mut now = self.source(index, frame_s);
        if let Self::Phosphor { decay_us, start } = self {
            let folds = frame_s / (decay_us * 1e-6);
            let left = (-folds * (1.0 - start)).exp();
            let memory = (-folds).exp();
            let past = Part { start: 0.0, end: 1.0, share: left, decay: folds };
            // What is left after a frame and does not count is not looked at.
            let past = if left < FORGOTTEN * 1e-3 { Vec::new() } else { vec![past] };
            return Timing { now, past, memory };
        }
        if lag_ms <= 0.0 {
            return Timing { now, past: Vec::new(), memory: 0.0 };
        }
        let folds = frame_s / (lag_ms * 1e-3);
        let unsettled = |p: &Part| {
            let decay = folds * (p.end - p.start);
            let mean = if decay < 1e-9 { 1.0 } else { -(-decay).exp_m1() / decay };
            Part { share: p.share * (-folds * p.start).exp() * mean, decay, ..*p }
        };
        let past: Vec<Part> = now.iter().map(unsettled).collect();
        now.extend(past.iter().map(|p| Part { share: -p.share, ..*p }));
        Timing { now, past, memory: (-folds).exp() }
    }
}

impl Timing {
    /// How many earlier pictures matter; [`MAX_HISTORY`] + 1 when more than are served.
    pub fn history(&self) -> u32 {
        if self.past.is_empty() {
            return 0;
        }
        let left: f64 = self.past.iter().map(|p| p.share).sum::<f64>().max(FORGOTTEN * 1e-3);
        // left·m^n < forgotten
        let needed = ((FORGOTTEN / left).ln() / self.memory.max(f64::MIN_POSITIVE).ln()).ceil().max(1.0);
        needed.min(f64::from(MAX_HISTORY + 1)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total(parts: &[Part]) -> f64 {
        parts.iter().map(|p| p.share).sum()
    }

    fn scanned(pixel: Waveform) -> Waveform {
        Waveform::Scanned { pixel: Box::new(pixel), scan: Scan { share: 0.93, line: 0.8 } }
    }

    fn all() -> Vec<(Waveform, f64)> {
        vec![
            (Waveform::Steady, 0.0),
            (Waveform::Steady, 5.0),
            (Waveform::Steady, 500.0),
            (Waveform::Pulses(vec![[0.1, 0.2], [0.6, 0.9]]), 0.0),
            (Waveform::Pulses(vec![[0.7, 0.9]]), 8.0),
            (Waveform::Pwm { hz: 240.0, duty: 0.25 }, 4.0),
            (Waveform::Phosphor { decay_us: 150.0, start: 0.3 }, 0.0),
            (Waveform::Phosphor { decay_us: 30_000.0, start: 0.0 }, 0.0),
            (scanned(Waveform::Phosphor { decay_us: 5000.0, start: 0.05 }), 0.0),
            (scanned(Waveform::Pulses(vec![[0.1, 0.2], [0.6, 0.9]])), 0.0),
            (scanned(Waveform::Steady), 0.0),
        ]
    }

    /// A still picture gives one frame of light, whatever its waveform; the light at any time is not negative.
    #[test]
    fn a_still_picture_gives_a_frame_of_light() {
        for (waveform, lag_ms) in all() {
            for index in [0, 1, 7] {
                let timing = waveform.timing(index, 1.0 / 60.0, lag_ms);
                assert!(
                    (total(&timing.now) + total(&timing.past) - 1.0).abs() < 1e-12,
                    "{waveform:?} {timing:?}"
                );
                let until = |u| light_until(&timing.now, u);
                assert!(
                    (0..100).all(|i| until(f64::from(i + 1) / 100.0) >= until(f64::from(i) / 100.0) - 1e-15)
                );
            }
        }
    }

    /// Light of one bright picture among dark ones, summed over all frames, is one frame of light: nothing is lost or counted twice.
    #[test]
    fn ghosts_keep_the_light() {
        for (waveform, lag_ms) in all() {
            let timing = waveform.timing(0, 1.0 / 60.0, lag_ms);
            if matches!(waveform, Waveform::Pwm { .. } | Waveform::Pulses(_)) && lag_ms > 0.0 {
                // Light that passes a settling pixel depends on when the light is on.
                continue;
            }
            let mut light = total(&timing.now);
            for j in 1..100_000 {
                light += total(&timing.past) * (1.0 - timing.memory) * timing.memory.powi(j - 1);
            }
            assert!((light - 1.0).abs() < 1e-9, "{waveform:?} {light}");
        }
    }

    /// A pixel's light is the unscanned one, later: over this frame and what the next one holds of it.
    #[test]
    fn a_scanned_pixel_gives_its_light_later() {
        for pixel in [
            Waveform::Steady,
            Waveform::Pulses(vec![[0.1, 0.3], [0.6, 0.9]]),
            Waveform::Phosphor { decay_us: 3000.0, start: 0.02 },
        ] {
            for delay in [0.0, 0.25, 0.7, 0.93] {
                let late = scanned(pixel.clone()).timing_at(3, 0.01, 0.0, delay);
                let own = pixel.timing(3, 0.01, 0.0);
                assert!((total(&late.now) + total(&late.past) - 1.0).abs() < 1e-12);
                for u in [0.2, 0.5, 0.9, 1.0] {
                    // What earlier flashes left of a phosphor is the same function, shifted; here it is below 1e-4.
                    let wanted = light_until(&own.now, u - delay);
                    assert!((light_until(&late.now, u) - wanted).abs() < 1e-4, "{pixel:?} {delay} {u}");
                }
            }
        }
    }

    #[test]
    fn a_phosphor_falls_below_a_tenth_within_its_time() {
        let timing = Waveform::Phosphor { decay_us: 150.0, start: 0.0 }.timing(0, 1.0 / 60.0, 0.0);
        let at = |us: f64| light_until(&timing.now, us * 60e-6);
        assert!((at(150.0) - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
        // Intensity at 350 µs over that at the flash.
        let slope = |us: f64| at(us + 0.5) - at(us);
        assert!(slope(350.0) / slope(0.0) < 0.1);
        assert_eq!(timing.history(), 0);
    }

    #[test]
    fn history_covers_what_is_left() {
        let timing = Waveform::Steady.timing(0, 1.0 / 60.0, 10.0);
        let n = timing.history();
        assert!(timing.past[0].share * timing.memory.powi(n as i32) <= 1e-5);
        assert!(timing.past[0].share * timing.memory.powi(n as i32 - 1) > 1e-5);
        assert!(Waveform::Steady.timing(0, 1e-6, 1000.0).history() > MAX_HISTORY);
    }

    #[test]
    fn pwm_out_of_step_keeps_its_mean() {
        let waveform = Waveform::Pwm { hz: 250.0, duty: 0.3 };
        let light: f64 = (0..60).map(|i| total(&waveform.timing(i, 1.0 / 60.0, 0.0).now)).sum();
        assert!((light / 60.0 - 1.0).abs() < 1e-9, "{light}");
    }
}
