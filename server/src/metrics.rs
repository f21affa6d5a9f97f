//! Counters of the service, in Prometheus' text form. What can be counted in the state or the database is counted there.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crate::jobs::{JobState, Phase, State};

/// Most different labels of one metric that come from outside.
const MOST_LABELS: usize = 64;

/// Since the start of the process.
#[derive(Default)]
pub struct Metrics {
    /// Artifacts that a new job found built, or being built for another.
    pub artifact_hits: AtomicU64,
    /// Artifacts that a new job needs built.
    pub artifact_misses: AtomicU64,
    /// Blobs that workers found in their local copies.
    pub worker_hits: AtomicU64,
    /// Blobs that workers fetched.
    pub worker_misses: AtomicU64,
    /// Jobs refused because of a limit.
    pub refused: AtomicU64,
    /// Bytes of results sent.
    pub result_bytes: AtomicU64,
    /// Commits and heartbeats under a lease that was taken away.
    pub fenced: AtomicU64,
    /// Seconds and pieces of work by stage.
    stages: Mutex<BTreeMap<String, (f64, u64)>>,
    /// Answers and seconds by door and status.
    answers: Mutex<BTreeMap<(bool, String), (u64, f64)>>,
}

impl Metrics {
    /// A request was answered (the body may go on).
    pub fn answered(&self, grpc: bool, status: u16, code: Option<&str>, time: Duration) {
        let status = if grpc { code.unwrap_or("0").to_owned() } else { status.to_string() };
        let mut answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = answers.entry((grpc, status)).or_default();
        entry.0 += 1;
        entry.1 += time.as_secs_f64();
    }

    /// A worker reported a piece of work; `report` is its JSON.
    pub fn worked(&self, report: &str) {
        let report: Option<serde_json::Value> = serde_json::from_str(report).ok();
        let seconds = report.as_ref().and_then(|report| report["seconds"].as_object());
        let mut stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        for (stage, seconds) in seconds.into_iter().flatten() {
            let stage: String =
                stage.chars().filter(|c| c.is_ascii_alphanumeric() || " -_".contains(*c)).collect();
            if stages.len() < MOST_LABELS || stages.contains_key(&stage) {
                let entry = stages.entry(stage).or_default();
                entry.0 += seconds.as_f64().unwrap_or(0.0);
                entry.1 += 1;
            }
        }
    }

    /// Everything as text. `jobs` counts all jobs by state, `workers` those that are alive.
    pub fn text(&self, state: &State, jobs: &[u64; 5], workers: usize) -> String {
        let mut page = Page(String::new());
        let label = |key: &str, value: String| format!("{{{key}=\"{}\"}}", value.to_lowercase());
        let all = JobState::ALL.iter().zip(jobs);
        let all: Vec<_> =
            all.map(|(one, count)| (label("state", format!("{one:?}")), *count as f64)).collect();
        page.family("jobs", "gauge", "Jobs by state.", &all);
        let of_phase = |one: Phase| state.artifacts.values().filter(|a| a.lease.phase == one).count() as f64;
        let artifacts = Phase::ALL.iter().map(|one| (label("phase", format!("{one:?}")), of_phase(*one)));
        page.family(
            "artifacts",
            "gauge",
            "Artifacts of jobs at hand, by phase.",
            &artifacts.collect::<Vec<_>>(),
        );
        let queues =
            state.queues.iter().map(|(name, jobs)| (label("tenant", name.clone()), jobs.len() as f64));
        page.family("queue_jobs", "gauge", "Active jobs by tenant.", &queues.collect::<Vec<_>>());
        let one = |value: f64| [(String::new(), value)];
        page.family("leases", "gauge", "Work that workers hold.", &one(state.leased.len() as f64));
        let left: usize = state.active.iter().filter_map(|id| state.jobs.get(id)).map(|job| job.left).sum();
        page.family("shards_left", "gauge", "Shards of active jobs that are not done.", &one(left as f64));
        page.family("workers", "gauge", "Workers heard within the life of a lease.", &one(workers as f64));
        page.family(
            "nondeterministic_results",
            "gauge",
            "Results that came out differently the second time; must be 0.",
            &one(state.nondeterministic as f64),
        );
        for (name, help, value) in [
            (
                "artifact_hits_total",
                "Artifacts that a new job found built or being built.",
                &self.artifact_hits,
            ),
            ("artifact_misses_total", "Artifacts that a new job needs built.", &self.artifact_misses),
            ("worker_cache_hits_total", "Blobs that workers found in their local copies.", &self.worker_hits),
            ("worker_cache_misses_total", "Blobs that workers fetched.", &self.worker_misses),
            ("refused_jobs_total", "Jobs refused because of a limit.", &self.refused),
            ("result_bytes_total", "Bytes of results sent.", &self.result_bytes),
            ("fenced_writes_total", "Writes refused because the lease was taken away.", &self.fenced),
        ] {
            page.family(name, "counter", help, &one(value.load(Relaxed) as f64));
        }
        self.stages_and_answers(&mut page);
        page.0
    }

    fn stages_and_answers(&self, page: &mut Page) {
        let stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        let each = |pick: fn(&(f64, u64)) -> f64| -> Vec<(String, f64)> {
            stages.iter().map(|(stage, value)| (format!("{{stage=\"{stage}\"}}"), pick(value))).collect()
        };
        page.family(
            "stage_seconds_total",
            "counter",
            "Wall seconds of workers by stage.",
            &each(|value| value.0),
        );
        page.family("stage_work_total", "counter", "Pieces of work by stage.", &each(|value| value.1 as f64));
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        let each = |pick: fn(&(u64, f64)) -> f64| -> Vec<(String, f64)> {
            let label = |grpc: bool, status: &str| {
                format!("{{door=\"{}\",status=\"{status}\"}}", if grpc { "grpc" } else { "rest" })
            };
            answers.iter().map(|((grpc, status), value)| (label(*grpc, status), pick(value))).collect()
        };
        page.family("answers_total", "counter", "Answered requests.", &each(|value| value.0 as f64));
        page.family(
            "answer_seconds_total",
            "counter",
            "Seconds until the answer began.",
            &each(|value| value.1),
        );
    }
}

struct Page(String);

impl Page {
    fn family(&mut self, name: &str, kind: &str, help: &str, values: &[(String, f64)]) {
        // Writing into a string cannot fail.
        let _ = writeln!(self.0, "# HELP photoneye_{name} {help}\n# TYPE photoneye_{name} {kind}");
        for (labels, value) in values {
            let _ = writeln!(self.0, "photoneye_{name}{labels} {value}");
        }
    }
}
