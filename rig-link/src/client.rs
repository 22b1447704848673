//! The host's end: what a rig has, and its files.
//!
//! Contract. Every call waits for its answer. A connection that is lost, refused or silent is made anew, with
//! pauses that double, until [`Patience::tries`] in a row brought nothing; a download goes on where it was.
//! What the rig refuses is not tried again, except when it says that it was asked too often. Over HTTPS
//! the rig is known by the fingerprint of its certificate and by nothing else; plain HTTP goes to this
//! machine only. Nothing the rig says is trusted beyond that: names are checked, lengths and hashes
//! compared, and an answer that is none of *rig link v1* is an error.

mod address;
mod connection;
mod download;
mod pin;

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bytes::{Buf, Bytes, BytesMut};
use http_body_util::{BodyExt, Limited};
use hyper::body::Incoming;
use hyper::header::{CONTENT_RANGE, RETRY_AFTER};
use hyper::{Method, Response, StatusCode};
use serde::de::DeserializeOwned;
use tokio::runtime::{self, Runtime};
use tokio::time::{sleep, timeout};

use self::connection::Connection;
use self::pin::Tls;
use crate::identity::Fingerprint;
use crate::link::{
    self, Code, ErrorBody, FORMAT, FileEntry, Line, MAX_LINE, Manifest, Problem, Receipt,
    SessionSummary, Sessions, VERSION,
};
use crate::token::Token;

pub use self::address::Address;
pub use self::download::Downloaded;

/// Longest answer other than a file or a manifest, bytes.
const MAX_ANSWER: usize = 16 << 20;
/// Most files of a session.
const MAX_FILES: usize = 1 << 20;
/// Longest pause that a rig may ask for.
const MAX_RETRY_AFTER: Duration = Duration::from_secs(60);

/// How long to wait for a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// For a connection.
    pub connect: Duration,
    /// For the next byte.
    pub silence: Duration,
    /// Tries in a row that bring nothing.
    pub tries: u32,
    /// Pause after the first of them.
    pub pause: Duration,
    /// Longest pause.
    pub longest_pause: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            connect: Duration::from_secs(10),
            silence: Duration::from_secs(30),
            tries: 8,
            pause: Duration::from_millis(250),
            longest_pause: Duration::from_secs(15),
        }
    }
}

/// Why a rig could not be asked, or did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Write it as `https://HOST:8077`.
    #[error("{found:?} is no address of a rig: {reason}; expected https://HOST[:PORT]")]
    Address {
        /// What was given.
        found: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Use https.
    #[error("{address} is not on this machine; over a network a rig is asked with https only")]
    PlainText {
        /// The address.
        address: Address,
    },
    /// Compare it with what `pawsd` shows on the rig, then give it.
    #[error(
        "the rig's certificate has the fingerprint {found}; if that is what `pawsd` shows on the rig, give it with --fingerprint: {address}"
    )]
    NoFingerprint {
        /// The fingerprint that the rig showed.
        found: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Something else answers at this address, or the rig has a new identity. Look at what `pawsd` shows
    /// on the rig.
    #[error(
        "this is not the rig that is meant: its certificate has the fingerprint {found}, expected {expected}: {address}"
    )]
    WrongFingerprint {
        /// The fingerprint that was shown.
        found: Fingerprint,
        /// The one that was given.
        expected: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Is the rig on, and in the same network?
    #[error("{doing}: no answer after {tries} tries ({reason}): {address}")]
    Lost {
        /// What was being done.
        doing: String,
        /// Tries in a row that brought nothing.
        tries: u32,
        /// How the last one ended.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The rig says no; its code says what to do.
    #[error("{doing}: the rig says: {}", .problem.message)]
    Refused {
        /// What was being done.
        doing: String,
        /// What the rig says.
        problem: Problem,
    },
    /// What answers is no rig, or one of another version.
    #[error("{doing}: the answer is not one of rig link v{VERSION}: {reason}: {address}")]
    Garbled {
        /// What was being done.
        doing: String,
        /// What is wrong with it.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The file is not what the manifest said, even when fetched again from the start: fetch the manifest
    /// again. If it happens again, the rig's disk or memory is at fault.
    #[error("{path} came with the hash {found}, the rig's manifest says {expected}")]
    Corrupt {
        /// The file's path in the session.
        path: String,
        /// Hash of what came.
        found: String,
        /// Hash in the manifest.
        expected: String,
    },
    /// The host's disk says no.
    #[error("{doing}: {}", .path.display())]
    Disk {
        /// What was being done.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// The system gives no thread, socket or randomness.
    #[error("preparing to ask a rig")]
    System(#[source] io::Error),
}

/// How one try ended.
enum Failure {
    /// Trying again may help; how long the rig asked to wait, if it did.
    Again(String, Option<Duration>),
    Final(LinkError),
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        Self::Final(error)
    }
}

/// A connection to a rig, made when it is needed.
pub struct Client {
    address: Address,
    token: Option<Token>,
    patience: Patience,
    tls: Option<Arc<Tls>>,
    connection: Option<Connection>,
    runtime: Runtime,
}

impl Client {
    /// A client for the rig at `address`. Nothing is sent yet. With https and no fingerprint every call
    /// ends with [`LinkError::NoFingerprint`], which tells the rig's.
    ///
    /// # Errors
    /// [`LinkError::System`].
    pub fn new(
        address: Address,
        fingerprint: Option<Fingerprint>,
        token: Option<Token>,
        patience: Patience,
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
            patience,
            tls: tls.map(Arc::new),
            connection: None,
            runtime,
        })
    }

    /// The rig's address.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// What sessions the rig has.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn sessions(&mut self) -> Result<Vec<SessionSummary>, LinkError> {
        let doing = "asking for the list of sessions";
        let list: Sessions = self.ask(doing, Method::GET, "/api/sessions", None)?;
        if (list.format.as_str(), list.version) != (FORMAT, VERSION) {
            let reason = format!("format {:?}, version {}", list.format, list.version);
            return Err(self.garbled(doing, reason));
        }
        let odd = list
            .sessions
            .iter()
            .find(|s| !link::is_session_name(&s.name));
        if let Some(odd) = odd {
            return Err(self.garbled(doing, format!("{:?} is no name of a session", odd.name)));
        }
        Ok(list.sessions)
    }

    /// The files of a session with their hashes; `on_file` is told of each as it comes, from the start again
    /// if the connection is lost. The rig may have to read the whole session for it.
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
        let mut tries = Tries::default();
        loop {
            let result = block(&self.runtime, async {
                let response = send(
                    &mut self.connection,
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.patience,
                    &doing,
                    (Method::GET, &path, None, None),
                )
                .await?;
                let response = accepted(response, &doing, &self.patience).await?;
                let lines = Lines::new(response.into_body(), self.patience.silence);
                read_manifest(lines, &mut on_file).await
            });
            match result {
                Ok(manifest) => {
                    return check(manifest).map_err(|reason| self.garbled(&doing, reason));
                }
                Err(ManifestFailure::Failure(failure)) => {
                    self.again(&mut tries, &doing, failure)?
                }
                Err(ManifestFailure::Garbled(reason)) => return Err(self.garbled(&doing, reason)),
                Err(ManifestFailure::Refused(problem)) => {
                    return Err(LinkError::Refused { doing, problem });
                }
            }
        }
    }

    /// Bytes `from..length` of a file of `length` bytes, handed to `sink` as they come.
    ///
    /// # Errors
    /// See [`LinkError`]; an error of `sink` ends it at once.
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
        let mut tries = Tries::default();
        let mut at = from;
        while at < length {
            let before = at;
            let result = block(&self.runtime, async {
                let range = format!("bytes={at}-");
                let response = send(
                    &mut self.connection,
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.patience,
                    &doing,
                    (Method::GET, &path, None, Some(&range)),
                )
                .await?;
                let response = accepted(response, &doing, &self.patience).await?;
                let found = response.headers().get(CONTENT_RANGE);
                let found = found.and_then(|v| v.to_str().ok()).unwrap_or("none");
                let expected = format!("bytes {at}-{}/{length}", length - 1);
                if response.status() != StatusCode::PARTIAL_CONTENT || found != expected {
                    return Err(LinkError::Garbled {
                        doing: doing.clone(),
                        reason: format!(
                            "the rig sends {found:?}, expected {expected:?}; did the file change?"
                        ),
                        address: self.address.clone(),
                    }
                    .into());
                }
                let mut body = response.into_body();
                while let Some(piece) = next(&mut body, self.patience.silence).await? {
                    if piece.len() as u64 > length - at {
                        return Err(Failure::Again(
                            "more came than was asked for".to_owned(),
                            None,
                        ));
                    }
                    at += piece.len() as u64;
                    sink(&piece)?;
                }
                Ok(())
            });
            if at > before {
                tries = Tries::default();
            }
            match result {
                Ok(()) if at == length => {}
                Ok(()) => {
                    let short = Failure::Again("less came than was asked for".to_owned(), None);
                    self.again(&mut tries, &doing, short)?;
                }
                Err(failure) => self.again(&mut tries, &doing, failure)?,
            }
        }
        Ok(())
    }

    /// Gives the rig the host's word that it holds a session, checked and on disk.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub fn put_receipt(&mut self, session: &str, receipt: &Receipt) -> Result<(), LinkError> {
        let body = serde_json::to_vec(receipt).map_err(|e| LinkError::System(e.into()))?;
        let doing = format!("sending the receipt for {session}");
        let path = format!("/api/sessions/{}/receipt", link::to_address(session));
        self.order(&doing, &path, Some(body.into()))
    }

    /// Asks the rig to free a session for which it has a receipt.
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
        serde_json::from_slice(&text).map_err(|e| self.garbled(doing, e.to_string()))
    }

    /// A whole answer.
    fn answer(
        &mut self,
        doing: &str,
        method: Method,
        path: &str,
        body: Option<Bytes>,
    ) -> Result<Bytes, LinkError> {
        let mut tries = Tries::default();
        loop {
            let result = block(&self.runtime, async {
                let response = send(
                    &mut self.connection,
                    &self.address,
                    self.tls.as_deref(),
                    self.token.as_ref(),
                    &self.patience,
                    doing,
                    (method.clone(), path, body.clone(), None),
                )
                .await?;
                let response = accepted(response, doing, &self.patience).await?;
                whole(response.into_body(), &self.patience).await
            });
            match result {
                Ok(bytes) => return Ok(bytes),
                Err(failure) => self.again(&mut tries, doing, failure)?,
            }
        }
    }

    /// Pauses before the next try, or gives up.
    fn again(&mut self, tries: &mut Tries, doing: &str, failure: Failure) -> Result<(), LinkError> {
        let (reason, asked) = match failure {
            Failure::Final(error) => return Err(error),
            Failure::Again(reason, asked) => (reason, asked),
        };
        self.connection = None;
        tries.0 += 1;
        if tries.0 >= self.patience.tries {
            return Err(LinkError::Lost {
                doing: doing.to_owned(),
                tries: tries.0,
                reason,
                address: self.address.clone(),
            });
        }
        log::debug!("{doing}: {reason}; trying again");
        let doubled = self
            .patience
            .pause
            .saturating_mul(1 << (tries.0 - 1).min(16));
        let pause = doubled.min(self.patience.longest_pause);
        let pause = pause.max(asked.unwrap_or_default().min(MAX_RETRY_AFTER));
        self.runtime.block_on(async { sleep(pause).await });
        Ok(())
    }

    fn garbled(&self, doing: &str, reason: String) -> LinkError {
        LinkError::Garbled {
            doing: doing.to_owned(),
            reason,
            address: self.address.clone(),
        }
    }
}

/// Tries in a row that brought nothing.
#[derive(Default)]
struct Tries(u32);

fn block<T>(runtime: &Runtime, future: impl Future<Output = T>) -> T {
    runtime.block_on(future)
}

type Asked<'a> = (Method, &'a str, Option<Bytes>, Option<&'a str>);

/// Sends a request over the connection that there is, or over a new one.
async fn send(
    connection: &mut Option<Connection>,
    address: &Address,
    tls: Option<&Tls>,
    token: Option<&Token>,
    patience: &Patience,
    doing: &str,
    (method, path, body, range): Asked<'_>,
) -> Result<Response<Incoming>, Failure> {
    log::debug!("{doing}: {method} {path}");
    let open = match connection.take().filter(Connection::is_open) {
        Some(open) => open,
        None => connection::connect(address, tls, patience.connect).await?,
    };
    let open = connection.insert(open);
    let sent = open.send(address, token, method, path, body, range);
    match timeout(patience.silence, sent).await {
        Ok(Ok(response)) => Ok(response),
        Ok(Err(e)) => Err(Failure::Again(connection::describe(&*e), None)),
        Err(_) => Err(silent(patience.silence)),
    }
}

fn silent(limit: Duration) -> Failure {
    Failure::Again(format!("silent for {} s", limit.as_secs_f64()), None)
}

/// The answer, unless it is an error.
async fn accepted(
    response: Response<Incoming>,
    doing: &str,
    patience: &Patience,
) -> Result<Response<Incoming>, Failure> {
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let after = response.headers().get(RETRY_AFTER);
    let after = after.and_then(|v| v.to_str().ok()?.parse().ok());
    let body = whole(response.into_body(), patience).await?;
    let problem = match serde_json::from_slice::<ErrorBody>(&body) {
        Ok(body) => body.error,
        Err(_) => Problem {
            code: Code::Unknown,
            message: format!("status {status}"),
        },
    };
    if problem.code == Code::TooMany {
        return Err(Failure::Again(
            problem.message,
            after.map(Duration::from_secs),
        ));
    }
    Err(Failure::Final(LinkError::Refused {
        doing: doing.to_owned(),
        problem,
    }))
}

/// The next piece of a body; none at its end.
async fn next(body: &mut Incoming, silence: Duration) -> Result<Option<Bytes>, Failure> {
    loop {
        match timeout(silence, body.frame()).await {
            Err(_) => return Err(silent(silence)),
            Ok(None) => return Ok(None),
            Ok(Some(Err(e))) => return Err(Failure::Again(connection::describe(&e), None)),
            Ok(Some(Ok(frame))) => match frame.into_data() {
                Ok(data) => return Ok(Some(data)),
                Err(_trailers) => {}
            },
        }
    }
}

async fn whole(body: Incoming, patience: &Patience) -> Result<Bytes, Failure> {
    match timeout(patience.silence, Limited::new(body, MAX_ANSWER).collect()).await {
        Err(_) => Err(silent(patience.silence)),
        Ok(Err(e)) => Err(Failure::Again(e.to_string(), None)),
        Ok(Ok(body)) => Ok(body.to_bytes()),
    }
}

enum ManifestFailure {
    Failure(Failure),
    Garbled(String),
    Refused(Problem),
}

impl From<Failure> for ManifestFailure {
    fn from(failure: Failure) -> Self {
        Self::Failure(failure)
    }
}

/// The lines of a body. An empty one says that the rig is still at it.
struct Lines {
    body: Incoming,
    buffer: BytesMut,
    silence: Duration,
}

impl Lines {
    fn new(body: Incoming, silence: Duration) -> Self {
        Self {
            body,
            buffer: BytesMut::new(),
            silence,
        }
    }

    async fn next(&mut self) -> Result<Option<Line>, ManifestFailure> {
        loop {
            if let Some(end) = self.buffer.iter().position(|b| *b == b'\n') {
                let line = self.buffer.split_to(end);
                self.buffer.advance(1);
                if line.is_empty() {
                    continue;
                }
                let line = serde_json::from_slice(&line);
                return line
                    .map(Some)
                    .map_err(|e| ManifestFailure::Garbled(e.to_string()));
            }
            if self.buffer.len() > MAX_LINE {
                let reason = format!("a line of the manifest is longer than {MAX_LINE} bytes");
                return Err(ManifestFailure::Garbled(reason));
            }
            match next(&mut self.body, self.silence).await? {
                Some(piece) => self.buffer.extend_from_slice(&piece),
                None => return Ok(None),
            }
        }
    }
}

async fn read_manifest(
    mut lines: Lines,
    on_file: &mut impl FnMut(&FileEntry),
) -> Result<Manifest, ManifestFailure> {
    let mut files = Vec::new();
    loop {
        match lines.next().await? {
            Some(Line::File(entry)) if files.len() < MAX_FILES => {
                on_file(&entry);
                files.push(entry);
            }
            Some(Line::File(_)) => {
                return Err(ManifestFailure::Garbled(format!(
                    "more than {MAX_FILES} files"
                )));
            }
            Some(Line::Total(total)) => return Ok(Manifest { files, total }),
            Some(Line::Error(problem)) => return Err(ManifestFailure::Refused(problem)),
            None => {
                let cut = Failure::Again("the manifest was cut off".to_owned(), None);
                return Err(cut.into());
            }
        }
    }
}

/// A manifest that can be worked with: paths that stay in the folder, each once, and the sums are right.
fn check(manifest: Manifest) -> Result<Manifest, String> {
    let mut paths: Vec<&str> = manifest.files.iter().map(|f| f.path.as_str()).collect();
    if let Some(odd) = paths.iter().find(|path| !link::is_file_path(path)) {
        return Err(format!("{odd:?} is no path of a session's file"));
    }
    paths.sort_unstable();
    if let Some(twice) = paths.windows(2).find(|two| two[0] == two[1]) {
        return Err(format!("{:?} is there twice", twice[0]));
    }
    if let Some(odd) = manifest.files.iter().find(|f| !link::is_hash(&f.blake3)) {
        return Err(format!("{:?} is no hash", odd.blake3));
    }
    let mut bytes = manifest.files.iter().map(|f| f.bytes);
    if bytes.try_fold(0_u64, |sum, b| sum.checked_add(b)).is_none() {
        return Err("its files are longer than any disk".to_owned());
    }
    let total = link::total(&manifest.files);
    if total != manifest.total {
        return Err(format!(
            "its last line says {:?}, its files make {total:?}",
            manifest.total
        ));
    }
    Ok(manifest)
}
