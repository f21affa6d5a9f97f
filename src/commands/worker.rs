//! `worker`: works for a server somewhere else; needs no open port.

use std::time::Duration;

use photoneye_worker::{Options, Worker};
use tokio_util::sync::CancellationToken;

use super::{Context, interrupted};
use crate::cli::WorkerArgs;
use crate::failure::Failure;
use crate::output;

/// Runs the command until it is interrupted or has been idle for long enough.
pub async fn run(context: Context, args: WorkerArgs) -> Result<(), Failure> {
    let settings = context.settings;
    let place = settings.server(args.server)?.ok_or_else(|| {
        Failure::usage("which server? Give --server http://host:port or set PHOTONEYE_SERVER")
    })?;
    let cache = args.cache.or_else(|| settings.cache.clone());
    let idle_exit = args.idle_exit.or(settings.idle_exit);
    let idle_exit = idle_exit.map(Duration::try_from_secs_f64).transpose();
    let options = Options {
        cache_dir: cache.map_or_else(|| settings.data(None).map(|data| data.join("cache")), Ok)?,
        cache_max_bytes: settings.cache_max(args.cache_max)?,
        idle_exit: idle_exit.map_err(|_| Failure::usage("--idle-exit is not a number of seconds"))?,
        name: args.name.unwrap_or_else(default_name),
        leases: settings.workers(args.workers).max(1),
        api_key: place.access.api_key.clone(),
    };
    let stop = interrupted();
    let channel = photoneye_client::channel(&place.url, &place.access)?;
    let url = &place.url;
    output::note(format_args!("working for {url}, local copies in {}", options.cache_dir.display()));
    let worker = Worker::new(channel, options).map_err(Failure::failed)?;
    let shutdown = CancellationToken::new();
    let mut work = tokio::spawn(worker.run(shutdown.clone()));
    tokio::select! {
        ended = &mut work => return ended.map_err(Failure::failed),
        () = stop => shutdown.cancel(),
    }
    output::note(format_args!("finishing what was begun; interrupt again to leave it"));
    tokio::select! {
        ended = work => ended.map_err(Failure::failed),
        () = interrupted() => Ok(()),
    }
}

/// Host and process.
fn default_name() -> String {
    let host = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let host = host.split_whitespace().next().unwrap_or("worker").to_owned();
    format!("{host}-{}", std::process::id())
}
