//! Bytes by digest: upload, download, and a job's cone table.

use bytes::{Bytes, BytesMut};
use photoneye_proto::v1;

use crate::error::is_transient;
use crate::{Client, ClientError, Door, MAX_MESSAGE, Pauses, job_request};

/// Bytes a message when uploading; the schema allows 1 MiB.
const PIECE: usize = 512 << 10;

impl Client {
    fn blobs(&self) -> v1::blobs_client::BlobsClient<Door> {
        v1::blobs_client::BlobsClient::with_interceptor(self.channel.clone(), self.key.clone())
            .max_decoding_message_size(MAX_MESSAGE)
    }

    /// Uploads bytes; the answer is their digest, `b3:<hex>/<size>`. The same bytes again are one blob.
    ///
    /// # Errors
    /// When they are larger than the server takes or it cannot be reached.
    pub async fn put_blob(&self, bytes: Bytes) -> Result<String, ClientError> {
        let reply: v1::PutBlobReply = self
            .repeat(|| {
                let (mut service, messages) = (self.blobs(), upload(&bytes));
                async move { service.put(futures::stream::iter(messages)).await }
            })
            .await?;
        reply.digest.ok_or(ClientError::Protocol("an upload without digest"))
    }

    /// Downloads the bytes of a digest.
    ///
    /// # Errors
    /// When there is no such blob or the server cannot be reached.
    pub async fn get_blob(&self, digest: &str) -> Result<Bytes, ClientError> {
        let request = v1::GetBlobRequest { digest: Some(digest.to_owned()) };
        let mut pauses = Pauses::new(self.patience);
        loop {
            let status = match self.blobs().get(request.clone()).await {
                Ok(reply) => match collect(reply.into_inner()).await {
                    Ok(bytes) => return Ok(bytes),
                    Err(status) => status,
                },
                Err(status) => status,
            };
            retry_or_give_up(&mut pauses, status).await?;
        }
    }

    /// The cone table of a job as one Arrow IPC file, as soon as the retina is built.
    ///
    /// # Errors
    /// When there is no such job, its retina is not built yet (`FailedPrecondition`), or the server cannot be reached.
    pub async fn cones(&self, id: &str) -> Result<Bytes, ClientError> {
        let mut pauses = Pauses::new(self.patience);
        loop {
            let status = match self.experiments().get_cones(job_request(id)).await {
                Ok(reply) => match collect(reply.into_inner()).await {
                    Ok(bytes) => return Ok(bytes),
                    Err(status) => status,
                },
                Err(status) => status,
            };
            retry_or_give_up(&mut pauses, status).await?;
        }
    }
}

async fn retry_or_give_up(pauses: &mut Pauses, status: tonic::Status) -> Result<(), ClientError> {
    if is_transient(&status) { pauses.pause(status).await } else { Err(status.into()) }
}

/// The messages of an upload: the declared size, then the bytes.
fn upload(bytes: &Bytes) -> Vec<v1::PutBlobRequest> {
    use v1::put_blob_request::Part;
    let message = |part| v1::PutBlobRequest { part: Some(part), made: None };
    let starts = (0..bytes.len()).step_by(PIECE);
    let pieces = starts.map(|start| bytes.slice(start..(start + PIECE).min(bytes.len())));
    std::iter::once(Part::Size(bytes.len() as u64)).chain(pieces.map(Part::Bytes)).map(message).collect()
}

async fn collect(mut pieces: tonic::Streaming<v1::GetBlobReply>) -> Result<Bytes, tonic::Status> {
    let mut bytes = BytesMut::new();
    while let Some(piece) = pieces.message().await? {
        bytes.extend_from_slice(piece.bytes.as_deref().unwrap_or_default());
    }
    Ok(bytes.freeze())
}
