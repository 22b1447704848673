//! Control from outside: one JSON object per line over a Unix socket.
//!
//! Contract of the server: each line is one [`Request`] and is answered by one [`Response`] line,
//! in order; several connections are served side by side. An invalid line is answered with an error
//! and the connection remains open, as is a request whose name or mark is too long or has control
//! characters ([`Request::check`], as on the page); a line longer than [`MAX_LINE_BYTES`] is
//! answered and the connection closed, as is a connection that is silent for [`IDLE_LIMIT`], or
//! whose line takes longer than [`LINE_LIMIT`]. With [`MAX_CONNECTIONS`] open, a new client
//! replaces the connection that has been without a request for longest, or, if all have one in
//! progress, gets an error: idle connections cannot keep others out. The socket has mode 0660: its
//! owner and its group may use it. A stale socket file is replaced; a live socket is not, nor is a
//! file of another kind. When the server is dropped the socket is removed, nothing more is read,
//! and requests that have arrived still get their answer.
//!
//! Contract of the client: [`request`] returns within [`answer_limit`] plus the time to connect,
//! with an answer or with an error that contains a remedy.

use std::collections::BTreeMap;
use std::fs::{self, File, Permissions};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rustix::fs::FlockOperation;
use session_archive::time::HostTime;

use crate::clock::{Clock, RealClock};
use crate::status::{Request, Response};

pub mod screen;

/// Maximum length of a request, bytes without the line break; the same as of a body on the page.
pub const MAX_LINE_BYTES: usize = 16 << 10;
/// Maximum length of an answer, bytes.
pub const MAX_ANSWER_BYTES: usize = 4 << 20;
/// Maximum number of simultaneous connections.
pub const MAX_CONNECTIONS: usize = 16;
/// Maximum time without a request on a connection.
pub const IDLE_LIMIT: Duration = Duration::from_secs(60);
/// Maximum time of a request from its first byte to its last.
pub const LINE_LIMIT: Duration = Duration::from_secs(5);
/// Time that the client waits for an answer, and the server for a client to take one.
pub const ANSWER_LIMIT: Duration = Duration::from_secs(15);
/// Time that the client waits for the answer to a stop, which comes when the session is closed.
const STOP_ANSWER_LIMIT: Duration = Duration::from_secs(45);

/// Pause after the system rejected an accept (no file descriptors, for example).
const RETRY: Duration = Duration::from_millis(200);

/// A running server. Dropping it ends it.
#[derive(Debug)]
pub struct Server {
    path: PathBuf,
    /// Device and inode of our socket: a later file at `path` may be another's.
    identity: (u64, u64),
    listener: UnixListener,
    connections: Arc<Connections>,
    /// Its end shows the accepting thread that an error is the end.
    running: Option<SyncSender<()>>,
    accepting: Option<JoinHandle<()>>,
}

/// Error of a request without an answer.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// Start the daemon, or give the path of its socket.
    #[error(
        "no pawsd answers; start it with `pawsd run --config FILE`, or name its socket with --socket: {}",
        path.display()
    )]
    NoDaemon {
        /// The socket.
        path: PathBuf,
    },
    /// Become a member of the socket's group.
    #[error("not allowed to use the control socket; are you in its group, and logged in again since? {}", path.display())]
    NotAllowed {
        /// The socket.
        path: PathBuf,
    },
    /// The daemon is frozen, or the request takes longer. Query the status.
    #[error("no answer from pawsd within {} s: {}", limit.as_secs(), path.display())]
    TimeOut {
        /// The socket.
        path: PathBuf,
        /// Time waited.
        limit: Duration,
    },
    /// The answer is not from a pawsd, or from another version.
    #[error("the answer is no answer of pawsd: {reason}: {}", path.display())]
    Garbled {
        /// The mismatch.
        reason: String,
        /// The socket.
        path: PathBuf,
    },
    /// The system returned an error.
    #[error("asking pawsd: {}", path.display())]
    Io {
        /// The socket.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// Listens at `path`. `handler` is called from several threads simultaneously.
///
/// # Errors
/// `AddrInUse` if a daemon answers at `path` or another kind of file exists there; otherwise the
/// system's error about the folder or the socket.
pub fn serve(
    path: &Path,
    handler: impl Fn(Request) -> Response + Send + Sync + 'static,
) -> io::Result<Server> {
    let listener = bind(path)?;
    let metadata = fs::symlink_metadata(path)?;
    let (running, stop) = mpsc::sync_channel(0);
    let connections = Arc::new(Connections::default());
    let accepting = thread::Builder::new().name("control".into()).spawn({
        let (listener, connections) = (listener.try_clone()?, connections.clone());
        move || accept(&listener, &connections, &Arc::new(handler), &stop)
    })?;
    Ok(Server {
        path: path.to_owned(),
        identity: (metadata.dev(), metadata.ino()),
        listener,
        connections,
        running: Some(running),
        accepting: Some(accepting),
    })
}

/// Time that the client waits for the answer to a request: longer than the daemon takes for one.
pub fn answer_limit(request: &Request) -> Duration {
    match request {
        Request::Stop => STOP_ANSWER_LIMIT,
        _ => ANSWER_LIMIT,
    }
}

/// Sends a request to the daemon at `path`.
///
/// # Errors
/// See [`ControlError`]. A rejected request has an answer: [`Response::Error`].
pub fn request(path: &Path, request: &Request) -> Result<Response, ControlError> {
    let limit = answer_limit(request);
    let failed = |source: io::Error| {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => {
                ControlError::NoDaemon { path }
            }
            io::ErrorKind::PermissionDenied => ControlError::NotAllowed { path },
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                ControlError::TimeOut { path, limit }
            }
            _ => ControlError::Io { path, source },
        }
    };
    let garbled = |reason: String| ControlError::Garbled {
        reason,
        path: path.to_owned(),
    };

    let stream = UnixStream::connect(path).map_err(failed)?;
    stream.set_read_timeout(Some(limit)).map_err(failed)?;
    stream.set_write_timeout(Some(limit)).map_err(failed)?;
    match send(&stream, request) {
        // A server with too many connections answers without reading.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        sent => sent.map_err(failed)?,
    }
    let line = receive(&mut BufReader::new(&stream), MAX_ANSWER_BYTES).map_err(failed)?;
    match line {
        Line::End => Err(garbled("the connection was closed without one".into())),
        Line::TooLong => Err(garbled(format!("longer than {MAX_ANSWER_BYTES} bytes"))),
        Line::Complete(line) => {
            serde_json::from_slice(&line).map_err(|error| garbled(error.to_string()))
        }
    }
}

/// The open connections, to be closed when the server ends.
#[derive(Debug, Default)]
struct Connections(Mutex<OpenConnections>);

#[derive(Debug, Default)]
struct OpenConnections {
    next: u64,
    connections: BTreeMap<u64, Connection>,
}

#[derive(Debug)]
struct Connection {
    stream: UnixStream,
    activity: Activity,
    /// Sequence number of the last change of activity; a lower one is older.
    since: u64,
}

/// Activity of a connection, in the order in which connections are replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Activity {
    /// Waits for a request, or for the rest of one.
    Listening,
    /// Its answer is being sent; the client may not take it.
    Answering,
    /// Its request is being processed.
    Handling,
}

impl OpenConnections {
    fn count(&mut self) -> u64 {
        self.next += 1;
        self.next
    }
}

/// Slot of one connection among the open ones.
struct ConnectionSlot {
    connections: Arc<Connections>,
    number: u64,
}

impl Connections {
    fn lock(&self) -> MutexGuard<'_, OpenConnections> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `None` if there are too many that are all being served.
    fn admit(self: &Arc<Self>, stream: &UnixStream) -> io::Result<Option<ConnectionSlot>> {
        let stream = stream.try_clone()?;
        let mut open = self.lock();
        if open.connections.len() >= MAX_CONNECTIONS {
            let waiting = open.connections.iter();
            let waiting = waiting.filter(|(_, c)| c.activity < Activity::Handling);
            let longest = waiting.min_by_key(|(_, c)| (c.activity, c.since));
            let Some(number) = longest.map(|(number, _)| *number) else {
                return Ok(None);
            };
            if let Some(connection) = open.connections.remove(&number) {
                // Its thread wakes from reading or writing, and ends.
                let _ = connection.stream.shutdown(Shutdown::Both);
            }
        }
        let number = open.count();
        let connection = Connection {
            stream,
            activity: Activity::Listening,
            since: number,
        };
        open.connections.insert(number, connection);
        Ok(Some(ConnectionSlot {
            connections: self.clone(),
            number,
        }))
    }
}

impl ConnectionSlot {
    /// False if the connection has been replaced.
    fn now(&self, activity: Activity) -> bool {
        let mut open = self.connections.lock();
        let since = open.count();
        let connection = open.connections.get_mut(&self.number);
        connection
            .map(|c| (c.activity, c.since) = (activity, since))
            .is_some()
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.connections.lock().connections.remove(&self.number);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let ours = |m: &fs::Metadata| (m.dev(), m.ino()) == self.identity;
        if fs::symlink_metadata(&self.path).is_ok_and(|m| ours(&m)) {
            let _ = fs::remove_file(&self.path);
        }
        self.running = None;
        // Wakes the accepting thread: on Linux, accept(2) fails on a socket that is shut down. Only
        // a stream has the call, and to the system a listener is one.
        let woken = self.listener.try_clone().and_then(|listener| {
            UnixStream::from(OwnedFd::from(listener)).shutdown(Shutdown::Both)
        });
        if let (Ok(()), Some(accepting)) = (woken, self.accepting.take()) {
            let _ = accepting.join();
        }
        // Not joined: a handler may be waiting for the very thread that drops this server.
        for connection in self.connections.lock().connections.values() {
            let _ = connection.stream.shutdown(Shutdown::Read);
        }
    }
}

fn bind(path: &Path) -> io::Result<UnixListener> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // Two daemons that start simultaneously must not replace each other's socket.
    let guard = File::open(folder)?;
    rustix::fs::flock(&guard, FlockOperation::LockExclusive)?;
    if let Ok(metadata) = fs::symlink_metadata(path) {
        let in_use = |what| {
            Err(io::Error::new(
                io::ErrorKind::AddrInUse,
                format!("{what}: {}", path.display()),
            ))
        };
        if !metadata.file_type().is_socket() {
            return in_use(
                "there is a file that is not a socket, remove it or choose another place",
            );
        }
        match UnixStream::connect(path) {
            Ok(_) => {
                return in_use(
                    "another daemon answers there already, stop it or choose another place",
                );
            }
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                fs::remove_file(path)?
            }
            Err(error) => return Err(error),
        }
    }
    let listener = UnixListener::bind(path)?;
    fs::set_permissions(path, Permissions::from_mode(0o660))?;
    Ok(listener)
}

fn accept(
    listener: &UnixListener,
    connections: &Arc<Connections>,
    handler: &Arc<impl Fn(Request) -> Response + Send + Sync + 'static>,
    stop: &Receiver<()>,
) {
    loop {
        let begun = listener
            .accept()
            .and_then(|(stream, _)| begin(stream, connections, handler));
        if let Err(error) = begun {
            if stop.recv_timeout(RETRY) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
            log::warn!("accepting a control connection: {error}");
        }
    }
}

fn begin(
    stream: UnixStream,
    connections: &Arc<Connections>,
    handler: &Arc<impl Fn(Request) -> Response + Send + Sync + 'static>,
) -> io::Result<()> {
    stream.set_write_timeout(Some(ANSWER_LIMIT))?;
    let Some(slot) = connections.admit(&stream)? else {
        let message = format!("{MAX_CONNECTIONS} requests are in hand already, try again later");
        // Fits into the socket's buffer, so nothing waits here; the client may have disconnected.
        let _ = send(&stream, &Response::Error { message });
        return Ok(());
    };
    let handler = handler.clone();
    thread::Builder::new()
        .name("control-conn".into())
        .spawn(move || {
            if let Err(error) = converse(&stream, &slot, &*handler) {
                log::debug!("a control connection ended: {error}");
            }
        })?;
    Ok(())
}

/// Reads with two limits: one for silence before a line, one for the whole line once it has begun.
struct DeadlineReader<'a> {
    stream: &'a UnixStream,
    clock: &'a dyn Clock,
    /// Deadline of the line that has begun.
    deadline: Option<HostTime>,
}

impl Read for DeadlineReader<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let left = match self.deadline {
            None => IDLE_LIMIT,
            Some(deadline) => {
                let left = deadline.since(self.clock.now());
                if left <= 0 {
                    return Err(io::ErrorKind::TimedOut.into());
                }
                Duration::from_nanos(left.unsigned_abs())
            }
        };
        self.stream.set_read_timeout(Some(left))?;
        let mut stream = self.stream;
        let read = stream.read(into)?;
        let end = || self.clock.now() + LINE_LIMIT.as_nanos() as i64;
        self.deadline.get_or_insert_with(end);
        Ok(read)
    }
}

fn converse(
    stream: &UnixStream,
    slot: &ConnectionSlot,
    handler: impl Fn(Request) -> Response,
) -> io::Result<()> {
    let mut lines = BufReader::new(DeadlineReader {
        stream,
        clock: &RealClock,
        deadline: None,
    });
    let answer = |line: &[u8]| -> Result<Response, String> {
        let request: Request = serde_json::from_slice(line).map_err(|error| {
            format!("reading a request: {error}; expected a line like {{\"do\":\"status\"}}")
        })?;
        request.check().map_err(|error| error.to_string())?;
        Ok(handler(request))
    };
    loop {
        lines.get_mut().deadline = None;
        match receive(&mut lines, MAX_LINE_BYTES)? {
            Line::End => return Ok(()),
            Line::TooLong => {
                let message = format!("reading a request: longer than {MAX_LINE_BYTES} bytes");
                return send(stream, &Response::Error { message });
            }
            Line::Complete(line) if line.trim_ascii().is_empty() => {}
            Line::Complete(line) => {
                if !slot.now(Activity::Handling) {
                    return Ok(());
                }
                let response = answer(&line).unwrap_or_else(|message| Response::Error { message });
                slot.now(Activity::Answering);
                send(stream, &response)?;
                slot.now(Activity::Listening);
            }
        }
    }
}

enum Line {
    /// Without the line break.
    Complete(Vec<u8>),
    TooLong,
    End,
}

fn receive(from: &mut impl BufRead, limit: usize) -> io::Result<Line> {
    let mut line = Vec::new();
    from.take(limit as u64 + 1).read_until(b'\n', &mut line)?;
    Ok(match line.last() {
        None => Line::End,
        Some(b'\n') => {
            line.pop();
            Line::Complete(line)
        }
        Some(_) if line.len() > limit => Line::TooLong,
        Some(_) => Line::Complete(line),
    })
}

fn send(mut to: &UnixStream, message: &impl serde::Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(message)?;
    line.push(b'\n');
    to.write_all(&line)
}

#[cfg(test)]
mod tests;
