//! The two endless readings, a job's events and its results: after a broken connection they go on behind the last number seen.

use async_stream::try_stream;
use futures::Stream;
use photoneye_proto::v1;

use crate::error::is_transient;
use crate::{Client, ClientError, Pauses};

impl Client {
    /// State and progress of a job, until it ends; events after number `after`, 0 for all.
    pub fn watch(
        &self,
        id: &str,
        after: u64,
    ) -> impl Stream<Item = Result<v1::JobEvent, ClientError>> + Send + use<> {
        let (client, id) = (self.clone(), id.to_owned());
        try_stream! {
            let (mut last, mut ended) = (after, false);
            let mut pauses = Pauses::new(client.patience);
            while !ended {
                let request = v1::WatchJobRequest { id: Some(id.clone()), after: Some(last) };
                let mut events = match client.experiments().watch_job(request).await {
                    Ok(reply) => reply.into_inner(),
                    Err(status) if is_transient(&status) => { pauses.pause(status).await?; continue }
                    Err(status) => Err(status)?,
                };
                loop {
                    match events.message().await {
                        Ok(Some(event)) => {
                            pauses.reset();
                            last = last.max(event.seq());
                            ended = event.job.as_ref().is_some_and(|job| has_ended(job.state()));
                            yield event;
                        }
                        // The server ends the stream when the job has ended, also when no event is left to tell.
                        Ok(None) => { ended = true; break }
                        Err(status) if is_transient(&status) => { pauses.pause(status).await?; break }
                        Err(status) => Err(status)?,
                    }
                    if ended { break }
                }
            }
        }
    }

    /// Result chunks in commit order from number `from` (the first is 1), waiting for new ones until the job ends.
    ///
    /// The stream ends when the job has: ask [`Client::job`] how.
    pub fn results(
        &self,
        id: &str,
        from: u64,
    ) -> impl Stream<Item = Result<v1::ResultChunk, ClientError>> + Send + use<> {
        let (client, id) = (self.clone(), id.to_owned());
        try_stream! {
            let (mut next, mut ended) = (from.max(1), false);
            let mut pauses = Pauses::new(client.patience);
            while !ended {
                let request = v1::StreamResultsRequest { id: Some(id.clone()), from: Some(next) };
                let mut chunks = match client.experiments().stream_results(request).await {
                    Ok(reply) => reply.into_inner(),
                    Err(status) if is_transient(&status) => { pauses.pause(status).await?; continue }
                    Err(status) => Err(status)?,
                };
                loop {
                    match chunks.message().await {
                        Ok(Some(chunk)) => {
                            pauses.reset();
                            if chunk.seq() < next { continue }
                            next = chunk.seq() + 1;
                            yield chunk;
                        }
                        Ok(None) => { ended = true; break }
                        Err(status) if is_transient(&status) => { pauses.pause(status).await?; break }
                        Err(status) => Err(status)?,
                    }
                }
            }
        }
    }
}

/// Whether a job in this state stays as it is.
pub(crate) fn has_ended(state: v1::job::State) -> bool {
    use v1::job::State::{Cancelled, Failed, Queued, Running, Succeeded};
    match state {
        Queued | Running => false,
        Succeeded | Failed | Cancelled => true,
    }
}
