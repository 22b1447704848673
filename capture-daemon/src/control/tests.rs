use std::sync::Barrier;
use std::sync::mpsc::sync_channel;

use session_archive::text::{MAX_NOTE, is_plain};
use session_archive::time::CivilTime;

use super::*;
use crate::clock::VirtualClock;
use crate::status::{MachineStatus, State, Status};

fn status(state: State) -> Response {
    Response::Ok {
        status: Box::new(Status {
            state,
            session: None,
            seconds: 0.0,
            durable_until: None,
            streams: Vec::new(),
            free_bytes: None,
            seconds_left: None,
            alarms: Vec::new(),
            notes: Vec::new(),
            concerns: Default::default(),
            encoders: Vec::new(),
            machine: MachineStatus::default(),
            degradation: String::new(),
        }),
    }
}

/// Its answer contains the request.
fn echo(request: Request) -> Response {
    match request {
        Request::Start { name } => Response::Error {
            message: format!("start {name}"),
        },
        Request::Mark { text, .. } => Response::Error {
            message: format!("mark {text}"),
        },
        Request::Stop => status(State::Stopping),
        Request::Discard | Request::DiscardLast => status(State::Idle),
        Request::Status => status(State::Armed),
    }
}

struct Place {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn place() -> Place {
    let folder = tempfile::tempdir().unwrap();
    Place {
        path: folder.path().join("pawsd.sock"),
        _folder: folder,
    }
}

/// Sends bytes as they are and returns the lines that come back until the server closes.
fn raw(path: &Path, bytes: &[u8]) -> Vec<String> {
    let stream = UnixStream::connect(path).unwrap();
    // The server may close before it has read everything.
    let _ = (&stream).write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    BufReader::new(&stream)
        .lines()
        .map_while(Result::ok)
        .collect()
}

#[test]
fn every_request_arrives_and_is_answered() {
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let requests = [
        Request::Start {
            name: "kitchen \"2\"".into(),
        },
        Request::Mark {
            text: "stairs ↑".into(),
            at: None,
        },
        Request::Stop,
        Request::Discard,
        Request::Status,
    ];
    for sent in requests {
        assert_eq!(request(&place.path, &sent).unwrap(), echo(sent));
    }
    let mode = fs::metadata(&place.path).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o660);
}

#[test]
fn invalid_request_is_answered_and_the_connection_stays_open() {
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let check = |line: &[u8], expected: &str| {
        let mut bytes = line.to_vec();
        bytes.extend(b"\n\n{\"do\":\"mark\"}");
        let answers = raw(&place.path, &bytes);
        assert_eq!(answers.len(), 2, "{answers:?}");
        let Ok(Response::Error { message }) = serde_json::from_str(&answers[0]) else {
            panic!("no error: {}", answers[0]);
        };
        assert!(
            message.contains(expected),
            "{message:?} does not say {expected:?}"
        );
        assert!(answers[1].contains("mark "), "{}", answers[1]);
    };
    check(b"hello", "expected a line like {\"do\":\"status\"}");
    check(b"{\"do\":\"strat\"}", "unknown variant `strat`");
    check(b"{\"do\":\"start\",\"name\":3}", "expected a string");
    check(b"{}", "missing field `do`");
    check(b"\xff\x00\xfe", "expected value");
    let deep = [b"{\"a\":".as_slice(), &vec![b'['; MAX_LINE_BYTES - 5]].concat();
    check(&deep, "recursion limit");
}

#[test]
fn overlong_line_ends_the_connection() {
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let mut longest = format!(
        "{{\"do\":\"mark\",\"text\":\"{}\"}}",
        "x".repeat(MAX_LINE_BYTES - 23)
    )
    .into_bytes();
    assert_eq!(longest.len(), MAX_LINE_BYTES);
    longest.extend(b"\n{\"do\":\"status\"}\n");
    assert_eq!(
        raw(&place.path, &longest).len(),
        2,
        "the longest line is still taken"
    );
    longest.insert(0, b' ');
    let answers = raw(&place.path, &longest);
    assert_eq!(answers.len(), 1, "{answers:?}");
    assert!(
        answers[0].contains("longer than 16384 bytes"),
        "{answers:?}"
    );
    assert!(
        request(&place.path, &Request::Status).is_ok(),
        "others are still served"
    );
}

#[test]
fn client_without_a_daemon_reports_what_to_do() {
    let place = place();
    let check = |what: &str| {
        let error = request(&place.path, &Request::Status).unwrap_err();
        assert!(
            matches!(error, ControlError::NoDaemon { .. }),
            "{what}: {error}"
        );
        assert!(error.to_string().contains("pawsd run --config"), "{error}");
    };
    check("nothing there");
    drop(UnixListener::bind(&place.path).unwrap());
    check("a dead daemon's socket");
}

#[test]
fn answer_of_a_foreign_server_is_rejected() {
    let place = place();
    let check = |answer: &'static [u8], expected: &str| {
        let _ = fs::remove_file(&place.path);
        let listener = UnixListener::bind(&place.path).unwrap();
        let stranger = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            BufReader::new(&stream)
                .read_until(b'\n', &mut Vec::new())
                .unwrap();
            stream.write_all(answer).unwrap();
        });
        let error = request(&place.path, &Request::Status).unwrap_err();
        stranger.join().unwrap();
        assert!(matches!(error, ControlError::Garbled { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
    };
    check(b"", "closed without one");
    check(b"HTTP/1.1 400 Bad Request\n", "expected value");
    check(b"{\"result\":\"maybe\"}\n", "unknown variant `maybe`");
}

#[test]
fn dead_socket_is_replaced_and_a_live_one_is_not() {
    let place = place();
    drop(UnixListener::bind(&place.path).unwrap());
    let server = serve(&place.path, echo).unwrap();
    assert!(request(&place.path, &Request::Status).is_ok());

    let error = serve(&place.path, echo).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
    assert!(
        error.to_string().contains("another daemon answers"),
        "{error}"
    );
    assert!(
        request(&place.path, &Request::Status).is_ok(),
        "the first daemon is untouched"
    );
    drop(server);

    fs::write(&place.path, "precious").unwrap();
    let error = serve(&place.path, echo).unwrap_err();
    assert!(error.to_string().contains("not a socket"), "{error}");
    assert_eq!(fs::read(&place.path).unwrap(), b"precious");

    let absent = serve(&place.path.join("no/such"), echo).unwrap_err();
    assert_ne!(absent.kind(), io::ErrorKind::AddrInUse);
}

#[test]
fn dropping_removes_only_its_own_socket() {
    let place = place();
    let server = serve(&place.path, echo).unwrap();
    drop(server);
    assert!(!place.path.exists());

    let server = serve(&place.path, echo).unwrap();
    fs::remove_file(&place.path).unwrap();
    let other = serve(&place.path, echo).unwrap();
    drop(server);
    assert!(
        request(&place.path, &Request::Status).is_ok(),
        "the other's socket is still there"
    );
    drop(other);
    assert!(!place.path.exists());
}

#[test]
fn dropping_lets_the_request_in_hand_finish() {
    let place = place();
    let (entered, wait) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
    let (entered_there, wait_there) = (entered.clone(), wait.clone());
    let server = serve(&place.path, move |_| {
        entered_there.wait();
        wait_there.wait();
        status(State::Stopping)
    })
    .unwrap();
    let path = place.path.clone();
    let client = thread::spawn(move || raw(&path, b"{\"do\":\"stop\"}\n"));
    entered.wait();
    // Must not wait for the handler, which may wait for the dropping thread.
    drop(server);
    wait.wait();
    let answers = client.join().unwrap();
    assert!(answers[0].contains("stopping"), "{answers:?}");
}

/// Connections of this many clients that send `bytes` and then nothing.
fn idle(place: &Place, count: usize, bytes: &[u8]) -> Vec<UnixStream> {
    let hold = |_| {
        let mut stream = UnixStream::connect(&place.path).unwrap();
        stream.write_all(bytes).unwrap();
        stream
    };
    (0..count).map(hold).collect()
}

#[test]
fn connections_with_a_request_in_hand_are_bounded() {
    let place = place();
    let (handled, handling) = sync_channel(MAX_CONNECTIONS);
    let (release, released) = sync_channel::<()>(0);
    let released = Mutex::new(released);
    let _server = serve(&place.path, move |_| {
        handled.send(()).unwrap();
        let _ = released.lock().unwrap().recv();
        status(State::Armed)
    })
    .unwrap();
    let open = idle(&place, MAX_CONNECTIONS, b"{\"do\":\"status\"}\n");
    for _ in 0..MAX_CONNECTIONS {
        handling.recv().unwrap();
    }
    let Ok(Response::Error { message }) = request(&place.path, &Request::Status) else {
        panic!("one connection too many was served");
    };
    assert!(message.contains("16 requests are in hand"), "{message}");
    drop(release);
    // All of them are still answered; then there is a free slot again.
    for stream in open {
        let mut answer = String::new();
        BufReader::new(&stream).read_line(&mut answer).unwrap();
        assert!(answer.contains("armed"), "{answer}");
    }
    let answer = request(&place.path, &Request::Status);
    assert!(matches!(answer, Ok(Response::Ok { .. })), "{answer:?}");
}

/// Idle ones, slow ones, and ones that take no answers.
#[test]
fn idle_connections_do_not_prevent_a_stop() {
    // More than a socket holds, so that a client which reads nothing is not answered to the end.
    let asks = b"{\"do\":\"mark\"}\n".repeat(100_000);
    let first = [&b""[..], b"{\"do\":\"sta", b"\n"];
    for bytes in first {
        let place = place();
        let _server = serve(&place.path, echo).unwrap();
        let _held = idle(&place, 3 * MAX_CONNECTIONS, bytes);
        let answer = request(&place.path, &Request::Stop);
        assert_eq!(answer.unwrap(), status(State::Stopping), "{bytes:?}");
    }
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let _held: Vec<UnixStream> = (0..MAX_CONNECTIONS)
        .map(|_| {
            let mut stream = UnixStream::connect(&place.path).unwrap();
            stream.set_nonblocking(true).unwrap();
            let _ = stream.write(&asks);
            stream
        })
        .collect();
    // A connection with a request in progress is served; none of them needs long. Not for as long
    // as it takes: at ANSWER_LIMIT they would be replaced in any case.
    let stopped = |_| {
        thread::yield_now();
        matches!(
            request(&place.path, &Request::Stop),
            Ok(Response::Ok { .. })
        )
    };
    assert!((0..100_000).any(stopped));
}

#[test]
fn longest_silent_connection_is_closed_first() {
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let talk = |mut stream: &UnixStream| {
        let mut answer = String::new();
        let _ = stream.write_all(b"{\"do\":\"status\"}\n");
        let _ = BufReader::new(stream).read_line(&mut answer);
        answer.contains("armed")
    };
    let idle = idle(&place, MAX_CONNECTIONS, b"");
    assert!(talk(&idle[0]) && idle.iter().skip(2).all(talk));
    assert!(request(&place.path, &Request::Status).is_ok());
    let alive: Vec<bool> = idle.iter().map(talk).collect();
    assert_eq!(alive.iter().filter(|a| !**a).count(), 1, "{alive:?}");
    assert!(!alive[1], "{alive:?}");
}

#[test]
fn slow_line_is_cut_off() {
    let (mut client, server) = UnixStream::pair().unwrap();
    let clock = VirtualClock::new(HostTime(0), CivilTime(0));
    let mut line = DeadlineReader {
        stream: &server,
        clock: &clock,
        deadline: None,
    };
    let mut byte = |at: Duration| {
        clock.advance_to(HostTime(at.as_nanos() as i64));
        client.write_all(b"x").unwrap();
        let mut one = [0];
        line.read(&mut one).map_err(|e| e.kind())
    };
    // Silence before it does not count.
    assert_eq!(byte(IDLE_LIMIT), Ok(1));
    let last = IDLE_LIMIT + LINE_LIMIT - Duration::from_nanos(1);
    assert_eq!(byte(last), Ok(1));
    assert_eq!(byte(IDLE_LIMIT + LINE_LIMIT), Err(io::ErrorKind::TimedOut));
    line.deadline = None;
    assert!(matches!(line.read(&mut [0]), Ok(1)));
}

#[test]
fn names_and_marks_follow_the_rules_of_the_page() {
    let place = place();
    let _server = serve(&place.path, echo).unwrap();
    let answers = |name: &str, text: &str| {
        let start = Request::Start { name: name.into() };
        let mark = Request::Mark {
            text: text.into(),
            at: None,
        };
        [start, mark].map(|sent| match request(&place.path, &sent) {
            Ok(Response::Error { message }) => message,
            other => panic!("{other:?}"),
        })
    };
    let longest = "x".repeat(MAX_NOTE);
    let [start, mark] = answers(&longest, &longest);
    assert_eq!((start.len(), mark.len()), (206, 205), "they are taken");
    for (bad, part) in [
        ("x".repeat(MAX_NOTE + 1), "201 bytes, expected at most 200"),
        ("a\u{1b}[2J".to_owned(), "U+001B at position 2"),
        ("a\nb".to_owned(), "U+000A at position 2"),
        ("\u{9b}2J".to_owned(), "U+009B at position 1"),
        ("a\u{202e}b".to_owned(), "U+202E at position 2"),
    ] {
        for message in answers(&bad, &bad) {
            assert!(message.contains(part), "{message}");
            assert!(is_plain(&message), "{message:?}");
        }
    }
}

#[test]
fn panicking_handler_ends_only_its_connection() {
    let place = place();
    let _server = serve(&place.path, |request| match request {
        Request::Stop => panic!("on purpose"),
        _ => status(State::Armed),
    })
    .unwrap();
    for _ in 0..2 * MAX_CONNECTIONS {
        let error = request(&place.path, &Request::Stop).unwrap_err();
        assert!(matches!(error, ControlError::Garbled { .. }), "{error}");
    }
    assert!(request(&place.path, &Request::Status).is_ok());
}
