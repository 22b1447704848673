//! The server: the phone's page, and sessions for hosts.
//!
//! Contract. On a loopback address it may use plain HTTP without a token; on every other address it
//! needs an [`Identity`] (TLS 1.3) and a [`Token`], and does not start without them. It runs on its
//! own thread, at low priority, with a few more for blocking work (disk, recorder); the recorder
//! never waits for it. Clients are limited in connections, in requests per second, in the time of a
//! head, a body or a stall, and in wrong tokens ([`Limits`]); beyond that they get an error or are
//! disconnected, and others are served as before. Unauthenticated clients take no connection from
//! authenticated ones (`server/connection_slots.rs`). A fault in one request ends that request.
//! Dropping the server stops it immediately; responses in transit are cut off.
//!
//! Requests: `server/route.rs`. Authorization: `server/guard.rs`. Files of a session:
//! [`crate::store`].

mod actions;
mod body;
mod connection_slots;
mod connections;
mod cookies;
mod guard;
mod limits;
mod page;
mod read_rate;
mod response;
mod route;
mod sessions;
mod stall_timeout;

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use tokio::runtime;
use tokio::sync::{Semaphore, oneshot};
use tokio_rustls::TlsAcceptor;

use self::guard::Guard;
use self::read_rate::ReadRateLimiter;
pub use crate::clock::{Clock, RealClock, Sleeping};
use crate::identity::{Fingerprint, Identity};
use crate::rig::Rig;
use crate::store::Store;
use crate::token::Token;

/// Default address of the server.
pub const DEFAULT_BIND: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 8077);
/// Nice value of the server's threads.
const NICE: i32 = 10;
/// Threads for blocking work.
const BLOCKING_THREADS: usize = 16;
/// Maximum number of files read simultaneously, for sending and for hashing.
const MAX_CONCURRENT_READS: usize = 4;
/// Maximum number of files hashed simultaneously.
const MAX_CONCURRENT_HASHES: usize = 2;
/// Maximum number of simultaneous calls to the recorder.
const MAX_RECORDER_CALLS: usize = 8;

/// Settings of the server.
#[derive(Debug)]
pub struct Settings {
    /// Address and port; port 0 selects a free one.
    pub bind: SocketAddr,
    /// Certificate for TLS. `None`: plain HTTP, on loopback only.
    pub identity: Option<Identity>,
    /// Token that clients need. `None`: open to all of this machine, on loopback only.
    pub token: Option<Token>,
    /// File with the logins that were ended by a logout; created with the first one. `None`: ended
    /// logins are valid again after a restart.
    pub ended_logins: Option<PathBuf>,
    /// Limits of clients.
    pub limits: Limits,
    /// Clock of the limits.
    pub clock: Arc<dyn Clock>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bind: DEFAULT_BIND,
            identity: None,
            token: None,
            ended_logins: None,
            limits: Limits::default(),
            clock: Arc::new(RealClock::default()),
        }
    }
}

/// Limits of clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum number of connections. When all are in use, unauthenticated ones are evicted,
    /// unfinished handshakes first.
    pub connections: usize,
    /// Maximum number of connections from one address (of IPv6: from one /64 network).
    pub connections_per_peer: usize,
    /// Timeout of the TLS handshake.
    pub handshake_time: Duration,
    /// Timeout of a request's head (from the end of the previous request), and of a body.
    pub head_time: Duration,
    /// Timeout of a peer that does not receive.
    pub stall_time: Duration,
    /// Sustained rate of requests from one address, Hz.
    pub requests_per_s: u32,
    /// Burst of requests from one address.
    pub request_burst: u32,
    /// Maximum length of a request's body, bytes.
    pub body_bytes: usize,
    /// First pause after a wrong token; it doubles with each further one, up to five minutes.
    pub wrong_token_pause: Duration,
    /// Wrong tokens in a row from all addresses before unknown addresses have to wait; one is
    /// forgiven every ten pauses.
    pub wrong_tokens: u32,
    /// Bytes read from disk per second while the rig records.
    pub recording_bytes_per_s: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 48,
            connections_per_peer: 16,
            handshake_time: Duration::from_secs(3),
            head_time: Duration::from_secs(10),
            stall_time: Duration::from_secs(60),
            requests_per_s: 50,
            request_burst: 200,
            body_bytes: 16 << 10,
            wrong_token_pause: Duration::from_secs(1),
            wrong_tokens: 30,
            recording_bytes_per_s: 20_000_000,
        }
    }
}

/// The server cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Configure a token, or stay on loopback.
    #[error(
        "serving on {bind}, which others can reach, needs a token; set one, or serve on 127.0.0.1"
    )]
    NoToken {
        /// Address.
        bind: SocketAddr,
    },
    /// Give an identity, or stay on loopback.
    #[error(
        "serving on {bind}, which others can reach, needs TLS; give it an identity, or serve on 127.0.0.1"
    )]
    NoIdentity {
        /// Address.
        bind: SocketAddr,
    },
    /// The identity cannot be used: remove it, so that a new one is created.
    #[error("setting up TLS")]
    Tls(#[from] rustls::Error),
    /// The address is in use, not of this machine, or not permitted.
    #[error("listening on {bind}")]
    Listen {
        /// Address.
        bind: SocketAddr,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}

/// A running server. Dropping it stops it.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    fingerprint: Option<Fingerprint>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The fingerprint of its certificate; `None` with plain HTTP.
    pub fn fingerprint(&self) -> Option<Fingerprint> {
        self.fingerprint
    }

    /// URL for the phone.
    pub fn url(&self) -> String {
        let scheme = if self.fingerprint.is_some() {
            "https"
        } else {
            "http"
        };
        format!("{scheme}://{}", self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// State shared by all requests.
struct Shared {
    rig: Arc<dyn Rig>,
    store: Store,
    guard: Guard,
    limits: Limits,
    read_rate: ReadRateLimiter,
    reads: Semaphore,
    hashes: Semaphore,
    asks: Semaphore,
    clock: Arc<dyn Clock>,
}

impl Shared {
    /// Time of the clock of the limits.
    fn now(&self) -> Duration {
        self.clock.now()
    }
}

/// Starts a server.
///
/// # Errors
/// See [`ServeError`].
pub fn serve(settings: Settings, rig: Arc<dyn Rig>) -> Result<Server, ServeError> {
    let Settings {
        bind,
        identity,
        token,
        ended_logins,
        limits,
        clock,
    } = settings;
    if !bind.ip().to_canonical().is_loopback() {
        if token.is_none() {
            return Err(ServeError::NoToken { bind });
        }
        if identity.is_none() {
            return Err(ServeError::NoIdentity { bind });
        }
    }
    let listen = |source| ServeError::Listen { bind, source };
    let tls = identity.as_ref().map(Identity::server_config).transpose()?;
    let tls = tls.map(|config| TlsAcceptor::from(Arc::new(config)));
    let listener = TcpListener::bind(bind).map_err(listen)?;
    listener.set_nonblocking(true).map_err(listen)?;
    let address = listener.local_addr().map_err(listen)?;
    let runtime = runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(BLOCKING_THREADS)
        .thread_name("rig-link-disk")
        .on_thread_start(lower_priority)
        .build()
        .map_err(listen)?;
    let (stop, stopped) = oneshot::channel();
    let serving = move || {
        lower_priority();
        let ended = runtime.block_on(async {
            let guard = Guard::new(
                token,
                ended_logins.as_deref(),
                tls.is_some(),
                address.ip(),
                &limits,
            );
            let shared = Arc::new(Shared {
                store: Store::new(rig.sessions_root()),
                guard,
                read_rate: ReadRateLimiter::new(limits.recording_bytes_per_s),
                reads: Semaphore::new(MAX_CONCURRENT_READS),
                hashes: Semaphore::new(MAX_CONCURRENT_HASHES),
                asks: Semaphore::new(MAX_RECORDER_CALLS),
                clock,
                rig,
                limits,
            });
            tokio::select! {
                ended = connections::accept(listener, tls, shared) => ended,
                _ = stopped => Ok(()),
            }
        });
        if let Err(e) = ended {
            log::error!("serving the rig's page: {e}");
        }
        // Blocking work may wait for the thread that drops the server.
        runtime.shutdown_background();
    };
    let thread = thread::Builder::new()
        .name("rig-link".into())
        .spawn(serving)
        .map_err(listen)?;
    Ok(Server {
        address,
        fingerprint: identity.as_ref().map(Identity::fingerprint),
        stop: Some(stop),
        thread: Some(thread),
    })
}

/// Lowers the priority of the calling thread. It matters only under load, so a failure is not an
/// error.
fn lower_priority() {
    if let Err(e) = rustix::process::setpriority_process(None, NICE) {
        log::debug!("lowering the priority of the page's threads: {e}");
    }
}
