//! What a job warns of is seen at both doors, in lists, events, the report and pictures, and after a restart.

use std::net::SocketAddr;

use photoneye_proto::v1;
use photoneye_proto::v1::experiments_client::ExperimentsClient;
use photoneye_server::Handle;
use serde_json::{Value, json};

use crate::common::{CONES, get, post, spec, start, work_on, work_saying};

const SAID: &str = "accuracy: 6 cones computed again show a relative error of 2.0e-2 (at least 2.0e-2 with 95 % confidence), \
                    above accuracy.target 0.001";

/// A worker's report with six cones that are off by 2 %.
fn report() -> String {
    let sample = |cone: u64| json!({"frame": 0, "tile": 0, "cone": cone, "value": 10.2, "reference": 10.0, "probability": 0.1, "total": 100.0});
    let report = json!({
        "seconds": {}, "peak_memory_bytes": 0, "diagnostics": {}, "counted": [0.0, 0.0, 0.0],
        "budget": photoneye_eye::report::PhotonBudget::default(),
        "audit": (0..6).map(sample).collect::<Vec<_>>(),
    });
    report.to_string()
}

fn aimed() -> Value {
    let mut spec = spec();
    spec["accuracy"] = json!({"target": 0.001});
    spec
}

/// Everything that can be asked after the job has ended says it.
async fn is_said(server: &Handle, id: &str) {
    let address: SocketAddr = server.local_addr();
    let job = get(address, &format!("/v1/jobs/{id}")).await.json();
    assert_eq!((&job["state"], &job["warnings"]), (&json!("SUCCEEDED"), &json!([SAID])));
    assert_eq!(get(address, "/v1/jobs").await.json()["jobs"][0]["warnings"], json!([SAID]));
    let events = get(address, &format!("/v1/jobs/{id}/events")).await;
    assert!(events.head.contains("x-accel-buffering: no"), "{}", events.head);
    let events = events.text();
    assert!(events.contains(SAID), "{events}");
    let report = get(address, &format!("/v1/jobs/{id}/report")).await.json();
    assert_eq!(report["warnings"], json!([SAID]));
    let lower = report["audit"]["lower_bound_95"].as_f64().unwrap();
    assert!((lower - 0.02).abs() < 1e-9, "{lower}");
    let picture = get(address, &format!("/v1/jobs/{id}/frames/0.png?side=16")).await;
    assert_eq!(picture.status, 200, "{}", picture.text());
    assert!(picture.text().contains("iTXtWarning\0") && picture.text().contains(SAID));

    let mut client = ExperimentsClient::new(server.channel());
    let request = || v1::JobRequest { id: Some(id.to_owned()) };
    assert_eq!(client.get_job(request()).await.unwrap().into_inner().warnings, [SAID]);
    let list = client.list_jobs(v1::ListJobsRequest::default()).await.unwrap().into_inner();
    assert_eq!(list.jobs[0].warnings, [SAID]);
    let report = client.get_report(request()).await.unwrap().into_inner();
    assert_eq!(report.audit.unwrap().lower_bound_95, Some(lower));
}

#[tokio::test]
async fn a_missed_target_is_said_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let created = post(server.local_addr(), "/v1/jobs", &aimed()).await.json();
    let id = created["id"].as_str().unwrap_or_else(|| panic!("{created}")).to_owned();
    let request = v1::WatchJobRequest { id: Some(id.clone()), after: None };
    let mut events = ExperimentsClient::new(server.channel()).watch_job(request).await.unwrap().into_inner();
    work_saying(&server.channel(), true, CONES, Some(&report())).await;
    let mut last = v1::Job::default();
    while let Some(event) = events.message().await.unwrap() {
        assert!(last.warnings.is_empty(), "said before the end");
        last = event.job.unwrap();
    }
    assert_eq!((last.state(), last.warnings), (v1::job::State::Succeeded, vec![SAID.to_owned()]));
    is_said(&server, &id).await;
    let schema = get(server.local_addr(), "/openapi.json").await.text();
    assert!(schema.contains("\"warnings\"") && schema.contains("\"lower_bound_95\""));
    server.shutdown().await;
    let server = start(folder.path()).await;
    is_said(&server, &id).await;
    server.shutdown().await;
}

#[tokio::test]
async fn a_job_without_audit_warns_of_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path()).await;
    let created = post(server.local_addr(), "/v1/jobs", &aimed()).await.json();
    let id = created["id"].as_str().unwrap_or_else(|| panic!("{created}")).to_owned();
    work_on(&server.channel(), true).await;
    let job = get(server.local_addr(), &format!("/v1/jobs/{id}")).await.json();
    assert!(job["state"] == "SUCCEEDED" && job["warnings"].as_array().is_none_or(Vec::is_empty), "{job}");
    let report = get(server.local_addr(), &format!("/v1/jobs/{id}/report")).await.json();
    assert_eq!(report["warnings"], json!([]));
    let picture = get(server.local_addr(), &format!("/v1/jobs/{id}/frames/0.png?side=16")).await;
    assert!(picture.status == 200 && !picture.text().contains("Warning"));
    server.shutdown().await;
}
