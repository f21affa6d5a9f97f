//! `results`: waits for a job and fetches its results into a folder.

use super::Context;
use super::run::{finish, follow};
use crate::cli::ResultsArgs;
use crate::failure::Failure;
use crate::progress::Progress;
use crate::result_folder::Draft;
use crate::service::connect;

/// Runs the command.
pub async fn run(context: Context, args: ResultsArgs) -> Result<(), Failure> {
    let draft = Draft::new(&args.out)?;
    let client = connect(&context.settings.server_or_local(args.job.server.server)?).await?;
    let stop = super::interrupted();
    let work = async {
        let job = follow(&client, &args.job.id, Progress::new(context.json)).await?;
        finish(&client, &job, draft, args.pictures, context.json).await
    };
    tokio::select! {
        outcome = work => outcome,
        () = stop => Err(Failure::failed("interrupted; the job goes on")),
    }
}
