//! The workers that were heard lately: what they do and what they use. For people; the leases do not depend on it.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Forgotten after so long.
const FORGET: Duration = Duration::from_mins(10);
/// Most workers that are remembered.
const MOST: usize = 2000;

/// What a worker said last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Word {
    /// What it works on; empty: it waits for work.
    pub work: String,
    /// What it does, for people.
    pub stage: String,
    /// How far it is, 0 to 1.
    pub progress: f64,
    /// Memory in use, bytes.
    pub memory_bytes: u64,
    /// CPU time used so far, seconds.
    pub cpu_seconds: f64,
    /// Local copies, bytes.
    pub cache_bytes: u64,
}

/// Workers by name.
#[derive(Default)]
pub struct Fleet {
    workers: Mutex<BTreeMap<String, (Instant, Word)>>,
}

impl Fleet {
    /// A worker was heard.
    pub fn heard(&self, name: &str, change: impl FnOnce(&mut Word)) {
        let mut workers = self.workers.lock().unwrap_or_else(PoisonError::into_inner);
        if workers.len() >= MOST && !workers.contains_key(name) {
            return;
        }
        let entry =
            workers.entry(name.chars().take(100).collect()).or_insert((Instant::now(), Word::default()));
        entry.0 = Instant::now();
        change(&mut entry.1);
    }

    /// Everybody who was heard in the last ten minutes.
    pub fn list(&self) -> Value {
        let mut workers = self.workers.lock().unwrap_or_else(PoisonError::into_inner);
        workers.retain(|_, (heard, _)| heard.elapsed() < FORGET);
        let list = workers.iter().map(|(name, (heard, word))| {
            json!({"name": name, "heard_seconds_ago": heard.elapsed().as_secs_f64(), "work": word.work,
                   "stage": word.stage, "progress": word.progress, "memory_bytes": word.memory_bytes,
                   "cpu_seconds": word.cpu_seconds, "cache_bytes": word.cache_bytes})
        });
        json!({"workers": list.collect::<Vec<_>>()})
    }

    /// How many were heard within the life of a lease.
    pub fn alive(&self) -> usize {
        let workers = self.workers.lock().unwrap_or_else(PoisonError::into_inner);
        workers.values().filter(|(heard, _)| heard.elapsed() < Duration::from_secs(35)).count()
    }
}
