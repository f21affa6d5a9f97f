//! Bytes in and out of the blob store in pieces, on threads that may block.

use std::io::{self, Read};

use bytes::Bytes;
use futures::Stream;
use photoneye_store::{BlobDigest, BlobSink};

use crate::error::{Error, Kind};
use crate::service::Service;

/// Read at once.
const PIECE: usize = 256 << 10;

/// An upload on its way.
pub struct Upload {
    sink: Box<dyn BlobSink>,
    size: u64,
    declared: Option<u64>,
    limit: u64,
}

impl Upload {
    /// Begins an upload of a declared size.
    ///
    /// # Errors
    /// When that is over the limit, or the store cannot write.
    pub async fn begin(service: &Service, declared: Option<u64>) -> Result<Self, Error> {
        let limit = service.limits.blob_bytes;
        if let Some(size) = declared.filter(|size| *size > limit) {
            return Err(Error::new(Kind::TooLarge, format!("{size} bytes, allowed are {limit}")));
        }
        Ok(Self { sink: service.with_blobs(|blobs| blobs.begin()).await?, size: 0, declared, limit })
    }

    /// Adds bytes.
    ///
    /// # Errors
    /// When there are more than declared or allowed, or the store cannot write.
    pub fn push(&mut self, bytes: Bytes) -> Result<(), Error> {
        self.size += bytes.len() as u64;
        let most = self.declared.unwrap_or(self.limit);
        if self.size > most {
            return Err(Error::new(Kind::TooLarge, format!("more than {most} bytes")));
        }
        // A write of one piece to a file takes less time than handing it to another thread.
        Ok(self.sink.write(&bytes)?)
    }

    /// Makes the blob durable.
    ///
    /// # Errors
    /// When bytes are missing, or the store cannot write.
    pub async fn finish(self) -> Result<BlobDigest, Error> {
        if let Some(declared) = self.declared.filter(|declared| *declared != self.size) {
            let message = format!("{} bytes came, {declared} were declared", self.size);
            return Err(Error::new(Kind::Invalid, message));
        }
        Ok(tokio::task::spawn_blocking(move || self.sink.finish()).await??)
    }
}

/// The bytes of a reader, the next piece read when the last one was taken.
pub fn pieces(reader: Box<dyn Read + Send>) -> impl Stream<Item = io::Result<Bytes>> + Send {
    async_stream::try_stream! {
        let mut reader = reader;
        loop {
            let read = tokio::task::spawn_blocking(move || {
                let mut piece = Vec::with_capacity(PIECE);
                let result = (&mut reader).take(PIECE as u64).read_to_end(&mut piece);
                (reader, result.map(|_| piece))
            });
            let (back, piece) = read.await.map_err(io::Error::other)?;
            reader = back;
            let piece = piece?;
            if piece.is_empty() {
                return;
            }
            yield Bytes::from(piece);
        }
    }
}
