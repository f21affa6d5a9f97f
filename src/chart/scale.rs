//! Where a value lies on an axis: 0 at its beginning, 1 at its end.

use super::Axis;

/// Free room at each end, as a share of the span.
const ROOM: f64 = 0.04;
/// Largest magnitude that is drawn, and smallest on a logarithmic axis.
const LARGEST: f64 = 1e150;
const SMALLEST: f64 = 1e-150;

/// An axis with its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Value at 0.
    pub from: f64,
    /// Value at 1.
    pub to: f64,
    /// Logarithmic.
    pub log: bool,
}

impl Scale {
    /// The ends that an axis asks for, or that hold all values that can be shown with a little room. Always a proper range.
    pub fn new(axis: &Axis, values: impl Iterator<Item = f64>) -> Self {
        let log = axis.log;
        if let Some((from, to)) = axis.range
            && from < to
            && fits(from, log)
            && fits(to, log)
        {
            return Self { from, to, log };
        }
        let least = axis.least.into_iter().flat_map(|(from, to)| [from, to]);
        let shown = values
            .chain(least)
            .filter(|value| fits(*value, log))
            .map(|value| if log { value.log10() } else { value });
        let (low, high) = shown.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let (low, high) = match high - low {
            _ if low > high => (0.0, 1.0),
            span if span <= 1e-12 * low.abs().max(high.abs()).max(1e-12) => widened(low, log),
            span => (low - ROOM * span, high + ROOM * span),
        };
        let value = |place: f64| if log { 10.0_f64.powf(place) } else { place };
        Self { from: value(low), to: value(high), log }
    }

    /// Where a value lies; `None` when it cannot be shown. Values outside the ends lie below 0 or above 1.
    pub fn place(&self, value: f64) -> Option<f64> {
        if !fits(value, self.log) {
            return None;
        }
        let place = if self.log {
            (value / self.from).log10() / (self.to / self.from).log10()
        } else {
            (value - self.from) / (self.to - self.from)
        };
        place.is_finite().then_some(place)
    }
}

/// Ends around a single place.
fn widened(place: f64, log: bool) -> (f64, f64) {
    let half = match place {
        _ if log => 0.5,
        0.0 => 1.0,
        _ => 0.1 * place.abs(),
    };
    (place - half, place + half)
}

fn fits(value: f64, log: bool) -> bool {
    value.is_finite() && value.abs() <= LARGEST && (!log || value >= SMALLEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scale(values: &[f64], log: bool) -> Scale {
        Scale::new(&Axis { log, ..Axis::default() }, values.iter().copied())
    }

    #[test]
    fn ends_hold_all_values() {
        for log in [false, true] {
            let s = scale(&[3.0, 70.0, f64::NAN], log);
            let (a, b) = (s.place(3.0).unwrap(), s.place(70.0).unwrap());
            assert!((0.02..0.06).contains(&a) && (0.94..0.98).contains(&b));
            assert_eq!(s.place(f64::NAN), None);
        }
        assert_eq!(scale(&[1.0, 10.0], true).place(0.0), None);
    }

    #[test]
    fn degenerate_ranges_become_proper() {
        for values in [&[][..], &[f64::NAN], &[5.0], &[0.0, 0.0], &[-3.0], &[1e-300], &[1e300, -1e300]] {
            for log in [false, true] {
                let s = scale(values, log);
                assert!(s.from.is_finite() && s.to.is_finite() && s.from < s.to, "{values:?} {s:?}");
                assert!(!log || s.from > 0.0);
            }
        }
        let asked = Axis { range: Some((0.0, 1.0)), ..Axis::log("") };
        assert!(Scale::new(&asked, [2.0, 4.0].into_iter()).from > 1.0);
        let asked = Axis { range: Some((0.0, 1.0)), ..Axis::linear("") };
        assert_eq!(Scale::new(&asked, [2.0].into_iter()).to.total_cmp(&1.0), std::cmp::Ordering::Equal);
    }
}
