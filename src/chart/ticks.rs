//! Which numbers stand at an axis, and how they are written.

/// Most ticks of any kind.
const MAX_TICKS: i32 = 400;
/// Decades that a logarithmic axis must span to have powers of ten only.
const DECADES: f64 = 1.6;
/// Powers of ten that are written out.
const PLAIN: std::ops::RangeInclusive<f64> = 1e-3..=1e4;

/// A place on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Value.
    pub at: f64,
    /// Number; empty for a short mark without one. A part in `^{}` is raised.
    pub label: String,
}

/// Ticks within finite ends, ascending, about `wanted` of them with a number.
pub fn ticks(from: f64, to: f64, log: bool, wanted: usize) -> Vec<Tick> {
    if !(from.is_finite() && to.is_finite() && from < to) || (log && from <= 0.0) {
        return Vec::new();
    }
    if !log {
        return linear(from, to, wanted);
    }
    let decades = (to / from).log10();
    let plain = PLAIN.contains(&from) && PLAIN.contains(&to) && decades < wanted as f64 / 1.5;
    if decades > DECADES && !plain {
        return powers(from, to, wanted);
    }
    let fine = parts_of_decades(from, to, if decades > 0.8 { &[1, 2, 5] } else { &[1, 2, 3, 4, 5, 6, 8] });
    if fine.iter().filter(|tick| !tick.label.is_empty()).count() < 3 {
        linear(from, to, wanted)
    } else {
        fine
    }
}

/// The step 1, 2 or 5 times a power of ten that gives at most about `wanted` intervals.
pub fn step(span: f64, wanted: usize) -> f64 {
    let rough = span / wanted.max(1) as f64;
    let power = 10.0_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= rough * 0.999).unwrap_or(10.0);
    factor * power
}

fn linear(from: f64, to: f64, wanted: usize) -> Vec<Tick> {
    let step = step(to - from, wanted);
    let large = from.abs().max(to.abs());
    if !step.is_normal() || step < 1e-12 * large {
        return Vec::new();
    }
    let decimals = (-step.log10().floor()).max(0.0);
    let first = (from / step - 1e-6).ceil();
    (0..MAX_TICKS)
        .map(|i| (first + f64::from(i)) * step)
        .take_while(|at| *at <= to + 1e-6 * step)
        .map(|at| Tick { at, label: tick_label(at, decimals, large) })
        .collect()
}

/// Powers of ten when an axis with numbers up to `large` needs them.
fn tick_label(value: f64, decimals: f64, large: f64) -> String {
    if large < 1e7 && decimals <= 5.0 {
        return number(value, decimals);
    }
    if value == 0.0 { "0".into() } else { scientific(value) }
}

/// A number with so many decimals, thousands parted by a comma.
pub fn number(value: f64, decimals: f64) -> String {
    let value = if value.abs() < 0.5 * 10.0_f64.powf(-decimals) { 0.0 } else { value };
    let text = format!("{:.*}", decimals as usize, value.abs());
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let mut out = String::from(if value < 0.0 { "-" } else { "" });
    for (i, digit) in whole.char_indices() {
        if i > 0 && (whole.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    if !fraction.is_empty() {
        out.push('.');
        out.push_str(fraction);
    }
    out
}

/// Up to three figures times a power of ten.
fn scientific(value: f64) -> String {
    let text = format!("{value:.2e}");
    let (figures, power) = text.split_once('e').unwrap_or((&text, "0"));
    let figures =
        if figures.contains('.') { figures.trim_end_matches('0').trim_end_matches('.') } else { figures };
    if figures == "1" { format!("10^{{{power}}}") } else { format!("{figures}·10^{{{power}}}") }
}

/// Every power of ten, or every second, third …; between neighbours short marks.
fn powers(from: f64, to: f64, wanted: usize) -> Vec<Tick> {
    let (first, last) = ((from.log10() - 1e-9).ceil() as i32, (to.log10() + 1e-9).floor() as i32);
    let every = ((last - first) / wanted.max(1) as i32 + 1).max(1);
    let plain = PLAIN.contains(&10.0_f64.powi(first)) && PLAIN.contains(&10.0_f64.powi(last));
    let mut out = Vec::new();
    for power in first - 1..=last {
        let decade = 10.0_f64.powi(power);
        if power >= first {
            let label = match power {
                _ if (power - first) % every != 0 => String::new(),
                _ if plain => number(decade, f64::from(-power).max(0.0)),
                _ => format!("10^{{{power}}}"),
            };
            out.push(Tick { at: decade, label });
        }
        if every == 1 {
            let between = (2..10).map(|k| f64::from(k) * decade).filter(|at| (from..=to).contains(at));
            out.extend(between.map(|at| Tick { at, label: String::new() }));
        }
    }
    out
}

/// Each decade's multiples; those listed have a number.
fn parts_of_decades(from: f64, to: f64, numbered: &[i32]) -> Vec<Tick> {
    let (first, last) = (from.log10().floor() as i32, to.log10().ceil() as i32);
    let multiples = (first..=last).flat_map(|power| (1..10).map(move |k| (power, k)));
    multiples
        .map(|(power, k)| (power, k, f64::from(k) * 10.0_f64.powi(power)))
        .filter(|(_, _, at)| (from * (1.0 - 1e-9)..=to * (1.0 + 1e-9)).contains(at))
        .map(|(power, k, at)| {
            let label = tick_label(at, f64::from(-power).max(0.0), to);
            Tick { at, label: if numbered.contains(&k) { label } else { String::new() } }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(from: f64, to: f64, log: bool, wanted: usize) -> Vec<String> {
        let ticks = ticks(from, to, log, wanted);
        ticks.into_iter().map(|tick| tick.label).filter(|label| !label.is_empty()).collect()
    }

    #[test]
    fn steps_are_one_two_and_five() {
        for (span, want) in [(1.0, 0.2), (10.0, 2.0), (0.9, 0.2), (22.0, 5.0), (0.003, 0.001), (7e6, 2e6)] {
            assert!((step(span, 5) / want - 1.0).abs() < 1e-9, "{span}");
        }
    }

    #[test]
    fn linear_numbers() {
        assert_eq!(labels(0.0, 1.0, false, 5), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(-0.11, 0.1, false, 4), ["-0.1", "0.0", "0.1"]);
        assert_eq!(labels(0.0, 200_000.0, false, 4), ["0", "50,000", "100,000", "150,000", "200,000"]);
        assert_eq!(labels(0.975, 1.025, false, 5), ["0.98", "0.99", "1.00", "1.01", "1.02"]);
        assert_eq!(labels(0.0, 4e9, false, 4), ["0", "10^{9}", "2·10^{9}", "3·10^{9}", "4·10^{9}"]);
    }

    #[test]
    fn logarithmic_numbers() {
        assert_eq!(labels(0.04, 120.0, true, 4), ["0.1", "1", "10", "100"]);
        assert_eq!(labels(0.09, 11.0, true, 5), ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        assert_eq!(labels(1e3, 3e5, true, 5), ["10^{3}", "10^{4}", "10^{5}"]);
        assert_eq!(labels(0.9, 21.0, true, 5), ["1", "2", "5", "10", "20"]);
        assert_eq!(labels(1e-12, 1e12, true, 5), ["10^{-12}", "10^{-7}", "10^{-2}", "10^{3}", "10^{8}"]);
        assert_eq!(labels(1.0, 1.1, true, 5).len(), 6);
        let marks = ticks(1.0, 100.0, true, 3);
        assert_eq!(marks.len(), 19);
        assert!(marks.is_sorted_by(|a, b| a.at < b.at));
    }

    #[test]
    fn senseless_ends_have_no_ticks() {
        for (from, to) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY)] {
            assert!(ticks(from, to, false, 5).is_empty() && ticks(from, to, true, 5).is_empty());
        }
        assert!(ticks(0.0, 1.0, true, 5).is_empty() && ticks(-1.0, 1.0, true, 5).is_empty());
        assert!(ticks(1.0, 1.0 + f64::EPSILON, false, 5).len() < 10);
        assert!(ticks(-f64::MAX / 4.0, f64::MAX / 4.0, false, 5).len() < 10);
    }
}
