//! Uploads and downloads over gRPC.

use std::io::Read;
use std::pin::Pin;
use std::sync::Arc;

use futures::{Stream, StreamExt as _};
use photoneye_proto::v1;
use photoneye_proto::v1::blobs_server::Blobs;
use photoneye_proto::v1::put_blob_request::Part;
use photoneye_store::BlobDigest;
use tonic::{Request, Response, Status, Streaming};

use super::caller;
use crate::access::Role;
use crate::error::{Error, Kind};
use crate::service::Service;
use crate::transfer::Upload;

pub(super) struct Door(pub Arc<Service>);

#[tonic::async_trait]
impl Blobs for Door {
    async fn put(
        &self,
        request: Request<Streaming<v1::PutBlobRequest>>,
    ) -> Result<Response<v1::PutBlobReply>, Status> {
        let caller = caller(&request)?;
        let mut parts = request.into_inner();
        let first = parts.message().await?.unwrap_or_default();
        let Some(Part::Size(size)) = first.part else {
            return Err(Error::new(Kind::Invalid, "the first message of an upload is its size").into());
        };
        let made = first.made() && caller.may(Role::Worker);
        if !made && !caller.may(Role::Submit) {
            return Err(Error::new(Kind::Forbidden, "a worker uploads only what it made").into());
        }
        let mut upload = Upload::begin(&self.0, Some(size)).await?;
        while let Some(message) = parts.message().await? {
            match message.part {
                Some(Part::Bytes(bytes)) => upload.push(bytes)?,
                Some(Part::Size(_)) | None => {
                    return Err(Error::new(Kind::Invalid, "after the size come bytes").into());
                }
            }
        }
        let digest = upload.finish().await?;
        if !made {
            self.0.uploaded(&caller, digest).await?;
        }
        Ok(Response::new(v1::PutBlobReply { digest: Some(digest.to_string()) }))
    }

    type GetStream = Pin<Box<dyn Stream<Item = Result<v1::GetBlobReply, Status>> + Send>>;

    async fn get(&self, request: Request<v1::GetBlobRequest>) -> Result<Response<Self::GetStream>, Status> {
        let digest: BlobDigest =
            request.get_ref().digest().parse().map_err(|error: photoneye_store::digest::NotADigest| {
                Status::invalid_argument(format!("digest: {error}"))
            })?;
        self.0.readable(&caller(&request)?, &digest).await?;
        let reader: Box<dyn Read + Send> = self.0.with_blobs(move |blobs| blobs.open(&digest)).await?;
        let pieces = crate::transfer::pieces(reader).map(|piece| {
            let bytes = Some(piece.map_err(|error| Status::unavailable(error.to_string()))?);
            Ok(v1::GetBlobReply { bytes })
        });
        Ok(Response::new(Box::pin(pieces)))
    }
}
