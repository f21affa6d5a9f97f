//! A server in a temporary folder, a plain HTTP client, and a worker that makes up its results.

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};

use photoneye_eye::artifact::ArtifactSpec;
use photoneye_proto::v1;
use photoneye_proto::v1::blobs_client::BlobsClient;
use photoneye_proto::v1::lease_reply::Work;
use photoneye_proto::v1::put_blob_request::Part;
use photoneye_proto::v1::workers_client::WorkersClient;
use photoneye_server::{Handle, Options, Server};
use photoneye_store::table::{Counts, counts_stream};
use serde_json::{Value, json};
use tonic::transport::Channel;

/// Cones of every tile that the made-up worker builds.
pub const CONES: u64 = 5;

pub async fn start(folder: &std::path::Path) -> Handle {
    let mut options = Options::new(folder);
    options.listen.set_port(0);
    Server::start(options).await.unwrap()
}

/// A small experiment with three frames.
pub fn spec() -> Value {
    json!({
        "display": {"preset": "lcos-3chip", "width_px": 4, "height_px": 4},
        "video": {"pattern": {"uniform": {"rgb": [1, 1, 1]}}},
        "frames": {"count": 3},
    })
}

/// An HTTP answer.
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("not JSON: {}", self.text()))
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// One request over HTTP/1.0, so that the answer ends with the connection.
pub async fn http(
    address: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &[u8],
) -> Answer {
    let mut head = format!("{method} {path} HTTP/1.0\r\nhost: test\r\n");
    for (name, value) in headers {
        let _ = write!(head, "{name}: {value}\r\n");
    }
    if !body.is_empty() {
        let _ = write!(head, "content-length: {}\r\n", body.len());
    }
    let request = [head.as_bytes(), b"\r\n", body].concat();
    let exchange = move || {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(&request).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        bytes
    };
    let bytes = tokio::task::spawn_blocking(exchange).await.unwrap();
    let split = bytes.windows(4).position(|end| end == b"\r\n\r\n").unwrap();
    let head = String::from_utf8_lossy(&bytes[..split]).to_lowercase();
    Answer { status: head[9..12].parse().unwrap(), head, body: bytes[split + 4..].to_vec() }
}

pub async fn get(address: SocketAddr, path: &str) -> Answer {
    http(address, "GET", path, &[], b"").await
}

pub async fn post(address: SocketAddr, path: &str, body: &Value) -> Answer {
    http(address, "POST", path, &[("content-type", "application/json")], body.to_string().as_bytes()).await
}

async fn put(channel: &Channel, bytes: Vec<u8>) -> String {
    let parts = [Part::Size(bytes.len() as u64), Part::Bytes(bytes.into())];
    let parts = parts.map(|part| v1::PutBlobRequest { part: Some(part), made: Some(true) });
    let reply = BlobsClient::new(channel.clone()).put(tokio_stream::iter(parts)).await.unwrap();
    reply.into_inner().digest().to_owned()
}

/// Leases and commits until there is nothing to do; says how many pieces.
pub async fn work(channel: &Channel) -> usize {
    work_on(channel, false).await
}

/// The same; with `real`, retinas are the model's, and counts fit them.
pub async fn work_on(channel: &Channel, real: bool) -> usize {
    work_of(channel, real, CONES).await
}

/// The same with so many made-up cones.
pub async fn work_of(channel: &Channel, real: bool, cones: u64) -> usize {
    work_saying(channel, real, cones, None).await
}

/// The same; with each shard comes a report.
pub async fn work_saying(channel: &Channel, real: bool, mut cones: u64, report: Option<&str>) -> usize {
    let made = cones;
    let mut workers = WorkersClient::new(channel.clone());
    for count in 0.. {
        let request =
            v1::LeaseRequest { worker: Some("test".into()), wait_ms: Some(0), ..v1::LeaseRequest::default() };
        let lease = workers.lease(request).await.unwrap().into_inner();
        let done = match lease.work.as_ref().unwrap() {
            Work::Nothing(_) => return count,
            Work::Build(build) => {
                assert!(build.spec_json().starts_with('{'));
                let (bytes, held) = if real { built(channel, build).await } else { made_up(build, made) };
                if build.kind() == "cones" {
                    cones = held.unwrap_or(cones);
                }
                let digest = put(channel, bytes).await;
                v1::commit_request::Done::Artifact(v1::ArtifactResult { digest: Some(digest), cones: held })
            }
            Work::Shard(shard) => v1::commit_request::Done::Shard(counts(channel, shard, cones).await),
        };
        let is_shard = matches!(done, v1::commit_request::Done::Shard(_));
        let report_json = report.filter(|_| is_shard).map(str::to_owned);
        let request = v1::CommitRequest { id: lease.id, fence: lease.fence, done: Some(done), report_json };
        assert!(workers.commit(request).await.unwrap().into_inner().accepted());
    }
    unreachable!()
}

fn made_up(build: &v1::Build, cones: u64) -> (Vec<u8>, Option<u64>) {
    (build.key().as_bytes().to_vec(), (build.kind() == "cones").then_some(cones))
}

/// What the model builds; kernels are left out, nobody here counts.
async fn built(channel: &Channel, build: &v1::Build) -> (Vec<u8>, Option<u64>) {
    if build.kind() == "kernels" {
        return made_up(build, CONES);
    }
    let mut inputs = Vec::new();
    for input in &build.inputs {
        let request = v1::GetBlobRequest { digest: input.digest.clone() };
        let mut pieces = BlobsClient::new(channel.clone()).get(request).await.unwrap().into_inner();
        let mut bytes = Vec::new();
        while let Some(piece) = pieces.message().await.unwrap() {
            bytes.extend_from_slice(piece.bytes());
        }
        inputs.push((input.key().parse().unwrap(), bytes));
    }
    let spec: ArtifactSpec = serde_json::from_str(build.spec_json()).unwrap();
    let inputs: Vec<_> = inputs.iter().map(|(key, bytes): &(_, Vec<u8>)| (*key, bytes.as_slice())).collect();
    let built = spec.build(&inputs).unwrap();
    (built.bytes, built.cones)
}

/// Frame `f` counts f, f + 1, …; many cones get noise, which does not shrink when it is packed.
async fn counts(channel: &Channel, shard: &v1::Shard, cones: u64) -> v1::ShardResult {
    assert!(shard.experiment_json().contains("pupil_mm"));
    let mut chunks = Vec::new();
    for frame in shard.first_frame()..shard.first_frame() + shard.frame_count() {
        let noise =
            |i: u32| (frame + i).wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(0x9e37_79b1);
        let small = cones < 1000;
        let values: Vec<u32> = (0..cones as u32).map(|i| if small { frame + i } else { noise(i) }).collect();
        let bytes = counts_stream(frame, shard.tile(), shard.first_cone(), Counts::U32(&values)).unwrap();
        let sum = values.iter().map(|value| f64::from(*value)).sum();
        chunks.push(v1::CommittedChunk {
            frame: Some(frame),
            digest: Some(put(channel, bytes).await),
            sum: vec![sum, 0.0, 0.0],
            sum_squares: vec![0.0; 3],
            cones: vec![cones, 0, 0],
        });
    }
    v1::ShardResult { chunks }
}
