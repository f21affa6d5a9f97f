//! `cancel`: cancels a job; one that has ended stays as it is.

use photoneye_client::Client;

use super::Context;
use crate::cli::JobArgs;
use crate::failure::Failure;
use crate::output;

/// Runs the command.
pub async fn run(context: Context, args: JobArgs) -> Result<(), Failure> {
    let client = Client::connect(&context.settings.server_or_local(args.server.server))?;
    let job = client.cancel(&args.id).await?;
    if context.json {
        return output::json(&job);
    }
    output::line(format_args!(
        "{} {}",
        job.id(),
        format!("{:?}", job.state()).to_lowercase()
    ))
}
