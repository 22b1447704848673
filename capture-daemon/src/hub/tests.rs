//! Hand-made samples through a hub with a real encoder at a small size.

use std::sync::{Mutex, MutexGuard};

use super::*;
use crate::sources::RawImu;
use video::{Picture, PixelFormat};

const MS: i64 = 1_000_000;
const START: HostTime = HostTime(1_000_000 * MS);

struct Bench {
    hub: Hub,
    seen: Arc<Mutex<Vec<Outgoing>>>,
}

/// A hub for one camera at 20 Hz with an IMU at 200 Hz.
fn bench() -> Bench {
    let seen: Arc<Mutex<Vec<Outgoing>>> = Arc::default();
    let into = seen.clone();
    let out: Out = Arc::new(move |item| into.lock().expect("seen").push(item));
    let clock = ClockConfig::new(TickLength::NANOSECOND);
    let camera = CameraSetup {
        name: "feet".to_owned(),
        rate_hz: 20.0,
        clock,
        number_bits: None,
        still: true,
        encoder: EncoderSettings {
            element: "x264enc".to_owned(),
            width: 64,
            height: 32,
            rate_hz: 20.0,
            quality_db: 40.0,
            threads: 1,
            max_key_interval_frames: 30,
        },
        imu: Some(ImuSetup {
            name: "feet/imu".to_owned(),
            info: ImuInfo {
                rate_hz: 200.0,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                scale: None,
            },
            clock,
            number_bits: None,
        }),
    };
    Bench {
        hub: Hub::new(vec![camera], 500 * MS, true, &out),
        seen,
    }
}

impl Bench {
    fn frame(&mut self, number: u64, at: HostTime) {
        let bytes = PixelFormat::I420.bytes(64, 32).expect("even");
        let data = vec![number as u8; bytes];
        let frame = RawFrame {
            number,
            device_ticks: at.0,
            kernel_time: None,
            host_time: at,
            exposure_ns: None,
            picture: Picture::new(64, 32, PixelFormat::I420, data).expect("picture"),
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
        };
        self.hub.sample(0, Sample::Imu(sample), now);
    }

    fn seen(&self) -> MutexGuard<'_, Vec<Outgoing>> {
        self.seen.lock().expect("seen")
    }

    fn notices(&self) -> Vec<String> {
        self.seen()
            .iter()
            .filter_map(|item| match item {
                Outgoing::Notice { text, .. } => Some(text.clone()),
                _ => None,
            })
            .collect()
    }
}

/// Were it encoded, the frames that are stored after it would refer to a frame that is not.
#[test]
fn a_late_or_repeated_frame_never_reaches_the_encoder() {
    let mut bench = bench();
    // The camera starts to count anew after its second frame.
    for (i, number) in [29, 30, 30, 0, 1, 2, 3, 4].into_iter().enumerate() {
        bench.frame(number, START + i as i64 * 50 * MS);
    }
    bench.hub.finish(START + 400 * MS);
    let frames: Vec<u64> = bench
        .seen()
        .iter()
        .filter_map(|item| match item {
            Outgoing::Frame { frame, .. } => Some(frame.number),
            _ => None,
        })
        .collect();
    assert_eq!(frames, [29, 30, 31, 32]);
    let notices = bench.notices();
    assert!(notices[0].contains("counts anew from 3"), "{notices:?}");
    assert_eq!(
        notices[1],
        "feet: samples that came late or twice, left out: 4"
    );
}

#[test]
fn a_repeated_imu_sample_costs_no_other() {
    let mut bench = bench();
    for (i, number) in (0..13).chain(12..40).enumerate() {
        let at = START + i as i64 * 5 * MS;
        bench.imu(number, at, at);
    }
    bench.hub.finish(START + 400 * MS);
    let mut next = 0;
    for item in bench.seen().iter() {
        if let Outgoing::Imu { batch, .. } = item {
            assert_eq!(batch.first_number, next);
            next += batch.times.len() as u64;
        }
    }
    assert_eq!(next, 40);
    assert_eq!(
        bench.notices(),
        ["feet/imu: samples that came late or twice, left out: 1"]
    );
}

#[test]
fn a_stream_that_comes_late_is_not_silent() {
    let mut bench = bench();
    for i in 0..100 {
        let at = START + i * 50 * MS;
        let now = at + 3000 * MS;
        bench.imu(i as u64, at, now);
        bench.frame(i as u64, now);
        bench.hub.tick(now);
    }
    let alarms = bench
        .seen()
        .iter()
        .filter(|item| matches!(item, Outgoing::Alarm { .. }))
        .count();
    assert_eq!(alarms, 0);
}

#[test]
fn a_failing_encoder_is_an_alarm() {
    let mut bench = bench();
    bench.hub.cameras[0].setup.encoder.element = "noenc".to_owned();
    bench.hub.cameras[0].lane = Lane::new(
        bench.hub.cameras[0].setup.encoder.clone(),
        500 * MS,
        Arc::new(|_| {}),
    );
    bench.frame(0, START);
    bench.hub.tick(START);
    bench.frame(1, START + 50 * MS);
    bench.hub.tick(START + 50 * MS);
    let alarms: Vec<String> = bench
        .seen()
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
