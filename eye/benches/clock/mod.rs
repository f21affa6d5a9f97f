//! Processor time, which other work on the machine does not lengthen as it does the wall's (Linux).

/// Seconds that this thread has had a core.
pub fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    1e-9 * text.split(' ').next().unwrap().parse::<f64>().unwrap()
}
