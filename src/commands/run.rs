//! `run`: an experiment from file to result folder in one go.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use futures::StreamExt as _;
use photoneye_client::Client;
use photoneye_proto::v1;
use photoneye_proto::v1::job::State;

use super::{Context, interrupted};
use crate::cli::{PictureArgs, RunArgs};
use crate::experiment_file::ExperimentFile;
use crate::failure::Failure;
use crate::progress::Progress;
use crate::result_folder::{self, Draft};
use crate::service::Service;
use crate::{output, pictures, summary};

/// How long Ctrl-C waits for the server to take note.
const CANCEL_WAIT: Duration = Duration::from_secs(5);

/// Runs the command.
pub async fn run(context: Context, args: RunArgs) -> Result<(), Failure> {
    // Everything that can be wrong on this side is found before anything is started.
    let mut experiment = ExperimentFile::read(&args.spec.spec, &args.spec.set)?;
    let out = args.out.unwrap_or_else(|| PathBuf::from("out").join(&experiment.stem));
    let draft = Draft::new(&out)?;

    let mut stop = std::pin::pin!(interrupted());
    let mut place = args.place;
    place.workers = Some(context.settings.workers(place.workers).max(1));
    let service = Service::open(&context.settings, place).await?;
    let client = &service.client;
    let outcome = match Box::pin(submit(client, &mut experiment, context.json)).await {
        Ok((job, progress)) => tokio::select! {
            outcome = complete(client, job.id(), progress, draft, args.pictures, context.json) => outcome,
            () = &mut stop => Err(cancel(client, job.id()).await),
        },
        Err(failure) => Err(failure),
    };
    service.close(outcome.is_ok()).await;
    outcome
}

/// Uploads, explains and creates the job.
async fn submit(
    client: &Client,
    experiment: &mut ExperimentFile,
    quiet: bool,
) -> Result<(v1::Job, Progress), Failure> {
    experiment.upload(client).await?;
    let plan = client.plan(experiment.experiment.clone()).await;
    let plan = plan.map_err(|error| experiment.name_pictures(error.into()))?;
    let mut progress = Progress::new(quiet);
    if let Some(plan) = &plan.plan {
        progress.say(&forecast(plan));
    }
    let job = client.create_job(experiment.experiment.clone(), &request_id()).await?;
    Ok((job, progress))
}

async fn complete(
    client: &Client,
    id: &str,
    progress: Progress,
    draft: Draft,
    args: PictureArgs,
    json: bool,
) -> Result<(), Failure> {
    let job = follow(client, id, progress).await?;
    finish(client, &job, draft, args, json).await
}

/// Cancels after Ctrl-C.
async fn cancel(client: &Client, id: &str) -> Failure {
    match tokio::time::timeout(CANCEL_WAIT, client.cancel(id)).await {
        Ok(Ok(_)) => Failure::failed("interrupted, the job was cancelled"),
        Ok(Err(error)) => {
            Failure::failed(format!("interrupted, but the job {id} could not be cancelled: {error}"))
        }
        Err(_) => Failure::failed(format!("interrupted, but the job {id} could not be cancelled in time")),
    }
}

/// Shows a job's progress until it has succeeded.
///
/// # Errors
/// When it fails or is cancelled.
pub(super) async fn follow(client: &Client, id: &str, mut progress: Progress) -> Result<v1::Job, Failure> {
    let mut events = std::pin::pin!(client.watch(id, 0));
    while let Some(event) = events.next().await {
        if let Some(job) = event?.job {
            progress.show(&job);
        }
    }
    progress.finish();
    let job = client.job(id).await?;
    warn(&job);
    match job.state() {
        State::Succeeded => Ok(job),
        State::Failed => Err(Failure::failed(format!("the job failed: {}", job.error()))),
        State::Cancelled => Err(Failure::failed("the job was cancelled")),
        State::Queued | State::Running => Err(Failure::failed("the server stopped telling about the job")),
    }
}

/// Says on standard error what a job warns of.
fn warn(job: &v1::Job) {
    for warning in &job.warnings {
        output::note(format_args!("warning: {warning}"));
    }
}

/// Fetches the results, draws the pictures, puts the folder in its place and tells what came out.
pub(super) async fn finish(
    client: &Client,
    job: &v1::Job,
    draft: Draft,
    args: PictureArgs,
    json: bool,
) -> Result<(), Failure> {
    let report = result_folder::fetch(client, job, &draft).await?;
    let folder = draft.path().to_owned();
    let drawn = tokio::task::spawn_blocking(move || pictures::draw(&folder, args));
    let drawn = drawn.await.map_err(Failure::failed)??;
    let out = draft.publish()?;
    tell(&report, &out, drawn, json)
}

fn tell(report: &str, out: &Path, drawn: usize, json: bool) -> Result<(), Failure> {
    let report: serde_json::Value = serde_json::from_str(report).map_err(Failure::failed)?;
    if json {
        return output::json(&serde_json::json!({"out": out, "pictures": drawn, "report": report}));
    }
    output::line(format_args!("{}", summary::of_report(&report, out, drawn)))
}

fn forecast(plan: &v1::Plan) -> String {
    format!(
        "about {} cones, {} frame(s), {} artifact(s) to build or reuse, at most about {:.1} s of computing",
        summary::number(plan.predicted_cones()),
        plan.frames(),
        plan.artifacts.iter().filter(|artifact| !artifact.cached()).count(),
        plan.predicted_seconds()
    )
}

/// Every run is a job of its own.
pub(super) fn request_id() -> String {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    format!("cli-{}-{}", std::process::id(), now.as_nanos())
}
