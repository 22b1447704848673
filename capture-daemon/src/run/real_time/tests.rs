use std::collections::BTreeSet;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use session_archive::record::Frame;
use session_archive::time::TickLength;
use video::encoder::Preset;
use video::{EncoderSettings, PixelFormat, RawImage};

use super::hub_thread::{run_hub, to_recorder};
use super::recorder_thread::{REQUEST_LIMIT, STOP_REQUEST_LIMIT};
use super::running::OUTBOX_CAPACITY_BYTES;
use super::shared::{HubInput, ToRecorder, lock};
use super::*;
use crate::control;
use crate::encoding::Encoding;
use crate::hub::{CameraSetup, FINISH_LIMIT, Hub, Out, Outgoing};
use crate::queue::PopResult;
use crate::recorder::MAX_STOP_NS;
use crate::sources::{RawFrame, Sample};
use crate::sync::clock::ClockConfig;

/// A status published before the wait is not missed, and the status already seen does not end
/// the wait.
#[test]
fn status_change_ends_the_wait() {
    const LONG: Duration = Duration::from_secs(3600);
    const STATUS: &str =
        r#"{"state": "idle", "seconds": 0, "streams": [], "alarms": [], "encoders": []}"#;
    let status = || Arc::new(serde_json::from_str(STATUS).expect("a status"));
    let shared = Arc::new(Shared::new(0, 0, false, Outcome::default()));
    assert!(!shared.wait_for_status(None, Duration::ZERO));
    *lock(&shared.latest) = Some(status());
    assert!(shared.wait_for_status(None, LONG));
    let seen = shared.latest();
    assert!(!shared.wait_for_status(seen.as_ref(), Duration::ZERO));
    let waiting = {
        let shared = shared.clone();
        std::thread::spawn(move || shared.wait_for_status(seen.as_ref(), LONG))
    };
    *lock(&shared.latest) = Some(status());
    shared.status_changed.notify_all();
    assert!(waiting.join().expect("it ends"));
}

/// Otherwise a stop on a slow machine would be reported as a failure, or killed, while it is in
/// progress.
#[test]
fn stop_clients_wait_longer_than_a_stop_takes() {
    let recorder = Duration::from_nanos(MAX_STOP_NS as u64);
    let client = control::answer_limit(&Request::Stop);
    assert!(recorder < STOP_REQUEST_LIMIT && STOP_REQUEST_LIMIT < client);
    assert!(REQUEST_LIMIT < control::answer_limit(&Request::Status));
    let number = |text: &str, before: &str, unit: Duration| {
        let (_, number) = text.split_once(before).expect(before);
        let number: String = number.chars().take_while(char::is_ascii_digit).collect();
        unit * number.parse::<u32>().expect("a number")
    };
    let unit = include_str!("../../../../deploy/pawsd.service");
    let second = Duration::from_secs(1);
    assert!(STOP_REQUEST_LIMIT < number(unit, "\nTimeoutStopSec=", second));
    let page = include_str!("../../../../crates/devices/rig-link/src/page/app.js");
    let page = number(page, "const ACT_LIMIT = ", Duration::from_millis(1));
    assert!(STOP_REQUEST_LIMIT < page);
}

/// Otherwise the end of a replay on a slow machine would be taken for a stuck thread.
#[test]
fn hub_loop_keeps_running_while_the_last_frames_are_encoded() {
    const { assert!(FINISH_LIMIT.as_nanos() < WATCHDOG_NS as u128) };
    let shared = Arc::new(Shared::new(
        1,
        OUTBOX_CAPACITY_BYTES,
        false,
        Outcome::default(),
    ));
    shared.set_recording(true);
    // Number of each delivered or reported frame, and time of the hub's last loop iteration.
    let reported: Arc<Mutex<Vec<(u64, i64)>>> = Arc::default();
    let (into, of_hub) = (reported.clone(), shared.clone());
    let out: Out = Arc::new(move |item| {
        let number = match item {
            Outgoing::Frame { frame, .. } => frame.number,
            Outgoing::Dropped { first, .. } => first,
            _ => return,
        };
        let beat = of_hub.hub_beat.load(Ordering::Relaxed);
        lock(&into).push((number, beat));
    });
    let (width, height) = (1344, 376);
    let setup = CameraSetup {
        name: "feet".to_owned(),
        trigger: None,
        rate_hz: 15.0,
        clock: ClockConfig::new(TickLength::NANOSECOND),
        number_bits: None,
        still: true,
        stamped: None,
        encoder: EncoderSettings {
            element: "x264enc".to_owned(),
            width,
            height,
            rate_hz: 15.0,
            quality_db: 40.0,
            threads: 1,
            max_key_interval_frames: 30,
            preset: Preset::default(),
        },
        imu: None,
    };
    let encoding = Encoding::new(1);
    let mut hub = Hub::new(vec![setup], NS_PER_S, false, &encoding, &out);
    let bytes = PixelFormat::I420.bytes(width, height).expect("even");
    // Noise: encoding a frame takes much longer than pushing it.
    let noise = |mut state: u64| {
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005);
            state = state.wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        let data: Vec<u8> = (0..bytes).map(|_| next()).collect();
        RawImage::new(width, height, PixelFormat::I420, data).expect("an image")
    };
    let images = [noise(1), noise(2)];
    // Many more than fit into an encoder.
    for number in 0..24 {
        let now = shared.now();
        let frame = RawFrame {
            number,
            device_ticks: now.0,
            kernel_time: None,
            host_time: now,
            exposure_ns: None,
            eyes_apart_ns: None,
            image: images[number as usize % 2].clone(),
        };
        hub.sample(0, Sample::Frame(frame), now);
    }
    let _ = shared.inbox.push_reserved(HubInput::Ended(0, None), 0);
    let of_hub = shared.clone();
    let hub = std::thread::spawn(move || run_hub(hub, 1, &of_hub));
    while !shared.all_ended.is_set() {
        wait_until(shared.now() + POLL_TIMEOUT.as_nanos() as i64, &shared);
    }
    shared.inbox.close();
    hub.join().expect("the hub");
    assert!(!encoding.is_busy(0));
    let mut reported = lock(&reported).clone();
    reported.sort_unstable();
    assert!(reported.iter().map(|(number, _)| *number).eq(0..24));
    let beats: BTreeSet<i64> = reported.iter().map(|(_, beat)| *beat).collect();
    assert!(beats.len() > 3, "{beats:?}");
}

/// A full outbox also rejects the requested key frame: then the next frame must be one.
#[test]
fn key_frame_is_requested_until_one_is_delivered() {
    let shared = Arc::new(Shared::new(1, 1000, false, Outcome::default()));
    let out = to_recorder(shared.clone(), vec!["feet".to_owned()]);
    let frame = |number, key| {
        out(Outgoing::Frame {
            camera: 0,
            frame: Frame {
                number,
                ..Frame::default()
            },
            unit: Bytes::from(vec![0; 500]),
            key,
        });
        shared.key_frame_needed[0].swap(false, Ordering::Relaxed)
    };
    assert!(!frame(0, true), "there is room");
    assert!(frame(1, false));
    assert!(!frame(2, false), "it was requested");
    assert!(frame(3, true), "it did not fit");
    while let PopResult::Item(_) = shared.outbox.pop(Duration::ZERO) {}
    assert!(!frame(4, false), "no reference frame, and requested");
    assert!(!frame(5, true));
    let mut numbers = Vec::new();
    while let PopResult::Item(item) = shared.outbox.pop(Duration::ZERO) {
        match item {
            ToRecorder::Item(Outgoing::Frame { frame, .. }) => numbers.push(Ok(frame.number)),
            ToRecorder::Item(Outgoing::Dropped { first, .. }) => numbers.push(Err(first)),
            _ => {}
        }
    }
    assert_eq!(numbers, [Err(4), Ok(5)]);
}
