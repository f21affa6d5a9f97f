//! `doctor`: looks over data folder, disk, database, blobs, clock, port and server, and says in plain words what to do.

use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use photoneye_client::Client;
use photoneye_server::doctor;
use serde::Serialize;

use super::Context;
use crate::cli_access::DoctorArgs;
use crate::failure::{Failure, plain};
use crate::output;
use crate::settings::{DEFAULT_LISTEN, Place};

/// Less room than this is a warning, bytes.
const LITTLE_ROOM: u64 = 5_000_000_000;
/// Less room than this stops work soon, bytes.
const NO_ROOM: u64 = 200_000_000;

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    Ok,
    Warning,
    Failed,
}

/// One check.
#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    verdict: Verdict,
    /// What was found, and what to do about it.
    says: String,
}

fn finding(what: &'static str, verdict: Verdict, says: impl Into<String>) -> Finding {
    Finding { what, verdict, says: says.into() }
}

/// Runs the command; fails when a check does.
pub async fn run(context: Context, args: DoctorArgs) -> Result<(), Failure> {
    let settings = &context.settings;
    let data = settings.data(args.data)?;
    let listen = args.listen.or(settings.listen.clone()).unwrap_or_else(|| DEFAULT_LISTEN.into());
    let mut findings = vec![folder(&data), processor()];
    if findings[0].verdict != Verdict::Failed {
        findings.push(room(&data));
        findings.extend(database(&data).await);
        let time = (args.verify_seconds > 0.0).then(|| Duration::try_from_secs_f64(args.verify_seconds));
        let time =
            time.transpose().map_err(|_| Failure::usage("--verify-seconds is not a number of seconds"))?;
        findings.push(blobs(&data, time));
    }
    findings.push(port(&listen));
    if let Some(place) = settings.server(args.server)? {
        findings.push(server(&place).await);
    }
    for finding in &findings {
        if context.json {
            output::json_line(finding)?;
        } else {
            let word = format!("{:?}", finding.verdict).to_lowercase();
            output::line(format_args!("{word:<8} {:<12} {}", finding.what, finding.says))?;
        }
    }
    let failed = findings.iter().filter(|finding| finding.verdict == Verdict::Failed).count();
    if failed == 0 {
        Ok(())
    } else {
        Err(Failure::failed(format!("{failed} of {} checks failed", findings.len())))
    }
}

/// Transforms round otherwise on processors without these instructions: workers of one server should be alike.
fn processor() -> Finding {
    #[cfg(target_arch = "x86_64")]
    let wide = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    #[cfg(not(target_arch = "x86_64"))]
    let wide = false;
    if wide {
        finding("processor", Verdict::Ok, "x86-64 with AVX2 and FMA")
    } else {
        let says = format!(
            "{} without AVX2 and FMA: slower, and single photons may differ from workers that have them",
            std::env::consts::ARCH
        );
        finding("processor", Verdict::Warning, says)
    }
}

fn folder(data: &Path) -> Finding {
    let probe = data.join(format!("doctor-{}", std::process::id()));
    let written = std::fs::create_dir_all(data).and_then(|()| std::fs::write(&probe, b"x"));
    let _ = std::fs::remove_file(&probe);
    match written {
        Ok(()) => finding("data folder", Verdict::Ok, format!("{} can be written", data.display())),
        Err(error) => {
            let says =
                format!("{}: {}; give another --data, or the rights to write", data.display(), plain(&error));
            finding("data folder", Verdict::Failed, says)
        }
    }
}

fn room(data: &Path) -> Finding {
    let free = match rustix::fs::statvfs(data) {
        Ok(disk) => disk.f_bavail.saturating_mul(disk.f_frsize),
        Err(error) => return finding("disk", Verdict::Warning, format!("cannot tell the room: {error}")),
    };
    let says = format!("{:.1} GB free", free as f64 / 1e9);
    match free {
        ..NO_ROOM => finding(
            "disk",
            Verdict::Failed,
            format!("{says}; jobs wait until there is room: delete something"),
        ),
        NO_ROOM..LITTLE_ROOM => finding("disk", Verdict::Warning, format!("{says}; make room soon")),
        _ => finding("disk", Verdict::Ok, says),
    }
}

async fn database(data: &Path) -> Vec<Finding> {
    if !data.join("photoneye.db").exists() {
        return vec![finding("database", Verdict::Ok, "not there yet; the first server makes it")];
    }
    let found = match doctor::database(data).await {
        Ok(found) => found,
        Err(error) => {
            let says =
                format!("{error}; restore photoneye.db, photoneye.db-wal and photoneye.db-shm from a backup");
            return vec![finding("database", Verdict::Failed, says)];
        }
    };
    let mut findings = vec![if found.integrity == "ok" {
        finding("database", Verdict::Ok, format!("whole; {} jobs, {} API keys", found.jobs, found.keys))
    } else {
        let says = format!("damaged: {}; stop the server and restore it from a backup", found.integrity);
        finding("database", Verdict::Failed, says)
    }];
    let says = format!("{} results came out differently the second time", found.alarms);
    findings.push(match found.alarms {
        0 => finding("results", Verdict::Ok, "no work gave two results"),
        _ => finding(
            "results",
            Verdict::Failed,
            format!("{says}: workers of different builds, or bad memory; see table alarms"),
        ),
    });
    findings.push(clock(found.latest_ms));
    findings
}

fn clock(latest_ms: u64) -> Finding {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_millis() as u64;
    if latest_ms > now + 1000 {
        let hours = (latest_ms - now) as f64 / 3.6e6;
        let says = format!("{hours:.1} hours behind the last job; set the clock, or wait");
        return finding("clock", Verdict::Warning, says);
    }
    finding("clock", Verdict::Ok, "not behind the last job")
}

fn blobs(data: &Path, time: Option<Duration>) -> Finding {
    match doctor::blobs(data, time) {
        Err(error) => finding("blobs", Verdict::Failed, error.to_string()),
        Ok(report) if report.damaged > 0 => {
            let says = format!(
                "{} of {} were damaged and set aside; they are made again when somebody asks. Check the disk",
                report.damaged, report.all
            );
            finding("blobs", Verdict::Warning, says)
        }
        Ok(report) => {
            finding("blobs", Verdict::Ok, format!("{} of {} read, all whole", report.whole, report.all))
        }
    }
}

fn port(listen: &str) -> Finding {
    let Ok(address) = listen.parse::<SocketAddr>() else {
        return finding(
            "port",
            Verdict::Failed,
            format!("`{listen}` is not an address and port such as {DEFAULT_LISTEN}"),
        );
    };
    match TcpListener::bind(address) {
        Ok(_) => finding("port", Verdict::Ok, format!("{address} is free")),
        Err(error) if error.kind() == std::io::ErrorKind::AddrInUse => {
            let says = format!("{address} is taken; by a server of yours, or give another --listen");
            finding("port", Verdict::Warning, says)
        }
        Err(error) => finding("port", Verdict::Failed, format!("{address}: {}", plain(&error))),
    }
}

/// What a worker or client on this machine meets.
async fn server(place: &Place) -> Finding {
    let client = match Client::connect_with(&place.url, &place.access) {
        Ok(client) => client.patience(Duration::from_secs(2)),
        Err(error) => return finding("server", Verdict::Failed, error.to_string()),
    };
    let started = Instant::now();
    match client.jobs("").await {
        Ok(_) => {
            let ms = started.elapsed().as_secs_f64() * 1e3;
            finding("server", Verdict::Ok, format!("{} answers in {ms:.0} ms", place.url))
        }
        Err(error) if error.code() == Some(tonic::Code::PermissionDenied) => {
            finding("server", Verdict::Ok, format!("{} answers; this key is not for reading jobs", place.url))
        }
        Err(error) => {
            let says = format!(
                "{}: {error}; is it running, is the address right, is a firewall between?",
                place.url
            );
            finding("server", Verdict::Failed, says)
        }
    }
}
