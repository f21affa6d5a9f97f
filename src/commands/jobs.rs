//! `jobs`: the jobs of a server, newest first.

use super::Context;
use crate::cli::ServerArgs;
use crate::failure::Failure;
use crate::output;
use crate::service::connect;

/// Runs the command.
pub async fn run(context: Context, args: ServerArgs) -> Result<(), Failure> {
    let client = connect(&context.settings.server_or_local(args.server)?).await?;
    let mut page = String::new();
    loop {
        let reply = client.jobs(&page).await?;
        for job in &reply.jobs {
            if context.json {
                output::json_line(job)?;
                continue;
            }
            let state = format!("{:?}", job.state()).to_lowercase();
            let progress = job.progress.clone().unwrap_or_default();
            output::line(format_args!(
                "{}  {state:<9}  {}/{} shards  {}",
                job.id(),
                progress.shards_done(),
                progress.shards_total(),
                job.error()
            ))?;
        }
        match reply.next_page {
            Some(next) if !next.is_empty() && next != page => page = next,
            _ => return Ok(()),
        }
    }
}
