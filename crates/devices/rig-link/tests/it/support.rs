//! A server with a fake rig, and a client that sends arbitrary bytes.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rig_link::client::{Client, RetryPolicy};
use rig_link::fake::{FakeRig, Scene, write_session};
use rig_link::identity::{Fingerprint, Identity};
use rig_link::server::{Clock, Limits, RealClock, Server, Settings, serve};
use rig_link::token::Token;

pub(crate) const TOKEN: &str = "correct-horse-battery";
/// Timeout of each step on a busy machine; reached only on a hang.
pub(crate) const TEST_TIMEOUT: Duration = Duration::from_secs(600);

/// A server with the sessions `walk-1` (being recorded if the test says so) and `walk-2`.
pub(crate) struct Setup {
    pub(crate) server: Server,
    pub(crate) rig: Arc<FakeRig>,
    pub(crate) root: PathBuf,
    pub(crate) identity: PathBuf,
    _folder: tempfile::TempDir,
}

pub(crate) struct Options {
    pub(crate) tls: bool,
    pub(crate) token: bool,
    pub(crate) limits: Limits,
    pub(crate) scene: Scene,
    pub(crate) clock: Arc<dyn Clock>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tls: false,
            token: false,
            limits: Limits::default(),
            scene: Scene::Armed,
            clock: Arc::new(RealClock::default()),
        }
    }
}

pub(crate) fn token() -> Token {
    Token::new(TOKEN).unwrap()
}

pub(crate) fn start(options: Options) -> Setup {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("sessions");
    let identity = folder.path().join("identity");
    std::fs::write(folder.path().join("secret"), "the secret").unwrap();
    write_session(&root, "walk-1", 1, 1);
    write_session(&root, "walk-2", 2, 8);
    let start = Instant::now();
    let rig = Arc::new(FakeRig::new(&root, options.scene, move || start.elapsed()));
    let settings = Settings {
        bind: "127.0.0.1:0".parse().unwrap(),
        identity: options
            .tls
            .then(|| Identity::load_or_create(&identity).unwrap()),
        token: options.token.then(token),
        ended_logins: Some(identity.join("ended-logins")),
        limits: options.limits,
        clock: options.clock,
    };
    Setup {
        server: serve(settings, rig.clone()).unwrap(),
        rig,
        root,
        identity,
        _folder: folder,
    }
}

impl Setup {
    /// A second server for the same rig, as after a restart; plain HTTP, with the token.
    pub(crate) fn again(&self) -> Server {
        let settings = Settings {
            bind: "127.0.0.1:0".parse().unwrap(),
            token: Some(token()),
            ended_logins: Some(self.identity.join("ended-logins")),
            ..Settings::default()
        };
        serve(settings, self.rig.clone()).unwrap()
    }

    pub(crate) fn client(&self) -> Client {
        self.client_with(self.server.fingerprint(), Some(token()), short_retry())
    }

    pub(crate) fn client_with(
        &self,
        fingerprint: Option<Fingerprint>,
        token: Option<Token>,
        retry: RetryPolicy,
    ) -> Client {
        let address = self.server.url().parse().unwrap();
        Client::new(address, fingerprint, token, retry).unwrap()
    }

    /// Sends these bytes and returns the response until the connection ends.
    pub(crate) fn raw(&self, bytes: impl AsRef<[u8]>) -> String {
        raw(self.server.address(), bytes.as_ref())
    }

    /// As [`Self::raw`], if the server does not close the connection: after a second without data
    /// the client ends its side.
    pub(crate) fn raw_and_done(&self, bytes: impl AsRef<[u8]>) -> String {
        let mut stream = TcpStream::connect(self.server.address()).unwrap();
        let _ = stream.write_all(bytes.as_ref());
        stream
            .set_read_timeout(Some(Duration::from_secs(1)))
            .unwrap();
        let mut all = read(&mut stream);
        let _ = stream.shutdown(Shutdown::Write);
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        all.extend(read(&mut stream));
        String::from_utf8_lossy(&all).into_owned()
    }

    /// A well-formed request with these headers, on a connection of its own.
    pub(crate) fn request(&self, line: &str, headers: &str, body: &str) -> String {
        self.raw(format!(
            "{line} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n{headers}\r\n{body}",
            self.server.address()
        ))
    }

    pub(crate) fn get(&self, path: &str) -> String {
        self.request(&format!("GET {path}"), "", "")
    }

    /// A POST with JSON, as a program sends it.
    pub(crate) fn post(&self, path: &str, headers: &str, body: &str) -> String {
        let length = body.len();
        let headers =
            format!("{headers}Content-Type: application/json\r\nContent-Length: {length}\r\n");
        self.request(&format!("POST {path}"), &headers, body)
    }

    /// Checks that the server still responds.
    pub(crate) fn is_well(&self) {
        let answer = self.request("GET /api/status", &bearer(TOKEN), "");
        assert_eq!(status(&answer), 200, "{answer}");
        assert!(answer.contains("\"state\""), "{answer}");
    }
}

pub(crate) fn bearer(token: &str) -> String {
    format!("Authorization: Bearer {token}\r\n")
}

/// A policy with few attempts.
pub(crate) fn short_retry() -> RetryPolicy {
    RetryPolicy {
        connect_timeout: Duration::from_secs(60),
        read_timeout: Duration::from_secs(60),
        max_attempts: 4,
        first_pause: Duration::from_millis(10),
        max_pause: Duration::from_millis(100),
    }
}

pub(crate) fn raw(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
    // The server may close the connection before it has read everything.
    let _ = stream.write_all(bytes);
    String::from_utf8_lossy(&read(&mut stream)).into_owned()
}

/// Everything until the end, an error, or a pause.
pub(crate) fn read(stream: &mut TcpStream) -> Vec<u8> {
    let mut all = Vec::new();
    let mut block = [0; 65536];
    loop {
        match stream.read(&mut block) {
            Ok(0) => return all,
            Ok(n) => all.extend_from_slice(&block[..n]),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => return all,
        }
    }
}

/// One response on a connection that is kept open.
pub(crate) fn read_one(stream: &mut TcpStream) -> String {
    stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
    let mut all = Vec::new();
    let mut block = [0; 4096];
    loop {
        let text = String::from_utf8_lossy(&all).into_owned();
        if let Some((head, body)) = text.split_once("\r\n\r\n") {
            let length = head
                .lines()
                .find_map(|l| l.strip_prefix("content-length: "))
                .map_or(0, |l| l.parse().unwrap());
            if body.len() >= length {
                return text;
            }
        }
        match stream.read(&mut block) {
            Ok(n) if n > 0 => all.extend_from_slice(&block[..n]),
            _ => return text,
        }
    }
}

/// A connection from this loopback address (127.0.0.0/8).
pub(crate) fn connect_from(from: [u8; 4], to: SocketAddr) -> TcpStream {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()
        .unwrap();
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind((from, 0).into()).unwrap();
        socket.connect(to).await.unwrap().into_std().unwrap()
    });
    stream.set_nonblocking(false).unwrap();
    stream
}

/// The status of a response; 0 if there was none.
pub(crate) fn status(answer: &str) -> u16 {
    let status = answer.strip_prefix("HTTP/1.1 ").and_then(|a| a.get(..3));
    status.and_then(|s| s.parse().ok()).unwrap_or(0)
}
