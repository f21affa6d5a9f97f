//! Rust client of the service: plans, jobs, results and blobs over gRPC.
//!
//! Every call that may be repeated is repeated while the server is away, with growing pauses, for [`Client::patience`]; the
//! two streams go on where they stopped. So a server that is restarted in the middle of a job is a pause, not an error.
//!
//! ```no_run
//! # async fn run(experiment: photoneye_proto::v1::Experiment) -> Result<(), photoneye_client::ClientError> {
//! use futures::StreamExt as _;
//! let client = photoneye_client::Client::connect("http://127.0.0.1:7733")?;
//! let job = client.create_job(experiment, "my-request-1").await?;
//! let mut chunks = std::pin::pin!(client.results(job.id(), 1));
//! while let Some(chunk) = chunks.next().await {
//!     let chunk = chunk?;
//!     // `chunk.bytes`: the counts of one tile of one frame as an Arrow IPC stream
//! }
//! # Ok(()) }
//! ```

mod blobs;
mod error;
mod streams;

use std::future::Future;
use std::time::Duration;

use photoneye_proto::{ApiKey, v1};
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint};

pub use error::ClientError;

/// Largest message that is taken.
const MAX_MESSAGE: usize = 16 << 20;

/// First pause before a repetition; it doubles up to [`MAX_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const MAX_PAUSE: Duration = Duration::from_secs(2);

/// HTTP/2 windows: the defaults cap a stream at 64 KiB a round trip.
const STREAM_WINDOW: u32 = 4 << 20;
const CONNECTION_WINDOW: u32 = 16 << 20;
/// One HTTP/2 frame, bytes.
const FRAME: u32 = 1 << 20;

/// A connection to the service; cheap to clone.
#[derive(Clone, Debug)]
pub struct Client {
    channel: Channel,
    key: ApiKey,
    patience: Duration,
}

/// A channel that shows an API key with each call.
pub(crate) type Door = InterceptedService<Channel, ApiKey>;

/// How to get in where not everybody may.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// The API key.
    pub api_key: Option<String>,
    /// Certificates (PEM) to trust for https beside those of the system.
    pub ca_pem: Option<Vec<u8>>,
}

impl Access {
    /// The key in the form that goes with each call.
    ///
    /// # Errors
    /// When it is not plain text.
    pub fn key(&self) -> Result<ApiKey, ClientError> {
        self.api_key.as_deref().map_or(Ok(ApiKey::default()), |key| ApiKey::new(key).ok_or(ClientError::Key))
    }
}

/// The channel that client and worker use: HTTP/2 windows of 4 MiB a stream and 16 MiB a connection, connected at first use.
///
/// # Errors
/// When `url` is not an http or https URL, or the certificates cannot be used.
pub fn channel(url: &str, access: &Access) -> Result<Channel, ClientError> {
    let wrong = || ClientError::Url(url.to_owned());
    let mut endpoint = Endpoint::from_shared(url.to_owned()).map_err(|_| wrong())?;
    if endpoint.uri().host().is_none() {
        return Err(wrong());
    }
    match endpoint.uri().scheme_str() {
        Some("http") => {}
        Some("https") => {
            let mut tls = ClientTlsConfig::new().with_native_roots();
            if let Some(pem) = &access.ca_pem {
                tls = tls.ca_certificate(Certificate::from_pem(pem));
            }
            endpoint = endpoint.tls_config(tls).map_err(|error| ClientError::Tls(error.to_string()))?;
        }
        _ => return Err(wrong()),
    }
    Ok(endpoint
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_frame_size(FRAME)
        .connect_timeout(Duration::from_secs(5))
        .http2_keep_alive_interval(Duration::from_secs(20))
        .keep_alive_while_idle(true)
        .connect_lazy())
}

impl Client {
    /// A client of the server at `url`, such as `http://127.0.0.1:7733`. Connects at the first call.
    ///
    /// # Errors
    /// When `url` is not an http or https URL.
    pub fn connect(url: &str) -> Result<Self, ClientError> {
        Self::connect_with(url, &Access::default())
    }

    /// A client that shows an API key, or trusts certificates of its own.
    ///
    /// # Errors
    /// When `url` is not an http or https URL, or key or certificates cannot be used.
    pub fn connect_with(url: &str, access: &Access) -> Result<Self, ClientError> {
        Ok(Self { key: access.key()?, ..Self::from_channel(channel(url, access)?) })
    }

    /// A client over a channel that exists, for example one to a server in the same process.
    pub fn from_channel(channel: Channel) -> Self {
        Self { channel, key: ApiKey::default(), patience: Duration::from_secs(30) }
    }

    /// How long a call goes on trying while the server is away. Default 30 s.
    pub fn patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    fn experiments(&self) -> v1::experiments_client::ExperimentsClient<Door> {
        let (channel, key) = (self.channel.clone(), self.key.clone());
        v1::experiments_client::ExperimentsClient::with_interceptor(channel, key)
            .max_decoding_message_size(MAX_MESSAGE)
            .max_encoding_message_size(MAX_MESSAGE)
    }

    /// Explains what would be computed, what is left out and why, and what it costs. Runs nothing.
    ///
    /// # Errors
    /// The field that is wrong, or that the server cannot be reached.
    pub async fn plan(&self, experiment: v1::Experiment) -> Result<v1::PlanReply, ClientError> {
        let request = v1::PlanRequest { experiment: Some(experiment) };
        self.repeat(|| {
            let (mut service, request) = (self.experiments(), request.clone());
            // Experiments are large.
            Box::pin(async move { service.plan(request).await })
        })
        .await
    }

    /// Creates a job. The same `request_id` again gives the same job, so that the call may be repeated.
    ///
    /// # Errors
    /// The field that is wrong, that the id was used with another experiment, or that the server cannot be reached.
    pub async fn create_job(
        &self,
        experiment: v1::Experiment,
        request_id: &str,
    ) -> Result<v1::Job, ClientError> {
        let request = v1::CreateJobRequest {
            experiment: Some(experiment),
            request_id: Some(request_id.to_owned()),
            priority: None,
        };
        self.repeat(|| {
            let (mut service, request) = (self.experiments(), request.clone());
            Box::pin(async move { service.create_job(request).await })
        })
        .await
    }

    /// A job's state, progress and plan.
    ///
    /// # Errors
    /// When there is no such job or the server cannot be reached.
    pub async fn job(&self, id: &str) -> Result<v1::Job, ClientError> {
        let request = job_request(id);
        self.repeat(|| {
            let (mut service, request) = (self.experiments(), request.clone());
            async move { service.get_job(request).await }
        })
        .await
    }

    /// Jobs, newest first; `page` is empty or the `next_page` of the reply before.
    ///
    /// # Errors
    /// When the page is unknown or the server cannot be reached.
    pub async fn jobs(&self, page: &str) -> Result<v1::ListJobsReply, ClientError> {
        let request =
            v1::ListJobsRequest { page: (!page.is_empty()).then(|| page.to_owned()), page_size: None };
        self.repeat(|| {
            let (mut service, request) = (self.experiments(), request.clone());
            async move { service.list_jobs(request).await }
        })
        .await
    }

    /// Cancels a job; a job that has ended stays as it is.
    ///
    /// # Errors
    /// When there is no such job or the server cannot be reached.
    pub async fn cancel(&self, id: &str) -> Result<v1::Job, ClientError> {
        let request = job_request(id);
        self.repeat(|| {
            let (mut service, request) = (self.experiments(), request.clone());
            async move { service.cancel_job(request).await }
        })
        .await
    }

    /// The report of a finished job: the text of report.json.
    ///
    /// # Errors
    /// When there is no such job, it has not ended, or the server cannot be reached.
    pub async fn report(&self, id: &str) -> Result<String, ClientError> {
        let request = job_request(id);
        let report: v1::Report = self
            .repeat(|| {
                let (mut service, request) = (self.experiments(), request.clone());
                async move { service.get_report(request).await }
            })
            .await?;
        report.json.ok_or(ClientError::Protocol("a report without text"))
    }

    /// Makes a call until it is answered, for as long as the patience lasts.
    async fn repeat<T, F>(&self, call: impl Fn() -> F) -> Result<T, ClientError>
    where
        F: Future<Output = Result<tonic::Response<T>, tonic::Status>>,
    {
        let mut pauses = Pauses::new(self.patience);
        loop {
            match call().await {
                Ok(reply) => return Ok(reply.into_inner()),
                Err(status) if error::is_transient(&status) => pauses.pause(status).await?,
                Err(status) => return Err(status.into()),
            }
        }
    }
}

fn job_request(id: &str) -> v1::JobRequest {
    v1::JobRequest { id: Some(id.to_owned()) }
}

/// Growing pauses between repetitions, until the patience is used up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pauses {
    patience: Duration,
    left: Duration,
    next: Duration,
}

impl Pauses {
    pub(crate) fn new(patience: Duration) -> Self {
        Self { patience, left: patience, next: FIRST_PAUSE }
    }

    /// After a success: all the patience is back.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.patience);
    }

    /// Waits, or gives the error back when the patience is used up.
    pub(crate) async fn pause(&mut self, status: tonic::Status) -> Result<(), ClientError> {
        if self.left.is_zero() {
            return Err(status.into());
        }
        let pause = self.next.min(self.left);
        tokio::time::sleep(pause).await;
        self.left -= pause;
        self.next = (2 * self.next).min(MAX_PAUSE);
        Ok(())
    }
}
