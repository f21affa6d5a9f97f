//! Builds one artifact: fetch its inputs, run the model, hand the bytes to the server.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use photoneye_eye::artifact::{ArtifactSpec, BuildError, Built, Input, blob_key};
use photoneye_eye::digest::Digest;
use photoneye_eye::report::WorkReport;
use photoneye_proto::v1;
use photoneye_store::Mapped;

use crate::lease::{Done, Lease};
use crate::{Shared, WorkError, blocking, memory};

pub(crate) async fn run(shared: &Arc<Shared>, lease: &Lease, build: v1::Build) -> Result<Done, WorkError> {
    let spec = parse(&build)?;
    let stage = format!("build {}", spec.kind());
    lease.progress(0.0, &stage);

    // Fetch what it is made from.
    let mut inputs = Vec::with_capacity(build.inputs.len());
    for input in &build.inputs {
        let key: Digest = input.key().parse().map_err(WorkError::Passing)?;
        inputs.push((key, shared.cache.artifact(input).await?));
        lease.check()?;
    }

    if let Some(blob) = spec.blob() {
        let key = blob_key(blob).map_err(|error| WorkError::Model(error.to_string()))?;
        inputs.push((key, shared.cache.blob(blob).await?));
        lease.check()?;
    }

    // Build it.
    let cones_known = spec.kind() == "cones";
    let (started, cpu) = (Instant::now(), shared.cpu.begin());
    let built = blocking(move || build_artifact(&spec, &inputs)).await?;
    let (seconds, cpu_seconds) = (started.elapsed().as_secs_f64(), cpu.end());
    lease.check()?;

    // Hand it over; keep a copy, most artifacts are needed here next.
    let bytes = Bytes::from_owner(shared.cache.keep(built.bytes).await?);
    let digest = shared.remote.put(bytes).await?;
    Ok(Done {
        done: v1::commit_request::Done::Artifact(v1::ArtifactResult {
            digest: Some(digest.to_string()),
            cones: built.cones,
        }),
        report: WorkReport {
            seconds: BTreeMap::from([(stage.clone(), seconds)]),
            cpu_seconds: BTreeMap::from([(stage, cpu_seconds)]),
            peak_memory_bytes: memory::peak_bytes(),
            diagnostics: built.diagnostics.into_iter().collect(),
            cones: if cones_known { built.cones_by_type } else { [0; 3] },
            ..WorkReport::default()
        },
    })
}

/// Reads the inputs and holds them against the key: a worker of another version would build other bytes under it.
fn parse(build: &v1::Build) -> Result<ArtifactSpec, WorkError> {
    let spec: ArtifactSpec = serde_json::from_str(build.spec_json()).map_err(|error| {
        WorkError::Passing(format!("this worker cannot read the artifact's inputs: {error}"))
    })?;
    let key = spec.key().map_err(|error| WorkError::Model(error.to_string()))?;
    if key.to_string() == build.key() {
        Ok(spec)
    } else {
        Err(WorkError::Passing(format!(
            "server and worker differ in the version of `{}`: the server asks for {}, this worker would build {key}",
            spec.kind(),
            build.key()
        )))
    }
}

fn build_artifact(spec: &ArtifactSpec, inputs: &[(Digest, Mapped)]) -> Result<Built, WorkError> {
    let inputs: Vec<Input> = inputs.iter().map(|(key, bytes)| (*key, &**bytes)).collect();
    spec.build(&inputs).map_err(|error| match error {
        BuildError::Input(..) => WorkError::Passing(error.to_string()),
        BuildError::Model(message) => WorkError::Model(message),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_build_under_another_key_is_refused() {
        let spec = ArtifactSpec::Cones {
            tiles: vec![Digest([7; 32])],
            region: serde_json::from_str("{\"min\": [0.0, 0.0], \"max\": [1.0, 1.0]}").unwrap(),
        };
        let mut build = v1::Build {
            key: Some(spec.key().unwrap().to_string()),
            spec_json: serde_json::to_string(&spec).ok(),
            ..v1::Build::default()
        };
        assert_eq!(parse(&build).unwrap(), spec);
        // The same inputs under the key of others.
        build.key = Some(Digest([8; 32]).to_string());
        assert!(matches!(parse(&build), Err(WorkError::Passing(_))));
    }
}
