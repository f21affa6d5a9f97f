//! Who gets in and how far: keys, roles, tenants, limits, TLS; and binary messages that the schema does not know.

use std::net::SocketAddr;
use std::path::Path;

use crate::common::{Answer, get, http, post, spec, start, work};
use photoneye_proto::v1::experiments_client::ExperimentsClient;
use photoneye_proto::v1::workers_client::WorkersClient;
use photoneye_proto::{ApiKey, v1};
use photoneye_server::access::{Role, keys};
use photoneye_server::{Options, Server};
use serde_json::{Value, json};
use tonic::Code;
use tonic::transport::{Certificate, Channel, ClientTlsConfig};

async fn key(folder: &Path, tenant: &str, roles: &[Role]) -> (String, String) {
    keys::create(folder, tenant, roles, "test").await.unwrap()
}

async fn with(key: &str, address: SocketAddr, method: &str, path: &str, body: &Value) -> Answer {
    let bearer = format!("Bearer {key}");
    let body = if body.is_null() { Vec::new() } else { body.to_string().into_bytes() };
    http(address, method, path, &[("Authorization", &bearer), ("content-type", "application/json")], &body)
        .await
}

#[tokio::test]
async fn tenants_do_not_see_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let (_, a) = key(folder.path(), "lab-a", &[Role::Read, Role::Submit]).await;
    let (_, b) = key(folder.path(), "lab-b", &[Role::Read, Role::Submit]).await;
    let (_, admin) = key(folder.path(), "ops", &[Role::Admin]).await;
    let server = start(folder.path()).await;
    let address = server.local_addr();
    let created = with(&a, address, "POST", "/v1/jobs", &spec()).await;
    assert_eq!(created.status, 201, "{}", created.text());
    assert_eq!(created.json()["tenant"], "lab-a");
    let id = created.json()["id"].as_str().unwrap().to_owned();
    work(&server.channel()).await;

    for path in ["", "/events", "/results", "/counts.npy", "/report"] {
        let path = format!("/v1/jobs/{id}{path}");
        assert_eq!(with(&a, address, "GET", &path, &Value::Null).await.status, 200, "{path}");
        assert_eq!(with(&b, address, "GET", &path, &Value::Null).await.status, 404, "{path}");
        assert_eq!(get(address, &path).await.status, 401, "{path}");
    }
    assert_eq!(with(&b, address, "POST", &format!("/v1/jobs/{id}/cancel"), &Value::Null).await.status, 404);
    let count = |answer: Answer| answer.json()["jobs"].as_array().map_or(0, Vec::len);
    assert_eq!(count(with(&a, address, "GET", "/v1/jobs", &Value::Null).await), 1);
    assert_eq!(count(with(&b, address, "GET", "/v1/jobs", &Value::Null).await), 0);
    assert_eq!(count(with(&admin, address, "GET", "/v1/jobs", &Value::Null).await), 1);

    // A digest is not a capability: neither for reading nor in an experiment.
    let upload = with(&a, address, "PUT", "/v1/blobs", &json!("a picture of lab-a")).await;
    let digest = upload.json()["digest"].as_str().unwrap().to_owned();
    let path = format!("/v1/blobs/{digest}");
    assert_eq!(with(&a, address, "GET", &path, &Value::Null).await.status, 200);
    assert_eq!(with(&b, address, "GET", &path, &Value::Null).await.status, 404);
    let mut stolen = spec();
    stolen["video"] = json!({"clip": {"blobs": [digest]}});
    let refused = with(&b, address, "POST", "/v1/plans", &stolen).await;
    assert!(refused.status == 400 && refused.text().contains("upload it first"), "{}", refused.text());
    server.shutdown().await;
}

#[tokio::test]
async fn roles_hold_and_revoked_keys_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let (_, reader) = key(folder.path(), "a", &[Role::Read]).await;
    let (_, worker) = key(folder.path(), "a", &[Role::Worker]).await;
    let (id, gone) = key(folder.path(), "a", &[Role::Read]).await;
    let server = start(folder.path()).await;
    let address = server.local_addr();
    assert_eq!(with(&reader, address, "GET", "/v1/jobs", &Value::Null).await.status, 200);
    assert_eq!(with(&reader, address, "POST", "/v1/jobs", &spec()).await.status, 403);
    assert_eq!(with(&worker, address, "GET", "/v1/jobs", &Value::Null).await.status, 403);
    assert_eq!(with(&reader, address, "GET", "/metrics", &Value::Null).await.status, 200);
    let refused = get(address, "/v1/jobs").await;
    assert!(refused.status == 401 && refused.head.contains("www-authenticate: bearer"), "{}", refused.head);
    for open in ["/healthz", "/readyz", "/docs", "/openapi.json"] {
        assert_eq!(get(address, open).await.status, 200, "{open}");
    }
    // A key that differs in its last character.
    let wrong = format!("{}{}", &reader[..reader.len() - 1], if reader.ends_with('0') { '1' } else { '0' });
    assert_eq!(with(&wrong, address, "GET", "/v1/jobs", &Value::Null).await.status, 401);

    let channel = Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap();
    let lease =
        || v1::LeaseRequest { worker: Some("w".into()), wait_ms: Some(0), ..v1::LeaseRequest::default() };
    let code = |key: ApiKey| {
        let mut workers = WorkersClient::with_interceptor(channel.clone(), key);
        async move { workers.lease(lease()).await.err().map(|status| status.code()) }
    };
    assert_eq!(code(ApiKey::new(&worker).unwrap()).await, None);
    assert_eq!(code(ApiKey::new(&reader).unwrap()).await, Some(Code::PermissionDenied));
    assert_eq!(code(ApiKey::default()).await, Some(Code::Unauthenticated));

    assert_eq!(with(&gone, address, "GET", "/v1/jobs", &Value::Null).await.status, 200);
    keys::revoke(folder.path(), &id).await.unwrap();
    tokio::time::sleep(std::time::Duration::from_millis(1100)).await;
    assert_eq!(with(&gone, address, "GET", "/v1/jobs", &Value::Null).await.status, 401);
    // The secret is nowhere on the disk.
    for file in ["photoneye.db", "photoneye.db-wal"] {
        let bytes = std::fs::read(folder.path().join(file)).unwrap_or_default();
        assert!(!bytes.windows(64).any(|part| part == &reader.as_bytes()[reader.len() - 64..]), "{file}");
    }
    server.shutdown().await;
}

#[tokio::test]
async fn limits_are_said_with_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = Options::new(folder.path());
    options.listen.set_port(0);
    options.limits.tenant_jobs = 2;
    options.limits.job_chunks = 100;
    let server = Server::start(options).await.unwrap();
    let address = server.local_addr();
    let mut long = spec();
    long["frames"]["count"] = json!(101);
    let refused = post(address, "/v1/jobs", &long).await;
    assert!(refused.status == 413 && refused.text().contains("1.010e2"), "{}", refused.text());
    let keyed = [("Idempotency-Key", "k"), ("content-type", "application/json")];
    let text = spec().to_string();
    assert_eq!(http(address, "POST", "/v1/jobs", &keyed, text.as_bytes()).await.status, 201);
    assert_eq!(post(address, "/v1/jobs?priority=9", &spec()).await.json()["priority"], 9);
    assert_eq!(post(address, "/v1/jobs?priority=10", &spec()).await.status, 400);
    let busy = post(address, "/v1/jobs", &spec()).await;
    assert!(busy.status == 429 && busy.head.contains("retry-after: "), "{}", busy.head);
    // A repetition is answered all the same.
    assert_eq!(http(address, "POST", "/v1/jobs", &keyed, text.as_bytes()).await.status, 200);
    server.shutdown().await;

    // A tenant that has asked for more work than may be.
    let mut options = Options::new(tempfile::tempdir().unwrap().path());
    options.listen.set_port(0);
    (options.limits.burst_seconds, options.limits.rate) = (1e-6, 1e-5);
    let server = Server::start(options).await.unwrap();
    assert_eq!(post(server.local_addr(), "/v1/jobs", &spec()).await.status, 201);
    let busy = post(server.local_addr(), "/v1/jobs", &spec()).await;
    assert!(busy.status == 429 && !busy.head.contains("retry-after: 5\r"), "{}", busy.head);
    assert!(get(server.local_addr(), "/metrics").await.text().contains("photoneye_refused_jobs_total 1"));
    server.shutdown().await;
}

#[tokio::test]
async fn both_doors_speak_tls() {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tls");
    let folder = tempfile::tempdir().unwrap();
    let mut options = Options::new(folder.path());
    options.listen.set_port(0);
    options.tls = Some((place.join("cert.pem"), place.join("key.pem")));
    let server = Server::start(options.clone()).await.unwrap();
    let pem = std::fs::read(place.join("cert.pem")).unwrap();
    let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(pem)).domain_name("localhost");
    let url = format!("https://{}", server.local_addr());
    let channel = Channel::from_shared(url).unwrap().tls_config(tls).unwrap().connect().await.unwrap();
    let jobs = ExperimentsClient::new(channel).list_jobs(v1::ListJobsRequest::default()).await;
    assert!(jobs.unwrap().into_inner().jobs.is_empty());
    server.shutdown().await;
    options.tls = Some((place.join("key.pem"), place.join("key.pem")));
    let error = Server::start(options).await.unwrap_err().to_string();
    assert!(error.contains("key.pem: no certificate"), "{error}");
}

#[tokio::test]
async fn binary_messages_of_another_schema_are_refused() {
    use bytes::{Buf as _, BufMut as _, Bytes, BytesMut};
    use http_body_util::{BodyExt as _, Full};
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let mut channel = server.channel();
    // PlanRequest { experiment: { field 999: 1 } }
    let message = [0x0a, 3, 0xb8, 0x3e, 1];
    let mut frame = BytesMut::new();
    frame.put_u8(0);
    frame.put_u32(message.len() as u32);
    frame.extend_from_slice(&message);
    let body = tonic::body::Body::new(Full::new(Bytes::from(frame)));
    let request = ::http::Request::post("http://photoneye.local/photoneye.v1.Experiments/Plan");
    let request = request.header("content-type", "application/grpc").header("te", "trailers").body(body);
    let ready = tower::ServiceExt::ready(&mut channel).await.unwrap();
    let response = tower::Service::call(ready, request.unwrap()).await.unwrap();
    let header =
        |name: &str, map: &::http::HeaderMap| map.get(name).map(|value| value.to_str().unwrap().to_owned());
    let mut status = header("grpc-status", response.headers());
    let mut text = header("grpc-message", response.headers());
    let collected = response.into_body().collect().await.unwrap();
    if let Some(trailers) = collected.trailers() {
        status = status.or(header("grpc-status", trailers));
        text = text.or(header("grpc-message", trailers));
    }
    assert_eq!(status.as_deref(), Some("3"));
    assert!(text.as_deref().unwrap().contains("unknown%20field%20number%20999"), "{text:?}");
    assert_eq!(collected.aggregate().remaining(), 0);
    server.shutdown().await;
}
