//! `cancel`: cancels a job; one that has ended stays as it is.

use super::Context;
use crate::cli::JobArgs;
use crate::failure::Failure;
use crate::output;
use crate::service::connect;

/// Runs the command.
pub async fn run(context: Context, args: JobArgs) -> Result<(), Failure> {
    let client = connect(&context.settings.server_or_local(args.server.server)?).await?;
    let job = client.cancel(&args.id).await?;
    if context.json {
        return output::json(&job);
    }
    output::line(format_args!("{} {}", job.id(), format!("{:?}", job.state()).to_lowercase()))
}
