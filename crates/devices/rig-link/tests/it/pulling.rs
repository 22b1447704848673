//! Pulling sessions over broken connections and with corrupted bytes.

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use rig_link::client::{Client, LinkError, RetryPolicy};
use rig_link::link::{Code, RECEIPT_FORMAT, Receipt, SessionState, Total, VERSION};
use rig_link::server::Limits;

use crate::support::{Options, Setup, short_retry, start, token};

/// A proxy that corrupts or cuts the server's data.
struct Proxy {
    address: SocketAddr,
    connections: Arc<AtomicUsize>,
}

/// Fault of connection number `n`: the number of server bytes before it is cut, and the position of
/// a flipped byte.
type Fault = dyn Fn(usize) -> (usize, Option<usize>) + Send + Sync;

impl Proxy {
    fn new(to: SocketAddr, fault: Box<Fault>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let connections = Arc::new(AtomicUsize::new(0));
        let count = connections.clone();
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let Ok(client) = client else { return };
                let n = count.fetch_add(1, Ordering::SeqCst);
                let (cut, flip) = fault(n);
                std::thread::spawn(move || carry(client, to, cut, flip));
            }
        });
        Self {
            address,
            connections,
        }
    }

    fn client(&self) -> Client {
        let address = format!("http://{}", self.address).parse().unwrap();
        Client::new(address, None, Some(token()), short_retry()).unwrap()
    }
}

fn carry(client: TcpStream, to: SocketAddr, mut cut: usize, mut flip: Option<usize>) {
    let server = TcpStream::connect(to).unwrap();
    let (mut from, mut into) = (client.try_clone().unwrap(), server.try_clone().unwrap());
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut from, &mut into);
        let _ = into.shutdown(Shutdown::Both);
    });
    let (mut from, mut into) = (server, client);
    let mut block = [0; 10_000];
    while let Ok(n) = from.read(&mut block) {
        let n = n.min(cut);
        cut -= n;
        if let Some(at) = &mut flip {
            if *at < n {
                block[*at] ^= 1;
                flip = None;
            } else {
                *at -= n;
            }
        }
        if n == 0 || into.write_all(&block[..n]).is_err() || cut == 0 {
            break;
        }
    }
    let _ = into.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}

fn receipt(session_id: &str, total: &Total) -> Receipt {
    Receipt {
        format: RECEIPT_FORMAT.to_owned(),
        version: VERSION,
        session_id: session_id.to_owned(),
        list: total.list.clone(),
        files: total.files,
        bytes: total.bytes,
        host: "desk".to_owned(),
        verified_ns: 1_790_000_000_000_000_000,
    }
}

/// Fetches every file of `walk-2` and compares it.
fn pull(setup: &Setup, client: &mut Client) -> Total {
    let folder = tempfile::tempdir().unwrap();
    let manifest = client.manifest("walk-2", |_| {}).unwrap();
    for (i, entry) in manifest.files.iter().enumerate() {
        let path = folder.path().join(i.to_string());
        let mut reported = 0;
        client
            .download("walk-2", entry, &path, |n| reported += n)
            .unwrap();
        let expected = fs::read(setup.root.join("walk-2").join(&entry.path)).unwrap();
        assert!(fs::read(&path).unwrap() == expected, "{}", entry.path);
        assert_eq!(reported, entry.bytes);
    }
    manifest.total
}

#[test]
fn session_is_downloaded_acknowledged_and_freed() {
    for tls in [false, true] {
        let setup = start(Options {
            tls,
            token: true,
            ..Options::default()
        });
        fs::write(setup.root.join("walk-2/rig/empty"), "").unwrap();
        fs::write(setup.root.join("walk-2/rig/odd name%2f\u{e4}#?.yaml"), "x").unwrap();
        let mut client = setup.client();
        let sessions = client.sessions().unwrap();
        let names: Vec<_> = sessions.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["walk-1", "walk-2"]);
        assert_eq!(
            (sessions[1].state, &sessions[1].receipt),
            (SessionState::Closed, &None)
        );
        let total = pull(&setup, &mut client);
        assert_eq!(
            (total.bytes, total.files),
            (sessions[1].bytes, sessions[1].files)
        );

        let refused = |result: Result<(), LinkError>| match result {
            Err(LinkError::Rejected { problem, .. }) => problem.code,
            other => panic!("{other:?}"),
        };
        assert_eq!(refused(client.free("walk-2")), Code::NoReceipt);
        let id = sessions[1].session_id.clone().unwrap();
        let mut wrong = receipt(&id, &total);
        wrong.list = "0".repeat(64);
        assert_eq!(
            refused(client.put_receipt("walk-2", &wrong)),
            Code::ListDiffers
        );
        client.put_receipt("walk-2", &receipt(&id, &total)).unwrap();
        let listed = client.sessions().unwrap().remove(1);
        assert_eq!(listed.receipt, Some(receipt(&id, &total)));
        // A file is added on the rig: the receipt no longer matches.
        let notes = setup.root.join("walk-2/rig/notes.txt");
        fs::write(&notes, "rain").unwrap();
        assert_eq!(refused(client.free("walk-2")), Code::ManifestFirst);
        client.manifest("walk-2", |_| {}).unwrap();
        assert_eq!(refused(client.free("walk-2")), Code::ListDiffers);
        fs::remove_file(&notes).unwrap();
        client.free("walk-2").unwrap();
        assert!(!setup.root.join("walk-2").exists());
        assert!(setup.root.join("walk-1").exists());
        assert!(setup.root.join("receipts/walk-2.json").exists());
        assert_eq!(refused(client.free("walk-2")), Code::NotFound);
    }
}

#[test]
fn download_survives_repeatedly_broken_connections() {
    let setup = start(Options::default());
    // Every connection carries a little more, so that finally even the longest response passes.
    let proxy = Proxy::new(setup.server.address(), Box::new(|n| (700 + n * 9000, None)));
    let mut client = proxy.client();
    pull(&setup, &mut client);
    let connections = proxy.connections.load(Ordering::SeqCst);
    assert!(connections > 5, "{connections}");
}

#[test]
fn connection_without_progress_is_given_up() {
    let setup = start(Options::default());
    let proxy = Proxy::new(setup.server.address(), Box::new(|_| (0, None)));
    let error = proxy.client().manifest("walk-2", |_| {}).unwrap_err();
    assert!(
        matches!(error, LinkError::NoResponse { tries: 4, .. }),
        "{error}"
    );
    // Half a response, always the same half: no progress either.
    let proxy = Proxy::new(setup.server.address(), Box::new(|_| (900, None)));
    let error = proxy.client().manifest("walk-2", |_| {}).unwrap_err();
    assert!(
        matches!(error, LinkError::NoResponse { tries: 4, .. }),
        "{error}"
    );
}

#[test]
fn partial_download_is_reused_if_correct() {
    let setup = start(Options::default());
    let mut client = setup.client();
    let manifest = client.manifest("walk-2", |_| {}).unwrap();
    let entry = manifest
        .files
        .iter()
        .find(|f| f.path.ends_with("mcap"))
        .unwrap();
    let whole = fs::read(setup.root.join("walk-2").join(&entry.path)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    let half = whole.len() / 2;
    let mut damaged = whole[..half].to_vec();
    damaged[1000] ^= 1;
    let longer = [&whole[..], b"more"].concat();
    let length = whole.len() as u64;
    for (there, resumed, fetched, wasted) in [
        (&whole[..half], half as u64, length - half as u64, 0),
        (&whole[..], length, 0, 0),
        (&[][..], 0, length, 0),
        // Wrong bytes in the first half: downloaded again from the start.
        (
            &damaged[..],
            0,
            length - half as u64 + length,
            length - half as u64,
        ),
        // Longer than the file.
        (&longer[..], 0, length, 0),
    ] {
        fs::write(&path, there).unwrap();
        let done = client.download("walk-2", entry, &path, |_| {}).unwrap();
        assert!(fs::read(&path).unwrap() == whole);
        assert_eq!(
            (done.resumed, done.fetched, done.wasted),
            (resumed, fetched, wasted)
        );
    }
}

#[test]
fn changed_byte_is_downloaded_again_and_then_an_error() {
    let setup = start(Options::default());
    let mut client = setup.client();
    let manifest = client.manifest("walk-2", |_| {}).unwrap();
    let entry = manifest
        .files
        .iter()
        .find(|f| f.path.ends_with("mcap"))
        .unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("segment");
    // On the first connection one byte is wrong; the second is cut off; the third is fine.
    let fault = |n: usize| match n {
        0 => (100_000, Some(50_000)),
        _ => (usize::MAX, None),
    };
    let proxy = Proxy::new(setup.server.address(), Box::new(fault));
    let done = proxy
        .client()
        .download("walk-2", entry, &path, |_| {})
        .unwrap();
    assert!(done.wasted > 0);
    let whole = fs::read(setup.root.join("walk-2").join(&entry.path)).unwrap();
    assert!(fs::read(&path).unwrap() == whole);

    fs::remove_file(&path).unwrap();
    let mut wrong = entry.clone();
    wrong.blake3 = "0".repeat(64);
    let error = client
        .download("walk-2", &wrong, &path, |_| {})
        .unwrap_err();
    assert!(
        matches!(&error, LinkError::Corrupt { found, .. } if *found == entry.blake3),
        "{error}"
    );
    assert_eq!(fs::metadata(&path).unwrap().len(), 0);
}

#[test]
fn file_changed_on_the_rig_is_detected() {
    let setup = start(Options::default());
    let mut client = setup.client();
    let manifest = client.manifest("walk-2", |_| {}).unwrap();
    let entry = manifest
        .files
        .iter()
        .find(|f| f.path == "rig/rig.toml")
        .unwrap();
    fs::write(setup.root.join("walk-2/rig/rig.toml"), "revision = 22\n").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let error = client.download("walk-2", entry, &path, |_| {}).unwrap_err();
    assert!(matches!(error, LinkError::Malformed { .. }), "{error}");
    // The manifest is made again for what changed.
    let again = client.manifest("walk-2", |_| {}).unwrap();
    assert_ne!(again.total, manifest.total);
}

#[test]
fn session_being_recorded_cannot_be_pulled() {
    let setup = start(Options::default());
    setup.rig.record(Some("walk-2"));
    let mut client = setup.client();
    assert_eq!(client.sessions().unwrap()[1].state, SessionState::Recording);
    match client.manifest("walk-2", |_| {}).unwrap_err() {
        LinkError::Rejected { problem, .. } => assert_eq!(problem.code, Code::Recording),
        error => panic!("{error}"),
    }
}

#[test]
fn read_rate_is_limited_while_recording() {
    let limits = Limits {
        recording_bytes_per_s: 400_000,
        ..Limits::default()
    };
    let setup = start(Options {
        limits,
        scene: rig_link::fake::Scene::Recording,
        ..Options::default()
    });
    let begin = std::time::Instant::now();
    pull(&setup, &mut setup.client());
    // Half a megabyte, read once for the hashes and once for the files.
    let elapsed = begin.elapsed();
    assert!(elapsed > Duration::from_millis(1500), "{elapsed:?}");
    // While it does not, at the disk's own speed: at a byte per second this would take days.
    let limits = Limits {
        recording_bytes_per_s: 1,
        ..Limits::default()
    };
    let setup = start(Options {
        limits,
        ..Options::default()
    });
    pull(&setup, &mut setup.client());
}

#[test]
fn server_that_is_not_a_rig_is_detected() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let answers = [
        "HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello",
        "HTTP/1.1 200 OK\r\nContent-Length: 49\r\n\r\n{\"format\":\"other\",\"version\":1,\"sessions\":[]}     ",
        "HTTP/1.1 200 OK\r\nContent-Length: 53\r\n\r\n{\"format\":\"rig-link\",\"version\":9,\"sessions\":[]}       ",
        "HTTP/1.1 418 Teapot\r\nContent-Length: 2\r\n\r\nno",
    ];
    std::thread::spawn(move || {
        for answer in answers {
            let (mut stream, _) = listener.accept().unwrap();
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(answer.as_bytes());
        }
    });
    for _ in 0..3 {
        let address = format!("http://{address}").parse().unwrap();
        let mut client = Client::new(
            address,
            None,
            None,
            RetryPolicy {
                max_attempts: 1,
                ..short_retry()
            },
        )
        .unwrap();
        let error = client.sessions().unwrap_err();
        assert!(matches!(error, LinkError::Malformed { .. }), "{error:?}");
    }
    let address = format!("http://{address}").parse().unwrap();
    let mut client = Client::new(address, None, None, short_retry()).unwrap();
    let error = client.sessions().unwrap_err();
    assert!(error.to_string().contains("418"), "{error}");
}

#[test]
fn manifests_with_paths_outside_the_folder_are_rejected() {
    let line = |path: &str| {
        let hash = "a".repeat(64);
        let total = rig_link::link::list_hash([(path, 1, hash.as_str())]);
        format!(
            "{{\"file\":{{\"path\":{path:?},\"bytes\":1,\"modified_ns\":0,\"blake3\":\"{hash}\"}}}}\n\n{{\"total\":{{\"list\":\"{total}\",\"files\":1,\"bytes\":1}}}}\n"
        )
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let bad = ["../x", "/etc/cron.d/x", "a/../../x", "", "import.json"];
    let bodies: Vec<String> = bad.iter().map(|p| line(p)).chain([line("rig/x")]).collect();
    std::thread::spawn(move || {
        for body in bodies {
            let (mut stream, _) = listener.accept().unwrap();
            let _ = stream.read(&mut [0; 4096]);
            let head = format!(
                "HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
                body.len()
            );
            let _ = stream.write_all(format!("{head}{body}").as_bytes());
        }
    });
    let ask = || {
        let address = format!("http://{address}").parse().unwrap();
        Client::new(address, None, None, short_retry())
            .unwrap()
            .manifest("x", |_| {})
    };
    for path in bad {
        let error = ask().unwrap_err();
        assert!(
            error.to_string().contains("not a path of a session's file"),
            "{path}: {error}"
        );
    }
    assert_eq!(ask().unwrap().files.len(), 1);
}

/// All attempts together end within the timeout of one connection, however many attempts are
/// allowed.
#[test]
fn unreachable_address_is_given_up_within_the_connect_timeout() {
    // Refused immediately and repeatedly.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let retry = RetryPolicy {
        connect_timeout: Duration::from_millis(700),
        max_attempts: 1000,
        first_pause: Duration::from_millis(100),
        max_pause: Duration::from_secs(3600),
        ..short_retry()
    };
    let address = format!("http://{address}").parse().unwrap();
    let mut client = Client::new(address, None, None, retry).unwrap();
    let error = client.sessions().unwrap_err();
    // Pauses of 100, 200 and 400 ms do not fit.
    assert!(
        matches!(error, LinkError::NoResponse { tries, .. } if (1..=4).contains(&tries)),
        "{error:?}"
    );
}

/// No rejection and no response: packets are dropped, as by a rig that is off.
#[test]
fn address_that_accepts_no_connection_is_given_up_within_the_connect_timeout() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let listener = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
        socket.listen(1).unwrap()
    });
    let address = listener.local_addr().unwrap();
    // Other connections that are never accepted fill the backlog.
    let mut waiting = Vec::new();
    while let Ok(stream) = TcpStream::connect_timeout(&address, Duration::from_secs(2)) {
        waiting.push(stream);
        if waiting.len() == 100 {
            println!("skipped: this system has room for everybody who connects");
            return;
        }
    }
    for scheme in ["http", "https"] {
        let retry = RetryPolicy {
            connect_timeout: Duration::from_millis(300),
            ..short_retry()
        };
        let address = format!("{scheme}://{address}").parse().unwrap();
        let mut client = Client::new(address, None, None, retry).unwrap();
        let error = client.sessions().unwrap_err();
        assert!(
            matches!(&error, LinkError::NoResponse { tries: 1, reason, .. }
                if reason.starts_with("no connection within ")),
            "{error:?}"
        );
    }
}
