//! photoneye.toml and the defaults behind it.

use std::env;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::failure::{Failure, plain};

/// What photoneye.toml may say.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Data folder.
    pub data: Option<PathBuf>,
    /// Folder of a worker's local copies.
    pub cache: Option<PathBuf>,
    /// Most bytes of local copies, a number with K, M, G or T behind it if need be.
    pub cache_max: Option<String>,
    /// Seconds without work after which a worker stops.
    pub idle_exit: Option<f64>,
    /// Pieces of work done at the same time.
    pub workers: Option<usize>,
    /// A running server.
    pub server: Option<String>,
    /// Address and port to serve on.
    pub listen: Option<String>,
    /// API key to show to the server.
    pub api_key: Option<String>,
    /// Certificates to trust beside those of the system.
    pub ca_cert: Option<PathBuf>,
    /// Most bytes of results and artifacts in the data folder.
    pub store_max: Option<String>,
    /// Certificate chain to serve with.
    pub tls_cert: Option<PathBuf>,
    /// Its private key.
    pub tls_key: Option<PathBuf>,
    /// What a server accepts.
    pub limits: Option<LimitSettings>,
}

/// Lines of `[limits]`; see the server's limits.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitSettings {
    /// Jobs that are not finished.
    pub active_jobs: Option<usize>,
    /// Those of one tenant.
    pub tenant_jobs: Option<usize>,
    /// Shards of one tenant that are at work at the same time.
    pub tenant_leases: Option<usize>,
    /// Predicted CPU seconds of one job.
    pub job_seconds: Option<f64>,
    /// Predicted bytes of memory of one job.
    pub job_bytes: Option<f64>,
    /// Predicted cones of one job.
    pub job_cones: Option<f64>,
    /// Predicted CPU seconds that a tenant may ask for at once.
    pub burst_seconds: Option<f64>,
    /// And in the long run, a second.
    pub rate: Option<f64>,
    /// Jobs that are remembered, the latest.
    pub kept_jobs: Option<u64>,
    /// Records of the audit that are kept, the latest.
    pub kept_audit: Option<u64>,
    /// Days after which ended jobs and records are deleted.
    pub keep_days: Option<f64>,
}

/// A server and how to get in.
#[derive(Clone, Debug)]
pub struct Place {
    /// http or https URL.
    pub url: String,
    /// API key and certificates.
    pub access: photoneye_client::Access,
}

/// Where a server listens when nothing else is said.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:7733";
/// Pieces of work done at the same time when nothing else is said: one computes while the other waits for the disk.
pub const DEFAULT_WORKERS: usize = 2;
/// Most bytes of local copies when nothing else is said.
pub const DEFAULT_CACHE_MAX: u64 = 20_000_000_000;

impl Settings {
    /// Reads the named file, or photoneye.toml in this folder or in the user's configuration folder.
    ///
    /// # Errors
    /// When the named file is missing, or a file has a wrong line.
    pub fn load(named: Option<&Path>) -> Result<Self, Failure> {
        if let Some(path) = named {
            return Self::read(path)?
                .ok_or_else(|| Failure::usage(format!("{}: no such file", path.display())));
        }
        let user = folder_of("XDG_CONFIG_HOME", ".config");
        let places = [Some(PathBuf::from("photoneye.toml")), user.map(|f| f.join("photoneye.toml"))];
        for path in places.iter().flatten() {
            if let Some(settings) = Self::read(path)? {
                return Ok(settings);
            }
        }
        Ok(Self::default())
    }

    fn read(path: &Path) -> Result<Option<Self>, Failure> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Failure::usage(format!("{}: {}", path.display(), plain(&e)))),
        };
        let settings = toml::from_str(&text);
        settings.map(Some).map_err(|error| Failure::usage(format!("{}: {}", path.display(), error.message())))
    }

    /// The data folder.
    ///
    /// # Errors
    /// When nothing says where and there is no home folder.
    pub fn data(&self, flag: Option<PathBuf>) -> Result<PathBuf, Failure> {
        let default = || folder_of("XDG_DATA_HOME", ".local/share").map(|folder| folder.join("photoneye"));
        flag.or_else(|| self.data.clone()).or_else(default).ok_or_else(|| {
            Failure::usage("no data folder: give --data DIR or set PHOTONEYE_DATA (there is no HOME)")
        })
    }

    /// Pieces of work done at the same time.
    pub fn workers(&self, flag: Option<usize>) -> usize {
        flag.or(self.workers).unwrap_or(DEFAULT_WORKERS)
    }

    /// The server that is asked for, if any.
    ///
    /// # Errors
    /// When the certificates cannot be read.
    pub fn server(&self, flag: Option<String>) -> Result<Option<Place>, Failure> {
        flag.or_else(|| self.server.clone()).map(|url| self.place(url)).transpose()
    }

    fn place(&self, url: String) -> Result<Place, Failure> {
        let read = |path: &PathBuf| std::fs::read(path).map_err(|error| Failure::file("read", path, &error));
        let ca_pem = self.ca_cert.as_ref().map(read).transpose()?;
        Ok(Place { url, access: photoneye_client::Access { api_key: self.api_key.clone(), ca_pem } })
    }

    /// What a server accepts.
    pub fn limits(&self) -> photoneye_server::Limits {
        let (set, default) = (self.limits.clone().unwrap_or_default(), photoneye_server::Limits::default());
        photoneye_server::Limits {
            active_jobs: set.active_jobs.unwrap_or(default.active_jobs),
            tenant_jobs: set.tenant_jobs.unwrap_or(default.tenant_jobs),
            tenant_leases: set.tenant_leases.unwrap_or(default.tenant_leases),
            job_seconds: set.job_seconds.unwrap_or(default.job_seconds),
            job_bytes: set.job_bytes.or_else(most_of_memory).unwrap_or(default.job_bytes),
            job_cones: set.job_cones.unwrap_or(default.job_cones),
            burst_seconds: set.burst_seconds.unwrap_or(default.burst_seconds),
            rate: set.rate.unwrap_or(default.rate),
            kept_jobs: set.kept_jobs.unwrap_or(default.kept_jobs),
            kept_audit: set.kept_audit.unwrap_or(default.kept_audit),
            keep_days: set.keep_days.or(default.keep_days),
            ..default
        }
    }

    /// The server that is asked for, or the one on this machine.
    ///
    /// # Errors
    /// When the certificates cannot be read.
    pub fn server_or_local(&self, flag: Option<String>) -> Result<Place, Failure> {
        self.server(flag)?.map_or_else(|| self.place(format!("http://{DEFAULT_LISTEN}")), Ok)
    }

    /// Most bytes of local copies.
    ///
    /// # Errors
    /// When the text is not a number of bytes.
    pub fn cache_max(&self, flag: Option<String>) -> Result<u64, Failure> {
        let text = flag.or_else(|| self.cache_max.clone());
        text.map_or(Ok(DEFAULT_CACHE_MAX), |text| number_of_bytes("cache_max", &text))
    }

    /// Most bytes of results and artifacts in the data folder; `None`: no bound.
    ///
    /// # Errors
    /// When the text is not a number of bytes.
    pub fn store_max(&self, flag: Option<String>) -> Result<Option<u64>, Failure> {
        let text = flag.or_else(|| self.store_max.clone());
        text.map(|text| number_of_bytes("store_max", &text)).transpose()
    }
}

fn number_of_bytes(name: &str, text: &str) -> Result<u64, Failure> {
    bytes(text).ok_or_else(|| {
        Failure::usage(format!("{name}: `{text}` is not a number of bytes such as 20000000000 or 20G"))
    })
}

/// `$variable`, else `below` the home folder.
fn folder_of(variable: &str, below: &str) -> Option<PathBuf> {
    let set = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    set(variable).or_else(|| set("HOME").map(|home| home.join(below)))
}

/// `20G` is 20 000 000 000.
fn bytes(text: &str) -> Option<u64> {
    let text = text.trim();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let factor = match text[digits.len()..].to_ascii_uppercase().trim_end_matches('B') {
        "" => 1,
        "K" => 1_000,
        "M" => 1_000_000,
        "G" => 1_000_000_000,
        "T" => 1_000_000_000_000,
        _ => return None,
    };
    digits.parse::<u64>().ok()?.checked_mul(factor)
}

/// Four fifths of this machine's or container's memory, bytes, where Linux tells: a job that needs more would be killed again and again.
fn most_of_memory() -> Option<f64> {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let machine = kibibytes(&read("/proc/meminfo"), "MemTotal:")? * 1024.0;
    let container = read("/sys/fs/cgroup/memory.max").trim().parse().unwrap_or(f64::INFINITY);
    Some(0.8 * machine.min(container))
}

fn kibibytes(text: &str, name: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    #[test]
    fn memory_of_the_machine_is_read() {
        let text = "MemTotal:       24576 kB\nMemFree: 1 kB\n";
        assert_eq!(super::kibibytes(text, "MemTotal:"), Some(24576.0));
        assert_eq!(super::kibibytes(text, "SwapTotal:"), None);
    }

    use super::*;

    #[test]
    fn flag_over_file_over_default() {
        let file: Settings = toml::from_str("workers = 5\ncache_max = \"3M\"").unwrap();
        assert_eq!(file.workers(Some(1)), 1);
        assert_eq!(file.workers(None), 5);
        assert_eq!(Settings::default().workers(None), DEFAULT_WORKERS);
        assert_eq!(file.cache_max(None).unwrap(), 3_000_000);
        assert!(file.cache_max(Some("many".into())).is_err());
    }

    #[test]
    fn unknown_lines_are_refused_by_name() {
        let error = toml::from_str::<Settings>("wrokers = 5").unwrap_err();
        assert!(error.message().contains("wrokers"), "{error}");
    }

    #[test]
    fn sizes() {
        assert_eq!(bytes("12"), Some(12));
        assert_eq!(bytes("20GB"), Some(20_000_000_000));
        assert_eq!(bytes("20X"), None);
        assert_eq!(bytes("99999999999T"), None);
    }
}
