//! Both doors over real sockets: a job from its submission to its results, errors, uploads, restarts.

use crate::common::{CONES, get, http, post, spec, start, work, work_on};
use photoneye_proto::v1;
use photoneye_proto::v1::experiments_client::ExperimentsClient;
use photoneye_server::{Options, Server, StartError};
use photoneye_store::BlobDigest;
use photoneye_store::table::{CountsVec, read_counts};
use serde_json::json;
use tonic::transport::Channel;

#[tokio::test]
async fn a_job_runs_and_survives_a_restart_and_damage() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let address = server.local_addr();
    let created = post(address, "/v1/jobs", &spec()).await;
    assert_eq!(created.status, 201, "{}", created.text());
    let id = created.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(created.json()["state"], "QUEUED");
    assert!(created.json()["plan"]["predicted_seconds"].is_number());
    let early = get(address, &format!("/v1/jobs/{id}/counts.npy")).await;
    assert_eq!((early.status, early.json()["status"].as_u64()), (409, Some(409)));

    // A restart in the middle loses nothing.
    server.shutdown().await;
    let server = start(folder.path()).await;
    let address = server.local_addr();
    assert!(work(&server.channel()).await > 2);
    let job = get(address, &format!("/v1/jobs/{id}")).await.json();
    assert_eq!((&job["state"], &job["cones"]), (&json!("SUCCEEDED"), &json!(CONES.to_string())));
    let digest = job["result_digest"].clone();

    let npy = get(address, &format!("/v1/jobs/{id}/counts.npy")).await;
    assert!(String::from_utf8_lossy(&npy.body).contains("'shape': (3, 5)"));
    let values: Vec<u32> =
        npy.body[128..].chunks(4).map(|v| u32::from_le_bytes(v.try_into().unwrap())).collect();
    assert_eq!(values, [0, 1, 2, 3, 4, 1, 2, 3, 4, 5, 2, 3, 4, 5, 6]);
    let arrow = get(address, &format!("/v1/jobs/{id}/results?from=1")).await;
    assert!(arrow.head.contains("application/vnd.apache.arrow.stream") && arrow.body.len() > 500);
    let report = get(address, &format!("/v1/jobs/{id}/report")).await.json();
    assert_eq!(report["digests"]["result"], digest);
    assert!((report["frames"][1]["types"]["l"]["mean"].as_f64().unwrap() - 3.0).abs() < 1e-12);
    assert_eq!(report["resolved"]["frames"], 3);

    // A damaged chunk is found when it is read, computed again, and then delivered.
    damage_one_chunk(folder.path());
    let channel = server.channel();
    let working = tokio::spawn(async move {
        while work(&channel).await == 0 {
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }
    });
    let again = get(address, &format!("/v1/jobs/{id}/counts.npy")).await;
    assert_eq!(again.body, npy.body);
    working.await.unwrap();
    let job = get(address, &format!("/v1/jobs/{id}")).await.json();
    assert_eq!((&job["state"], &job["result_digest"]), (&json!("SUCCEEDED"), &digest));
    server.shutdown().await;
}

/// Flips a byte in a blob that holds counts.
fn damage_one_chunk(folder: &std::path::Path) {
    for shelf in std::fs::read_dir(folder.join("blobs")).unwrap() {
        for blob in std::fs::read_dir(shelf.unwrap().path()).unwrap() {
            let path = blob.unwrap().path();
            let mut bytes = std::fs::read(&path).unwrap();
            if read_counts(&bytes).is_ok() {
                bytes[10] ^= 1;
                std::fs::write(&path, bytes).unwrap();
                return;
            }
        }
    }
    panic!("no counts in the store");
}

#[tokio::test]
async fn grpc_streams_what_rest_created() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let id = post(server.local_addr(), "/v1/jobs", &spec()).await.json()["id"].as_str().unwrap().to_owned();
    // Over TCP like any client from outside.
    let channel =
        Channel::from_shared(format!("http://{}", server.local_addr())).unwrap().connect().await.unwrap();
    let mut client = ExperimentsClient::new(channel.clone());
    let request = v1::StreamResultsRequest { id: Some(id.clone()), from: None };
    let mut chunks = client.stream_results(request).await.unwrap().into_inner();
    let request = v1::WatchJobRequest { id: Some(id.clone()), after: None };
    let mut events = client.watch_job(request).await.unwrap().into_inner();
    work(&channel).await;
    let mut seen = Vec::new();
    while let Some(chunk) = chunks.message().await.unwrap() {
        seen.push(chunk.seq());
        assert_eq!(chunk.digest().parse(), Ok(BlobDigest::of(chunk.bytes())));
        let counts = read_counts(chunk.bytes()).unwrap();
        assert_eq!(counts.counts.len(), CONES as usize);
        assert!(matches!(counts.counts, CountsVec::U32(values) if values[0] == chunk.frame()));
    }
    assert_eq!(seen, [1, 2, 3]);
    let mut last = None;
    while let Some(event) = events.message().await.unwrap() {
        assert!(last.as_ref().is_none_or(|last: &v1::JobEvent| last.seq() < event.seq()));
        last = Some(event);
    }
    assert_eq!(last.unwrap().job.unwrap().state(), v1::job::State::Succeeded);
    let sse =
        http(server.local_addr(), "GET", &format!("/v1/jobs/{id}/events"), &[("Last-Event-ID", "1")], b"")
            .await;
    assert!(sse.text().contains("id: ") && sse.text().contains("\"SUCCEEDED\""), "{}", sse.text());
    server.shutdown().await;
}

#[tokio::test]
async fn both_doors_give_the_same_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut client = ExperimentsClient::new(server.channel());
    let mut with = vec![spec()];
    for (part, value) in [
        ("eye", json!({"pupil_mm": 99})),
        ("eye", json!({"preset": "cat"})),
        ("retina", json!({"cell_walls": "AVERAGING"})),
        ("video", json!({"clip": {"blobs": [BlobDigest::of(b"absent").to_string()]}})),
        ("display", json!({"preset": "lcos-3chip", "distance_cm": -0.0})),
        ("gaze", json!({"center_px": [1, 2, 3]})),
        ("frames", json!({"count": 0})),
    ] {
        let mut spec = spec();
        spec[part] = value;
        with.push(spec);
    }
    for spec in with {
        let message = photoneye_proto::experiment_from_json(&spec.to_string()).unwrap();
        let rest = post(server.local_addr(), "/v1/plans", &spec).await;
        let grpc = client.plan(v1::PlanRequest { experiment: Some(message) }).await;
        match grpc {
            Ok(reply) => {
                assert_eq!(rest.status, 200);
                let rest: v1::PlanReply = photoneye_proto::from_json(&rest.text()).unwrap();
                assert_eq!(rest, reply.into_inner());
            }
            Err(status) => {
                let problem = rest.json();
                assert_eq!((rest.status, status.code()), (400, tonic::Code::InvalidArgument), "{spec}");
                let field = problem["field"].as_str().unwrap();
                assert_eq!(format!("{field}: {}", problem["detail"].as_str().unwrap()), status.message());
            }
        }
    }
    server.shutdown().await;
}

#[tokio::test]
async fn a_repeated_request_is_one_job() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let key = [("Idempotency-Key", "k1"), ("content-type", "application/json")];
    let text = spec().to_string();
    let first = http(server.local_addr(), "POST", "/v1/jobs", &key, text.as_bytes()).await;
    let again = http(server.local_addr(), "POST", "/v1/jobs", &key, text.as_bytes()).await;
    assert_eq!((first.status, again.status), (201, 200));
    assert_eq!(first.json()["id"], again.json()["id"]);
    let other = text.replace("\"count\":3", "\"count\":4");
    let refused = http(server.local_addr(), "POST", "/v1/jobs", &key, other.as_bytes()).await;
    assert_eq!(refused.status, 422);
    let list = get(server.local_addr(), "/v1/jobs?page_size=5").await.json();
    assert_eq!(list["jobs"].as_array().unwrap().len(), 1);
    // The form that MATLAB and Octave send.
    let form = [("content-type", "application/x-www-form-urlencoded")];
    let encoded = text.bytes().map(|byte| format!("%{byte:02X}")).collect::<Vec<_>>().concat();
    // Longer than any address line may be.
    let body = format!("spec={encoded}{}", "+".repeat(200_000));
    let sent = http(server.local_addr(), "POST", "/v1/jobs", &form, body.as_bytes()).await;
    assert_eq!(sent.status, 201, "{}", sent.text());
    let id = sent.json()["id"].as_str().unwrap().to_owned();
    let cancelled = http(server.local_addr(), "POST", &format!("/v1/jobs/{id}/cancel"), &[], b"").await;
    assert_eq!(cancelled.json()["state"], "CANCELLED");
    server.shutdown().await;
}

#[tokio::test]
async fn blobs_go_in_and_out() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let address = server.local_addr();
    let bytes: Vec<u8> = (0..700_000_u32).map(|i| (i % 251) as u8).collect();
    let put = http(address, "PUT", "/v1/blobs", &[], &bytes).await;
    assert_eq!(put.status, 201);
    let digest = put.json()["digest"].as_str().unwrap().to_owned();
    assert_eq!(digest.parse(), Ok(BlobDigest::of(&bytes)));
    assert_eq!(get(address, &format!("/v1/blobs/{digest}")).await.body, bytes);
    let head = http(address, "HEAD", &format!("/v1/blobs/{digest}"), &[], b"").await;
    assert!(head.status == 200 && head.head.contains("content-length: 700000") && head.body.is_empty());
    let absent = format!("/v1/blobs/{}", BlobDigest::of(b"absent"));
    assert_eq!(get(address, &absent).await.status, 404);
    assert_eq!(http(address, "HEAD", &absent, &[], b"").await.status, 404);
    assert_eq!(get(address, "/v1/blobs/nonsense").await.status, 400);
    let long = [("content-length", "99999999999999")];
    assert_eq!(http(address, "PUT", "/v1/blobs", &long, b"").await.status, 413);
    server.shutdown().await;
}

#[tokio::test]
async fn every_other_path_answers() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let address = server.local_addr();
    for path in [
        "/v1/displays",
        "/v1/eyes",
        "/v1/spectra",
        "/v1/retinas",
        "/healthz",
        "/readyz",
        "/metrics",
        "/openapi.json",
        "/docs",
        "/v1/jobs",
    ] {
        let answer = get(address, path).await;
        assert_eq!(answer.status, 200, "{path}: {}", answer.text());
    }
    assert!(get(address, "/v1/spectra").await.text().contains("projector-uhp/red"));
    assert!(get(address, "/metrics").await.text().contains("photoneye_jobs{state=\"queued\"} 0"));
    for (method, path, status) in [
        ("GET", "/v1/nothing", 404),
        ("GET", "/v1/jobs/j0", 404),
        ("DELETE", "/v1/jobs", 405),
        ("POST", "/v1/jobs", 400),
        ("GET", "/v1/jobs?page_size=0", 400),
        ("GET", "/v1/jobs?page=1&page=2", 400),
        ("GET", "/v1/jobs/%ff/report", 400),
        ("GET", "/v1/jobs/j0/frames/x", 404),
        ("GET", "/v1/jobs/j0/results?from=x", 400),
    ] {
        let answer = http(address, method, path, &[], b"").await;
        assert_eq!(answer.status, status, "{path}: {}", answer.text());
        assert!(answer.head.contains("application/problem+json"), "{path}");
        assert_eq!(answer.json()["status"], status, "{path}");
    }
    // A compressed body is named, for uploads too: they would be kept as they came.
    for (method, path) in [("POST", "/v1/plans"), ("POST", "/v1/jobs"), ("PUT", "/v1/blobs")] {
        let answer = http(address, method, path, &[("content-encoding", "gzip")], b"\x1f\x8b").await;
        assert_eq!(answer.status, 415, "{path}: {}", answer.text());
        assert!(answer.text().contains("Content-Encoding `gzip`"), "{}", answer.text());
    }
    let large = vec![b' '; (1 << 20) + 1];
    assert_eq!(http(address, "POST", "/v1/jobs", &[], &large).await.status, 413);
    server.shutdown().await;
}

#[tokio::test]
async fn what_prevents_a_start_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut options = Options::new(tempfile::tempdir().unwrap().path());
    options.listen = server.local_addr();
    let taken = Server::start(options.clone()).await.unwrap_err().to_string();
    assert!(taken.starts_with(&format!("cannot listen on {}", server.local_addr())), "{taken}");
    options.listen = ([0, 0, 0, 0], 0).into();
    assert!(matches!(Server::start(options.clone()).await, Err(StartError::Open(_))));
    options.listen = ([127, 0, 0, 1], 0).into();
    options.data_dir = folder.path().to_owned();
    assert!(matches!(Server::start(options.clone()).await, Err(StartError::InUse(_))));
    options.data_dir = "/proc/photoneye".into();
    let unwritable = Server::start(options).await.unwrap_err().to_string();
    assert!(unwritable.contains("/proc/photoneye"), "{unwritable}");
    server.shutdown().await;
}

#[tokio::test]
async fn cones_and_pictures_come_from_the_retina() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let address = server.local_addr();
    let id = post(address, "/v1/jobs", &spec()).await.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(get(address, &format!("/v1/jobs/{id}/cones.arrow")).await.status, 409);
    work_on(&server.channel(), true).await;
    let job = get(address, &format!("/v1/jobs/{id}")).await.json();
    let file = get(address, &format!("/v1/jobs/{id}/cones.arrow")).await;
    assert_eq!(file.status, 200, "{}", file.text());
    let cones = photoneye_store::table::read_cones_file(&file.body).unwrap();
    assert_eq!(job["cones"], json!(cones.len().to_string()));
    let (x, y) = (cones.x_um[0] as f32, cones.y_um[0] as f32);
    let corner = cones.polygon_of(0);
    assert!((corner[0] - x).hypot(corner[1] - y) < 10.0, "a polygon lies around its cone");
    let mut pieces = ExperimentsClient::new(server.channel())
        .get_cones(v1::JobRequest { id: Some(id.clone()) })
        .await
        .unwrap()
        .into_inner();
    let mut streamed = Vec::new();
    while let Some(piece) = pieces.message().await.unwrap() {
        streamed.extend_from_slice(piece.bytes());
    }
    assert_eq!(streamed, file.body);
    let picture = get(address, &format!("/v1/jobs/{id}/frames/2.png?side=64")).await;
    assert_eq!(picture.status, 200, "{}", picture.text());
    let size =
        photoneye_eye::video::png_size(&picture.body, photoneye_eye::video::Limits::default()).unwrap();
    assert_eq!(size.0.max(size.1), 64);
    assert_eq!(get(address, &format!("/v1/jobs/{id}/frames/3.png")).await.status, 404);
    assert_eq!(get(address, &format!("/v1/jobs/{id}/frames/0.png?side=0")).await.status, 400);
    server.shutdown().await;
}
