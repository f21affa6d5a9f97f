//! `watch`: follows a job until it ends; fails when the job does.

use futures::StreamExt as _;

use super::{Context, run::follow};
use crate::cli::JobArgs;
use crate::failure::Failure;
use crate::output;
use crate::progress::Progress;
use crate::service::connect;

/// Runs the command.
pub async fn run(context: Context, args: JobArgs) -> Result<(), Failure> {
    let client = connect(&context.settings.server_or_local(args.server.server)?).await?;
    if context.json {
        let mut events = std::pin::pin!(client.watch(&args.id, 0));
        while let Some(event) = events.next().await {
            output::json_line(&event?)?;
        }
    }
    let job = follow(&client, &args.id, Progress::new(context.json)).await?;
    if context.json {
        return Ok(());
    }
    output::line(format_args!("{} succeeded, result {}", job.id(), job.result_digest()))
}
