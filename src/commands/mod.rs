//! One file a command.

mod calibrate;
mod cancel;
mod displays;
mod doctor;
mod eyes;
mod jobs;
mod keys;
mod plan;
mod psf;
mod render;
mod results;
mod retina;
mod run;
mod serve;
mod study;
mod submit;
mod trace;
mod watch;
mod worker;

use std::future::Future;

use crate::cli::{Cli, Command};
use crate::failure::Failure;
use crate::settings::Settings;

/// What every command knows.
#[derive(Clone, Debug)]
pub struct Context {
    /// photoneye.toml.
    pub settings: Settings,
    /// Facts as JSON.
    pub json: bool,
}

/// Does what was asked.
///
/// # Errors
/// Why it could not be done.
pub fn run(cli: Cli) -> Result<(), Failure> {
    let mut settings = Settings::load(cli.config.as_deref())?;
    settings.api_key = cli.api_key.or(settings.api_key);
    settings.ca_cert = cli.ca_cert.or(settings.ca_cert);
    let context = Context { settings, json: cli.json };
    match cli.command {
        Command::Run(args) => block_on(run::run(context, args)),
        Command::Plan(args) => block_on(plan::run(context, args)),
        Command::Serve(args) => block_on(serve::run(context, args)),
        Command::Worker(args) => block_on(worker::run(context, args)),
        Command::Submit(args) => block_on(submit::run(context, args)),
        Command::Jobs(args) => block_on(jobs::run(context, args)),
        Command::Watch(args) => block_on(watch::run(context, args)),
        Command::Results(args) => block_on(results::run(context, args)),
        Command::Cancel(args) => block_on(cancel::run(context, args)),
        Command::Render(args) => render::run(&context, &args),
        Command::Calibrate(args) => calibrate::run(&context, &args),
        Command::Displays(args) => displays::run(&context, &args),
        Command::Retina(args) => retina::run(&context, &args),
        Command::Eyes => eyes::run(&context),
        Command::Psf(args) => psf::run(&context, &args),
        Command::Trace(args) => trace::run(&context, &args),
        Command::Keys(args) => block_on(keys::run(context, args)),
        Command::Doctor(args) => block_on(doctor::run(context, args)),
        Command::Study(args) => study::run(&context, &args),
    }
}

fn block_on(work: impl Future<Output = Result<(), Failure>>) -> Result<(), Failure> {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::failed)?;
    let outcome = runtime.block_on(work);
    // Work on blocking threads that nobody waits for any more must not hold up the end.
    runtime.shutdown_background();
    outcome
}

/// From now on, Ctrl-C and the system's wish to stop end the process no more; the future ends at the first of them.
pub fn interrupted() -> impl Future<Output = ()> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut signals = [SignalKind::interrupt(), SignalKind::terminate()].map(|kind| signal(kind).ok());
        std::future::poll_fn(move |context| {
            let mut came = signals.iter_mut().flatten().map(|signal| signal.poll_recv(context).is_ready());
            // Both are asked, so that both wake us.
            if came.by_ref().fold(false, |any, one| any | one) {
                std::task::Poll::Ready(())
            } else {
                std::task::Poll::Pending
            }
        })
    }
    #[cfg(not(unix))]
    async {
        let _ = tokio::signal::ctrl_c().await;
    }
}
