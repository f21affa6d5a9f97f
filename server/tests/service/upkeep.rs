//! What a server does to itself over time: old jobs and their blobs go, the clock may jump, and metrics tell.

use crate::common::{get, http, post, spec, start, work};
use photoneye_proto::v1;
use photoneye_proto::v1::workers_client::WorkersClient;
use photoneye_server::jobs::clock::Clock;
use photoneye_server::{Options, Server};
use photoneye_store::table::read_counts;
use photoneye_store::{BlobDigest, Blobs as _, FolderStore};

const HOUR_MS: u64 = 3_600_000;

fn options(folder: &std::path::Path) -> Options {
    let mut options = Options::new(folder);
    options.listen.set_port(0);
    options
}

#[tokio::test]
async fn only_the_latest_jobs_are_remembered() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut ids = Vec::new();
    for number in 0..4 {
        let key = [("Idempotency-Key", format!("key {number}"))];
        let headers = [(key[0].0, key[0].1.as_str()), ("content-type", "application/json")];
        let text = spec().to_string();
        let job = http(server.local_addr(), "POST", "/v1/jobs", &headers, text.as_bytes()).await.json();
        ids.push(job["id"].as_str().unwrap().to_owned());
        work(&server.channel()).await;
    }
    let counts = get(server.local_addr(), &format!("/v1/jobs/{}/counts.npy", ids[3])).await.body;
    server.shutdown().await;
    let mut options = options(folder.path());
    options.limits.kept_jobs = 2;
    let server = Server::start(options).await.unwrap();
    let status = async |id: &str| get(server.local_addr(), &format!("/v1/jobs/{id}")).await.status;
    for _ in 0..200 {
        if status(&ids[1]).await == 404 {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    assert_eq!((status(&ids[0]).await, status(&ids[1]).await), (404, 404));
    assert_eq!((status(&ids[2]).await, status(&ids[3]).await), (200, 200));
    // What was shared with those that are gone is still there.
    let job = get(server.local_addr(), &format!("/v1/jobs/{}", ids[3])).await.json();
    assert!(job["plan"]["artifacts"].is_array());
    assert!(get(server.local_addr(), &format!("/v1/jobs/{}/counts.npy", ids[3])).await.body == counts);
    assert_eq!(get(server.local_addr(), &format!("/v1/jobs/{}/report", ids[3])).await.status, 200);
    // The next job finds what was built.
    post(server.local_addr(), "/v1/jobs", &spec()).await;
    assert_eq!(work(&server.channel()).await, 1, "one shard");
    server.shutdown().await;
}

/// A worker holds a lease while the server is away and comes back with another idea of the time.
#[tokio::test]
async fn a_server_whose_clock_jumps_loses_and_doubles_nothing() {
    let now = Clock::new().now_ms();
    for later in [now - HOUR_MS, now + HOUR_MS] {
        let folder = tempfile::tempdir().unwrap();
        let server = start(folder.path()).await;
        let id =
            post(server.local_addr(), "/v1/jobs", &spec()).await.json()["id"].as_str().unwrap().to_owned();
        let address = server.local_addr();
        // Over TCP: a worker that does not die with the server.
        let connect = async |address| {
            let channel = tonic::transport::Channel::from_shared(format!("http://{address}")).unwrap();
            WorkersClient::new(channel.connect().await.unwrap())
        };
        let request = v1::LeaseRequest { worker: Some("far".into()), ..v1::LeaseRequest::default() };
        let lease = connect(address).await.lease(request).await.unwrap().into_inner();
        server.shutdown().await;

        let mut options = options(folder.path());
        options.clock = Clock::at(later);
        let server = Server::start(options).await.unwrap();
        // Time enough for the leases to be looked over.
        tokio::time::sleep(std::time::Duration::from_millis(1500)).await;
        let beat =
            v1::HeartbeatRequest { id: lease.id, fence: lease.fence, ..v1::HeartbeatRequest::default() };
        let mut workers = connect(server.local_addr()).await;
        let kept = workers.heartbeat(beat.clone()).await.unwrap().into_inner();
        assert!(kept.keep(), "the lease is still the worker's");
        let gone = v1::FailRequest {
            id: beat.id,
            fence: beat.fence,
            message: Some("m".into()),
            deterministic: None,
        };
        assert!(workers.fail(gone).await.unwrap().into_inner().accepted());
        work(&server.channel()).await;
        let job = get(server.local_addr(), &format!("/v1/jobs/{id}")).await.json();
        assert_eq!(job["state"], "SUCCEEDED");
        assert_eq!(job["progress"]["shards_done"], job["progress"]["shards_total"]);
        let report = get(server.local_addr(), &format!("/v1/jobs/{id}/report")).await.json();
        assert!(report["wall_seconds"].as_f64().unwrap() >= 0.0);
        server.shutdown().await;
    }
}

#[tokio::test]
async fn workers_tell_what_their_caches_were_good_for() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut workers = WorkersClient::new(server.channel());
    for (hits, misses) in [(3, 1), (4, 0)] {
        let request = v1::LeaseRequest {
            worker: Some("w".into()),
            cache_hits: Some(hits),
            cache_misses: Some(misses),
            ..v1::LeaseRequest::default()
        };
        workers.lease(request).await.unwrap();
    }
    let text = get(server.local_addr(), "/metrics").await.text();
    for line in ["photoneye_worker_cache_hits_total 7", "photoneye_worker_cache_misses_total 1"] {
        assert!(text.lines().any(|one| one == line), "{line}: {text}");
    }
    server.shutdown().await;
}

/// Jobs that are deleted take the results along that nothing else names; what is shared, uploaded or new stays.
#[tokio::test]
async fn blobs_that_only_deleted_jobs_named_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    http(server.local_addr(), "PUT", "/v1/blobs", &[], b"a picture").await;
    // The first three frames are the same in both.
    let mut long = spec();
    long["frames"]["count"] = 5.into();
    post(server.local_addr(), "/v1/jobs", &long).await;
    work(&server.channel()).await;
    let id = post(server.local_addr(), "/v1/jobs", &spec()).await.json()["id"].as_str().unwrap().to_owned();
    work(&server.channel()).await;
    let path = format!("/v1/jobs/{id}/counts.npy");
    let counts = get(server.local_addr(), &path).await.body;
    server.shutdown().await;

    let store = FolderStore::open(folder.path()).unwrap();
    // As a crash between rows and blobs leaves it, and a worker that never committed.
    store.put(b"named by nothing").unwrap();
    let before: Vec<(BlobDigest, Vec<u8>)> =
        store.list().into_iter().map(|digest| (digest, store.get(&digest).unwrap())).collect();
    let old = std::time::SystemTime::now() - std::time::Duration::from_hours(25);
    for (digest, _) in &before {
        std::fs::File::open(store.path(digest)).unwrap().set_modified(old).unwrap();
    }
    let new = store.put(b"on its way into a commit").unwrap();
    let mut options = options(folder.path());
    options.limits.kept_jobs = 1;
    let server = Server::start(options).await.unwrap();
    let gone = || before.iter().filter(|(digest, _)| !store.has(digest).unwrap()).collect::<Vec<_>>();
    for _ in 0..500 {
        if gone().len() >= 3 {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let frames: Vec<Option<u32>> =
        gone().iter().map(|(_, bytes)| read_counts(bytes).ok().map(|chunk| chunk.frame)).collect();
    let count = |frame| frames.iter().filter(|one| **one == frame).count();
    assert_eq!((frames.len(), count(Some(3)), count(Some(4)), count(None)), (3, 1, 1, 1), "{frames:?}");
    assert!(store.has(&new).unwrap() && store.has(&BlobDigest::of(b"a picture")).unwrap());
    assert!(get(server.local_addr(), &path).await.body == counts);
    // Deleted results are made again by whoever asks again.
    let id = post(server.local_addr(), "/v1/jobs", &long).await.json()["id"].as_str().unwrap().to_owned();
    work(&server.channel()).await;
    let job = get(server.local_addr(), &format!("/v1/jobs/{id}")).await.json();
    assert_eq!(job["state"], "SUCCEEDED");
    server.shutdown().await;
}
