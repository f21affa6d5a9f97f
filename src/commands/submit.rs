//! `submit`: hands an experiment to a server and prints the job's id.

use super::{Context, run::request_id};
use crate::cli::SubmitArgs;
use crate::experiment_file::ExperimentFile;
use crate::failure::Failure;
use crate::output;
use crate::service::connect;

/// Runs the command.
pub async fn run(context: Context, args: SubmitArgs) -> Result<(), Failure> {
    let mut experiment = ExperimentFile::read(&args.spec.spec, &args.spec.set)?;
    let client = connect(&context.settings.server_or_local(args.server.server)?).await?;
    experiment.upload(&client).await?;
    let key = args.request_id.unwrap_or_else(request_id);
    let job = client.create_job(experiment.experiment.clone(), &key).await;
    let job = job.map_err(|error| experiment.name_pictures(error.into()))?;
    if context.json { output::json(&job) } else { output::line(format_args!("{}", job.id())) }
}
