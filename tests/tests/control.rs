//! Remote control of the daemon: arm, start, mark, stop, discard.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use capture_daemon::clock::{Clock as _, RealClock};
use capture_daemon::config::Config;
use capture_daemon::control;
use capture_daemon::run::{StopFlag, daemon};
use capture_daemon::status::{Request, Response, State, Status};
use harness::contents::{Contents, open};
use harness::rig::Rig;
use session_archive::manifest;
use session_archive::record::paws::event::Kind;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::verify::verify;

/// A daemon in a thread of this process.
struct Daemon {
    socket: PathBuf,
    stop: StopFlag,
    thread: Option<std::thread::JoinHandle<anyhow::Result<()>>>,
    /// Disconnected at its end.
    ended: Receiver<()>,
}

/// Time between two requests for the status, so that they do not slow down the daemon.
const REQUEST_INTERVAL: Duration = Duration::from_millis(2);

impl Daemon {
    fn start(mut config: Config, folder: &Path) -> Self {
        config.session.out = Some(folder.join("sessions"));
        let stop = StopFlag::new();
        let socket = config.control.socket.clone();
        let flag = stop.clone();
        let (is_running, ended) = sync_channel(0);
        let thread = std::thread::spawn(move || {
            let result = daemon(&config, &flag);
            drop(is_running);
            result
        });
        Self {
            socket,
            stop,
            thread: Some(thread),
            ended,
        }
    }

    fn ask(&self, request: Request) -> Result<Status, String> {
        match control::request(&self.socket, &request) {
            Ok(Response::Ok { status }) => Ok(*status),
            Ok(Response::Error { message }) => Err(message),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Waits for a status of which `is` holds, or the end of the daemon. The socket gives no notice
    /// of a change, only the status on request, so that it is requested repeatedly.
    fn wait(&self, what: &str, is: impl Fn(&Status) -> bool) -> Status {
        let until = RealClock.now() + 600 * NS_PER_S;
        let mut last = None;
        while RealClock.now() < until {
            match self.ask(Request::Status) {
                Ok(status) if is(&status) => return status,
                other => last = Some(other),
            }
            if self.ended.recv_timeout(REQUEST_INTERVAL) == Err(RecvTimeoutError::Disconnected) {
                break;
            }
        }
        panic!("waited in vain for {what}; the last answer was {last:?}");
    }

    fn end(mut self) {
        self.stop.set();
        let thread = self.thread.take().expect("a running daemon");
        thread.join().expect("daemon").expect("daemon");
    }
}

fn start(name: &str) -> Request {
    Request::Start {
        name: name.to_owned(),
    }
}

#[test]
fn sessions_last_from_a_button_press_to_a_stop() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig::small(3);
    let daemon = Daemon::start(
        rig.config(folder.path()).expect("configuration"),
        folder.path(),
    );
    let armed = daemon.wait("armed", |s| s.state == State::Armed);
    assert_eq!((armed.session, armed.streams.len()), (None, 6));
    assert!(
        daemon
            .ask(Request::Stop)
            .is_err_and(|e| e.contains("armed")),
        "a stop of nothing"
    );
    // Until a whole pre-roll has passed.
    daemon.wait("two seconds of frames", |s| s.streams[0].received >= 60);

    let mut sessions = BTreeSet::new();
    for round in 0..3 {
        let pressed = RealClock.now();
        let status = daemon.ask(start(&format!("round {round}"))).expect("start");
        assert_eq!(status.state, State::Recording);
        let session = status.session.expect("a session");
        assert!(sessions.insert(session.clone()), "a session of its own");
        assert!(
            daemon
                .ask(start("again"))
                .is_err_and(|e| e.contains("already recording"))
        );
        daemon.wait("some chunks, and something of every stream", |s| {
            s.durable_until.is_some_and(|t| t > pressed) && s.streams.iter().all(|s| s.stored > 0)
        });
        daemon
            .ask(Request::Mark {
                text: "here".to_owned(),
                at: None,
            })
            .expect("mark");

        daemon.ask(Request::Stop).expect("stop");
        let status = daemon.wait("the end", |s| {
            s.session.is_some() && s.state == State::Armed
        });
        assert_eq!(status.session.as_deref(), Some(session.as_path()));
        check_session(&session, &format!("round {round}"), &status);
    }

    let status = daemon.ask(start("unwanted")).expect("start");
    let unwanted = status.session.expect("a session");
    assert!(unwanted.is_dir());
    daemon.ask(Request::Discard).expect("discard");
    assert!(!unwanted.exists(), "a discarded session is removed");

    let last = daemon
        .ask(start("last"))
        .expect("start")
        .session
        .expect("a session");
    daemon.wait("some frames", |s| s.seconds > 1.2);
    let socket = daemon.socket.clone();
    daemon.end();
    assert!(!socket.exists(), "the socket is removed");
    let manifest = Contents::read(&last).expect("contents").manifest;
    assert_eq!(manifest.state, manifest::State::Closed);
    assert_eq!(manifest.stopped.expect("an end").reason, "signal");
}

/// Armed without a pre-roll nothing is encoded; after the button press frames are stored from the
/// first one on, which is a key frame.
#[test]
fn without_a_pre_roll_recording_starts_after_the_button_press() {
    let folder = tempfile::tempdir().expect("folder");
    let mut config = Rig::small(3).config(folder.path()).expect("configuration");
    config.session.pre_roll_ns = 0;
    let daemon = Daemon::start(config, folder.path());
    // Longer than the first second, in which a frame is shown.
    let armed = daemon.wait("frames of all cameras", |s| {
        s.state == State::Armed && s.streams[..3].iter().all(|s| s.received >= 60)
    });
    assert!(armed.streams.iter().all(|s| s.stored == 0), "{armed:?}");

    let pressed = RealClock.now();
    let session = daemon.ask(start("immediately")).expect("start").session;
    let session = session.expect("a session");
    daemon.wait("stored frames of all cameras", |s| {
        s.streams.iter().all(|s| s.stored > 0)
    });
    daemon.ask(Request::Stop).expect("stop");
    daemon.wait("the end", |s| s.state == State::Armed);
    daemon.end();

    let report = verify(&open(&session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let contents = Contents::read(&session).expect("contents");
    assert_eq!(contents.frames.len(), 3);
    for (camera, frames) in &contents.frames {
        let first = &frames.first().expect("frames").record;
        assert!(first.key_frame, "{camera} begins with a key frame");
        // They count from 0: frames received before the report of the press are not in the session.
        let stream = armed.streams.iter().find(|s| s.name == *camera);
        let before = stream.expect("its stream").received;
        assert!(
            first.number >= before,
            "{camera} begins with frame {}, and {before} came while it was armed",
            first.number
        );
        let after_ms = HostTime(first.time).since(pressed) / 1_000_000;
        println!("{camera}: the first frame is {after_ms} ms after the press");
    }
}

/// A session from a button press to a stop: valid, consistent with the daemon's status, decodable
/// from its first frame on, and without data after the stop. The latency of start and stop is
/// tested in virtual time, with the recorder.
fn check_session(session: &Path, name: &str, status: &Status) {
    let report = verify(&open(session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    for stream in &status.streams {
        let found = &report.streams[&stream.name];
        assert_eq!(
            (stream.stored, stream.missing),
            (found.samples, found.gaps),
            "{}",
            stream.name
        );
        assert!(stream.stored > 0, "{stream:?}");
    }
    let contents = Contents::read(session).expect("contents");
    assert_eq!(contents.manifest.state, manifest::State::Closed);
    assert_eq!(contents.manifest.name, name);
    contents.check_times().expect("times");
    let stopped = contents.manifest.stopped.expect("an end");
    assert_eq!(stopped.reason, "control");
    for (camera, frames) in &contents.frames {
        let first = &frames.first().expect("frames").record;
        assert!(first.key_frame, "{camera} begins with a key frame");
        let last = frames.last().expect("frames").record.time;
        assert!(
            last <= stopped.at.0,
            "{camera} has a frame of {last}, stopped at {}",
            stopped.at
        );
    }
    // Alarms depend on the load of the machine.
    let events: Vec<(i32, &str, &str)> = contents
        .events
        .iter()
        .map(|(_, e)| (e.kind, e.source.as_str(), e.text.as_str()))
        .filter(|(_, source, _)| *source == "control")
        .collect();
    let expected = [
        (Kind::Start as i32, "control", name),
        (Kind::Mark as i32, "control", "here"),
        (Kind::Stop as i32, "control", ""),
    ];
    assert_eq!(events, expected);
}
