//! What work costs: CPU seconds of all threads of this process, and the largest memory it used.
//!
//! CPU time is the kernel's own account of each thread in nanoseconds (`/proc/self/task/*/schedstat`), so that other programs on the
//! machine do not count. Where there is no such account the clock on the wall is used instead, and `kind` says so.

use std::fs;
use std::time::Instant;

/// CPU seconds of all threads so far; `None` where the system does not tell.
fn cpu_seconds() -> Option<f64> {
    let mut sum = 0.0;
    for thread in fs::read_dir("/proc/self/task").ok()?.flatten() {
        // A thread may end while we look.
        let text = fs::read_to_string(thread.path().join("schedstat")).unwrap_or_default();
        sum += text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9;
    }
    (sum > 0.0).then_some(sum)
}

/// What the seconds of [`measure`] are, for axes and tables.
pub fn kind() -> &'static str {
    if cpu_seconds().is_some() { "CPU seconds" } else { "seconds" }
}

/// Times work that was begun.
pub struct Stopwatch {
    cpu: Option<f64>,
    wall: Instant,
}

impl Stopwatch {
    /// Starts.
    pub fn start() -> Self {
        Self { cpu: cpu_seconds(), wall: Instant::now() }
    }

    /// CPU seconds since the start, or seconds where there is no account of CPU time.
    pub fn seconds(&self) -> f64 {
        match (self.cpu, cpu_seconds()) {
            (Some(from), Some(to)) => to - from,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

/// Does the work until it took `least` seconds, at most 1,000 times; gives the last outcome and the mean seconds of one time.
pub fn measure<T>(least: f64, mut work: impl FnMut() -> T) -> (T, f64) {
    let watch = Stopwatch::start();
    let mut outcome = work();
    let mut times = 1;
    while watch.seconds() < least && times < 1000 {
        outcome = work();
        times += 1;
    }
    (outcome, watch.seconds() / f64::from(times))
}

/// Forgets the largest memory so far, where the system allows it.
pub fn reset_peak() {
    // Elsewhere the peak is that of the whole process so far.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Largest memory since [`reset_peak`], bytes; 0 where the system does not tell.
pub fn peak_bytes() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = line.and_then(|rest| rest.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
    kibibytes.unwrap_or(0.0) * 1024.0
}

#[cfg(test)]
mod tests {
    use super::{Stopwatch, measure};

    #[test]
    fn work_takes_time() {
        let watch = Stopwatch::start();
        let spin = || (0..200_000_u64).fold(1_u64, |a, k| std::hint::black_box(a.wrapping_mul(k | 1)));
        let (_, seconds) = measure(0.02, spin);
        assert!(seconds > 0.0 && seconds < 1.0, "{seconds}");
        assert!(watch.seconds() >= 0.015, "{}", watch.seconds());
    }
}
