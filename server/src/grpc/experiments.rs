//! Experiments from the user's side, over gRPC.

use std::pin::Pin;
use std::sync::Arc;

use bytes::Bytes;
use futures::{Stream, StreamExt as _};
use photoneye_proto::v1;
use photoneye_proto::v1::experiments_server::Experiments;
use tonic::{Request, Response, Status};

use super::{Local, caller, needed};
use crate::admit::Wish;
use crate::service::Service;

/// One message of a cone table, bytes.
const PIECE: usize = 1 << 20;

pub(super) struct Door(pub Arc<Service>);

type Answer<T> = Result<Response<T>, Status>;
type Streamed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

#[tonic::async_trait]
impl Experiments for Door {
    async fn plan(&self, request: Request<v1::PlanRequest>) -> Answer<v1::PlanReply> {
        let caller = caller(&request)?;
        let experiment = needed("experiment", request.into_inner().experiment)?;
        Ok(Response::new(self.0.plan(&caller, &experiment).await?))
    }

    async fn create_job(&self, request: Request<v1::CreateJobRequest>) -> Answer<v1::Job> {
        let caller = caller(&request)?;
        let local = request.extensions().get::<Local>().is_some();
        let request = request.into_inner();
        let experiment = needed("experiment", request.experiment)?;
        let request_id = request.request_id.filter(|id| !id.is_empty());
        let wish = Wish { request_id, priority: request.priority, local };
        Ok(Response::new(self.0.create(&caller, &experiment, wish).await?.0))
    }

    async fn get_job(&self, request: Request<v1::JobRequest>) -> Answer<v1::Job> {
        self.0.owned(&caller(&request)?, request.get_ref().id()).await?;
        Ok(Response::new(self.0.job(request.get_ref().id()).await?))
    }

    async fn list_jobs(&self, request: Request<v1::ListJobsRequest>) -> Answer<v1::ListJobsReply> {
        let caller = caller(&request)?;
        let request = request.into_inner();
        Ok(Response::new(self.0.list(&caller, request.page.as_deref(), request.page_size).await?))
    }

    async fn cancel_job(&self, request: Request<v1::JobRequest>) -> Answer<v1::Job> {
        Ok(Response::new(self.0.cancel(&caller(&request)?, request.get_ref().id()).await?))
    }

    type WatchJobStream = Streamed<v1::JobEvent>;

    async fn watch_job(&self, request: Request<v1::WatchJobRequest>) -> Answer<Self::WatchJobStream> {
        self.0.owned(&caller(&request)?, request.get_ref().id()).await?;
        let request = request.into_inner();
        let after = request.after();
        let events = Arc::clone(&self.0).watch(needed("id", request.id)?, after).await?;
        Ok(Response::new(Box::pin(events.map(Ok))))
    }

    type StreamResultsStream = Streamed<v1::ResultChunk>;

    async fn stream_results(
        &self,
        request: Request<v1::StreamResultsRequest>,
    ) -> Answer<Self::StreamResultsStream> {
        self.0.owned(&caller(&request)?, request.get_ref().id()).await?;
        let request = request.into_inner();
        let from = request.from.unwrap_or(1);
        let chunks = Arc::clone(&self.0).chunks(needed("id", request.id)?, from).await?;
        Ok(Response::new(Box::pin(chunks.map(|chunk| chunk.map_err(Status::from)))))
    }

    async fn get_report(&self, request: Request<v1::JobRequest>) -> Answer<v1::Report> {
        self.0.owned(&caller(&request)?, request.get_ref().id()).await?;
        Ok(Response::new(self.0.report_message(request.get_ref().id()).await?))
    }

    type GetConesStream = Streamed<v1::GetBlobReply>;

    async fn get_cones(&self, request: Request<v1::JobRequest>) -> Answer<Self::GetConesStream> {
        self.0.owned(&caller(&request)?, request.get_ref().id()).await?;
        let mut table = Bytes::from(self.0.cones_file(request.get_ref().id(), true).await?);
        let pieces = std::iter::from_fn(move || {
            let piece = table.split_to(table.len().min(PIECE));
            (!piece.is_empty()).then(|| Ok(v1::GetBlobReply { bytes: Some(piece) }))
        });
        Ok(Response::new(Box::pin(futures::stream::iter(pieces))))
    }
}
