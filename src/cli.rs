//! What can be typed. Every option is also a PHOTONEYE_ variable and, where it makes sense, a line of photoneye.toml:
//! flag > variable > file > default.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::cli_access::{DoctorArgs, KeysArgs};
use crate::cli_optics::{PsfArgs, RetinaArgs, TraceArgs};
use crate::cli_study::{CalibrateArgs, StudyArgs};

/// Photon-accurate simulation of the human eye looking at a display.
///
/// `photoneye run data/experiments/face.json` does everything in one process and leaves a folder with counts and pictures.
#[derive(Debug, Parser)]
#[command(name = "photoneye", version, propagate_version = true, max_term_width = 110)]
pub struct Cli {
    /// Facts as JSON instead of text
    #[arg(long, global = true, env = "PHOTONEYE_JSON")]
    pub json: bool,
    /// Settings file [default: photoneye.toml here, else in the user's configuration folder]
    #[arg(long, global = true, env = "PHOTONEYE_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// API key to show to the server (see `photoneye keys`)
    #[arg(long, global = true, env = "PHOTONEYE_API_KEY", value_name = "KEY", hide_env_values = true)]
    pub api_key: Option<String>,
    /// Certificates (PEM) to trust for https beside those of the system
    #[arg(long, global = true, env = "PHOTONEYE_CA_CERT", value_name = "FILE")]
    pub ca_cert: Option<PathBuf>,
    /// Say more: -v what happens, -vv everything
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run an experiment and fetch its results
    Run(RunArgs),
    /// Explain an experiment: what is computed, what is left out and why, predicted time and memory
    Plan(PlanArgs),
    /// Serve REST and gRPC on one port, with workers in the same process
    Serve(ServeArgs),
    /// Work for a server somewhere else
    Worker(WorkerArgs),
    /// Hand an experiment to a server; prints the job's id
    Submit(SubmitArgs),
    /// List the jobs of a server, newest first
    Jobs(ServerArgs),
    /// Follow a job until it ends
    Watch(JobArgs),
    /// Fetch the results of a job
    Results(ResultsArgs),
    /// Cancel a job
    Cancel(JobArgs),
    /// Draw the pictures of a result folder again
    Render(RenderArgs),
    /// Measure how fast this machine is and keep it in the data folder, so that predicted times are its own
    Calibrate(CalibrateArgs),
    /// List the displays, show one, or import one of ColorVideoVDP
    Displays(DisplaysArgs),
    /// Grow the cones out to an eccentricity; prints figures of the mosaic
    Retina(RetinaArgs),
    /// List the model eyes
    Eyes,
    /// Compute one point spread of the eye
    Psf(PsfArgs),
    /// Trace given rays through the unaccommodated eye
    Trace(TraceArgs),
    /// Make, list and revoke the API keys of a server's data folder
    Keys(KeysArgs),
    /// Look over data folder, database, blobs, disk, clock, port and server; say what to do
    Doctor(DoctorArgs),
    /// Measure what the model does and what it costs; leaves tables, charts and a page
    Study(StudyArgs),
}

/// An experiment file with changes.
#[derive(Debug, Args)]
pub struct SpecArgs {
    /// The experiment, a JSON file; - for standard input
    pub spec: PathBuf,
    /// Change a field: eye.pupil_mm=5, counts.noise=NONE, retina.seed=9
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub set: Vec<String>,
}

/// Where the server is; the embedded one's data when there is none.
#[derive(Debug, Args)]
pub struct WhereArgs {
    /// A running server, http://host:port; without it, one is started inside this process
    #[arg(long, env = "PHOTONEYE_SERVER", value_name = "URL")]
    pub server: Option<String>,
    /// Data folder of the server in this process [default: $XDG_DATA_HOME/photoneye, else ~/.local/share/photoneye]
    #[arg(long, env = "PHOTONEYE_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Pieces of work done at the same time in this process [default: 2]
    #[arg(long, env = "PHOTONEYE_WORKERS", value_name = "N")]
    pub workers: Option<usize>,
}

/// `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// The experiment
    #[command(flatten)]
    pub spec: SpecArgs,
    /// Result folder, by default out/ and the name of the experiment file
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Pictures
    #[command(flatten)]
    pub pictures: PictureArgs,
    /// Where it runs
    #[command(flatten)]
    pub place: WhereArgs,
}

/// `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The experiment
    #[command(flatten)]
    pub spec: SpecArgs,
    /// Where it is planned
    #[command(flatten)]
    pub place: WhereArgs,
}

/// `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Address and port [default: 127.0.0.1:7733]
    #[arg(long, env = "PHOTONEYE_LISTEN", value_name = "ADDRESS")]
    pub listen: Option<String>,
    /// Data folder [default: $XDG_DATA_HOME/photoneye, else ~/.local/share/photoneye]
    #[arg(long, env = "PHOTONEYE_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Pieces of work done at the same time in this process; 0: none, workers connect from elsewhere [default: 2]
    #[arg(long, env = "PHOTONEYE_WORKERS", value_name = "N")]
    pub workers: Option<usize>,
    /// Most bytes of results and artifacts in the data folder, such as 200G; what was not read for longest is dropped and made
    /// again when somebody asks [default: no bound]
    #[arg(long, env = "PHOTONEYE_STORE_MAX", value_name = "BYTES")]
    pub store_max: Option<String>,
    /// Certificate chain, a PEM file: serve https instead of http, for REST and gRPC
    #[arg(long, env = "PHOTONEYE_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate, a PEM file
    #[arg(long, env = "PHOTONEYE_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Allow an address that others can reach, without access control
    #[arg(long, env = "PHOTONEYE_INSECURE")]
    pub insecure: bool,
}

/// `worker`.
#[derive(Debug, Args)]
pub struct WorkerArgs {
    /// The server, http://host:port
    #[arg(long, env = "PHOTONEYE_SERVER", value_name = "URL")]
    pub server: Option<String>,
    /// Folder of local copies [default: cache/ in the data folder]
    #[arg(long, env = "PHOTONEYE_CACHE", value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Most bytes of local copies, such as 20000000000 or 20G [default: 20G]
    #[arg(long, env = "PHOTONEYE_CACHE_MAX", value_name = "BYTES")]
    pub cache_max: Option<String>,
    /// Stop after so many seconds without work
    #[arg(long, env = "PHOTONEYE_IDLE_EXIT", value_name = "SECONDS")]
    pub idle_exit: Option<f64>,
    /// Pieces of work done at the same time [default: 2]
    #[arg(long, env = "PHOTONEYE_WORKERS", value_name = "N")]
    pub workers: Option<usize>,
    /// Name shown at the server [default: host and process]
    #[arg(long, env = "PHOTONEYE_WORKER_NAME", value_name = "NAME")]
    pub name: Option<String>,
}

/// A running server.
#[derive(Debug, Args)]
pub struct ServerArgs {
    /// The server [default: http://127.0.0.1:7733]
    #[arg(long, env = "PHOTONEYE_SERVER", value_name = "URL")]
    pub server: Option<String>,
}

/// `submit`.
#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// The experiment
    #[command(flatten)]
    pub spec: SpecArgs,
    /// The same key again gives the same job
    #[arg(long, value_name = "KEY")]
    pub request_id: Option<String>,
    /// The server
    #[command(flatten)]
    pub server: ServerArgs,
}

/// A job of a running server.
#[derive(Debug, Args)]
pub struct JobArgs {
    /// The job's id
    pub id: String,
    /// The server
    #[command(flatten)]
    pub server: ServerArgs,
}

/// `results`.
#[derive(Debug, Args)]
pub struct ResultsArgs {
    /// The job
    #[command(flatten)]
    pub job: JobArgs,
    /// Result folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Pictures
    #[command(flatten)]
    pub pictures: PictureArgs,
}

/// How pictures are drawn.
#[derive(Clone, Copy, Debug, Args)]
pub struct PictureArgs {
    /// Longer side of a picture, pixels
    #[arg(long, env = "PHOTONEYE_PICTURE_PX", value_name = "PIXELS", default_value_t = 1024,
          value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub picture_px: u32,
    /// Most frames that are drawn, from the first; 0: no pictures
    #[arg(long, env = "PHOTONEYE_PICTURES", value_name = "N", default_value_t = 240)]
    pub pictures: u32,
}

/// `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// A result folder with cones.arrow and counts.npy
    pub dir: PathBuf,
    /// Also write profile.csv and profile.png: the cones' signal across the picture, averaged over its height; of a frequency
    /// sweep also the contrast that is left at each frequency
    #[arg(long)]
    pub profile: bool,
    /// Pictures
    #[command(flatten)]
    pub pictures: PictureArgs,
}

/// `displays`.
#[derive(Debug, Args)]
pub struct DisplaysArgs {
    /// Show this display in full; with --import, the display of the file
    pub name: Option<String>,
    /// A display file of ColorVideoVDP; prints the `display` part of an experiment
    #[arg(long, value_name = "FILE")]
    pub import: Option<PathBuf>,
    /// The display that lends spectra and pixels to an imported one
    #[arg(long, value_name = "NAME", default_value = "lcd-wled")]
    pub spectra_of: String,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    #[test]
    fn the_command_line_is_consistent() {
        super::Cli::command().debug_assert();
    }
}
