//! Faults at random: kill -9 of server and workers, SIGSTOP, damaged and truncated files, slow readers, broken connections, a
//! full disk. Nothing is lost, nothing doubled, and the result is that of a calm run.
//!
//! PHOTONEYE_TORTURE_SECONDS makes it longer (default 25), PHOTONEYE_TORTURE_SEED repeats a run; the seed is printed.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;
use tempfile::tempdir;

use crate::support::{Server, photoneye, small_experiment};

const FRAMES: u32 = 48;

/// xorshift64*: small, and the same everywhere.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) % sides
    }
}

fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

fn experiment(number: u64) -> Value {
    let mut experiment = small_experiment(FRAMES);
    experiment["counts"]["seed"] = number.to_string().into();
    experiment
}

fn signal(child: &Child, name: &str) {
    Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap();
}

fn worker(place: &Path, url: &str, number: usize) -> Child {
    let mut command = photoneye(place);
    command.args(["worker", "--server", url, "--cache", &format!("cache-{number}"), "--workers", "1"]);
    command.stderr(Stdio::null()).spawn().unwrap()
}

/// A blob of the server or of a worker.
fn some_blob(place: &Path, dice: &mut Dice) -> Option<PathBuf> {
    let folder = ["data", "cache-0", "cache-1"][dice.roll(3) as usize];
    let shelves = fs::read_dir(place.join(folder).join("blobs")).ok()?.flatten();
    let blobs: Vec<PathBuf> = shelves
        .flat_map(|shelf| fs::read_dir(shelf.path()).into_iter().flatten().flatten())
        .map(|b| b.path())
        .collect();
    blobs.get(dice.roll(blobs.len().max(1) as u64) as usize).cloned()
}

fn damage(path: &Path, dice: &mut Dice) {
    let Ok(mut bytes) = fs::read(path) else { return };
    if bytes.is_empty() {
        return;
    }
    let at = dice.roll(bytes.len() as u64) as usize;
    if dice.roll(2) == 0 {
        bytes[at] ^= 1 << dice.roll(8);
    } else {
        bytes.truncate(at);
    }
    // In place: who has the file mapped keeps what it has verified only when the file is replaced, as a broken disk would not.
    let aside = path.with_extension("damaged");
    if fs::write(&aside, &bytes).is_ok() {
        let _ = fs::rename(&aside, path);
    }
}

/// Submits until there is an answer: the same key again is the same job.
fn submit(server: &Server, key: &str, number: u64) -> Option<String> {
    let reply = server.try_post("/v1/jobs", Some(key), &experiment(number).to_string());
    let mut reply = reply.ok().filter(|reply| reply.status().is_success())?;
    let job: Value = serde_json::from_reader(reply.body_mut().as_reader()).ok()?;
    Some(job["id"].as_str()?.to_owned())
}

/// A server, two workers, whoever reads slowly, and the jobs: key, seed and, once accepted, id.
struct Storm {
    place: tempfile::TempDir,
    server: Option<Server>,
    address: String,
    workers: [Child; 2],
    readers: Vec<TcpStream>,
    jobs: Vec<(String, u64, Option<String>)>,
    dice: Dice,
}

impl Storm {
    fn begin(dice: Dice) -> Self {
        let place = tempdir().unwrap();
        let server = Server::start(place.path(), 0);
        let address = server.address().to_owned();
        let workers = [0, 1].map(|number| worker(place.path(), &server.url, number));
        Self { place, server: Some(server), address, workers, readers: Vec::new(), jobs: Vec::new(), dice }
    }

    fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// One more job when all are accepted; then asks again for each.
    fn submit(&mut self) {
        if self.jobs.len() < 200 && self.jobs.iter().all(|job| job.2.is_some()) {
            self.jobs.push((format!("key {}", self.jobs.len()), self.dice.roll(3), None));
        }
        let server = self.server.as_ref().unwrap();
        for (key, number, id) in &mut self.jobs {
            let answered = submit(server, key, *number);
            assert!(id.is_none() || answered.is_none() || *id == answered, "a key gave two jobs");
            *id = id.take().or(answered);
        }
    }

    /// One fault of seven kinds.
    fn strike(&mut self, deed: usize) {
        match deed {
            0 => {
                self.server.take().into_iter().for_each(Server::kill);
                self.server = Some(Server::start_on(self.place.path(), 0, &self.address));
            }
            1 => {
                let number = self.dice.roll(2) as usize;
                self.workers[number].kill().unwrap();
                self.workers[number].wait().unwrap();
                self.workers[number] = worker(self.place.path(), &self.url(), number);
            }
            2 => {
                let number = self.dice.roll(2) as usize;
                signal(&self.workers[number], "STOP");
                std::thread::sleep(Duration::from_millis(100 + self.dice.roll(900)));
                signal(&self.workers[number], "CONT");
            }
            3 | 4 => {
                if let Some(path) = some_blob(self.place.path(), &mut self.dice) {
                    damage(&path, &mut self.dice);
                }
            }
            5 => {
                // Asks for a result, takes a little of it and no more.
                let id = self.jobs.first().and_then(|job| job.2.clone()).unwrap_or_default();
                if let Ok(mut reader) = TcpStream::connect(&self.address) {
                    let _ = write!(reader, "GET /v1/jobs/{id}/results HTTP/1.1\r\nhost: test\r\n\r\n");
                    let _ = reader.set_read_timeout(Some(Duration::from_millis(50)));
                    let _ = reader.read(&mut [0; 64]);
                    self.readers.push(reader);
                }
            }
            _ => {
                // Breaks off in the middle of a request, and all slow readers with it.
                if let Ok(mut broken) = TcpStream::connect(&self.address) {
                    let _ = broken.write_all(
                        b"POST /v1/jobs HTTP/1.1\r\nhost: test\r\ncontent-length: 900\r\n\r\n{\"eye\"",
                    );
                }
                self.readers.clear();
            }
        }
    }
}

#[test]
fn faults_at_random_change_nothing() {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let seed = setting("PHOTONEYE_TORTURE_SEED").unwrap_or(now.as_secs());
    let length = Duration::from_secs(setting("PHOTONEYE_TORTURE_SECONDS").unwrap_or(25));
    println!("PHOTONEYE_TORTURE_SEED={seed}");
    let dice = Dice(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);

    let calm_place = tempdir().unwrap();
    let calm_server = Server::start(calm_place.path(), 2);
    let calm = |number| {
        let id = calm_server.submit(&experiment(number));
        let digest = calm_server.success(&id)["result_digest"].clone();
        (digest, calm_server.get(&format!("/v1/jobs/{id}/counts.npy")).1)
    };
    let calm: Vec<_> = (0..3).map(calm).collect();
    drop(calm_server);

    let mut storm = Storm::begin(dice);
    let mut deeds = [0_u32; 7];
    let start = Instant::now();
    while start.elapsed() < length {
        storm.submit();
        let deed = storm.dice.roll(7) as usize;
        deeds[deed] += 1;
        storm.strike(deed);
        std::thread::sleep(Duration::from_millis(storm.dice.roll(700)));
    }
    println!(
        "kills of the server {}, of workers {}, stops {}, damages {}, slow readers {}, broken requests {}; {} jobs in {:?}",
        deeds[0],
        deeds[1],
        deeds[2],
        deeds[3] + deeds[4],
        deeds[5],
        deeds[6],
        storm.jobs.len(),
        start.elapsed()
    );

    // Calm again: every job ends, with the bytes of the calm run, although what holds them is damaged once more.
    let Storm { place, server, workers, jobs, mut dice, .. } = storm;
    let server = server.unwrap();
    for (key, number, id) in &jobs {
        let id = id.clone().or_else(|| submit(&server, key, *number)).unwrap();
        let job = server.success(&id);
        let (digest, npy) = &calm[*number as usize];
        assert_eq!(&job["result_digest"], digest, "seed {seed}, {job}");
        if let Some(path) = some_blob(place.path(), &mut dice) {
            damage(&path, &mut dice);
        }
        let (status, bytes) = server.get(&format!("/v1/jobs/{id}/counts.npy"));
        assert!(status == 200 && bytes == *npy, "seed {seed}, {id}: {status}, {} bytes", bytes.len());
    }
    let list = server.get_json("/v1/jobs?page_size=200");
    assert_eq!(list["jobs"].as_array().unwrap().len(), jobs.len(), "a job was lost or doubled: seed {seed}");
    let metrics = String::from_utf8(server.get("/metrics").1).unwrap();
    assert!(metrics.contains("photoneye_nondeterministic_results 0"), "seed {seed}: {metrics}");
    for mut worker in workers {
        worker.kill().unwrap();
        worker.wait().unwrap();
    }
}

/// A worker that sleeps past its lease and wakes up again: another one has its work, and what it says is refused.
#[test]
fn a_zombie_is_fenced_off() {
    let place = tempdir().unwrap();
    let server = Server::start(place.path(), 0);
    let id = server.submit(&small_experiment(400));
    let mut zombie = worker(place.path(), &server.url, 0);
    server.wait(&id, |job| job["state"] == "RUNNING");
    signal(&zombie, "STOP");
    let mut other = worker(place.path(), &server.url, 1);
    let job = server.success(&id);
    signal(&zombie, "CONT");
    let npy = server.get(&format!("/v1/jobs/{id}/counts.npy")).1;
    // It finds out by itself and takes other work.
    let metric = |name: &str| {
        let text = String::from_utf8(server.get("/metrics").1).unwrap();
        let line = text.lines().find_map(|line| line.strip_prefix(name)).unwrap().trim().to_owned();
        line.parse::<f64>().unwrap()
    };
    let start = Instant::now();
    while metric("photoneye_fenced_writes_total") < 1.0 {
        assert!(start.elapsed() < Duration::from_mins(1), "the zombie was never heard again");
        std::thread::sleep(Duration::from_millis(200));
    }
    other.kill().unwrap();
    other.wait().unwrap();
    server.success(&server.submit(&small_experiment(2)));
    assert_eq!(server.get_json(&format!("/v1/jobs/{id}"))["result_digest"], job["result_digest"]);
    assert_eq!(server.get(&format!("/v1/jobs/{id}/counts.npy")).1, npy);
    assert!(metric("photoneye_nondeterministic_results") < 0.5);
    zombie.kill().unwrap();
    zombie.wait().unwrap();
}

/// A small disk of its own, when this machine lets us; taken away when dropped.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn new() -> Option<Self> {
        let place = tempdir().unwrap();
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", "size=32m", "tmpfs"]).arg(place.path());
        let mounted = mount.stderr(Stdio::null()).status().is_ok_and(|status| status.success());
        mounted.then_some(Self(place))
    }

    /// Takes all the room that is left.
    fn fill(&self) {
        let mut file = fs::File::create(self.0.path().join("filler")).unwrap();
        while file.write_all(&[7; 4096]).is_ok() {}
        while file.write_all(&[7]).is_ok() {}
    }

    fn empty(&self) {
        fs::remove_file(self.0.path().join("filler")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_is_waited_out() {
    let Some(disk) = SmallDisk::new() else {
        println!("skipped: a small disk cannot be mounted here");
        return;
    };
    let calm_place = tempdir().unwrap();
    let calm_server = Server::start(calm_place.path(), 2);
    let calm = calm_server.success(&calm_server.submit(&experiment(1)));
    drop(calm_server);

    let server = Server::start(disk.0.path(), 1);
    disk.fill();
    let (status, problem) = server.post("/v1/jobs", Some("k"), &experiment(1).to_string());
    assert_eq!(status, 503, "{problem}");
    assert_eq!(server.get("/healthz").0, 200, "the server lives on");
    assert!(server.get_json("/v1/jobs")["jobs"].is_null(), "what was refused is not there");
    disk.empty();
    let (status, job) = server.post("/v1/jobs", Some("k"), &experiment(1).to_string());
    assert_eq!(status, 201, "{job}");
    let id = job["id"].as_str().unwrap();
    server.wait(id, |job| job["state"] != "QUEUED");
    disk.fill();
    std::thread::sleep(Duration::from_secs(3));
    disk.empty();
    assert_eq!(server.success(id)["result_digest"], calm["result_digest"]);
}
