//! REST and gRPC front end, job machine, SQLite.
//!
//! [`Server::start`] opens the data folder, listens, and serves both doors on one port until its [`Handle`] is shut down.

pub mod access;
mod admit;
mod ahead;
mod cones;
pub mod doctor;
pub mod error;
mod fleet;
mod grpc;
mod janitor;
pub mod jobs;
mod listen;
mod memory;
mod metrics;
mod pieces;
mod prepare;
mod quota;
mod report;
mod rest;
mod results;
pub mod service;
pub mod spec;
mod tls;
mod transfer;
mod uploads;
mod view;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hyper_util::rt::TokioIo;
use photoneye_store::FolderStore;
use tokio::io::DuplexStream;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::transport::{Channel, Endpoint, Uri};

pub use service::Limits;

use access::Access;
use jobs::clock::Clock;
use jobs::sqlite::SqliteStore;
use jobs::state::ORPHAN;
use jobs::{Command, Machine, State};
use photoneye_eye::plan::Machine as Speed;
use quota::Quota;
use service::Service;

/// How a server is set up.
#[derive(Clone, Debug)]
pub struct Options {
    /// Address and port; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Where jobs and blobs are kept.
    pub data_dir: PathBuf,
    /// Listen on an address that others can reach, although nobody is asked who they are.
    pub insecure: bool,
    /// Certificate chain and private key, PEM files; without them the port speaks plain HTTP.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// What is accepted.
    pub limits: Limits,
    /// Most bytes of blobs; `None`: as many as the disk holds.
    pub store_max_bytes: Option<u64>,
    /// The time that leases and records go by.
    pub clock: Clock,
    /// Work only on jobs that are made in this process: those that wait in the folder stay there for a server.
    pub local_only: bool,
}

impl Options {
    /// A server for this machine only, with jobs and blobs in a folder.
    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 7733)),
            data_dir: data_dir.into(),
            insecure: false,
            tls: None,
            limits: Limits::default(),
            store_max_bytes: None,
            clock: Clock::new(),
            local_only: false,
        }
    }
}

/// Why a server cannot start. Each error is one line that names what is wrong.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Others could reach the port and nobody would be asked who they are.
    #[error(
        "{0} can be reached by others and there are no API keys: make one with `photoneye keys create`, or give --insecure if that is meant"
    )]
    Open(SocketAddr),
    /// The port is taken, or the address is not this machine's.
    #[error("cannot listen on {0}: {1}")]
    Listen(SocketAddr, std::io::Error),
    /// The data folder cannot be used.
    #[error("data folder: {0}")]
    Folder(#[from] photoneye_store::StoreError),
    /// Another server uses the data folder.
    #[error("data folder {0} is in use by another server")]
    InUse(PathBuf),
    /// The database cannot be used.
    #[error("{0}: {1}")]
    Database(PathBuf, jobs::StoreError),
    /// Certificate or key cannot be used.
    #[error("{0}: {1}")]
    Tls(PathBuf, String),
    /// The schema's descriptors are broken.
    #[error("reflection: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
}

/// The service, not started yet.
#[derive(Debug)]
pub struct Server;

impl Server {
    /// Opens the data folder, listens and serves.
    ///
    /// # Errors
    /// When the port is taken, or the data folder cannot be used.
    pub async fn start(options: Options) -> Result<Handle, StartError> {
        memory::share_arenas();
        let listen_error = |error| StartError::Listen(options.listen, error);
        let listener = TcpListener::bind(options.listen).await.map_err(listen_error)?;
        let address = listener.local_addr().map_err(listen_error)?;
        let blobs = FolderStore::open(&options.data_dir)?;
        let lock = lock(&options.data_dir).await?;
        let file = options.data_dir.join("photoneye.db");
        let clock = options.clock;
        let opened = SqliteStore::open(&file, clock.now_ms()).await;
        let store = opened.map_err(|error| StartError::Database(file.clone(), error))?;
        let machine = Machine::new(store, clock);
        let orphans: Vec<String> = machine.read(State::orphans);
        machine.execute(Command::Disown).await.map_err(|error| StartError::Database(file.clone(), error))?;
        for job in orphans {
            tracing::warn!(job, "cancelled: {ORPHAN}");
        }
        let limits = options.limits;
        let service = Arc::new(Service {
            access: Access::new(machine.documents().clone()),
            machine,
            blobs: Arc::new(blobs.clone()),
            limits,
            quota: Quota::new(limits.burst_seconds, limits.rate),
            fleet: fleet::Fleet::default(),
            metrics: metrics::Metrics::default(),
            unpacking: tokio::sync::Semaphore::new(service::UNPACKED),
            ahead: ahead::Places::default(),
            plans: prepare::Plans::default(),
            local_only: options.local_only,
            speed: speed(&options.data_dir),
        });
        let keys = service.access.asks().await.map_err(|error| StartError::Database(file, error))?;
        if !options.listen.ip().is_loopback() && !options.insecure && !keys {
            return Err(StartError::Open(options.listen));
        }
        let tls = options.tls.as_ref().map(|(chain, key)| tls::acceptor(chain, key)).transpose()?;
        let routes = rest::routes(Arc::clone(&service))
            .merge(grpc::routes(&service).await?)
            .fallback(rest::unknown)
            .layer(axum::middleware::from_fn_with_state(Arc::clone(&service), access::guard));
        let (sender, receiver) = mpsc::channel(16);
        let stop = CancellationToken::new();
        let serving = tokio::spawn({
            let stop = stop.clone();
            async move {
                tokio::select! {
                    () = listen::serve(listener, tls, receiver, routes, stop) => {}
                    () = service.machine.reap() => {}
                    () = service.keep_size(&blobs, options.store_max_bytes) => {}
                    () = service.sweep(&blobs) => {}
                    () = service.give_memory_back() => {}
                }
                service.machine.stop().await;
                drop(service);
                drop(lock);
            }
        });
        tracing::info!(%address, data = %options.data_dir.display(), "serving");
        Ok(Handle { address, connector: sender, stop, serving })
    }
}

/// The file of the data folder that says how fast the machine is.
pub const MACHINE_FILE: &str = "machine.json";

/// What `photoneye calibrate` found out; without it the machine of the cost model's constants.
fn speed(folder: &Path) -> Speed {
    let path = folder.join(MACHINE_FILE);
    let Ok(text) = std::fs::read_to_string(&path) else { return Speed::default() };
    serde_json::from_str(&text).unwrap_or_else(|error| {
        tracing::warn!(path = %path.display(), %error, "the calibration cannot be read");
        Speed::default()
    })
}

/// How long a start waits for the data folder: a server that was killed holds it until the system has cleared it away.
const LOCK_TRIES: u32 = 40;
const LOCK_PAUSE: std::time::Duration = std::time::Duration::from_millis(50);

/// Holds the data folder for one server; the system lets go of it when the process ends, however it ends.
async fn lock(folder: &Path) -> Result<std::fs::File, StartError> {
    let path = folder.join("lock");
    let unusable = |source| {
        StartError::Folder(photoneye_store::StoreError::Io { action: "lock", path: path.clone(), source })
    };
    let file = std::fs::File::options().create(true).append(true).open(&path).map_err(unusable)?;
    for _ in 0..LOCK_TRIES {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(std::fs::TryLockError::WouldBlock) => tokio::time::sleep(LOCK_PAUSE).await,
            Err(std::fs::TryLockError::Error(error)) => return Err(unusable(error)),
        }
    }
    Err(StartError::InUse(folder.to_owned()))
}

/// A server that runs.
#[derive(Debug)]
pub struct Handle {
    address: SocketAddr,
    connector: mpsc::Sender<DuplexStream>,
    stop: CancellationToken,
    serving: JoinHandle<()>,
}

impl Handle {
    /// Where it listens.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// A gRPC channel inside this process, over the same accept loop as TCP; it connects again by itself.
    pub fn channel(&self) -> Channel {
        let connector = self.connector.clone();
        let connect = tower::service_fn(move |_: Uri| {
            let connector = connector.clone();
            async move {
                let (near, far) = tokio::io::duplex(listen::LOCAL_BUFFER);
                let gone =
                    |_| std::io::Error::new(std::io::ErrorKind::ConnectionRefused, "the server has stopped");
                connector.send(far).await.map_err(gone)?;
                Ok::<_, std::io::Error>(TokioIo::new(near))
            }
        });
        // The name is never looked up.
        Endpoint::from_static("http://photoneye.local")
            .initial_stream_window_size(listen::STREAM_WINDOW)
            .initial_connection_window_size(listen::CONNECTION_WINDOW)
            .max_frame_size(listen::FRAME)
            .connect_with_connector_lazy(connect)
    }

    /// Stops: no new connections, a moment for open requests, then the end.
    pub async fn shutdown(self) {
        self.stop.cancel();
        if let Err(error) = self.serving.await {
            tracing::error!(%error, "the server died");
        }
    }
}
