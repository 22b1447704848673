//! Hand-written samples through a hub with a real encoder at a small size.

use std::sync::{Mutex, MutexGuard};

use session_archive::time::TickLength;

use super::stream_clock::MAX_TRANSIT_NS;
use super::*;
use crate::sources::{
    DevicePart, FrameArrival, ImuInfo, ImuValues, RawFrame, RawImu, TimestampRelation,
};
use crate::sync::clock::ClockConfig;
use video::{EncoderSettings, PixelFormat, RawImage};

const MS: i64 = 1_000_000;
const START: HostTime = HostTime(1_000_000 * MS);

struct Bench {
    hub: Hub,
    encoding: Encoding,
    frame_arrival: Arc<Mutex<Vec<Outgoing>>>,
}

/// A hub for one camera at 20 Hz with an IMU at 200 Hz.
fn bench() -> Bench {
    bench_with(None)
}

fn bench_with(stamped: Option<TimestampRelation>) -> Bench {
    bench_of(vec![CameraSetup {
        stamped,
        ..camera("feet")
    }])
}

/// A camera at 20 Hz with an IMU at 200 Hz.
fn camera(name: &str) -> CameraSetup {
    let clock = ClockConfig::new(TickLength::NANOSECOND);
    CameraSetup {
        name: name.to_owned(),
        trigger: None,
        rate_hz: 20.0,
        clock,
        number_bits: None,
        still: true,
        stamped: None,
        encoder: EncoderSettings {
            element: "x264enc".to_owned(),
            width: 64,
            height: 32,
            rate_hz: 20.0,
            quality_db: 40.0,
            threads: 1,
            max_key_interval_frames: 30,
            preset: Preset::default(),
        },
        imu: Some(ImuSetup {
            name: format!("{name}/imu"),
            info: ImuInfo {
                rate_hz: 200.0,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                scale: None,
                temperature_scale_c: None,
            },
            clock,
            number_bits: None,
        }),
    }
}

fn bench_of(cameras: Vec<CameraSetup>) -> Bench {
    let frame_arrival: Arc<Mutex<Vec<Outgoing>>> = Arc::default();
    let into = frame_arrival.clone();
    let out: Out = Arc::new(move |item| into.lock().expect("seen").push(item));
    let encoding = Encoding::new(cameras.len());
    Bench {
        hub: Hub::new(cameras, 500 * MS, true, &encoding, &out),
        encoding,
        frame_arrival,
    }
}

impl Bench {
    fn frame(&mut self, number: u64, at: HostTime) {
        self.stamped_frame(number, at, at);
    }

    fn stamped_frame(&mut self, number: u64, stamp: HostTime, at: HostTime) {
        let bytes = PixelFormat::I420.bytes(64, 32).expect("even");
        let data = vec![number as u8; bytes];
        let frame = RawFrame {
            number,
            device_ticks: stamp.0,
            kernel_time: None,
            host_time: at,
            exposure_ns: None,
            eyes_apart_ns: None,
            image: RawImage::new(64, 32, PixelFormat::I420, data).expect("image"),
        };
        self.hub.sample(0, Sample::Frame(frame), at);
    }

    fn imu(&mut self, number: u64, at: HostTime, now: HostTime) {
        let sample = RawImu {
            number,
            device_ticks: at.0,
            host_time: at,
            values: ImuValues::Si {
                gyro: [0.0; 3],
                accel: [9.8; 3],
            },
            temperature: None,
            frame_sync: false,
        };
        self.hub.sample(0, Sample::Imu(sample), now);
    }

    fn frame_arrival(&self) -> MutexGuard<'_, Vec<Outgoing>> {
        self.frame_arrival.lock().expect("seen")
    }

    /// Alarms about encoders that are too slow, with their beginnings and ends.
    fn relieved(&self) -> Vec<(String, bool)> {
        let alarms = self.frame_arrival();
        let alarms = alarms.iter().filter_map(|item| match item {
            Outgoing::Alarm {
                text,
                active,
                stream,
                ..
            } if stream == ENCODERS => {
                let (_, what) = text.split_once(": ").expect("what is done");
                Some((what.to_owned(), *active))
            }
            _ => None,
        });
        alarms.collect()
    }

    fn notices(&self) -> Vec<String> {
        self.frame_arrival()
            .iter()
            .filter_map(|item| match item {
                Outgoing::Notice { text, .. } => Some(text.clone()),
                _ => None,
            })
            .collect()
    }
}

/// If it were encoded, the frames stored after it would refer to a frame that is not stored.
#[test]
fn late_or_repeated_frame_never_reaches_the_encoder() {
    let mut bench = bench();
    // The camera restarts its counter after its second frame.
    for (i, number) in [29, 30, 30, 0, 1, 2, 3, 4].into_iter().enumerate() {
        bench.frame(number, START + i as i64 * 50 * MS);
    }
    bench.hub.finish(RemainingFrames::Encode, START + 400 * MS);
    assert!(!bench.encoding.is_busy(0), "each frame is counted out once");
    let frames: Vec<u64> = bench
        .frame_arrival()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Frame { frame, .. } => Some(frame.number),
            _ => None,
        })
        .collect();
    assert_eq!(frames, [29, 30, 31, 32]);
    let notices = bench.notices();
    assert!(notices[0].contains("counter restarted at 3"), "{notices:?}");
    assert_eq!(notices[1], "feet: late or repeated samples, rejected: 4");
}

#[test]
fn repeated_imu_sample_drops_no_other_sample() {
    let mut bench = bench();
    for (i, number) in (0..13).chain(12..40).enumerate() {
        let at = START + i as i64 * 5 * MS;
        bench.imu(number, at, at);
    }
    bench.hub.finish(RemainingFrames::Encode, START + 400 * MS);
    let mut next = 0;
    for item in bench.frame_arrival().iter() {
        if let Outgoing::Imu { batch, .. } = item {
            assert_eq!(batch.first_number, next);
            next += batch.times.len() as u64;
        }
    }
    assert_eq!(next, 40);
    assert_eq!(
        bench.notices(),
        ["feet/imu: late or repeated samples, rejected: 1"]
    );
}

#[test]
fn late_stream_is_not_silent() {
    let mut bench = bench();
    for i in 0..100 {
        let at = START + i * 50 * MS;
        let now = at + 3000 * MS;
        bench.imu(i as u64, at, now);
        bench.frame(i as u64, now);
        bench.hub.tick(now);
    }
    let alarms = bench
        .frame_arrival()
        .iter()
        .filter(|item| matches!(item, Outgoing::Alarm { .. }))
        .count();
    assert_eq!(alarms, 0);
}

#[test]
fn failing_encoder_raises_an_alarm() {
    let mut bench = bench();
    bench.hub.cameras[0].setup.encoder.element = "noenc".to_owned();
    bench.hub.cameras[0].encoder = CameraEncoder::new(
        bench.hub.cameras[0].setup.encoder.clone(),
        500 * MS,
        1,
        Arc::new(|_| {}),
    );
    bench.frame(0, START);
    bench.hub.tick(START);
    bench.frame(1, START + 50 * MS);
    bench.hub.tick(START + 50 * MS);
    let alarms: Vec<String> = bench
        .frame_arrival()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Alarm { text, active, .. } => Some(format!("{active} {text}")),
            _ => None,
        })
        .collect();
    assert_eq!(
        alarms,
        ["true feet: the encoder fails and is started again"]
    );
}

#[test]
fn samples_missed_while_disconnected_have_that_cause() {
    let mut bench = bench();
    let at = |i: i64| START + i * 50 * MS;
    let disconnect = |bench: &mut Bench, i: i64| {
        let host_time = at(i) + 10 * MS;
        let detail = "unplugged".to_owned();
        let part = DevicePart::Both;
        let disconnect = Sample::Disconnected(Disconnect {
            host_time,
            part,
            detail,
        });
        bench.hub.sample(0, disconnect, host_time);
    };
    for i in 0..10 {
        bench.frame(i as u64, at(i));
    }
    disconnect(&mut bench, 9);
    // Eight periods later its counter restarts.
    for i in 18..22 {
        bench.frame(i as u64 - 18, at(i));
    }
    disconnect(&mut bench, 21);
    // Once more, with a counter that continued: the device's count is better than the clock's.
    bench.frame(9, at(26));
    disconnect(&mut bench, 26);
    bench.hub.finish(RemainingFrames::Encode, at(30));
    let frame_arrival = bench.frame_arrival();
    let frames: Vec<u64> = frame_arrival
        .iter()
        .filter_map(|item| match item {
            Outgoing::Frame { frame, .. } => Some(frame.number),
            _ => None,
        })
        .collect();
    assert_eq!(
        frames,
        (0..10).chain(18..22).chain([27]).collect::<Vec<_>>()
    );
    let dropped: Vec<(u64, u64, Cause)> = frame_arrival
        .iter()
        .filter_map(|item| match item {
            Outgoing::Dropped {
                first, last, cause, ..
            } => Some((*first, *last, *cause)),
            _ => None,
        })
        .collect();
    let expected = [(10, 17), (22, 26), (28, 30)].map(|(a, b)| (a, b, Cause::Disconnected));
    assert_eq!(dropped, expected);
    let alarms: Vec<bool> = frame_arrival
        .iter()
        .filter_map(|item| match item {
            Outgoing::Alarm { text, active, .. }
                if text.starts_with("feet: the device is disconnected (") =>
            {
                Some(*active)
            }
            _ => None,
        })
        .collect();
    assert_eq!(alarms, [true, false, true, false, true]);
}

/// Otherwise a recording that ends before the device reconnects would lack the cause.
#[test]
fn missed_samples_are_reported_during_the_disconnect() {
    let mut bench = bench();
    let at = |i: i64| START + i * 50 * MS;
    for i in 0..10 {
        bench.frame(i as u64, at(i));
    }
    let disconnect = Sample::Disconnected(Disconnect {
        host_time: at(9),
        part: DevicePart::Camera,
        detail: "unplugged".to_owned(),
    });
    bench.hub.sample(0, disconnect, at(9));
    bench.hub.tick(at(10));
    bench.hub.tick(at(15));
    bench.hub.tick(at(20));
    bench.frame(0, at(22));
    bench.hub.tick(at(24));
    let dropped: Vec<(HostTime, u64, u64)> = bench
        .frame_arrival()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Dropped {
                at, first, last, ..
            } => Some((*at, *first, *last)),
            _ => None,
        })
        .collect();
    assert_eq!(
        dropped,
        [(at(15), 10, 14), (at(20), 10, 19), (at(9), 10, 21)]
    );
}

/// Otherwise a device with another date would end the recording: no message may be before the
/// clock's zero.
#[test]
fn tick_far_in_the_past_is_timed_by_its_arrival() {
    let mut bench = bench();
    for i in 0..80 {
        let at = START + i * 50 * MS;
        let raw = RawFrame {
            number: i as u64,
            // Two hours back, after a second.
            device_ticks: at.0 - if i < 20 { 0 } else { 7200 * NS_PER_S },
            kernel_time: None,
            host_time: at,
            exposure_ns: None,
            eyes_apart_ns: None,
            image: RawImage::new(64, 32, PixelFormat::I420, vec![i as u8; 64 * 48]).expect("image"),
        };
        bench.hub.sample(0, Sample::Frame(raw), at);
    }
    bench.hub.finish(RemainingFrames::Encode, START + 4000 * MS);
    let mut count = 0;
    for item in bench.frame_arrival().iter() {
        if let Outgoing::Frame { frame, .. } = item {
            let off = frame.host_time - frame.time;
            assert!(off.abs() < MAX_TRANSIT_NS, "{frame:?}");
            count += 1;
        }
    }
    assert_eq!(count, 80);
}

/// A driver's timestamp on the host clock is a time, unless it is impossible.
#[test]
fn host_timestamps_are_used_as_times() {
    let mut bench = bench_with(Some(TimestampRelation {
        latency_ns: 2 * MS,
        sigma_ns: 50_000,
    }));
    let arrival = |i: i64| START + i * 50 * MS;
    for (i, age) in [(0, 8 * MS), (1, 30 * MS), (2, -5 * MS), (3, 9 * MS)] {
        let stamp = arrival(i) + -age;
        bench.stamped_frame(i as u64, stamp, arrival(i));
    }
    let frame_arrival = bench.frame_arrival();
    let times: Vec<(i64, u64, bool)> = frame_arrival
        .iter()
        .filter_map(|item| match item {
            Outgoing::Frame { frame, .. } => {
                Some((frame.time - START.0, frame.sigma_ns, frame.time_unreliable))
            }
            _ => None,
        })
        .collect();
    assert_eq!(times[0], (-10 * MS, 50_000, false));
    assert_eq!(times[1], (50 * MS - 32 * MS, 50_000, false));
    // It cannot have been stamped after its arrival.
    assert!(times[2].2 && times[2].0 == 100 * MS, "{times:?}");
    assert_eq!((times[3].0, times[3].2), (150 * MS - 11 * MS, false));
    let maps = frame_arrival
        .iter()
        .filter(|item| matches!(item, Outgoing::Clock { map, .. } if map.latency_ns == 2 * MS));
    assert_eq!(maps.count(), 1, "the map is published once");
}

#[test]
fn frame_rate_mitigation_drops_every_other_frame() {
    let mut bench = bench();
    let at = |i: i64| START + i * 50 * MS;
    for i in 0..10 {
        bench.hub.set_mitigations(Mitigations {
            lower_frame_rate: i >= 4,
            ..Mitigations::default()
        });
        bench.frame(i as u64, at(i));
    }
    let mut kept = Vec::new();
    let mut decimated = Vec::new();
    for item in bench.frame_arrival().iter() {
        match item {
            Outgoing::Frame { frame, .. } => kept.push(frame.number),
            Outgoing::Dropped {
                first,
                cause: Cause::LoadShed,
                ..
            } => decimated.push(*first),
            _ => {}
        }
    }
    assert_eq!(kept, [0, 1, 2, 3, 4, 6, 8]);
    assert_eq!(decimated, [5, 7, 9]);
}

/// The hub may lag when recording begins. Otherwise frames without pixels behind the previewed one
/// would be a gap in the recording.
#[test]
fn frames_that_arrived_before_recording_are_not_encoded() {
    let mut bench = bench();
    let at = |i: u64| START + i as i64 * 50 * MS;
    let without_pixels = |bench: &mut Bench, number: u64| {
        let frame_arrival = FrameArrival {
            number,
            device_ticks: at(number).0,
            host_time: at(number),
        };
        bench
            .hub
            .sample(0, Sample::Arrival(frame_arrival), at(number));
    };
    bench.hub.idle(true, START);
    without_pixels(&mut bench, 0);
    bench.hub.idle(false, at(3) + 1);
    bench.frame(1, at(1));
    without_pixels(&mut bench, 2);
    without_pixels(&mut bench, 3);
    bench.frame(4, at(4));
    bench.frame(5, at(5));
    let encoded: Vec<(u64, bool)> = bench
        .frame_arrival()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Frame { frame, key, .. } => Some((frame.number, *key)),
            _ => None,
        })
        .collect();
    assert_eq!(encoded, [(4, true), (5, false)]);
}

/// Frames queued at the end of a recording are not the beginning of the next one.
#[test]
fn queued_frames_are_dropped_when_not_recording() {
    let mut bench = bench();
    bench.hub.waits = false;
    // An encoder that cannot be started for now.
    bench.hub.cameras[0].setup.encoder.element = "noenc".to_owned();
    let (settings, frame_arrival) = (
        bench.hub.cameras[0].setup.encoder.clone(),
        bench.frame_arrival.clone(),
    );
    let sink = Arc::new(move |encoded: EncoderOutput| match encoded {
        EncoderOutput::Dropped {
            at, first, last, ..
        } => frame_arrival.lock().expect("seen").push(Outgoing::Dropped {
            at,
            stream: String::new(),
            first,
            last,
            cause: Cause::Late,
            detail: String::new(),
        }),
        EncoderOutput::Frame { .. } => panic!("there is no such encoder"),
    });
    bench.hub.cameras[0].encoder = CameraEncoder::new(settings, 500 * MS, 1 << 20, sink);
    for i in 0..10 {
        bench.frame(i, START + i as i64 * MS);
    }
    let dropped = |bench: &Bench| {
        let frame_arrival = bench.frame_arrival();
        let is_dropped = |item: &&Outgoing| matches!(item, Outgoing::Dropped { .. });
        frame_arrival.iter().filter(is_dropped).count()
    };
    assert_eq!(dropped(&bench), 2, "two tries");
    bench.hub.idle(true, START);
    assert_eq!(dropped(&bench), 10);
}

#[test]
fn draining_delivers_everything_without_a_silence_alarm() {
    let mut bench = bench();
    bench.hub.waits = false;
    let at = |i: u64| START + i as i64 * 50 * MS;
    for i in 0..30 {
        bench.frame(i, at(i));
        bench.imu(i, at(i), at(i));
    }
    while !bench.hub.drain(at(30)) {
        std::thread::yield_now();
    }
    assert!(!bench.encoding.is_busy(0));
    for i in 30..200 {
        bench.hub.tick(at(i));
        assert!(bench.hub.drain(at(i)));
    }
    bench.hub.finish(RemainingFrames::Encode, at(200));
    let frame_arrival = bench.frame_arrival();
    let frames = frame_arrival.iter().filter_map(|item| match item {
        Outgoing::Frame { frame, .. } => Some(frame.number),
        _ => None,
    });
    assert!(frames.eq(0..30));
    let alarms = frame_arrival
        .iter()
        .filter(|item| matches!(item, Outgoing::Alarm { .. }));
    assert_eq!(alarms.count(), 0);
}

/// The camera continues while its IMU is disconnected, and vice versa.
#[test]
fn camera_and_imu_disconnect_independently() {
    let mut bench = bench();
    let at = |i: i64| START + i * 50 * MS;
    let disconnect = |bench: &mut Bench, part, i: i64| {
        let disconnect = Sample::Disconnected(Disconnect {
            host_time: at(i),
            part,
            detail: "unplugged".to_owned(),
        });
        bench.hub.sample(0, disconnect, at(i));
    };
    bench.frame(0, at(0));
    bench.imu(0, at(0), at(0));
    disconnect(&mut bench, DevicePart::Imu, 1);
    bench.frame(1, at(1));
    disconnect(&mut bench, DevicePart::Camera, 2);
    bench.imu(20, at(2), at(2));
    bench.frame(3, at(3));
    let alarms: Vec<String> = bench
        .frame_arrival()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Alarm { text, active, .. } => Some(format!("{active} {text}")),
            _ => None,
        })
        .collect();
    assert_eq!(
        alarms,
        [
            "true feet/imu: the device is disconnected (unplugged)",
            "true feet: the device is disconnected (unplugged)",
            "false feet/imu: the device is disconnected (unplugged)",
            "false feet: the device is disconnected (unplugged)",
        ]
    );
}

/// Growing queues reduce quality before frames are lost, and when they are empty everything is
/// restored.
#[test]
fn slow_machine_sheds_load_step_by_step() {
    let mut bench = bench();
    bench.hub.waits = false;
    let mut now = START;
    let mut run = |bench: &mut Bench, seconds: i64, fill: &dyn Fn(i64) -> f64| {
        for tick in 0..10 * seconds {
            now = now + TICK_NS;
            bench.hub.set_inbox_fill(fill(tick));
            bench.hub.tick(now);
        }
    };
    // The queue grows by a twentieth of its capacity per second, then remains empty.
    run(&mut bench, 8, &|tick| tick as f64 / 200.0);
    let rate_lowered = bench.hub.rate_lowered(0).is_some();
    run(&mut bench, 60, &|_| 0.0);
    assert!(rate_lowered && bench.hub.rate_lowered(0).is_none());
    let alarms = bench.relieved();
    let (quality, rates) = (Step::Quality.text(), Step::AllRates.text());
    let expected = [
        (quality, true),
        (quality, false),
        (rates, true),
        (rates, false),
        (quality, true),
        (quality, false),
    ];
    let expected = expected.map(|(what, active)| (what.to_owned(), active));
    assert_eq!(alarms, expected, "one camera at the fastest preset");
}

/// With several cameras, and a preset that can be faster, there are four steps.
#[test]
fn last_camera_loses_its_frame_rate_before_the_others() {
    let mut cameras = vec![camera("left_shoulder"), camera("feet")];
    for camera in &mut cameras {
        camera.encoder.preset = Preset::Veryfast;
    }
    let mut bench = bench_of(cameras);
    bench.hub.waits = false;
    let mut now = START;
    let mut lowered = Vec::new();
    // The queue grows by a twentieth of its capacity per second, until all steps are taken.
    for tick in 0..120 {
        now = now + TICK_NS;
        bench.hub.set_inbox_fill(f64::from(tick) / 200.0);
        bench.hub.tick(now);
        let of = [0, 1].map(|camera| bench.hub.rate_lowered(camera).is_some());
        if lowered.last() != Some(&of) {
            lowered.push(of);
        }
    }
    let begun = bench.relieved().into_iter().filter(|(_, active)| *active);
    let begun: Vec<String> = begun.map(|(what, _)| what).collect();
    assert_eq!(
        begun,
        [
            "faster preset",
            "quality lowered",
            "half the frame rate of the last camera",
            "half the frame rate of all cameras",
        ]
    );
    assert_eq!(lowered, [[false, false], [false, true], [true, true]]);
}

/// Armed without a pre-roll: frames are counted and timed, and no more.
#[test]
fn idle_frames_are_counted_and_the_first_recorded_frame_is_a_key_frame() {
    let mut bench = bench();
    let at = |i: i64| START + i * 50 * MS;
    let frames = |bench: &Bench| -> Vec<(u64, bool)> {
        let items = bench.frame_arrival();
        let frames = items.iter().filter_map(|item| match item {
            Outgoing::Frame { frame, key, .. } => Some((frame.number, *key)),
            _ => None,
        });
        frames.collect()
    };
    let stage = |bench: &mut Bench, is_idle: bool, numbers: std::ops::Range<i64>| {
        bench.hub.idle(is_idle, at(numbers.start));
        for i in numbers {
            // A source may omit the pixels, but need not.
            if is_idle && i % 2 == 1 {
                let frame_arrival = FrameArrival {
                    number: i as u64,
                    device_ticks: at(i).0,
                    host_time: at(i),
                };
                bench.hub.sample(0, Sample::Arrival(frame_arrival), at(i));
            } else {
                bench.frame(i as u64, at(i));
            }
            bench.hub.tick(at(i));
        }
    };
    stage(&mut bench, true, 0..33);
    assert_eq!(frames(&bench), []);
    assert!(!bench.encoding.is_busy(0), "nothing is being encoded");
    let received = bench
        .frame_arrival()
        .iter()
        .rev()
        .find_map(|item| match item {
            Outgoing::Health { streams, .. } => Some(streams[0].received),
            _ => None,
        });
    // Health is reported once a second, the last time with the 21st frame.
    assert_eq!(received, Some(21));

    // None of them begins a chunk, which would also require a key frame.
    stage(&mut bench, false, 33..36);
    stage(&mut bench, true, 36..38);
    stage(&mut bench, false, 38..39);
    bench.hub.finish(RemainingFrames::Encode, at(39));
    assert_eq!(
        frames(&bench),
        [(33, true), (34, false), (35, false), (38, true)]
    );
    let is_dropped = |item: &Outgoing| matches!(item, Outgoing::Dropped { .. });
    assert!(
        !bench.frame_arrival().iter().any(is_dropped),
        "frames that were not requested are not missing"
    );
}
