//! The recorder with hand-written items, virtual time and a disk that fails on demand.

use std::io;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use session_archive::manifest::{Camera, Imu, State as ManifestState};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::paws::gap::Cause;
use session_archive::record::{CameraCalibration, ClockMap, FrameTransforms, Health};
use session_archive::record::{Event, Frame, FrameSet, Gap, ImuBatch};
use session_archive::storage::{Fault, FaultKind, FaultStorage, Operation, Storage};
use session_archive::time::{CivilTime, TickLength};
use session_archive::verify::verify;

use machine::thermal::Heat;

use super::disk_guard::{DISK_FULL, DISK_LOW};
use super::*;
use crate::clock::VirtualClock;
use crate::status::State;

mod bench;
mod disk;
mod losses;

use bench::*;

#[test]
fn idle_armed_recording_stopping_armed() {
    let mut rig = rig(1000 * MS, Bench::default());
    assert_eq!(rig.recorder.state(), State::Idle);
    rig.steps(2);
    assert_eq!(rig.recorder.state(), State::Armed);
    started(&mut rig);
    assert_eq!(rig.recorder.state(), State::Recording);
    assert!(
        rig.recorder.start("", "button").is_err(),
        "it is already recording"
    );
    rig.steps(40);
    assert!(matches!(
        rig.recorder.request(Request::Stop, "button"),
        Response::Ok { .. }
    ));
    assert_eq!(rig.recorder.state(), State::Stopping);
    rig.step();
    rig.step();
    assert_eq!(rig.recorder.state(), State::Armed);
    let reader = rig.session();
    assert_eq!(reader.manifest().state, ManifestState::Closed);
    assert_eq!(
        reader.manifest().stopped.as_ref().expect("stop").reason,
        "button"
    );
    assert!(verify(&reader, |_| {}).expect("verify").is_sound());
    assert!(
        rig.recorder.stop("button").is_err(),
        "nothing is being recorded"
    );
}

#[test]
fn camera_begins_with_a_requested_key_frame_right_after_a_stop() {
    let mut rig = rig(1000 * MS, Bench::default());
    rig.steps(13);
    started(&mut rig);
    assert!(
        rig.recorder.take_key_frame_requests().is_empty(),
        "there is a pre-roll"
    );
    rig.recorder.close_now("button");
    rig.steps(2);
    started(&mut rig);
    assert_eq!(rig.recorder.take_key_frame_requests(), [0, 1]);
    assert!(
        rig.recorder.take_key_frame_requests().is_empty(),
        "once is enough"
    );
    rig.steps(10);
    rig.recorder.close_now("button");
    for camera in ["left_shoulder", "feet"] {
        let numbers: Vec<u64> = rig
            .messages::<Frame>(camera)
            .iter()
            .map(|f| f.number)
            .collect();
        assert_eq!(numbers, [20, 21, 22, 23, 24]);
    }
    assert_eq!(
        rig.messages::<Gap>(""),
        [],
        "it begins with what can be decoded"
    );
    assert!(verify(&rig.session(), |_| {}).expect("verify").is_sound());
}

#[test]
fn samples_in_transit_during_a_stop_keep_their_clock_maps() {
    let mut rig = rig(1000 * MS, Bench::default());
    let map = |rig: &mut Rig, version| {
        let map = ClockMap {
            clock: "feet".to_owned(),
            version,
            ..ClockMap::default()
        };
        rig.recorder.handle(Outgoing::Clock { at: rig.now(), map });
    };
    map(&mut rig, 1);
    rig.steps(100);
    started(&mut rig);
    rig.steps(2);
    map(&mut rig, 2);
    map(&mut rig, 3);
    rig.recorder.close_now("button");
    let versions = |rig: &Rig| -> Vec<u32> {
        rig.messages::<ClockMap>("feet")
            .iter()
            .map(|m| m.version)
            .collect()
    };
    assert_eq!(versions(&rig), [1, 2, 3]);
    rig.steps(2);
    started(&mut rig);
    rig.recorder.close_now("button");
    // A frame of version 2 may have been in the encoder when version 3 arrived.
    assert_eq!(versions(&rig), [1, 2, 3]);
    rig.steps(100);
    map(&mut rig, 4);
    rig.steps(100);
    started(&mut rig);
    rig.recorder.close_now("button");
    assert_eq!(versions(&rig), [4], "nothing can be on its way for seconds");
}

#[test]
fn the_pre_roll_begins_with_key_frames_from_before_the_press() {
    let mut rig = rig(1000 * MS, Bench::default());
    rig.steps(97);
    let press = rig.now();
    started(&mut rig);
    rig.steps(3);
    rig.recorder.close_now("button");
    for camera in ["left_shoulder", "feet"] {
        let frames: Vec<Frame> = rig.messages(camera);
        let first = &frames[0];
        assert!(first.key_frame);
        let before = press - HostTime(first.time);
        assert!(
            (1000 * MS..1600 * MS).contains(&before),
            "{camera}: {before}"
        );
        assert_eq!(frames.len() as u64, 100 - first.number);
    }
    let batches: Vec<ImuBatch> = rig.messages("feet/imu");
    assert!(press.0 - batches[0].times[0] >= 1000 * MS);
    let report = verify(&rig.session(), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:#?}");
}

#[test]
fn session_without_pre_roll_begins_at_the_press_with_requested_key_frames() {
    let mut rig = rig(0, Bench::default());
    let map = ClockMap {
        clock: "feet".to_owned(),
        version: 7,
        ..ClockMap::default()
    };
    rig.recorder.handle(Outgoing::Clock { at: START, map });
    rig.steps(36);
    let press = rig.now();
    started(&mut rig);
    assert_eq!(rig.messages::<Event>("").len(), 0, "nothing is on disk yet");
    assert_eq!(rig.recorder.take_key_frame_requests(), [0, 1]);
    rig.steps(6);
    rig.recorder.close_now("button");
    let frames: Vec<Frame> = rig.messages("feet");
    assert!(frames[0].key_frame && frames[0].number == 40, "{frames:?}");
    let batches: Vec<ImuBatch> = rig.messages("feet/imu");
    assert_eq!(batches[0].times[0], press.0);
    let maps: Vec<ClockMap> = rig.messages("feet");
    assert_eq!(maps.len(), 1, "its times can be mapped with it");
}

/// Samples that cameras deliver after a stop, on a rig whose IMU never delivers, must not be in a
/// session an hour later.
#[test]
fn samples_after_a_stop_are_not_in_the_next_session() {
    let mut rig = rig(0, Bench::default());
    let images = |rig: &mut Rig, periods| {
        for _ in 0..periods {
            rig.frame(0);
            rig.frame(1);
            rig.clock.advance_to(rig.now() + PERIOD);
            rig.recorder.tick();
        }
    };
    started(&mut rig);
    images(&mut rig, 15);
    rig.recorder.stop("button").expect("stop");
    // Number 20 is a key frame.
    images(&mut rig, 10);
    assert_eq!(rig.recorder.state(), State::Idle, "the stop is over");
    rig.clock.advance_to(rig.now() + 60 * NS_PER_S);
    rig.next = [1300; 2];
    let press = rig.now();
    started(&mut rig);
    let begun = rig.recorder.session.as_ref().map(|s| s.started);
    assert_eq!(begun, Some(press));
    images(&mut rig, 10);
    rig.recorder.close_now("button");
    assert_eq!(rig.messages::<Gap>(""), []);
    assert_eq!(rig.messages::<Frame>("feet")[0].number, 1300);
}

#[test]
fn pre_roll_excludes_samples_before_a_silence() {
    let mut rig = rig(1000 * MS, Bench::default());
    rig.steps(50);
    rig.clock.advance_to(rig.now() + 60 * NS_PER_S);
    let press = rig.now();
    started(&mut rig);
    let begun = rig.recorder.session.as_ref().map(|s| s.started);
    assert_eq!(begun, Some(press));
    assert_eq!(rig.recorder.take_key_frame_requests(), [0, 1]);
}

#[test]
fn stop_waits_for_frames_received_before_it_with_a_limit() {
    let mut rig = rig(0, Bench::default());
    rig.steps(20);
    started(&mut rig);
    rig.steps(10);
    // A frame captured before the press is still in the encoder.
    let late = Frame {
        number: rig.next[0],
        time: rig.now().0,
        host_time: rig.now().0,
        ..Frame::default()
    };
    rig.next[0] += 1;
    rig.encoding.begin(0);
    rig.clock.advance_to(rig.now() + 10 * MS);
    rig.recorder.stop("button").expect("stop");
    rig.clock.advance_to(rig.now() + 2 * STOP_LIMIT_NS);
    rig.recorder.tick();
    assert_eq!(rig.recorder.state(), State::Stopping, "it is being encoded");
    rig.queued.store(1, Ordering::SeqCst);
    rig.encoding.end(0);
    rig.recorder.tick();
    assert_eq!(rig.recorder.state(), State::Stopping, "it is queued");
    rig.queued.store(0, Ordering::SeqCst);
    let unit = Bytes::from_static(b"unit");
    rig.recorder.handle(Outgoing::Frame {
        camera: 0,
        frame: late,
        unit,
        key: false,
    });
    assert_eq!(
        rig.recorder.state(),
        State::Armed,
        "the other camera delivers nothing"
    );
    assert_eq!(
        rig.messages::<Frame>("left_shoulder")
            .last()
            .map(|f| f.number),
        Some(late.number)
    );
}

#[test]
fn marks_health_and_alarms_are_in_the_session() {
    let mut rig = rig(0, Bench::default());
    assert!(matches!(
        rig.recorder.request(
            Request::Mark {
                text: "early".to_owned(),
                at: None,
            },
            "button"
        ),
        Response::Error { .. }
    ));
    rig.steps(10);
    started(&mut rig);
    rig.steps(5);
    rig.recorder.request(
        Request::Mark {
            text: "stairs".to_owned(),
            at: None,
        },
        "button",
    );
    let alarm = |active, at| Outgoing::Alarm {
        at,
        text: "feet: no samples".to_owned(),
        stream: "feet".to_owned(),
        active,
    };
    rig.recorder.handle(alarm(true, rig.now()));
    assert_eq!(rig.recorder.status().alarms, ["feet: no samples"]);
    rig.queued.store(7, Ordering::SeqCst);
    rig.health();
    rig.recorder.handle(alarm(false, rig.now()));
    assert!(rig.recorder.status().alarms.is_empty());
    rig.recorder.close_now("button");
    let kinds: Vec<Kind> = rig.messages::<Event>("").iter().map(Event::kind).collect();
    assert_eq!(
        kinds,
        [
            Kind::Start,
            Kind::Mark,
            Kind::Fault,
            Kind::Cleared,
            Kind::Stop
        ]
    );
    let health: Vec<Health> = rig.messages("");
    assert_eq!((health.len(), health[0].writer_queue_bytes), (1, 7));
    assert_eq!(health[0].temperature_c, Some(41.5));
    assert!(health[0].streams[0].stored > 0 && health[0].streams[0].bitrate > 0.0);
}

#[test]
fn discarded_session_is_deleted() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    rig.steps(30);
    rig.recorder.request(Request::Discard, "button");
    assert!(rig.bench.disks.lock().expect("disks").is_empty());
    assert_eq!(rig.recorder.state(), State::Armed);
    assert_eq!(rig.recorder.status().session, None);
}

#[test]
fn pre_roll_over_the_byte_limit_is_an_alarm() {
    let mut rig = rig(10_000 * MS, Bench::default());
    let unit = Bytes::from(vec![0; MAX_PRE_ROLL_BYTES / 20]);
    for number in 0..30 {
        let time = rig.now().0;
        let frame = Frame {
            number,
            time,
            host_time: time,
            ..Frame::default()
        };
        rig.recorder.handle(Outgoing::Frame {
            camera: 0,
            frame,
            unit: unit.clone(),
            key: true,
        });
        rig.clock.advance_to(rig.now() + PERIOD);
    }
    assert_eq!(
        rig.recorder.status().alarms,
        ["pre-roll: 256 MB hold less than the 10.0 s of the configuration"]
    );
    rig.steps(250);
    assert!(rig.recorder.status().alarms.is_empty());
}

/// Otherwise a camera that was never present would leave a recording without any missing sample.
#[test]
fn streams_without_samples_are_named() {
    let mut rig = rig(0, Bench::default());
    let absent = |rig: &Rig| {
        let progress = rig.bench.progress.lock().expect("progress");
        match progress.last() {
            Some(Progress::Finished { absent, .. }) => absent.clone(),
            other => panic!("{other:?}"),
        }
    };
    started(&mut rig);
    rig.recorder.close_now("button");
    assert_eq!(absent(&rig), ["left_shoulder", "feet", "feet/imu"]);
    started(&mut rig);
    rig.steps(20);
    rig.recorder.close_now("button");
    assert!(absent(&rig).is_empty());
}

#[test]
fn the_last_recording_can_be_discarded_once() {
    let mut rig = rig(0, Bench::default());
    let discard = |rig: &mut Rig| rig.recorder.request(Request::DiscardLast, "button");
    assert!(
        matches!(discard(&mut rig), Response::Error { .. }),
        "none was created"
    );
    rig.steps(5);
    started(&mut rig);
    rig.steps(5);
    assert!(
        matches!(discard(&mut rig), Response::Error { .. }),
        "it is being created"
    );
    rig.recorder.close_now("button");
    assert_eq!(rig.bench.disks.lock().expect("disks").len(), 1);
    *rig.bench.keeps.lock().expect("keeps") = true;
    assert!(matches!(discard(&mut rig), Response::Error { .. }));
    *rig.bench.keeps.lock().expect("keeps") = false;
    assert!(
        matches!(discard(&mut rig), Response::Ok { .. }),
        "it can be tried again"
    );
    assert!(rig.bench.disks.lock().expect("disks").is_empty());
    assert!(
        matches!(discard(&mut rig), Response::Error { .. }),
        "it no longer exists"
    );
}

/// A hot machine raises an alarm, is relieved, is stopped before the kernel switches it off, and
/// does not start again.
#[test]
fn overheating_degrades_and_then_stops_the_recording() {
    let mut rig = rig(0, Bench::default());
    rig.steps(5);
    started(&mut rig);
    let mut delivered = Vec::new();
    for second in 0..240 {
        let margin_c = 20.0 - f64::from(second) * 0.2;
        rig.bench.machine.lock().expect("machine").pressure.heat = Some(Heat {
            hottest_c: Some(95.0 - margin_c),
            margin_c: Some(margin_c),
            critical_margin_c: Some(margin_c + 8.0),
            ..Heat::default()
        });
        rig.steps(20);
        let at = rig.now();
        rig.recorder.handle(Outgoing::Health {
            at,
            streams: Vec::new(),
        });
        let status = rig.recorder.status();
        if delivered.last() != Some(&status.degradation) {
            delivered.push(status.degradation.clone());
        }
        let is_hot = status.concerns.contains(&Concern::Heat);
        assert_eq!(is_hot, status.degradation != "normal", "{status:?}");
    }
    assert_eq!(
        delivered,
        [
            "normal",
            "warn",
            "lower preview",
            "lower frame rate",
            "stop"
        ]
    );
    assert_eq!(rig.recorder.state(), State::Armed, "it was stopped");
    let refused = rig.recorder.start("", "button").expect_err("too hot");
    assert!(refused.starts_with("not now: "), "{refused}");
}

/// A press immediately after another: the encoder of a camera has not delivered its first frame
/// yet.
#[test]
fn short_recording_waits_for_the_first_frame() {
    let mut rig = rig(0, Bench::default());
    rig.steps(20);
    started(&mut rig);
    rig.encoding.begin(0);
    let at = rig.now();
    rig.clock.advance_to(at + 1);
    rig.recorder.stop("button").expect("stop");
    rig.clock.advance_to(at + 5 * NS_PER_S);
    rig.recorder.tick();
    assert_eq!(rig.recorder.state(), State::Stopping);
    rig.recorder.handle(Outgoing::Frame {
        camera: 0,
        frame: Frame {
            number: rig.next[0],
            time: at.0,
            host_time: at.0,
            ..Frame::default()
        },
        unit: Bytes::from_static(b"unit"),
        key: true,
    });
    rig.encoding.end(0);
    rig.recorder.tick();
    assert_eq!(rig.recorder.state(), State::Armed);
    let stored: Vec<Frame> = rig.messages("left_shoulder");
    assert_eq!(stored.last().map(|f| f.number), Some(rig.next[0]));
}

/// Encoders that lag at the stop: the frames that they still deliver belong to the session, up to a
/// limit.
#[test]
fn stop_waits_for_lagging_encoders() {
    let mut rig = rig(0, Bench::default());
    rig.steps(20);
    started(&mut rig);
    rig.steps(10);
    let at = rig.now();
    rig.clock.advance_to(at + 1);
    rig.encoding.begin(0);
    rig.recorder.stop("button").expect("stop");
    let first = rig.next[0];
    let mut given = 0;
    while rig.recorder.state() == State::Stopping {
        assert!(
            rig.now() <= at + MAX_STOP_NS + 2 * NS_PER_S,
            "it never ends"
        );
        rig.clock.advance_to(rig.now() + NS_PER_S);
        let time = at.0 - 1_000 + given;
        let frame = Frame {
            number: first + given as u64,
            time,
            host_time: time,
            ..Frame::default()
        };
        given += 1;
        rig.recorder.handle(Outgoing::Frame {
            camera: 0,
            frame,
            unit: Bytes::from_static(b"unit"),
            key: false,
        });
        rig.recorder.tick();
    }
    let stored: Vec<Frame> = rig.messages("left_shoulder");
    let late = stored.iter().filter(|f| f.number >= first).count() as i64;
    assert_eq!(late, given, "all that came is stored");
    assert!(given >= MAX_STOP_NS / NS_PER_S - 1, "{given}");
}

#[test]
fn recording_without_intrinsics_is_noted_at_the_start() {
    let bench = Bench::default();
    let mut rig = rig(0, bench);
    rig.recorder.start("walk", "test").expect("a session");
    let notes = rig.recorder.status().notes;
    let progress = rig.bench.progress.lock().expect("progress").clone();
    let reported = progress.iter().find_map(|p| match p {
        Progress::Started { notes, .. } => Some(notes.clone()),
        _ => None,
    });
    assert_eq!(reported.as_ref(), Some(&notes));
    assert!(
        notes[0].starts_with("the lenses of left_shoulder, feet are not known")
            && notes[0].contains("`paws calib cameras "),
        "{notes:?}"
    );
    // Both eyes must be calibrated, and then there is no note.
    let mut setup = rig.recorder.setup.clone();
    let lens = |eye: &str| (eye.to_owned(), CameraCalibration::default());
    let eyes = ["feet/left", "left_shoulder/left", "left_shoulder/right"];
    setup.calibrations.extend(eyes.map(lens));
    assert!(setup.notes()[0].starts_with("the lenses of feet are not known"));
    setup.calibrations.push(lens("feet/right"));
    assert_eq!(setup.notes(), Vec::<String>::new());
}
