//! The command line of photoneye: reads what the user asks, starts or calls the service, and tells what came out.

mod chart;
mod cli;
mod cli_access;
mod cli_optics;
mod cli_study;
mod commands;
mod counts_file;
mod experiment_file;
mod failure;
mod output;
mod photon_list;
mod pictures;
mod profile;
mod progress;
mod result_folder;
mod service;
mod settings;
mod summary;

use std::process::ExitCode;

use clap::Parser as _;

use cli::Cli;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return failure::of_arguments(&error),
    };
    init_log(cli.verbose);
    match commands::run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

/// Logs go to standard error: warnings, with -v what happens, with -vv everything of ours. RUST_LOG overrides.
fn init_log(verbose: u8) {
    use tracing_subscriber::EnvFilter;
    let default = match verbose {
        0 => "warn",
        1 => "info",
        _ => "info,photoneye=debug,photoneye_server=debug,photoneye_worker=debug",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    if log.try_init().is_err() {
        // Somebody else listens already; then they get the log.
    }
}
