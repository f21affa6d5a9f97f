//! What this process uses: memory now and at most, CPU time.

/// Bytes, from the kernel's high-water mark on Linux; 0 elsewhere.
pub(crate) fn peak_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| peak_of(&status))
}

/// Bytes in use now on Linux; 0 elsewhere.
pub(crate) fn now_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| field(&status, "VmRSS:"))
}

/// CPU seconds of all threads so far, user and system, those that ended too: one system call.
pub(crate) fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

fn peak_of(status: &str) -> u64 {
    field(status, "VmHWM:")
}

fn field(status: &str, name: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix(name));
    let kibibytes = line.and_then(|rest| rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    kibibytes.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    #[test]
    fn reads_the_high_water_mark() {
        assert_eq!(super::peak_of("Name:\tx\nVmHWM:\t    2048 kB\nVmRSS: 1 kB\n"), 2 << 20);
        assert_eq!(super::peak_of(""), 0);
    }

    #[test]
    fn cpu_time_passes_when_there_is_work() {
        let before = super::cpu_seconds();
        let sum: f64 = (0..1_000_000).map(f64::from).map(f64::sqrt).sum();
        assert!(sum > 0.0 && super::cpu_seconds() > before);
    }
}
