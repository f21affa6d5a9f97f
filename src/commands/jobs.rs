//! `jobs`: the jobs of a server, newest first; one that warns of its result is marked `!`.

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
            let mark = if job.warnings.is_empty() { ' ' } else { '!' };
            let warnings = job.warnings.iter().map(|warning| format!("warning: {warning}"));
            let said: Vec<String> = job.error.clone().into_iter().chain(warnings).collect();
            output::line(format_args!(
                "{}  {state:<9}{mark} {}/{} shards  {}",
                job.id(),
                progress.shards_done(),
                progress.shards_total(),
                said.join("; ")
            ))?;
        }
        match reply.next_page {
            Some(next) if !next.is_empty() && next != page => page = next,
            _ => return Ok(()),
        }
    }
}
