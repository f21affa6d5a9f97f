//! Streams of results: resumed from any number, and slow readers that cost a chunk of memory, not the result.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use crate::common::{get, http, post, spec, start, work, work_of};
use photoneye_proto::v1;
use photoneye_proto::v1::experiments_client::ExperimentsClient;
use photoneye_store::BlobDigest;
use serde_json::json;
use tonic::transport::{Channel, Endpoint};

/// Nearly as many as a chunk may have.
const MANY_CONES: u64 = 260_000;
/// A chunk of them, bytes.
const CHUNK: u64 = 4 * MANY_CONES;
/// What a connection costs beside its chunk, at most: pieces on their way, an Arrow batch, buffers, bytes.
const BESIDE: u64 = 512 << 10;

/// Memory of this process, bytes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches("kB").trim().parse::<u64>().unwrap() * 1024
}

/// The same when the server has given back what is free, as it does soon after something happened and no work is leased.
async fn rested(server: &photoneye_server::Handle) -> u64 {
    let job = post(server.local_addr(), "/v1/jobs", &spec()).await.json();
    let path = format!("/v1/jobs/{}/cancel", job["id"].as_str().unwrap());
    assert_eq!(post(server.local_addr(), &path, &json!({})).await.status, 200);
    tokio::time::sleep(std::time::Duration::from_secs(4)).await;
    resident()
}

/// A job of so many frames that is done; its id.
async fn done(server: &photoneye_server::Handle, frames: u32, cones: u64) -> String {
    let mut spec = spec();
    spec["frames"]["count"] = json!(frames);
    let id = post(server.local_addr(), "/v1/jobs", &spec).await.json()["id"].as_str().unwrap().to_owned();
    work_of(&server.channel(), false, cones).await;
    id
}

fn endpoint(server: &photoneye_server::Handle) -> Endpoint {
    Channel::from_shared(format!("http://{}", server.local_addr())).unwrap()
}

#[tokio::test]
async fn a_stream_goes_on_from_any_number() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let id = done(&server, 9, 5).await;
    let mut client = ExperimentsClient::new(endpoint(&server).connect().await.unwrap());
    for from in [1, 2, 5, 9, 10, u64::MAX] {
        let request = v1::StreamResultsRequest { id: Some(id.clone()), from: Some(from) };
        let mut chunks = client.stream_results(request).await.unwrap().into_inner();
        let mut seen = Vec::new();
        while let Some(chunk) = chunks.message().await.unwrap() {
            seen.push(chunk.seq());
        }
        assert_eq!(seen, (from..=9).collect::<Vec<_>>());
    }
    let all = get(server.local_addr(), &format!("/v1/jobs/{id}/results?from=1")).await;
    let part = get(server.local_addr(), &format!("/v1/jobs/{id}/results?from=8")).await;
    assert!(all.status == 200 && part.status == 200 && part.body.len() < all.body.len());
    assert_eq!(work(&server.channel()).await, 0, "reading computes nothing");
    server.shutdown().await;
}

/// Other changes wait for their tenth of a second.
#[tokio::test]
async fn the_end_of_a_job_is_told_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut client = ExperimentsClient::new(server.channel());
    let mut delays = Vec::new();
    for _ in 0..5 {
        let job = post(server.local_addr(), "/v1/jobs", &spec()).await.json();
        let request = v1::WatchJobRequest { id: job["id"].as_str().map(str::to_owned), after: None };
        let mut events = client.watch_job(request).await.unwrap().into_inner();
        let mut last = events.message().await.unwrap().unwrap();
        work(&server.channel()).await;
        let ended = std::time::Instant::now();
        while let Some(event) = events.message().await.unwrap() {
            last = event;
        }
        delays.push(ended.elapsed());
        assert_eq!(last.job.unwrap().state(), v1::job::State::Succeeded);
    }
    assert!(delays.iter().min() < Some(&std::time::Duration::from_millis(50)), "{delays:?}");
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn twenty_stalled_readers_cost_a_chunk_each() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let id = done(&server, 60, MANY_CONES).await;
    let before = rested(&server).await;
    let mut stalled = Vec::new();
    for _ in 0..20 {
        let mut reader = TcpStream::connect(server.local_addr()).unwrap();
        write!(reader, "GET /v1/jobs/{id}/results?from=1 HTTP/1.1\r\nhost: test\r\n\r\n").unwrap();
        stalled.push(reader);
    }
    let most = 20 * (CHUNK + BESIDE);
    let grown = rested(&server).await.saturating_sub(before);
    println!("20 stalled readers: {:.1} MB", grown as f64 / 1e6);
    assert!(grown < most, "{grown} bytes for 20 stalled readers of 60 MB each");
    let (grpc, channels) = grpc_readers(&server, &id).await;
    let grown_more = rested(&server).await.saturating_sub(before + grown);
    println!("20 stalled gRPC readers: {:.1} MB with their own buffers", grown_more as f64 / 1e6);
    assert!(grown_more < most, "{grown_more} bytes for 20 stalled gRPC readers of 60 MB each");
    // Others are served meanwhile.
    assert_eq!(get(server.local_addr(), &format!("/v1/jobs/{id}")).await.status, 200);
    drop((stalled, grpc, channels));
    server.shutdown().await;
}

/// Twenty gRPC clients, each over its own connection, that take no chunk. Their windows are small: what they buffer themselves,
/// in this same process, counts for little.
async fn grpc_readers(
    server: &photoneye_server::Handle,
    id: &str,
) -> (Vec<tonic::Streaming<v1::ResultChunk>>, Vec<Channel>) {
    let (mut readers, mut channels) = (Vec::new(), Vec::new());
    for _ in 0..20 {
        let small =
            endpoint(server).initial_stream_window_size(65_535).initial_connection_window_size(65_535);
        let channel = small.connect().await.unwrap();
        let request = v1::StreamResultsRequest { id: Some(id.to_owned()), from: None };
        let stream = ExperimentsClient::new(channel.clone()).stream_results(request).await;
        readers.push(stream.unwrap().into_inner());
        channels.push(channel);
    }
    (readers, channels)
}

/// Over its size the store drops what was not read lately; uploads stay, and results are made again to the same bytes.
#[tokio::test]
async fn what_was_evicted_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let upload = http(server.local_addr(), "PUT", "/v1/blobs", &[], b"a picture").await.json();
    let id = done(&server, 3, 5).await;
    let path = format!("/v1/jobs/{id}/counts.npy");
    let before = get(server.local_addr(), &path).await.body;
    server.shutdown().await;

    let store = photoneye_store::FolderStore::open(folder.path()).unwrap();
    let old = std::time::SystemTime::now() - std::time::Duration::from_hours(1);
    for digest in store.list() {
        std::fs::File::open(store.path(&digest)).unwrap().set_modified(old).unwrap();
    }
    let mut options = photoneye_server::Options::new(folder.path());
    options.listen.set_port(0);
    options.store_max_bytes = Some(1);
    let server = photoneye_server::Server::start(options).await.unwrap();
    for _ in 0..200 {
        if store.list().len() == 1 {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let left: Vec<String> = store.list().iter().map(ToString::to_string).collect();
    assert_eq!(left, [upload["digest"].as_str().unwrap()]);
    let channel = server.channel();
    let working = tokio::spawn(async move {
        loop {
            work(&channel).await;
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }
    });
    assert!(get(server.local_addr(), &path).await.body == before);
    let metrics = get(server.local_addr(), "/metrics").await.text();
    assert!(metrics.contains("photoneye_nondeterministic_results 0"), "{metrics}");
    working.abort();
    server.shutdown().await;
}

/// A job of 156 MB.
async fn large(folder: &std::path::Path) -> (photoneye_server::Handle, String) {
    let server = start(folder).await;
    let id = done(&server, 150, MANY_CONES).await;
    (server, id)
}

/// A folder that needs no disk.
fn shared_memory() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Median and best of some rounds.
fn median_and_best(mut rates: Vec<f64>) -> String {
    rates.sort_by(f64::total_cmp);
    let (median, best) = (rates[rates.len() / 2], rates[rates.len() - 1]);
    format!("{median:.2} GB/s, best of {} {best:.2}", rates.len())
}

/// Times that a result is read.
const ROUNDS: usize = 25;

/// `cargo test --release -p photoneye-server --test service speed_over -- --ignored --nocapture --test-threads 1`
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "a measurement"]
async fn speed_over_grpc() {
    let folder = shared_memory();
    let (server, id) = large(folder.path()).await;
    let channel = endpoint(&server)
        .initial_stream_window_size(4 << 20)
        .initial_connection_window_size(16 << 20)
        .max_frame_size(1 << 20);
    let mut client =
        ExperimentsClient::new(channel.connect().await.unwrap()).max_decoding_message_size(16 << 20);
    let mut rates = Vec::new();
    for _ in 0..ROUNDS {
        let started = std::time::Instant::now();
        let mut bytes = 0;
        let request = v1::StreamResultsRequest { id: Some(id.clone()), from: None };
        let mut chunks = client.stream_results(request).await.unwrap().into_inner();
        while let Some(chunk) = chunks.message().await.unwrap() {
            bytes += chunk.bytes().len();
            assert_eq!(chunk.digest().parse(), Ok(BlobDigest::of(chunk.bytes())));
        }
        rates.push(bytes as f64 / 1e9 / started.elapsed().as_secs_f64());
    }
    println!("gRPC, verified on both sides: {}", median_and_best(rates));
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "a measurement"]
async fn speed_over_rest() {
    let folder = shared_memory();
    let (server, id) = large(folder.path()).await;
    let mut rates = Vec::new();
    for _ in 0..ROUNDS {
        let mut reader = TcpStream::connect(server.local_addr()).unwrap();
        write!(reader, "GET /v1/jobs/{id}/counts.npy HTTP/1.0\r\nhost: test\r\n\r\n").unwrap();
        let read = tokio::task::spawn_blocking(move || {
            let (mut place, mut bytes, started) = (vec![0; 256 << 10], 0, std::time::Instant::now());
            while let n @ 1.. = reader.read(&mut place).unwrap() {
                bytes += n;
            }
            assert!(bytes as u64 > 150 * CHUNK);
            bytes as f64 / 1e9 / started.elapsed().as_secs_f64()
        });
        rates.push(read.await.unwrap());
    }
    println!("REST counts.npy, verified by the server: {}", median_and_best(rates));
    server.shutdown().await;
}

/// `cargo test --release -p photoneye-server --test service submissions -- --ignored --nocapture`
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "a measurement"]
async fn speed_of_submissions_and_of_looking() {
    const EACH: usize = 125;
    const CALLERS: usize = 32;
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let server = start(folder.path()).await;
    let experiment = photoneye_proto::experiment_from_json(&spec().to_string()).unwrap();
    let channel = endpoint(&server).connect().await.unwrap();
    let create = |number: usize| {
        let mut client = ExperimentsClient::new(channel.clone());
        let (experiment, request_id) = (Some(experiment.clone()), Some(format!("key {number}")));
        async move {
            let request = v1::CreateJobRequest { experiment, request_id, priority: None };
            client.create_job(request).await.unwrap().into_inner().id.unwrap()
        }
    };
    let id = create(usize::MAX).await;
    let started = std::time::Instant::now();
    let callers: Vec<_> = (0..CALLERS)
        .map(|caller| {
            let jobs: Vec<_> = (0..EACH).map(|number| create(caller * EACH + number)).collect();
            tokio::spawn(async move {
                for job in jobs {
                    job.await;
                }
            })
        })
        .collect();
    let mut looks = Vec::new();
    let mut client = ExperimentsClient::new(channel.clone());
    while callers.iter().any(|caller| !caller.is_finished()) {
        let look = std::time::Instant::now();
        client.get_job(v1::JobRequest { id: Some(id.clone()) }).await.unwrap();
        looks.push(look.elapsed().as_secs_f64() * 1e3);
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    let rate = (CALLERS * EACH) as f64 / started.elapsed().as_secs_f64();
    looks.sort_by(f64::total_cmp);
    let at = |part: f64| looks[((looks.len() - 1) as f64 * part) as usize];
    println!(
        "{rate:.0} submissions per second; GET job p50 {:.1} ms, p99 {:.1} ms of {}",
        at(0.5),
        at(0.99),
        looks.len()
    );
    server.shutdown().await;
}
