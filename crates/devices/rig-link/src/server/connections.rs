//! Accepting connections, and the requests on each.

use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hyper::body::Incoming;
use hyper::header::{CONTENT_LENGTH, TRANSFER_ENCODING};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode, Version};
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::time::sleep;
use tokio_rustls::TlsAcceptor;

use super::body::Body;
use super::connection_slots::{ConnectionSlots, Stage};
use super::route::Route;
use super::stall_timeout::StallTimeoutStream;
use super::{Limits, Shared, actions, page, response, sessions};
use crate::clock::{HyperTimer, timeout};
use crate::link::Code;
use crate::store::problem;

/// Pause after a failed accept (for example, out of file descriptors).
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(200);
/// Maximum length of a request's head, bytes.
const MAX_HEAD: usize = 16 << 10;
/// Maximum number of headers of a request.
const MAX_HEADERS: usize = 64;
/// Maximum length of a request's URI, bytes.
const MAX_ADDRESS: usize = 4 << 10;

/// The open connections. Each holds the sender of a channel, which is dropped on eviction.
struct OpenConnections(Mutex<ConnectionSlots<oneshot::Sender<()>>>);

/// The slot of one open connection.
struct SlotGuard {
    open: Arc<OpenConnections>,
    number: u64,
}

impl OpenConnections {
    fn lock(&self) -> MutexGuard<'_, ConnectionSlots<oneshot::Sender<()>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A slot, and the receiver that ends on eviction.
    fn admit(
        self: &Arc<Self>,
        peer: IpAddr,
        stage: Stage,
        shared: &Shared,
    ) -> Option<(SlotGuard, oneshot::Receiver<()>)> {
        let known = shared.guard.is_known(peer, shared.now());
        let (held, evicted) = oneshot::channel();
        let admitted = self.lock().admit(peer, known, stage, held)?;
        let slot = SlotGuard {
            open: self.clone(),
            number: admitted.number,
        };
        // The evicted connection sees the end of its channel.
        drop(admitted.evicted);
        Some((slot, evicted))
    }
}

impl SlotGuard {
    fn set_stage(&self, stage: Stage) {
        self.open.lock().set_stage(self.number, stage);
    }
}

impl Drop for SlotGuard {
    fn drop(&mut self) {
        self.open.lock().remove(self.number);
    }
}

/// Accepts connections forever.
pub(super) async fn accept(
    listener: std::net::TcpListener,
    tls: Option<TlsAcceptor>,
    shared: Arc<Shared>,
) -> io::Result<()> {
    let listener = TcpListener::from_std(listener)?;
    let Limits {
        connections,
        connections_per_peer,
        ..
    } = shared.limits;
    let slots = ConnectionSlots::new(connections, connections_per_peer);
    let open = Arc::new(OpenConnections(Mutex::new(slots)));
    let stage = match tls {
        Some(_) => Stage::Handshake,
        None => Stage::Unauthenticated,
    };
    loop {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                log::warn!("accepting a connection: {e}");
                sleep(ACCEPT_RETRY_DELAY).await;
                continue;
            }
        };
        let Some((slot, evicted)) = open.admit(peer.ip(), stage, &shared) else {
            log::debug!("too many connections: {peer} is sent away");
            continue;
        };
        let (tls, shared) = (tls.clone(), shared.clone());
        tokio::spawn(async move {
            tokio::select! {
                ended = converse(stream, peer, tls, shared, Arc::new(slot)) => {
                    if let Err(e) = ended {
                        log::debug!("a connection from {peer} ended: {e}");
                    }
                }
                _ = evicted => log::debug!("a connection from {peer} gives way to another one"),
            }
        });
    }
}

async fn converse(
    stream: TcpStream,
    peer: SocketAddr,
    tls: Option<TlsAcceptor>,
    shared: Arc<Shared>,
    slot: Arc<SlotGuard>,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    stream.set_nodelay(true)?;
    let stream = StallTimeoutStream::new(stream, shared.limits.stall_time, shared.clock.clone());
    match tls {
        None => serve(stream, peer.ip(), shared, slot).await?,
        Some(tls) => {
            let limit = shared.limits.handshake_time;
            let handshake = timeout(&*shared.clock, limit, tls.accept(stream)).await;
            let stream = handshake??;
            slot.set_stage(Stage::Unauthenticated);
            serve(stream, peer.ip(), shared, slot).await?;
        }
    }
    Ok(())
}

async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin,
    peer: IpAddr,
    shared: Arc<Shared>,
    slot: Arc<SlotGuard>,
) -> hyper::Result<()> {
    let head_time = shared.limits.head_time;
    let timer = HyperTimer::new(shared.clock.clone());
    let service = service_fn(move |request| {
        let (shared, slot) = (shared.clone(), slot.clone());
        async move {
            let response = answer(request, peer, &shared, &slot).await;
            Ok::<_, Infallible>(response::finish(response))
        }
    });
    http1::Builder::new()
        .timer(timer)
        .header_read_timeout(head_time)
        .max_buf_size(MAX_HEAD)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(stream), service)
        .await
}

/// Answers one request.
async fn answer(
    request: Request<Incoming>,
    peer: IpAddr,
    shared: &Arc<Shared>,
    slot: &SlotGuard,
) -> Response<Body> {
    let now = shared.now();
    let (head, body) = request.into_parts();
    let malformed = |why| response::closing(response::error(problem(Code::BadRequest, why)));
    if head.version != Version::HTTP_11 {
        return response::closing(response::plain(StatusCode::HTTP_VERSION_NOT_SUPPORTED));
    }
    if let Err(rejection) = shared.guard.admit(peer, &head.headers, now) {
        return response::rejection(&rejection);
    }
    if head.uri.scheme().is_some() || head.uri.authority().is_some() {
        return malformed("this server is not a proxy");
    }
    let address = head.uri.path_and_query().map_or(0, |a| a.as_str().len());
    if address > MAX_ADDRESS {
        return response::closing(response::plain(StatusCode::URI_TOO_LONG));
    }
    let route = match Route::of(&head.method, head.uri.path()) {
        Ok(route) => route,
        Err(no_route) => return response::closing(response::no_route(no_route)),
    };
    let has_body = head.headers.contains_key(TRANSFER_ENCODING)
        || head.headers.get(CONTENT_LENGTH).is_some_and(|v| v != "0");
    if !route.changes() && has_body {
        return malformed("a request that changes nothing has no body");
    }
    let allowed = if route.changes() {
        shared.guard.change(&head.headers)
    } else if matches!(route, Route::Page(_)) {
        Ok(())
    } else {
        shared.guard.check_read(&head.headers)
    };
    let allowed = allowed.and_then(|()| {
        if route.is_open() {
            return Ok(());
        }
        shared.guard.authenticate(peer, &head.headers, now)?;
        slot.set_stage(Stage::Authenticated);
        Ok(())
    });
    if let Err(rejection) = allowed {
        let response = response::rejection(&rejection);
        // An unread body must not be mistaken for the next request.
        return if has_body {
            response::closing(response)
        } else {
            response
        };
    }
    let result = match route {
        Route::Page(position) => Ok(page::file(position)),
        Route::Status => actions::status(shared).await,
        Route::Preview(camera) => actions::preview(shared, camera, head.uri.query()).await,
        Route::Act => actions::act(shared, &head, body).await,
        Route::Login => {
            let answer = actions::login(shared, peer, &head, body).await;
            if answer.as_ref().is_ok_and(|a| a.status().is_success()) {
                slot.set_stage(Stage::Authenticated);
            }
            answer
        }
        Route::Logout => actions::logout(shared, &head.headers).await,
        Route::Sessions => sessions::list(shared).await,
        Route::Manifest(name) => sessions::manifest(shared, name).await,
        Route::File(name, path) => {
            let empty = head.method == Method::HEAD;
            sessions::file(shared, name, path, &head.headers, empty).await
        }
        Route::Receipt(name) => sessions::receipt(shared, name, &head, body).await,
        Route::Free(name) => sessions::free(shared, name).await,
    };
    result.unwrap_or_else(response::error)
}
