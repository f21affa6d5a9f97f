//! What the end-to-end tests share: the binary in a clean environment, a server in a process of its own, a plain HTTP client.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Longest wait for anything.
pub const PATIENCE: Duration = Duration::from_mins(5);

/// The binary, deaf to the settings of whoever runs the tests.
pub fn photoneye(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_photoneye"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("PHOTONEYE_")) {
        command.env_remove(name);
    }
    command
        .current_dir(folder)
        .env("HOME", folder)
        .env_remove("XDG_DATA_HOME")
        .env_remove("XDG_CONFIG_HOME")
        .env_remove("RUST_LOG")
        .stdin(Stdio::null());
    command
}

/// Standard output and standard error as text.
pub fn texts(output: &Output) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (text(&output.stdout), text(&output.stderr))
}

/// Runs to the end and asserts success; gives standard output.
pub fn succeed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let (out, err) = texts(&output);
    assert!(output.status.success(), "{command:?}\n{out}\n{err}");
    out
}

/// A scene that takes moments: a small patch, a drawn pattern.
pub fn small_experiment(frames: u32) -> Value {
    json!({
        "display": {"preset": "lcos-3chip", "width_px": 8, "height_px": 8},
        "video": {"pattern": {"checkerboard": {"square_px": 2}}},
        "retina": {"region_deg": {"x_min": -0.1, "x_max": 0.1, "y_min": -0.1, "y_max": 0.1}},
        "counts": {"seed": 5},
        "accuracy": {"target": 0.02, "audit_cones": 0},
        "frames": {"count": frames}
    })
}

/// `photoneye serve` in a process of its own; killed when dropped.
pub struct Server {
    child: Child,
    pub url: String,
    agent: ureq::Agent,
}

impl Server {
    /// Starts on a free port.
    pub fn start(folder: &Path, workers: usize) -> Self {
        Self::start_on(folder, workers, "127.0.0.1:0")
    }

    /// Starts on a given port.
    pub fn start_on(folder: &Path, workers: usize, listen: &str) -> Self {
        let mut child = photoneye(folder)
            .args([
                "serve",
                "--json",
                "--listen",
                listen,
                "--data",
                "data",
                "--workers",
                &workers.to_string(),
            ])
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|_| panic!("serve said `{line}`"));
        let agent =
            ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build();
        Self { child, url: said["listening"].as_str().unwrap().to_owned(), agent: agent.into() }
    }

    /// Host and port.
    pub fn address(&self) -> &str {
        self.url.strip_prefix("http://").unwrap()
    }

    /// Memory of the server's process.
    pub fn resident_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches("kB").trim().parse::<u64>().unwrap() * 1024
    }

    /// kill -9.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Status and body of a GET.
    pub fn get(&self, path: &str) -> (u16, Vec<u8>) {
        let reply = self.agent.get(format!("{}{path}", self.url)).call().unwrap();
        body(reply)
    }

    /// A GET that answers 200 with JSON.
    pub fn get_json(&self, path: &str) -> Value {
        let (status, bytes) = self.get(path);
        assert_eq!(status, 200, "GET {path}: {}", String::from_utf8_lossy(&bytes));
        serde_json::from_slice(&bytes).unwrap()
    }

    /// A POST that may break off.
    pub fn try_post(
        &self,
        path: &str,
        key: Option<&str>,
        text: &str,
    ) -> Result<ureq::http::Response<ureq::Body>, ureq::Error> {
        let mut request =
            self.agent.post(format!("{}{path}", self.url)).header("Content-Type", "application/json");
        if let Some(key) = key {
            request = request.header("Idempotency-Key", key);
        }
        request.send(text)
    }

    /// Status and body of a POST.
    pub fn post(&self, path: &str, key: Option<&str>, text: &str) -> (u16, Value) {
        let (status, bytes) = body(self.try_post(path, key, text).unwrap());
        let value = serde_json::from_slice(&bytes);
        (status, value.unwrap_or_else(|_| Value::String(String::from_utf8_lossy(&bytes).into_owned())))
    }

    /// Uploads bytes; gives status and body.
    pub fn put_blob(&self, bytes: &[u8]) -> (u16, Value) {
        let reply = self.agent.put(format!("{}/v1/blobs", self.url)).send(bytes).unwrap();
        let (status, bytes) = body(reply);
        (status, serde_json::from_slice(&bytes).unwrap_or(Value::Null))
    }

    /// Creates a job; gives its id.
    pub fn submit(&self, experiment: &Value) -> String {
        let (status, job) = self.post("/v1/jobs", None, &experiment.to_string());
        assert_eq!(status, 201, "{job}");
        job["id"].as_str().unwrap().to_owned()
    }

    /// Waits until a job satisfies a condition.
    pub fn wait(&self, id: &str, until: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let job = self.get_json(&format!("/v1/jobs/{id}"));
            if until(&job) {
                return job;
            }
            assert!(start.elapsed() < PATIENCE, "waited too long for {job}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until a job has succeeded.
    pub fn success(&self, id: &str) -> Value {
        let job = self.wait(id, |job| !matches!(job["state"].as_str(), Some("QUEUED" | "RUNNING")));
        assert_eq!(job["state"], "SUCCEEDED", "{job}");
        job
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn body(mut reply: ureq::http::Response<ureq::Body>) -> (u16, Vec<u8>) {
    let mut bytes = Vec::new();
    reply.body_mut().as_reader().read_to_end(&mut bytes).unwrap();
    (reply.status().as_u16(), bytes)
}

/// Shape and little-endian words of a .npy file of 4-byte values.
pub fn read_npy(bytes: &[u8]) -> (Vec<usize>, Vec<u32>) {
    assert_eq!(&bytes[..6], b"\x93NUMPY");
    let head = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = std::str::from_utf8(&bytes[10..10 + head]).unwrap();
    let shape = text.split("'shape': (").nth(1).unwrap().split(')').next().unwrap();
    let shape = shape.split(',').filter_map(|side| side.trim().parse().ok()).collect();
    let words = bytes[10 + head..].chunks_exact(4);
    (shape, words.map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}
