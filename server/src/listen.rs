//! One accept loop for REST and gRPC: TCP connections, and in-memory ones from this process.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use http::{Request, Response};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use tokio::io::{AsyncRead, AsyncWrite, DuplexStream};
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt as _;

use crate::grpc::Local;
use crate::pieces::Pieces;

/// In flight on one HTTP/2 stream, bytes; the default caps a stream at its window over the round trip.
pub const STREAM_WINDOW: u32 = 4 << 20;
/// In flight on one HTTP/2 connection, bytes.
pub const CONNECTION_WINDOW: u32 = 16 << 20;
/// One HTTP/2 frame, bytes: the default of 16 KiB costs a third of the speed.
pub const FRAME: u32 = 1 << 20;
/// Of one answer, what waits to be sent: a reader who stalls holds so much and what is read of its chunk, bytes.
pub const SEND_BUFFER: usize = 128 << 10;
/// Buffer of an in-memory connection, bytes.
pub const LOCAL_BUFFER: usize = 1 << 20;

/// A client has so long to send its headers.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
/// Connections at the same time.
const MAX_CONNECTIONS: usize = 4096;
/// Open requests have so long to end when the server stops.
const FAREWELL: Duration = Duration::from_secs(1);

/// Serves connections until the token is cancelled and open requests have ended or had their time.
pub async fn serve(
    listener: TcpListener,
    tls: Option<TlsAcceptor>,
    mut local: mpsc::Receiver<DuplexStream>,
    routes: Router,
    stop: CancellationToken,
) {
    let graceful = GracefulShutdown::new();
    let connections = CancellationToken::new();
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        tokio::select! {
            () = stop.cancelled() => break,
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => {
                    let _ = stream.set_nodelay(true);
                    // Over the limit the connection is closed at once.
                    let Ok(place) = Arc::clone(&room).try_acquire_owned() else { continue };
                    let (routes, watcher, stop) = (routes.clone(), graceful.watcher(), connections.clone());
                    match tls.clone() {
                        None => drop(tokio::spawn(answer(stream, false, routes, watcher, stop, Some(place)))),
                        Some(tls) => drop(tokio::spawn(async move {
                            let shaken = tokio::time::timeout(HEADER_TIMEOUT, tls.accept(stream)).await;
                            match shaken {
                                Ok(Ok(stream)) => answer(stream, false, routes, watcher, stop, Some(place)).await,
                                Ok(Err(error)) => tracing::debug!(%error, "no TLS agreement"),
                                Err(_) => tracing::debug!("no TLS agreement in time"),
                            }
                        })),
                    }
                }
                Err(error) => {
                    // Out of file descriptors, most likely: others may be closed soon.
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            },
            Some(stream) = local.recv() => {
                let (routes, watcher, stop) = (routes.clone(), graceful.watcher(), connections.clone());
                drop(tokio::spawn(answer(stream, true, routes, watcher, stop, None)));
            }
        }
    }
    drop(listener);
    let _ = tokio::time::timeout(FAREWELL, graceful.shutdown()).await;
    connections.cancel();
}

/// Answers the requests of one connection; `_place` is held as long.
async fn answer(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    local: bool,
    routes: Router,
    watcher: Watcher,
    stop: CancellationToken,
    _place: Option<OwnedSemaphorePermit>,
) {
    let service =
        hyper_util::service::TowerToHyperService::new(tower::service_fn(move |mut request: Request<_>| {
            if local {
                request.extensions_mut().insert(Local);
            }
            let routes = routes.clone();
            async move {
                let answer = routes.oneshot(request.map(Body::new)).await;
                answer.map(|answer: Response<Body>| answer.map(Pieces::of))
            }
        }));
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(HEADER_TIMEOUT).max_buf_size(SEND_BUFFER);
    builder
        .http2()
        .timer(TokioTimer::new())
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_frame_size(FRAME)
        .max_send_buf_size(SEND_BUFFER)
        .max_concurrent_streams(1000)
        .keep_alive_interval(Duration::from_secs(30))
        .keep_alive_timeout(Duration::from_secs(20));
    let connection = builder.serve_connection(TokioIo::new(stream), service).into_owned();
    let connection = watcher.watch(connection);
    tokio::select! {
        () = stop.cancelled() => {}
        ended = connection => {
            if let Err(error) = ended {
                tracing::debug!(%error, "a connection broke");
            }
        }
    }
}
