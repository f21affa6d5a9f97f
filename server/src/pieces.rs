//! Bodies in small pieces, so that a reader who stalls holds the chunk that it is at and little more.
//!
//! What is sent lies in buffers that count bytes but keep whole frames, and hyper takes the next frame while the one before is on its
//! way: two chunks of a megabyte each. A slice of a frame keeps all of it; so the last pieces, which may be on their way when the next
//! frame is asked for, are copies.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use axum::body::{Body, Bytes};
use http_body::{Body as HttpBody, Frame, SizeHint};

use crate::listen::SEND_BUFFER;

/// Most bytes of a piece.
pub const PIECE: usize = 128 << 10;
/// Of the end of a frame so much may be on its way when the next one is asked for, bytes: what waits to be sent, the piece that
/// went over it, and the one behind.
const TAIL: usize = SEND_BUFFER + 2 * PIECE;

/// A body whose frames are at most a piece.
pub struct Pieces {
    body: Body,
    /// What is left of the frame that is being cut.
    rest: Bytes,
}

impl Pieces {
    /// Cuts a body.
    pub fn of(body: Body) -> Self {
        Self { body, rest: Bytes::new() }
    }
}

impl HttpBody for Pieces {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_frame(context)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) if data.len() > PIECE => self.rest = data,
                    Ok(data) => return Poll::Ready(Some(Ok(Frame::data(data)))),
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                end => return Poll::Ready(end),
            }
        }
        let length = self.rest.len().min(PIECE);
        let whole = self.rest.len() > TAIL;
        let slice = self.rest.split_to(length);
        let piece = if whole { slice } else { Bytes::copy_from_slice(&slice) };
        if self.rest.is_empty() {
            self.rest = Bytes::new();
        }
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        let mut whole = SizeHint::new();
        whole.set_lower(hint.lower() + rest);
        if let Some(upper) = hint.upper() {
            whole.set_upper(upper + rest);
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use http_body_util::BodyExt as _;

    use super::*;

    #[tokio::test]
    async fn all_bytes_come_in_order_and_none_in_a_large_piece() {
        let frames = [3 * PIECE + 7, 0, 5, PIECE, PIECE + 1];
        let frames: Vec<Bytes> = (0..).zip(frames).map(|(i, n)| Bytes::from(vec![i; n])).collect();
        let all = frames.concat();
        let whole = Pieces::of(Body::from(all.clone()));
        assert_eq!(whole.size_hint().exact(), Some(all.len() as u64));
        let body = Body::from_stream(futures::stream::iter(frames.into_iter().map(Ok::<_, std::io::Error>)));
        for mut cut in [Pieces::of(body), whole] {
            let mut seen = Vec::new();
            while let Some(frame) = cut.frame().await {
                let data = frame.unwrap().into_data().unwrap();
                assert!(data.len() <= PIECE);
                seen.extend_from_slice(&data);
                assert!(!cut.is_end_stream() || seen.len() == all.len());
            }
            assert!(seen == all);
        }
    }
}
