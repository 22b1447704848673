//! Synthetic cameras through the whole daemon: every loss accounted for, every picture the one that
//! its record says, the same input the same bytes; and the daemon under control from outside.

#![expect(
    clippy::disallowed_methods,
    reason = "the daemon runs in real time and is waited for"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use capture_daemon::clock::{Clock as _, RealClock};
use capture_daemon::config::Config;
use capture_daemon::control;
use capture_daemon::recorder::STOP_LIMIT_NS;
use capture_daemon::run::{Finished, RecordOptions, StopFlag, build, daemon, record, record_built};
use capture_daemon::sources::Source;
use capture_daemon::sources::synthetic::{FaultPlan, read_counter};
use capture_daemon::status::{Request, Response, State, Status};
use session_archive::manifest;
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::verify::verify;
use tests::contents::{Contents, StoredFrame, open};
use tests::rig::Rig;

fn virtual_time(seconds: f64, out: &Path) -> RecordOptions {
    RecordOptions {
        seconds,
        virtual_time: true,
        name: "whole chain".to_owned(),
        out: out.to_owned(),
    }
}

/// Records a rig whose cameras have faults.
fn record_faulty(
    rig: &Rig,
    faults: [FaultPlan; 3],
    seconds: f64,
    out: &Path,
) -> (Finished, HostTime) {
    let config = rig.config(out).expect("configuration");
    let mut began = HostTime(0);
    let built = |start| {
        began = start;
        let mut built = build(&config, start)?;
        for (camera, faults) in faults.into_iter().enumerate() {
            let source: Box<dyn Source> = Box::new(rig.source(camera, start)?.with_faults(faults));
            built.sources[camera] = source;
        }
        Ok(built)
    };
    let finished = record_built(
        built,
        &virtual_time(seconds, out),
        &StopFlag::new(),
        Box::new(|_| {}),
    );
    (finished.expect("recording"), began)
}

/// Numbers present and numbers in gaps are every number from 0 to the last, each once; gives how
/// many are present.
fn accounted(contents: &Contents, stream: &str) -> u64 {
    let frames = contents
        .frames
        .get(stream)
        .into_iter()
        .flatten()
        .map(|f| f.record.number);
    let samples = contents
        .imu
        .get(stream)
        .into_iter()
        .flatten()
        .map(|s| s.number);
    let present: Vec<u64> = frames.chain(samples).collect();
    let gaps = contents
        .gaps_of(stream)
        .into_iter()
        .flat_map(|(first, last, _)| first..=last);
    let mut all: Vec<u64> = present.iter().copied().chain(gaps).collect();
    all.sort_unstable();
    assert!(
        all.iter().copied().eq(0..all.len() as u64),
        "{stream}: {all:?}"
    );
    present.len() as u64
}

#[test]
fn every_fault_is_accounted_for() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig {
        imu_rate_hz: 100.0,
        ..Rig::small(3)
    };
    let s = |seconds: f64| (seconds * NS_PER_S as f64) as i64;
    let faults = [
        FaultPlan {
            drop_frames: vec![7, 50, 51, 52, 120],
            ..FaultPlan::default()
        },
        FaultPlan {
            camera_silence: Some(s(3.0)..s(5.5)),
            imu_silence: Some(s(6.0)..s(8.0)),
            ..FaultPlan::default()
        },
        FaultPlan {
            frozen: Some(100..180),
            end_after_frames: Some(240),
            ..FaultPlan::default()
        },
    ];
    let (finished, start) = record_faulty(&rig, faults, 10.0, folder.path());
    assert_eq!(finished.error, None);
    let report = verify(&open(&finished.session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let contents = Contents::read(&finished.session).expect("contents");

    // What is missing, and why.
    let device = Cause::Device as i32;
    let gaps = [
        (
            "left_shoulder",
            vec![(7, 7, device), (50, 52, device), (120, 120, device)],
            295,
        ),
        ("left_shoulder/imu", vec![], 1000),
        ("right_shoulder", vec![(90, 164, device)], 225),
        ("right_shoulder/imu", vec![(600, 799, device)], 800),
        ("feet", vec![], 240),
        ("feet/imu", vec![], 800),
    ];
    for (stream, expected, stored) in gaps {
        assert_eq!(contents.gaps_of(stream), expected, "{stream}");
        assert_eq!(accounted(&contents, stream), stored, "{stream}");
    }
    assert_eq!((finished.stored, finished.missing), (3360, 280));

    // Every picture shows its number, but the frozen ones, which are marked.
    for name in rig.names() {
        let mut seen = 0;
        let checked = contents.decode(name, |frame, picture| {
            let frozen = *name == "feet" && (100..180).contains(&frame.number);
            assert_eq!(frame.frozen, frozen, "{name} {}", frame.number);
            let expected = if frozen { 99 } else { frame.number };
            assert_eq!(
                read_counter(picture),
                Some(expected),
                "{name} {}",
                frame.number
            );
            seen += 1;
            Ok(())
        });
        checked.expect("decoding");
        assert_eq!(seen, contents.frames[*name].len());
    }

    // No time is further from the truth than its sigma says, nor, once the clocks have settled, than
    // a fifth of a millisecond.
    for (camera, name) in rig.names().iter().enumerate() {
        let truth = rig.source(camera, start).expect("source");
        for StoredFrame { record, .. } in &contents.frames[*name] {
            let error = HostTime(record.time).since(truth.frame_time(record.number));
            assert!(
                error.unsigned_abs() <= record.sigma_ns,
                "{name}: {error} ns, {record:?}"
            );
            assert!(
                record.time_doubtful || error.abs() <= 200_000,
                "{name}: {error}, {record:?}"
            );
        }
    }

    alarms_come_in_time(&contents, &rig, start);
    sets_are_of_stored_frames(&contents);
}

/// The alarms of the faults above, each within two periods and a second of the last good sample, and
/// no others.
fn alarms_come_in_time(contents: &Contents, rig: &Rig, start: HostTime) {
    let frame_time = |number: f64| start + (number / rig.rate_hz * 1e9) as i64;
    let sample_time = |number: f64| start + (number / rig.imu_rate_hz * 1e9) as i64;
    // Stream, last good sample, first good one after it.
    let frozen = (frame_time(99.0), Some(frame_time(180.0)));
    let expected = [
        (
            "right_shoulder",
            "no samples",
            frame_time(89.0),
            Some(frame_time(165.0)),
        ),
        ("feet", "the picture is frozen", frozen.0, frozen.1),
        (
            "right_shoulder/imu",
            "no samples",
            sample_time(599.0),
            Some(sample_time(800.0)),
        ),
        ("feet", "no samples", frame_time(239.0), None),
        ("feet/imu", "no samples", sample_time(799.0), None),
    ];
    // Arrivals are up to 2 ms late.
    const LATE_NS: i64 = 2_000_000;
    let mut found = BTreeSet::new();
    for (stream, what, good, over) in expected {
        let text = format!("{stream}: {what}");
        let mut at = |kind: Kind| {
            let mut events = contents.events.iter().zip(0..).filter(|((_, event), _)| {
                event.kind == kind as i32 && event.source == stream && event.text == text
            });
            let first = events.next().map(|((at, _), position)| (*at, position));
            assert!(events.next().is_none(), "{text}: {kind:?} twice");
            found.extend(first.map(|(_, position)| position));
            first.map(|(at, _)| at)
        };
        let rate = if stream.ends_with("/imu") {
            rig.imu_rate_hz
        } else {
            rig.rate_hz
        };
        let limit = NS_PER_S + (2.0 / rate * 1e9) as i64;
        let raised = at(Kind::Fault).unwrap_or_else(|| panic!("no alarm {text:?}"));
        let after = raised.since(good);
        assert!(
            after > limit / 2 && after <= limit + LATE_NS,
            "{text}: after {after} ns, the limit is {limit}"
        );
        let cleared = at(Kind::Cleared);
        let late = cleared.zip(over).map(|(cleared, over)| cleared.since(over));
        assert_eq!(cleared.is_some(), over.is_some(), "{text}");
        assert!(
            late.is_none_or(|late| (0..=LATE_NS).contains(&late)),
            "{text}: over {late:?}"
        );
    }
    let others: Vec<_> = (0..contents.events.len())
        .filter(|position| !found.contains(position))
        .map(|position| contents.events[position].1.kind)
        .collect();
    assert_eq!(
        others,
        [Kind::Start as i32, Kind::Stop as i32],
        "{:?}",
        contents.events
    );
}

/// Each set's frames are in the session with the time that it says, each frame is in one set at most,
/// and a camera is either in a set or named as missing.
fn sets_are_of_stored_frames(contents: &Contents) {
    let stored: BTreeMap<(&str, u64), i64> = contents
        .frames
        .iter()
        .flat_map(|(name, frames)| {
            frames
                .iter()
                .map(|f| ((name.as_str(), f.record.number), f.record.time))
        })
        .collect();
    let mut used = BTreeSet::new();
    let mut without = BTreeMap::new();
    for (set, number) in contents.sets.iter().zip(0..) {
        assert_eq!(set.number, number);
        for member in &set.members {
            let key = (member.camera.as_str(), member.number);
            assert_eq!(stored.get(&key), Some(&member.time), "{key:?}");
            assert!(used.insert(key), "{key:?} is in two sets");
        }
        let members = set.members.iter().map(|m| &m.camera);
        let cameras: BTreeSet<&String> = members.chain(&set.missing).collect();
        assert_eq!(cameras.len(), 3, "{set:?}");
        assert_eq!(set.members.len() + set.missing.len(), 3, "{set:?}");
        for camera in &set.missing {
            *without.entry(camera.as_str()).or_insert(0) += 1;
        }
    }
    // Every instant at which any camera has a frame, and who has none there.
    assert_eq!(contents.sets.len(), 300);
    let expected = [("left_shoulder", 5), ("right_shoulder", 75), ("feet", 60)];
    assert_eq!(without, BTreeMap::from(expected));
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig::small(3);
    let run = |out: &str| {
        let out = folder.path().join(out);
        let config = rig.config(folder.path()).expect("configuration");
        let options = virtual_time(4.0, &out);
        let finished =
            record(&config, &options, &StopFlag::new(), Box::new(|_| {})).expect("recording");
        assert_eq!((finished.error, finished.missing), (None, 0));
        assert_eq!(finished.stored, 3 * (4 * 30 + 4 * 200));
        files(&out)
    };
    let (first, second) = (run("first"), run("second"));
    assert!(
        first
            .keys()
            .any(|path| path.ends_with("segments/000000.mcap")),
        "{:?}",
        first.keys()
    );
    assert_eq!(
        first.keys().collect::<Vec<_>>(),
        second.keys().collect::<Vec<_>>()
    );
    for (path, content) in &first {
        let other = &second[path];
        let differs = content.iter().zip(other).position(|(a, b)| a != b);
        assert_eq!(
            (content.len(), differs),
            (other.len(), None),
            "{}",
            path.display()
        );
    }
}

/// All files below a folder, by their path in it.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).expect("folder") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("inside").to_owned();
                found.insert(name, fs::read(&path).expect("file"));
            }
        }
    }
    found
}

/// A daemon in a thread of this process.
struct Daemon {
    socket: PathBuf,
    stop: StopFlag,
    thread: Option<std::thread::JoinHandle<anyhow::Result<()>>>,
}

impl Daemon {
    fn start(mut config: Config, folder: &Path) -> Self {
        config.session.out = Some(folder.join("sessions"));
        let stop = StopFlag::new();
        let socket = config.control.socket.clone();
        let flag = stop.clone();
        let thread = std::thread::spawn(move || daemon(&config, &flag));
        Self {
            socket,
            stop,
            thread: Some(thread),
        }
    }

    fn ask(&self, request: Request) -> Result<Status, String> {
        match control::request(&self.socket, &request) {
            Ok(Response::Ok { status }) => Ok(*status),
            Ok(Response::Error { message }) => Err(message),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Waits for a status of which `is` holds.
    fn wait(&self, what: &str, is: impl Fn(&Status) -> bool) -> Status {
        let until = RealClock.now() + 60 * NS_PER_S;
        let mut last = None;
        while RealClock.now() < until {
            match self.ask(Request::Status) {
                Ok(status) if is(&status) => return status,
                other => last = Some(other),
            }
            std::thread::sleep(Duration::from_millis(2));
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
fn a_press_records_at_once_and_a_stop_ends_soon() {
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
    // So that a whole pre-roll has gone by.
    daemon.wait("two seconds of frames", |s| s.streams[0].received >= 60);

    let mut fastest_stop = i64::MAX;
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
        let running = daemon.wait("some chunks", |s| {
            s.durable_until.is_some_and(|t| t > pressed)
        });
        assert!(running.streams.iter().all(|s| s.stored > 0), "{running:?}");
        daemon
            .ask(Request::Mark {
                text: "here".to_owned(),
            })
            .expect("mark");

        let stopped = RealClock.now();
        daemon.ask(Request::Stop).expect("stop");
        let status = daemon.wait("the end", |s| {
            s.session.is_some() && s.state == State::Armed
        });
        fastest_stop = fastest_stop.min(RealClock.now().since(stopped));
        assert_eq!(
            (status.alarms, status.session.as_deref()),
            (vec![], Some(session.as_path()))
        );
        check_session(
            &session,
            &format!("round {round}"),
            round == 0,
            pressed,
            stopped,
        );
    }
    // The best of three: the machine may have been busy with something else.
    let limit = 500_000_000 + STOP_LIMIT_NS;
    assert!(
        fastest_stop < limit,
        "stopping took {fastest_stop} ns, expected below {limit}"
    );

    let status = daemon.ask(start("unwanted")).expect("start");
    let unwanted = status.session.expect("a session");
    assert!(unwanted.is_dir());
    daemon.ask(Request::Discard).expect("discard");
    assert!(!unwanted.exists(), "a discarded session is gone");

    let last = daemon
        .ask(start("last"))
        .expect("start")
        .session
        .expect("a session");
    daemon.wait("some frames", |s| s.seconds > 1.2);
    let socket = daemon.socket.clone();
    daemon.end();
    assert!(!socket.exists(), "the socket is gone");
    let manifest = Contents::read(&last).expect("contents").manifest;
    assert_eq!(manifest.state, manifest::State::Closed);
    assert_eq!(manifest.stopped.expect("an end").reason, "signal");
}

/// A session from a press to a stop: whole, with nothing missing, and with its pre-roll unless another
/// one has just ended: what that one has is not recorded again.
fn check_session(session: &Path, name: &str, is_first: bool, pressed: HostTime, stopped: HostTime) {
    let report = verify(&open(session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let contents = Contents::read(session).expect("contents");
    assert_eq!(contents.manifest.state, manifest::State::Closed);
    assert_eq!(contents.manifest.name, name);
    assert_eq!(contents.gaps, [], "nothing is missing");
    let period = NS_PER_S / 30;
    for (camera, frames) in &contents.frames {
        let first = &frames.first().expect("frames").record;
        assert!(first.key_frame, "{camera} begins with a key frame");
        let first = HostTime(first.time);
        let after = first.since(pressed);
        assert!(
            after <= 100_000_000,
            "{camera}: the first key frame is {after} ns after the press"
        );
        let pre_roll = pressed.since(first);
        if is_first {
            let range = NS_PER_S - 2 * period..=2 * NS_PER_S + 2 * period;
            assert!(
                range.contains(&pre_roll),
                "{camera}: a pre-roll of {pre_roll} ns"
            );
        }
        // What was received before the stop is in, and nothing from after it.
        let last = HostTime(frames.last().expect("frames").record.time);
        let before = stopped.since(last);
        assert!(
            before < 2 * period,
            "{camera} ends {before} ns before the stop"
        );
    }
    let events: Vec<(i32, &str, &str)> = contents
        .events
        .iter()
        .map(|(_, e)| (e.kind, e.source.as_str(), e.text.as_str()))
        .collect();
    let expected = [
        (Kind::Start as i32, "control", name),
        (Kind::Mark as i32, "control", "here"),
        (Kind::Stop as i32, "control", ""),
    ];
    assert_eq!(events, expected);
    assert_eq!(contents.manifest.stopped.expect("an end").reason, "control");
}
