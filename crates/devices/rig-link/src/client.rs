//! The host's end: a rig's sessions and their files.
//!
//! Contract. Every call waits for its response. Before the first connection, it gives up after
//! [`RetryPolicy::connect_timeout`] for all attempts: most likely there is no server. After that a
//! connection that is lost, refused or silent is reopened, with pauses that double, until
//! [`RetryPolicy::max_attempts`] in a row made no progress; a download resumes. Each retry is
//! logged as a warning. Requests that the rig rejects are not repeated, except after `too_many`.
//! Over HTTPS the rig is authenticated by the fingerprint of its certificate only; plain HTTP goes
//! to this machine only. Data from the rig is not trusted beyond that: names are checked, lengths
//! and hashes compared, and a response that does not follow *rig link v1* is an error.

mod address;
mod connection;
mod download;
mod error;
mod manifest;
mod pin;

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Limited};
use hyper::body::Incoming;
use hyper::header::{CONTENT_RANGE, RETRY_AFTER};
use hyper::{Method, Response, StatusCode};
use serde::de::DeserializeOwned;
use tokio::runtime::{self, Runtime};
use tokio::time::{Instant, sleep, timeout};

use self::connection::Connection;
use self::manifest::{Lines, ManifestFailure, check, read_manifest};
use self::pin::Tls;
use crate::identity::Fingerprint;
use crate::link::{
    self, Code, ErrorBody, FORMAT, FileEntry, Manifest, Problem, Receipt, SessionSummary, Sessions,
    VERSION,
};
use crate::token::Token;

pub use self::address::Address;
pub use self::download::DownloadStats;
pub use self::error::LinkError;

/// Maximum length of a response other than a file or a manifest, bytes.
const MAX_ANSWER: usize = 16 << 20;
/// Maximum `Retry-After` that is respected.
const MAX_RETRY_AFTER: Duration = Duration::from_secs(60);

/// Timeouts and retries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetryPolicy {
    /// Timeout of a connection attempt. For the first connection, of all attempts together.
    pub connect_timeout: Duration,
    /// Timeout for the next byte.
    pub read_timeout: Duration,
    /// Maximum attempts in a row without progress.
    pub max_attempts: u32,
    /// Pause after the first failed attempt; it doubles.
    pub first_pause: Duration,
    /// Maximum pause.
    pub max_pause: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(10),
            read_timeout: Duration::from_secs(30),
            max_attempts: 8,
            first_pause: Duration::from_millis(250),
            max_pause: Duration::from_secs(15),
        }
    }
}

/// Failure of one attempt.
enum Failure {
    /// A retry may help; with the `Retry-After` of the rig, if any.
    Retry(String, Option<Duration>),
    Final(LinkError),
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        Self::Final(error)
    }
}

/// A client of a rig; connects when needed.
pub struct Client {
    address: Address,
    token: Option<Token>,
    retry: RetryPolicy,
    tls: Option<Arc<Tls>>,
    connection: Option<Connection>,
    contact: ContactState,
    runtime: Background,
}

/// Whether there was a connection before.
#[derive(Default)]
struct ContactState {
    /// Time of the first attempt.
    begun: Option<Instant>,
    made: bool,
}

impl ContactState {
    /// Timeout of the next connection attempt.
    fn limit(&mut self, retry: &RetryPolicy) -> Duration {
        let begun = *self.begun.get_or_insert_with(Instant::now);
        match self.made {
            true => retry.connect_timeout,
            false => retry.connect_timeout.saturating_sub(begun.elapsed()),
        }
    }
}

/// A runtime that is dropped without waiting for its threads, which may still resolve a name.
struct Background(Option<Runtime>);

impl Background {
    fn block_on<T>(&self, future: impl Future<Output = T>) -> T {
        let runtime = self.0.as_ref().expect("it is taken at the end only");
        runtime.block_on(future)
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

impl Client {
    /// A client for the rig at `address`. Nothing is sent yet. With https and no fingerprint every
    /// call fails with [`LinkError::NoFingerprint`], which contains the rig's.
    ///
    /// # Errors
    /// [`LinkError::System`].
    pub fn new(
        address: Address,
        fingerprint: Option<Fingerprint>,
        token: Option<Token>,
        retry: RetryPolicy,
    ) -> Result<Self, LinkError> {
        let runtime = runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .thread_name("rig-names")
            .build()
            .map_err(LinkError::System)?;
        let tls = address.tls.then(|| Tls::new(fingerprint)).transpose()?;
        Ok(Self {
            address,
            token,
            retry,
            tls: tls.map(Arc::new),
            connection: None,
            contact: ContactState::default(),
            runtime: Background(Some(runtime)),
        })
    }

    /// The rig's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// The sessions of the rig.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn sessions(&mut self) -> Result<Vec<SessionSummary>, LinkError> {
        let doing = "asking for the list of sessions";
        let list: Sessions = self.ask(doing, Method::GET, "/api/sessions", None)?;
        if (list.format.as_str(), list.version) != (FORMAT, VERSION) {
            let reason = format!("format {:?}, version {}", list.format, list.version);
            return Err(self.malformed(doing, reason));
        }
        let odd = list
            .sessions
            .iter()
            .find(|s| !link::is_session_name(&s.name));
        if let Some(odd) = odd {
            return Err(self.malformed(doing, format!("{:?} is not a session name", odd.name)));
        }
        Ok(list.sessions)
    }

    /// The files of a session with their hashes; `on_file` is called for each as it arrives, from
    /// the start again if the connection is lost. The rig may have to read the whole session.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn manifest(
        &mut self,
        session: &str,
        mut on_file: impl FnMut(&FileEntry),
    ) -> Result<Manifest, LinkError> {
        let doing = format!("asking for the files of {session}");
        let path = format!("/api/sessions/{}/manifest", link::to_address(session));
        let mut tries = FailedAttempts::default();
        loop {
            let result = block(&self.runtime, async {
                let response = send(
                    (&mut self.connection, &mut self.contact),
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.retry,
                    &doing,
                    (Method::GET, &path, None, None),
                )
                .await?;
                let response = check_status(response, &doing, &self.retry).await?;
                let lines = Lines::new(response.into_body(), self.retry.read_timeout);
                read_manifest(lines, &mut on_file).await
            });
            match result {
                Ok(manifest) => {
                    return check(manifest).map_err(|reason| self.malformed(&doing, reason));
                }
                Err(ManifestFailure::Failure(failure)) => {
                    self.retry_or_fail(&mut tries, &doing, failure)?
                }
                Err(ManifestFailure::Malformed(reason)) => {
                    return Err(self.malformed(&doing, reason));
                }
                Err(ManifestFailure::Refused(problem)) => {
                    return Err(LinkError::Rejected { doing, problem });
                }
            }
        }
    }

    /// Bytes `from..length` of a file of `length` bytes, passed to `sink` as they arrive.
    ///
    /// # Errors
    /// See [`LinkError`]; an error of `sink` aborts the download.
    pub fn fetch(
        &mut self,
        session: &str,
        file: &str,
        from: u64,
        length: u64,
        mut sink: impl FnMut(&[u8]) -> Result<(), LinkError>,
    ) -> Result<(), LinkError> {
        let doing = format!("fetching {file} of {session}");
        let path = format!(
            "/api/sessions/{}/files/{}",
            link::to_address(session),
            link::to_address(file)
        );
        let mut tries = FailedAttempts::default();
        let mut at = from;
        while at < length {
            let before = at;
            let result = block(&self.runtime, async {
                let range = format!("bytes={at}-");
                let response = send(
                    (&mut self.connection, &mut self.contact),
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.retry,
                    &doing,
                    (Method::GET, &path, None, Some(&range)),
                )
                .await?;
                let response = check_status(response, &doing, &self.retry).await?;
                let found = response.headers().get(CONTENT_RANGE);
                let found = found.and_then(|v| v.to_str().ok()).unwrap_or("none");
                let expected = format!("bytes {at}-{}/{length}", length - 1);
                if response.status() != StatusCode::PARTIAL_CONTENT || found != expected {
                    return Err(LinkError::Malformed {
                        doing: doing.clone(),
                        reason: format!(
                            "the rig sends {found:?}, expected {expected:?}; did the file change?"
                        ),
                        address: self.address.clone(),
                    }
                    .into());
                }
                let mut body = response.into_body();
                while let Some(piece) = next(&mut body, self.retry.read_timeout).await? {
                    if piece.len() as u64 > length - at {
                        return Err(Failure::Retry("more bytes than requested".to_owned(), None));
                    }
                    at += piece.len() as u64;
                    sink(&piece)?;
                }
                Ok(())
            });
            if at > before {
                tries = FailedAttempts::default();
            }
            match result {
                Ok(()) if at == length => {}
                Ok(()) => {
                    let short = Failure::Retry("fewer bytes than requested".to_owned(), None);
                    self.retry_or_fail(&mut tries, &doing, short)?;
                }
                Err(failure) => self.retry_or_fail(&mut tries, &doing, failure)?,
            }
        }
        Ok(())
    }

    /// Sends a receipt: the host holds the session, verified and synced.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn put_receipt(&mut self, session: &str, receipt: &Receipt) -> Result<(), LinkError> {
        let body = serde_json::to_vec(receipt).map_err(|e| LinkError::System(e.into()))?;
        let doing = format!("sending the receipt for {session}");
        let path = format!("/api/sessions/{}/receipt", link::to_address(session));
        self.order(&doing, &path, Some(body.into()))
    }

    /// Requests to free a session for which the rig has a receipt.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn free(&mut self, session: &str) -> Result<(), LinkError> {
        let doing = format!("asking the rig to free {session}");
        let path = format!("/api/sessions/{}/free", link::to_address(session));
        self.order(&doing, &path, None)
    }

    fn order(&mut self, doing: &str, path: &str, body: Option<Bytes>) -> Result<(), LinkError> {
        self.answer(doing, Method::POST, path, body).map(drop)
    }

    fn ask<T: DeserializeOwned>(
        &mut self,
        doing: &str,
        method: Method,
        path: &str,
        body: Option<Bytes>,
    ) -> Result<T, LinkError> {
        let text = self.answer(doing, method, path, body)?;
        serde_json::from_slice(&text).map_err(|e| self.malformed(doing, e.to_string()))
    }

    /// Requests a complete response.
    fn answer(
        &mut self,
        doing: &str,
        method: Method,
        path: &str,
        body: Option<Bytes>,
    ) -> Result<Bytes, LinkError> {
        let mut tries = FailedAttempts::default();
        loop {
            let result = block(&self.runtime, async {
                let response = send(
                    (&mut self.connection, &mut self.contact),
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.retry,
                    doing,
                    (method.clone(), path, body.clone(), None),
                )
                .await?;
                let response = check_status(response, doing, &self.retry).await?;
                read_all(response.into_body(), &self.retry).await
            });
            match result {
                Ok(bytes) => return Ok(bytes),
                Err(failure) => self.retry_or_fail(&mut tries, doing, failure)?,
            }
        }
    }

    /// Pauses before the next attempt, or gives up.
    fn retry_or_fail(
        &mut self,
        tries: &mut FailedAttempts,
        doing: &str,
        failure: Failure,
    ) -> Result<(), LinkError> {
        let (reason, requested) = match failure {
            Failure::Final(error) => return Err(error),
            Failure::Retry(reason, requested) => (reason, requested),
        };
        self.connection = None;
        tries.0 += 1;
        let doubled = self
            .retry
            .first_pause
            .saturating_mul(1 << (tries.0 - 1).min(16));
        let pause = doubled.min(self.retry.max_pause);
        let pause = pause.max(requested.unwrap_or_default().min(MAX_RETRY_AFTER));
        let is_hopeless = !self.contact.made && pause >= self.contact.limit(&self.retry);
        if tries.0 >= self.retry.max_attempts || is_hopeless {
            return Err(LinkError::NoResponse {
                doing: doing.to_owned(),
                tries: tries.0,
                reason,
                address: self.address.clone(),
            });
        }
        log::warn!(
            "{doing}: {reason}; try {} of {} in {:.1} s",
            tries.0 + 1,
            self.retry.max_attempts,
            pause.as_secs_f64()
        );
        self.runtime.block_on(async { sleep(pause).await });
        Ok(())
    }

    fn malformed(&self, doing: &str, reason: String) -> LinkError {
        LinkError::Malformed {
            doing: doing.to_owned(),
            reason,
            address: self.address.clone(),
        }
    }
}

/// Number of failed attempts in a row.
#[derive(Default)]
struct FailedAttempts(u32);

fn block<T>(runtime: &Background, future: impl Future<Output = T>) -> T {
    runtime.block_on(future)
}

type RequestParts<'a> = (Method, &'a str, Option<Bytes>, Option<&'a str>);

/// Sends a request over the open connection, or over a new one.
async fn send(
    (connection, contact): (&mut Option<Connection>, &mut ContactState),
    address: &Address,
    tls: Option<&Tls>,
    token: Option<&Token>,
    retry: &RetryPolicy,
    doing: &str,
    (method, path, body, range): RequestParts<'_>,
) -> Result<Response<Incoming>, Failure> {
    log::debug!("{doing}: {method} {path}");
    let open = match connection.take().filter(Connection::is_open) {
        Some(open) => open,
        None => connection::connect(address, tls, contact.limit(retry)).await?,
    };
    contact.made = true;
    let open = connection.insert(open);
    let sent = open.send(address, token, method, path, body, range);
    match timeout(retry.read_timeout, sent).await {
        Ok(Ok(response)) => Ok(response),
        Ok(Err(e)) => Err(Failure::Retry(connection::describe(&*e), None)),
        Err(_) => Err(silent(retry.read_timeout)),
    }
}

fn silent(limit: Duration) -> Failure {
    Failure::Retry(format!("silent for {} s", limit.as_secs_f64()), None)
}

/// The response, unless it is an error.
async fn check_status(
    response: Response<Incoming>,
    doing: &str,
    retry: &RetryPolicy,
) -> Result<Response<Incoming>, Failure> {
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let after = response.headers().get(RETRY_AFTER);
    let after = after.and_then(|v| v.to_str().ok()?.parse().ok());
    let body = read_all(response.into_body(), retry).await?;
    let problem = match serde_json::from_slice::<ErrorBody>(&body) {
        Ok(body) => body.error,
        Err(_) => Problem {
            code: Code::Unknown,
            message: format!("status {status}"),
        },
    };
    if problem.code == Code::TooMany {
        return Err(Failure::Retry(
            problem.message,
            after.map(Duration::from_secs),
        ));
    }
    Err(Failure::Final(LinkError::Rejected {
        doing: doing.to_owned(),
        problem,
    }))
}

/// The next piece of a body; `None` at its end.
async fn next(body: &mut Incoming, silence: Duration) -> Result<Option<Bytes>, Failure> {
    loop {
        match timeout(silence, body.frame()).await {
            Err(_) => return Err(silent(silence)),
            Ok(None) => return Ok(None),
            Ok(Some(Err(e))) => return Err(Failure::Retry(connection::describe(&e), None)),
            Ok(Some(Ok(frame))) => match frame.into_data() {
                Ok(data) => return Ok(Some(data)),
                Err(_trailers) => {}
            },
        }
    }
}

async fn read_all(body: Incoming, retry: &RetryPolicy) -> Result<Bytes, Failure> {
    match timeout(retry.read_timeout, Limited::new(body, MAX_ANSWER).collect()).await {
        Err(_) => Err(silent(retry.read_timeout)),
        Ok(Err(e)) => Err(Failure::Retry(e.to_string(), None)),
        Ok(Ok(body)) => Ok(body.to_bytes()),
    }
}
