//! Calls to the server, repeated with growing pauses while the server is away.

use std::future::Future;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use photoneye_proto::{ApiKey, v1};
use photoneye_store::BlobDigest;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Code, Status};

use crate::WorkError;

/// How long a lease call waits at the server for work.
const LEASE_WAIT: Duration = Duration::from_secs(10);
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const MAX_PAUSE: Duration = Duration::from_secs(2);
/// Repetitions of a transfer before the work is given back; together about half a minute.
const TRANSFER_TRIES: u32 = 18;
/// Bytes a message when uploading; the schema allows 1 MiB.
const PIECE: usize = 512 << 10;
const MAX_MESSAGE: usize = 16 << 20;

/// The server, as seen by a worker.
#[derive(Clone)]
pub(crate) struct Remote {
    channel: Channel,
    key: ApiKey,
}

/// A channel that shows the worker's API key with each call.
type Door = InterceptedService<Channel, ApiKey>;

impl Remote {
    pub(crate) fn new(channel: Channel, key: ApiKey) -> Self {
        Self { channel, key }
    }

    pub(crate) fn workers(&self) -> v1::workers_client::WorkersClient<Door> {
        v1::workers_client::WorkersClient::with_interceptor(self.channel.clone(), self.key.clone())
            .max_decoding_message_size(MAX_MESSAGE)
    }

    fn blobs(&self) -> v1::blobs_client::BlobsClient<Door> {
        v1::blobs_client::BlobsClient::with_interceptor(self.channel.clone(), self.key.clone())
            .max_decoding_message_size(MAX_MESSAGE)
    }

    /// Asks for work once and tells what the cache was good for; while the server is away, waits a little and answers "nothing".
    pub(crate) async fn lease(
        &self,
        worker: &str,
        holds: Vec<String>,
        [hits, misses]: [u64; 2],
    ) -> v1::LeaseReply {
        let request = v1::LeaseRequest {
            worker: Some(worker.to_owned()),
            holds,
            wait_ms: Some(LEASE_WAIT.as_millis() as u32),
            cache_hits: Some(hits),
            cache_misses: Some(misses),
        };
        match self.workers().lease(request).await {
            Ok(reply) => reply.into_inner(),
            Err(status) => {
                let refused = matches!(status.code(), Code::Unauthenticated | Code::PermissionDenied);
                if refused {
                    tracing::error!(message = status.message(), "the server refuses this worker");
                } else {
                    tracing::debug!(%status, "no lease");
                }
                tokio::time::sleep(if refused { 2 * MAX_PAUSE } else { MAX_PAUSE / 4 }).await;
                v1::LeaseReply::default()
            }
        }
    }

    /// Uploads bytes; durable when it returns.
    pub(crate) async fn put(&self, bytes: Bytes) -> Result<BlobDigest, WorkError> {
        let digest = BlobDigest::of(&bytes);
        let reply = repeat(|| {
            let (mut service, messages) = (self.blobs(), upload(&bytes));
            async move { service.put(tokio_stream::iter(messages)).await }
        })
        .await?;
        if reply.into_inner().digest() == digest.to_string() {
            Ok(digest)
        } else {
            Err(WorkError::Passing(format!("blob {digest} was changed on its way to the server")))
        }
    }

    /// Downloads a blob. The caller verifies the bytes.
    pub(crate) async fn get(&self, digest: BlobDigest) -> Result<Vec<u8>, WorkError> {
        let request = v1::GetBlobRequest { digest: Some(digest.to_string()) };
        repeat(|| {
            let (mut service, request) = (self.blobs(), request.clone());
            async move {
                let mut pieces = service.get(request).await?.into_inner();
                let mut bytes = BytesMut::new();
                while let Some(piece) = pieces.message().await? {
                    bytes.extend_from_slice(piece.bytes.as_deref().unwrap_or_default());
                    if bytes.len() as u64 > digest.size {
                        return Err(Status::data_loss("the blob is larger than its digest says"));
                    }
                }
                Ok(bytes.into())
            }
        })
        .await
    }
}

/// Makes a call until it is answered, at most [`TRANSFER_TRIES`] times.
pub(crate) async fn repeat<T, F>(call: impl Fn() -> F) -> Result<T, WorkError>
where
    F: Future<Output = Result<T, Status>>,
{
    let mut pause = FIRST_PAUSE;
    let mut tries = 1;
    loop {
        match call().await {
            Ok(reply) => return Ok(reply),
            Err(status) if tries < TRANSFER_TRIES && is_transient(&status) => {
                tokio::time::sleep(pause).await;
                pause = (2 * pause).min(MAX_PAUSE);
                tries += 1;
            }
            Err(status) => return Err(WorkError::Passing(status.message().to_owned())),
        }
    }
}

/// Whether the same call may succeed later: the connection broke, or the server is starting, stopping or busy.
fn is_transient(status: &Status) -> bool {
    matches!(status.code(), Code::Unavailable | Code::ResourceExhausted)
        || std::error::Error::source(status).is_some()
        || status.message().starts_with("Service was not ready")
}

/// The messages of an upload: the declared size, then the bytes.
fn upload(bytes: &Bytes) -> Vec<v1::PutBlobRequest> {
    use v1::put_blob_request::Part;
    let starts = (0..bytes.len()).step_by(PIECE);
    let pieces = starts.map(|start| bytes.slice(start..(start + PIECE).min(bytes.len())));
    std::iter::once(Part::Size(bytes.len() as u64))
        .chain(pieces.map(Part::Bytes))
        .map(|part| v1::PutBlobRequest { part: Some(part), made: Some(true) })
        .collect()
}
