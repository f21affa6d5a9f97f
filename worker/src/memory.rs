//! What this process uses: memory now and at most, CPU time.

/// Bytes, from the kernel's high-water mark on Linux; 0 elsewhere.
pub(crate) fn peak_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| peak_of(&status))
}

/// Bytes in use now on Linux; 0 elsewhere.
pub(crate) fn now_bytes() -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| field(&status, "VmRSS:"))
}

/// CPU seconds used so far on Linux, user and system; 0 elsewhere.
pub(crate) fn cpu_seconds() -> f64 {
    std::fs::read_to_string("/proc/self/stat").map_or(0.0, |stat| cpu_of(&stat))
}

/// Fields 14 and 15, in hundredths of a second; the name in brackets before them may hold blanks.
fn cpu_of(stat: &str) -> f64 {
    let behind_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks = behind_name.split_whitespace().skip(11).take(2);
    ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
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
        let stat = "7 (a b) c) S 1 2 3 4 5 6 7 8 9 10 250 50 0 0 20";
        assert!((super::cpu_of(stat) - 3.0).abs() < 1e-12);
    }
}
