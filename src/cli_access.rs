//! What can be typed for `keys` and `doctor`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// `keys`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    /// Data folder of the server [default: $XDG_DATA_HOME/photoneye, else ~/.local/share/photoneye]
    #[arg(long, global = true, env = "PHOTONEYE_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// What to do
    #[command(subcommand)]
    pub what: KeysCommand,
}

/// What `keys` does.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Make a key; it is shown once and kept only as a hash. With the first key, everybody is asked for one
    Create {
        /// What its holder may do: read, submit, admin, worker; several times if need be
        #[arg(long, value_name = "ROLE", required = true)]
        role: Vec<photoneye_server::access::Role>,
        /// Whose jobs and uploads its holder sees
        #[arg(long, value_name = "TENANT", default_value = "local")]
        tenant: String,
        /// What it is for
        #[arg(long, value_name = "TEXT", default_value = "")]
        name: String,
    },
    /// List all keys, without their secrets
    List,
    /// Revoke a key; a running server refuses it within a second
    Revoke {
        /// The key's id
        id: String,
    },
}

/// `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Data folder [default: $XDG_DATA_HOME/photoneye, else ~/.local/share/photoneye]
    #[arg(long, env = "PHOTONEYE_DATA", value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// A server that should answer
    #[arg(long, env = "PHOTONEYE_SERVER", value_name = "URL")]
    pub server: Option<String>,
    /// Address and port to serve on [default: 127.0.0.1:7733]
    #[arg(long, env = "PHOTONEYE_LISTEN", value_name = "ADDRESS")]
    pub listen: Option<String>,
    /// Seconds for reading blobs, the latest first; 0: all of them
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub verify_seconds: f64,
}
