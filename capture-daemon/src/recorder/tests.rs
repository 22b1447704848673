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

const MS: i64 = 1_000_000;
const START: HostTime = HostTime(1_000_000 * MS);

/// Results that a test inspects.
#[derive(Clone, Default)]
struct Bench {
    disks: Arc<Mutex<Vec<FaultStorage>>>,
    progress: Arc<Mutex<Vec<Progress>>>,
    free: Arc<Mutex<Option<u64>>>,
    machine: Arc<Mutex<MachineReading>>,
    /// Deleting fails.
    keeps: Arc<Mutex<bool>>,
    /// The folder of the session was removed.
    is_removed: Arc<Mutex<bool>>,
    /// Faults of the first disk.
    faults: Vec<Fault>,
}

impl SessionStore for Bench {
    fn create(&mut self, _: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)> {
        let disk = FaultStorage::with_faults(std::mem::take(&mut self.faults));
        let mut disks = self.disks.lock().expect("disks");
        disks.push(disk.clone());
        let path = PathBuf::from(format!("session{}", disks.len()));
        Ok((path, Arc::new(disk), format!("id{}", disks.len())))
    }

    fn discard(&mut self, _: &Path) -> io::Result<()> {
        if *self.keeps.lock().expect("keeps") {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        self.disks.lock().expect("disks").pop();
        Ok(())
    }

    fn is_there(&self, _: &Path) -> bool {
        !*self.is_removed.lock().expect("is_removed")
    }

    fn free_bytes(&self) -> Option<u64> {
        *self.free.lock().expect("free")
    }

    fn machine(&mut self, _: HostTime, _: bool) -> MachineReading {
        let mut reading = self.machine.lock().expect("machine").clone();
        reading.status.temperature_c = Some(41.5);
        reading
    }
}

/// A recorder for two cameras and an IMU, fed with synthetic samples in virtual time.
struct Rig {
    recorder: Recorder,
    clock: Arc<VirtualClock>,
    bench: Bench,
    encoding: Encoding,
    /// Bytes in the queue to the recorder.
    queued: Arc<AtomicU64>,
    /// Next frame numbers of both cameras.
    next: [u64; 2],
    next_imu: u64,
}

const PERIOD: i64 = 50 * MS;

fn rig(pre_roll_ns: i64, bench: Bench) -> Rig {
    let clock = Arc::new(VirtualClock::new(START, CivilTime(1_790_000_000_000 * MS)));
    let camera = |name: &str| Camera {
        name: name.to_owned(),
        width: 64,
        height: 32,
        codec: "h264".to_owned(),
        colour: "grey".to_owned(),
        rate_hz: 20.0,
        tick: TickLength::NANOSECOND,
        trigger: None,
        source: "synthetic".to_owned(),
        encoder: "none".to_owned(),
    };
    let setup = Setup {
        cameras: vec![camera("left_shoulder"), camera("feet")],
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: TickLength::NANOSECOND,
            source: "synthetic".to_owned(),
        }],
        calibrations: Vec::new(),
        transforms: FrameTransforms::default(),
        rig_files: Vec::new(),
        chunk_ns: 500 * MS,
        pre_roll_ns,
        reserve_bytes: 1 << 30,
        name: "walk".to_owned(),
        software: "tests".to_owned(),
    };
    let delivered = bench.progress.clone();
    let (encoding, queued) = (Encoding::new(2), Arc::<AtomicU64>::default());
    let of_queue = queued.clone();
    let queues = Queues {
        bytes: Box::new(move || of_queue.load(Ordering::SeqCst)),
        encoding: encoding.clone(),
    };
    let recorder = Recorder::new(
        setup,
        clock.clone(),
        Box::new(bench.clone()),
        queues,
        Box::new(move |p| delivered.lock().expect("progress").push(p)),
    );
    Rig {
        recorder,
        clock,
        bench,
        encoding,
        queued,
        next: [0; 2],
        next_imu: 0,
    }
}

impl Rig {
    fn now(&self) -> HostTime {
        self.clock.now()
    }

    /// One period: a frame of each camera (every tenth a key frame), ten IMU samples.
    fn step(&mut self) {
        for camera in 0..2 {
            self.frame(camera);
        }
        let times: Vec<i64> = (0..10).map(|i| self.now().0 + i * 5 * MS).collect();
        let batch = ImuBatch {
            first_number: self.next_imu,
            device_ticks: times.clone(),
            host_times: times.clone(),
            times,
            gyro: vec![0.5; 30],
            accel: vec![9.8; 30],
            ..ImuBatch::default()
        };
        self.next_imu += 10;
        self.recorder.handle(Outgoing::Imu { imu: 0, batch });
        self.clock.advance_to(self.now() + PERIOD);
        self.recorder.tick();
    }

    fn frame(&mut self, camera: usize) {
        let number = self.next[camera];
        self.next[camera] += 1;
        let time = self.now() + camera as i64 * MS;
        let frame = Frame {
            number,
            time: time.0,
            host_time: time.0,
            ..Frame::default()
        };
        let unit = Bytes::from(vec![number as u8; 100]);
        let key = number.is_multiple_of(10);
        self.recorder.handle(Outgoing::Frame {
            camera,
            frame,
            unit,
            key,
        });
    }

    fn steps(&mut self, n: usize) {
        for _ in 0..n {
            self.step();
        }
    }

    fn session(&self) -> SessionReader {
        let disk = self
            .bench
            .disks
            .lock()
            .expect("disks")
            .last()
            .cloned()
            .expect("a session");
        SessionReader::open(Arc::new(disk)).expect("open")
    }

    fn messages<R: session_archive::record::Record>(&self, of: &str) -> Vec<R> {
        let reader = self.session();
        let id = reader.manifest().stream::<R>(of).expect("stream").id;
        reader
            .entries()
            .filter_map(|e| match e.expect("read") {
                Entry::Message(m) if m.stream == id => Some(m.decode().expect("decode")),
                _ => None,
            })
            .collect()
    }

    fn health(&mut self) {
        let streams = ["left_shoulder", "feet", "feet/imu"].map(|name| StreamHealth {
            name: name.to_owned(),
            rate_hz: 20.0,
            ..StreamHealth::default()
        });
        self.recorder.handle(Outgoing::Health {
            at: self.now(),
            streams: streams.to_vec(),
        });
    }

    /// Samples stored and missing, as reported at the end.
    fn account(&self) -> (u64, u64) {
        let reported = self.progress().into_iter().find_map(|p| match p {
            Progress::Finished {
                stored, missing, ..
            } => Some((stored, missing)),
            _ => None,
        });
        reported.expect("the session ended")
    }

    fn progress(&self) -> Vec<Progress> {
        self.bench.progress.lock().expect("progress").clone()
    }
}

fn started(rig: &mut Rig) {
    assert!(matches!(
        rig.recorder.request(
            Request::Start {
                name: String::new()
            },
            "button"
        ),
        Response::Ok { .. }
    ));
}

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
fn every_loss_becomes_a_gap_with_its_cause() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    rig.steps(3);
    let dropped = |first, last, cause| Outgoing::Dropped {
        at: START,
        stream: "feet".to_owned(),
        first,
        last,
        cause,
        detail: "test".to_owned(),
    };
    rig.recorder.handle(dropped(
        rig.next[1],
        rig.next[1] + 1,
        Cause::EncoderOverload,
    ));
    // Two are reported, two only the device counted.
    for _ in 0..4 {
        rig.next[1] += 1;
        rig.frame(0);
        rig.clock.advance_to(rig.now() + PERIOD);
    }
    rig.steps(5);
    rig.recorder
        .handle(dropped(rig.next[1], rig.next[1], Cause::EncoderRestart));
    rig.recorder.close_now("button");
    let gaps: Vec<Gap> = rig.messages("");
    let found: Vec<_> = gaps
        .iter()
        .map(|g| (g.stream.as_str(), g.count(), g.cause()))
        .collect();
    let expected = [
        ("feet", 2, Cause::EncoderOverload),
        ("feet", 2, Cause::Device),
        ("feet", 1, Cause::EncoderRestart),
    ];
    assert_eq!(found, expected);
    let report = verify(&rig.session(), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:#?}");
    let feet = &report.streams["feet"];
    assert_eq!(feet.samples + feet.gaps, feet.expected());
    let sets: Vec<FrameSet> = rig.messages("");
    assert!(sets.iter().any(|s| s.missing == ["feet"]));
    assert!(sets.iter().any(|s| s.members.len() == 2));
}

#[test]
fn full_disk_ends_in_a_closed_session() {
    let bench = Bench::default();
    *bench.free.lock().expect("free") = Some(10 << 30);
    let mut rig = rig(0, bench);
    rig.steps(10);
    started(&mut rig);
    rig.steps(30);
    *rig.bench.free.lock().expect("free") = Some(900 << 20);
    rig.health();
    assert_eq!(rig.recorder.state(), State::Stopping);
    rig.steps(6);
    assert_eq!(rig.recorder.state(), State::Armed);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_FULL]);
    let reader = rig.session();
    assert_eq!(
        reader.manifest().stopped.as_ref().expect("stop").reason,
        "disk full"
    );
    assert!(verify(&reader, |_| {}).expect("verify").is_sound());
    let refused = rig.recorder.start("", "button").expect_err("no space");
    assert!(refused.contains("900 MB are free"), "{refused}");
}

/// Whatever write or sync fails, permanently or once: the session can be opened, is accounted for,
/// and the failure is reported.
#[test]
fn failing_disk_ends_in_a_valid_session_and_a_clear_message() {
    let run = |fault: Option<Fault>| {
        let mut rig = rig(
            0,
            Bench {
                faults: fault.into_iter().collect(),
                ..Bench::default()
            },
        );
        rig.steps(10);
        let _ = rig.recorder.start("", "button");
        rig.steps(40);
        rig.recorder.close_now("button");
        rig
    };
    let disks = run(None).bench.disks;
    let operations = disks.lock().expect("disks")[0].operations();
    assert!(operations > 20);
    for at in 0..operations {
        for kind in [
            FaultKind::NoSpace,
            FaultKind::InputOutput,
            FaultKind::PowerCut,
        ] {
            let rig = run(Some(Fault { at, kind, keep: 17 }));
            let progress = rig.progress();
            let reported = progress.iter().any(|p| {
                matches!(p, Progress::Finished { error: Some(_), .. })
                    || matches!(p, Progress::Alarm { active: true, .. })
            });
            let disk = rig.bench.disks.lock().expect("disks").first().cloned();
            let Some(disk) = disk else {
                assert!(
                    rig.recorder.fault.is_some(),
                    "{kind:?} at {at}: no session and no word"
                );
                continue;
            };
            let reader = SessionReader::open(Arc::new(disk)).expect("open");
            let report = verify(&reader, |_| {}).expect("verify");
            assert!(report.lost.is_empty(), "{kind:?} at {at}: {report:#?}");
            let (stored, missing) = rig.account();
            let found: u64 = report.streams.values().map(|s| s.samples).sum();
            assert!(
                stored <= found,
                "{kind:?} at {at}: {stored} of {found} stored"
            );
            assert!(
                stored == found || missing > 0,
                "{kind:?} at {at}: {stored} of {found} stored, nothing missing"
            );
            if kind == FaultKind::InputOutput {
                assert_eq!(
                    report.streams["feet"].gaps, 0,
                    "one failure loses nothing: {at}"
                );
            } else {
                let whole = report.streams["feet"].samples == 40;
                assert!(
                    reported || whole || rig.recorder.fault.is_some(),
                    "{kind:?} at {at}"
                );
            }
        }
    }
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
fn disk_alarms_end_with_their_cause() {
    let bench = Bench::default();
    let free = bench.free.clone();
    let set = |bytes| *free.lock().expect("free") = Some(bytes);
    let mut rig = rig(0, bench);
    set(10 << 30);
    rig.steps(10);
    started(&mut rig);
    rig.steps(20);
    set((1 << 30) + 1000);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_LOW]);
    assert!(rig.recorder.status().seconds_left.is_some());
    rig.recorder.close_now("button");
    set(10 << 30);
    rig.health();
    let status = rig.recorder.status();
    assert!(status.alarms.is_empty() && status.seconds_left.is_none());
    set(1 << 30);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_FULL], "before a press");
}

/// Two failures in a row lose the last chunk; the gap records written instead of it must not hide
/// this.
#[test]
fn losses_while_closing_are_reported() {
    let run = |faults: Vec<Fault>| {
        let bench = Bench {
            faults,
            ..Bench::default()
        };
        let mut rig = rig(0, bench);
        rig.steps(10);
        started(&mut rig);
        rig.steps(25);
        let disk = rig.bench.disks.lock().expect("disks")[0].clone();
        let before = disk.operations() as usize;
        rig.recorder.close_now("button");
        (rig, disk.log().split_off(before), before as u64)
    };
    let (whole, log, before) = run(Vec::new());
    let append = log
        .iter()
        .position(|o| matches!(o, Operation::Append(_)))
        .expect("a chunk") as u64;
    // The chunk, and after cutting it back the segment into which it was to go instead.
    let faults = [0, 2].map(|later| Fault {
        at: before + append + later,
        kind: FaultKind::InputOutput,
        keep: 0,
    });
    let (rig, ..) = run(faults.to_vec());
    let (all, none) = whole.account();
    let (stored, missing) = rig.account();
    assert_eq!(none, 0);
    assert!(missing > 0, "{:?}", rig.progress());
    assert_eq!(stored + missing, all);
    let report = verify(&rig.session(), |_| {}).expect("verify");
    let found: u64 = report.streams.values().map(|s| s.samples).sum();
    assert_eq!(found, stored);
    assert!(rig.progress().iter().any(
        |p| matches!(p, Progress::Alarm { text, active: true } if text.contains("data are lost"))
    ));
}

#[test]
fn failed_start_keeps_the_pre_roll_and_removes_the_folder() {
    let fault = Fault {
        at: 3,
        kind: FaultKind::InputOutput,
        keep: 0,
    };
    let bench = Bench {
        faults: vec![fault],
        ..Bench::default()
    };
    let mut rig = rig(1000 * MS, bench);
    rig.steps(50);
    let refused = rig.recorder.start("", "button").expect_err("the disk");
    assert!(refused.contains("cannot be created"), "{refused}");
    assert!(rig.bench.disks.lock().expect("disks").is_empty());
    let press = rig.now();
    started(&mut rig);
    rig.recorder.close_now("button");
    let frames: Vec<Frame> = rig.messages("feet");
    assert!(press.0 - frames[0].time >= 1000 * MS);
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

/// A loss raises an alarm with its cause within two seconds, and is reported at the end as a
/// fraction of the frames.
#[test]
fn loss_is_an_alarm_and_a_fraction_of_the_cameras_frames() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    // With a key frame.
    rig.step();
    for step in 0..60 {
        if step < 30 {
            // Every other frame of one camera is lost in its encoder.
            rig.recorder.handle(Outgoing::Dropped {
                at: rig.now(),
                stream: "feet".to_owned(),
                first: rig.next[1],
                last: rig.next[1],
                cause: Cause::EncoderOverload,
                detail: "full".to_owned(),
            });
            rig.next[1] += 1;
        }
        rig.step();
        if step % 20 == 19 {
            rig.health();
        }
        if step == 29 {
            // Page and lights use this status.
            let status = rig.recorder.status();
            assert_eq!(status.concerns, [Concern::Stream].into());
            assert!(
                status.alarms[0].contains("samples are being lost"),
                "{status:?}"
            );
        }
    }
    for _ in 0..6 {
        rig.steps(20);
        rig.health();
    }
    assert_eq!(rig.recorder.status().concerns, [].into());
    let alarms: Vec<(String, bool)> = rig
        .progress()
        .into_iter()
        .filter_map(|p| match p {
            Progress::Alarm { text, active } => Some((text, active)),
            _ => None,
        })
        .collect();
    let text = "feet: samples are being lost: the machine is too slow to encode them";
    let expected = [(text.to_owned(), true), (text.to_owned(), false)];
    assert_eq!(alarms, expected);
    rig.recorder.close_now("button");
    let Some(Progress::Finished {
        streams, missing, ..
    }) = rig.progress().pop()
    else {
        panic!("the session ended");
    };
    let feet = &streams[1];
    assert_eq!((feet.missing, feet.is_camera), (30, true));
    assert_eq!(missing, 30);
    assert_eq!(feet.causes.len(), 1, "{feet}");
    let share = 30.0 / (30.0 + feet.stored as f64);
    assert_eq!(feet.missing_share(), share);
    assert!(
        feet.to_string()
            .contains("% of the frames are missing (30 of "),
        "{feet}"
    );
    assert_eq!(streams[0].missing, 0);
}

/// A frame of each of these streams that is lost in its encoder.
fn lose(rig: &mut Rig, streams: &[&str]) {
    for stream in streams {
        rig.recorder.handle(Outgoing::Dropped {
            at: rig.now(),
            stream: (*stream).to_owned(),
            first: rig.next[0],
            last: rig.next[0],
            cause: Cause::EncoderOverload,
            detail: "full".to_owned(),
        });
    }
}

#[test]
fn discarding_a_session_clears_its_alarms() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    rig.step();
    lose(&mut rig, &["feet"]);
    rig.health();
    let text = "feet: samples are being lost: the machine is too slow to encode them";
    assert_eq!(rig.recorder.status().alarms, [text]);
    rig.recorder.request(Request::Discard, "button");
    assert_eq!(rig.recorder.status().alarms, Vec::<String>::new());
    let over = Progress::Alarm {
        text: text.to_owned(),
        active: false,
    };
    assert_eq!(rig.progress().pop(), Some(over));
}

/// The disk fails while the first of two alarms is written, which ends the session and both of
/// them.
#[test]
fn loss_alarms_end_with_the_session() {
    let run = |faults: Vec<Fault>| {
        let bench = Bench {
            faults,
            ..Bench::default()
        };
        let mut rig = rig(0, bench);
        rig.steps(10);
        started(&mut rig);
        rig.steps(10);
        lose(&mut rig, &["left_shoulder", "feet"]);
        // The next message closes the chunk.
        rig.clock.advance_to(rig.now() + 10 * NS_PER_S);
        let disk = rig.bench.disks.lock().expect("disks")[0].clone();
        let before = disk.operations();
        rig.health();
        assert!(disk.operations() > before);
        (rig, before)
    };
    let (whole, before) = run(Vec::new());
    assert_eq!(whole.recorder.status().alarms.len(), 2);
    let (rig, _) = run(vec![Fault {
        at: before,
        kind: FaultKind::PowerCut,
        keep: 0,
    }]);
    assert_eq!(rig.recorder.state(), State::Fault);
    let alarms = rig.recorder.status().alarms;
    assert!(
        alarms.len() == 1 && alarms[0].contains("ended by a failure"),
        "{alarms:?}"
    );
    let mut reported: BTreeMap<String, bool> = BTreeMap::new();
    for progress in rig.progress() {
        if let Progress::Alarm { text, active } = progress {
            reported.insert(text, active);
        }
    }
    let standing: Vec<String> = reported
        .into_iter()
        .filter_map(|(text, active)| active.then_some(text))
        .filter(|text| text.contains("samples are being lost"))
        .collect();
    assert_eq!(standing, Vec::<String>::new());
}

#[test]
fn session_ends_with_the_next_chunk_after_its_folder_is_removed() {
    let bench = Bench::default();
    let mut rig = rig(0, bench.clone());
    rig.steps(10);
    started(&mut rig);
    rig.steps(30);
    *bench.is_removed.lock().expect("is_removed") = true;
    let removed = rig.now();
    while rig.recorder.state() == State::Recording {
        rig.step();
        assert!(
            rig.now().since(removed) <= 1_000 * MS + PERIOD,
            "it continues"
        );
    }
    assert_eq!(rig.recorder.state(), State::Fault);
    let Some(Progress::Finished { error, .. }) = rig.progress().pop() else {
        panic!("the session ended");
    };
    let error = error.expect("a failure");
    assert!(error.contains("removed"), "{error}");
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
