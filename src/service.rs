//! The service that a command talks to: a running server, or one inside this process with its workers.
//!
//! Both speak the same gRPC; the one in this process does it over an in-memory connection, so that no port is taken.

use std::net::SocketAddr;
use std::time::Duration;

use photoneye_client::Client;
use photoneye_server::{Handle, Server, StartError};
use photoneye_worker::Worker;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::transport::Channel;

use crate::cli::WhereArgs;
use crate::failure::{Failure, plain};
use crate::settings::{self, Place, Settings};

/// How long the first answer of a server may take.
const FIRST_ANSWER: Duration = Duration::from_secs(1);
/// How long a server may be away in the middle.
const RESTART: Duration = Duration::from_mins(2);
/// How long a stop waits for work that was begun.
const DRAIN: Duration = Duration::from_secs(20);

/// A service to talk to.
pub struct Service {
    /// The way to it.
    pub client: Client,
    embedded: Option<Embedded>,
}

/// A server and its workers in this process.
pub struct Embedded {
    /// In-memory connection to the server.
    pub channel: Channel,
    /// Where it listens.
    pub address: SocketAddr,
    server: Handle,
    stop_workers: CancellationToken,
    workers: Option<JoinHandle<()>>,
}

/// A client of a running server, when it answers; later on a restart of the server is waited for.
///
/// # Errors
/// When the URL is wrong or nobody answers.
pub async fn connect(place: &Place) -> Result<Client, Failure> {
    let client = Client::connect_with(&place.url, &place.access)?;
    client
        .clone()
        .patience(FIRST_ANSWER)
        .jobs("")
        .await
        .map_err(|error| Failure::failed(format!("{}: {error}", place.url)))?;
    Ok(client.patience(RESTART))
}

impl Service {
    /// The server that is asked for, or one started here.
    ///
    /// # Errors
    /// When the URL is wrong or the server in this process cannot start.
    pub async fn open(settings: &Settings, place: WhereArgs) -> Result<Self, Failure> {
        if let Some(server) = settings.server(place.server)? {
            return Ok(Self { client: connect(&server).await?, embedded: None });
        }
        let data = settings.data(place.data)?;
        let mut options = photoneye_server::Options::new(&data);
        // A free port of this machine; nobody is told which.
        options.listen.set_port(0);
        // Who runs one experiment does not want to wait for those of others.
        options.local_only = true;
        let embedded = Embedded::start(options, settings.workers(place.workers)).await?;
        Ok(Self { client: Client::from_channel(embedded.channel.clone()), embedded: Some(embedded) })
    }

    /// Stops what was started here; `drain`: after the workers have finished what they began.
    pub async fn close(self, drain: bool) {
        if let Some(embedded) = self.embedded {
            embedded.stop(drain).await;
        }
    }
}

impl Embedded {
    /// Starts a server and `workers` leases of a worker.
    ///
    /// # Errors
    /// When the data folder cannot be written, the address is taken, or the worker's cache cannot be made.
    pub async fn start(options: photoneye_server::Options, workers: usize) -> Result<Self, Failure> {
        let data = options.data_dir.clone();
        let server = Server::start(options).await.map_err(|error| start_failure(&error))?;
        let channel = server.channel();
        let stop_workers = CancellationToken::new();
        let workers = if workers == 0 {
            None
        } else {
            let options = photoneye_worker::Options {
                cache_dir: data.join("cache"),
                cache_max_bytes: settings::DEFAULT_CACHE_MAX,
                idle_exit: None,
                name: "in-process".into(),
                leases: workers,
                api_key: None,
            };
            let worker = Worker::new(channel.clone(), options).map_err(Failure::failed)?;
            Some(tokio::spawn(worker.run(stop_workers.clone())))
        };
        Ok(Self { channel, address: server.local_addr(), server, stop_workers, workers })
    }

    /// Stops the workers, after they have finished what they began when `drain` is set, then the server.
    pub async fn stop(self, drain: bool) {
        self.stop_workers.cancel();
        if let Some(workers) = self.workers
            && drain
            && tokio::time::timeout(DRAIN, workers).await.is_err()
        {
            tracing::info!("a worker is still busy; its lease will run out");
        }
        self.server.shutdown().await;
    }
}

/// What starting says, with a way out when the folder is taken.
fn start_failure(error: &StartError) -> Failure {
    match error {
        StartError::InUse(_) => {
            Failure::failed(format!("{error}; ask that one with --server, or give another --data"))
        }
        StartError::Listen(address, cause) => {
            Failure::failed(format!("cannot listen on {address}: {}", plain(cause)))
        }
        StartError::Open(_) | StartError::Tls(..) => Failure::usage(error),
        _ => Failure::failed(error),
    }
}
